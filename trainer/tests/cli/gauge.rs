//! Base and tool on the command line: kept, stated, carried to another station, or refused.

use poegp_calibration::blob::predict::BlobModel;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::{Pose, Twist};
use serde_json::Value;

use crate::program::{Folder, SERIAL, changed, simulated};
use crate::texts::texts;

/// Returns a folder with two measurements of one arm, and a model of the first.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("first.csv", simulated("train", 60));
    folder.write("second.csv", simulated("test1", 60));
    let line = format!(
        "calibrate --robot {SERIAL} first.csv --method poe --gauge grid --out first.blob --json first.json"
    );
    folder.run(&line).ok().said();
    folder
}

fn again(folder: &Folder, options: &str) -> String {
    let _ = folder;
    format!(
        "calibrate --robot {SERIAL} second.csv --method poe --out second.blob --json second.json {options}"
    )
}

/// Returns the measurements with other measured poses.
fn moved(csv: &str, other: impl Fn(Pose<f64>) -> Pose<f64>) -> String {
    changed(csv, |names, fields| {
        let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
        let get = |name: &str| fields[at(name)].parse::<f64>().unwrap();
        let v = nalgebra::Vector3::new(get("qx"), get("qy"), get("qz"));
        let t = 1e-3 * nalgebra::Vector3::new(get("x_mm"), get("y_mm"), get("z_mm"));
        let pose = other(Pose::from_quaternion(get("qw"), &v, t));
        let (w, v) = pose.quaternion();
        for (name, value) in [("qw", w), ("qx", v[0]), ("qy", v[1]), ("qz", v[2])] {
            fields[at(name)] = format!("{value:.12}");
        }
        for (axis, name) in ["x_mm", "y_mm", "z_mm"].iter().enumerate() {
            fields[at(name)] = format!("{:.6}", 1e3 * pose.translation[axis]);
        }
    })
}

/// Returns X,Y,Z,QW,QX,QY,QZ in mm.
fn text(rows: &[f64; 12]) -> String {
    let pose = Pose::from_rows(rows);
    let (w, v) = pose.quaternion();
    let t = 1e3 * pose.translation;
    format!("{},{},{},{w},{},{},{}", t[0], t[1], t[2], v[0], v[1], v[2])
}

#[test]
fn a_gauge_is_kept_or_stated() {
    let _texts = texts();
    let folder = folder();
    let gauge = |name: &str| -> Value { folder.json(name)["gauge"].clone() };
    assert_eq!(gauge("first.json")["base"], "grid");
    let read = |name: &str| BlobModel::read(&folder.path(name)).unwrap();
    let first = read("first.blob").host().gauge.clone();

    folder
        .run(&again(&folder, "--keep-gauge first.blob"))
        .ok()
        .said();
    let kept = read("second.blob").host().gauge.clone();
    assert_eq!(kept.base, FrameSource::Previous);
    assert_eq!(kept.instrument_from_base, first.instrument_from_base);
    assert_eq!(kept.flange_from_target, first.flange_from_target);
    assert_eq!(kept.ranges, first.ranges);
    let moved = &gauge("second.json")["commands_move"];
    assert_eq!(moved["poses"], 60);
    assert!(moved["position_mm"]["mean"].as_f64().unwrap() > 0.0);
    folder.run("inspect second.blob").ok().said();
    folder
        .run("check second.blob first.csv --max-mm 9 --previous first.blob")
        .ok()
        .said();

    // The same frames as numbers.
    let (base, tool) = (
        text(&first.instrument_from_base),
        text(&first.flange_from_target),
    );
    let line = format!("--base-from {base} --tool-from {tool} --previous first.blob");
    folder.run(&again(&folder, &line)).ok();
    let stated = read("second.blob").host().gauge.clone();
    assert_eq!(
        (stated.base, stated.tool),
        (FrameSource::Stated, FrameSource::Stated)
    );
    let near = |a: &[f64; 12], b: &[f64; 12]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(near(
        &stated.instrument_from_base,
        &first.instrument_from_base
    ));
    assert!(near(&stated.flange_from_target, &first.flange_from_target));

    // A project file repeats it, byte for byte.
    folder
        .run(&again(
            &folder,
            "--keep-gauge first.blob --write-project again.toml",
        ))
        .ok();
    let bytes = folder.read("second.blob");
    folder.run("calibrate again.toml").ok();
    assert_eq!(folder.read("second.blob"), bytes);
    assert_eq!(folder.json("second.json")["repeats"], true);
}

/// The instrument is moved. Reference points carry the base to its new place, and commands stay as before.
#[test]
fn fixed_points_carry_the_base_to_another_station() {
    let _texts = texts();
    let folder = folder();
    let by = Pose::exp(&Twist::from_array(&[0.4, -0.3, 0.2, 0.1, -0.2, 0.3]));
    folder.write(
        "second.csv",
        moved(&simulated("test1", 60), |pose| by * pose),
    );
    let points = |lift: f64| {
        let mut out =
            "before_x_mm,before_y_mm,before_z_mm,after_x_mm,after_y_mm,after_z_mm\n".to_owned();
        for (i, p) in [
            [0.0, 0.0, 0.0],
            [2.0, 0.0, 0.1],
            [0.0, 1.5, 0.0],
            [1.0, 1.0, 0.8],
        ]
        .iter()
        .enumerate()
        {
            let before = nalgebra::Vector3::from(*p);
            let mut after = by.transform_point(&before);
            after[2] += if i == 3 { lift } else { 0.0 };
            let (a, b) = (1e3 * before, 1e3 * after);
            out += &format!(
                "{},{},{},{:.5},{:.5},{:.5}\n",
                a[0], a[1], a[2], b[0], b[1], b[2]
            );
        }
        out
    };
    // Without reference points the kept base would be wrong, which is refused.
    let refused = folder
        .run(&again(&folder, "--keep-gauge first.blob"))
        .refused();
    refused.said();
    folder.write("points.csv", points(0.0));
    folder
        .run(&again(
            &folder,
            "--keep-gauge first.blob --references points.csv",
        ))
        .ok()
        .said();
    let document = folder.json("second.json");
    assert_eq!(document["gauge"]["points"]["points"], 4);
    // One of the points was moved by a millimetre.
    folder.write("points.csv", points(1e-3));
    let line = again(&folder, "--keep-gauge first.blob --references points.csv");
    folder.run(&line).refused().said();
}

/// An instrument that was moved by 3 mm, or a joint whose zero is 0.05° off: only the first shifts commands if the base is kept.
#[test]
fn a_moved_base_is_not_kept() {
    let _texts = texts();
    let folder = folder();
    let by = Pose::exp(&Twist::from_array(&[2e-3, -1e-3, 2e-3, 0.0, 0.0, 1e-4]));
    folder.write(
        "second.csv",
        moved(&simulated("test1", 60), |pose| by * pose),
    );
    let line = again(&folder, "--keep-gauge first.blob");
    let refused = folder.run(&line).said();
    assert_eq!(refused.code, Some(3), "{refused:#?}");
    assert!(!folder.path("second.blob").exists());
    assert_eq!(folder.json("second.json")["refused"][0]["cause"], "frames");
    folder.run(&format!("{line} --accept frames")).ok();

    // A target that was mounted in another way is refused, too, unless its frame is stated.
    let by = Pose::exp(&Twist::from_array(&[0.0, 3e-3, 0.0, 0.0, 0.0, 0.0]));
    folder.write(
        "second.csv",
        moved(&simulated("test1", 60), |pose| pose * by),
    );
    let refused = folder.run(&line).said();
    assert_eq!(refused.code, Some(3), "{refused:#?}");
    let first = BlobModel::read(&folder.path("first.blob")).unwrap();
    let tool = Pose::from_rows(&first.host().gauge.flange_from_target) * by;
    let stated = text(&tool.to_rows());
    folder.run(&format!("{line} --tool-from {stated}")).ok();

    let worn = changed(&simulated("test1", 60), |names, fields| {
        let joint = names.iter().position(|n| *n == "q3_deg").unwrap();
        let angle: f64 = fields[joint].parse().unwrap();
        fields[joint] = format!("{:.9}", angle + 0.05);
    });
    folder.write("second.csv", worn);
    folder.run(&line).ok();
    // All zeros at once, as after a new mastering: a base that seems to have moved beside them is no reason to refuse.
    let mastered = changed(&simulated("test1", 60), |names, fields| {
        let zeros = [0.07, -0.12, 0.09, -0.05, 0.11, 0.06];
        for (joint, by) in (1..).zip(zeros) {
            let name = format!("q{joint}_deg");
            let at = names.iter().position(|n| **n == *name).unwrap();
            let angle: f64 = fields[at].parse().unwrap();
            fields[at] = format!("{:.9}", angle + by);
        }
    });
    folder.write("second.csv", mastered);
    folder.run(&line).ok();
    let warnings = folder.json("second.json")["warnings"].clone();
    assert_eq!(warnings.as_array().map_or(0, Vec::len), 0, "{warnings}");
}

#[test]
fn what_is_no_gauge_is_refused() {
    let _texts = texts();
    let folder = folder();
    folder.write("line.csv", "base_x_mm,base_y_mm,base_z_mm,measured_x_mm,measured_y_mm,measured_z_mm\n0,0,0,0,0,0\n1,0,0,1,0,0\n2,0,0,2,0,0\n");
    folder.write("two.csv", "base_x_mm,base_y_mm,base_z_mm,measured_x_mm,measured_y_mm,measured_z_mm\n0,0,0,0,0,0\n1,0,0,1,0,0\n");
    folder.write(
        "columns.csv",
        "base_x_mm,base_y_mm,base_z_mm,x_mm,y_mm,z_mm\n0,0,0,0,0,0\n1,0,0,1,0,0\n",
    );
    for options in [
        "--base-from line.csv",
        "--base-from two.csv",
        "--base-from columns.csv",
        "--base-from none.csv",
        "--base-from -1,2,3,1,1,0,0",
        "--base-from -1,2,3,1,0,0,0",
        "--tool-from 1,2,3",
        "--tool-from 0,0,100,1,0,0,0",
        "--references line.csv",
        "--keep-gauge none.blob",
    ] {
        folder.refuses(again(&folder, options));
    }
    folder
        .run("simulate --robot ur5 --poses 30 --test-sets 0 --out other")
        .ok();
    folder
        .run("calibrate --robot ur5 other/train.csv --method poe --accept few --out ur5.blob")
        .ok();
    folder.refuses(again(&folder, "--keep-gauge ur5.blob"));
    folder.refuses(again(&folder, "--previous ur5.blob"));
    folder.refuses("check first.blob second.csv --max-mm 1 --previous ur5.blob");
}
