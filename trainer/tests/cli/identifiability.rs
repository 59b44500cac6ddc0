//! What `calibrate` says about the poses of its input.

use poegp_calibration::robot::{LoadOptions, Robot};

use crate::program::{Folder, SERIAL, changed, simulated};
use crate::texts::texts;

/// Returns `csv` with joint 3 at 10° in every row, and the poses of the nominal arm, rounded to 0.1 mm.
fn with_joint_3_still(csv: &str) -> String {
    let robot = Robot::load(SERIAL, &LoadOptions::default()).unwrap();
    let chain = robot.chain().unwrap();
    changed(csv, |names, fields| {
        let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
        fields[column("q3_deg")] = "10".to_owned();
        let joint = |i: usize| -> f64 { fields[column(&format!("q{i}_deg"))].parse().unwrap() };
        let joints: Vec<f64> = (1..=6).map(|i| joint(i).to_radians()).collect();
        let pose = chain.forward(&joints);
        let (w, v) = pose.quaternion();
        for (name, value) in ["x_mm", "y_mm", "z_mm"].iter().zip(pose.translation.iter()) {
            fields[column(name)] = format!("{:.1}", 1e3 * value);
        }
        for (name, value) in ["qw", "qx", "qy", "qz"].iter().zip([w, v[0], v[1], v[2]]) {
            fields[column(name)] = format!("{value:.5}");
        }
    })
}

#[test]
fn random_poses_and_a_joint_that_never_moves() {
    let _texts = texts();
    let folder = Folder::new();
    let csv = simulated("train", 40);
    folder.write("all.csv", &csv);
    folder.write("still.csv", with_joint_3_still(&csv));
    for model in ["base-tool", "poe", "elastic"] {
        let line = format!(
            "calibrate --robot {SERIAL} all.csv --method {model} --accept gain --out arm.blob --json arm.json"
        );
        folder.run(&line).ok().said();
        let (parameters, rank) = if model == "base-tool" {
            (12, 12)
        } else {
            (42, 30)
        };
        let told = &folder.json("arm.json")["identifiability"];
        assert_eq!(told["parameters"], parameters, "{model}");
        assert_eq!(told["rank"], rank, "{model}");
        assert_eq!(told["unidentified"], 0, "{model}");
        assert!(told["condition"].as_f64().unwrap() > 1.0);
        assert!(told["expected"]["rms_mm"].as_f64().unwrap() > 0.0);
    }
    let line = format!(
        "calibrate --robot {SERIAL} still.csv --method poe --accept gain --out arm.blob --json -"
    );
    let out = folder.run(&line).ok().said();
    let told = &out.json()["identifiability"];
    assert_eq!(told["rank"], 26);
    assert_eq!(told["unidentified"], 4);
    let text = told["findings"][0]["text"].as_str().unwrap();
    assert!(text.starts_with("joint 3 never moves"), "{text}");
}
