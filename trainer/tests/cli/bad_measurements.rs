//! Bad measurement files: each is refused by every command that reads one, with its place, and nothing is written.

use crate::program::{Folder, SERIAL, changed, simulated, with_field, without};

const POSES: usize = 24;

/// A folder with a good set, a blob of it and an old blob to keep.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("good.csv", simulated("train", POSES));
    let line = format!("calibrate --robot {SERIAL} good.csv --model poe-gp-load --out arm.blob");
    folder.run(&line).ok();
    folder.write("old.blob", "the old blob");
    folder
}

/// Every command refuses `bad`, says `parts`, and writes nothing.
#[track_caller]
fn refused(folder: &Folder, bad: impl AsRef<[u8]>, parts: &[&str]) {
    folder.write("bad.csv", bad);
    every_command_refuses(folder, "bad.csv", parts);
}

#[track_caller]
fn every_command_refuses(folder: &Folder, file: &str, parts: &[&str]) {
    let before = folder.names();
    for line in [
        format!("calibrate --robot {SERIAL} {file} --model poe --out old.blob --json new.json"),
        format!("calibrate --robot {SERIAL} {file} --model poe --out new.blob"),
        format!("compare --robot {SERIAL} {file} --folds 3 --json new.json"),
        format!("compare --robot {SERIAL} good.csv --test {file} --folds 0 --json new.json"),
        format!("evaluate arm.blob {file} --predictions new.csv --json new.json"),
        format!("evaluate arm.blob {file} --json -"),
    ] {
        folder.run(&line).refused(parts);
        assert_eq!(folder.names(), before, "{line}");
        assert_eq!(folder.read("old.blob"), b"the old blob", "{line}");
    }
}

#[test]
fn files_that_are_no_table() {
    let folder = folder();
    let found = ["error: none.csv: found no such file", "expected"];
    every_command_refuses(&folder, "none.csv", &found);
    let header = simulated("train", 0);
    refused(
        &folder,
        "",
        &[
            "error: bad.csv: found an empty file",
            "expected a header row",
        ],
    );
    refused(
        &folder,
        &header,
        &[
            "bad.csv:1: found a header without rows",
            "expected one measured pose",
        ],
    );
    refused(
        &folder,
        b"q1_deg,x_mm\n\x00\x01\x02",
        &[
            "bad.csv:2: found a binary file",
            "expected a CSV text file in UTF-8",
        ],
    );
    let image = [b"\x89PNG\r\n\x1a\n".as_slice(), &[0xff; 64]].concat();
    refused(
        &folder,
        image,
        &["bad.csv:", "expected a CSV text file in UTF-8"],
    );
}

#[test]
fn rows_and_columns() {
    let folder = folder();
    let good = simulated("train", POSES);
    let cut = good.trim_end().rsplit_once(',').unwrap().0.to_owned() + "\n";
    refused(
        &folder,
        cut,
        &[
            "bad.csv:25: found a short row of 13 fields",
            "expected 14 fields",
        ],
    );
    refused(
        &folder,
        without(&good, &["y_mm"]),
        &[
            "bad.csv:1: column 8 (x_mm): found x_mm, z_mm without y",
            "expected all of x, y, z",
        ],
    );
    refused(
        &folder,
        good.replacen("q2_deg", "q1_deg", 1),
        &[
            "bad.csv:1: column 3 (q1_deg): found the column q1_deg a second time",
            "expected every quantity once",
        ],
    );
    refused(
        &folder,
        without(&good, &["qw"]),
        &[
            "bad.csv:1: column 11 (qx): found qx, qy, qz without qw",
            "expected all of qw, qx, qy, qz, or none",
        ],
    );
    refused(
        &folder,
        without(&good, &["q6_deg"]),
        &[
            "bad.csv:1: found 5 joint columns",
            &format!("expected 6, the joints of robot \"{SERIAL}\""),
        ],
    );
    let seven = changed(&good, |_, fields| fields.insert(7, "1.5".to_owned()));
    refused(
        &folder,
        seven.replacen("q6_deg", "q6_deg,q7_deg", 1),
        &["bad.csv:1: found 7 joint columns", "expected 6"],
    );
}

#[test]
fn fields() {
    let folder = folder();
    let good = simulated("train", POSES);
    let field = |name: &str, text: &str, parts: &[&str]| {
        refused(&folder, with_field(&good, 7, name, text), parts);
    };
    field(
        "payload_kg",
        "-2.5",
        &[
            "bad.csv:7: column 1 (payload_kg): found \"-2.5\"",
            "expected a payload of 0 kg or more",
        ],
    );
    field(
        "q4_deg",
        "abc",
        &["bad.csv:7: column 5 (q4_deg): found \"abc\", expected a number in degrees"],
    );
    field(
        "x_mm",
        "",
        &["bad.csv:7: column 8 (x_mm): found an empty field, expected a number in millimetres"],
    );
    for text in ["nan", "NaN", "inf", "-Infinity", "1e999"] {
        let found = format!("bad.csv:7: column 9 (y_mm): found \"{text}\"");
        field("y_mm", text, &[&found, "expected a number"]);
    }
    field(
        "qw",
        "0.9",
        &[
            "bad.csv:7: column 11 (qw): found a quaternion of norm",
            "expected",
        ],
    );
    field(
        "qy",
        "",
        &["bad.csv:7: column 13 (qy): found an empty field", "four"],
    );
    let miss = ["x_mm", "y_mm", "z_mm"]
        .iter()
        .fold(good.clone(), |csv, name| with_field(&csv, 7, name, "0"));
    refused(
        &folder,
        miss,
        &[
            "bad.csv:7: column 8 (x_mm): found the position 0 0 0",
            "missed",
        ],
    );
    // Degrees under a name in radians: the joint limits tell.
    refused(
        &folder,
        good.replacen("q1_deg", "q1_rad", 1),
        &[
            "bad.csv:2: column 2 (q1_rad): found",
            " rad, expected a value of joint",
            "is the column's unit _deg?",
        ],
    );
}

#[test]
fn radians_under_a_name_in_degrees_are_pointed_out() {
    let folder = folder();
    let radians = changed(&simulated("train", POSES), |names, fields| {
        for (name, field) in names.iter().zip(fields) {
            if name.starts_with('q') && name.ends_with("_deg") {
                *field = field.parse::<f64>().unwrap().to_radians().to_string();
            }
        }
    });
    folder.write("radians.csv", radians);
    let line = format!("compare --robot {SERIAL} radians.csv --folds 0 --models base-tool");
    let outcome = folder.run(&line).ok();
    assert!(outcome.stderr.contains("are they radians?"), "{outcome:#?}");
}

#[test]
fn too_few_poses() {
    let folder = folder();
    for (model, poses, needed) in [("base-tool", 2, 3), ("poe", 5, 6), ("poe-gp", 9, 10)] {
        folder.write("few.csv", simulated("train", poses));
        let parts = [
            &format!("few.csv: found {poses} poses"),
            &format!("expected at least {needed} for `{model}`") as &str,
        ];
        let line = format!("calibrate --robot {SERIAL} few.csv --model {model} --out new.blob");
        folder.run(&line).refused(&parts);
        let line = format!("compare --robot {SERIAL} few.csv --models {model} --folds 0");
        folder.run(&line).refused(&parts);
        assert!(!folder.path("new.blob").exists());
        folder.write("enough.csv", simulated("train", needed));
        let line = format!("calibrate --robot {SERIAL} enough.csv --model {model} --out few.blob");
        folder.run(&line).ok();
    }
    // Enough for all, too few for what is left when a fold is held out.
    folder.write("few.csv", simulated("train", 6));
    let line = format!("compare --robot {SERIAL} few.csv --models poe --folds 2");
    folder.run(&line).refused(&["few.csv: found 3 poses"]);
}

#[test]
fn payloads_that_are_missing() {
    let folder = folder();
    let bare = without(&simulated("train", POSES), &["payload_kg"]);
    folder.write("bare.csv", bare);
    let parts = ["bare.csv: found no payload_kg column", "expected one"];
    for line in [
        format!("calibrate --robot {SERIAL} bare.csv --model poe-gp-load --out new.blob"),
        format!("compare --robot {SERIAL} bare.csv --models poe,poe-gp-load --folds 0"),
        format!("compare --robot {SERIAL} good.csv --test bare.csv --folds 0"),
        "evaluate arm.blob bare.csv --predictions new.csv".to_owned(),
    ] {
        folder.run(&line).refused(&parts);
    }
    assert!(!folder.path("new.blob").exists() && !folder.path("new.csv").exists());
    // Left to itself, compare runs what the data allow.
    let line = format!("compare --robot {SERIAL} bare.csv --folds 2 --json -");
    let document = folder.run(&line).ok().json();
    let models: Vec<&str> = document["models"]
        .as_array()
        .unwrap()
        .iter()
        .map(|model| model["model"].as_str().unwrap())
        .collect();
    assert!(
        models.starts_with(&["base-tool", "poe", "poe-gp"]),
        "{models:?}"
    );
    assert!(!models.contains(&"poe-gp-load"), "{models:?}");
}

/// The paper's Gaussian process compares whole poses of one tool; the other models take what there is.
#[test]
fn sessions_targets_and_positions_alone() {
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
    for csv in [
        named("session"),
        named("target"),
        without(&good, &["qw", "qx", "qy", "qz"]),
    ] {
        folder.write("tools.csv", csv);
        for model in ["poe-gp", "poe-gp-load"] {
            let line =
                format!("calibrate --robot {SERIAL} tools.csv --model {model} --out new.blob");
            folder.run(&line).refused(&[
                "tools.csv: found several sessions or targets, or positions alone",
                &format!("expected whole poses of one tool for `{model}`"),
                "help: use --model elastic, poe or base-tool",
            ]);
            let line = format!(
                "compare --robot {SERIAL} tools.csv --models {model} --folds 0 --test tools.csv"
            );
            folder
                .run(&line)
                .refused(&["tools.csv", "found several sessions"]);
            assert!(!folder.path("new.blob").exists());
        }
        for model in ["base-tool", "poe", "elastic"] {
            let line =
                format!("calibrate --robot {SERIAL} tools.csv --model {model} --out taken.blob");
            folder.run(&line).ok();
        }
        // Left to itself, compare runs what the data allow.
        let line =
            format!("compare --robot {SERIAL} tools.csv --folds 0 --test tools.csv --json -");
        let document = folder.run(&line).ok().json();
        let models = document["models"].as_array().unwrap();
        assert!(
            models
                .iter()
                .all(|m| !m["model"].as_str().unwrap().contains("gp"))
        );
    }
}

#[test]
fn repeated_rows_are_kept() {
    let folder = folder();
    let good = simulated("train", POSES);
    let last = good.lines().last().unwrap();
    folder.write("repeated.csv", format!("{good}{last}\n"));
    let line = format!("calibrate --robot {SERIAL} repeated.csv --model poe --out r.blob --json -");
    let outcome = folder.run(&line).ok();
    assert!(
        outcome.stderr.contains(
            "note: repeated.csv: kept, though the same to the last digit as an earlier row: 1 row"
        ),
        "{outcome:#?}"
    );
    assert_eq!(outcome.json()["training_poses"], POSES + 1);
}
