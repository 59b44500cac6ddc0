//! The record beside a corrected program: which model made which bytes of which. A program keeps its own bytes, so that it
//! cannot say itself that it was corrected.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::cli::failure::Failure;
use crate::cli::inputs::file_name;
use crate::robot_programs::correction::engine::Direction;
use crate::robot_programs::correction::replacement::Rewritten;
use poegp_calibration::input_error::InputError;

/// Ending of a record's name.
const ENDING: &str = ".poegp.json";
/// A record is not longer.
const LONGEST: u64 = 1 << 24;

/// What a record says.
#[derive(Debug, Deserialize, Serialize)]
pub struct Record {
    version: String,
    source: String,
    model_sha256: String,
    source_sha256: String,
    result_sha256: String,
    is_inverse: bool,
    /// Where in the result instructions are that the source does not have: first byte, and the one behind the last.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inserted: Vec<(usize, usize)>,
}

impl Record {
    /// Of one file.
    pub fn new(
        path: &Path,
        model: &str,
        source_sha256: &str,
        (result, inserted): &Rewritten,
        direction: Direction,
    ) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: file_name(path),
            model_sha256: model.to_owned(),
            source_sha256: source_sha256.to_owned(),
            result_sha256: sha256(result),
            is_inverse: direction == Direction::Inverse,
            inserted: inserted.clone(),
        }
    }
}

/// SHA-256 as hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// Refuses a program that a record of its folder names as corrected already, and one to be brought back that another model
/// has corrected. Returns the record of the one that is brought back, if there is one.
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
        let found = format!("a program that was corrected already: {name} says so");
        match direction {
            Direction::Correct => {
                return Err(InputError::new(path, found, "a program that was not")
                    .with_help(format!(
                        "correct {} instead, or bring this one back with --inverse",
                        record.source
                    ))
                    .into());
            }
            Direction::Inverse if record.model_sha256 != model => {
                let found = format!("a program that another model has corrected: {name} says so");
                return Err(InputError::new(path, found, "the model that corrected it").into());
            }
            Direction::Inverse => return Ok(Some(record)),
        }
    }
    Ok(None)
}
