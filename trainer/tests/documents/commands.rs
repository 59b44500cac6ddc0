//! The commands of the documents work.

use std::fs;
use std::path::Path;

use crate::blocks::{Background, Block, FIRST, blocks, new_folder, run, run_block, run_in};
use crate::workspace;

#[test]
fn the_commands_work() {
    let folder = run("trainer/tests/documents/examples.txt");
    for file in [
        "arm.blob",
        "compare.json",
        "report.html",
        "predicted.csv",
        "errors.json",
        "corrected.csv",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

/// The README's four commands work on simulated poses of the arm that they name. Cloning and installing are only parsed.
#[test]
fn four_commands_lead_from_a_clone_to_a_report() {
    let folder = new_folder("first");
    let block = blocks("README.md")
        .into_iter()
        .find(|block| block.instruction == FIRST)
        .expect("the README has a block for new users");
    let lines: Vec<&str> = block.text.lines().collect();
    let [clone, enter, install, calibrate] = lines[..] else {
        panic!("four commands, not {lines:#?}");
    };
    assert!(clone.starts_with("git clone ") && enter.starts_with("cd "));
    let package = install.rsplit(' ').next().unwrap();
    assert!(install.starts_with("cargo install "), "{install}");
    assert!(workspace().join(package).join("Cargo.toml").is_file());

    let words: Vec<&str> = calibrate.split_whitespace().collect();
    let robot = words.iter().position(|word| *word == "--robot").unwrap();
    let simulate = format!(
        "trainer simulate --robot {} --poses 60 --test-sets 0 --out cell\n",
        words[robot + 1]
    );
    let background = &mut Background(Vec::new());
    for (text, place) in [(simulate.as_str(), "simulate"), (calibrate, "README.md")] {
        if text == calibrate {
            fs::copy(folder.join("cell/train.csv"), folder.join("measured.csv")).unwrap();
        }
        let block = Block {
            instruction: "run".to_owned(),
            line: block.line,
            text: text.to_owned(),
        };
        run_block(&block, &folder, 0, place, background);
    }
    for file in ["arm.blob", "report.html"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

#[test]
fn the_commands_of_the_tutorial_work() {
    let folder = run("docs/guide/tutorial.md");
    for file in ["plan.mod", "report.html", "check.json"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
    for file in ["program.csv", "from-device.csv"] {
        let text = fs::read_to_string(folder.join(file)).unwrap();
        let rows = text.lines().filter(|line| !line.starts_with('#'));
        assert_eq!(rows.count(), 101, "{file}");
    }
}

#[test]
fn a_file_of_a_tracker_is_imported() {
    let folder = run("trainer/tests/documents/import.txt");
    assert!(folder.join("first.csv").is_file());
}

#[test]
fn the_commands_of_the_page_on_programs_work() {
    let folder = run("docs/guide/into-the-cell.md");
    let [weld, corrected, original] = ["weld.mod", "corrected.mod", "original.mod"]
        .map(|name| fs::read_to_string(folder.join(name)).unwrap());
    assert_ne!(weld, corrected);
    assert!(!folder.join("twice.mod").exists());
    let moves = |text: &str| text.matches("MoveAbsJ").count();
    assert_eq!(moves(&weld), moves(&corrected));
    assert_eq!(original.lines().count(), weld.lines().count());
}

#[test]
fn the_commands_of_the_page_on_projects_work() {
    let folder = run("docs/guide/projects.md");
    assert!(folder.join("other.blob").is_file());
}

/// The project file of one robot of a fleet works on simulated poses of the robot that it names.
#[test]
fn the_project_of_the_page_on_fleets_works() {
    let page = "docs/guide/fleet.md";
    let folder = run(page);
    let text = "trainer simulate --robot abb-irb120 --poses 60 --test-sets 1 --out .\n\
                trainer calibrate fleet.toml --method poe --out arm.blob\n";
    let background = &mut Background(Vec::new());
    for (number, line) in text.lines().enumerate() {
        let block = Block {
            instruction: "run".to_owned(),
            line: number,
            text: format!("{line}\n"),
        };
        run_block(&block, &folder, 0, page, background);
        let _ = fs::rename(folder.join("train.csv"), folder.join("measured.csv"));
        let _ = fs::rename(folder.join("test1.csv"), folder.join("test.csv"));
    }
    assert!(folder.join("arm.blob").is_file());
}

#[test]
fn the_commands_of_the_page_on_results_work() {
    let folder = run("docs/guide/reading-results.md");
    for file in [
        "arm.blob",
        "report.html",
        "compare.html",
        "compare.json",
        "check.json",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

/// Returns x, y, z in mm of every row of a predictions file.
fn positions(file: &Path) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(file).unwrap();
    let row = |line: &str| {
        let mut fields = line.split(',').map(|field| field.parse().unwrap());
        std::array::from_fn(|_| fields.next().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn the_examples_of_robots_and_measurements_work_and_describe_one_robot_three_times() {
    let folder = run("docs/reference/robot-description.md");
    run_in(&folder, "trainer/tests/documents/robots.txt");
    // Calibrated with base-tool, because any other method would fit the differences of the descriptions away.
    let poe = positions(&folder.join("poe.csv"));
    assert_eq!(poe.len(), 20);
    for other in ["dh.csv", "modified-dh.csv"] {
        for (a, b) in poe.iter().zip(positions(&folder.join(other))) {
            let apart = (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
            assert!(apart < 2e-3, "{other}: {apart} mm apart");
        }
    }
    run_in(&folder, "docs/reference/measurement-file.md");
}

#[test]
fn the_examples_of_planning_work() {
    let folder = run("docs/guide/measuring.md");
    for file in ["plan.csv", "check.csv", "plan.mod"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

#[test]
fn the_commands_of_the_page_without_a_tracker_work() {
    let folder = run("docs/guide/without-a-tracker.md");
    for file in [
        "touches.csv",
        "touches.toml",
        "practice/truth.csv",
        "practice.html",
        "measured.csv",
        "arm.blob",
        "corrected.script",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

#[test]
fn the_examples_of_importing_work() {
    let folder = run("docs/guide/import.md");
    for file in ["measured.csv", "points.csv", "tracker.csv.imported"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}
