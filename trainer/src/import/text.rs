//! From bytes to fields: decodes text, skips lines, splits off the header, and checks the width of the rows.

use std::path::{Path, PathBuf};

use crate::import::column_map::{ColumnName, Decimal, Encoding, Layout, Separator};
use crate::import::spreadsheet::{self, is_zip};
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::is_spreadsheet_error;

/// A row of trimmed fields.
#[derive(Clone, Debug)]
pub struct Line {
    /// Line number in the file, from 1.
    pub number: usize,
    /// Fields of the row.
    pub fields: Vec<String>,
    /// Which of them are numbers of a sheet, which have no decimal mark; empty for a text.
    pub are_numbers: Vec<bool>,
}

impl Line {
    /// Returns whether all fields are empty, as in the rows that a spreadsheet appends to a table.
    pub fn is_blank(&self) -> bool {
        self.fields.iter().all(String::is_empty)
    }
}

/// The fields of a file.
#[derive(Debug)]
pub struct Table {
    /// Path of the file, for messages.
    pub path: PathBuf,
    /// Decimal mark of the numbers.
    pub decimal: Decimal,
    /// Character that groups the digits of the numbers.
    pub thousands: Option<char>,
    /// The first line of the header, with the names of the columns.
    pub header: Option<Line>,
    /// The second line of the header, with units.
    units: Option<Line>,
    /// The rows, all as wide as the header, or as the first row where there is no header.
    pub rows: Vec<Line>,
}

impl Table {
    /// Splits a file into header and rows; `path` is for messages.
    pub fn parse(path: &Path, bytes: &[u8], layout: &Layout) -> Result<Self, InputError> {
        let mut kept = lines(path, bytes, layout)?.into_iter();
        let (mut header, mut units) = (None, None);
        for i in 0..layout.header_lines {
            let Some(line) = kept.next() else {
                return Err(InputError::new(
                    path,
                    "no header",
                    "a header row and one measurement per row",
                )
                .with_help("is skip_lines too large? A file without header has header_lines = 0"));
            };
            if i < 2 {
                check_header(path, &line, layout)?;
            }
            match i {
                0 => header = Some(line),
                1 => units = Some(line),
                _ => {}
            }
        }
        let mut rows: Vec<Line> = kept.collect();
        while rows.last().is_some_and(Line::is_blank) {
            rows.pop();
        }
        let Some(first) = rows.first() else {
            return Err(
                InputError::new(path, "no rows", "one measurement per row after the header")
                    .with_help(format!(
                        "lines that begin with {} are comments; comments in [file] of the map sets their mark",
                        layout.comments.join(" or ")
                    )),
            );
        };
        // A separator at the end of a row makes an empty field that is no column.
        let named = header.as_ref().map_or(0, |header| header.fields.len());
        if let Some(header) = &mut header {
            while header.fields.len() > 1 && header.fields.last().is_some_and(String::is_empty) {
                header.fields.pop();
            }
        }
        let width = header
            .as_ref()
            .map_or(first.fields.len(), |header| header.fields.len());
        for row in &mut rows {
            if row.is_blank() {
                row.fields.resize(width, String::new());
            }
            while row.fields.len() > width && row.fields.last().is_some_and(String::is_empty) {
                row.fields.pop();
            }
            if row.fields.len() != width {
                let found = counted(row.fields.len(), "cell");
                let expected = match &header {
                    Some(_) => format!("{width}, as the header has"),
                    None => format!("{width}, as the first row has"),
                };
                let help = match (layout.separator, width, layout.decimal) {
                    (_, 1, _) => "is the separator another one?",
                    _ if row.fields.len() == named => {
                        "the header does not name the last column: with header_lines = 0 and skip_lines, the map gives \
                         every column by its number"
                    }
                    (Separator::Comma, _, Decimal::Point) if row.fields.len() > width => {
                        "is the comma the decimal point?"
                    }
                    _ if row.fields.len() < width => {
                        "was the file cut off here? skip_lines, skip_last_lines or comments in [file] of the map skip \
                         lines that are not rows"
                    }
                    _ => "does a text hold the separator? Then it has to be in double quotes",
                };
                return Err(InputError::new(path, found, expected)
                    .at_line(row.number)
                    .with_help(help));
            }
        }
        Ok(Self {
            path: path.to_path_buf(),
            decimal: layout.decimal,
            thousands: layout.thousands,
            header,
            units,
            rows,
        })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.header
            .as_ref()
            .or(self.rows.first())
            .map_or(0, |line| line.fields.len())
    }

    /// Returns the name of column `index` (from 0), or "".
    pub fn name(&self, index: usize) -> &str {
        let fields = self
            .header
            .as_ref()
            .map(|header| header.fields.as_slice())
            .unwrap_or(&[]);
        fields.get(index).map_or("", String::as_str)
    }

    /// Returns what the header states as the unit of column `index`, each with its line: on the second line, and in brackets
    /// behind the name.
    pub fn units(&self, index: usize) -> impl Iterator<Item = (usize, &str)> {
        let below = self.units.as_ref().and_then(|units| {
            let text = units.fields.get(index).filter(|text| !text.is_empty())?;
            Some((units.number, heading(text).1.unwrap_or(text)))
        });
        let behind = self.header.as_ref().and_then(|header| {
            let unit = heading(self.name(index)).1?;
            Some((header.number, unit))
        });
        below.into_iter().chain(behind)
    }

    /// Returns the index of a column, from 0; else what was found and what was expected.
    pub fn find(&self, column: &ColumnName) -> Result<usize, (String, String)> {
        let width = self.width();
        let name = match column {
            ColumnName::Number(number) if (1..=width).contains(number) => return Ok(number - 1),
            ColumnName::Number(number) => {
                let path = self.path.display();
                return Err((
                    format!("column {number}"),
                    format!("a column from 1 to {width} of {path}"),
                ));
            }
            ColumnName::Name(name) => name.trim(),
        };
        let Some(header) = &self.header else {
            return Err((
                format!("the column {name:?}"),
                "numbers of columns, as header_lines is 0".to_owned(),
            ));
        };
        let with = |is: &dyn Fn(&str) -> bool| -> Vec<usize> {
            let fields = header.fields.iter().enumerate();
            fields
                .filter(|(_, text)| is(text))
                .map(|(i, _)| i)
                .collect()
        };
        let mut there = with(&|text| text == name);
        if there.is_empty() {
            there = with(&|text| heading(text).0 == name);
        }
        match there.as_slice() {
            [index] => Ok(*index),
            [one, other, ..] => Err((
                format!(
                    "the column {name:?}, which is twice in the header, as {} and {}",
                    one + 1,
                    other + 1
                ),
                "the number of the column".to_owned(),
            )),
            [] => {
                let names: Vec<String> = header
                    .fields
                    .iter()
                    .map(|name| format!("{name:?}"))
                    .collect();
                Err((
                    format!(
                        "the column {name:?}, which {} does not have",
                        self.path.display()
                    ),
                    format!("one of its columns: {}", names.join(", ")),
                ))
            }
        }
    }
}

/// Refuses a measurement in the place of a header: it would be lost. Columns without a name are often numbered, so whole
/// numbers are names.
fn check_header(path: &Path, line: &Line, layout: &Layout) -> Result<(), InputError> {
    let is_name = |field: &&String| field.bytes().all(|b| b.is_ascii_digit());
    let mut fields = line.fields.iter().filter(|field| !is_name(field));
    let Some(number) = fields.find(|field| is_number(field, layout.decimal)) else {
        return Ok(());
    };
    let found = format!("the number {number:?} in the header");
    Err(InputError::new(path, found, "the names of the columns")
        .at_line(line.number)
        .with_help(
            "for a file without a header set header_lines = 0; for a header after # set comments = []",
        ))
}

/// Returns whether a field is a number with this decimal mark.
fn is_number(field: &str, decimal: Decimal) -> bool {
    let plain = match decimal {
        Decimal::Point => field.to_owned(),
        Decimal::Comma if field.contains('.') => return false,
        Decimal::Comma => field.replace(',', "."),
    };
    plain.parse::<f64>().is_ok_and(f64::is_finite)
}

/// Returns the lines of a file, header included, without those that the layout skips.
fn lines(path: &Path, bytes: &[u8], layout: &Layout) -> Result<Vec<Line>, InputError> {
    let is_comment = |text: &str| {
        let mut comments = layout.comments.iter();
        comments.any(|c| !c.is_empty() && text.starts_with(c.as_str()))
    };
    if is_zip(bytes) {
        let rows = spreadsheet::rows(path, bytes, layout)?.into_iter();
        let rows = rows.map(|row| Line {
            number: row.number,
            fields: row.fields,
            are_numbers: row.are_numbers,
        });
        let mut lines: Vec<Line> = rows
            .filter(|line| line.number > layout.skip_lines)
            .collect();
        lines.truncate(lines.len().saturating_sub(layout.skip_last_lines));
        lines.retain(|line| {
            let mut there = line.fields.iter().filter(|field| !field.is_empty());
            let first = there.next();
            let mut is_error = |first: &str| is_spreadsheet_error(first) && there.next().is_some();
            first.is_some_and(|first| !is_comment(first) || is_error(first))
        });
        return Ok(lines);
    }
    let text = decoded(path, bytes, layout.encoding)?;
    // Older programs for the Mac end a line with a carriage return alone.
    let all: Vec<&str> = match text.contains('\n') {
        true => text.lines().collect(),
        false => text.split_terminator('\r').collect(),
    };
    let end = all.len().saturating_sub(layout.skip_last_lines);
    let mut first = layout.skip_lines;
    if let Some(separator) = stated_separator(path, &text)?.filter(|_| first == 0) {
        first = 1;
        if separator != layout.separator {
            let found = format!("{:?}, which states another separator than the map", all[0]);
            let expected = format!("separator = {:?}", separator.mark());
            return Err(
                InputError::new(path, found, expected + " in [file] of the map").at_line(1),
            );
        }
    }
    let kept = all[..end].iter().enumerate().skip(first);
    let is_error = |line: &str| {
        let parts = match layout.separator {
            Separator::Space => line.split_once(char::is_whitespace),
            separator => line.split_once(separator.mark()),
        };
        parts.is_some_and(|(first, _)| is_spreadsheet_error(first.trim()))
    };
    let is_row = |line: &str| !line.is_empty() && (!is_comment(line) || is_error(line));
    let lines = kept
        .filter(|(_, line)| is_row(line.trim()))
        .map(|(index, line)| {
            Ok(Line {
                number: index + 1,
                fields: fields(path, index + 1, line, layout)?,
                are_numbers: Vec::new(),
            })
        });
    let mut lines = lines.collect::<Result<Vec<Line>, InputError>>()?;
    if layout.header_lines > 0 {
        let blank = lines.iter().take_while(|line| line.is_blank()).count();
        lines.drain(..blank);
    }
    Ok(lines)
}

/// Returns the separator that the first line of a text states for a spreadsheet: `sep=;`.
pub fn stated_separator(path: &Path, text: &str) -> Result<Option<Separator>, InputError> {
    let line = text.split(['\n', '\r']).next().unwrap_or("");
    let bare = line.trim_matches([' ', '"']);
    let Some((key, mark)) = bare.split_at_checked(4) else {
        return Ok(None);
    };
    if !key.eq_ignore_ascii_case("sep=") {
        return Ok(None);
    }
    let all = [Separator::Comma, Separator::Semicolon, Separator::Tab];
    match all.into_iter().find(|separator| separator.mark() == mark) {
        Some(separator) => Ok(Some(separator)),
        None => {
            let expected = "a comma, a semicolon or a tab as the separator of the cells";
            Err(InputError::new(path, format!("{line:?}"), expected).at_line(1))
        }
    }
}

impl Separator {
    /// Returns the characters between two fields.
    fn mark(self) -> &'static str {
        match self {
            Self::Comma => ",",
            Self::Semicolon => ";",
            Self::Tab => "\t",
            Self::Space => " ",
        }
    }
}

/// Splits a name of a header from the unit in brackets behind it: `X [mm]`, `X (mm)`.
pub fn heading(text: &str) -> (&str, Option<&str>) {
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((name, unit)) = text.strip_suffix(close).and_then(|t| t.rsplit_once(open)) {
            return (
                name.trim_end(),
                Some(unit.trim()).filter(|unit| !unit.is_empty()),
            );
        }
    }
    (text, None)
}

/// Decodes the bytes of a file into text.
pub fn decoded(path: &Path, bytes: &[u8], encoding: Encoding) -> Result<String, InputError> {
    let is_utf16 = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    if is_utf16 != (encoding == Encoding::Utf16) {
        let (found, help) = match is_utf16 {
            true => (
                "UTF-16 text",
                "state it in the map: encoding = \"utf-16\" in [file]",
            ),
            false => (
                "no byte order mark",
                "without it UTF-16 cannot be distinguished from other encodings",
            ),
        };
        let expected = if is_utf16 {
            "text as the map says"
        } else {
            "UTF-16 with its byte order mark"
        };
        return Err(InputError::new(path, found, expected).with_help(help));
    }
    match encoding {
        Encoding::Utf8 => {
            let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
            let line = |at: usize| 1 + bytes[..at].iter().filter(|byte| **byte == b'\n').count();
            if let Some(zero) = bytes.iter().position(|byte| *byte == 0) {
                return Err(InputError::new(path, "a binary file (a zero byte)", "text")
                    .at_line(line(zero)));
            }
            match std::str::from_utf8(bytes) {
                Ok(text) => Ok(text.to_owned()),
                Err(error) => Err(InputError::new(path, "bytes that are not UTF-8", "UTF-8 text")
                    .at_line(line(error.valid_up_to()))
                    .with_help("older programs write Latin-1: encoding = \"latin-1\" in [file] of the map")),
            }
        }
        Encoding::Latin1 => Ok(bytes.iter().map(|byte| char::from(*byte)).collect()),
        Encoding::Utf16 => {
            let little = bytes.starts_with(&[0xff, 0xfe]);
            let units = bytes[2..].chunks_exact(2).map(|pair| match little {
                true => u16::from_le_bytes([pair[0], pair[1]]),
                false => u16::from_be_bytes([pair[0], pair[1]]),
            });
            let text: Result<String, _> = char::decode_utf16(units).collect();
            match text {
                Ok(text) if bytes.len().is_multiple_of(2) => Ok(text),
                _ => Err(
                    InputError::new(path, "bytes that are not UTF-16", "UTF-16 text")
                        .with_help("was the file cut off?"),
                ),
            }
        }
    }
}

/// Splits a line into trimmed fields.
pub fn fields(
    path: &Path,
    number: usize,
    line: &str,
    layout: &Layout,
) -> Result<Vec<String>, InputError> {
    let delimiter = match layout.separator {
        Separator::Comma => b',',
        Separator::Semicolon => b';',
        Separator::Tab => b'\t',
        Separator::Space => return Ok(line.split_whitespace().map(str::to_owned).collect()),
    };
    if line.matches('"').count() % 2 == 1 {
        return Err(InputError::new(
            path,
            "a quotation mark that is not closed",
            "texts in pairs of quotation marks",
        )
        .at_line(number));
    }
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .delimiter(delimiter)
        .trim(csv::Trim::All)
        .from_reader(line.as_bytes());
    match reader.records().next() {
        Some(Ok(record)) => Ok(record.iter().map(str::to_owned).collect()),
        Some(Err(error)) => {
            Err(InputError::new(path, error.to_string(), "a row of cells").at_line(number))
        }
        None => Ok(Vec::new()),
    }
}
