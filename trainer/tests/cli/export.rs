//! Exports of a calibrated arm for other programs, read back by the trainer's own readers. `tests/peers/exports/run` reads them
//! with Pinocchio, yourdfpy and Python.

use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_protocol::blob;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use poegp_trainer::export::CalibratedChain;

use crate::program::{Folder, data};
use crate::texts::texts;

/// Returns a folder with `arm.blob`, calibrated from few poses. `robot` is a name or a file of `tests/data/urdf`.
pub fn calibrated(robot: &str, model: &str) -> Folder {
    Folder::prepared(format!("export {robot} {model}"), |folder| {
        if robot.ends_with(".urdf") {
            folder.write(
                robot,
                std::fs::read(data(&format!("urdf/{robot}"))).unwrap(),
            );
        }
        folder
            .run(&format!(
                "simulate --robot {robot} --poses 30 --test-sets 0 --seed 5 --out cell"
            ))
            .ok();
        folder
            .run(&format!(
                "calibrate --robot {robot} cell/train.csv --method {model} --out arm.blob"
            ))
            .ok();
    })
}

pub fn chain(folder: &Folder) -> CalibratedChain {
    CalibratedChain::of(&BlobModel::read(&folder.path("arm.blob")).unwrap())
}

/// Returns the robot of a description, whose chain ends at the flange.
fn described(folder: &Folder, file: &str, tip: Option<&str>) -> Robot {
    let options = LoadOptions {
        base: None,
        tip: tip.map(str::to_owned),
    };
    Robot::load(folder.path(file).to_str().unwrap(), &options).unwrap()
}

/// Returns the largest difference in metres and of rotation elements, over joint values of the whole range.
fn apart(a: &Poe<f64>, b: &Poe<f64>, b_end: &Pose<f64>) -> (f64, f64) {
    let mut worst = (0.0_f64, 0.0_f64);
    for k in 0..200 {
        let q: Vec<f64> = (0..a.kinds().len())
            .map(|i| 2.5 * (0.37 * f64::from(k * k) + 1.9 * i as f64).sin())
            .collect();
        let (one, other) = (a.forward(&q), b.forward(&q) * *b_end);
        worst.0 = worst.0.max((one.translation - other.translation).norm());
        worst.1 = worst.1.max((one.rotation - other.rotation).amax());
    }
    worst
}

#[track_caller]
fn same(folder: &Folder, file: &str, tip: Option<&str>, target: &Pose<f64>) {
    let robot = described(folder, file, tip);
    let (position, rotation) = apart(&chain(folder).poe(), &robot.chain().unwrap(), target);
    assert!(
        position < 1e-12 && rotation < 1e-12,
        "{file}: {position:e} m, {rotation:e}"
    );
}

#[test]
fn every_description_has_the_poses_of_the_chain() {
    let _texts = texts();
    for robot in [
        "abb-irb4400",
        "kuka-iiwa7",
        "ur5",
        "workbench.urdf",
        "no_tool0.urdf",
    ] {
        let folder = calibrated(robot, "poe");
        let nominal = if robot.ends_with(".urdf") {
            format!("--urdf {robot}")
        } else {
            String::new()
        };
        let line = format!(
            "export arm.blob {nominal} --out new.urdf --target-link probe --dh dh.toml --mdh mdh.toml --poe poe.toml"
        );
        folder.run(&line).ok().said();
        same(&folder, "new.urdf", Some("probe"), &Pose::identity());
        let flange_from_target = chain(&folder).flange_from_target;
        for table in ["dh.toml", "mdh.toml", "poe.toml"] {
            same(&folder, table, None, &flange_from_target);
        }
        if robot == "abb-irb4400" {
            let coupling = described(&folder, "dh.toml", None).coupling;
            assert_eq!(
                coupling,
                Robot::load(robot, &LoadOptions::default())
                    .unwrap()
                    .coupling
            );
            // A table has the coupling, and a URDF says that it has none.
            let says = |file: &str| folder.text(file).contains("the coupling of the joints");
            assert!(says("new.urdf") && !says("dh.toml") && !says("poe.toml"));
            let document = folder.run("export arm.blob --poe a.toml --json -").ok();
            assert_eq!(document.json()["not_carried"], serde_json::json!([]));
        }
        folder
            .run("export arm.blob --dh dh.json --poe -")
            .ok()
            .json();
        assert_eq!(folder.json("dh.json")["convention"], "dh");
    }
}

/// A blob without correction exports its own frames; its `f32` poses are within tenths of a micrometre.
#[test]
fn the_chain_is_the_devices() {
    let folder = calibrated("abb-irb120", "poe");
    let bytes = folder.read("arm.blob");
    let decoded = blob::decode(&bytes).unwrap();
    let kinds: Vec<_> = decoded.robot.joints.iter().map(|j| j.kind).collect();
    let frames: Vec<Pose<f32>> = decoded
        .geometry
        .calibrated
        .iter()
        .map(Pose::from_rows)
        .collect();
    let device = Poe::new(&kinds, &frames).unwrap();
    let exported = chain(&folder).poe();
    for k in 0..100 {
        let q: Vec<f64> = (0..6)
            .map(|i| f64::from(((0.3 * f64::from(k) + i as f64).sin()) as f32))
            .collect();
        let single: Vec<f32> = q.iter().map(|x| *x as f32).collect();
        let apart =
            device.forward(&single).cast::<f64>().translation - exported.forward(&q).translation;
        assert!(apart.norm() < 1e-6, "{:e} m", apart.norm());
    }
    for (own, exported) in frames.iter().zip(exported.frames()) {
        assert_eq!(own.cast::<f64>().translation, exported.translation);
    }
    folder
        .run("export arm.blob --poe a.toml --json a.json")
        .ok();
    assert!(folder.json("a.json").get("fit").is_none());
    assert!(!folder.text("a.toml").contains("fitted"));
}

/// The distance that a file states for its fitted chain is the distance of its frames, at joints that the fit did not use.
#[test]
fn the_chain_of_a_model_with_a_correction_is_the_nearest_one() {
    let _texts = texts();
    let folder = calibrated("abb-irb4400", "elastic");
    folder
        .run("export arm.blob --out new.urdf --dh dh.toml --poe poe.toml --json all.json")
        .ok()
        .said();
    let flange_from_target = chain(&folder).flange_from_target;
    same(&folder, "new.urdf", Some("tool0"), &flange_from_target);
    let model = BlobModel::read(&folder.path("arm.blob")).unwrap();
    let ranges = &model.blob().ranges;
    let (light, heavy) = ranges.payload_kg.unwrap();
    assert!(light < heavy);
    let document = folder.json("all.json");
    let said = |when: &str| {
        document["fit"][when]["position_mm"]["mean"]
            .as_f64()
            .unwrap()
    };
    assert!(said("after") < 0.8 * said("before"), "{document:#}");
    for table in ["dh.toml", "poe.toml"] {
        same(&folder, table, None, &flange_from_target);
        let robot = described(&folder, table, None);
        let text = format!("distance {:.3} mm on average", said("after"));
        assert!(folder.text(table).contains(&text), "{text}");
        let mut sum = 0.0;
        for k in 0..500 {
            // Steps that fill the ranges and the payloads evenly.
            let share = |i: i32| (0.5 + f64::from(k) * 0.918_f64.powi(i + 1)).fract();
            let between = |i: i32, (lower, upper): (f32, f32)| {
                f64::from(lower) + share(i) * f64::from(upper - lower)
            };
            let q: Vec<f64> = (0..)
                .zip(&ranges.joints)
                .map(|(i, r)| between(i, *r))
                .collect();
            let flange = robot.chain().unwrap().forward(&robot.serial_joints(&q));
            let target = flange * flange_from_target;
            let stands = model.instrument_from_base() * target;
            let predicted = model.predict(&q, Some(between(6, (light, heavy)))).pose;
            sum += 1e3 * (stands.translation - predicted.translation).norm() / 500.0;
        }
        let ratio = sum / said("after");
        assert!(
            (0.8..1.25).contains(&ratio),
            "{table}: {sum} mm, {document:#}"
        );
    }
    // A chain for one payload can be nearer than a chain for all of them.
    let line = format!("export arm.blob --poe - --json one.json --payload-kg {heavy}");
    folder.run(&line).ok();
    let one = folder.json("one.json");
    assert_eq!(one["fit"]["payload_kg"], serde_json::json!([heavy, heavy]));
    let mean = one["fit"]["after"]["position_mm"]["mean"].as_f64().unwrap();
    assert!(mean < said("after"), "{one:#}");
    folder.refuses("export arm.blob --poe a.toml --payload-kg 100");
}

/// Except for the corrected origins, the added elements and the comment, every line is that of the nominal file.
#[test]
fn everything_else_of_a_urdf_is_kept() {
    let folder = calibrated("workbench.urdf", "poe");
    folder
        .run("export arm.blob --urdf workbench.urdf --out new.urdf")
        .ok();
    let (nominal, new) = (folder.text("workbench.urdf"), folder.text("new.urdf"));
    let mut lines: Vec<&str> = new.lines().collect();
    let mut changed = 0;
    for line in nominal.lines() {
        match lines.iter().position(|other| *other == line) {
            Some(at) => drop(lines.remove(at)),
            None => {
                assert!(line.contains("<origin"), "{line}");
                changed += 1;
            }
        }
    }
    // Seven joints are corrected; the joint "lift" had no origin.
    assert_eq!(changed, 6);
    assert_eq!(
        lines.iter().filter(|line| line.contains("<origin")).count(),
        7
    );
    let comment = lines.iter().filter(|line| !line.contains("<origin"));
    assert_eq!(comment.count(), 8, "{lines:#?}");
    // The links stay where they were, within the errors of the arm, so that meshes fit.
    let (old, new) = (
        described(&folder, "workbench.urdf", None),
        described(&folder, "new.urdf", None),
    );
    for (a, b) in old.parent_from_joint.iter().zip(&new.parent_from_joint) {
        assert!((a.translation - b.translation).norm() < 5e-3);
    }
}

#[test]
fn what_a_chain_cannot_hold_is_said() {
    let _texts = texts();
    let folder = calibrated("ur5", "elastic");
    folder
        .run("export arm.blob --out a.urdf --poe a.toml --ur-kinematics a.yaml --c-header a.h")
        .ok()
        .said();
    for file in ["a.urdf", "a.toml", "a.yaml"] {
        assert!(
            folder.text(file).contains("the deflection under gravity"),
            "{file}"
        );
    }
    folder.refuses("export arm.blob --ur-kinematics a.json");
    let yaml = folder.text("a.yaml");
    for part in [
        "kinematics:\n  shoulder:\n    x: ",
        "  wrist_3:\n",
        "    yaw: ",
        "  hash: calib_",
    ] {
        assert!(yaml.contains(part), "{part}: {yaml}");
    }
    // The header contains the bytes of the blob.
    let header = folder.text("a.h");
    let body = header
        .split("a_blob[A_BLOB_BYTES] = {")
        .nth(1)
        .unwrap()
        .split('}')
        .next()
        .unwrap();
    let bytes: Vec<u8> = body
        .split(',')
        .filter_map(|text| u8::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok())
        .collect();
    assert_eq!(bytes, folder.read("arm.blob"));
}

#[test]
fn what_does_not_fit_is_refused() {
    let _texts = texts();
    let folder = calibrated("workbench.urdf", "poe");
    folder.write(
        "no_tool0.urdf",
        std::fs::read(data("urdf/no_tool0.urdf")).unwrap(),
    );
    let named = folder.text("workbench.urdf");
    let named = named.replace("<joint name=\"plate\"", "<joint name=\"probe_joint\"");
    folder.write("named.urdf", named);
    for line in [
        "arm.blob",
        "arm.blob --urdf workbench.urdf",
        "arm.blob --urdf no_tool0.urdf --out a.urdf",
        "arm.blob --urdf workbench.urdf --tip flange --out a.urdf",
        "arm.blob --urdf no.urdf --out a.urdf",
        "arm.blob --urdf arm.blob --out a.urdf",
        "arm.blob --urdf workbench.urdf --out workbench.urdf",
        "arm.blob --urdf workbench.urdf --out a.urdf --target-link camera",
        "arm.blob --urdf named.urdf --out a.urdf --target-link probe",
        "arm.blob --urdf workbench.urdf --out a.urdf --target-link=",
        "arm.blob --out a.urdf --target-link tool0",
        "arm.blob --out a.urdf --target-link base_link",
        "arm.blob --out a.urdf --target-link link_1",
        "arm.blob --out a.urdf --target-link=",
        "arm.blob --dh a.txt",
        "arm.blob --mdh a.txt",
        "arm.blob --joint-offsets a.csv",
        "arm.blob --poe a.xlsx",
        "arm.blob --mjcf arm.blob",
        "arm.blob --dh a.toml --payload-kg 1",
        "arm.blob --ur-kinematics a.yaml",
        "workbench.urdf --dh a.toml",
    ] {
        folder.refuses(format!("export {line}"));
    }
}
