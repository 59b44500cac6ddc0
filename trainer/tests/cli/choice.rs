//! Selection by cross-validation and within budgets: what is chosen, and the tables that show why.

use crate::program::{Folder, SERIAL, simulated};

#[test]
fn the_default_ships_the_simplest_that_is_not_behind_and_shows_its_table() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let line = format!("calibrate --robot {SERIAL} train.csv --out arm.blob --json -");
    let document = folder.run(&line).ok().json();
    let table = document["choice"].as_array().unwrap();
    let chosen: Vec<_> = table.iter().filter(|r| r["chosen"] == true).collect();
    assert_eq!(chosen.len(), 1);
    let chosen = chosen[0];
    let behind = |r: &serde_json::Value| r["behind_best_mm"].as_f64().unwrap();
    let error = |r: &serde_json::Value| r["standard_error_mm"].as_f64().unwrap();
    assert!(behind(chosen) <= error(chosen), "{chosen}");
    let simpler = table.iter().take_while(|r| r["chosen"] == false);
    for row in simpler {
        assert!(
            behind(row) > error(row),
            "a simpler candidate is not behind: {row}"
        );
    }
    // The simulated arm bends under gravity, so neither base and tool nor the chain alone is enough.
    let name = chosen["candidate"].as_str().unwrap();
    assert!(["parametric", "elastic"].contains(&name), "{name}");
    // The model has the name of its row, in every document.
    assert_eq!(document["method"], name);
    assert_eq!(
        folder.run("inspect arm.blob --json -").ok().json()["method"],
        name
    );
}

/// Too few poses to hold any out show no gain, so nothing is written unless the user accepts that.
#[test]
fn what_shows_no_gain_is_refused() {
    let folder = Folder::new();
    folder.write("few.csv", simulated("train", 6));
    for method in ["", "--method poe"] {
        let line =
            format!("calibrate -q --robot {SERIAL} few.csv {method} --accept few --out arm.blob");
        let refused = folder.run(&line);
        assert_eq!(refused.code, Some(3), "{refused:?}");
        assert!(refused.stderr.contains("gain"), "{refused:?}");
        assert!(!folder.path("arm.blob").exists());
    }
    let line = format!(
        "calibrate -q --robot {SERIAL} few.csv --accept few --accept gain --out arm.blob --json -"
    );
    let accepted = folder.run(&line).ok();
    assert!(accepted.stderr.contains("warning"), "{accepted:?}");
    let document = accepted.json();
    let warnings = document["warnings"].as_array().unwrap();
    let warning = warnings.iter().find(|w| w["cause"] == "gain").unwrap();
    assert!(warning["value"].as_f64().unwrap() >= warning["threshold"].as_f64().unwrap());
    assert!(folder.path("arm.blob").is_file());
    let causes: Vec<_> = warnings.iter().map(|w| w["cause"].clone()).collect();
    let blob = folder.run("inspect arm.blob --json -").ok().json();
    // The blob has the same causes as the document, in its own order.
    for cause in blob["warnings"].as_array().unwrap() {
        assert!(causes.contains(cause), "{cause} is not in {causes:?}");
    }
    for cause in &causes {
        let kept = blob["warnings"].as_array().unwrap();
        assert!(kept.contains(cause), "{cause} is not in {kept:?}");
    }
    assert_eq!(blob["accepted"], serde_json::json!(["few", "gain"]));
}

/// A method that the user names is kept. If a simpler one has smaller held-out errors, a warning says so, also with `-q`.
#[test]
fn a_named_method_that_a_simpler_one_beats_is_warned_of() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 9));
    let line = format!(
        "calibrate -q --robot {SERIAL} train.csv --method poe-gp --accept gain --out arm.blob --json -"
    );
    let outcome = folder.run(&line);
    assert_ne!(
        outcome.code,
        Some(0),
        "nine poses are too few: ten are needed"
    );
    folder.write("train.csv", simulated("train", 14));
    let document = folder.run(&line).ok().json();
    assert_eq!(document["method"], "poe-gp");
    let causes: Vec<_> = document["warnings"].as_array().unwrap().iter().collect();
    assert!(causes.iter().any(|w| w["cause"] == "model"), "{causes:?}");
}

#[test]
fn a_budget_is_kept_and_its_price_is_told() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    let calibrate = format!("calibrate --robot {SERIAL} train.csv --out arm.blob");
    let elastic = format!("{calibrate} --method elastic");
    for (limit, trials) in [(27_000, 3), (21_000, 2)] {
        let line = format!("{elastic} --max-instructions {limit} --json -");
        let document = folder.run(&line).ok().json();
        let table = document["budget"].as_array().unwrap();
        assert_eq!(
            table.len(),
            trials,
            "rows: without a budget, within it, parametric"
        );
        let taken = table.iter().find(|r| r["chosen"] == true).unwrap();
        assert!(taken["instructions"].as_u64().unwrap() <= limit);
        let mean = |r: &serde_json::Value| r["position_mm"]["mean"].as_f64().unwrap();
        assert!(table[1..].iter().all(|r| mean(taken) <= mean(r)));
        // Read from the blob itself, as the device sees it.
        assert_eq!(document["blob"]["instructions"], taken["instructions"]);
        assert_eq!(
            document["elastic"]["inducing_points"],
            taken["inducing_points"]
        );
    }

    folder.run(&format!("{elastic} --max-blob-bytes 3000")).ok();
    assert!(folder.read("arm.blob").len() <= 3_000);

    // A budget that cannot be met is an error, and the old blob stays.
    let before = folder.read("arm.blob");
    let refused = folder.run(&format!("{calibrate} --max-instructions 100"));
    assert_eq!(refused.code, Some(1), "{refused:?}");
    assert_eq!(folder.read("arm.blob"), before);
    let wrong = folder.run(&format!("{calibrate} --method poe --max-instructions 9000"));
    assert_eq!(wrong.code, Some(2), "{wrong:?}");
}

/// From few poses, the program does not state that more poses do not pay.
#[test]
fn few_poses_do_not_say_that_more_do_not_pay() {
    let folder = Folder::new();
    folder.write("few.csv", simulated("train", 8));
    let line = format!("calibrate --robot {SERIAL} few.csv --accept gain --out arm.blob");
    let said = folder.run(&line).ok();
    assert!(!said.stdout.contains("do not pay"), "{said:?}");
    assert!(said.stdout.contains("next: "), "{said:?}");
}

/// With limits of the size, cross-validation still selects the model. Options that the selection ignores are reported.
#[test]
fn a_limit_names_no_method() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let calibrate = format!("calibrate --robot {SERIAL} train.csv --out arm.blob --json -");
    let limits = "--inducing-points 60 --max-instructions 30000 --weighting none --per-output";
    let limited = folder.run(&format!("{calibrate} {limits}")).ok();
    for option in ["--weighting", "--per-output"] {
        let note = format!("note: {option} has no effect");
        assert!(limited.stderr.contains(&note), "{limited:?}");
    }
    let limited = limited.json();
    assert_eq!(limited["choice"].as_array().unwrap().len(), 4);
    let reason = limited["chosen"].as_str().unwrap();
    assert!(!reason.contains("requested"), "{reason}");
    assert!(limited["blob"]["instructions"].as_u64().unwrap() <= 30_000);
}
