//! `--correct-drift`: a drifting instrument, measured by reference points.

use std::fmt::Write as _;

use crate::program::{Folder, SERIAL, changed, simulated};
use crate::texts::texts;

/// Returns the set as an instrument would measure it that drifts by `creep_mm` along x, with two reference points. The
/// first point is missed once, and the second is wrong once.
fn drifted(set: &str, poses: usize, creep_mm: f64) -> String {
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
                let creep = creep_mm * f64::from(k) / poses as f64;
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
