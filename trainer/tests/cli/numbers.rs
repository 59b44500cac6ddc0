//! Every number in the program's output is within the range of its unit; a value that the data do not determine is left out.
//!
//! [`check_text`] and [`check_document`] examine the output of every run in these tests. The tests here use data that usual
//! tests do not have: repeated poses, joints that stand still, positions alone, impossible noise.

use serde_json::Value;

use crate::program::{Folder, SERIAL, changed, simulated, without};

/// Units, with the largest magnitude of a number in that unit.
const RANGES: [(&str, f64); 9] = [
    ("mm", 1e5),
    ("mrad", 3.2e3),
    ("deg", 3.6e3),
    ("°", 3.6e3),
    ("um", 1e6),
    ("µm", 1e6),
    ("urad", 1e6),
    ("kg", 1e3),
    ("%", 1e4),
];
/// The largest magnitude of any other number; squared distances in standard deviations may be larger.
const BARE: f64 = 1e10;
const CHI_SQUARED: f64 = 1e13;
/// Keys with a unit that may be null: documented as not measured, absent, or not determined.
const NULLS: [&str; 4] = ["noise_mrad", "payload_kg", "shift_xyz_mm", "turn_xyz_mrad"];

fn range(unit: &str) -> Option<f64> {
    let found = RANGES.iter().find(|(name, _)| *name == unit);
    found.map(|(_, range)| *range)
}

/// Panics at NaN or infinity in `text`, and at a number beyond the range of the unit behind it.
#[track_caller]
pub fn check_text(line: &str, text: &str) {
    let is_word = |c: char| c.is_alphanumeric() || "_.µ°%".contains(c);
    let mut words = text
        .split(|c: char| !is_word(c) && c != '-')
        .map(|word| word.trim_matches(['-', '.']))
        .filter(|word| !word.is_empty())
        .peekable();
    while let Some(word) = words.next() {
        assert!(
            !["nan", "inf", "infinity"].contains(&word.to_lowercase().as_str()),
            "{line}: {word} in {text}"
        );
        // A checksum or the id of a key, which may consist of digits only.
        if [8, 16].contains(&word.len()) && word.chars().all(|c| c.is_ascii_hexdigit()) {
            continue;
        }
        let digits = word.trim_end_matches(['°', '%']);
        let Ok(number) = digits.parse::<f64>() else {
            continue;
        };
        let unit = match &word[digits.len()..] {
            "" => words.peek().copied().unwrap_or(""),
            unit => unit,
        };
        let largest = range(unit).unwrap_or(BARE);
        assert!(number.abs() <= largest, "{line}: {word} {unit} in {text}");
    }
}

/// Panics at a number in a JSON document beyond the range of the unit in its key, and at a null where a number is required.
#[track_caller]
pub fn check_document(line: &str, document: &Value) {
    check_value(line, "", BARE, document);
}

#[track_caller]
fn check_value(line: &str, key: &str, largest: f64, value: &Value) {
    match value {
        Value::Object(members) => {
            for (key, value) in members {
                let largest = match key.rsplit('_').next().and_then(range) {
                    Some(range) => range,
                    None if key == "chi_squared" => CHI_SQUARED,
                    None => largest,
                };
                check_value(line, key, largest, value);
            }
        }
        Value::Array(values) => {
            for value in values {
                check_value(line, key, largest, value);
            }
        }
        Value::Number(number) => {
            let number = number.as_f64().unwrap();
            assert!(number.abs() <= largest, "{line}: {key} {number}");
        }
        Value::Null => assert!(
            largest == BARE || NULLS.contains(&key),
            "{line}: {key} is null"
        ),
        Value::Bool(_) | Value::String(_) => {}
    }
}

/// Returns rows of a simulated set without the noiseless truth.
fn rows(set: &str, poses: usize) -> String {
    let csv = simulated(set, poses);
    let names = csv.lines().next().unwrap().split(',');
    let truth: Vec<&str> = names.filter(|name| name.starts_with("true_")).collect();
    without(&csv, &truth)
}

/// Returns `csv` with its first `different` rows repeated in place of the others.
fn repeated(csv: &str, different: usize) -> String {
    let rows: Vec<&str> = csv.lines().collect();
    let repeat = |k: usize| rows[1 + k % different].to_owned() + "\n";
    rows[0].to_owned() + "\n" + &(0..rows.len() - 1).map(repeat).collect::<String>()
}

/// Data that determine little, for every command that reads measurements. [`check_text`] and [`check_document`] examine each
/// run; the exit code is any but that of a panic.
#[test]
fn poor_data_make_no_absurd_numbers() {
    let folder = Folder::new();
    let (train, fresh) = (rows("train", 60), rows("test2", 20));
    let positions = |csv: &str| without(csv, &["qw", "qx", "qy", "qz"]);
    let still = |csv: &str| {
        changed(csv, |names, fields| {
            for (name, field) in names.iter().zip(fields) {
                if ["q4_deg", "q5_deg", "q6_deg", "payload_kg"].contains(name) {
                    *field = "1".to_owned();
                }
            }
        })
    };
    for (name, csv) in [
        ("usual", train.clone()),
        ("one-pose", repeated(&train, 1)),
        ("five-poses", repeated(&train, 5)),
        ("still", still(&train)),
        ("positions", positions(&train)),
        ("repeated-positions", positions(&repeated(&train, 5))),
    ] {
        folder.write(&format!("{name}.csv"), csv);
    }
    folder.write("fresh.csv", &fresh);
    folder.write("fresh-positions.csv", positions(&fresh));
    let run = |line: &str| {
        let outcome = folder.run(&format!("{line} --json out.json"));
        let code = outcome.code.unwrap();
        assert!(
            code <= 3 && !outcome.stderr.contains("panicked"),
            "{outcome:#?}"
        );
        if code < 2 && folder.names().contains(&"out.json".to_owned()) {
            folder.json("out.json");
        }
        code
    };
    let mut calibrated = 0;
    for name in [
        "usual",
        "one-pose",
        "five-poses",
        "still",
        "positions",
        "repeated-positions",
    ] {
        run(&format!(
            "compare --robot {SERIAL} {name}.csv --methods poe,base-tool --folds 3"
        ));
        for method in ["base-tool", "poe", "elastic"] {
            let line = format!("calibrate --robot {SERIAL} {name}.csv --method {method}");
            if run(&format!("{line} --out arm.blob --report out.html")) > 1 {
                continue;
            }
            calibrated += 1;
            run("inspect arm.blob");
            for fresh in ["fresh", "fresh-positions"] {
                for frames in ["", "--fit-base", "--fit-base --fit-tool"] {
                    run(&format!("evaluate arm.blob {fresh}.csv {frames}"));
                    run(&format!("check arm.blob {fresh}.csv --max-mm 1 {frames}"));
                }
            }
        }
    }
    assert!(calibrated >= 6, "{calibrated}");
}

#[test]
fn absurd_numbers_are_found() {
    for text in [
        "joint 6 642304364605551.5000°",
        "the tool inf mm",
        "mean NaN",
        "moved by 123456.7 mm",
        "(condition number inf)",
        "12000 mrad",
    ] {
        assert!(
            std::panic::catch_unwind(|| check_text("", text)).is_err(),
            "{text}"
        );
    }
    check_text(
        "",
        "0.05 ± 0.01 mm, 3 of 4 poses on 2026-11-20, id 5469418343840729, CRC 1234e678, 98 %, file inf.csv",
    );
    for text in [
        r#"{"smallest_deg": 1e9}"#,
        r#"{"position_mm": {"mean": null}}"#,
        r#"{"rows": [{"size": 1e11}]}"#,
    ] {
        let document: Value = serde_json::from_str(text).unwrap();
        let found = std::panic::catch_unwind(|| check_document("", &document));
        assert!(found.is_err(), "{text}");
    }
}
