//! The structure of the JSON documents, on which other programs rely.

use serde_json::Value;

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

/// Names of an object's members, sorted.
fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    keys.sort_unstable();
    keys
}

/// Checks `poses` and the five figures of position and orientation, including their order of size.
#[track_caller]
fn check_errors(errors: &Value, poses: usize) {
    assert_eq!(errors["poses"], poses, "{errors}");
    for quantity in ["position_mm", "orientation_mrad"] {
        let figures = &errors[quantity];
        assert_eq!(keys(figures), ["max", "mean", "median", "p95", "rms"]);
        let of = |name: &str| figures[name].as_f64().unwrap();
        assert!(of("mean") > 0.0 && of("mean") <= of("rms"), "{figures}");
        assert!(of("median") <= of("p95") && of("p95") <= of("max"));
        assert!(of("rms") <= of("max"));
    }
}

#[test]
fn compare() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    for set in ["test1", "test2"] {
        folder.write(&format!("{set}.csv"), simulated(set, 15));
    }
    let sets = "--test test1.csv --test test2.csv";
    let line = format!("compare --robot {SERIAL} train.csv {sets} --folds 4 --json out.json");
    folder.run(&line).ok();
    let document = folder.json("out.json");
    assert_eq!(document["version"], env!("CARGO_PKG_VERSION"));
    let models = document["methods"].as_array().unwrap();
    let names = ["base-tool", "poe", "poe-gp", "poe-gp-load"];
    assert!(models.len() >= names.len());
    for (model, name) in models.iter().zip(names) {
        assert_eq!(model["method"], name);
        check_errors(&model["cross_validation"], 40);
        let sets = model["sets"].as_array().unwrap();
        assert_eq!(sets.len(), 2);
        for (set, name) in sets.iter().zip(["test1.csv", "test2.csv"]) {
            assert_eq!(set["name"], name);
            check_errors(set, 15);
        }
    }
    // The name of a model is its name in --methods, whatever the flags.
    let flags = "--methods poe-gp,poe --per-output --weighting noise --folds 0";
    let line = format!("compare --robot {SERIAL} train.csv {sets} {flags} --json -");
    let document = folder.run(&line).ok().json();
    assert_eq!(document["methods"][0]["method"], "poe-gp");
    assert_eq!(document["methods"][1]["method"], "poe");
    assert_eq!(document["per_output"], true);
    assert_eq!(document["weighting"], "noise");
    assert_eq!(document["methods"][0]["sets"][1]["poses"], 15);
}

#[test]
fn calibrate_evaluate_and_inspect() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    folder.write("test.csv", simulated("test1", 15));
    for (flags, sets) in [("", 1), ("--per-output", 6)] {
        let line = format!(
            "calibrate --robot {SERIAL} train.csv --method poe-gp-load {flags} --serial-number A7 \
             --max-correction-mm 4 --max-correction-mrad 3 --out arm.blob --json -"
        );
        let document = folder.run(&line).ok().json();
        assert_eq!(document["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(document["method"], "poe-gp-load");
        check_errors(&document["training"], 40);
        assert_eq!(document["step1"]["parameters"], 42);
        assert_eq!(document["step1"]["identifiable"], 30);
        assert_eq!(document["hyperparameters"].as_array().unwrap().len(), sets);
        assert_eq!(
            (
                &document["correction_limit_mm"],
                &document["correction_limit_mrad"]
            ),
            (&4.0.into(), &3.0.into())
        );

        let facts = folder.run("inspect arm.blob --json -").ok().json();
        assert_eq!(facts["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(facts["method"], "poe-gp-load");
        assert_eq!(facts["robot"]["name"], SERIAL);
        assert_eq!(facts["robot"]["serial_number"], "A7");
        assert_eq!(facts["robot"]["joints"].as_array().unwrap().len(), 6);
        assert_eq!(facts["training_poses"], 40);
        assert_eq!(facts["date"], "2023-11-14");
        assert_eq!(facts["correction"]["inputs"], 7);
        assert_eq!(facts["correction"]["inducing_points"], 40);
        folder.run("inspect arm.blob").ok().said();

        let line = "evaluate arm.blob test.csv --json -";
        let document = folder.run(line).ok().json();
        assert_eq!(document["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(document["method"], "poe-gp-load");
        let sets = document["sets"].as_array().unwrap();
        assert_eq!(sets.len(), 1);
        assert_eq!(sets[0]["name"], "test.csv");
        check_errors(&sets[0], 15);
        check_errors(&sets[0]["against_truth"], 15);
    }
}

/// Every warning that a command prints is in its JSON document: those that come with the results, too.
#[test]
fn every_printed_warning_is_in_the_document() {
    let folder = crate::check::folder();
    // The second joint of the test poses was turned: no fold expects such errors.
    let turned = crate::program::changed(&simulated("test2", 20), |names, fields| {
        let at = names.iter().position(|n| *n == "x_mm").unwrap();
        fields[at] = format!("{:.9}", fields[at].parse::<f64>().unwrap() + 2.0);
    });
    folder.write("turned.csv", turned);
    for (line, words) in [
        (
            format!("calibrate --robot {SERIAL} train.csv --out new.blob --test turned.csv"),
            "the error of the test files is",
        ),
        (
            "check arm.blob fresh.csv --max-mm 0.2 --position-sigma-mm 0.3".to_owned(),
            "may be hidden",
        ),
        (
            "evaluate arm.blob train.csv".to_owned(),
            "its errors elsewhere are larger",
        ),
    ] {
        // Compares what is printed with the document.
        let outcome = folder.run(&format!("--quiet {line} --json out.json")).ok();
        assert!(outcome.stderr.contains(words), "{outcome:#?}");
        let warnings = folder.json("out.json")["warnings"].to_string();
        assert!(warnings.contains(words), "{warnings}");
    }
}
