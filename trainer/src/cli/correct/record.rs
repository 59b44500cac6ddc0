//! The record beside a corrected program: which model corrected which source to which result, with the joints before and
//! after. The program keeps its other bytes unchanged, so that it cannot carry this information itself.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::cli::failure::Failure;
use crate::cli::inputs::file_name;
use crate::robot_programs::correction::engine::Direction;
use crate::robot_programs::correction::program::{Program, frames_of};
use crate::robot_programs::correction::replacement::{Rewritten, Solved};
use poegp_calibration::blob::commander::Joints;
use poegp_calibration::input_error::InputError;

/// Ending of a record's file name.
const ENDING: &str = ".poegp.json";
/// Size limit of a record, in bytes; a longer file is not a record.
const LONGEST: u64 = 1 << 24;
/// Largest number of targets in a record, evenly spaced along the program.
const MOST_TARGETS: usize = 1_000;

/// The contents of a record.
#[derive(Debug, Deserialize, Serialize)]
pub struct Record {
    version: String,
    pub source: String,
    pub model_sha256: String,
    source_sha256: String,
    pub result_sha256: String,
    pub is_inverse: bool,
    /// Name of the robot; empty in records of earlier versions.
    #[serde(default)]
    pub robot: String,
    /// Number of targets that were corrected.
    #[serde(default)]
    pub corrected: usize,
    /// The corrected targets, or an even selection of them.
    #[serde(default)]
    pub targets: Vec<Target>,
    /// Byte ranges of inserted instructions in the result, which the source does not have: first byte, and one past the
    /// last.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inserted: Vec<(usize, usize)>,
}

/// A corrected target.
#[derive(Debug, Deserialize, Serialize)]
pub struct Target {
    /// Joints that bring the arm as drawn to the target, rad or m.
    pub joints: Vec<f64>,
    /// Joints that are commanded, rad or m.
    pub command: Vec<f64>,
    pub payload_kg: f64,
    /// Position of the tool in the flange frame, m.
    pub tool_m: [f64; 3],
}

/// The model that corrects a program, and the direction.
pub struct Corrector<'a> {
    pub robot: &'a str,
    pub joints: usize,
    pub sha256: &'a str,
    pub direction: Direction,
}

impl Record {
    /// Creates the record of file `index` of a program.
    pub fn new(
        path: &Path,
        corrector: &Corrector<'_>,
        source_sha256: &str,
        (result, inserted): &Rewritten,
        (program, solved, index): (&Program, &[Solved], usize),
    ) -> Self {
        let is_inverse = corrector.direction == Direction::Inverse;
        let is_here = |solved: &&Solved| program.targets[solved.target].location.file == index;
        let own: Vec<&Solved> = solved.iter().filter(is_here).collect();
        let count = own.len().min(MOST_TARGETS);
        let some = (0..count).map(|i| own[i * own.len() / count]);
        let joints = |q: &Joints| q[..corrector.joints].iter().map(|q| nanos(*q)).collect();
        let target = |solved: &Solved| Target {
            joints: joints(&solved.joints),
            command: joints(&solved.command),
            payload_kg: solved.payload_kg,
            tool_m: {
                let (tool, _) = frames_of(program, &program.targets[solved.target]);
                [0, 1, 2].map(|i| nanos(tool.translation[i]))
            },
        };
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: file_name(path),
            model_sha256: corrector.sha256.to_owned(),
            source_sha256: source_sha256.to_owned(),
            result_sha256: sha256(result),
            is_inverse,
            robot: corrector.robot.to_owned(),
            corrected: own.len(),
            // A program that was brought back to the drawing has nothing to compare with a model.
            targets: match is_inverse {
                true => Vec::new(),
                false => some.map(target).collect(),
            },
            inserted: inserted.clone(),
        }
    }

    /// Reads a record.
    ///
    /// # Errors
    /// [`InputError`] names the file.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let expected = "a record OUT.poegp.json, which `trainer correct` writes beside a program";
        let bytes =
            std::fs::read(path).map_err(|error| InputError::unreadable(path, &error, expected))?;
        serde_json::from_slice(&bytes)
            .map_err(|error| InputError::new(path, format!("no record: {error}"), expected))
    }
}

/// Rounds to nine decimals: nanometres or nanoradians.
fn nanos(x: f64) -> f64 {
    (1e9 * x).round() * 1e-9
}

/// Returns the path of a program's record, `OUT.poegp.json`.
pub fn record_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(ENDING);
    PathBuf::from(name)
}

/// Returns the program that a record belongs to; `None` if the file name is not that of a record.
pub fn program_of(record: &Path) -> Option<PathBuf> {
    let name = record.file_name()?.to_str()?.strip_suffix(ENDING)?;
    (!name.is_empty()).then(|| record.with_file_name(name))
}

/// Computes the SHA-256 of bytes, as hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// Refuses to correct a program that a record in its folder lists as corrected already, and to bring back one that another
/// model has corrected. Returns the record of the program that is to be brought back, if there is one.
///
/// # Errors
/// [`InputError`] names the program and the record.
pub fn refuse_corrected(
    path: &Path,
    bytes: &[u8],
    model: &str,
    direction: Direction,
) -> Result<Option<Record>, Failure> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let hash = sha256(bytes);
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Ok(None);
    };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_short = entry
            .metadata()
            .is_ok_and(|data| data.is_file() && data.len() <= LONGEST);
        if !name.ends_with(ENDING) || !is_short {
            continue;
        }
        let text = std::fs::read(entry.path()).unwrap_or_default();
        let Ok(record) = serde_json::from_slice::<Record>(&text) else {
            continue;
        };
        if record.result_sha256 != hash || record.source_sha256 == hash || record.is_inverse {
            continue;
        }
        let found = format!("a program that was corrected already ({name})");
        match direction {
            Direction::Correct => {
                return Err(InputError::new(path, found, "an uncorrected program")
                    .with_help(format!(
                        "correct {} instead, or bring this one back with --inverse",
                        record.source
                    ))
                    .into());
            }
            Direction::Inverse if record.model_sha256 != model => {
                let found = format!("a program that another model has corrected ({name})");
                return Err(InputError::new(path, found, "the model that corrected it").into());
            }
            Direction::Inverse => return Ok(Some(record)),
        }
    }
    Ok(None)
}
