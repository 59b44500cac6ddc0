//! Measurement files as they come, by a map of their columns, into the measurement file of this project.
//!
//! ```text
//! raw files ──> text (encoding, separator, header) ──> cells by the map ──> rows ──> CSV of poegp_calibration::measurement
//!                                                       points, joints ──> rigid fit ──┘
//! ```
//!
//! `docs/reference/column-map.md` has the map's keys, `docs/guide/import.md` has examples. Nothing is dropped in silence: a cell that is not
//! what the map says is refused with file, line and column, a row without a measurement is refused unless the map says
//! `incomplete = "leave-out"` and then listed, and columns that the map does not name are listed.
//!
//! **Rounding.** Whatever the shape, what is written is rounded once, at the end: positions to 1e-6 mm, joints to 1e-10
//! degrees (1e-6 mm), quaternions to 1e-10, all below a nanometre at the tool. Two shapes of one measurement give the same
//! rows to the last character as long as the raw file has the digits for it.

mod beside;
pub mod column_map;
mod columns;
mod join;
mod orientation;
mod points;
mod pose;
mod poses;
pub mod preset;
mod rigid;
pub mod sockets;
mod spreadsheet;
mod text;
mod units;
mod value;
mod write;

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::import::column_map::Map;
use crate::import::text::Table;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement as measurements;

pub use crate::import::write::Row;

/// What came out of an import.
#[derive(Debug)]
pub struct Imported {
    /// The measurement file.
    pub csv: String,
    /// The rows in it.
    pub rows: Vec<Row>,
    /// What its user should see.
    pub notes: Vec<String>,
}

/// Reads `raws` as `map` says: one file of rows, or points and then joints.
///
/// # Errors
/// [`InputError`] names file, line and column of the first thing that is not as the map says.
pub fn import(raws: &[PathBuf], map: &Map) -> Result<Imported, InputError> {
    let read = |path: &Path| {
        std::fs::read(path)
            .map_err(|error| InputError::unreadable(path, &error, "a measurement file"))
    };
    let bytes = raws
        .iter()
        .map(|path| read(path))
        .collect::<Result<Vec<_>, _>>()?;
    import_bytes(raws, &bytes, map)
}

/// The same with the bytes of the files; `raws` are their names.
///
/// # Errors
/// As [`import`].
pub fn import_bytes(
    raws: &[PathBuf],
    bytes: &[Vec<u8>],
    map: &Map,
) -> Result<Imported, InputError> {
    let two = map.points.is_some() || map.join.is_some();
    let (rows, mut notes) = match (two, raws, bytes) {
        (false, [path], [bytes]) => poses::rows(&Table::parse(path, bytes, &map.file)?, None, map)?,
        (true, [poses, joints], [pose_bytes, joint_bytes]) => {
            let layout = map.joints_file.as_ref().unwrap_or(&map.file);
            let poses = Table::parse(poses, pose_bytes, &map.file)?;
            let joints = Table::parse(joints, joint_bytes, layout)?;
            match &map.join {
                Some(join) => poses::rows(&poses, Some((&joints, join)), map)?,
                None => points::rows(&poses, &joints, map)?,
            }
        }
        (two, ..) => {
            let expected = if two {
                "two, the points or poses and then the joints, as the map has [points] or [join]"
            } else {
                "one, as the map has neither [points] nor [join]"
            };
            let found = match raws.len() {
                1 => "1 file to import".to_owned(),
                count => format!("{count} files to import"),
            };
            return Err(InputError::new(&map.path, found, expected));
        }
    };
    let sources: Vec<String> = raws
        .iter()
        .zip(bytes)
        .map(|(path, bytes)| {
            let name = path
                .file_name()
                .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
            let digest: String = Sha256::digest(bytes)
                .iter()
                .map(|b| format!("{b:02x}"))
                .collect();
            format!("{name} (SHA-256 {digest})")
        })
        .collect();
    let csv = write::csv(&rows, &sources);
    // What is written is read again: a file that no other command takes is no import.
    let set = measurements::parse(Path::new("<imported>"), csv.as_bytes())?;
    notes.extend(set.notes);
    Ok(Imported { csv, rows, notes })
}
