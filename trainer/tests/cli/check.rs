//! `trainer check`: exit codes, messages, and bad input.

use crate::program::{Folder, Outcome, SERIAL, changed, simulated, without};
use crate::texts::texts;

/// Returns a folder with an elastic model of 150 poses, and 20 fresh poses.
pub fn folder() -> Folder {
    Folder::prepared("check", |folder| {
        folder.write("train.csv", simulated("train", 150));
        folder.write("fresh.csv", simulated("test2", 20));
        folder
            .run(&format!(
                "calibrate --robot {SERIAL} train.csv --out arm.blob"
            ))
            .ok();
    })
}

const ORIENTATION: [&str; 4] = ["qw", "qx", "qy", "qz"];

/// Returns the fresh poses with something added to a column.
fn moved(column: &str, by: f64) -> String {
    changed(&simulated("test2", 20), |names, fields| {
        let at = names.iter().position(|n| *n == column).unwrap();
        fields[at] = format!("{:.9}", fields[at].parse::<f64>().unwrap() + by);
    })
}

fn does_not_hold(outcome: Outcome) -> Outcome {
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    outcome.said()
}

#[test]
fn it_holds_until_something_moves() {
    let _texts = texts();
    let folder = folder();
    let run = |line: &str| folder.run(&format!("check arm.blob {line} --json out.json"));
    run("fresh.csv --max-mm 0.15").ok().said();
    let document = folder.json("out.json");
    assert_eq!(document["holds"], true);
    assert_eq!(document["changes"].as_array().unwrap().len(), 0);
    assert_eq!(document["poses"], 20);

    folder.write("base.csv", moved("x_mm", 0.2));
    does_not_hold(run("base.csv --max-mm 0.15"));
    let document = folder.json("out.json");
    let change = &document["changes"][0];
    assert_eq!(change["part"], "base");
    let (size, reach) = (
        &change["shift_mm"]["value"],
        &change["shift_mm"]["plus_minus"],
    );
    let (size, reach) = (size.as_f64().unwrap(), reach.as_f64().unwrap());
    assert!((size - 0.2).abs() < 2.0 * reach && reach < 0.05, "{change}");

    // The controller reports 0.02° more than the real joint angle.
    folder.write("joint.csv", moved("q2_deg", 0.02));
    does_not_hold(run("joint.csv --max-mm 0.15"));
    let document = folder.json("out.json");
    assert_eq!(document["changes"][0]["part"]["joint"], 2);
    let offset = document["changes"][0]["offset_deg"]["value"]
        .as_f64()
        .unwrap();
    assert!((offset + 0.02).abs() < 0.002, "{offset}");

    // A drift that is found but is within the limits.
    let line = "base.csv --max-mm 0.5 --max-drift-mm 0.4";
    let small = run(line).ok().said().stdout;
    assert!(
        small.contains(
            "the drift of the base is within what is allowed for positions: the calibration can stay in use"
        ),
        "{small}"
    );
    assert!(!small.contains("measure the base frame again"), "{small}");
    does_not_hold(run("base.csv --max-mm 0.5 --max-drift-mm 0.1"));
    does_not_hold(run("fresh.csv --max-mm 0.05 --statistic max"));
}

/// What moves while the rows are measured is named as such, not as a base that has moved since the calibration; no joint is
/// blamed for a payload that the model was never trained with.
#[test]
fn what_the_rows_themselves_explain_is_no_drift() {
    let _texts = texts();
    let folder = folder();
    let run = |line: &str| {
        folder.run(&format!(
            "check arm.blob {line} --max-mm 0.15 --json out.json"
        ))
    };
    let shifted = |share: fn(usize) -> f64| {
        let mut row = 0;
        changed(&simulated("test2", 20), |names, fields| {
            let at = names.iter().position(|n| *n == "x_mm").unwrap();
            let x = fields[at].parse::<f64>().unwrap();
            fields[at] = format!("{:.6}", x + share(row));
            row += 1;
        })
    };
    folder.write("step.csv", shifted(|row| if row < 10 { 0.0 } else { 1.0 }));
    folder.write("creep.csv", shifted(|row| 0.05 * row as f64));
    for (file, cause) in [("step.csv", "step"), ("creep.csv", "drift")] {
        let outcome = does_not_hold(run(file));
        assert!(
            outcome.stderr.contains(&format!("[{cause}]")),
            "{outcome:#?}"
        );
        assert!(
            !outcome.stdout.contains("the base has moved"),
            "{outcome:#?}"
        );
        let document = folder.json("out.json");
        assert_eq!(document["warnings"][0]["cause"], cause);
        assert_eq!(document["during"]["part"], "base");
        assert_eq!(document["during"]["from_line"].is_null(), cause == "drift");
        assert_eq!(document["changes"].as_array().unwrap().len(), 0);
    }
    folder.write(
        "heavy.csv",
        changed(&moved("q3_deg", 0.1), |names, fields| {
            let at = names.iter().position(|n| *n == "payload_kg").unwrap();
            fields[at] = "30".to_owned();
        }),
    );
    let outcome = does_not_hold(run("heavy.csv"));
    assert!(
        outcome.stderr.starts_with("warning: heavy.csv: 20 of 20"),
        "{outcome:#?}"
    );
    assert!(
        outcome.stderr.contains("help: check with a payload of"),
        "{outcome:#?}"
    );
    assert!(!outcome.stderr.contains("joint 3"), "{outcome:#?}");
    let document = folder.json("out.json");
    assert_eq!(document["is_searched"], false);
    assert_eq!(document["untrained_payload"].as_array().unwrap().len(), 20);
}

/// A model that does not know its own error does not separate it from the noise, and if it is the cause of the error, more poses
/// do not help.
#[test]
fn a_model_that_is_too_simple_is_named() {
    let _texts = texts();
    let folder = folder();
    let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out poe.blob");
    folder.run(&line).ok();
    let line = "check poe.blob fresh.csv --max-mm 0.05 --json out.json";
    let outcome = folder.run(line);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let document = folder.json("out.json");
    assert!(document["noise_mm"].is_null() && document["noise_mrad"].is_null());
    let scatter = document["scatter_mm"].as_f64().unwrap();
    assert!(
        outcome
            .stdout
            .contains(&format!("together: {scatter:.4} mm")),
        "{outcome:#?}"
    );
    assert!(outcome.stderr.contains("--method elastic"), "{outcome:#?}");
    assert!(!outcome.stderr.contains("100 poses"), "{outcome:#?}");
    // Nor does it know the payloads of its training, under which a joint may seem to have changed.
    folder.write("joint.csv", moved("q5_deg", 0.3));
    let outcome = does_not_hold(folder.run("check poe.blob joint.csv --max-mm 0.05"));
    let payload = "warning: joint.csv: these measurements have a payload of";
    assert!(outcome.stderr.starts_with(payload), "{outcome:#?}");
    assert!(
        outcome.stderr.contains("help: first make sure"),
        "{outcome:#?}"
    );
}

/// Returns joints whose changes the check cannot see.
fn hidden_joints(document: &serde_json::Value) -> Vec<u64> {
    let all = document["sensitivity"].as_array().unwrap().iter();
    let hidden = all.filter(|s| s["smallest"].is_null());
    hidden
        .map(|s| s["part"]["joint"].as_u64().unwrap())
        .collect()
}

#[test]
fn base_and_tool_that_were_set_up_again() {
    let _texts = texts();
    let folder = folder();
    let turned = changed(&moved("q3_deg", 0.02), |names, fields| {
        let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
        // The instrument is turned by a quarter turn about its z and moved by two metres.
        let number = |fields: &[String], name: &str| fields[at(name)].parse::<f64>().unwrap();
        let (x, y) = (number(fields, "x_mm"), number(fields, "y_mm"));
        fields[at("x_mm")] = format!("{:.6}", 2000.0 - y);
        fields[at("y_mm")] = format!("{x:.6}");
        let q = ["qw", "qx", "qy", "qz"].map(|name| number(fields, name));
        let s = 0.5_f64.sqrt();
        let new = [q[0] - q[3], q[1] - q[2], q[2] + q[1], q[3] + q[0]];
        for (name, value) in ["qw", "qx", "qy", "qz"].iter().zip(new) {
            fields[at(name)] = format!("{:.12}", s * value);
        }
    });
    folder.write("turned.csv", turned);
    let refused = folder.run("check arm.blob turned.csv --max-mm 0.15");
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    refused.said();
    for options in ["--fit-base", "--fit-base --fit-tool"] {
        let line = format!("check arm.blob turned.csv --max-mm 0.15 {options} --json out.json");
        does_not_hold(folder.run(&line));
        let document = folder.json("out.json");
        assert_eq!(document["changes"].as_array().unwrap().len(), 1);
        // A change of joint 1 looks like one of the base, and a change of joint 6 like one of the tool.
        let hidden = hidden_joints(&document);
        assert_eq!(
            hidden,
            if options.contains("tool") {
                vec![1, 6]
            } else {
                vec![1]
            }
        );
    }
    let line = "evaluate arm.blob turned.csv --json out.json";
    let outcome = folder.run(line).ok();
    assert!(
        outcome.stderr.contains("warning: turned.csv"),
        "{outcome:#?}"
    );
    let mean = || {
        folder.json("out.json")["sets"][0]["position_mm"]["mean"]
            .as_f64()
            .unwrap()
    };
    let as_it_stands = mean();
    folder.run(&format!("{line} --fit-base")).ok().said();
    assert!(as_it_stands > 1000.0 && mean() < 0.5, "{}", mean());
    folder
        .run(&format!("{line} --fit-base --fit-tool 10"))
        .ok()
        .said();
    assert_eq!(folder.json("out.json")["sets"][0]["poses"], 10);
    folder.refuses("evaluate arm.blob turned.csv --fit-base --fit-tool 1");
    folder.refuses("evaluate arm.blob turned.csv --fit-tool 20");
    let session = format!(
        "session,{}",
        simulated("test2", 20).replace('\n', "\nmonday,")
    );
    folder.write("session.csv", session.trim_end_matches("monday,"));
    let line = "check arm.blob session.csv --max-mm 0.15 --fit-tool";
    folder.run(line).ok().said();
    folder.run(&format!("{line} 8 --json out.json")).ok().said();
    assert_eq!(folder.json("out.json")["poses"], 12);
}

#[test]
fn positions_alone_and_other_models() {
    let _texts = texts();
    let folder = folder();
    let positions = without(&moved("y_mm", -0.2), &ORIENTATION);
    let truth: Vec<&str> = positions.lines().next().unwrap().split(',').collect();
    let truth: Vec<&str> = truth
        .into_iter()
        .filter(|n| n.starts_with("true_"))
        .collect();
    folder.write("positions.csv", without(&positions, &truth));
    does_not_hold(folder.run("check arm.blob positions.csv --max-mm 0.15"));
    // A calibration with positions alone does not know the target's orientation, so no orientation error is reported.
    folder.write(
        "train-positions.csv",
        without(&simulated("train", 150), &ORIENTATION),
    );
    let line =
        format!("calibrate --robot {SERIAL} train-positions.csv --method poe --out positions.blob");
    folder.run(&line).ok();
    folder.refuses("check positions.blob fresh.csv --max-mm 5 --max-drift-mm 5");
    let line = "check positions.blob fresh.csv --max-mm 5 --max-drift-mm 5 --fit-tool";
    folder.run(line).ok();
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --weighting noise --out poe.blob"
    );
    folder.run(&line).ok();
    folder
        .run("check poe.blob fresh.csv --max-mm 5 --max-drift-mm 5")
        .ok()
        .said();
}

#[test]
fn what_cannot_be_checked_is_refused() {
    let _texts = texts();
    let folder = folder();
    folder.write("three.csv", simulated("test2", 3));
    folder.refuses("check arm.blob three.csv --max-mm 0.15");
    // Twenty rows of one pose count as one pose.
    let fresh = simulated("test2", 1);
    let (header, row) = fresh.trim_end().split_once('\n').unwrap();
    folder.write(
        "same.csv",
        format!("{header}\n") + &format!("{row}\n").repeat(20),
    );
    folder.refuses("check arm.blob same.csv --max-mm 0.15 --fit-base");
    folder.refuses("evaluate arm.blob same.csv --fit-base");
    folder.write(
        "bare.csv",
        without(&simulated("test2", 20), &["payload_kg"]),
    );
    folder.refuses("check arm.blob bare.csv --max-mm 0.15");
    for options in [
        "",
        "--max-mm 0",
        "--max-mm 1 --max-drift-mm nan",
        "--max-mm 1 --false-alarms 0",
        "--max-mm 1 --position-sigma-mm 0",
        "--max-mm 1 --correct-drift",
    ] {
        folder.refuses(format!("check arm.blob fresh.csv {options}"));
    }
}

/// The rows that a model was fitted to hardly show its errors, so they are no evidence.
#[test]
fn training_data_are_no_evidence() {
    let _texts = texts();
    let folder = folder();
    folder.refuses("check arm.blob train.csv --max-mm 0.15");
    folder.refuses(format!(
        "compare --robot {SERIAL} train.csv --test train.csv --folds 0 --methods poe"
    ));
    folder.refuses(format!(
        "calibrate --robot {SERIAL} train.csv --test train.csv --method poe --out new.blob"
    ));
    // Training rows are recognised with other line ends, in another order and in another file, and poses count once.
    let train = folder.text("train.csv");
    let rows: Vec<&str> = train.lines().filter(|l| !l.starts_with('#')).collect();
    let reversed: Vec<&str> = rows.iter().skip(1).rev().copied().collect();
    folder.write("crlf.csv", train.replace('\n', "\r\n"));
    folder.write("reversed.csv", [&rows[..1], &reversed].concat().join("\n"));
    folder.write("last.csv", [rows[0], rows[rows.len() - 1]].join("\n"));
    // Exported again with fewer digits.
    let rounded = |row: &&str| {
        let fields = row
            .split(',')
            .enumerate()
            .map(|(i, field)| match field.parse::<f64>() {
                Ok(value) if (1..=9).contains(&i) => format!("{value:.3}"),
                _ => field.to_owned(),
            });
        fields.collect::<Vec<_>>().join(",")
    };
    let rounded: Vec<String> = rows.iter().map(rounded).collect();
    folder.write("rounded.csv", rounded.join("\n"));
    for tests in [
        "crlf.csv",
        "reversed.csv",
        "last.csv",
        "rounded.csv",
        "fresh.csv --test fresh.csv",
    ] {
        folder.refuses(format!(
            "compare --robot {SERIAL} train.csv --test {tests} --folds 0 --methods poe"
        ));
    }
    // A copy counts as the same file.
    folder.write("copy.csv", folder.text("train.csv"));
    folder.refuses("check arm.blob copy.csv --max-mm 0.15");
    // Errors of training data are reported on request, and named as such.
    let line = |file: &str| format!("evaluate arm.blob {file} --json out.json");
    let outcome = folder.run(&line("train.csv")).ok().said();
    assert!(outcome.stderr.contains("its errors elsewhere are larger"));
    assert_eq!(folder.json("out.json")["training_data"], true);
    let outcome = folder.run(&line("fresh.csv")).ok();
    assert_eq!(outcome.stderr, "");
    assert_eq!(folder.json("out.json")["training_data"], false);
}

/// A stated noise that is too large hides drift, so it causes a warning, as an option and as a column.
#[test]
fn a_wrong_stated_noise_is_warned_of() {
    let folder = folder();
    let check = |flags: &str| {
        let line = format!("check arm.blob fresh.csv --max-mm 0.2 --json out.json {flags}");
        let outcome = folder.run(&line).ok();
        let warnings = folder.json("out.json")["warnings"].to_string();
        (outcome.stdout.contains("may be hidden"), warnings)
    };
    assert!(!check("").0);
    // A user who sees nothing else must see it, too.
    let line = "--quiet check arm.blob fresh.csv --max-mm 0.2 --position-sigma-mm 0.3";
    assert!(folder.run(line).ok().stderr.contains("may be hidden"));
    let (is_hidden, warnings) = check("--position-sigma-mm 0.3");
    assert!(is_hidden && warnings.contains("noise"), "{warnings}");
    for sigma in ["5", "0.00001"] {
        let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out new.blob");
        let outcome = folder
            .run(&format!("{line} --position-sigma-mm {sigma}"))
            .ok();
        assert!(outcome.stderr.contains("[noise]"), "{outcome:#?}");
    }
}
