//! The predictions file has one row for each input row, in order, and the errors recomputed from it are the reported ones.

use crate::program::{Folder, SERIAL, changed, simulated};
use crate::texts::texts;

/// Returns the columns `names` of a CSV text, row by row.
fn columns<const N: usize>(csv: &str, names: [&str; N]) -> Vec<[f64; N]> {
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = names.map(|name| header.iter().position(|n| *n == name).unwrap());
    lines
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            at.map(|i| fields[i].parse().unwrap())
        })
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn errors_recomputed_from_the_predictions_are_those_of_the_json() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    let test = simulated("test2", 100);
    folder.write("test.csv", &test);
    for model in ["base-tool", "poe", "poe-gp", "poe-gp-load"] {
        let line =
            format!("calibrate --robot {SERIAL} train.csv --method {model} --out {model}.blob");
        folder.run(&line).ok();
        let line = format!("evaluate {model}.blob test.csv --predictions out.csv --json out.json");
        folder.run(&line).ok();
        let predicted = folder.text("out.csv");
        let mut lines = predicted.lines();
        assert_eq!(
            lines.next(),
            Some("x_mm,y_mm,z_mm,qw,qx,qy,qz,status"),
            "{model}"
        );
        let flagged = lines.clone().filter(|row| !row.ends_with(",ok")).count();
        assert_eq!(lines.count(), 100);

        let position = ["x_mm", "y_mm", "z_mm"];
        let orientation = ["qw", "qx", "qy", "qz"];
        let distances: Vec<f64> = columns(&predicted, position)
            .iter()
            .zip(columns(&test, position))
            .map(|(a, b)| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt())
            .collect();
        // The angle comes from |q − q'|, which is more exact than the arc cosine of q · q'.
        let angles: Vec<f64> = columns(&predicted, orientation)
            .iter()
            .zip(columns(&test, orientation))
            .map(|(a, b)| {
                let norm = |sign: f64| {
                    let squares = (0..4).map(|i| (a[i] - sign * b[i]).powi(2));
                    squares.sum::<f64>().sqrt()
                };
                4e3 * (0.5 * norm(1.0).min(norm(-1.0))).asin()
            })
            .collect();
        let set = &folder.json("out.json")["sets"][0];
        assert_eq!(set["flagged"], flagged, "{model}");
        let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
        for (quantity, values) in [("position_mm", distances), ("orientation_mrad", angles)] {
            for (name, value) in [("mean", mean(&values)), ("max", largest(&values))] {
                let reported = set[quantity][name].as_f64().unwrap();
                assert!(
                    (value - reported).abs() < 1e-6,
                    "{model} {quantity} {name}: {value} {reported}"
                );
            }
        }
    }
}

#[test]
fn the_status_says_what_a_prediction_is_worth() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe-gp-load --out arm.blob --max-correction-mm 0.001"
    );
    folder.run(&line).ok();
    let test = simulated("test1", 3);
    let mut rows: Vec<String> = test.lines().map(str::to_owned).collect();
    // A payload and a first joint far from the trained ranges.
    rows[1] = rows[1].replacen(rows[1].split(',').next().unwrap(), "20", 1);
    let q1 = rows[2].split(',').nth(1).unwrap().to_owned();
    rows[2] = rows[2].replacen(&q1, "150", 1);
    folder.write("test.csv", rows.join("\n") + "\n");
    folder
        .run("evaluate arm.blob test.csv --accept no-fit --predictions out.csv")
        .ok()
        .said();
    let text = folder.text("out.csv");
    let status: Vec<&str> = text
        .lines()
        .skip(1)
        .map(|row| row.splitn(8, ',').nth(7).unwrap())
        .collect();
    assert!(status[0].contains("payload"), "{status:?}");
    assert!(status[1].contains("joint"), "{status:?}");
    for status in status {
        assert!(status.contains("limited"), "{status:?}");
        assert!(!status.contains(','), "one field: {status:?}");
    }
}

/// A cell whose controller evaluates the model may export its prediction as the pose: that judges nothing.
#[test]
fn own_predictions_are_no_measurements() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    let test = simulated("test2", 40);
    folder.write("test.csv", &test);
    for line in [
        format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob"),
        "evaluate arm.blob test.csv --predictions out.csv".to_owned(),
    ] {
        folder.run(&line).ok();
    }
    let predicted = folder.text("out.csv");
    let mut predicted = predicted.lines().skip(1);
    let pose = ["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"];
    let own = changed(&test, |names, fields| {
        let values = predicted.next().unwrap().split(',');
        for (name, value) in pose.iter().zip(values) {
            let at = names.iter().position(|n| n == name).unwrap();
            fields[at] = value.to_owned();
        }
    });
    folder.write("own.csv", own);
    for command in [
        "evaluate arm.blob own.csv",
        "check arm.blob own.csv --max-mm 0.5",
    ] {
        let found = folder.run(command);
        assert_eq!(found.code, Some(3), "{found:#?}");
        let text = "these poses were computed by it, not measured [readout]";
        assert!(found.stderr.contains(text), "{found:#?}");
        folder.run(&format!("{command} --accept readout")).ok();
    }
}
