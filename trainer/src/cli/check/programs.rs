//! Corrected programs: which model corrected each, and how far its targets would move if the checked model corrected it.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::correct::record::{Record, Target, program_of, record_path, sha256};
use crate::cli::failure::Failure;
use crate::robot_programs::correction::engine::TRUSTED;
use crate::signing::unsigned;
use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::robot::normal_form::translation;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;

/// A corrected program, summarised from its record.
#[derive(Debug, Serialize)]
pub struct CorrectedProgram {
    pub program: String,
    /// Name of the original program.
    pub source: String,
    /// Whether the model of this check corrected the program.
    pub by_this_model: bool,
    /// Whether the program was brought back to the nominal model instead of corrected.
    pub is_brought_back: bool,
    /// Whether the program's file still has the bytes that the record states; absent if there is no such file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub is_unchanged: Option<bool>,
    /// Number of targets that were corrected.
    pub targets: usize,
    /// Number of recorded targets that were compared.
    pub compared: usize,
    /// Number of the compared targets that the checked model does not correct.
    pub uncorrected: usize,
    /// How far the other compared targets would move.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moves_mm: Option<Summary>,
}

impl CorrectedProgram {
    /// Describes which model corrected the program, and whether its file still has that result.
    pub fn state(&self) -> String {
        let by = match (self.is_brought_back, self.by_this_model) {
            (true, _) => "restored to the nominal arm",
            (false, true) => "corrected by this model",
            (false, false) => "corrected by another model",
        };
        let since = match self.is_unchanged {
            Some(true) => "",
            Some(false) => ", and changed since",
            None => ", and missing",
        };
        format!("{by}{since}")
    }

    /// Formats a line about the program for the user.
    pub fn text(&self) -> String {
        let mut out = format!("{}: {}", self.program, self.state());
        if let Some(mm) = &self.moves_mm {
            let of_all = match self.compared == self.targets {
                true => format!("its {} targets", self.targets),
                false => format!("{} of its {} targets", self.compared, self.targets),
            };
            out += &format!(
                "; {of_all} would now move by {:.3} mm on average and {:.3} mm at most",
                mm.mean, mm.max
            );
        }
        if self.uncorrected > 0 {
            out += &format!("; this model leaves {} of them", self.uncorrected);
        }
        let is_old = !self.by_this_model && !self.is_brought_back;
        out += &match (is_old, self.compared) {
            (false, _) => ".".to_owned(),
            (true, 0) => format!(
                "; its record has no targets to compare. Correct {} again.",
                self.source
            ),
            (true, _) => format!(". Correct {} again.", self.source),
        };
        out
    }
}

/// Finds the records of programs and folders, and compares each with a model.
///
/// # Errors
/// [`InputError`] for a program or folder without a record, and for a record of another robot.
pub fn compared(
    paths: &[PathBuf],
    model: &BlobModel,
    blob: &Path,
) -> Result<Vec<CorrectedProgram>, Failure> {
    if paths.is_empty() {
        return Ok(Vec::new());
    }
    let commander = Commander::new(model).map_err(|error| {
        let expected = "a model blob written by `trainer calibrate`";
        InputError::new(blob, error.to_string(), expected)
    })?;
    let own = sha256(&unsigned(model.bytes()));
    let mut out = Vec::new();
    for path in paths {
        for path in records(path)? {
            let record = Record::read(&path)?;
            out.push(compare(&path, &record, model, &commander, &own)?);
        }
    }
    Ok(out)
}

/// Returns the files that [`compared`] reads: records, and their programs.
pub fn files(paths: &[PathBuf]) -> Vec<PathBuf> {
    let records = paths
        .iter()
        .flat_map(|path| records(path).unwrap_or_default());
    records
        .flat_map(|record| [program_of(&record), Some(record)])
        .flatten()
        .collect()
}

/// Returns the record of a program, or those of all programs in a folder.
fn records(path: &Path) -> Result<Vec<PathBuf>, InputError> {
    let expected =
        "a program that `trainer correct` wrote, its record beside it, or a folder with some";
    if !path.is_dir() {
        let record = match program_of(path) {
            Some(_) => path.to_path_buf(),
            None => record_path(path),
        };
        return match record.exists() {
            true => Ok(vec![record]),
            false => {
                let found = format!("no record {}", record.display());
                Err(InputError::new(path, found, expected))
            }
        };
    }
    let entries =
        std::fs::read_dir(path).map_err(|error| InputError::unreadable(path, &error, expected))?;
    let names = entries.flatten().map(|entry| path.join(entry.file_name()));
    let mut found: Vec<PathBuf> = names.filter(|name| program_of(name).is_some()).collect();
    found.sort();
    match found.is_empty() {
        true => Err(InputError::new(path, "no record *.poegp.json", expected)),
        false => Ok(found),
    }
}

fn compare(
    path: &Path,
    record: &Record,
    model: &BlobModel,
    commander: &Commander,
    own: &str,
) -> Result<CorrectedProgram, InputError> {
    let robot = &model.blob().robot;
    let joints = robot.joints.len();
    let other = |target: &&Target| target.joints.len() != joints || target.command.len() != joints;
    if record.targets.iter().any(|target| other(&target)) || record.robot != robot.name {
        let found = format!("a program of \"{}\"", record.robot);
        let expected = format!(
            "one of \"{}\" with {joints} joints, as the model",
            robot.name
        );
        return Err(InputError::new(path, found, expected));
    }
    let program = program_of(path).unwrap_or_default();
    let bytes = std::fs::read(&program).ok();
    let by_this_model = record.model_sha256 == own;
    let is_old = !by_this_model && !record.is_inverse;
    let moves: Vec<Option<f64>> = match is_old {
        true => record.targets.iter().map(|t| moved(commander, t)).collect(),
        false => Vec::new(),
    };
    let moved: Vec<f64> = moves.iter().flatten().copied().collect();
    Ok(CorrectedProgram {
        program: program.display().to_string(),
        source: record.source.clone(),
        by_this_model,
        is_brought_back: record.is_inverse,
        is_unchanged: bytes.map(|bytes| sha256(&bytes) == record.result_sha256),
        targets: record.corrected,
        compared: moves.len(),
        uncorrected: moves.len() - moved.len(),
        moves_mm: (!moved.is_empty()).then(|| Summary::of(moved)),
    })
}

/// Computes how far the real tool moves, by the model, from the recorded command to the model's own, in mm. `None` if
/// `correct` would leave the target with this model.
fn moved(commander: &Commander, target: &Target) -> Option<f64> {
    let padded = |q: &[f64]| -> Joints {
        let mut out = [0.0; MAX_JOINTS];
        out[..q.len()].copy_from_slice(q);
        out
    };
    let [x, y, z] = target.tool_m;
    let flange_from_tool = translation(x, y, z);
    let now = commander.correct_target(
        &padded(&target.joints),
        target.payload_kg,
        &flange_from_tool,
    );
    let refused = [Status::CORRECTION_LIMITED, Status::BAD_INPUT];
    let trust = commander
        .evaluate(&padded(&target.joints), target.payload_kg)
        .trust;
    if refused.into_iter().any(|bit| now.status.contains(bit))
        || trust < TRUSTED
        || commander.beyond_limit(&now.joints).is_some()
    {
        return None;
    }
    let goes = |command: &Joints| {
        let tool = commander.real_flange(command, target.payload_kg) * flange_from_tool;
        tool.translation
    };
    Some(1e3 * (goes(&padded(&target.command)) - goes(&now.joints)).norm())
}
