//! The help of the program.

use crate::program::Folder;
use crate::texts::{record, texts};

/// The reference of the JSON documents, with a heading for each command.
const JSON: &str = include_str!("../../../docs/reference/json.md");

/// Collects the commands that the help of `command` lists, and their subcommands.
fn commands(folder: &Folder, command: &str, out: &mut Vec<String>) {
    let help = folder.run(&format!("{command} --help")).ok().stdout;
    let listed = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| line.starts_with("  "))
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help");
    for name in listed {
        let whole = format!("{command} {name}").trim().to_owned();
        out.push(whole.clone());
        commands(folder, &whole, out);
    }
}

#[test]
fn every_help() {
    let _texts = texts();
    let folder = Folder::new();
    let version = folder.run("--version").ok().stdout;
    assert_eq!(version, format!("trainer {}\n", env!("CARGO_PKG_VERSION")));
    let overview = folder.run("--help").ok();
    record(&overview.line, &overview.stdout);
    let mut all = Vec::new();
    commands(&folder, "", &mut all);
    assert!(all.len() > 25, "{all:?}");
    for command in all {
        let outcome = folder.run(&format!("{command} --help")).ok();
        let help = &outcome.stdout;
        record(&outcome.line, help);
        // Every help has an example and the exit codes.
        let word = format!("trainer {}", command.split(' ').next().unwrap());
        let examples = help.split("Example").nth(1).unwrap_or_default();
        assert!(examples.contains(&word), "{command}\n{help}");
        assert!(help.contains("130 stopped by Ctrl-C"), "{command}");
        assert!(help.contains("--quiet"), "{command}");
        // A group of commands has no result of its own, and `completions` prints only a script.
        let is_group = help.contains("\nCommands:\n");
        let reports = !is_group && command != "completions";
        assert_eq!(help.contains("--json <FILE>"), reports, "{command}");
        let code = format!("`{command}`");
        let in_heading = |line: &str| line.starts_with("### ") && line.contains(&code);
        assert!(!reports || JSON.lines().any(in_heading), "{command}");
    }
}

#[test]
fn what_cannot_be_meant_is_a_usage_error() {
    let _texts = texts();
    let folder = Folder::new();
    for line in [
        "",
        "calibrat",
        "calibrate",
        "compare --robot ur5",
        "compare --robot ur5 train.csv --methods gp",
        "compare --robot ur5 train.csv --folds 1",
        "compare --robot ur5 train.csv --folds -3",
        "calibrate --robot ur5 train.csv --method poe --out a.blob --max-correction-mm 0",
        "calibrate --robot ur5 train.csv --method poe --out a.blob --max-correction-mrad nan",
        "simulate --robot ur5 --poses 0 --out a",
        "simulate --robot ur5 --payloads 1,-2 --out a",
        "simulate --robot ur5 --payloads 1,nan --out a",
        "inspect a.blob b.blob",
    ] {
        folder.refuses(line);
    }
}
