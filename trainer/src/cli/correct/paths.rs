//! The paths of one run of `trainer correct` for controllers' programs: what is read and what is written.

use std::path::{Path, PathBuf};

use crate::cli::correct::args::Correct;
use crate::cli::correct::record::{is_result, record_path};
use crate::cli::output::Output;
use crate::cli::output::kind::Kind;
use crate::cli::terminal::print::is_stdout;
use crate::robot_programs::correction::Format;
use crate::robot_programs::correction::replacement::Rewritten;
use poegp_calibration::input_error::InputError;

/// The path that is read and the path that is written, for each file.
pub type Files = Vec<(PathBuf, PathBuf)>;

/// All paths of a run, beside those that its arguments name.
pub struct Paths {
    /// The corrected files.
    pub files: Files,
    /// The record of each of `files`.
    records: Vec<PathBuf>,
    /// Files that the controller keeps beside the programs: they are read for tools and frames, and not corrected.
    pub beside: Vec<PathBuf>,
    /// Whether a corrected program goes to standard output, beside which no record is written.
    is_stream: bool,
}

/// The contents of all outputs.
pub struct Texts<'a> {
    /// The corrected files.
    pub results: &'a [Rewritten],
    /// The record of each of `results`.
    pub records: &'a [String],
    /// The summary for `--json`.
    pub json: Option<&'a str>,
    /// The page for `--report`.
    pub report: Option<&'a str>,
}

impl Paths {
    /// Returns the paths of the programs that `a` names and of the files that belong to them.
    ///
    /// # Errors
    /// [`InputError`] if several files do not fit into the output.
    pub fn new(a: &Correct, format: Format) -> Result<Self, InputError> {
        let files = files(a, format);
        if a.programs.len() > 1 && !a.out.is_dir() {
            let expected = "one for the corrected files of several programs";
            return Err(InputError::new(&a.out, "no folder", expected)
                .with_help("create this folder first"));
        }
        if is_stdout(&a.out) && files.len() > 1 {
            let expected = "a file, beside which the data list is written";
            return Err(InputError::new(&a.out, "standard output", expected));
        }
        let mut beside: Vec<PathBuf> = a.programs.iter().flat_map(|p| format.beside(p)).collect();
        beside.sort();
        beside.dedup();
        Ok(Self {
            records: files.iter().map(|(_, out)| record_path(out)).collect(),
            is_stream: files.iter().any(|(_, out)| is_stdout(out)),
            beside,
            files,
        })
    }

    /// Returns all paths that are written without `--dry-run`.
    pub fn outputs<'a>(&'a self, a: &'a Correct) -> Vec<Output<'a>> {
        let results = self.files.iter().map(|(_, out)| out.as_path());
        let mut outputs: Vec<Output<'_>> = results
            .map(|out| (Some(out), Kind::Program(is_result)))
            .collect();
        if !self.is_stream {
            let records = self.records.iter().map(PathBuf::as_path);
            outputs.extend(records.map(|path| (Some(path), Kind::Record)));
        }
        outputs.extend([
            (a.json.as_deref(), Kind::Json),
            (a.report.as_deref(), Kind::Report),
        ]);
        outputs
    }

    /// Returns all paths that are read.
    pub fn inputs<'a>(&'a self, a: &'a Correct) -> Vec<&'a Path> {
        let mut inputs: Vec<&Path> = vec![&a.blob];
        let others = a.with.iter().chain(&self.beside).chain(&a.frames);
        inputs.extend(
            self.files
                .iter()
                .map(|(path, _)| path)
                .chain(others)
                .map(PathBuf::as_path),
        );
        inputs
    }

    /// Returns what is written, each with its path: with `--dry-run` neither programs nor records.
    pub fn written<'a>(&'a self, a: &'a Correct, texts: &Texts<'a>) -> Vec<(&'a Path, &'a [u8])> {
        let mut written: Vec<(&Path, &[u8])> = Vec::new();
        if !a.dry_run {
            let results = self.files.iter().zip(texts.results);
            written
                .extend(results.map(|((_, out), (result, _))| (out.as_path(), result.as_slice())));
        }
        if !self.is_stream && !a.dry_run {
            let records = self.records.iter().zip(texts.records);
            written.extend(records.map(|(path, text)| (path.as_path(), text.as_bytes())));
        }
        let others = [(&a.json, texts.json), (&a.report, texts.report)];
        for (path, text) in others {
            if let (Some(path), Some(text)) = (path, text) {
                written.push((path, text.as_bytes()));
            }
        }
        written
    }
}

/// Returns the path that is read and the path that is written, for each program and the data list that belongs to it.
fn files(a: &Correct, format: Format) -> Files {
    let is_folder = a.programs.len() > 1 || a.out.is_dir();
    let mut files = Files::new();
    for path in &a.programs {
        let out = if is_folder {
            a.out.join(path.file_name().unwrap_or_default())
        } else {
            a.out.clone()
        };
        let companion = format
            .companion(path)
            .filter(|path| !a.programs.contains(path));
        if let Some(companion) = companion {
            let ending = companion.extension().unwrap_or_default().to_owned();
            files.push((companion, out.with_extension(ending)));
        }
        files.push((path.clone(), out));
    }
    files
}
