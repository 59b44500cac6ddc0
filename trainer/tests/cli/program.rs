//! Runs the program in a folder of its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, OnceLock};

use serde_json::Value;
use tempfile::TempDir;

use crate::numbers::{check_document, check_text};
use crate::texts::{masked, record};

/// The robot of the simulated sets, without coupling.
pub const SERIAL: &str = "abb-irb4400-serial";

/// The result of a run.
#[derive(Debug)]
pub struct Outcome {
    /// The arguments of the command.
    pub line: String,
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Outcome {
    /// Asserts exit code 0.
    #[track_caller]
    pub fn ok(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:#?}");
        self
    }

    /// Asserts exit code 2 and nothing on standard output. The message is compared with the test's text file.
    #[track_caller]
    pub fn refused(self) -> Self {
        assert_eq!(self.stdout, "", "{self:#?}");
        self.refused_after_output()
    }

    /// Asserts what [`Outcome::refused`] asserts, but something may have been printed before.
    #[track_caller]
    pub fn refused_after_output(self) -> Self {
        assert_eq!(self.code, Some(2), "{self:#?}");
        assert!(!self.stderr.is_empty(), "{self:#?}");
        assert!(!self.stderr.contains("panicked"), "{self:#?}");
        record(&self.line, &masked(&self.stderr, false));
        self
    }

    /// Asserts exit code 1 because an output to `place` could not be written.
    #[track_caller]
    pub fn lost(self, place: &str) {
        assert_eq!(self.code, Some(1), "{self:#?}");
        let start = format!("error: {place}: not written: ");
        let is_it = |line: &str| line.starts_with(&start);
        assert!(self.stderr.lines().any(is_it), "{self:#?}");
        record(&self.line, &masked(&self.stderr, true));
    }

    /// Compares the output with the test's text file, except for numbers and for documents on standard output.
    #[track_caller]
    pub fn said(self) -> Self {
        let is_text = !self.stdout.starts_with(['{', '#']);
        let stdout = if is_text { self.stdout.as_str() } else { "" };
        let text = masked(&format!("{stdout}{}", self.stderr), true);
        record(&self.line, &text);
        self
    }

    /// Returns standard output, which must be one JSON document.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {self:#?}"))
    }
}

/// A folder for one test, removed at its end.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// Returns a folder with the files that `make` writes. `make` runs once in a test program for each `name`, so that not
    /// every test calibrates its own model.
    pub fn prepared(name: impl Into<String>, make: impl FnOnce(&Folder)) -> Self {
        type Files = BTreeMap<PathBuf, Vec<u8>>;
        static PREPARED: Mutex<BTreeMap<String, Arc<OnceLock<Files>>>> =
            Mutex::new(BTreeMap::new());
        let files = Arc::clone(PREPARED.lock().unwrap().entry(name.into()).or_default());
        let files = files.get_or_init(|| {
            let made = Self::new();
            make(&made);
            let files = made
                .contents()
                .into_iter()
                .filter(|(path, _)| path.is_file());
            let inside = |path: PathBuf| path.strip_prefix(made.0.path()).unwrap().to_owned();
            files.map(|(path, bytes)| (inside(path), bytes)).collect()
        });
        let folder = Self::new();
        for (file, bytes) in files {
            let path = folder.0.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file and returns its name.
    pub fn write<'a>(&self, name: &'a str, bytes: impl AsRef<[u8]>) -> &'a str {
        std::fs::write(self.path(name), bytes).unwrap();
        name
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap()
    }

    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap()
    }

    pub fn json(&self, name: &str) -> Value {
        let document = serde_json::from_slice(&self.read(name)).unwrap();
        check_document(name, &document);
        document
    }

    /// Returns the names of everything in the folder, sorted.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.0.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Returns everything in the folder and its subfolders.
    fn contents(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut contents = BTreeMap::new();
        let mut folders = vec![self.0.path().to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let (path, kind) = entry.map(|e| (e.path(), e.file_type().unwrap())).unwrap();
                let bytes = if kind.is_file() {
                    std::fs::read(&path).unwrap()
                } else {
                    Vec::new()
                };
                if kind.is_dir() {
                    folders.push(path.clone());
                }
                contents.insert(path, bytes);
            }
        }
        contents
    }

    /// Asserts that a command is refused and leaves everything in the folder as it was.
    #[track_caller]
    pub fn refuses(&self, line: impl AsRef<str>) -> Outcome {
        let before = self.contents();
        let outcome = self.run(line.as_ref()).refused();
        assert!(
            self.contents() == before,
            "{}: something was written",
            outcome.line
        );
        outcome
    }

    /// Asserts that measurements are refused: exit code 3, the message of the text file, and nothing written.
    #[track_caller]
    pub fn refuses_data(&self, line: impl AsRef<str>) -> Outcome {
        let before = self.contents();
        let outcome = self.run(line.as_ref());
        assert_eq!(outcome.code, Some(3), "{outcome:#?}");
        let outcome = outcome.said();
        assert!(
            self.contents() == before,
            "{}: something was written",
            outcome.line
        );
        outcome
    }

    /// Runs `trainer` in the folder with the arguments in `line`.
    pub fn run(&self, line: &str) -> Outcome {
        self.run_dated(line, "1700000000")
    }

    /// Runs `trainer` on the day of `source_date_epoch`.
    pub fn run_dated(&self, line: &str, source_date_epoch: &str) -> Outcome {
        self.finish(
            self.command(line)
                .env("SOURCE_DATE_EPOCH", source_date_epoch),
        )
    }

    /// Runs `trainer` with standard output going to `device`.
    #[cfg(target_os = "linux")]
    pub fn run_into(&self, line: &str, device: &str) -> Outcome {
        let device = std::fs::OpenOptions::new().write(true).open(device);
        self.finish(self.command(line).stdout(device.unwrap()))
    }

    /// Runs `trainer` with standard output going to a pipe that nobody reads any more.
    #[cfg(unix)]
    pub fn run_without_reader(&self, line: &str) -> Outcome {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        self.finish(self.command(line).stdout(writer))
    }

    /// Returns the command for the arguments in `line`, in the folder.
    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trainer"));
        command
            .args(line.split_whitespace())
            .current_dir(self.0.path());
        command
    }

    /// Runs `trainer` with this text on standard input.
    pub fn run_with_input(&self, line: &str, input: &str) -> Outcome {
        self.write("standard-input", input);
        let input = std::fs::File::open(self.path("standard-input")).unwrap();
        self.finish(self.command(line).stdin(input))
    }

    /// Asserts that the warnings that a command has printed are those of the JSON document that it has written.
    fn expect_documented_warnings(&self, words: &[&str], outcome: &Outcome) {
        let option = words.iter().position(|word| *word == "--json");
        let file = option.and_then(|at| words.get(at + 1));
        // A usage error writes no document.
        let is_written = matches!(outcome.code, Some(0 | 1 | 3));
        let bytes = file.filter(|_| is_written).and_then(|file| match *file {
            "-" => Some(outcome.stdout.clone().into_bytes()),
            // A device such as /dev/full has no end.
            file if self.path(file).is_file() => std::fs::read(self.path(file)).ok(),
            _ => None,
        });
        let document = bytes.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
        let Some(document) = document else {
            return;
        };
        let listed = document["warnings"].as_array().cloned();
        let listed: Vec<Value> = listed.unwrap_or_default();
        let texts = listed.iter().filter_map(|warning| warning["text"].as_str());
        let printed = [outcome.stdout.as_str(), outcome.stderr.as_str()];
        let printed: Vec<&str> = printed
            .iter()
            .flat_map(|text| text.lines())
            .filter_map(|line| line.strip_prefix("warning: "))
            .collect();
        let mut missing = printed.clone();
        for text in texts {
            let first = text.lines().next().unwrap_or_default();
            let found = missing.iter().position(|line| line.contains(first));
            let at =
                found.unwrap_or_else(|| panic!("in the JSON, not printed: {text}\n{outcome:#?}"));
            missing.remove(at);
        }
        assert!(
            missing.is_empty(),
            "printed, not in the JSON: {missing:?}\n{outcome:#?}"
        );
    }

    /// Asserts that a JSON document that a command has written could be replaced by another one.
    #[track_caller]
    fn expect_replaceable(words: &[&str], stdout: &str, folder: &Self) {
        let option = words.iter().position(|word| *word == "--json");
        let Some(file) = option.and_then(|at| words.get(at + 1)) else {
            return;
        };
        let text = match *file {
            "-" => stdout.to_owned(),
            file if folder.path(file).is_file() => folder.text(file),
            _ => return,
        };
        // The lines of `measure` and `device monitor` are none.
        if serde_json::from_str::<Value>(&text).is_ok_and(|json| json["version"].is_string()) {
            let other = Self::new();
            other.write("document.json", &text);
            let mut command = other.command("keys new --out k --json document.json");
            let output = command.output().unwrap();
            assert!(output.status.success(), "{words:?}: {output:?}\n{text}");
        }
    }

    /// Runs a command to its end and checks the numbers in its output.
    pub fn finish(&self, command: &mut Command) -> Outcome {
        let output = command.output().unwrap();
        let words: Vec<_> = command
            .get_args()
            .map(|word| word.to_str().unwrap())
            .collect();
        let outcome = Outcome {
            line: words.join(" "),
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        };
        if let Ok(document) = serde_json::from_str(&outcome.stdout) {
            check_document(&outcome.line, &document);
        } else {
            check_text(&outcome.line, &outcome.stdout);
        }
        self.expect_documented_warnings(&words, &outcome);
        if outcome.code == Some(0) {
            Self::expect_replaceable(&words, &outcome.stdout, self);
        }
        // An error quotes input, so only successful runs are checked.
        if outcome.code == Some(0) {
            check_text(&outcome.line, &outcome.stderr);
        }
        outcome
    }
}

/// Returns a model and its report, as an earlier calibration wrote them.
pub fn earlier() -> (Vec<u8>, Vec<u8>) {
    let folder = Folder::prepared("earlier", |folder| {
        folder.write("train.csv", simulated("train", 30));
        folder.write("test.csv", simulated("test1", 10));
        let line = "train.csv --test test.csv --method base-tool --out old.blob --report old.html";
        folder
            .run(&format!("calibrate --robot {SERIAL} {line}"))
            .ok();
    });
    (folder.read("old.blob"), folder.read("old.html"))
}

/// Returns a file of `tests/data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/data")
        .join(name)
}

/// Returns one of the simulated sets (`train`, `test1`, `test2`, `test3`), its header and first `poses` rows.
pub fn simulated(set: &str, poses: usize) -> String {
    let path = data(&format!("simulated/irb4400_paper_s0_{set}.csv"));
    let text = std::fs::read_to_string(path).unwrap();
    let lines: Vec<&str> = text.lines().take(1 + poses).collect();
    lines.join("\n") + "\n"
}

/// Returns `csv` with every row passed through `change`, which gets the names of the columns and the fields.
pub fn changed(csv: &str, mut change: impl FnMut(&[&str], &mut Vec<String>)) -> String {
    let mut lines = csv.lines();
    let header = lines.next().unwrap();
    let names: Vec<&str> = header.split(',').collect();
    let mut out = header.to_owned() + "\n";
    for line in lines {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        change(&names, &mut fields);
        out += &fields.join(",");
        out.push('\n');
    }
    out
}

/// Returns `csv` without the columns `dropped`.
pub fn without(csv: &str, dropped: &[&str]) -> String {
    let names: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let mut out = String::new();
    for line in csv.lines() {
        let kept: Vec<&str> = line
            .split(',')
            .zip(&names)
            .filter(|(_, name)| !dropped.contains(name))
            .map(|(field, _)| field)
            .collect();
        out += &kept.join(",");
        out.push('\n');
    }
    out
}

/// Returns `csv` with `field` in column `name` of line `line` (from 1, the header).
pub fn with_field(csv: &str, line: usize, name: &str, field: &str) -> String {
    let mut at = 1;
    changed(csv, |names, fields| {
        at += 1;
        if at == line {
            let column = names.iter().position(|n| *n == name).unwrap();
            fields[column] = field.to_owned();
        }
    })
}
