//! Sessions, several targets, and positions alone: the tool frames that a file needs.

use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, SimulatedPose, Simulator, to_csv};
use poegp_runtime::math::se3::{Pose, Twist};
use serde_json::{Value, json};

use crate::program::{Folder, SERIAL, without};
use crate::texts::texts;

const ORIENTATION: [&str; 4] = ["qw", "qx", "qy", "qz"];

/// Measures `train` and `test` poses of a small cell.
fn measured(train: usize, test: usize) -> (Robot, Vec<SimulatedPose>, Vec<SimulatedPose>) {
    let robot = Robot::load(SERIAL, &LoadOptions::default()).unwrap();
    let mut simulator = Simulator::new(&robot, Scenario::Paper, &[1.0, 3.0, 6.0], 5);
    let train = simulator.measure(train);
    let test = simulator.measure(test);
    (robot, train, test)
}

/// Returns the pose of tool `i` relative to the first: decimetres away, with a large rotation.
fn tool(i: usize) -> Pose<f64> {
    let i = i as f64;
    Pose::exp(&Twist::from_array(&[
        0.04 * i,
        -0.07 * i,
        0.05 * i,
        0.3 * i,
        -0.2 * i,
        0.4 * i,
    ]))
}

/// Returns a file whose row `i` has tool `of(i)`, named by `names` in column `column`.
fn with_tools(
    robot: &Robot,
    poses: &[SimulatedPose],
    column: &str,
    names: &[&str],
    of: impl Fn(usize) -> usize,
) -> String {
    let moved: Vec<SimulatedPose> = poses
        .iter()
        .enumerate()
        .map(|(i, pose)| SimulatedPose {
            measured: pose.measured * tool(of(i)),
            truth: pose.truth * tool(of(i)),
            ..pose.clone()
        })
        .collect();
    let csv = to_csv(robot, &moved, false, "tools");
    let mut lines = csv.lines();
    let mut out = format!(
        "{}\n{},{column}\n",
        lines.next().unwrap(),
        lines.next().unwrap()
    );
    for (i, line) in lines.enumerate() {
        out += &format!("{line},{}\n", names[of(i)]);
    }
    out
}

/// Returns positions of a `to_csv` text, without its comment.
fn positions(csv: &str) -> String {
    without(csv.split_once('\n').unwrap().1, &ORIENTATION)
}

fn position(set: &Value) -> f64 {
    set["position_mm"]["mean"].as_f64().unwrap()
}

/// Evaluates a file and returns the only set of the document.
#[track_caller]
fn evaluated(folder: &Folder, file: &str, flags: &str) -> Value {
    let line = format!("evaluate arm.blob {file} {flags} --json -");
    folder.run(&line).ok().json()["sets"][0].clone()
}

#[test]
fn positions_alone() {
    let folder = Folder::new();
    let (robot, train, test) = measured(80, 40);
    for (name, poses) in [("train.csv", &train), ("test.csv", &test)] {
        folder.write(name, positions(&to_csv(&robot, poses, false, "")));
    }
    let mut errors = Vec::new();
    for model in ["base-tool", "poe", "elastic"] {
        let line = format!(
            "calibrate --robot {SERIAL} train.csv --method {model} --out arm.blob --json -"
        );
        let document = folder.run(&line).ok().json();
        assert!(
            document["training"].get("orientation_mrad").is_none(),
            "{model}"
        );
        let set = evaluated(&folder, "test.csv", "--predictions out.csv");
        assert!(set.get("orientation_mrad").is_none(), "{model}: {set}");
        assert_eq!(set["poses"], 40);
        assert_eq!(folder.text("out.csv").lines().count(), 41);
        errors.push(position(&set));
    }
    println!("positions alone: base-tool, poe, elastic {errors:.4?} mm");
    assert!(
        errors[1] < 0.6 * errors[0] && errors[2] < 0.5 * errors[1],
        "{errors:?}"
    );
    let line = format!("compare --robot {SERIAL} train.csv --methods base-tool --folds 2 --json -");
    let document = folder.run(&line).ok().json();
    let all = &document["methods"][0]["cross_validation"];
    assert!(position(all) > 0.0 && all.get("orientation_mrad").is_none());
}

/// Positions do not show the target's orientation, so that no file states one, and the user need not know it.
#[test]
fn positions_do_not_show_an_orientation() {
    let folder = Folder::new();
    let (robot, train, test) = measured(60, 20);
    for (name, poses) in [("train.csv", &train), ("test.csv", &test)] {
        folder.write(name, positions(&to_csv(&robot, poses, false, "")));
    }
    let calibrate = |flags: &str| {
        let line = format!(
            "calibrate --robot {SERIAL} train.csv --method poe --out arm.blob --json - {flags}"
        );
        folder.run(&line).ok().json()["gauge"].clone()
    };
    let gauge = calibrate("");
    assert_eq!(
        (&gauge["base"], &gauge["tool"]),
        (&json!("grid"), &json!("positions"))
    );
    let said = folder.run("inspect arm.blob").ok().stdout;
    assert!(
        said.contains("positions alone, which do not show its orientation"),
        "{said}"
    );
    let written = |flags: &str| {
        evaluated(
            &folder,
            "test.csv",
            &format!("--predictions out.csv {flags}"),
        );
        let text = folder.text("out.csv");
        text.lines().skip(1).all(|line| line.contains(",,,,,"))
    };
    assert!(written(""));
    let said = folder.run("export arm.blob --mjcf arm.xml").ok().stdout;
    let text = "the orientation of the target is not known";
    assert!(
        said.contains(text) && folder.text("arm.xml").contains(text),
        "{said}"
    );
    // A stated orientation is that of the drawing; positions cannot contradict it, and they cannot confirm it.
    let blob = BlobModel::read(&folder.path("arm.blob")).unwrap();
    let found = Pose::from_rows(&blob.host().gauge.flange_from_target).translation * 1e3;
    let stated = format!(
        "{},{},{},0.5,0.5,0.5,0.5",
        found[0],
        found[1],
        found[2] + 1.0
    );
    let gauge = calibrate(&format!("--tool-from {stated}"));
    assert_eq!(gauge["tool"], "stated");
    folder
        .run("correct arm.blob test.csv --out c.csv --json c.json")
        .ok();
    // The nominal arm and the model have the same orientation of the target, whatever was stated.
    let shift = folder.json("c.json")["shift_mrad"]["max"].as_f64().unwrap();
    assert!(shift < 20.0, "{shift}");
}

#[test]
fn several_targets_on_one_tool() {
    let folder = Folder::new();
    let (robot, train, test) = measured(90, 45);
    let file = |poses: &[SimulatedPose]| {
        let csv = with_tools(&robot, poses, "target", &["left", "right", "top"], |i| {
            i % 3
        });
        positions(&csv)
    };
    folder.write("train.csv", file(&train));
    folder.write("test.csv", file(&test));
    let line = format!("calibrate --robot {SERIAL} train.csv --out arm.blob");
    folder.run(&line).ok();
    let set = evaluated(&folder, "test.csv", "");
    println!("three targets, positions alone: {:.4} mm", position(&set));
    assert!(position(&set) < 0.15, "{set}");
    assert!(set.get("orientation_mrad").is_none());
}

/// `inspect` shows the tool of each session, and an export says whose target it has.
fn the_blobs_tools_are_shown(folder: &Folder) {
    let document = folder.run("inspect arm.blob --json -").ok().json();
    let pose = |of: &Value| -> Pose<f64> {
        let rows: Vec<f64> = serde_json::from_value(of["flange_from_target"].clone()).unwrap();
        Pose::from_rows(&rows.try_into().unwrap())
    };
    let tools = document["tools"].as_array().unwrap();
    let names: Vec<&Value> = tools.iter().map(|tool| &tool["session"]).collect();
    assert_eq!(names, ["monday", "tuesday"]);
    let apart = |a: &Pose<f64>, b: &Pose<f64>| (a.inverse() * *b).log().to_array();
    assert!(
        apart(&pose(&document), &pose(&tools[0]))
            .iter()
            .all(|x| x.abs() < 1e-9)
    );
    let missed = apart(&(pose(&tools[0]) * tool(1)), &pose(&tools[1]));
    assert!(missed.iter().all(|x| x.abs() < 3e-4), "{missed:?}");
    let text = folder.run("inspect arm.blob").ok().stdout;
    assert!(
        text.contains("flange_from_target of session \"tuesday\": "),
        "{text}"
    );
    folder
        .run("export arm.blob --dh dh.toml --joint-offsets zeros.toml --out a.urdf")
        .ok();
    let said = "the target is that of the first tool; not that of session \"tuesday\"";
    for file in ["dh.toml", "zeros.toml", "a.urdf"] {
        assert!(folder.text(file).contains(said), "{file}");
    }
}

/// A calibration of two sessions, and a third session that the blob does not contain.
#[test]
fn sessions() {
    let _texts = texts();
    const ROWS: u64 = 8;
    let folder = Folder::new();
    let (robot, train, test) = measured(100, 60);
    let names = ["monday", "tuesday", "friday"];
    let file = |poses: &[SimulatedPose], of: &dyn Fn(usize) -> usize| {
        with_tools(&robot, poses, "session", &names, of)
    };
    folder.write("train.csv", file(&train, &|i| usize::from(i >= 50)));
    for (i, name) in names.iter().enumerate() {
        folder.write(name, file(&test, &|_| i));
    }
    let line = format!("calibrate --robot {SERIAL} train.csv --out arm.blob");
    folder.run(&line).ok();
    the_blobs_tools_are_shown(&folder);
    for known in ["monday", "tuesday"] {
        let set = evaluated(&folder, known, "");
        println!("session {known}: {:.4} mm", position(&set));
        assert_eq!(set["poses"], 60);
        assert!(position(&set) < 0.15, "{set}");
        assert!(
            set["orientation_mrad"]["mean"].as_f64().unwrap() < 0.3,
            "{set}"
        );
        // A session that the blob contains is not fitted again.
        let again = evaluated(&folder, known, &format!("--fit-tool {ROWS}"));
        assert_eq!(again, set);
    }
    folder.refuses("evaluate arm.blob friday --json -");
    let flags = format!("--fit-tool {ROWS} --predictions out.csv");
    let set = evaluated(&folder, "friday", &flags);
    println!(
        "session friday, its tool from {ROWS} rows: {:.4} mm",
        position(&set)
    );
    assert_eq!(set["poses"], 60 - ROWS);
    assert!(position(&set) < 0.2, "{set}");
    assert!(
        set["orientation_mrad"]["mean"].as_f64().unwrap() < 0.4,
        "{set}"
    );
    // Every row is predicted, including those that the tool was fitted to.
    assert_eq!(folder.text("out.csv").lines().count(), 61);
    for rows in ["60", "1000"] {
        let line = format!("evaluate arm.blob friday --fit-tool {rows} --json -");
        folder.refuses(line);
    }
    folder.refuses("evaluate arm.blob friday --fit-tool 0 --json -");
}

/// A remounted tool without a new session name gives large errors unless `--fit-tool` is used; the file cannot show the cause.
#[test]
fn a_tool_that_was_changed() {
    let folder = Folder::new();
    let (robot, train, test) = measured(60, 40);
    let moved: Vec<SimulatedPose> = test
        .into_iter()
        .map(|pose| SimulatedPose {
            measured: pose.measured * tool(1),
            ..pose
        })
        .collect();
    folder.write("train.csv", to_csv(&robot, &train, false, ""));
    folder.write("test.csv", to_csv(&robot, &moved, false, ""));
    let line = format!("calibrate --robot {SERIAL} train.csv --out arm.blob");
    folder.run(&line).ok();
    let without = evaluated(&folder, "test.csv", "");
    let with = evaluated(&folder, "test.csv", "--fit-tool 10");
    println!(
        "a changed tool: {:.1} mm, fitted to ten rows {:.4} mm",
        position(&without),
        position(&with)
    );
    assert_eq!(
        (&without["poses"], &with["poses"]),
        (&40.into(), &30.into())
    );
    assert!(position(&without) > 50.0 && position(&with) < 0.25);
}

#[test]
fn too_few_rows() {
    let _texts = texts();
    let folder = Folder::new();
    let (robot, train, _) = measured(12, 1);
    let calibrate = |csv: String| {
        folder.write("few.csv", csv);
        folder.refuses(format!(
            "calibrate --robot {SERIAL} few.csv --method elastic --out new.blob"
        ));
    };
    calibrate(to_csv(&robot, &train[..5], false, ""));
    // Positions give three equations for each pose in place of six.
    calibrate(positions(&to_csv(&robot, &train[..11], false, "")));
}
