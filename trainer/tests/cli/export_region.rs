//! The distance from the model that an export states, tested with the written files at other poses; and what it refuses.

use nalgebra::Vector3;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use serde_json::Value;

use crate::export::calibrated;
use crate::program::{Folder, data};
use crate::texts::texts;

/// Returns the model of a simulated arm with all errors for which the trainer has no formula.
fn wild() -> Folder {
    Folder::prepared("wild", |folder| {
        let rows = std::fs::read(data("simulated/irb4400_wild_s0_train.csv")).unwrap();
        folder.write("train.csv", rows);
        folder
            .run("calibrate --robot abb-irb4400-serial train.csv --method elastic --out arm.blob")
            .ok();
    })
}

fn mean_mm(document: &Value, of: &str) -> f64 {
    let mean = &document["distance"][of]["position_mm"]["mean"];
    mean.as_f64().unwrap()
}

/// Returns the mean distance in mm between a chain's target and the model's predictions at `kg`, over poses that fill
/// `ranges` evenly: the fractional parts of multiples of powers of the root of x⁷ = x + 1.
fn judged(
    folder: &Folder,
    instrument_from_target: impl Fn(&[f64]) -> Pose<f64>,
    ranges: &[(f64, f64)],
    kg: f64,
) -> f64 {
    let model = BlobModel::read(&folder.path("arm.blob")).unwrap();
    let poses = 40_000;
    let mut sum = 0.0;
    for k in 0..poses {
        let share =
            |i: i32| (0.5 + f64::from(k) * 1.112_775_684_278_705_5_f64.powi(-1 - i)).fract();
        let q: Vec<f64> = (0..)
            .zip(ranges)
            .map(|(i, (lower, upper))| lower + (upper - lower) * share(i))
            .collect();
        let predicted = model.predict(&q, Some(kg)).pose;
        sum += (instrument_from_target(&q).translation - predicted.translation).norm();
    }
    1e3 * sum / f64::from(poses)
}

fn urdf(folder: &Folder, file: &str, tip: &str) -> Poe<f64> {
    let options = LoadOptions {
        base: None,
        tip: Some(tip.to_owned()),
    };
    let robot = Robot::load(folder.path(file).to_str().unwrap(), &options).unwrap();
    robot.chain().unwrap()
}

fn trained(folder: &Folder) -> Vec<(f64, f64)> {
    let model = BlobModel::read(&folder.path("arm.blob")).unwrap();
    let ranges = model.blob().ranges.joints.iter();
    ranges
        .map(|(lower, upper)| (f64::from(*lower), f64::from(*upper)))
        .collect()
}

/// Over the ranges at 5 kg, and around a pose: the stated distance is right to a hundredth, and small.
#[test]
fn what_is_stated_of_a_chain_is_what_its_urdf_does() {
    let _texts = texts();
    let folder = wild();
    let model = BlobModel::read(&folder.path("arm.blob")).unwrap();
    let all = trained(&folder);
    let degrees = [10.0_f64, -10.0, 20.0, 30.0, 40.0, 0.0];
    let about: Vec<(f64, f64)> = degrees
        .iter()
        .zip(&all)
        .map(|(q, (lower, upper))| {
            let (near, reach) = (q.to_radians(), 15_f64.to_radians());
            ((near - reach).max(*lower), (near + reach).min(*upper))
        })
        .collect();
    for (region, ranges, largest) in [
        ("", &all, 0.35),
        (" --region 15@10,-10,20,30,40,0", &about, 0.06),
    ] {
        folder
            .run(&format!(
                "export arm.blob --out new.urdf --target-link probe --payload-kg 5 --json all.json{region}"
            ))
            .ok()
            .said();
        let document = folder.json("all.json");
        let chain = urdf(&folder, "new.urdf", "probe");
        let target = |q: &[f64]| model.instrument_from_base() * chain.forward(q);
        let (said, seen) = (
            mean_mm(&document, "chain"),
            judged(&folder, target, ranges, 5.0),
        );
        eprintln!("chain{region}: said {said} mm, seen {seen} mm");
        assert!((said / seen - 1.0).abs() < 0.01, "{region}: {said}, {seen}");
        assert!(said < largest, "{region}: {said}");
        assert!(said < 0.5 * mean_mm(&document, "nominal"), "{document:#}");
        let text = format!("distance {said:.3} mm on average");
        assert!(folder.text("new.urdf").contains(&text), "{text}");
        assert_eq!(document["distance"]["chain"]["poses"], 50_000);
        assert_eq!(
            document["distance"]["payload_kg"],
            serde_json::json!([5.0, 5.0])
        );
        // The nominal model: the nominal arm on the model's base with the model's tool.
        let nominal = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
        let nominal = nominal.chain().unwrap();
        let tool = Pose::from_rows(&model.host().gauge.flange_from_target);
        let drawn = |q: &[f64]| model.instrument_from_base() * nominal.forward(q) * tool;
        let (said, seen) = (
            mean_mm(&document, "nominal"),
            judged(&folder, drawn, ranges, 5.0),
        );
        assert!((said / seen - 1.0).abs() < 0.01, "{region}: {said}, {seen}");
    }
    // Compared with the true arm, at the noiseless poses of its test sets.
    folder
        .run("export arm.blob --out new.urdf --target-link probe --payload-kg 5")
        .ok();
    let chain = urdf(&folder, "new.urdf", "probe");
    let mut distances = Vec::new();
    for set in ["test1", "test2", "test3"] {
        let text =
            std::fs::read_to_string(data(&format!("simulated/irb4400_wild_s0_{set}.csv"))).unwrap();
        let mut rows = text.lines().filter(|line| !line.starts_with('#'));
        let names: Vec<&str> = rows.next().unwrap().split(',').collect();
        for row in rows {
            let fields: Vec<f64> = row.split(',').map(|x| x.parse().unwrap()).collect();
            let field = |name: &str| fields[names.iter().position(|n| *n == name).unwrap()];
            if field("payload_kg") == 5.0 {
                let joints = [1, 2, 3, 4, 5, 6].map(|i| field(&format!("q{i}_deg")).to_radians());
                let stands = model.instrument_from_base() * chain.forward(&joints);
                let truth = ["true_x_mm", "true_y_mm", "true_z_mm"].map(field);
                distances.push((1e3 * stands.translation - Vector3::from(truth)).norm());
            }
        }
    }
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    eprintln!("against the arm: {mean} mm at {} poses", distances.len());
    assert!(distances.len() > 50 && mean < 0.35, "{mean} mm");
}

#[test]
fn what_is_stated_of_joint_offsets_is_what_they_do() {
    let _texts = texts();
    let folder = wild();
    folder
        .run("export arm.blob --joint-offsets zeros.json --payload-kg 5 --json all.json")
        .ok()
        .said();
    let (zeros, document) = (folder.json("zeros.json"), folder.json("all.json"));
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let nominal = robot.chain().unwrap();
    let rows = zeros["joints"].as_array().unwrap();
    let offsets: Vec<f64> = rows
        .iter()
        .map(|row| row["offset_rad"].as_f64().unwrap())
        .collect();
    assert_eq!((offsets.len(), offsets[0], offsets[5]), (6, 0.0, 0.0));
    assert!(offsets[1..5].iter().all(|o| *o != 0.0 && o.abs() < 0.01));
    let pose = |key: &str| -> Pose<f64> {
        let three = |part: &str| [0, 1, 2].map(|i| zeros[key][part][i].as_f64().unwrap());
        let turn = |i: usize| {
            let mut twist = [0.0; 6];
            twist[3 + i] = three("rpy_rad")[i];
            Pose::exp(&Twist::from_array(&twist))
        };
        Pose {
            translation: three("xyz_m").into(),
            rotation: (turn(2) * turn(1) * turn(0)).rotation,
        }
    };
    let (base, tool) = (pose("instrument_from_base"), pose("flange_from_target"));
    let stands = |q: &[f64]| {
        let moved: Vec<f64> = q.iter().zip(&offsets).map(|(q, o)| q + o).collect();
        base * nominal.forward(&moved) * tool
    };
    let said = mean_mm(&document, "joint_offsets");
    let seen = judged(&folder, stands, &trained(&folder), 5.0);
    eprintln!("offsets: said {said} mm, seen {seen} mm");
    assert!((said / seen - 1.0).abs() < 0.01, "{said}, {seen}");
    for other in ["base_and_tool", "nominal"] {
        let means = ["chain", "joint_offsets", other].map(|of| mean_mm(&document, of));
        assert!(means[0] < means[1] && means[1] < means[2], "{document:#}");
    }
    folder
        .run("export arm.blob --joint-offsets zeros.toml --payload-kg 5")
        .ok();
    let text = folder.text("zeros.toml");
    for part in [
        format!("# distance {said:.3} mm on average"),
        "q + offset".to_owned(),
        "offset_rad = ".to_owned(),
        "base_from_nominal = ".to_owned(),
    ] {
        assert!(text.contains(&part), "{part}: {text}");
    }
    assert!(toml::from_str::<toml::Table>(&text).is_ok());
}

/// The poses of a file with its payloads are a region, and so are their neighbourhoods.
#[test]
fn the_poses_of_a_file_are_a_region() {
    let _texts = texts();
    let folder = calibrated("abb-irb4400", "elastic");
    let rows = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,payload_kg\n\
                # picks\n10,0,5,10,20,0,2.5\n-10,5,0,0,30,10,5\n";
    folder.write("picks.csv", rows);
    let mean = |options: &str| {
        let line = format!("export arm.blob --poe a.toml --json a.json {options}");
        folder.run(&line).ok().said();
        let document = folder.json("a.json");
        let payload = document["distance"]["payload_kg"].clone();
        (mean_mm(&document, "chain"), payload)
    };
    let (_, payload) = mean("--region picks.csv");
    assert_eq!(payload, serde_json::json!([2.5, 5.0]));
    let text = "joints within 2° of one of 2 poses, payload 2.5 to 5 kg";
    assert!(folder.text("a.toml").contains(text));
    let (further, payload) = mean("--region 10@picks.csv --payload-kg 5");
    assert_eq!(payload, serde_json::json!([5.0, 5.0]));
    let (near, _) = mean("--region picks.csv --payload-kg 5");
    let (everywhere, _) = mean("--payload-kg 5");
    assert!(
        near < further && further < everywhere,
        "{near}, {further}, {everywhere}"
    );
    // Ranges that the training limits are named; a reach beyond all ranges is none.
    let text =
        "joints within 20° of 50° 0° 5° 10° 20° 0°, limited to the trained ranges (joint 1 to ";
    mean("--region 20@50,0,5,10,20,0 --payload-kg 5");
    assert!(folder.text("a.toml").contains(text));
    mean("--region 1e9@50,0,5,10,20,0 --payload-kg 5");
    assert!(
        folder
            .text("a.toml")
            .contains("over the trained joint ranges, payload 5 kg")
    );
    folder.write("far.csv", rows.replace("picks\n10,", "picks\n150,"));
    folder.write("heavy.csv", rows.replace("30,10,5", "30,10,50"));
    folder.write("empty.csv", rows.lines().next().unwrap());
    folder.write("five.csv", rows.replace(",q6_deg", ",speed"));
    for region in [
        "far.csv",
        "heavy.csv",
        "empty.csv",
        "five.csv",
        "missing.csv",
        "0@picks.csv",
        "-3@picks.csv",
        "15@1,2,3",
        "15@150,0,5,10,20,0",
        "200@60,0,5,10,20,0",
        "15@1e300,0,5,10,20,0",
        "-1e300@picks.csv",
        "1e-300@picks.csv",
        "10,0,5,10,20,0",
        "15@",
    ] {
        folder.refuses(format!("export arm.blob --poe b.toml --region {region}"));
    }
    folder.refuses("export arm.blob --poe picks.csv --region picks.csv");
}

/// A model that only moves base and tool has the chain of the nominal model, so no export could be nearer, and none is
/// written.
#[test]
fn what_is_no_nearer_than_the_nominal_model_is_not_written() {
    let _texts = texts();
    let folder = calibrated("ur5", "base-tool");
    let before = folder.names();
    for output in [
        "--out a.urdf",
        "--mjcf a.xml",
        "--ur-kinematics a.yaml",
        "--dh a.toml",
        "--mdh a.toml",
        "--poe a.toml",
        "--joint-offsets a.toml",
        "--poe a.toml --c-header a.h",
    ] {
        let outcome = folder.run(&format!("export arm.blob {output} --json a.json"));
        assert_eq!(outcome.code, Some(1), "{outcome:#?}");
        assert_eq!(outcome.stdout, "");
        outcome.said();
        assert_eq!(folder.names(), before, "{output}");
    }
    // The C header is written, because it has the whole model.
    folder.run("export arm.blob --c-header a.h").ok();
}
