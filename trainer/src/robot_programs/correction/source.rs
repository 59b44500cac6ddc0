//! A file of a program as bytes, and the numbers in it that may be replaced.

use std::ops::Range;
use std::path::{Path, PathBuf};

use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::decimal::push_decimal;

/// Largest number of characters of a file that an error quotes.
const QUOTED: usize = 40;

/// A file of a program.
#[derive(Clone, Debug)]
pub struct Source {
    /// Path as it was given.
    pub path: PathBuf,
    /// All bytes of the file.
    pub bytes: Vec<u8>,
    /// Whether the targets of the file are corrected; otherwise only its frames are used.
    pub is_corrected: bool,
    /// First byte of each line.
    lines: Vec<usize>,
}

impl Source {
    /// Creates a source from the bytes of a file.
    pub fn new(path: &Path, bytes: Vec<u8>, is_corrected: bool) -> Self {
        let mut lines = vec![0];
        for (at, byte) in bytes.iter().enumerate() {
            let is_end = match byte {
                b'\n' => true,
                b'\r' => bytes.get(at + 1) != Some(&b'\n'),
                _ => false,
            };
            if is_end {
                lines.push(at + 1);
            }
        }
        Self {
            path: path.to_path_buf(),
            bytes,
            is_corrected,
            lines,
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`InputError`] names the file.
    pub fn read(path: &Path, is_corrected: bool) -> Result<Self, InputError> {
        let bytes = std::fs::read(path)
            .map_err(|error| InputError::unreadable(path, &error, "a robot program"))?;
        if bytes.len() >= u32::MAX as usize {
            return Err(InputError::new(path, "more than 4 GB", "a robot program"));
        }
        // Programs begin with a letter or a sign of ASCII, which UTF-16 writes with a zero.
        if matches!(
            bytes.as_slice(),
            [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [_, 0, _, 0, ..] | [0, _, 0, ..]
        ) {
            let help = "save the file as UTF-8 or ANSI";
            return Err(InputError::new(path, "UTF-16 text", "UTF-8 or ANSI").with_help(help));
        }
        Ok(Self::new(path, bytes, is_corrected))
    }

    /// Returns line and column of a byte, from 1.
    pub fn line_and_column(&self, at: usize) -> (usize, usize) {
        let line = self.lines.partition_point(|start| *start <= at).max(1);
        (line, 1 + at - self.lines[line - 1])
    }

    /// Returns the first byte of the line that contains a byte.
    pub fn line_start(&self, at: usize) -> usize {
        let line = self.lines.partition_point(|start| *start <= at).max(1);
        self.lines[line - 1]
    }

    /// Returns the file without some spans; `None` where these are not in order, or go beyond the end.
    pub fn without(&self, spans: &[(usize, usize)]) -> Option<Self> {
        let (mut bytes, mut from) = (Vec::with_capacity(self.bytes.len()), 0);
        for (start, end) in spans {
            bytes.extend_from_slice(self.bytes.get(from..*start).filter(|_| start <= end)?);
            from = *end;
        }
        bytes.extend_from_slice(self.bytes.get(from..)?);
        Some(Self::new(&self.path, bytes, self.is_corrected))
    }

    /// Returns the bytes of a span.
    pub fn slice(&self, span: &Range<usize>) -> &[u8] {
        self.bytes.get(span.clone()).unwrap_or(&[])
    }

    /// Returns the bytes of a span as shortened text, for messages.
    pub fn quoted(&self, span: &Range<usize>) -> String {
        let text = String::from_utf8_lossy(self.slice(span));
        let text: String = text.split_whitespace().collect::<Vec<_>>().join(" ");
        match text.char_indices().nth(QUOTED) {
            Some((end, _)) => format!("\"{}…\"", &text[..end]),
            None => format!("\"{text}\""),
        }
    }

    /// Returns an error at the byte `at`.
    pub fn error(
        &self,
        at: usize,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        let (line, column) = self.line_and_column(at);
        InputError::new(&self.path, found, expected)
            .at_line(line)
            .at_column(column, "")
    }
}

/// A number of a program that a correction may replace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    /// Index of the file.
    pub file: u32,
    /// First byte, the sign included.
    pub start: u32,
    /// Byte behind the last one.
    pub end: u32,
    /// Value in the unit of the file.
    pub value: f64,
}

impl Number {
    /// Parses a whole span as a number; `None` for text that is no finite decimal number.
    pub fn parse(file: usize, source: &Source, span: &Range<usize>) -> Option<Self> {
        let text = std::str::from_utf8(source.slice(span)).ok()?;
        let plain = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
        if !text.contains(|c: char| c.is_ascii_digit()) || !text.chars().all(plain) {
            return None;
        }
        let value: f64 = text.parse().ok()?;
        value.is_finite().then_some(Self {
            file: file as u32,
            start: span.start as u32,
            end: span.end as u32,
            value,
        })
    }

    /// Returns the bytes of the number in its file.
    pub fn span(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }
}

/// Number of decimals with which a number is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decimals {
    /// Least number of decimals.
    pub least: usize,
    /// Largest number of decimals, unless the old number has more.
    pub most: Option<usize>,
}

impl Decimals {
    /// Returns the number of decimals for a number that was written as `text`.
    pub fn of(&self, text: &[u8]) -> usize {
        let least = self.most.map_or(self.least, |most| self.least.min(most));
        decimals_of(text).max(least).min(15)
    }
}

/// Returns the number of written decimals, with the exponent taken into account.
fn decimals_of(text: &[u8]) -> usize {
    let exponent_at = text.iter().position(|b| matches!(b, b'e' | b'E'));
    let (mantissa, exponent) = match exponent_at {
        Some(at) => (&text[..at], &text[at + 1..]),
        None => (text, &[] as &[u8]),
    };
    let fraction = mantissa
        .iter()
        .position(|b| *b == b'.')
        .map_or(0, |dot| mantissa.len() - dot - 1) as i64;
    let exponent: i64 = std::str::from_utf8(exponent)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(0);
    fraction.saturating_sub(exponent).clamp(0, 15) as usize
}

/// Formats a number with this many decimals; a number that rounds to zero has no sign.
pub fn fixed(value: f64, decimals: usize) -> String {
    let mut text = String::new();
    push_decimal(&mut text, value, decimals);
    match text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.')) {
        true => text.trim_start_matches('-').to_owned(),
        false => text,
    }
}

/// Returns the text of a new value in place of `old`; `None` when at these decimals the number does not change.
pub fn rewritten(old: &[u8], was: f64, value: f64, decimals: Decimals) -> Option<String> {
    let count = decimals.of(old);
    let new = fixed(value, count);
    if new == fixed(was, count) {
        return None;
    }
    Some(match old.first() {
        Some(b'+') if !new.starts_with('-') => format!("+{new}"),
        _ => new,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_changes_only_at_the_decimals_that_it_gets() {
        let least = |least| Decimals { least, most: None };
        let of = |old: &str, value: f64, decimals| {
            rewritten(old.as_bytes(), old.parse().unwrap(), value, decimals)
        };
        assert_eq!(of("10", 10.0, least(3)), None);
        assert_eq!(of("10", 10.000_4, least(3)), None);
        assert_eq!(of("10", 10.000_6, least(3)).unwrap(), "10.001");
        assert_eq!(of("-0.000", 0.0, least(3)), None);
        assert_eq!(of("0.5000000", 0.500_000_1, least(3)).unwrap(), "0.5000001");
        assert_eq!(of("+1.5", 1.6, least(1)).unwrap(), "+1.6");
        assert_eq!(of("+1.5", -1.6, least(1)).unwrap(), "-1.6");
        assert_eq!(of("1.5E+02", 151.0, least(1)).unwrap(), "151.0");
        assert_eq!(of("-0.01", -0.000_1, least(2)).unwrap(), "0.00");
        let three = Decimals {
            least: 5,
            most: Some(3),
        };
        assert_eq!(of("1.234", 1.234_4, three), None);
        assert_eq!(of("1.234", 1.234_6, three).unwrap(), "1.235");
    }

    #[test]
    fn lines_end_with_either_end() {
        let source = Source::new(Path::new("a"), b"a\r\nb\rc\nd".to_vec(), true);
        let at = |at| source.line_and_column(at);
        assert_eq!(
            [at(0), at(1), at(3), at(5), at(7)],
            [(1, 1), (1, 2), (2, 1), (3, 1), (4, 1)]
        );
    }
}
