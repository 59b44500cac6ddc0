//! Sheets of an xlsx file as rows of fields.
//!
//! The sheet is read as a stream, so that a single field far out does not allocate a table of that size. A number becomes
//! text with the decimal mark of the map; a date becomes a date and time of ISO 8601, which no reader accepts as a number.
//!
//! A small file can expand to gigabytes: compressed zeros, one long text that all fields share, or one far-out field in each
//! of a million rows. All three are counted, and refused before they take the memory.

use std::io::{Cursor, Read as _};
use std::path::Path;

use calamine::{DataRef, ExcelDateTime, Reader as _, Xlsx};
use zip::ZipArchive;

use crate::import::column_map::{Decimal, Layout};
use poegp_calibration::input_error::InputError;

/// Largest number of columns of a table of measurements.
const MOST_COLUMNS: usize = 1000;
/// Largest number of fields (rows times columns) of a table of measurements.
const LARGEST_TABLE: usize = 10_000_000;
/// Largest size in bytes of a decompressed file, and of the texts of all its fields.
const MOST_BYTES: u64 = 1 << 28;

/// A row of a sheet.
pub struct SheetRow {
    /// Number in the sheet, from 1.
    pub number: usize,
    /// Texts of its fields.
    pub fields: Vec<String>,
    /// Which of them are numbers.
    pub are_numbers: Vec<bool>,
}

/// Returns whether a file is a zip file, as every xlsx file is.
pub fn is_zip(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04")
}

/// Refuses a file that would become too large: decompresses every part once and discards it.
fn bounded(path: &Path, bytes: &[u8]) -> Result<(), InputError> {
    // A file that is no zip file is reported by its reader.
    let Ok(mut archive) = ZipArchive::new(Cursor::new(bytes)) else {
        return Ok(());
    };
    let mut left = MOST_BYTES;
    for index in 0..archive.len() {
        let Ok(part) = archive.by_index(index) else {
            continue;
        };
        let name = part
            .name()
            .map_or_else(|_| index.to_string(), |name| name.into_owned());
        let read = std::io::copy(&mut part.take(left + 1), &mut std::io::sink());
        match read.ok().and_then(|read| left.checked_sub(read)) {
            Some(rest) => left = rest,
            None => {
                let found = format!("a zip file whose part {name:?} is damaged or too large");
                let expected =
                    format!("an xlsx file of at most {MOST_BYTES} bytes once it is decompressed");
                return Err(
                    InputError::new(path, found, expected).with_help("export the table as CSV")
                );
            }
        }
    }
    Ok(())
}

/// Returns a date and time as ISO 8601 has it, and a time of day or a duration below a day as a clock shows it.
fn date_text(date: &ExcelDateTime) -> String {
    let (year, month, day, hours, minutes, seconds, millis) = date.to_ymd_hms_milli();
    let time = format!("{hours:02}:{minutes:02}:{seconds:02}.{millis:03}");
    match (0.0..1.0).contains(&date.as_f64()) {
        true => time,
        false => format!("{year:04}-{month:02}-{day:02}T{time}"),
    }
}

/// Returns the rows of the sheet that the map names, or of the only sheet.
pub fn rows(path: &Path, bytes: &[u8], layout: &Layout) -> Result<Vec<SheetRow>, InputError> {
    let unreadable = |error: calamine::XlsxError| {
        let found = format!("a zip file that cannot be read as xlsx ({error})");
        InputError::new(path, found, "text or an xlsx file").with_help("export the table as CSV")
    };
    bounded(path, bytes)?;
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
    let mut out: Vec<SheetRow> = Vec::new();
    let (mut letters, mut widest) = (0, 0);
    while let Some(read) = stream.next_cell().map_err(unreadable)? {
        let is_number = matches!(read.get_value(), DataRef::Int(_) | DataRef::Float(_));
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
            DataRef::DateTime(date) => date_text(date),
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
        if out.last().is_none_or(|last| last.number != number) {
            out.push(SheetRow {
                number,
                fields: Vec::new(),
                are_numbers: Vec::new(),
            });
        }
        widest = widest.max(column + 1);
        if out.len() * widest > LARGEST_TABLE {
            let found = format!("a table of {} rows and {widest} columns", out.len());
            let error = InputError::new(path, found, format!("at most {LARGEST_TABLE} cells"));
            return Err(error.at_line(number));
        }
        letters += text.len() as u64;
        if letters > MOST_BYTES {
            let expected = format!("at most {MOST_BYTES} bytes");
            let error = InputError::new(path, "cells with longer texts", expected);
            return Err(error.at_line(number));
        }
        if let Some(row) = out.last_mut() {
            let width = row.fields.len().max(column + 1);
            row.fields.resize(width, String::new());
            row.are_numbers.resize(width, false);
            row.fields[column] = text;
            row.are_numbers[column] = is_number;
        }
    }
    // A file does not store empty fields at the end of a row.
    let width = out.iter().map(|row| row.fields.len()).max();
    for row in &mut out {
        row.fields.resize(width.unwrap_or(0), String::new());
    }
    Ok(out)
}
