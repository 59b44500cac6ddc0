//! Letters, separator, decimal point, header and where the rows are.

use std::path::Path;

use crate::import::map::{Decimal, Encoding, Layout, Separator};
use crate::import::text::{cells, decoded};
use poegp_calibration::input_error::InputError;

/// Beginnings of lines that are comments.
const COMMENTS: [&str; 5] = ["#", "//", "%", "!", "*"];

/// A layout, and names of columns that the header could not give.
pub struct Found {
    pub layout: Layout,
    /// Names that stand in a comment before the rows, where there is no header; else empty.
    pub hints: Vec<String>,
}

/// A block of lines that are rows of numbers.
struct Block {
    /// First and last line, from 0.
    first: usize,
    last: usize,
    width: usize,
    rows: usize,
}

/// Whether a cell is a number with this decimal point.
pub fn is_number(cell: &str, decimal: Decimal) -> bool {
    let (point, other) = marks(decimal);
    let plain = match is_grouped(cell, decimal) {
        true => cell.replace(other, ""),
        false => cell.to_owned(),
    };
    let numeric = |c: char| c.is_ascii_digit() || "+-eE".contains(c) || c == point;
    plain.chars().all(numeric) && plain.replace(point, ".").parse::<f64>().is_ok()
}

/// The decimal point, and what may group thousands beside it.
fn marks(decimal: Decimal) -> (char, char) {
    match decimal {
        Decimal::Point => ('.', ','),
        Decimal::Comma => (',', '.'),
    }
}

/// Whether a number has its thousands grouped: 1.234,5. Without the decimal point after it, a mark is not taken for one.
fn is_grouped(cell: &str, decimal: Decimal) -> bool {
    let (point, other) = marks(decimal);
    let Some((whole, _)) = cell.split_once(point) else {
        return false;
    };
    let mut groups = whole.trim_start_matches(['-', '+']).split(other);
    let first = groups.next().map_or(0, str::len);
    let mut rest = groups.peekable();
    (1..=3).contains(&first) && rest.peek().is_some() && rest.all(|group| group.len() == 3)
}

/// The layout that makes most lines rows of numbers of one width.
pub fn found(path: &Path, bytes: &[u8]) -> Result<Found, InputError> {
    let encoding = if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        Encoding::Utf16
    } else if std::str::from_utf8(bytes).is_ok() {
        Encoding::Utf8
    } else {
        Encoding::Latin1
    };
    let text = decoded(path, bytes, encoding)?;
    let lines: Vec<&str> = text.lines().collect();
    let comments: Vec<String> = COMMENTS
        .iter()
        .filter(|mark| {
            lines
                .iter()
                .any(|line| line.trim_start().starts_with(*mark))
        })
        .map(|mark| (*mark).to_owned())
        .collect();
    let is_comment = |line: &str| {
        comments
            .iter()
            .any(|mark| line.trim_start().starts_with(mark.as_str()))
    };

    let mut best: Option<(f64, Layout, Block)> = None;
    for separator in [
        Separator::Semicolon,
        Separator::Tab,
        Separator::Comma,
        Separator::Space,
    ] {
        for decimal in [Decimal::Point, Decimal::Comma] {
            if separator == Separator::Comma && decimal == Decimal::Comma {
                continue;
            }
            let layout = Layout {
                separator,
                decimal,
                encoding,
                ..Layout::default()
            };
            let Some((score, block)) = block(path, &lines, &layout, &is_comment) else {
                continue;
            };
            if best.as_ref().is_none_or(|(other, ..)| score > *other) {
                best = Some((score, layout, block));
            }
        }
    }
    let Some((_, mut layout, block)) = best else {
        return Err(InputError::new(
            path,
            "no rows of numbers",
            "a table: cells between commas, semicolons, tabulators or spaces",
        ));
    };
    let (header_lines, hints) = header(path, &lines, &layout, &block, &is_comment);
    layout.header_lines = header_lines.len();
    let rows = lines[block.first..=block.last].iter();
    let mut cells = rows.flat_map(|line| cells(path, 0, line, &layout).unwrap_or_default());
    if layout.separator != Separator::Comma && cells.any(|cell| is_grouped(&cell, layout.decimal)) {
        layout.thousands = Some(marks(layout.decimal).1);
    }
    let start = header_lines.first().copied().unwrap_or(block.first);
    let nothing = |lines: &[&str]| {
        let mut lines = lines.iter();
        lines.all(|line| line.trim().is_empty() || is_comment(line))
    };
    if !nothing(&lines[..start]) {
        layout.skip_lines = start;
    }
    if !nothing(&lines[block.last + 1..]) {
        layout.skip_last_lines = lines.len() - block.last - 1;
    }
    let used = lines[layout.skip_lines..lines.len() - layout.skip_last_lines].iter();
    let marks: Vec<String> = comments
        .iter()
        .filter(|mark| {
            used.clone()
                .any(|line| line.trim_start().starts_with(mark.as_str()))
        })
        .cloned()
        .collect();
    layout.comments = if marks.is_empty() {
        Layout::default().comments
    } else {
        marks
    };
    Ok(Found { layout, hints })
}

/// The largest block of rows of one width, and what it is worth: the numbers in it.
fn block(
    path: &Path,
    lines: &[&str],
    layout: &Layout,
    is_comment: &dyn Fn(&str) -> bool,
) -> Option<(f64, Block)> {
    let mut best: Option<(f64, Block)> = None;
    let mut current: Option<(f64, Block)> = None;
    for (i, line) in lines.iter().enumerate() {
        if line.trim().is_empty() || is_comment(line) {
            continue;
        }
        let row = cells(path, i + 1, line, layout).unwrap_or_default();
        let filled = row.iter().filter(|cell| !cell.is_empty()).count();
        let numbers = row
            .iter()
            .filter(|cell| is_number(cell, layout.decimal))
            .count();
        let is_row = numbers >= 3 && 2 * numbers >= filled && filled - numbers <= 4;
        let goes_on = current
            .as_ref()
            .is_some_and(|(_, block)| block.width == row.len());
        if !is_row || !goes_on {
            best = larger(best, current.take());
        }
        if is_row {
            // Texts that could be numbers with another point count against it.
            let worth = numbers as f64 - 0.5 * (filled - numbers) as f64;
            match &mut current {
                Some((score, block)) => {
                    *score += worth;
                    block.last = i;
                    block.rows += 1;
                }
                None => {
                    current = Some((
                        worth,
                        Block {
                            first: i,
                            last: i,
                            width: row.len(),
                            rows: 1,
                        },
                    ))
                }
            }
        }
    }
    best = larger(best, current);
    // 1;5 with spaces in between would be three numbers: a pose has more.
    best.filter(|(_, block)| block.width >= 3 && block.rows >= 1)
}

fn larger(a: Option<(f64, Block)>, b: Option<(f64, Block)>) -> Option<(f64, Block)> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.0 > a.0 { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// The lines of the header before a block, and names that a comment has in its place.
fn header(
    path: &Path,
    lines: &[&str],
    layout: &Layout,
    block: &Block,
    is_comment: &dyn Fn(&str) -> bool,
) -> (Vec<usize>, Vec<String>) {
    let mut out: Vec<usize> = Vec::new();
    let mut before = (0..block.first)
        .rev()
        .filter(|i| !lines[*i].trim().is_empty());
    for i in before.by_ref() {
        let line = lines[i];
        let names = |line: &str| -> Option<Vec<String>> {
            let mut row = cells(path, i + 1, line, layout).ok()?;
            while row.len() > block.width && row.last().is_some_and(String::is_empty) {
                row.pop();
            }
            // A trailing separator of the rows makes a cell more than the header's.
            let fits = row.len() == block.width || row.len() + 1 == block.width;
            let texts = row
                .iter()
                .filter(|cell| !is_number(cell, layout.decimal))
                .count();
            (fits && 2 * texts > row.len()).then_some(row)
        };
        if is_comment(line) {
            if out.is_empty() {
                let stripped = line
                    .trim_start()
                    .trim_start_matches(['#', '/', '%', '!', '*']);
                return (
                    out,
                    names(stripped.trim())
                        .filter(|n| n.len() == block.width)
                        .unwrap_or_default(),
                );
            }
            break;
        }
        if names(line).is_none() || out.len() == 2 {
            break;
        }
        out.insert(0, i);
    }
    (out, Vec::new())
}
