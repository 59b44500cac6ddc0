//! Every command that reads measurements refuses a bad file, names the place, and writes nothing.

use crate::program::{Folder, SERIAL, changed, simulated, with_field, without};
use crate::texts::texts;

const POSES: usize = 24;

/// Returns a folder with a good set, a blob calibrated from it, and an old blob that must be kept.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("good.csv", simulated("train", POSES));
    let line = format!("calibrate --robot {SERIAL} good.csv --method poe-gp-load --out arm.blob");
    folder.run(&line).ok();
    folder.write("old.blob", folder.read("arm.blob"));
    folder
}

/// Asserts that every command refuses `bad`.
#[track_caller]
fn refused(folder: &Folder, bad: impl AsRef<[u8]>) {
    folder.write("bad.csv", bad);
    every_command_refuses(folder, "bad.csv");
}

#[track_caller]
fn every_command_refuses(folder: &Folder, file: &str) {
    for line in [
        format!("calibrate --robot {SERIAL} {file} --method poe --out old.blob --json new.json"),
        format!("calibrate --robot {SERIAL} {file} --method poe --out new.blob"),
        format!("compare --robot {SERIAL} {file} --folds 3 --json new.json"),
        format!("compare --robot {SERIAL} good.csv --test {file} --folds 0 --json new.json"),
        format!("evaluate arm.blob {file} --predictions new.csv --json new.json"),
        format!("evaluate arm.blob {file} --json -"),
    ] {
        folder.refuses(line);
    }
}

#[test]
fn files_that_are_no_table() {
    let _texts = texts();
    let folder = folder();
    every_command_refuses(&folder, "none.csv");
    refused(&folder, "");
    refused(&folder, simulated("train", 0));
    refused(&folder, b"q1_deg,x_mm\n\x00\x01\x02");
    refused(
        &folder,
        [b"\x89PNG\r\n\x1a\n".as_slice(), &[0xff; 64]].concat(),
    );
}

#[test]
fn rows_and_columns() {
    let _texts = texts();
    let folder = folder();
    let good = simulated("train", POSES);
    refused(
        &folder,
        good.trim_end().rsplit_once(',').unwrap().0.to_owned() + "\n",
    );
    refused(&folder, without(&good, &["y_mm"]));
    refused(&folder, good.replacen("q2_deg", "q1_deg", 1));
    refused(&folder, without(&good, &["qw"]));
    refused(&folder, without(&good, &["q6_deg"]));
    let seven = changed(&good, |_, fields| fields.insert(7, "1.5".to_owned()));
    refused(&folder, seven.replacen("q6_deg", "q6_deg,q7_deg", 1));
}

#[test]
fn fields() {
    let _texts = texts();
    let folder = folder();
    let good = simulated("train", POSES);
    for (name, text) in [
        ("payload_kg", "-2.5"),
        ("q4_deg", "abc"),
        ("x_mm", ""),
        ("y_mm", "nan"),
        ("y_mm", "NaN"),
        ("y_mm", "inf"),
        ("y_mm", "-Infinity"),
        ("y_mm", "1e999"),
        ("qw", "0.9"),
        ("qy", ""),
    ] {
        refused(&folder, with_field(&good, 7, name, text));
    }
    let missed = ["x_mm", "y_mm", "z_mm"].iter();
    refused(
        &folder,
        missed.fold(good.clone(), |csv, name| with_field(&csv, 7, name, "0")),
    );
    // Degrees under a column name in radians exceed the joint limits.
    refused(&folder, good.replacen("q1_deg", "q1_rad", 1));
}

#[test]
fn radians_under_a_name_in_degrees_are_pointed_out() {
    let _texts = texts();
    let folder = folder();
    let radians = changed(&simulated("train", POSES), |names, fields| {
        for (name, field) in names.iter().zip(fields) {
            if name.starts_with('q') && name.ends_with("_deg") {
                *field = field.parse::<f64>().unwrap().to_radians().to_string();
            }
        }
    });
    folder.write("radians.csv", radians);
    let line = format!("compare --robot {SERIAL} radians.csv --folds 0 --methods base-tool");
    folder.refuses_data(line);
}

/// Test files are examined as those of `evaluate` are; what differs from the training rows in another way is warned of.
#[test]
fn test_files_are_examined() {
    let _texts = texts();
    let folder = folder();
    let test = |change: fn(&str, f64) -> f64| {
        changed(&simulated("test1", POSES), |names, fields| {
            for (name, field) in names.iter().zip(fields) {
                if name.ends_with("_mm") {
                    *field = change(name, field.parse().unwrap()).to_string();
                }
            }
        })
    };
    folder.write("inches.csv", test(|_, mm| mm / 25.4));
    let line = format!("--robot {SERIAL} good.csv --test inches.csv");
    folder.refuses_data(format!("calibrate {line} --method poe --out new.blob"));
    folder.refuses_data(format!("compare {line} --folds 0 --methods base-tool"));
    folder.write(
        "moved.csv",
        test(|name, mm| mm + 30.0 * f64::from(u8::from(name == "x_mm"))),
    );
    let line = format!("calibrate --robot {SERIAL} good.csv --method poe --out new.blob");
    folder.run(&format!("{line} --test moved.csv")).ok();
}

#[test]
fn too_many_poses() {
    let _texts = texts();
    let folder = Folder::new();
    let rows = simulated("train", 300);
    let rows: Vec<&str> = rows.lines().collect();
    let more = rows[1..].iter().cycle().take(4_100);
    let many: Vec<&str> = rows[..1].iter().chain(more).copied().collect();
    folder.write("many.csv", many.join("\n"));
    folder.refuses(format!(
        "calibrate --robot {SERIAL} many.csv --method poe-gp-load --out new.blob"
    ));
}

#[test]
fn too_few_poses() {
    let _texts = texts();
    let folder = folder();
    for (model, poses, needed) in [("base-tool", 2, 3), ("poe", 5, 6), ("poe-gp", 9, 10)] {
        folder.write("few.csv", simulated("train", poses));
        folder.refuses(format!(
            "calibrate --robot {SERIAL} few.csv --method {model} --out new.blob"
        ));
        folder.refuses(format!(
            "compare --robot {SERIAL} few.csv --methods {model} --folds 0"
        ));
        folder.write("enough.csv", simulated("train", needed));
        // Enough poses for the method; whether it gains anything is another question.
        let line = format!(
            "calibrate --robot {SERIAL} enough.csv --method {model} --accept few --accept gain --out few.blob"
        );
        folder.run(&line).ok();
    }
    // Enough for the whole set, too few when a fold is held out.
    folder.write("few.csv", simulated("train", 6));
    folder.refuses(format!(
        "compare --robot {SERIAL} few.csv --methods poe --folds 2"
    ));
}

#[test]
fn payloads_that_are_missing() {
    let _texts = texts();
    let folder = folder();
    let bare = without(&simulated("train", POSES), &["payload_kg"]);
    folder.write("bare.csv", bare);
    for line in [
        format!("calibrate --robot {SERIAL} bare.csv --method poe-gp-load --out new.blob"),
        format!("compare --robot {SERIAL} bare.csv --methods poe,poe-gp-load --folds 0"),
        format!("compare --robot {SERIAL} good.csv --test bare.csv --folds 0"),
        "evaluate arm.blob bare.csv --predictions new.csv".to_owned(),
    ] {
        folder.refuses(line);
    }
    // Without a named method, compare runs those that the data allow.
    let line = format!("compare --robot {SERIAL} bare.csv --folds 2 --json -");
    let document = folder.run(&line).ok().json();
    let models: Vec<&str> = document["methods"]
        .as_array()
        .unwrap()
        .iter()
        .map(|model| model["method"].as_str().unwrap())
        .collect();
    assert!(
        models.starts_with(&["base-tool", "poe", "poe-gp"]),
        "{models:?}"
    );
    assert!(!models.contains(&"poe-gp-load"), "{models:?}");
}

/// The paper's Gaussian process needs whole poses, whereas the other models also take positions alone. All models take several
/// tools.
#[test]
fn sessions_targets_and_positions_alone() {
    let _texts = texts();
    let folder = folder();
    let good = simulated("train", POSES);
    let named = |column: &str| {
        let mut row = 0;
        let csv = changed(&good, |_, fields| {
            row += 1;
            fields.push(if row <= POSES / 2 { "a" } else { "b" }.to_owned());
        });
        csv.replacen("qz", &format!("qz,{column}"), 1)
    };
    let positions = without(&good, &["qw", "qx", "qy", "qz"]);
    for (csv, takes_all) in [
        (named("session"), true),
        (named("target"), true),
        (positions, false),
    ] {
        let all_but_one = csv.trim_end().rsplit_once('\n').unwrap().0.to_owned();
        // Slightly changed, because training rows are no test.
        let again = changed(&all_but_one, |names, fields| {
            let x = names.iter().position(|name| *name == "x_mm").unwrap();
            fields[x] = format!("{}", fields[x].parse::<f64>().unwrap() + 0.01);
        });
        folder.write("test.csv", again);
        folder.write("tools.csv", csv);
        for model in ["base-tool", "poe", "poe-gp", "poe-gp-load", "elastic"] {
            let line = |out: &str| {
                format!("calibrate --robot {SERIAL} tools.csv --method {model} --out {out}")
            };
            if takes_all || !model.contains("gp") {
                folder.run(&line("taken.blob")).ok();
                continue;
            }
            folder.refuses(line("new.blob"));
            let files = "tools.csv --folds 0 --test test.csv";
            folder.refuses(format!(
                "compare --robot {SERIAL} {files} --methods {model}"
            ));
        }
        // Without a named method, compare runs those that the data allow.
        let line = format!("compare --robot {SERIAL} tools.csv --folds 0 --test test.csv --json -");
        let document = folder.run(&line).ok().json();
        let models = document["methods"].as_array().unwrap();
        let is_gp = |m: &serde_json::Value| m["method"].as_str().unwrap().contains("gp");
        assert_eq!(models.iter().any(is_gp), takes_all);
    }
}

#[test]
fn repeated_rows_are_kept() {
    let _texts = texts();
    let folder = folder();
    let good = simulated("train", POSES);
    let last = good.lines().last().unwrap();
    folder.write("repeated.csv", format!("{good}{last}\n"));
    let line =
        format!("calibrate --robot {SERIAL} repeated.csv --method poe --out r.blob --json -");
    let outcome = folder.run(&line).ok().said();
    assert_eq!(outcome.json()["training_poses"], POSES + 1);
}
