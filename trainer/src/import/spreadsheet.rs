//! Sheets of an xlsx file as rows of cells.
//!
//! Cells are read as a stream, so that a sheet with one cell far out is not a table of that size. A number becomes the text
//! that has it with the decimal mark of the map; a date stays a date, which is no number of anything.

use std::io::Cursor;
use std::path::Path;

use calamine::{DataRef, Reader as _, Xlsx};

use crate::import::column_map::{Decimal, Layout};
use poegp_calibration::input_error::InputError;

/// Columns beyond are no table of measurements.
const MOST_COLUMNS: usize = 1000;

/// Whether a file is a spreadsheet, or any other zip file.
pub fn is_zip(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04")
}

/// The rows of the sheet that the map names, or of the only one, with their numbers.
pub fn rows(
    path: &Path,
    bytes: &[u8],
    layout: &Layout,
) -> Result<Vec<(usize, Vec<String>)>, InputError> {
    let unreadable = |error: calamine::XlsxError| {
        let found = format!("a zip file that cannot be read as xlsx ({error})");
        InputError::new(path, found, "text or an xlsx file").with_help("export the table as CSV")
    };
    let mut book: Xlsx<_> = Xlsx::new(Cursor::new(bytes)).map_err(unreadable)?;
    let sheets = book.sheet_names();
    let listed: Vec<String> = sheets.iter().map(|name| format!("{name:?}")).collect();
    let listed = listed.join(", ");
    let name = match (&layout.sheet, sheets.as_slice()) {
        (Some(name), sheets) if sheets.contains(name) => name,
        (Some(name), _) => {
            let found = format!("no sheet {name:?}");
            return Err(InputError::new(path, found, format!("one of {listed}")));
        }
        (None, [only]) => only,
        (None, _) => {
            let found = format!("{} sheets: {listed}", sheets.len());
            return Err(InputError::new(
                path,
                found,
                "sheet = \"…\" in [file] of the map",
            ));
        }
    };
    let mut stream = book.worksheet_cells_reader(name).map_err(unreadable)?;
    let mut out: Vec<(usize, Vec<String>)> = Vec::new();
    while let Some(read) = stream.next_cell().map_err(unreadable)? {
        let text = match read.get_value() {
            DataRef::Empty => continue,
            DataRef::Int(number) => number.to_string(),
            DataRef::Float(number) if layout.decimal == Decimal::Comma => {
                number.to_string().replace('.', ",")
            }
            DataRef::Float(number) => number.to_string(),
            DataRef::String(text) | DataRef::DateTimeIso(text) | DataRef::DurationIso(text) => {
                text.trim().to_owned()
            }
            DataRef::SharedString(text) => text.trim().to_owned(),
            DataRef::Bool(is) => is.to_string(),
            DataRef::DateTime(date) => format!("date {}", date.as_f64()),
            DataRef::Error(error) => error.to_string(),
        };
        let (row, column) = read.get_position();
        let (number, column) = (row as usize + 1, column as usize);
        if column >= MOST_COLUMNS {
            let found = format!("a cell in column {}", column + 1);
            return Err(
                InputError::new(path, found, format!("at most {MOST_COLUMNS} columns"))
                    .at_line(number),
            );
        }
        if out.last().is_none_or(|(last, _)| *last != number) {
            out.push((number, Vec::new()));
        }
        if let Some((_, fields)) = out.last_mut() {
            fields.resize(fields.len().max(column + 1), String::new());
            fields[column] = text;
        }
    }
    // Empty cells at the end of a row are not stored.
    let width = out.iter().map(|(_, fields)| fields.len()).max();
    for (_, fields) in &mut out {
        fields.resize(width.unwrap_or(0), String::new());
    }
    Ok(out)
}
