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
mod campaign;
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

use crate::import::campaign::Part;
use crate::import::column_map::{Join, JoinBy, Layout, Map};
use crate::import::origin::ReadRows;
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

/// Imports `raws` as `map` says: files of rows, one or several of one campaign; or two files, first the points or poses, then
/// the joints.
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
    import_bytes(raws, &bytes, &[map], false)
}

/// Imports files whose contents are `bytes`; `raws` are their names. Each file has its own of `maps`, or the last of them.
/// `is_session_per_file` gives the rows of each file a session with the file's name.
///
/// # Errors
/// See [`import`].
pub fn import_bytes(
    raws: &[PathBuf],
    bytes: &[Vec<u8>],
    maps: &[&Map],
    is_session_per_file: bool,
) -> Result<Imported, InputError> {
    let map = maps[0];
    let (files_of_a_part, expected) = match map.points.is_some() || map.join.is_some() {
        true => (
            2,
            "two, the points or poses and then the joints, as the map has [points] or [join]",
        ),
        false => (1, "at least one"),
    };
    if raws.len() < files_of_a_part || (files_of_a_part == 2 && raws.len() > 2) {
        let found = match raws.len() {
            1 => "1 file to import".to_owned(),
            count => format!("{count} files to import"),
        };
        return Err(InputError::new(&map.path, found, expected));
    }
    let sources: Vec<String> = raws
        .iter()
        .zip(bytes)
        .map(|(path, bytes)| source(path, bytes))
        .collect();
    let (mut parts, mut notes) = (Vec::new(), Vec::new());
    let groups = raws
        .chunks(files_of_a_part)
        .zip(bytes.chunks(files_of_a_part));
    for (k, (raws, bytes)) in groups.enumerate() {
        let map = maps[k.min(maps.len() - 1)];
        let (rows, of_file, origins) = rows(raws, bytes, map)?;
        let (path, bytes) = (raws[0].as_path(), bytes[0].as_slice());
        let mut part = Part { path, bytes, rows };
        if is_session_per_file {
            campaign::name_session(&mut part)?;
        }
        notes.extend(of_file);
        // Read what is written: an import that no other command accepts is no use.
        let csv = write::csv(&part.rows, &sources);
        let lines = part.rows.iter().map(|row| row.line);
        let set = measurements::parse_rows_of(path, csv.as_bytes(), lines)
            .map_err(|error| origin::cited(error, &part.rows, &origins))?;
        let of_set = set.notes.iter();
        notes.extend(of_set.map(|note| format!("{}: {note}", path.display())));
        parts.push(part);
    }
    notes.extend(campaign::note(&parts));
    let rows = campaign::join(parts, is_session_per_file)?;
    let csv = write::csv(&rows, &sources);
    Ok(Imported { csv, rows, notes })
}

/// Returns the name of a file with its digest.
fn source(path: &Path, bytes: &[u8]) -> String {
    let name = path
        .file_name()
        .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let digest: String = Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    format!("{name} (SHA-256 {digest})")
}

/// Reads the rows of one file, or of poses and joints in two.
fn rows(raws: &[PathBuf], bytes: &[Vec<u8>], map: &Map) -> Result<ReadRows, InputError> {
    // A blank row has its place in an order, and is refused there; otherwise it is no row.
    let is_ordered = map
        .join
        .as_ref()
        .is_some_and(|join| join.by == JoinBy::Order)
        || map
            .points
            .as_ref()
            .is_some_and(|points| points.join == Join::Order);
    let parse = |k: usize, layout: &Layout| {
        let mut table = Table::parse(&raws[k], &bytes[k], layout)?;
        table.rows.retain(|line| is_ordered || !line.is_blank());
        Ok::<_, InputError>(table)
    };
    let poses = parse(0, &map.file)?;
    if raws.len() == 1 {
        return poses::rows(&poses, None, map);
    }
    let joints = parse(1, map.joints_file.as_ref().unwrap_or(&map.file))?;
    match &map.join {
        Some(join) => poses::rows(&poses, Some((&joints, join)), map),
        None => points::rows(&poses, &joints, map),
    }
}
