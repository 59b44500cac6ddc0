//! Converts measurement files as instruments write them into measurement files of this project, by a map of their columns.
//!
//! ```text
//! raw files ──> text (encoding, separator, header) ──> fields by the map ──> rows ──> CSV of poegp_calibration::measurement
//!                                                        points, joints ──> rigid fit ──┘
//! ```
//!
//! `docs/reference/column-map.md` has the map's keys, `docs/guide/import.md` has examples. Nothing is dropped in silence:
//! a field that is not what the map says is refused with file, line and column; a row without a measurement is refused
//! unless the map says `incomplete = "leave-out"`, and is then listed; and columns that the map does not name are listed.
//!
//! **Rounding.** Whatever the shape of the input, written numbers are rounded once, at the end: positions to 1e-6 mm,
//! joints to 1e-10 degrees (1e-6 mm), quaternions to 1e-10, all below a nanometre at the tool. Two shapes of one
//! measurement give the same rows to the last character as long as the raw file has enough digits.

mod beside;
pub mod column_map;
mod columns;
mod join;
mod marks;
mod orientation;
mod origin;
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

use crate::import::column_map::{Join, JoinBy, Layout, Map};
use crate::import::text::Table;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement as measurements;

pub use crate::import::write::Row;

/// Result of an import.
#[derive(Debug)]
pub struct Imported {
    /// The measurement file.
    pub csv: String,
    /// The rows in it.
    pub rows: Vec<Row>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Imports `raws` as `map` says: one file of rows; or two files, first the points or poses, then the joints.
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

/// Imports files whose contents are `bytes`; `raws` are their names.
///
/// # Errors
/// See [`import`].
pub fn import_bytes(
    raws: &[PathBuf],
    bytes: &[Vec<u8>],
    map: &Map,
) -> Result<Imported, InputError> {
    // A blank row has its place in an order, and is refused there; otherwise it is no row.
    let is_ordered = map
        .join
        .as_ref()
        .is_some_and(|join| join.by == JoinBy::Order)
        || map
            .points
            .as_ref()
            .is_some_and(|points| points.join == Join::Order);
    let parse = |path: &Path, bytes: &[u8], layout: &Layout| {
        let mut table = Table::parse(path, bytes, layout)?;
        table.rows.retain(|line| is_ordered || !line.is_blank());
        Ok::<_, InputError>(table)
    };
    let two = map.points.is_some() || map.join.is_some();
    let (rows, mut notes, origins) = match (two, raws, bytes) {
        (false, [path], [bytes]) => poses::rows(&parse(path, bytes, &map.file)?, None, map)?,
        (true, [poses, joints], [pose_bytes, joint_bytes]) => {
            let layout = map.joints_file.as_ref().unwrap_or(&map.file);
            let poses = parse(poses, pose_bytes, &map.file)?;
            let joints = parse(joints, joint_bytes, layout)?;
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
    // Read the output again: an import that no other command accepts is no use.
    let lines = rows.iter().map(|row| row.line);
    let set = measurements::parse_rows_of(&raws[0], csv.as_bytes(), lines)
        .map_err(|error| origin::cited(error, &rows, &origins))?;
    let file = raws[0].display();
    notes.extend(set.notes.iter().map(|note| format!("{file}: {note}")));
    Ok(Imported { csv, rows, notes })
}
