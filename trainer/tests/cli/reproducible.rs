//! The same input gives the same bytes.

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

#[test]
fn blobs_are_the_same_bytes() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 50));
    for flags in ["", "--per-output", "--weighting noise"] {
        let calibrate = |out: &str, day: &str| {
            let line = format!(
                "calibrate --robot {SERIAL} train.csv --method poe-gp-load {flags} --out {out}"
            );
            folder.run_dated(&line, day).ok();
            folder.read(out)
        };
        let blob = calibrate("a.blob", "1700000000");
        assert_eq!(blob, calibrate("b.blob", "1700000000"), "{flags}");
        let other_day = calibrate("c.blob", "0");
        assert_ne!(blob, other_day, "the date is in the blob");
        assert_eq!(
            folder.run("inspect c.blob --json -").json()["date"],
            "1970-01-01"
        );
    }
}

#[test]
fn folds_and_simulations_are_drawn_with_a_seed() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let compare = |seed: &str| {
        let line =
            format!("compare --robot {SERIAL} train.csv --methods poe --folds 4 {seed} --json -");
        folder.run(&line).ok().said().json()["methods"].clone()
    };
    let first = compare("");
    assert_eq!(first, compare("--seed 1"));
    assert_ne!(first, compare("--seed 2"));

    let simulate = |seed: u64, out: &str| {
        let line = format!(
            "simulate --robot ur5 --poses 5 --payloads 1,2 --test-sets 1 --seed {seed} --out {out}"
        );
        folder.run(&line).ok();
        ["train.csv", "test1.csv"].map(|name| folder.read(&format!("{out}/{name}")))
    };
    let set = simulate(7, "a");
    assert_eq!(set, simulate(7, "b"));
    assert_ne!(set, simulate(8, "c"));
}
