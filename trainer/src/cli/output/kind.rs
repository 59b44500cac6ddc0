//! Kinds of output files. An existing file is replaced only if it is empty or recognisably an earlier output of the same
//! kind: a mistyped name must not cost the user a file.

use std::path::Path;

use poegp_calibration::input_error::InputError;
use poegp_protocol::blob::envelope;
use serde_json::Value;

use crate::cli::failure::Failure;
use crate::cli::output::paths::is_stream;
use crate::signing::document;

/// Bytes at the beginning of a text that have its marks. Only a URDF may have more before them: its own first comment.
const HEAD: usize = 1 << 16;
/// Bytes of a mebibyte: flash images are whole ones.
const MEBIBYTE: usize = 1 << 20;
/// What every file of `export` says of itself.
const CHAIN: &str = "calibrated chain of model `";
/// Keys of which every JSON document of results has one group, beside `version`.
const DOCUMENTS: [&[&str]; 27] = [
    &["training_poses"],
    &["robot", "touches"],
    &["methods"],
    &["name", "models"],
    &["training_data"],
    &["holds"],
    &["corrected", "uncorrected"],
    &["language", "targets"],
    &["setpoint"],
    &["period_us", "max_instructions"],
    &["strategy", "poses"],
    &["measurements"],
    &["touches", "features"],
    &["payloads_kg"],
    &["firmware_version"],
    &["key", "port"],
    &["uploaded"],
    &["flagged"],
    &["statistics"],
    &["board", "elf"],
    &["secret_key_file"],
    &["replaced_key"],
    &["signature_file"],
    &["verified"],
    &["format_version"],
    &["remarks", "not_carried"],
    &["refused"],
];

/// The kind of a file that a command writes.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A model.
    Model,
    /// Results for other programs, of any command.
    Json,
    /// The dialogue of `measure`, one JSON document per line.
    Dialogue,
    /// A report.
    Report,
    /// A project file.
    Project,
    /// The parameters of `calibrate --controller-csv`.
    ControllerCsv,
    /// The predictions of `evaluate`.
    Predictions,
    /// Corrected joint targets.
    Targets,
    /// A corrected robot program, and whether the contents of a file at a path are what the record beside it says.
    Program(fn(&Path, &[u8]) -> bool),
    /// The record of a corrected program.
    Record,
    /// Imported measurements or touches.
    Imported,
    /// Simulated measurements.
    Simulated,
    /// Measured rows: `measure` adds to them.
    Rows,
    /// The signature of a document.
    Signature,
    /// A calibrated URDF.
    Urdf,
    /// A model for MuJoCo.
    Mjcf,
    /// The kinematics file of the Universal Robots driver.
    UrKinematics,
    /// A Denavit-Hartenberg table.
    Dh,
    /// A Denavit-Hartenberg table in the modified convention.
    ModifiedDh,
    /// A table of frames.
    Poe,
    /// Joint offsets.
    JointOffsets,
    /// A C header.
    CHeader,
    /// A script that completes commands.
    Completions,
    /// A manual page.
    ManualPage,
    /// The flash of an emulated board, which is changed in place.
    FlashImage,
    /// A file that is made to be filled in by hand: [`super::check_not_filled_in`] compares its contents.
    FilledIn,
}

impl Kind {
    /// Says what a file of this kind is.
    const fn what(self) -> &'static str {
        match self {
            Self::Model => "a model (.blob)",
            Self::Json => "a JSON document of results by `trainer`",
            Self::Dialogue => "a dialogue by `trainer measure`",
            Self::Report => "a report by `trainer`",
            Self::Project => "a project file by `trainer calibrate`",
            Self::ControllerCsv => "a table by `trainer calibrate --controller-csv`",
            Self::Predictions => "a table by `trainer evaluate --predictions`",
            Self::Targets => "a table of corrected targets by `trainer`",
            Self::Program(_) => "a program that is as `trainer correct` wrote it, with its record",
            Self::Record => "a record by `trainer correct`",
            Self::Imported => "a file by `trainer import`",
            Self::Simulated => "simulated measurements by `trainer`",
            Self::Rows => "a measurement file or touch file, to which rows are added",
            Self::Signature => "a signature by `trainer sign`",
            Self::Urdf => "a URDF by `trainer export --out`",
            Self::Mjcf => "a model by `trainer export --mjcf`",
            Self::UrKinematics => "a file by `trainer export --ur-kinematics`",
            Self::Dh => "a table by `trainer export --dh`",
            Self::ModifiedDh => "a table by `trainer export --mdh`",
            Self::Poe => "a table by `trainer export --poe`",
            Self::JointOffsets => "a table by `trainer export --joint-offsets`",
            Self::CHeader => "a header by `trainer export --c-header`",
            Self::Completions => "a script by `trainer completions`",
            Self::ManualPage => "a page by `trainer manual`",
            Self::FlashImage => "a flash image by `trainer device emulate`",
            Self::FilledIn => "a file to be filled in by hand",
        }
    }

    /// Whether `there`, the contents of the file at `path`, are recognisably of this kind.
    fn recognises(self, path: &Path, there: &[u8]) -> bool {
        let head = String::from_utf8_lossy(&there[..there.len().min(HEAD)]);
        let begins = |mark: &str| head.starts_with(mark);
        let has = |mark: &str| head.contains(mark);
        let is_export = |marks: &[&str]| {
            let text = String::from_utf8_lossy(there);
            text.contains(CHAIN) && marks.iter().any(|mark| text.contains(mark))
        };
        match self {
            Self::Model => there.starts_with(&envelope::MAGIC),
            Self::Json => is_document(there),
            Self::Dialogue => is_dialogue(&head),
            Self::Report => has("<meta name=\"generator\" content=\"poegp trainer"),
            Self::Project => begins("# `trainer calibrate` with this file repeats the calibration"),
            Self::ControllerCsv => begins("table,name,quantity,unit,before,after,difference,"),
            Self::Predictions => begins("x_mm,y_mm,z_mm,qw,qx,qy,qz,status"),
            Self::Targets => header(&head).is_some_and(|line| line.contains("position_error_um")),
            Self::Program(is_result) => is_result(path, there),
            Self::Record => object(there).is_some_and(|record| !record["result_sha256"].is_null()),
            Self::Imported => {
                begins("# imported by trainer ") || begins("# imported socket touches\n")
            }
            Self::Simulated => begins("# simulated "),
            Self::Rows => are_rows(&head),
            Self::Signature => begins(document::TITLE),
            Self::Urdf => is_export(&["<robot"]),
            Self::Mjcf => is_export(&["<mujoco"]),
            Self::UrKinematics => is_export(&["kinematics:\n", "base_link_inertia"]),
            Self::Dh => is_export(&["\"convention\": \"dh\"", " Rows: R_z(q"]),
            Self::ModifiedDh => is_export(&["\"convention\": \"modified-dh\"", " Rows: T_x(a)"]),
            Self::Poe => is_export(&[
                "\"convention\": \"poe\"",
                " A joint's origin is in the frame",
            ]),
            Self::JointOffsets => is_export(&["base_from_nominal"]),
            Self::CHeader => is_export(&["Written by `trainer export --c-header`"]),
            Self::Completions => [
                "_trainer() {",
                "#compdef trainer",
                "function __fish_trainer",
                "arg-completer[trainer]",
            ]
            .iter()
            .any(|mark| has(mark)),
            Self::ManualPage => has("\n.TH trainer"),
            Self::FlashImage => there.len().is_multiple_of(MEBIBYTE),
            Self::FilledIn => true,
        }
    }
}

/// Refuses to replace a file that is neither empty nor recognisably of this kind.
///
/// # Errors
/// [`InputError`] names the file.
pub fn check_kind(path: &Path, kind: Kind) -> Result<(), Failure> {
    if matches!(kind, Kind::FilledIn) || is_stream(path) || !path.is_file() {
        return Ok(());
    }
    let expected = format!("a new file, an empty one, or {}", kind.what());
    let there =
        std::fs::read(path).map_err(|error| InputError::unreadable(path, &error, &expected))?;
    if there.is_empty() || kind.recognises(path, &there) {
        return Ok(());
    }
    Err(
        InputError::new(path, "a file with other contents", expected)
            .with_help("nothing was written: choose another name, or delete this file")
            .into(),
    )
}

/// Returns the JSON object in a file.
fn object(bytes: &[u8]) -> Option<Value> {
    let value: Value = serde_json::from_slice(bytes).ok()?;
    value.is_object().then_some(value)
}

/// Whether a file is a document of results.
fn is_document(bytes: &[u8]) -> bool {
    let Some(document) = object(bytes) else {
        return false;
    };
    let has = |key: &&str| document.get(*key).is_some();
    let mut keys = document.as_object().into_iter().flat_map(|of| of.keys());
    // The list of manual pages has nothing else.
    let is_list =
        has(&"files") && keys.all(|key| ["files", "version", "warnings"].contains(&&**key));
    document["version"].is_string()
        && (is_list || DOCUMENTS.iter().any(|group| group.iter().all(has)))
}

/// Whether the first line of a text is an event of `measure`.
fn is_dialogue(text: &str) -> bool {
    let first = text.lines().next().unwrap_or_default();
    object(first.as_bytes()).is_some_and(|line| line["event"].is_string())
}

/// Returns the first line of a table that is neither blank nor a comment.
fn header(text: &str) -> Option<&str> {
    text.lines()
        .find(|line| !line.trim().is_empty() && !line.starts_with('#'))
}

/// Whether a text has joint columns, or is the beginning of a header that a power failure has cut.
fn are_rows(text: &str) -> bool {
    let is_of_names = |c: char| c.is_ascii_alphanumeric() || ['_', ',', '\0'].contains(&c);
    header(text).is_none_or(|line| {
        let has_joints = line.split(',').any(|name| name.trim().starts_with("q1_"));
        let is_cut = text.ends_with(line) && line.contains(',') || line.starts_with('\0');
        has_joints || (is_cut && line.chars().all(is_of_names))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_of_other_programs_are_no_results() {
        for (text, is_own) in [
            (r#"{"version": "0.1.0", "verified": true}"#, true),
            (r#"{"version": "0.1.0", "files": ["trainer.1"]}"#, true),
            (
                r#"{"version": "1.0.0", "name": "package", "files": ["lib"]}"#,
                false,
            ),
            (r#"{"version": 3, "verified": true}"#, false),
            (r#"{"verified": true}"#, false),
            (r#"["version", "verified"]"#, false),
            ("poegp secret key, Ed25519", false),
        ] {
            assert_eq!(is_document(text.as_bytes()), is_own, "{text}");
        }
    }

    #[test]
    fn a_dialogue_begins_with_an_event() {
        let text = "{\"columns\":\"q1_deg\",\"event\":\"columns\"}\n{\"event\":\"end\"}\n";
        assert!(is_dialogue(text));
        assert!(!is_dialogue("event\n") && !is_dialogue("{\"event\": 1}\n"));
    }

    #[test]
    fn rows_are_added_only_to_tables_with_joints() {
        for (text, are) in [
            ("# skip: line 7\nq1_deg,x_mm\n1,2\n", true),
            ("feature,q1_deg\n", true),
            ("q1_deg,x_", true),
            ("# torn, left out: q1\n", true),
            ("\0\0\0", true),
            ("Call the customer, then measure again\n", false),
            ("Call the customer", false),
            ("a,b\n1,2\n", false),
        ] {
            assert_eq!(are_rows(text), are, "{text:?}");
        }
    }
}
