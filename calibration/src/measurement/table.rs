//! From bytes to fields: text, comments, blank lines, a header row and rows of its width.

use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};

use crate::input_error::InputError;

/// The fields of a file, trimmed.
pub(super) struct Table {
    /// Line of the header, from 1.
    pub header_line: usize,
    /// The names of the columns.
    pub header: StringRecord,
    /// Line and fields of every row, as many fields as the header has.
    pub rows: Vec<(usize, StringRecord)>,
}

impl Table {
    /// Takes a file apart; `file` is for messages.
    pub(super) fn parse(file: &Path, bytes: &[u8]) -> Result<Self, InputError> {
        let text = text(file, bytes)?;
        // Comments and blank lines are taken out before the CSV reader counts lines; `numbers` has what they were.
        let mut kept = String::with_capacity(text.len());
        let mut numbers = Vec::new();
        for (number, line) in (1..).zip(text.lines()) {
            let line = line.trim();
            if !line.is_empty() && !line.starts_with('#') {
                kept.push_str(line);
                kept.push('\n');
                numbers.push(number);
            }
        }
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .from_reader(kept.as_bytes());
        let mut rows = Vec::with_capacity(numbers.len());
        for record in reader.records() {
            let record = record.map_err(|error| InputError::new(file, error.to_string(), "CSV"))?;
            let index = record
                .position()
                .map_or(0, |at| at.line() as usize)
                .saturating_sub(1);
            rows.push((numbers.get(index).copied().unwrap_or(0), record));
        }
        let mut rows = rows.into_iter();
        let Some((header_line, header)) = rows.next() else {
            return Err(InputError::new(
                file,
                "an empty file",
                "a header row and one measured pose a row",
            ));
        };
        check_header(file, header_line, &header)?;
        let rows: Vec<_> = rows.collect();
        if rows.is_empty() {
            return Err(InputError::new(
                file,
                "a header without rows",
                "one measured pose a row after the header",
            )
            .at_line(header_line));
        }
        for (line, record) in &rows {
            check_width(file, *line, record, header.len())?;
        }
        Ok(Self {
            header_line,
            header,
            rows,
        })
    }
}

/// The bytes as text, without a byte order mark.
fn text<'a>(file: &Path, bytes: &'a [u8]) -> Result<&'a str, InputError> {
    let line_of = |at: usize| 1 + bytes[..at].iter().filter(|byte| **byte == b'\n').count();
    let binary = |at: usize, found: &str| {
        InputError::new(file, found, "a CSV text file in UTF-8").at_line(line_of(at))
    };
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(binary(0, "UTF-16 text").with_help("save the file as UTF-8"));
    }
    if bytes.starts_with(b"PK\x03\x04") {
        return Err(binary(0, "a spreadsheet or zip file").with_help("export the table as CSV"));
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if let Some(at) = bytes.iter().position(|byte| *byte == 0) {
        return Err(binary(at, "a binary file (a zero byte)"));
    }
    std::str::from_utf8(bytes).map_err(|error| {
        binary(error.valid_up_to(), "bytes that are not UTF-8 text")
            .with_help("save the file as UTF-8, or export it as CSV")
    })
}

fn check_header(file: &Path, line: usize, header: &StringRecord) -> Result<(), InputError> {
    let first = header.get(0).unwrap_or("");
    if header.len() == 1 && first.contains([';', '\t']) {
        return Err(
            InputError::new(file, "a single column", "columns separated by commas")
                .at_line(line)
                .with_help("the file seems to be separated by semicolons or tabs"),
        );
    }
    if first.parse::<f64>().is_ok() {
        return Err(InputError::new(
            file,
            format!("{} in the first row", quoted(first)),
            "a header row with the names of the columns",
        )
        .at_line(line)
        .with_help("a header after # is a comment: take the # away"));
    }
    Ok(())
}

fn check_width(
    file: &Path,
    line: usize,
    record: &StringRecord,
    width: usize,
) -> Result<(), InputError> {
    let count = record.len();
    if count == width {
        return Ok(());
    }
    let kind = if count < width { "short" } else { "long" };
    let error = InputError::new(
        file,
        format!("a {kind} row of {count} fields"),
        format!("{width} fields, as the header has"),
    )
    .at_line(line);
    let help = if record.iter().any(|field| field.contains('\n')) {
        "a quotation mark that is not closed goes on to the next line"
    } else if count < width {
        "was the file cut off here?"
    } else {
        "is a comma used as decimal point or within a text?"
    };
    Err(error.with_help(help))
}

/// Text of a file in double quotes, shortened.
pub(super) fn quoted(text: &str) -> String {
    if text.is_empty() {
        return "an empty field".to_owned();
    }
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{:?}…", &text[..end]),
        None => format!("{text:?}"),
    }
}
