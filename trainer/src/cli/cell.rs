//! The project file of `trainer calibrate`: everything that a calibration was made of.
//!
//! `cell.toml` becomes the options of the command line that would do the same, so there is one path to a blob and the same
//! bytes come out of it. What was typed goes before what the file says. Paths are relative to the file. Checksums, tools
//! and payloads that it states have to be those of the data; keys that are not known are refused with their place.

mod keys;
mod write;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue};
use clap::parser::ValueSource;
use sha2::{Digest, Sha256};

use crate::cli::arguments::Calibrate;
use crate::cli::cell::keys::{Cell, Given};
pub use crate::cli::cell::write::text;
use crate::cli::{Failure, command};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::sample::ToolName;

/// The options that cannot go together: when one of the first is typed, the others of the file do not count.
const APART: [(&str, &[&str]); 3] = [
    ("support-per-output", &["support", "tied"]),
    ("support", &["support-per-output"]),
    ("tied", &["support-per-output"]),
];

/// Typed beside a project file, these change nothing in the blob.
const BESIDE: [&str; 4] = ["out", "report", "json", "write_cell"];

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What the command line calls an option inside.
fn id(option: &str) -> String {
    match option {
        "test" => "tests".to_owned(),
        _ => option.replace('-', "_"),
    }
}

/// The project file of a calibration.
#[derive(Clone, Debug)]
pub struct Project {
    /// Where it is.
    pub file: PathBuf,
    /// The measurements that it names.
    train: PathBuf,
    /// SHA-256 of the blob that it states, when nothing was typed that makes another one.
    pub blob_sha256: Option<String>,
}

/// A command line with its project file, if it has one, taken apart into options.
pub struct Expanded {
    /// What clap shall read.
    pub words: Vec<OsString>,
    /// What there is to say of it.
    pub notes: Vec<String>,
    project: Option<Project>,
}

impl Expanded {
    /// Without a project file.
    fn plain(words: Vec<OsString>) -> Self {
        Self {
            words,
            notes: Vec::new(),
            project: None,
        }
    }

    /// Puts the measurements where the project file was typed, and that aside.
    pub fn complete(self, a: &mut Calibrate) {
        if let Some(project) = self.project {
            a.train.clone_from(&project.train);
            a.project = Some(project);
        }
    }
}

/// The options that a project file stands for, before those that were typed.
pub fn expanded(words: Vec<OsString>) -> Result<Expanded, Failure> {
    // What the file may have need not be typed.
    let lenient = command().mut_subcommand("calibrate", |c| {
        c.mut_arg("robot", |a| a.required(false))
            .mut_arg("out", |a| a.required(false))
    });
    let Ok(matches) = lenient.try_get_matches_from(&words) else {
        return Ok(Expanded::plain(words));
    };
    let Some(("calibrate", typed)) = matches.subcommand() else {
        return Ok(Expanded::plain(words));
    };
    let Some(path) = typed
        .get_one::<PathBuf>("train")
        .filter(|path| is_cell(path))
    else {
        return Ok(Expanded::plain(words));
    };
    let cell = Cell::read(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    check_data(&cell, folder)?;
    // Groups of options have ids, too.
    let options = command();
    let options = options.find_subcommand("calibrate");
    let all_typed: Vec<&str> = options
        .into_iter()
        .flat_map(clap::Command::get_arguments)
        .map(|option| option.get_id().as_str())
        .filter(|id| typed.value_source(id) == Some(ValueSource::CommandLine))
        .collect();
    let is_typed = |option: &str| all_typed.contains(&id(option).as_str());
    if cell.output().blob.is_none() && !is_typed("out") {
        return Err(
            InputError::new(path, "no output.blob", "where the blob goes")
                .with_help("add `blob = \"arm.blob\"` under [output], or type --out FILE")
                .into(),
        );
    }
    let mut notes = Vec::new();
    if let Some(then) = cell.trainer().filter(|then| *then != VERSION) {
        notes.push(format!(
            "{} was written by trainer {then}, this is {VERSION}: results may differ, and the bytes of the blob do, which names \
             its trainer; install that version to repeat them",
            path.display()
        ));
    }
    let mut options = Vec::new();
    let mut known = Vec::from(BESIDE);
    known.push("train");
    let given = cell.options(folder);
    let ids: Vec<String> = given.iter().map(|given| id(given.option)).collect();
    known.extend(ids.iter().map(String::as_str));
    for given in given {
        let apart = APART
            .iter()
            .any(|(first, others)| is_typed(first) && others.contains(&given.option));
        if is_typed(given.option) || apart {
            notes.push(format!(
                "the command line goes before {} in {}",
                given.key,
                path.display()
            ));
        } else if given.typed {
            options.push(given);
        }
    }
    notes.dedup();
    for id in all_typed.iter().filter(|id| !known.contains(id)) {
        let option = id.replace('_', "-");
        notes.push(format!("--{option} is not in {}", path.display()));
    }
    let as_written = all_typed
        .iter()
        .all(|id| BESIDE.contains(id) || *id == "train");
    let stated = cell.output().blob_sha256.as_ref().filter(|_| as_written);
    let project = Project {
        file: path.clone(),
        train: folder.join(cell.data().train.get_ref()),
        blob_sha256: stated.map(|sum| sum.get_ref().clone()),
    };
    let at = words.iter().skip(1).position(|word| word == "calibrate");
    let at = at.map_or(words.len(), |at| at + 2);
    let mut all = words;
    let new: Vec<OsString> = options.iter().map(Given::word).collect();
    all.splice(at..at, new);
    if let Err(error) = command().try_get_matches_from(&all)
        && let Some(error) = blamed(&cell, &options, &error)
    {
        return Err(error.into());
    }
    Ok(Expanded {
        words: all,
        notes,
        project: Some(project),
    })
}

/// Measurements are CSV; a TOML file is a project.
fn is_cell(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

/// A value of the file that the command line would refuse, at its place.
fn blamed(cell: &Cell, options: &[Given], error: &clap::Error) -> Option<InputError> {
    let argument = match error.get(ContextKind::InvalidArg)? {
        ContextValue::String(text) => text,
        _ => return None,
    };
    let name = argument
        .trim_start_matches('-')
        .split([' ', '=', '['])
        .next()?;
    let given = options.iter().find(|given| given.option == name)?;
    let value = match error.get(ContextKind::InvalidValue) {
        Some(ContextValue::String(text)) => text.clone(),
        _ => return None,
    };
    let text = error.to_string();
    let why = text
        .lines()
        .find_map(|line| line.trim().strip_prefix("[possible values: "))
        .map(|values| format!("one of {}", values.trim_end_matches(']')))
        .or_else(|| std::error::Error::source(error).map(ToString::to_string))
        .unwrap_or_else(|| format!("what --{name} takes"));
    let expected = why.strip_prefix("expected ").unwrap_or(&why).to_owned();
    Some(
        cell.error(
            given.place.clone(),
            &given.key,
            format!("\"{value}\""),
            expected,
        )
        .with_help("`trainer calibrate --help` says what every option takes"),
    )
}

/// Whether the data are those that the file states.
fn check_data(cell: &Cell, folder: &Path) -> Result<(), InputError> {
    for (name, stated) in &cell.data().sha256 {
        let known = cell.files().any(|file| file == name.get_ref());
        if !known {
            let found = format!("a checksum of \"{}\"", name.get_ref());
            let expected = "one of the robot, of data.train or of data.tests, written as there";
            return Err(cell.error(name.span(), name.get_ref(), found, expected));
        }
        let path = folder.join(name.get_ref());
        let bytes = std::fs::read(&path)
            .map_err(|error| InputError::unreadable(&path, &error, "a file of this project"))?;
        let sum: String = Sha256::digest(&bytes)
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect();
        if !sum.eq_ignore_ascii_case(stated.get_ref()) {
            let found = format!(
                "another file than {}, whose checksum is {sum}",
                path.display()
            );
            return Err(cell
                .error(stated.span(), "sha256", found, "the checksum of that file")
                .with_help(
                    "bring the old file back, or correct the checksum if the new one is meant",
                ));
        }
    }
    let data = cell.data();
    if data.payloads_kg.is_none() && data.tools.is_none() {
        return Ok(());
    }
    // A file that cannot be read is told by the command itself.
    let Ok(set) = poegp_calibration::measurement::read(folder.join(data.train.get_ref())) else {
        return Ok(());
    };
    let (payloads, tools) = stated(&set);
    if let Some(there) = data
        .payloads_kg
        .as_ref()
        .filter(|p| *p.get_ref() != payloads)
    {
        let found = format!("{:?}", there.get_ref());
        let expected = format!("{payloads:?}, which {} has", data.train.get_ref());
        return Err(cell.error(there.span(), "payloads_kg", found, expected));
    }
    if let Some(there) = data.tools.as_ref().filter(|t| *t.get_ref() != tools) {
        let found = format!("{:?}", there.get_ref());
        let expected = format!("{tools:?}, which {} has", data.train.get_ref());
        return Err(cell.error(there.span(), "tools", found, expected));
    }
    Ok(())
}

/// Payloads in kg, ascending, and tools in their order, of a measurement file.
fn stated(set: &poegp_calibration::measurement::MeasurementSet) -> (Vec<f64>, Vec<String>) {
    let mut payloads: Vec<f64> = set
        .measurements
        .iter()
        .filter_map(|m| m.payload_kg)
        .collect();
    payloads.sort_by(f64::total_cmp);
    payloads.dedup();
    let mut tools: Vec<String> = Vec::new();
    for m in &set.measurements {
        let name = ToolName {
            session: m.session.clone().unwrap_or_default(),
            target: m.target.clone().unwrap_or_default(),
        };
        let name = name.to_string();
        if !tools.contains(&name) {
            tools.push(name);
        }
    }
    (payloads, tools)
}

impl Given {
    /// As it would be typed. With `=`, so that nothing that follows is taken for its value.
    fn word(&self) -> OsString {
        let mut word = OsString::from(format!("--{}", self.option));
        if let Some(value) = &self.value {
            word.push("=");
            word.push(value);
        }
        word
    }
}
