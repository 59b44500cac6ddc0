//! The demonstration, as a new user runs it.

use serde_json::Value;

use crate::program::{Folder, Outcome};

/// Checks that `docs/evidence/paper.md` quotes the output and has another command that plots the folds.
fn the_page_on_the_paper_is_right(folder: &Folder, outcome: &Outcome) {
    let page = include_str!("../../../docs/evidence/paper.md");
    let block = page.split("```console\n$ trainer demo --out demo\n").nth(1);
    let quoted = block.unwrap().split("\n```").next().unwrap();
    for line in quoted.lines() {
        assert!(outcome.stdout.contains(line), "{line:?}: {outcome:#?}");
    }
    assert!(quoted.lines().count() > 8);
    let command = page
        .lines()
        .find_map(|line| line.strip_prefix("trainer compare"));
    folder.run(&format!("compare{}", command.unwrap())).ok();
    assert!(folder.path("figure1.html").is_file());
}

#[test]
fn everything_that_it_names_is_written_and_works() {
    let folder = Folder::new();
    let outcome = folder.run("demo").ok();
    for word in ["Table I", "87.5 / 71.3 / 63.1 %", "POE + GP with loading"] {
        assert!(outcome.stdout.contains(word), "{word}: {outcome:#?}");
    }
    the_page_on_the_paper_is_right(&folder, &outcome);
    let files = [
        "arm.blob",
        "compare.json",
        "chosen.blob",
        "predictions.csv",
        "report.html",
        "report.json",
        "test1.csv",
        "test2.csv",
        "test3.csv",
        "train.csv",
    ];
    for file in files {
        assert!(outcome.stdout.contains(file), "{file}: {outcome:#?}");
        assert!(folder.path("demo").join(file).is_file(), "{file}");
    }
    assert_eq!(
        std::fs::read_dir(folder.path("demo")).unwrap().count(),
        files.len()
    );

    // The table has the errors of the blob, as another run computes them from the file.
    let mean = |set: &Value| set["position_mm"]["mean"].as_f64().unwrap();
    let compared = folder.json("demo/compare.json");
    assert_eq!(compared["methods"][3]["method"], "poe-gp-load");
    for (i, test) in ["test1.csv", "test2.csv", "test3.csv"].iter().enumerate() {
        let set = &compared["methods"][3]["sets"][i];
        assert_eq!(set["name"], *test);
        let line = format!("evaluate demo/arm.blob demo/{test} --json -");
        let evaluated = folder.run(&line).ok().json();
        assert_eq!(mean(&evaluated["sets"][0]), mean(set), "{test}");
        assert!(outcome.stdout.contains(&format!("{:.2}", mean(set))));
    }
    assert_eq!(folder.text("demo/predictions.csv").lines().count(), 101);
}
