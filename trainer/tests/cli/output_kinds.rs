//! An output replaces only an empty file or an earlier output of the same kind.

use std::any::TypeId;
use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::CommandFactory;
use poegp_trainer::cli::Arguments;

use crate::program::Folder;
use crate::texts::texts;

/// Options that name files to read.
const INPUTS: [&str; 18] = [
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
    "touch-plan",
    "urdf",
    "with",
];

/// The outputs: command, its other arguments, option, its value, file that is written, and whether a second run replaces it
/// (`not run`: it needs a device, takes minutes, or refuses every file that exists).
const OUTPUTS: &str = "\
compare | --robot ur10 cell/train.csv --methods poe --folds 2 | json | o.json | o.json | replaces
check | arm.blob cell/test1.csv --max-mm 9 --max-drift-mm 9 | json | o.json | o.json | replaces
correct | arm.blob p.script --out other.script | json | o.json | o.json | replaces
compare | --robot ur10 cell/train.csv --methods poe --folds 2 | report | o.html | o.html | replaces
check | arm.blob cell/test1.csv --max-mm 9 --max-drift-mm 9 | report | o.html | o.html | replaces
correct | arm.blob p.script --out other.script | report | o.html | o.html | replaces
calibrate | --robot ur10 cell/train.csv --method poe | out | o.blob | o.blob | replaces
calibrate | --robot ur10 cell/train.csv --method poe --out other.blob | json | o.json | o.json | replaces
calibrate | --robot ur10 cell/train.csv --method poe --out other.blob | write-project | o.toml | o.toml | replaces
calibrate | --robot ur10 cell/train.csv --method poe --out other.blob | controller-csv | o.csv | o.csv | replaces
calibrate | --robot ur10 cell/train.csv --method poe --out other.blob --test cell/test1.csv | report | o.html | o.html | replaces
evaluate | arm.blob cell/test1.csv | predictions | o.csv | o.csv | replaces
evaluate | arm.blob cell/test1.csv | json | o.json | o.json | replaces
correct | arm.blob targets.csv | out | o.csv | o.csv | replaces
correct | arm.blob p.script | out | o.script | o.script | replaces
correct | arm.blob p.script | out | o.script | o.script.poegp.json | replaces
inspect | arm.blob | json | o.json | o.json | replaces
bridge rsi | arm.blob --listen 127.0.0.1:0 | json | o.json | o.json | not run
keys new | --out new | json | o.json | o.json | not run
keys new |  | out | new | new.key | not run
keys new |  | out | new | new.pub | not run
sign | arm.blob --key k.key | out | o.blob | o.blob | replaces
sign | document.html --key k.key | out | o.sig | o.sig | replaces
sign | arm.blob --key k.key --out other.blob | json | o.json | o.json | replaces
verify | signed.blob --public-key k.pub | json | o.json | o.json | replaces
export | arm.blob --out other.urdf | json | o.json | o.json | replaces
export | arm.blob | out | o.urdf | o.urdf | replaces
export | arm.blob | mjcf | o.xml | o.xml | replaces
export | arm.blob | ur-kinematics | o.yaml | o.yaml | replaces
export | arm.blob | ur-kinematics | o.csv | o.csv | replaces
export | arm.blob | joint-offsets | o.toml | o.toml | replaces
export | arm.blob | joint-offsets | o.json | o.json | replaces
export | arm.blob | c-header | o.h | o.h | replaces
export | arm.blob | dh | o.toml | o.toml | replaces
export | arm.blob | dh | o.json | o.json | replaces
export | arm.blob | dh | o.csv | o.csv | replaces
export | arm.blob | mdh | o.toml | o.toml | replaces
export | arm.blob | mdh | o.json | o.json | replaces
export | arm.blob | mdh | o.csv | o.csv | replaces
export | arm.blob | poe | o.toml | o.toml | replaces
export | arm.blob | poe | o.json | o.json | replaces
export | arm.blob | poe | o.csv | o.csv | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast | out | o.csv | o.csv | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast --out other.csv | json | o.json | o.json | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast --out other.csv | rapid | o.mod | o.mod | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast --out other.csv | krl | o.src | o.src | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast --out other.csv | urscript | o.script | o.script | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast --out other.csv | fanuc | o.ls | o.ls | replaces
plan | --robot ur10 --count 16 --space-filling --no-forecast --out other.csv --test-poses 3 | test-out | o.csv | o.csv | replaces
plan | --robot ur10 --touch socket=600,100,500 --count 12 --out other.csv | features-out | o.toml | o.toml | replaces
measure | --robot ur10 plan.csv | out | o.csv | o.csv | not run
measure | --robot ur10 plan.csv --out other.csv | json | o.json | o.json | not run
import | cell/train.csv | out | o.csv | o.csv | replaces
import | cell/train.csv --out other.csv | json | o.json | o.json | replaces
import | cell/train.csv --out other.csv | write-map | o.toml | o.toml | replaces
simulate | --robot ur10 --poses 3 | out | d | d/train.csv | replaces
simulate | --robot ur10 --poses 3 --out e | json | o.json | o.json | replaces
demo |  | out | d | d/train.csv | not run
demo |  | out | d | d/report.html | not run
demo | --out e | json | o.json | o.json | not run
completions | bash | out | o.sh | o.sh | replaces
completions | zsh | out | _o | _o | replaces
completions | fish | out | o.fish | o.fish | replaces
completions | elvish | out | o.elv | o.elv | replaces
manual |  | out | d | d/trainer-check.1 | replaces
manual | --out e | json | o.json | o.json | replaces
device correct | targets.csv --port unix:nowhere | out | o.csv | o.csv | not run
device correct | targets.csv --port unix:nowhere --out other.csv | json | o.json | o.json | not run
device evaluate | cell/test1.csv --port unix:nowhere | json | o.json | o.json | not run
device flash | arm.blob --port unix:nowhere | json | o.json | o.json | not run
device provision | k.pub --port unix:nowhere | json | o.json | o.json | not run
device bypass | on --port unix:nowhere | json | o.json | o.json | not run
device monitor | --once --port unix:nowhere | json | o.json | o.json | not run
device emulate | --elf cell/train.csv | json | o.json | o.json | not run
device emulate | --elf cell/train.csv | flash-image | o.bin | o.bin | not run
device info | --port unix:nowhere | json | o.json | o.json | not run
device rollback | --port unix:nowhere | json | o.json | o.json | not run
device statistics | --port unix:nowhere | json | o.json | o.json | not run
device restart | --port unix:nowhere | json | o.json | o.json | not run
device stop | --port unix:nowhere | json | o.json | o.json | not run
device cycle | --port unix:nowhere | json | o.json | o.json | not run
";

/// An output, a line of [`OUTPUTS`].
#[derive(Clone, Copy, Debug)]
struct Output {
    command: &'static str,
    others: &'static str,
    option: &'static str,
    value: &'static str,
    file: &'static str,
    is_run: bool,
}

impl Output {
    /// Returns the line of the command.
    fn line(&self) -> String {
        let (option, value) = (self.option, self.value);
        format!("{} {} --{option} {value}", self.command, self.others)
    }
}

fn outputs() -> Vec<Output> {
    let output = |line: &'static str| {
        let fields: Vec<&str> = line.split(" | ").collect();
        let [command, others, option, value, file, again] = fields[..] else {
            panic!("{line}");
        };
        Output {
            command,
            others,
            option,
            value,
            file,
            is_run: again == "replaces",
        }
    };
    OUTPUTS.lines().map(output).collect()
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
    let listed = outputs().into_iter();
    let listed = listed.map(|output| (output.command.to_owned(), output.option.to_owned()));
    let listed: BTreeSet<(String, String)> = listed.collect();
    let unlisted: Vec<_> = found.symmetric_difference(&listed).collect();
    assert!(unlisted.is_empty(), "{unlisted:?}");
}

fn folder() -> Folder {
    Folder::prepared("output kinds", |folder| {
        for line in [
            "simulate --robot ur10 --poses 40 --test-sets 1 --test-poses 20 --out cell",
            "calibrate --robot ur10 cell/train.csv --method poe --out arm.blob",
            "plan --robot ur10 --count 16 --space-filling --no-forecast --out plan.csv",
            "keys new --out k",
            "sign arm.blob --key k.key --out signed.blob",
        ] {
            folder.run(line).ok();
        }
        let program = "def p():\n  movej([0.1, -1.2, 1.3, -0.4, 1.5, 0.6], a=1, v=1)\nend\n";
        folder.write("p.script", program);
        let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,payload_kg";
        folder.write("targets.csv", format!("{header}\n10,-60,70,-20,80,30,3\n"));
        folder.write("document.html", "a document");
    })
}

/// A file that is no output of the program stays as it is, and no other file is written, either.
#[test]
fn a_file_of_the_user_is_not_replaced() {
    let _texts = texts();
    for foreign in ["Call the customer.\n", "{\"version\": \"1.0.0\"}\n"] {
        for output in outputs() {
            let folder = folder();
            if output.file.starts_with("d/") {
                std::fs::create_dir(folder.path("d")).unwrap();
            }
            folder.write(output.file, foreign);
            let outcome = folder.refuses(output.line());
            assert!(outcome.stderr.contains(output.file), "{outcome:#?}");
        }
    }
}

/// What the same command wrote earlier is replaced, and so is an empty file.
#[test]
fn an_earlier_output_is_replaced() {
    for output in outputs().iter().filter(|output| output.is_run) {
        let folder = folder();
        for _ in 0..2 {
            folder.run(&output.line()).ok();
            assert!(!folder.read(output.file).is_empty(), "{output:?}");
        }
        // Without its record a program is not known to be a corrected one.
        if !output.file.ends_with(".poegp.json") {
            folder.write(output.file, "");
        }
        folder.run(&output.line()).ok();
        assert!(!folder.read(output.file).is_empty(), "{output:?}");
    }
}

/// An export is not replaced by one of another kind.
#[test]
fn kinds_of_exports_are_told_apart() {
    let folder = folder();
    let exports = outputs()
        .into_iter()
        .filter(|output| output.command == "export");
    let written: Vec<(Output, Vec<u8>)> = exports
        .map(|output| {
            folder.run(&output.line()).ok();
            let bytes = folder.read(output.file);
            std::fs::remove_file(folder.path(output.file)).unwrap();
            (output, bytes)
        })
        .collect();
    for (output, _) in &written {
        let others = written
            .iter()
            .filter(|(other, _)| other.option != output.option);
        for (other, bytes) in others {
            folder.write(output.file, bytes);
            let outcome = folder.run(&output.line());
            assert_eq!(outcome.code, Some(2), "{other:?}: {outcome:#?}");
            assert_eq!(&folder.read(output.file), bytes);
        }
        std::fs::remove_file(folder.path(output.file)).unwrap();
    }
}
