//! Records: pages that repeat a record agree with it, and each record states its date.

use std::fs;
use std::path::{Path, PathBuf};

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn document(name: &str) -> String {
    fs::read_to_string(workspace().join(name)).unwrap()
}

/// The list of planted faults names every patch beside its test, and the evidence states their number.
#[test]
fn every_planted_fault_stands_beside_its_law() {
    let page = document("tests/faults/README.md");
    let evidence = document("docs/evidence/verification-evidence.md");
    let mut faults = 0;
    for entry in fs::read_dir(workspace().join("tests/faults")).unwrap() {
        let path = entry.unwrap().path();
        let Some(name) = path
            .file_name()
            .unwrap()
            .to_str()
            .unwrap()
            .strip_suffix(".patch")
        else {
            continue;
        };
        let patch = fs::read_to_string(&path).unwrap();
        let test = patch.lines().find_map(|line| line.strip_prefix("Test: "));
        let law = format!("`{}`", test.unwrap().rsplit(' ').next().unwrap());
        let fault = format!("`{name}`");
        let beside = |line: &str| line.contains(&law) && line.contains(&fault);
        assert!(page.lines().any(beside), "{fault} beside {law}");
        faults += 1;
    }
    assert!(
        evidence.contains(&format!("[all {faults}]")),
        "{faults} faults"
    );
    let listed = page.lines().filter(|line| line.starts_with("- `"));
    let listed: usize = listed.map(|line| line.matches('`').count() / 2 - 1).sum();
    assert_eq!(listed, faults, "faults without a patch");
}

/// Returns the cells of the table below `heading`, row by row.
fn table(page: &str, heading: &str) -> Vec<Vec<String>> {
    let (_, rest) = page.split_once(&format!("\n{heading}\n")).unwrap();
    let rows = rest.lines().skip_while(|line| !line.starts_with('|'));
    let cells = |line: &str| {
        let cells = line.trim_matches('|').split('|');
        cells.map(|cell| cell.trim().replace("**", "")).collect()
    };
    rows.take_while(|line| line.starts_with('|'))
        .skip(2)
        .map(cells)
        .collect()
}

/// The mean errors in the README are those of the record, which has at least as many digits.
#[test]
fn the_errors_of_the_readme_are_those_of_the_record() {
    let (readme, record) = (
        document("README.md"),
        document("docs/evidence/performance.md"),
    );
    let measured = table(&record, "### Measured robots");
    let simulated = table(&record, "### Simulated by another program");
    let shown = table(&readme, "## Results");
    assert_eq!(shown.len(), measured.len() + 1);
    for row in &shown {
        let recorded: Vec<&str> = if row[0].starts_with("simulated") {
            let paper = simulated
                .iter()
                .find(|recorded| recorded[0] == "paper")
                .unwrap();
            [1, 2, 3, 6].map(|column| paper[column].as_str()).to_vec()
        } else {
            let of_robot = |recorded: &&Vec<String>| {
                row[0]
                    .split(", ")
                    .all(|part| recorded[0].split(", ").any(|other| other == part))
            };
            let recorded = measured.iter().find(of_robot).unwrap();
            recorded[1..5]
                .iter()
                .map(|cell| cell.split(' ').next().unwrap())
                .collect()
        };
        for (shown, recorded) in row[1..].iter().zip(recorded) {
            let (Ok(shown_value), Ok(value)) = (shown.parse::<f64>(), recorded.parse::<f64>())
            else {
                assert_eq!(shown, recorded, "{row:?}");
                continue;
            };
            assert!(
                (shown_value - value).abs() <= 0.5e-3 + 1e-9,
                "{shown}, recorded {recorded}: {row:?}"
            );
        }
    }
}

/// Records that no test repeats state the day and the commit at which they were made.
#[test]
fn records_have_a_day_and_a_commit() {
    for (page, headings) in [
        (
            "performance",
            &[
                "## Record",
                "### Simulated by another program",
                "### Measured robots",
                "### Accuracy beside other programs",
                "### Beside scikit-learn",
                "### Growth",
                "### Number of inducing points",
            ][..],
        ),
        (
            "singularities",
            &["## The oracle", "## What remains on fitted robots"],
        ),
        (
            "verification-evidence",
            &[
                "## Fuzzing",
                "## Drift checks",
                "## Planned poses",
                "## Emulated commands",
            ],
        ),
    ] {
        let text = document(&format!("docs/evidence/{page}.md"));
        for heading in headings {
            let (_, rest) = text.split_once(&format!("\n{heading}\n")).unwrap();
            let section = rest.split("\n#").next().unwrap().replace('\n', " ");
            let place = format!("{page}, {heading}");
            let when = section.split("ecorded on ").nth(1);
            let when = when.unwrap_or_else(|| panic!("{place}: no day"));
            let (day, commit) = when.split_once(" at commit ").unwrap();
            assert!(day.starts_with("20") && day.len() == 10, "{place}: {day}");
            let digits = commit.chars().take_while(char::is_ascii_hexdigit);
            assert!(digits.count() >= 7, "{place}: {commit}");
        }
    }
}
