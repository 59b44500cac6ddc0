//! Provenance of a result, so that it can be reproduced.

use serde::Serialize;
use sha2::{Digest, Sha256};

use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::touch::TouchSet;

/// A file that was read or written.
#[derive(Clone, Debug, Serialize)]
pub struct FileSummary {
    /// Use of the file.
    pub role: &'static str,
    /// Path as it was typed.
    pub file: String,
    /// SHA-256 of the bytes.
    pub sha256: String,
    /// Number of rows of a measurement file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rows: Option<usize>,
}

impl FileSummary {
    /// Describes a measurement file.
    pub fn of_set(role: &'static str, set: &MeasurementSet) -> Self {
        Self {
            role,
            file: set.path.display().to_string(),
            sha256: hex(&set.sha256),
            rows: Some(set.measurements.len()),
        }
    }

    /// Describes a touch file: the file of its rows, and the file of its features.
    pub fn of_touches(set: &TouchSet) -> [Self; 2] {
        let [rows, features] =
            [&set.path, &set.features_path].map(|path| path.display().to_string());
        [
            Self {
                role: "touches",
                file: rows,
                sha256: hex(&set.sha256[0]),
                rows: Some(set.rows.len()),
            },
            Self {
                role: "features",
                file: features,
                sha256: hex(&set.sha256[1]),
                rows: None,
            },
        ]
    }

    /// Describes `file`, which consists of `bytes`.
    pub fn of_bytes(role: &'static str, file: impl Into<String>, bytes: &[u8]) -> Self {
        Self {
            role,
            file: file.into(),
            sha256: hex(&Sha256::digest(bytes)),
            rows: None,
        }
    }
}

/// The part `provenance` of a JSON document.
#[derive(Clone, Debug, Serialize)]
pub struct Provenance {
    /// The command line.
    pub command: String,
    /// Version of the trainer.
    pub version: &'static str,
    /// Day of the calibration, as in the blob.
    pub date: String,
    /// Seed of all random draws.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Name of the robot.
    pub robot: String,
    /// Serial number of the arm, possibly empty.
    pub serial_number: String,
    /// Files that were read or written.
    pub files: Vec<FileSummary>,
}

impl Provenance {
    /// Describes a result that this process makes, without random draws.
    pub fn new(robot: &str, serial_number: &str, date: String, files: Vec<FileSummary>) -> Self {
        Self {
            command: command_line(),
            version: env!("CARGO_PKG_VERSION"),
            date,
            seed: None,
            robot: robot.to_owned(),
            serial_number: serial_number.to_owned(),
            files,
        }
    }

    /// Names the robot, with its serial number if it has one.
    pub fn arm(&self) -> String {
        match self.serial_number.as_str() {
            "" => self.robot.clone(),
            number => format!("{}, serial number {number}", self.robot),
        }
    }
}

/// Returns the command line of this process as for a shell, with the program called `trainer`. It leaves out `--json`, which
/// only says where the results go and changes none.
fn command_line() -> String {
    let arguments = std::env::args_os().skip(1);
    command(arguments.map(|word| word.to_string_lossy().into_owned()))
}

fn command(arguments: impl Iterator<Item = String>) -> String {
    let quoted = |word: &str| {
        let plain = |c: char| c.is_alphanumeric() || "-_./=,:@+%".contains(c);
        if !word.is_empty() && word.chars().all(plain) {
            word.to_owned()
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    };
    let mut all = vec!["trainer".to_owned()];
    let mut is_destination = false;
    for word in arguments {
        let dropped = is_destination || word.starts_with("--json=");
        is_destination = !is_destination && word == "--json";
        if !dropped && !is_destination {
            all.push(quoted(&word));
        }
    }
    all.join(" ")
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_can_be_typed_again() {
        let of = |arguments: &[&str]| command(arguments.iter().map(ToString::to_string));
        let arguments = ["compare", "--json", "--json", "a b.csv", "--json=x", "it's"];
        assert_eq!(of(&arguments), r"trainer compare 'a b.csv' 'it'\''s'");
        assert_eq!(of(&["calibrate", "--json", "-"]), "trainer calibrate");
        assert_eq!(of(&["demo", ""]), "trainer demo ''");
    }
}
