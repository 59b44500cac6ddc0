//! Touch files: simulated, planned and imported ones, and what is refused.

use std::path::Path;

use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::robot::{LoadOptions, Robot};

use crate::program::{Folder, changed};
use crate::texts::texts;

/// Reads a touch file as every command does, with NAME.toml beside NAME.csv.
fn touches(folder: &Folder, name: &str, robot: &str) -> TouchSet {
    let robot = Robot::load(robot, &LoadOptions::default()).unwrap();
    let read = TouchSet::read(Path::new(&folder.path(name)), None, &robot);
    read.unwrap_or_else(|error| panic!("{error}"))
}

/// A simulated file has every kind of touch, and comes with the truth for scoring.
#[test]
fn simulated_touches_are_a_touch_file() {
    let _texts = texts();
    let folder = Folder::new();
    let kinds = "socket2,plane1,sphere1,ballbar1,wire2,level1,camera1";
    let line = format!("simulate --robot ur10 --touch {kinds} --touches 16 --seed 5 --out t");
    folder.run(&line).ok().said();
    let set = touches(&folder, "t/touches.csv", "ur10");
    assert_eq!(set.features.len(), 9);
    assert!(set.notes.is_empty(), "{:?}", set.notes);
    let truth = folder.text("t/truth.csv");
    assert_eq!(truth.lines().count(), 302);
    // The same seed gives the same files.
    folder.run(&line.replace("--out t", "--out u")).ok();
    assert_eq!(folder.text("t/touches.csv"), folder.text("u/touches.csv"));
    folder
        .run("simulate --robot ur10 --touch hole2 --out v")
        .refused();
    folder
        .run("simulate --robot ur10 --touch socket2 --poses 30 --out v")
        .refused();
}

/// The rows of a plan are touches of its features, and their expected error is smaller than that of random ones.
#[test]
fn planned_touches_are_a_touch_file() {
    let _texts = texts();
    let folder = Folder::new();
    let goals = "--touch socket=600,100,500 --touch socket=400,-300,500 --touch plane=600,0,400";
    let line = format!(
        "plan --robot ur10 {goals} --count 15 --out touches.csv --features-out touches.toml --json plan.json"
    );
    folder.run(&line).ok().said();
    let set = touches(&folder, "touches.csv", "ur10");
    assert_eq!((set.rows.len(), set.features.len()), (15, 3));
    let plan = folder.json("plan.json");
    let mm = |key: &str| plan[key].as_f64().unwrap();
    assert!(
        mm("expected_mm") < mm("random_mm") && mm("random_mm") < mm("nominal_mm"),
        "{plan}"
    );
    // What a plan does not ask for is not simulated from one.
    let ball = folder
        .text("touches.toml")
        .replacen("\"plane\"", "\"sphere\"\nradius_mm = 50", 1);
    folder.write("touches.toml", &ball);
    folder
        .run("simulate --robot ur10 --touch-plan touches.csv --out t")
        .refused();
    let sockets =
        "plan --robot ur10 --touch socket=600,100,500 --touch socket=400,-300,500 --count 12";
    folder
        .run(&format!("{sockets} --out s.csv --features-out s.toml"))
        .ok();
    folder
        .run("simulate --robot ur10 --touch-plan s.csv --out t")
        .ok();
    let touched = touches(&folder, "t/touches.csv", "ur10");
    let planned = touches(&folder, "s.csv", "ur10");
    assert_eq!(touched.rows.len(), 12);
    for (touched, planned) in touched.rows.iter().zip(&planned.rows) {
        let pairs = touched.joints.iter().zip(&planned.joints);
        let largest = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(largest < 0.1, "{largest} rad from the plan");
    }
    let plan = |rest: &str| folder.run(&format!("plan --robot ur10 --out p.csv {rest}"));
    plan("--touch socket=600,100").refused();
    plan("--touch socket=6000,100,500").refused();
    plan("--touch socket=600,100,500 --count 2").refused();
    plan("--touch socket=600,100,500 --payloads 1").refused();
    plan("--touch socket=600,100,500 --gravity 0,0,9.81").refused();
}

/// Imports folders as MUKCa writes them: a placement with two holes, and a folder of placements.
#[test]
fn folders_of_sockets_are_imported() {
    let _texts = texts();
    let folder = Folder::new();
    // A ball driven by hand to two sockets of two placements: joints in radians, as numpy saves them.
    let simulated = "simulate --robot ur10 --touch socket2 --touches 12 --seed 5 --out t";
    folder.run(simulated).ok();
    let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
    let set = TouchSet::read(&folder.path("t/touches.csv"), None, &robot).unwrap();
    for place in ["front", "left"] {
        std::fs::create_dir_all(folder.path(&format!("arm/{place}"))).unwrap();
        for hole in 0..2 {
            let rows = set
                .rows
                .iter()
                .filter(|row| row.reading.feature() == Some(hole));
            let text: String = rows
                .map(|row| {
                    let fields: Vec<String> =
                        row.joints.iter().map(|q| format!("{q:.18e}")).collect();
                    format!("{}\n", fields.join(","))
                })
                .collect();
            folder.write(&format!("arm/{place}/hole_{hole}.csv"), text);
        }
    }
    folder
        .run("import arm --preset mukca --distance 50.1 --out all.csv")
        .ok()
        .said();
    let toml = folder.text("all.toml");
    assert_eq!(toml.matches("mm = 50.1\n").count(), 2, "{toml}");
    assert!(
        toml.contains("between = [\"front/0\", \"front/1\"]"),
        "{toml}"
    );
    folder.run("import arm/front --out one.csv").ok().said();
    let one = touches(&folder, "one.csv", "ur10");
    let names: Vec<&str> = one.features.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["front/0", "front/1"]);
    for (row, before) in one.rows.iter().zip(&set.rows) {
        for (q, known) in row.joints.iter().zip(&before.joints) {
            assert!(
                (q - known).abs() < 1e-15,
                "the joints must have the digits of the file"
            );
        }
    }
    // A folder's name may begin as a comment does.
    let from = folder.path("arm/front");
    std::fs::rename(&from, folder.path("arm/#1")).unwrap();
    folder.run("import arm/#1 --out hash.csv").ok();
    let hash = touches(&folder, "hash.csv", "ur10");
    assert_eq!(hash.rows.len(), one.rows.len());
    assert_eq!(hash.features[0].name, "#1/0");
    std::fs::rename(folder.path("arm/#1"), from).unwrap();
    let import = |what: &str| folder.run(&format!("import {what} --out x.csv"));
    import("t --preset mukca").refused();
    import("arm --preset mukca --distance 0.05").refused();
    import("t/touches.csv --preset kuka --distance 50").refused();
    folder.write("arm/left/hole_1.csv", "1,2,3,4,5,6\n1,2,x,4,5,6\n");
    import("arm --preset mukca").refused();
    folder.write("arm/left/hole_1.csv", "1,2,3,4,5,60\n");
    import("arm --preset mukca").refused();
    folder.write("arm/left/hole_1.csv", "1,2,3,4,5\n");
    import("arm --preset mukca").refused();
    assert!(!folder.names().contains(&"x.csv".to_owned()));
}

/// A bad touch file or features file is refused with file, line and column, and nothing is written.
#[test]
fn touch_files_are_refused_with_their_place() {
    let _texts = texts();
    let folder = Folder::new();
    folder
        .run("simulate --robot ur10 --touch socket2 --touches 12 --seed 5 --out t")
        .ok();
    let (csv, toml) = (folder.text("t/touches.csv"), folder.text("t/touches.toml"));
    let refused = |csv: &str, toml: &str| {
        folder.write("bad.csv", csv);
        folder.write("bad.toml", toml);
        folder.refuses("simulate --robot ur10 --touch-plan bad.csv --out out");
    };
    let second = csv.lines().nth(3).unwrap();
    refused(
        &csv.replace(second, &second.replace("socket/0", "hole")),
        &toml,
    );
    refused(&csv, &toml.replacen("\"point\"", "\"cone\"", 1));
    refused(&csv, &toml.replacen("\nmm = ", "\nmm = 1", 1));
    refused(&csv, &toml.replacen("touch_mm", "touch", 1));
    refused(&csv.replace("socket/0", "socket/1"), &toml);
    folder.write("alone.csv", &csv);
    folder.refuses("simulate --robot ur10 --touch-plan alone.csv --out out");
}

/// `calibrate` refuses bad touches with exit code 2, file, line and column. Touches that do not determine the arm are refused
/// with exit code 3. Neither writes a model.
#[test]
fn touches_are_refused_before_a_model_is_written() {
    let _texts = texts();
    let folder = Folder::new();
    let calibrate = "calibrate --robot abb-irb120 --out model.blob";
    folder
        .run("simulate --robot abb-irb120 --touch socket2 --touches 12 --seed 1 --out t")
        .ok();
    let (csv, toml) = (folder.text("t/touches.csv"), folder.text("t/touches.toml"));
    let second = csv.lines().nth(3).unwrap();
    folder.write(
        "bad.csv",
        csv.replace(second, &second.replace("socket/0", "hole")),
    );
    folder.refuses(format!("{calibrate} bad.csv --features t/touches.toml"));
    // A distance that is 8 mm wrong: only the calibrated arm can detect it, not the nominal arm.
    let stated = toml.lines().find(|line| line.starts_with("mm = ")).unwrap();
    let length: f64 = stated.strip_prefix("mm = ").unwrap().parse().unwrap();
    folder.write(
        "bad.toml",
        toml.replace(stated, &format!("mm = {}", length + 8.0)),
    );
    folder.refuses(format!("{calibrate} t/touches.csv --features bad.toml"));
    folder
        .run("simulate --robot abb-irb120 --touch plane1 --touches 8 --seed 1 --out few")
        .ok();
    folder.refuses_data(format!("{calibrate} few/touches.csv"));
    // A wire that reads 1 % too much, and one with a wrong zero: the touches fit an impossible arm.
    folder
        .run("simulate --robot ur10 --touch wire1 --touches 60 --seed 1 --out wire")
        .ok();
    let wire = folder.text("wire/touches.csv");
    folder.write("wrong.toml", folder.text("wire/touches.toml"));
    for (scale, zero) in [(1.01, 0.0), (1.0, 40.0)] {
        // The header follows a comment.
        let csv = changed(wire.split_once('\n').unwrap().1, |names, fields| {
            let at = names.iter().position(|name| *name == "value_mm").unwrap();
            let value: f64 = fields[at].parse().unwrap();
            fields[at] = (scale * value + zero).to_string();
        });
        folder.write("wrong.csv", csv);
        folder.refuses_data("calibrate --robot ur10 wrong.csv --out wrong.blob");
    }
    folder.run(&format!("{calibrate} t/touches.csv")).ok();
    assert!(folder.names().contains(&"model.blob".to_owned()));
}
