//! Splits bytes into fields: a header row and rows of its width; comments and blank lines are skipped.

use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};

use crate::input_error::{InputError, counted};

/// The fields of a file, trimmed.
pub(super) struct Table {
    /// Line of the header, from 1.
    pub header_line: usize,
    /// Names of the columns.
    pub header: StringRecord,
    /// Line and fields of every row; each row has as many fields as the header.
    pub rows: Vec<(usize, StringRecord)>,
}

impl Table {
    /// Parses a file; `file` and `row`, which says what a row is, are for messages.
    pub(super) fn parse(file: &Path, bytes: &[u8], row: &str) -> Result<Self, InputError> {
        let text = text(file, bytes, 1)?;
        let mut rows = Vec::new();
        each_line(file, text, 1, |part| {
            if let Part::Record(line, record) = part {
                rows.push((line, record.clone()));
            }
            Ok(())
        })?;
        let mut rows = rows.into_iter();
        let Some((header_line, header)) = rows.next() else {
            return Err(no_header(file, row));
        };
        check_header(file, header_line, &header)?;
        let rows: Vec<_> = rows.collect();
        if rows.is_empty() {
            return Err(no_rows(file, header_line, row));
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

/// Description of a row of a measurement file.
pub(super) const MEASURED_POSE: &str = "one measured pose per row";
/// Description of a row of a touch file.
pub(super) const TOUCH: &str = "one touch per row";

pub(super) fn no_header(file: &Path, row: &str) -> InputError {
    InputError::new(file, "an empty file", format!("a header row and {row}"))
}

pub(super) fn no_rows(file: &Path, header_line: usize, row: &str) -> InputError {
    let expected = format!("{row} after the header");
    InputError::new(file, "a header without rows", expected).at_line(header_line)
}

/// Returns the header of a file; `None` if there is none or if the file is not text.
pub(super) fn header(bytes: &[u8]) -> Option<StringRecord> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.trim_start_matches('\u{feff}').lines();
    let line = lines.find(|line| !is_remark(line.trim()))?;
    let mut out = None;
    let file = Path::new("");
    let shown = each_line(file, line, 1, |part| {
        if let Part::Record(_, record) = part {
            out = Some(record.clone());
        }
        Ok(())
    });
    shown.ok().and(out)
}

/// A part of a file.
pub(super) enum Part<'a> {
    /// A comment or a blank line.
    Remark(&'a str),
    /// A record with trimmed fields, and the line in which it begins. Its further lines are part of its fields.
    Record(usize, &'a StringRecord),
}

/// Returns whether a line is a comment or blank; `line` is trimmed. A row whose first field is an error of a spreadsheet is
/// neither.
pub fn is_remark(line: &str) -> bool {
    let is_row = |line: &str| {
        line.split_once(',')
            .is_some_and(|(first, _)| is_spreadsheet_error(first.trim()))
    };
    line.is_empty() || (line.starts_with('#') && !is_row(line))
}

/// Returns whether a spreadsheet writes this text into a cell without a value, in whatever language: `#DIV/0!`, `#WERT!`,
/// `#NAME?`, `#N/A`, `#NV`, or `####` where the column is too narrow.
pub fn is_spreadsheet_error(field: &str) -> bool {
    let Some(name) = field.strip_prefix('#') else {
        return false;
    };
    let is_name = !name.chars().any(|c| c.is_lowercase() || c.is_whitespace());
    let is_narrow = name.len() > 1 && name.chars().all(|c| c == '#');
    let is_letter = |part: &str| part.chars().count() == 1 && part.chars().all(char::is_alphabetic);
    let is_unavailable = name == "NV"
        || name
            .split_once('/')
            .is_some_and(|(a, b)| is_letter(a) && is_letter(b));
    is_narrow || (is_name && (is_unavailable || name.ends_with(['!', '?'])))
}

/// Passes all parts of `text` to `show`, in order. `text` consists of whole records; its first line is number `first` of the
/// file.
pub(super) fn each_line(
    file: &Path,
    text: &str,
    first: usize,
    mut show: impl FnMut(Part<'_>) -> Result<(), InputError>,
) -> Result<(), InputError> {
    let is_plain = |line: &str| !line.contains(['"', '\r']);
    let mut record = StringRecord::new();
    if text.lines().all(is_plain) {
        for (number, line) in (first..).zip(text.lines()) {
            let trimmed = line.trim();
            if is_remark(trimmed) {
                show(Part::Remark(line))?;
                continue;
            }
            record.clear();
            trimmed
                .split(',')
                .for_each(|field| record.push_field(field.trim()));
            show(Part::Record(number, &record))?;
        }
        return Ok(());
    }
    // Comments and blank lines are removed before the CSV reader counts lines; `numbers` keeps the original line numbers.
    let mut kept = String::with_capacity(text.len());
    let (mut numbers, mut remarks) = (Vec::new(), Vec::new());
    let (mut state, mut begin) = (Quoting::default(), first);
    for (number, line) in (first..).zip(text.lines()) {
        if state.is_remark(line.trim()) {
            remarks.push((number, line));
            continue;
        }
        let mut part = line;
        if state != Quoting::Open {
            (begin, part) = (number, line.trim_start());
        }
        state = state.after(part.as_bytes());
        kept.push_str(part);
        kept.push('\n');
        numbers.push(number);
    }
    if state == Quoting::Open {
        let found = "a quotation mark that is not closed";
        return Err(
            InputError::new(file, found, "a quotation mark that closes the text").at_line(begin),
        );
    }
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(kept.as_bytes());
    let mut next = || -> Result<Option<(usize, StringRecord)>, InputError> {
        let mut record = StringRecord::new();
        let is_there = reader
            .read_record(&mut record)
            .map_err(|error| InputError::new(file, error.to_string(), "CSV"))?;
        let index = record.position().map_or(0, |at| at.line() as usize);
        let line = numbers.get(index.saturating_sub(1)).copied().unwrap_or(0);
        Ok(is_there.then_some((line, record)))
    };
    let mut remarks = remarks.into_iter().peekable();
    while let Some((at, record)) = next()? {
        while let Some((_, remark)) = remarks.next_if(|(number, _)| *number < at) {
            show(Part::Remark(remark))?;
        }
        show(Part::Record(at, &record))?;
    }
    remarks.try_for_each(|(_, remark)| show(Part::Remark(remark)))
}

/// State of the CSV reader within a record, with regard to quotation marks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Quoting {
    /// At the beginning of a field.
    #[default]
    Start,
    /// In a field without quotation marks, or after its quotation marks.
    Plain,
    /// Within quotation marks: the record continues on the next line.
    Open,
    /// After a quotation mark that either closes the field or is the first of a doubled pair.
    Closing,
}

impl Quoting {
    /// Returns whether a line in this state is a comment or blank; `line` is trimmed. Within quotation marks none is.
    pub(super) fn is_remark(self, line: &str) -> bool {
        self != Self::Open && is_remark(line)
    }

    /// Returns the state after another line, which is not a comment.
    pub(super) fn after(self, line: &[u8]) -> Self {
        let begin = match self {
            Self::Open => Self::Open,
            _ => Self::Start,
        };
        line.iter().fold(begin, |state, byte| match (state, byte) {
            (Self::Open, b'"') => Self::Closing,
            (Self::Open, _) => Self::Open,
            (Self::Start | Self::Closing, b'"') => Self::Open,
            (_, b',' | b'\r') => Self::Start,
            _ => Self::Plain,
        })
    }
}

/// Decodes the bytes as UTF-8 text without a byte order mark; their first line is number `first` of the file.
pub(super) fn text<'a>(file: &Path, bytes: &'a [u8], first: usize) -> Result<&'a str, InputError> {
    let line_of = |at: usize| first + bytes[..at].iter().filter(|byte| **byte == b'\n').count();
    let binary = |at: usize, found: &str| {
        InputError::new(file, found, "a CSV text file in UTF-8").at_line(line_of(at))
    };
    let begins = |mark: &[u8]| first == 1 && bytes.starts_with(mark);
    if begins(&[0xff, 0xfe]) || begins(&[0xfe, 0xff]) {
        return Err(binary(0, "UTF-16 text").with_help("save the file as UTF-8"));
    }
    if begins(b"PK\x03\x04") {
        return Err(binary(0, "a spreadsheet or zip file").with_help("export the table as CSV"));
    }
    let bytes = match bytes.strip_prefix(b"\xef\xbb\xbf") {
        Some(rest) if first == 1 => rest,
        _ => bytes,
    };
    if let Some(at) = bytes.iter().position(|byte| *byte == 0) {
        return Err(binary(at, "a binary file (a zero byte)"));
    }
    std::str::from_utf8(bytes).map_err(|error| {
        binary(error.valid_up_to(), "bytes that are not UTF-8 text")
            .with_help("save the file as UTF-8, or export it as CSV")
    })
}

pub(super) fn check_header(
    file: &Path,
    line: usize,
    header: &StringRecord,
) -> Result<(), InputError> {
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
        .with_help("a header after # is a comment: remove the #"));
    }
    Ok(())
}

pub(super) fn check_width(
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
        format!("a {kind} row of {}", counted(count, "field")),
        format!("{}, as the header has", counted(width, "field")),
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

/// Returns text of a file in double quotes, shortened.
pub(super) fn quoted(text: &str) -> String {
    if text.is_empty() {
        return "an empty field".to_owned();
    }
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{:?}…", &text[..end]),
        None => format!("{text:?}"),
    }
}
