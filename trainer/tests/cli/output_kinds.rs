//! An output replaces only an empty file or an earlier output of the same kind.

use std::any::TypeId;
use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::CommandFactory;
use poegp_trainer::cli::Arguments;

use crate::program::Folder;
use crate::texts::texts;

/// Options that name files to read.
const INPUTS: [&str; 17] = [
    "base",
    "blob",
    "constraints",
    "elf",
    "features",
    "frames",
    "key",
    "keep-gauge",
    "map",
    "previous",
    "prior",
    "programs",
    "public-key",
    "references",
    "test",
    "urdf",
    "with",
];

/// What a run of the command, repeated, does to its own output.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Again {
    /// It replaces it.
    Replaces,
    /// It needs a device or a controller, runs for minutes, or refuses every file that exists.
    IsNotRun,
}
use Again::{IsNotRun, Replaces};

/// An output: the command, its other arguments, the option, its value, and the file that is written.
type Output = (
    &'static str,
    &'static str,
    &'static str,
    &'static str,
    &'static str,
    Again,
);

const POE: &str = "--robot ur10 cell/train.csv --method poe";
const PLAN: &str = "--robot ur10 --count 16 --space-filling --no-forecast";

/// Returns the outputs of commands that take measurements and models.
fn of_models() -> Vec<Output> {
    let mut out = Vec::new();
    for (option, file) in [("json", "o.json"), ("report", "o.html")] {
        out.push((
            "compare",
            "--robot ur10 cell/train.csv --methods poe --folds 2",
            option,
            file,
            file,
            Replaces,
        ));
        out.push((
            "check",
            "arm.blob cell/test1.csv --max-mm 9 --max-drift-mm 9",
            option,
            file,
            file,
            Replaces,
        ));
        out.push((
            "correct",
            "arm.blob p.script --out other.script",
            option,
            file,
            file,
            Replaces,
        ));
    }
    out.push(("calibrate", POE, "out", "o.blob", "o.blob", Replaces));
    for (option, file) in [
        ("json", "o.json"),
        ("write-project", "o.toml"),
        ("controller-csv", "o.csv"),
    ] {
        out.push((
            "calibrate",
            "--robot ur10 cell/train.csv --method poe --out other.blob",
            option,
            file,
            file,
            Replaces,
        ));
    }
    let reported =
        "--robot ur10 cell/train.csv --method poe --out other.blob --test cell/test1.csv";
    out.extend([
        (
            "calibrate",
            reported,
            "report",
            "o.html",
            "o.html",
            Replaces,
        ),
        (
            "evaluate",
            "arm.blob cell/test1.csv",
            "predictions",
            "o.csv",
            "o.csv",
            Replaces,
        ),
        (
            "evaluate",
            "arm.blob cell/test1.csv",
            "json",
            "o.json",
            "o.json",
            Replaces,
        ),
        (
            "correct",
            "arm.blob targets.csv",
            "out",
            "o.csv",
            "o.csv",
            Replaces,
        ),
        (
            "correct",
            "arm.blob p.script",
            "out",
            "o.script",
            "o.script",
            Replaces,
        ),
        (
            "correct",
            "arm.blob p.script",
            "out",
            "o.script",
            "o.script.poegp.json",
            Replaces,
        ),
        ("inspect", "arm.blob", "json", "o.json", "o.json", Replaces),
        (
            "bridge rsi",
            "arm.blob",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "keys new",
            "--out new",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        ("keys new", "", "out", "new", "new.key", IsNotRun),
        ("keys new", "", "out", "new", "new.pub", IsNotRun),
        (
            "sign",
            "arm.blob --key k.key",
            "out",
            "o.blob",
            "o.blob",
            Replaces,
        ),
        (
            "sign",
            "targets.csv.html --key k.key",
            "out",
            "o.sig",
            "o.sig",
            Replaces,
        ),
        (
            "sign",
            "arm.blob --key k.key --out other.blob",
            "json",
            "o.json",
            "o.json",
            Replaces,
        ),
        (
            "verify",
            "signed.blob --public-key k.pub",
            "json",
            "o.json",
            "o.json",
            Replaces,
        ),
    ]);
    out
}

/// Returns the outputs of `export`.
fn of_export() -> Vec<Output> {
    let mut out = vec![(
        "export",
        "arm.blob --out other.urdf",
        "json",
        "o.json",
        "o.json",
        Replaces,
    )];
    for (option, file) in [
        ("out", "o.urdf"),
        ("mjcf", "o.xml"),
        ("ur-kinematics", "o.yaml"),
        ("ur-kinematics", "o.csv"),
        ("joint-offsets", "o.toml"),
        ("joint-offsets", "o.json"),
        ("c-header", "o.h"),
    ] {
        out.push(("export", "arm.blob", option, file, file, Replaces));
    }
    for option in ["dh", "mdh", "poe"] {
        for file in ["o.toml", "o.json", "o.csv"] {
            out.push(("export", "arm.blob", option, file, file, Replaces));
        }
    }
    out
}

/// Returns the outputs of commands that come before a measurement, and of those about the program itself.
fn of_others() -> Vec<Output> {
    let mut out = vec![("plan", PLAN, "out", "o.csv", "o.csv", Replaces)];
    for (option, file) in [
        ("json", "o.json"),
        ("rapid", "o.mod"),
        ("krl", "o.src"),
        ("urscript", "o.script"),
        ("fanuc", "o.ls"),
    ] {
        let line = "--robot ur10 --count 16 --space-filling --no-forecast --out other.csv";
        out.push(("plan", line, option, file, file, Replaces));
    }
    let tested =
        "--robot ur10 --count 16 --space-filling --no-forecast --out other.csv --test-poses 3";
    let touched = "--robot ur10 --touch socket=600,100,500 --count 12 --out other.csv";
    out.extend([
        ("plan", tested, "test-out", "o.csv", "o.csv", Replaces),
        (
            "plan",
            touched,
            "features-out",
            "o.toml",
            "o.toml",
            Replaces,
        ),
        (
            "measure",
            "--robot ur10 plan.csv",
            "out",
            "o.csv",
            "o.csv",
            IsNotRun,
        ),
        (
            "measure",
            "--robot ur10 plan.csv --out other.csv",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "import",
            "cell/train.csv",
            "out",
            "o.csv",
            "o.csv",
            Replaces,
        ),
        (
            "import",
            "cell/train.csv --out other.csv",
            "json",
            "o.json",
            "o.json",
            Replaces,
        ),
        (
            "import",
            "cell/train.csv --out other.csv",
            "write-map",
            "o.toml",
            "o.toml",
            Replaces,
        ),
        (
            "simulate",
            "--robot ur10 --poses 3",
            "out",
            "d",
            "d/train.csv",
            Replaces,
        ),
        (
            "simulate",
            "--robot ur10 --poses 3 --out e",
            "json",
            "o.json",
            "o.json",
            Replaces,
        ),
        ("demo", "", "out", "d", "d/train.csv", IsNotRun),
        ("demo", "", "out", "d", "d/report.html", IsNotRun),
        ("demo", "--out e", "json", "o.json", "o.json", IsNotRun),
        ("completions", "bash", "out", "o.sh", "o.sh", Replaces),
        ("completions", "zsh", "out", "_o", "_o", Replaces),
        ("completions", "fish", "out", "o.fish", "o.fish", Replaces),
        ("completions", "elvish", "out", "o.elv", "o.elv", Replaces),
        ("manual", "", "out", "d", "d/trainer-check.1", Replaces),
        ("manual", "--out e", "json", "o.json", "o.json", Replaces),
    ]);
    out
}

/// Returns the outputs of commands for a device.
fn of_devices() -> Vec<Output> {
    let mut out = vec![
        (
            "device correct",
            "targets.csv --port unix:nowhere",
            "out",
            "o.csv",
            "o.csv",
            IsNotRun,
        ),
        (
            "device correct",
            "targets.csv --port unix:nowhere --out other.csv",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device evaluate",
            "cell/test1.csv --port unix:nowhere",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device flash",
            "arm.blob --port unix:nowhere",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device provision",
            "k.pub --port unix:nowhere",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device bypass",
            "on --port unix:nowhere",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device monitor",
            "--once --port unix:nowhere",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device emulate",
            "--elf cell/train.csv",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ),
        (
            "device emulate",
            "--elf cell/train.csv",
            "flash-image",
            "o.bin",
            "o.bin",
            IsNotRun,
        ),
    ];
    for command in [
        "device info",
        "device rollback",
        "device statistics",
        "device restart",
        "device stop",
        "device cycle",
    ] {
        out.push((
            command,
            "--port unix:nowhere",
            "json",
            "o.json",
            "o.json",
            IsNotRun,
        ));
    }
    out
}

fn outputs() -> Vec<Output> {
    [of_models(), of_export(), of_others(), of_devices()].concat()
}

/// Collects the options of every command that name a file.
fn options_of(command: &clap::Command, name: &str, out: &mut BTreeSet<(String, String)>) {
    for option in command.get_arguments() {
        let is_path = option.get_value_parser().type_id() == TypeId::of::<PathBuf>();
        if let Some(long) = option.get_long().filter(|_| is_path) {
            out.insert((name.to_owned(), long.to_owned()));
        }
    }
    for subcommand in command.get_subcommands() {
        let name = format!("{name} {}", subcommand.get_name());
        options_of(subcommand, name.trim(), out);
    }
}

/// A new option that names a file is in one of the lists.
#[test]
fn every_output_is_listed() {
    let mut found = BTreeSet::new();
    options_of(&Arguments::command(), "", &mut found);
    found.retain(|(_, option)| !INPUTS.contains(&option.as_str()));
    let listed = outputs();
    let listed = listed
        .iter()
        .map(|output| (output.0.to_owned(), output.2.to_owned()));
    assert_eq!(found, listed.collect());
}

fn folder() -> Folder {
    Folder::prepared("output kinds", |folder| {
        let line = "simulate --robot ur10 --poses 40 --test-sets 1 --test-poses 20 --out cell";
        folder.run(line).ok();
        folder.run(&format!("calibrate {POE} --out arm.blob")).ok();
        folder.run(&format!("plan {PLAN} --out plan.csv")).ok();
        folder.run("keys new --out k").ok();
        folder
            .run("sign arm.blob --key k.key --out signed.blob")
            .ok();
        folder.write(
            "p.script",
            "def p():\n  movej([0.1, -1.2, 1.3, -0.4, 1.5, 0.6], a=1, v=1)\nend\n",
        );
        folder.write(
            "targets.csv",
            "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,payload_kg\n10,-60,70,-20,80,30,3\n",
        );
        folder.write("targets.csv.html", "a document");
    })
}

fn line((command, others, option, value, _, _): Output) -> String {
    format!("{command} {others} --{option} {value}")
}

/// Whatever is there and no output of the program stays there, and no other file is written, either.
#[test]
fn a_file_of_the_user_is_not_replaced() {
    let _texts = texts();
    for foreign in [
        "Call the customer.\nThen measure again.\n",
        "{\"version\": \"1.0.0\", \"name\": \"site\"}\n",
    ] {
        for output in outputs() {
            let folder = folder();
            let (file, is_in_folder) = (output.4, output.4.starts_with("d/"));
            if is_in_folder {
                std::fs::create_dir(folder.path("d")).unwrap();
            }
            folder.write(file, foreign);
            let outcome = folder.refuses(line(output));
            assert!(outcome.stderr.contains(file), "{outcome:#?}");
        }
    }
}

/// What the same command wrote earlier is replaced, and so is an empty file.
#[test]
fn an_earlier_output_is_replaced() {
    for output in outputs().into_iter().filter(|output| output.5 == Replaces) {
        let folder = folder();
        let (line, file) = (line(output), output.4);
        folder.run(&line).ok();
        let first = folder.read(file);
        assert!(!first.is_empty(), "{line}");
        folder.run(&line).ok();
        if !file.ends_with(".poegp.json") && output.3 != "o.script" {
            folder.write(file, "");
        }
        folder.run(&line).ok();
        assert!(!folder.read(file).is_empty(), "{line}");
    }
}

/// An output of another kind is as foreign as any other file: no kind is taken for another.
#[test]
fn kinds_are_told_apart() {
    let folder = folder();
    let mut written: Vec<(Output, Vec<u8>)> = Vec::new();
    for output in of_export() {
        folder.run(&line(output)).ok();
        written.push((output, folder.read(output.4)));
        std::fs::remove_file(folder.path(output.4)).unwrap();
    }
    for (output, _) in &written {
        for (other, bytes) in written.iter().filter(|(other, _)| other.2 != output.2) {
            folder.write(output.4, bytes);
            let outcome = folder.run(&line(*output));
            assert_eq!(outcome.code, Some(2), "{other:?}: {outcome:#?}");
            assert_eq!(&folder.read(output.4), bytes);
            std::fs::remove_file(folder.path(output.4)).unwrap();
        }
    }
}
