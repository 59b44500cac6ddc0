//! Numbers of the documents, recomputed from the written files, in the units of their names.

use poegp_calibration::blob::predict::BlobModel;
use poegp_protocol::blob::Correction;
use serde_json::Value;

use crate::program::{Folder, SERIAL, changed, simulated};

#[track_caller]
fn near(value: &Value, expected: f64) {
    let value = value.as_f64().unwrap();
    assert!(
        (value - expected).abs() <= 1e-5 * expected,
        "{value}, expected {expected}"
    );
}

/// The correction limit is that in the blob's bytes. The loss of single precision is below the allowed 2 µm and above a
/// hundredth of that, since `f32` resolves 0.1 µm here.
#[test]
fn the_limit_of_the_correction_is_the_blobs() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe-gp-load --out arm.blob --json -"
    );
    let document = folder.run(&line).ok().json();
    let loaded = BlobModel::read(&folder.path("arm.blob")).unwrap();
    let Correction::TaskSpace(correction) = &loaded.blob().correction else {
        panic!("the method has a correction in task space");
    };
    let limit = &correction.limit;
    near(
        &document["correction_limit_mm"],
        1e3 * f64::from(limit.position_m),
    );
    near(
        &document["correction_limit_mrad"],
        1e3 * f64::from(limit.angle_rad),
    );
    for quantity in ["mean", "max"] {
        let lost = document["single_precision_loss_um"][quantity]
            .as_f64()
            .unwrap();
        assert!((0.02..2.0).contains(&lost), "{lost}");
    }
}

/// Noise stated on the command line has the same effect as noise in columns of every row.
#[test]
fn noise_on_the_command_line_is_noise_in_columns() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    let line = format!("calibrate --robot {SERIAL} train.csv --method elastic --out arm.blob");
    folder.run(&line).ok();
    let fresh = simulated("test2", 20);
    folder.write("fresh.csv", &fresh);
    let columns = changed(&fresh, |_, fields| {
        fields.push("0.06".to_owned());
        fields.push("0.1".to_owned());
    });
    let (header, rows) = columns.split_once('\n').unwrap();
    folder.write(
        "columns.csv",
        format!("{header},sigma_mm,sigma_mrad\n{rows}"),
    );
    let checked = |line: &str| {
        let mut document = folder
            .run(&format!(
                "check arm.blob {line} --max-mm 5 --max-drift-mm 5 --json -"
            ))
            .ok()
            .json();
        let members = document.as_object_mut().unwrap();
        members.retain(|key, _| !["name", "provenance"].contains(&key.as_str()));
        document
    };
    let stated = checked("fresh.csv --position-sigma-mm 0.06 --orientation-sigma-mrad 0.1");
    assert_eq!(stated, checked("columns.csv"));
    assert_ne!(stated, checked("fresh.csv"));
    // Twice the instrument's noise; the check does not assume less than what is stated, and the joints scatter besides.
    for (name, sigma) in [("noise_mm", 0.06), ("noise_mrad", 0.1)] {
        let noise = stated[name].as_f64().unwrap();
        assert!((sigma..1.1 * sigma).contains(&noise), "{name}: {noise}");
    }
}

/// "Before" in a report is the arm with base and tool fitted, as `base-tool` calibrates it; "after" is the blob.
#[test]
fn before_is_the_arm_as_it_was_drawn() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    folder.write("test.csv", simulated("test1", 30));
    let position = |document: &Value, pointer: &str| document.pointer(pointer).unwrap().clone();
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --test test.csv --out poe.blob --json -"
    );
    let document = folder.run(&line).ok().json();
    let line = format!("calibrate --robot {SERIAL} train.csv --method base-tool --out before.blob");
    folder.run(&line).ok();
    for (blob, part) in [("before.blob", "nominal"), ("poe.blob", "calibrated")] {
        let line = format!("evaluate {blob} test.csv --json -");
        let evaluated = folder.run(&line).ok().json();
        assert_eq!(
            position(&document, &format!("/held_out/{part}/position_mm")),
            position(&evaluated, "/sets/0/position_mm"),
            "{part}"
        );
    }
}
