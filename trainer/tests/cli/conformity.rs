//! A tolerance, its verdict, and the certificate.

use serde_json::Value;

use crate::program::{Folder, Outcome, SERIAL, changed, simulated};
use crate::texts::texts;

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    folder.write("test.csv", simulated("test1", 40));
    folder
}

fn calibrate(folder: &Folder, flags: &str) -> Outcome {
    folder.run(&format!(
        "calibrate --robot {SERIAL} train.csv --test test.csv --method poe --out arm.blob --json arm.json {flags}"
    ))
}

fn position(document: &Value) -> [f64; 2] {
    let position = &document["certificate"]["conformity"]["position"];
    ["error", "expanded"].map(|name| position[name].as_f64().unwrap())
}

/// The simulated instrument has 0.03 mm of noise. Four times as much is said, and the verdict uses what the fit found.
#[test]
fn a_noise_that_is_stated_too_large_is_said() {
    let folder = folder();
    let fit = |flags: &str| {
        let line = format!(
            "calibrate --robot {SERIAL} train.csv --test test.csv --method parametric --out arm.blob --json arm.json \
             --tolerance-mm 5 {flags}"
        );
        let stderr = folder.run(&line).ok().stderr;
        let document = folder.json("arm.json");
        let met = document["certificate"]["conformity"]["position"]["met"].as_f64();
        (stderr, document["warnings"].to_string(), met.unwrap())
    };
    let text = "but the fitted noise of one component is 0.0";
    let (stated, listed, without) = fit("--position-sigma-mm 0.03");
    assert!(!stated.contains(text) && !listed.contains(text), "{stated}");
    let (stated, listed, met) = fit("--position-sigma-mm 0.12");
    assert!(stated.contains(text) && listed.contains(text), "{stated}");
    assert!(met > 0.8 * without, "{met} {without}");
}

/// The verdict of ISO 14253-1 is in the exit code, in the JSON and on the page.
#[test]
fn the_verdict_follows_the_guard_band() {
    let folder = folder();
    calibrate(&folder, "").ok();
    let [error, expanded] = position(&folder.json("arm.json"));
    assert!(error > 0.0 && expanded > 0.0 && expanded < error);
    for (tolerance, code, verdict, words) in [
        (error + 1.001 * expanded, 0, "conforms", "The arm conforms."),
        (
            error + 0.9 * expanded,
            1,
            "undecided",
            "It cannot be decided",
        ),
        (
            error - 1.001 * expanded,
            1,
            "does-not-conform",
            "The arm does not conform.",
        ),
    ] {
        let flags = format!("--tolerance-mm {tolerance} --report report.html");
        let outcome = calibrate(&folder, &flags);
        assert_eq!(outcome.code, Some(code), "{outcome:#?}");
        // More poses are proposed only where the verdict is undecided.
        let is_undecided = verdict == "undecided";
        assert_eq!(outcome.stderr.contains("more held-out poses"), is_undecided);
        let document = folder.json("arm.json");
        let found = &document["certificate"]["conformity"];
        assert_eq!(found["verdict"], verdict);
        assert_eq!(found["position"]["tolerance"], tolerance);
        let page = folder.text("report.html");
        let (said, results) = (
            page.find(words).unwrap(),
            page.find("id=\"result\"").unwrap(),
        );
        assert!(said < results, "the verdict must come before the results");
        // The blob is written whatever the verdict is.
        assert!(!folder.read("arm.blob").is_empty());
    }
}

/// A program that is run a second time measures the poses of the training again: their errors are learnt, so that they say
/// nothing of other poses.
#[test]
fn the_verdict_leaves_out_poses_that_were_trained_on() {
    let folder = folder();
    let rows = |from: usize, to: usize| -> String {
        let all = simulated("train", to);
        all.lines()
            .skip(1 + from)
            .fold(String::new(), |text, row| text + row + "\n")
    };
    let header = simulated("train", 0);
    let again = |count: usize| {
        changed(&(header.clone() + &rows(0, count)), |names, fields| {
            let x = names.iter().position(|name| *name == "x_mm").unwrap();
            fields[x] = format!("{:.6}", fields[x].parse::<f64>().unwrap() + 0.05);
        })
    };
    folder.write("test.csv", header.clone() + &rows(40, 80));
    calibrate(&folder, "").ok();
    let of_new = folder.json("arm.json")["certificate"]["conformity"].clone();
    folder.write("test.csv", again(20) + &rows(40, 80));
    let outcome = calibrate(&folder, "");
    let said = "warning: test.csv: 20 of 60 rows repeat joints of the training data (within 0.1°)";
    assert!(outcome.stderr.contains(said), "{outcome:#?}");
    assert!(outcome.stderr.contains("[copies]"), "{outcome:#?}");
    outcome.ok();
    let document = folder.json("arm.json");
    assert_eq!(document["certificate"]["conformity"], of_new);
    // Where nothing else was measured, there is no verdict.
    folder.write("test.csv", again(20));
    let outcome = calibrate(&folder, "--tolerance-mm 100");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(outcome.stderr.contains("too few poses"), "{outcome:#?}");
    // A pose or two, such as that at home, are no reason for a warning.
    folder.write("test.csv", again(1) + &rows(40, 80));
    let outcome = calibrate(&folder, "");
    assert!(
        outcome.stderr.contains("note: test.csv: 1 of 41 rows"),
        "{outcome:#?}"
    );
}

/// A coverage of 99 % needs a wider range than one of 68 %.
#[test]
fn coverage_widens_the_range() {
    let folder = folder();
    let expanded = |coverage: &str| {
        calibrate(&folder, &format!("--coverage {coverage}")).ok();
        position(&folder.json("arm.json"))[1]
    };
    let (narrow, wide) = (expanded("0.68"), expanded("0.99"));
    // Normal quantiles are 0.9945 and 2.5758; Student's with ten degrees of freedom are 1.0464 and 3.1693.
    assert!(
        (2.590..=3.030).contains(&(wide / narrow)),
        "{wide} {narrow}"
    );
}

/// Touches give a verdict on positions, from the uncertainty that they leave.
#[test]
fn touches_have_a_verdict() {
    let folder = Folder::new();
    folder
        .run("simulate --robot abb-irb120 --touch socket4 --touches 60 --seed 3 --out touched")
        .ok();
    let calibrate = |flags: &str| {
        folder.run(&format!(
            "calibrate --robot abb-irb120 touched/touches.csv --out arm.blob --json arm.json {flags}"
        ))
    };
    calibrate("").ok();
    assert_eq!(folder.json("arm.json").get("certificate"), None);
    calibrate("--report report.html").ok();
    let document = folder.json("arm.json");
    let [error, expanded] = position(&document);
    assert_eq!(document["certificate"]["conformity"]["evidence"], "touches");
    // The expected error of 95 of 100 poses of one arm is near the 95 % quantile of the errors of all possible arms.
    let stated = document["touches"]["after"]["p95_mm"].as_f64().unwrap();
    assert!((error / stated - 1.0).abs() < 0.2, "{error} {stated}");
    assert!(expanded > 0.0 && expanded < error, "{expanded}");
    for (tolerance, code, verdict) in [
        (error + 1.001 * expanded, 0, "conforms"),
        (error + 0.999 * expanded, 1, "undecided"),
        (error - 1.001 * expanded, 1, "does-not-conform"),
    ] {
        let outcome = calibrate(&format!("--tolerance-mm {tolerance} --report report.html"));
        assert_eq!(outcome.code, Some(code), "{outcome:#?}");
        let document = folder.json("arm.json");
        assert_eq!(document["certificate"]["conformity"]["verdict"], verdict);
        assert!(
            folder
                .text("report.html")
                .contains("No poses were held out.")
        );
    }
    let refused = calibrate("--tolerance-mrad 1");
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert!(refused.stderr.contains("--tolerance-mrad"), "{refused:#?}");
}

/// The stated noise is subtracted from the error, and its uncertainty is the instrument's row of the budget.
#[test]
fn a_stated_noise_is_taken_out() {
    let folder = folder();
    calibrate(&folder, "").ok();
    let [plain, _] = position(&folder.json("arm.json"));
    calibrate(&folder, "--position-sigma-mm 0.2").ok();
    let document = folder.json("arm.json");
    let [error, _] = position(&document);
    assert!(error < 0.99 * plain, "{error} {plain}");
    let row = &document["certificate"]["conformity"]["position"]["budget"][0];
    assert_eq!(row["source"], "instrument");
    assert!(row["standard_uncertainty"].as_f64().unwrap() > 0.0);
}

/// The project file states instrument and operator. They appear on the page and in the JSON, and survive --write-project.
#[test]
fn a_project_states_tolerance_instrument_and_record() {
    let folder = folder();
    calibrate(&folder, "--serial-number 17 --write-project project.toml").ok();
    let plain = position(&folder.json("arm.json"));
    let project = folder.text("project.toml")
        + "\n[tolerance]\nposition_mm = 90.0\n\n[instrument]\nname = \"AT960 no. 5\"\ncertificate = \"K 12, 2026-03-01\"\n\
           expanded_uncertainty_mm = 0.4\n\n[record]\noperator = \"<script>alert(1)</script>\"\nsite = \"hall 3\"\ntemperature_c = 21.5\n";
    folder.write("project.toml", &project);
    let made = folder
        .run("calibrate project.toml --report r.html --json r.json --write-project again.toml")
        .ok();
    assert!(made.stdout.contains("verdict: conforms"), "{made:#?}");
    assert!(!made.stderr.contains("lacks"), "{made:#?}");
    let document = folder.json("r.json");
    let certificate = &document["certificate"];
    assert_eq!(certificate["missing"].as_array().unwrap().len(), 0);
    assert_eq!(certificate["record"]["temperature_c"], 21.5);
    assert_eq!(certificate["program_sha256"].as_str().unwrap().len(), 64);
    // 0.4 mm at k = 2 is a standard uncertainty of 0.2 mm.
    let row = &certificate["conformity"]["position"]["budget"][0];
    assert_eq!(row["standard_uncertainty"], 0.2);
    let [error, expanded] = position(&document);
    assert_eq!(error, plain[0]);
    assert!(expanded > plain[1]);
    let page = folder.text("r.html");
    assert!(page.contains("AT960 no. 5") && page.contains("K 12, 2026-03-01"));
    assert!(!page.contains("<script>alert"));
    let again = folder.text("again.toml");
    for line in [
        "position_mm = 90.0",
        "site = \"hall 3\"",
        "expanded_uncertainty_mm = 0.4",
    ] {
        assert!(again.contains(line), "{again}");
    }

    // Without them, the report and a note name what is missing.
    let flags = "--tolerance-mm 90 --report r.html";
    assert!(
        calibrate(&folder, flags)
            .ok()
            .stderr
            .contains("lacks the instrument")
    );
    assert!(folder.text("r.html").contains("Missing: the instrument"));
}

#[test]
fn values_out_of_range_are_refused_with_their_line() {
    let _texts = texts();
    let folder = folder();
    calibrate(&folder, "--write-project project.toml").ok();
    let project = folder.text("project.toml");
    for table in [
        "[tolerance]\nposition_mm = 0",
        "[tolerance]\ncoverage = 1.5",
        "[instrument]\nexpanded_uncertainty_mm = -1",
        "[record]\ntemperature_c = inf",
        "[record]\nweather = \"fine\"",
    ] {
        folder.write("bad.toml", format!("{project}\n{table}\n"));
        folder.refuses("calibrate bad.toml");
    }
    for flags in ["--tolerance-mm 0", "--tolerance-mrad x", "--coverage 1"] {
        folder.refuses(format!(
            "calibrate --robot {SERIAL} train.csv --out arm.blob {flags}"
        ));
    }
}

/// Accuracy and repeatability by ISO 9283 for repeated poses, recomputed from the predictions.
#[test]
fn repeated_poses_have_accuracy_and_repeatability() {
    let folder = folder();
    let test = simulated("test1", 40);
    let (header, rows) = test.split_once('\n').unwrap();
    let header = header.trim_start_matches('#');
    let (header, rows) = match header.contains(",x_mm") {
        true => (header.to_owned(), rows.to_owned()),
        // The first line is a comment.
        false => {
            let (header, rows) = rows.split_once('\n').unwrap();
            (header.to_owned(), rows.to_owned())
        }
    };
    let x = header.split(',').position(|name| name == "x_mm").unwrap();
    let lines: Vec<&str> = rows.lines().collect();
    let moved = [0.0, 0.06, -0.03, 0.02, -0.05];
    let mut repeated = header.clone() + "\n";
    for line in &lines {
        repeated += &format!("{line}\n");
    }
    for shift in &moved[1..] {
        let mut fields: Vec<String> = lines[0].split(',').map(str::to_owned).collect();
        fields[x] = format!("{}", fields[x].parse::<f64>().unwrap() + shift);
        repeated += &format!("{}\n", fields.join(","));
    }
    folder.write("test.csv", repeated);
    calibrate(&folder, "").ok();
    let document = folder.json("arm.json");
    let poses = document["certificate"]["repeated_poses"]
        .as_array()
        .unwrap();
    assert_eq!(poses.len(), 1);
    assert_eq!(poses[0]["cycles"], 5);
    // All shifts are along one axis, so the distances from the mean pose are those of the shifts.
    let mean = moved.iter().sum::<f64>() / 5.0;
    let distances: Vec<f64> = moved.iter().map(|m| (m - mean).abs()).collect();
    let l = distances.iter().sum::<f64>() / 5.0;
    let s = (distances.iter().map(|d| (d - l).powi(2)).sum::<f64>() / 4.0).sqrt();
    let found = poses[0]["position_repeatability_mm"].as_f64().unwrap();
    assert!(
        (found - (l + 3.0 * s)).abs() < 1e-9,
        "{found} {}",
        l + 3.0 * s
    );
    assert_eq!(
        document["certificate"]["conformity"]["position"]["poses"],
        40
    );
}

/// Poses that are measured again do not count as new poses, in whichever file they are.
#[test]
fn a_second_file_of_the_same_poses_decides_nothing_more() {
    let folder = folder();
    let again = changed(&folder.text("test.csv"), |names, fields| {
        let x = names.iter().position(|n| *n == "x_mm").unwrap();
        fields[x] = format!("{}", fields[x].parse::<f64>().unwrap() + 0.01);
    });
    folder.write("again.csv", again);
    calibrate(&folder, "--test again.csv").ok();
    let certificate = &folder.json("arm.json")["certificate"];
    assert_eq!(certificate["conformity"]["position"]["poses"], 40);
    assert_eq!(certificate["repeated_poses"].as_array().unwrap().len(), 40);
}

/// A report and its JSON are signed, and `verify` accepts nothing else.
#[test]
fn a_report_and_its_json_are_signed() {
    let _texts = texts();
    let folder = folder();
    calibrate(&folder, "--tolerance-mm 90 --report r.html").ok();
    for name in ["ours", "theirs"] {
        folder.run(&format!("keys new --out {name}")).ok();
    }
    for file in ["r.html", "arm.json"] {
        folder.run(&format!("sign {file} --key ours.key")).ok();
        folder
            .run(&format!("verify {file} --public-key ours.pub"))
            .ok();
        let other = folder.run(&format!("verify {file} --public-key theirs.pub"));
        assert_eq!(other.code, Some(1), "{other:#?}");
    }
    let page = folder.text("r.html");
    folder.write("r.html", page.replacen("90", "91", 1));
    let changed = folder.run("verify r.html --public-key ours.pub --json v.json");
    assert_eq!(changed.code, Some(1), "{changed:#?}");
    assert_eq!(folder.json("v.json")["verified"], false);
    std::fs::remove_file(folder.path("r.html.sig")).unwrap();
    folder.refuses("verify r.html --public-key ours.pub");
    folder.refuses("sign r.html --key ours.key --revision 3");
}

#[test]
fn compare_judges_the_best_model() {
    let folder = folder();
    let line = format!(
        "compare --robot {SERIAL} train.csv --test test.csv --methods base-tool,poe --folds 0"
    );
    let outcome = folder
        .run(&format!(
            "{line} --tolerance-mm 90 --json c.json --report c.html"
        ))
        .ok();
    assert!(
        outcome
            .stdout
            .contains("Verdict on the best model: conforms"),
        "{outcome:#?}"
    );
    assert_eq!(
        folder.json("c.json")["certificate"]["conformity"]["verdict"],
        "conforms"
    );
    let failed = folder.run(&format!("{line} --tolerance-mm 0.001"));
    assert_eq!(failed.code, Some(1), "{failed:#?}");
}

/// A check on fresh poses gives the verdict that the same poses gave at the calibration.
#[test]
fn a_check_judges_as_the_calibration_did() {
    let folder = folder();
    calibrate(&folder, "").ok();
    let made = position(&folder.json("arm.json"));
    let line = "check arm.blob test.csv --max-mm 90 --json check.json --report check.html";
    let outcome = folder.run(&format!("{line} --tolerance-mm 90")).ok();
    assert!(
        outcome
            .stdout
            .contains("Verdict on the tolerance: conforms"),
        "{outcome:#?}"
    );
    let found = position(&folder.json("check.json"));
    for (found, made) in found.iter().zip(&made) {
        assert!((found / made - 1.0).abs() < 1e-4, "{found} {made}");
    }
    assert!(folder.text("check.html").contains("The arm conforms."));
    let failed = folder.run(&format!("{line} --tolerance-mm 0.001"));
    assert_eq!(failed.code, Some(1), "{failed:#?}");
}
