//! `--support-per-output`: a support set for each joint, in the blob, in what is told of it, and in a budget.

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

#[test]
fn a_support_set_for_each_joint_is_fitted_told_and_evaluated() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 100));
    folder.write("test.csv", simulated("test1", 100));
    let calibrate = |flags: &str| {
        let line = format!("calibrate --robot {SERIAL} train.csv {flags} --out arm.blob --json -");
        let told = folder.run(&line).ok().json();
        let facts = folder.run("inspect arm.blob --json -").ok().json();
        let set = folder
            .run("evaluate arm.blob test.csv --json -")
            .ok()
            .json()["sets"][0]
            .clone();
        (told, facts, set["position_mm"]["mean"].as_f64().unwrap())
    };
    let (_, facts, shared) = calibrate("--method elastic");
    assert_eq!(facts["format_version"], 1);
    assert!(facts["correction"]["support_per_output"].is_null());
    for (flags, functions) in [
        ("--support-per-output", 200),
        ("--support-per-output 60", 60),
    ] {
        let (told, facts, error) = calibrate(flags);
        let support = told["elastic"]["inducing_points"].as_u64().unwrap();
        // Fewer only when nothing is left that a further one could say.
        assert!(
            (functions.min(50)..=functions).contains(&support),
            "{support}"
        );
        assert_eq!(facts["format_version"], 1);
        assert_eq!(facts["correction"]["inducing_points"], support);
        let sets = facts["correction"]["support_per_output"]
            .as_array()
            .unwrap();
        assert_eq!(sets.len(), 6);
        let sum: u64 = sets.iter().map(|points| points.as_u64().unwrap()).sum();
        assert_eq!(sum, support);
        assert!(error < 1.05 * shared, "{flags}: {error} of {shared}");
    }
    folder.run("inspect arm.blob").ok().said();
    // The same data, the same bytes.
    let first = folder.read("arm.blob");
    calibrate("--support-per-output 60");
    assert_eq!(folder.read("arm.blob"), first);
}

#[test]
fn what_does_not_go_with_support_sets_is_refused() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    for flags in [
        "--support-per-output --tied",
        "--support-per-output 100 --support 50",
        "--support-per-output 0",
        "--support-per-output many",
    ] {
        folder.refuses(format!(
            "calibrate --robot {SERIAL} train.csv {flags} --out arm.blob"
        ));
    }
}
