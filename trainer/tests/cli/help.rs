//! What the program says about itself.

use crate::program::Folder;

const ROBOT: [&str; 3] = ["--robot", "--base", "--tip"];
const FIT: [&str; 2] = ["--per-output", "--weighted"];

#[test]
fn every_option_is_in_the_help() {
    let folder = Folder::new();
    let commands: [(&str, Vec<&str>); 14] = [
        (
            "plan",
            [
                &ROBOT[..],
                &[
                    "--count",
                    "--payloads",
                    "--constraints",
                    "--check-poses",
                    "--check-out",
                    "--d-optimal",
                    "--space-filling",
                    "--seed",
                    "--gravity",
                    "--forecast",
                    "--no-forecast",
                    "--out",
                    "--rapid",
                    "--krl",
                    "--urscript",
                    "--fanuc",
                    "--json",
                ],
            ]
            .concat(),
        ),
        (
            "simulate",
            [
                &ROBOT[..],
                &[
                    "--poses",
                    "--test-sets",
                    "--test-poses",
                    "--payloads",
                    "--scenario",
                    "--seed",
                    "--out",
                ],
            ]
            .concat(),
        ),
        (
            "calibrate",
            [
                &ROBOT[..],
                &FIT,
                &[
                    "<TRAIN>",
                    "--model",
                    "--serial-number",
                    "--max-correction-mm",
                    "--max-correction-mrad",
                    "--correct-drift",
                    "--test",
                    "--report",
                    "--out",
                    "--json",
                ],
            ]
            .concat(),
        ),
        (
            "evaluate",
            vec!["<BLOB>", "<TEST>", "--predictions", "--json"],
        ),
        (
            "compare",
            [
                &ROBOT[..],
                &FIT,
                &[
                    "<TRAIN>", "--test", "--models", "--folds", "--seed", "--report", "--json",
                ],
            ]
            .concat(),
        ),
        (
            "correct",
            vec!["<BLOB>", "<TARGETS>", "--payload-kg", "--out", "--json"],
        ),
        (
            "check",
            vec![
                "<MEASUREMENTS>",
                "--max-mm",
                "--statistic",
                "--max-drift-mm",
                "--false-alarms",
                "--refit-base",
                "--refit-tool",
                "--correct-drift",
                "--json",
            ],
        ),
        ("inspect", vec!["<BLOB>", "--json"]),
        (
            "export",
            vec![
                "<BLOB>",
                "--out",
                "--urdf",
                "--base",
                "--tip",
                "--target-link",
                "--ur-kinematics",
                "--dh",
                "--poe",
                "--c-header",
            ],
        ),
        ("import", vec!["<RAWS>", "--map", "--guess", "--out"]),
        ("keys new", vec!["--out <NAME>"]),
        ("sign", vec!["<BLOB>", "--key", "--out"]),
        ("verify", vec!["<BLOB>", "--public-key"]),
        ("demo", vec!["--seed", "--out"]),
    ];
    let overview = folder.run("--help").ok().stdout;
    assert!(overview.contains(
        "Exit codes: 0 done, 1 a quality bound was not met or a signature does not fit, 2"
    ));
    for (command, options) in commands {
        let word = command.split(' ').next().unwrap();
        assert!(overview.contains(word), "{command}");
        let help = folder.run(&format!("{command} --help")).ok().stdout;
        for option in options {
            assert!(help.contains(option), "{command}: {option}\n{help}");
        }
    }
    let models = folder.run("calibrate --help").ok().stdout;
    for model in ["base-tool", "poe", "poe-gp", "poe-gp-load"] {
        assert!(models.contains(model), "{model}");
    }
    let version = folder.run("--version").ok().stdout;
    assert_eq!(version, format!("trainer {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn what_cannot_be_meant_is_a_usage_error() {
    let folder = Folder::new();
    for line in [
        "",
        "calibrat",
        "calibrate",
        "compare --robot ur5",
        "compare --robot ur5 train.csv --models gp",
        "compare --robot ur5 train.csv --folds 1",
        "compare --robot ur5 train.csv --folds -3",
        "calibrate --robot ur5 train.csv --model poe --out a.blob --max-correction-mm 0",
        "calibrate --robot ur5 train.csv --model poe --out a.blob --max-correction-mrad nan",
        "simulate --robot ur5 --poses 0 --out a",
        "simulate --robot ur5 --payloads 1,-2 --out a",
        "simulate --robot ur5 --payloads 1,nan --out a",
        "inspect a.blob b.blob",
    ] {
        let outcome = folder.run(line).refused(&[]);
        assert!(!outcome.stderr.is_empty(), "{line}");
        assert!(folder.names().is_empty(), "{line}");
    }
}

#[test]
fn every_option_of_the_device_commands_is_in_the_help() {
    const LINK: [&str; 3] = ["--port", "--baud", "--answer-limit"];
    let folder = Folder::new();
    let overview = folder.run("device --help").ok().stdout;
    for (command, options) in [
        ("info", &["--json"][..]),
        ("flash", &["<BLOB>", "--force", "--piece", "--json"]),
        ("evaluate", &["<TEST>", "--blob", "--json"]),
        ("correct", &["<TEST>", "--blob", "--out"]),
        ("bypass", &["<SWITCH>", "on", "off"]),
        ("rollback", &[]),
        ("statistics", &["--json"]),
        ("monitor", &["--once", "--log", "--elf"]),
        ("restart", &[]),
        ("provision", &["<KEY>", "cannot be undone"]),
        (
            "cycle",
            &[
                "--period-us <US>",
                "--rate",
                "--acceleration",
                "--blend <S>",
            ],
        ),
        (
            "emulate",
            &[
                "--board",
                "mps2-an500",
                "--elf",
                "--listen",
                "--log",
                "--memory",
                "--json",
            ],
        ),
    ] {
        assert!(overview.contains(command), "{command}");
        let help = folder.run(&format!("device {command} --help")).ok().stdout;
        let link = if command == "emulate" { &[][..] } else { &LINK };
        for option in options.iter().chain(link) {
            assert!(help.contains(option), "{command}: {option}\n{help}");
        }
    }
}
