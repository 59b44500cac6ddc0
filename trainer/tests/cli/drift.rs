//! `--correct-drift`: a drifting instrument, measured by reference points.

use std::fmt::Write as _;

use crate::program::{Folder, SERIAL, changed, simulated};
use crate::texts::texts;

/// Returns the set as an instrument would measure it that drifts by `creep_mm` along x, with two reference points. The
/// first point is missed once, and the second is wrong once.
fn drifted(set: &str, poses: usize, creep_mm: f64) -> String {
    crept(set, poses, [creep_mm; 2])
}

/// Same as [`drifted`], with the poses and the reference points drifting by different amounts.
fn crept(set: &str, poses: usize, [creep_mm, of_references_mm]: [f64; 2]) -> String {
    let csv = simulated(set, poses);
    let mut k = 0;
    let moved = changed(&csv, |names, fields| {
        let x = names.iter().position(|n| *n == "x_mm").unwrap();
        let value: f64 = fields[x].parse().unwrap();
        fields[x] = format!("{:.6}", value + creep_mm * k as f64 / poses as f64);
        k += 1;
    });
    let mut out = String::new();
    let mut row = None;
    for line in moved.lines() {
        let _ = match (line.starts_with('#'), row) {
            (true, _) => writeln!(out, "{line}"),
            (_, None) => {
                row = Some(0);
                writeln!(
                    out,
                    "{line},ref1_x_mm,ref1_y_mm,ref1_z_mm,ref2_x_mm,ref2_y_mm,ref2_z_mm"
                )
            }
            (_, Some(k)) => {
                row = Some(k + 1);
                let creep = of_references_mm * f64::from(k) / poses as f64;
                let first = if k == 3 { 0.0 } else { 1.0 };
                let mistaken = if k == 7 { 2.0 } else { 0.0 };
                let noise = 1e-3 * f64::from(k * 7 % 5 - 2);
                let (a, b) = (900.0 + creep + noise, 1500.0 + creep - noise + mistaken);
                writeln!(
                    out,
                    "{line},{},{},{},{b},300,{noise}",
                    first * a,
                    first * noise,
                    first * 20.0
                )
            }
        };
    }
    out
}

#[test]
fn compared_without_and_with() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", drifted("train", 60, 2.0));
    folder.write("test.csv", drifted("test1", 20, 0.5));
    let line = format!(
        "compare --robot {SERIAL} train.csv --test test.csv --methods poe --weighting noise --folds 4 --correct-drift --json out.json"
    );
    folder.run(&line).ok().said();
    let document = folder.json("out.json");
    assert_eq!(document["drift"]["motion"], "translation");
    assert_eq!(document["drift"]["points"], 2);
    let error = |models: &str| {
        let model = &document[models][0];
        assert_eq!(model["method"], "poe");
        model["cross_validation"]["position_mm"]["mean"]
            .as_f64()
            .unwrap()
    };
    let (with, without) = (error("methods"), error("methods_without_correction"));
    assert!(with < 0.9 * without, "{without} → {with}");
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --correct-drift --out arm.blob --json -"
    );
    let document = folder.run(&line).ok().json();
    let creep = document["drift"]["max_um"][0].as_f64().unwrap();
    assert!((900.0..1100.0).contains(&creep), "{creep}");
}

/// A stand of reference points that was knocked shows a motion that the poses contradict: no advice to remove it, and a warning
/// of one who does.
#[test]
fn reference_points_that_moved_are_no_drift_of_the_instrument() {
    let folder = Folder::new();
    folder.write("train.csv", crept("train", 60, [0.0, 1.0]));
    let line =
        format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob --json arm.json");
    let outcome = folder.run(&line).ok();
    assert!(
        outcome.stderr.contains("do not use --correct-drift"),
        "{outcome:#?}"
    );
    let steps = folder.json("arm.json")["next_steps"].to_string();
    assert!(!steps.contains("--correct-drift"), "{steps}");
    let outcome = folder.run(&format!("{line} --correct-drift"));
    let said = "the reference points moved, not the instrument";
    assert!(outcome.stderr.contains(said), "{outcome:#?}");
    // Nothing of this is said where the instrument moved.
    folder.write("train.csv", drifted("train", 60, 1.0));
    let outcome = folder.run(&line);
    assert!(
        outcome.stderr.contains("--correct-drift removes this"),
        "{outcome:#?}"
    );
    let outcome = folder.run(&format!("{line} --correct-drift"));
    assert!(!outcome.stderr.contains(said), "{outcome:#?}");
}

/// Where reference points show that the instrument moved, the advice is to remove that, not to warm the arm up; the note and
/// the advice state the same motion.
#[test]
fn the_instruments_drift_is_no_warm_up_of_the_arm() {
    let folder = Folder::new();
    folder.write("train.csv", drifted("train", 60, 0.5));
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method elastic --out arm.blob --report arm.html --json out.json"
    );
    let outcome = folder.run(&line).ok();
    let moved = |text: &str| -> f64 {
        let after = text.split("the instrument moved by up to ").nth(1).unwrap();
        after.split(' ').next().unwrap().parse().unwrap()
    };
    let document = folder.json("out.json");
    assert!(!document["elastic"]["warm_up"].is_null(), "{document}");
    let advice = document["next_steps"].to_string();
    let found = moved(&advice);
    assert!((found / 0.5 - 1.0).abs() < 0.06, "{found}");
    assert!(
        found.to_bits() == moved(&outcome.stderr).to_bits(),
        "{outcome:#?}"
    );
    assert!(advice.contains("--correct-drift"), "{advice}");
    assert!(!advice.contains("warm the arm up"), "{advice}");
    // Once it is removed, neither is left.
    let line = format!("{line} --correct-drift");
    let outcome = folder.run(&line).ok();
    assert!(
        !outcome.stderr.contains("the instrument moved"),
        "{outcome:#?}"
    );
    let advice = folder.json("out.json")["next_steps"].to_string();
    assert!(!advice.contains("--correct-drift"), "{advice}");
}

#[test]
fn refused_without_reference_points() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 20));
    for command in ["calibrate --method poe --out arm.blob", "compare --folds 2"] {
        folder.refuses(format!(
            "{command} --robot {SERIAL} train.csv --correct-drift"
        ));
    }
}
