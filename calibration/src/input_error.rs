//! The error for bad input: which file, which line, which column, what was found and what was expected.
//!
//! A person repairs bad input, so every reader of the trainer reports these five items and, where it is known, the next
//! step. Failures of the program itself are not reported as [`InputError`].

use std::path::{Path, PathBuf};

use thiserror::Error;

/// An error that the author of the input can repair. The binary exits with code 2 on it.
///
/// Displayed as `train.csv:17: column 4 (q4_deg): found "abc", expected a number in degrees`, with a second line
/// `help: …` if there is a help text.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{}found {found}, expected {expected}{}", location(.file, .line, .column), help_line(.help))]
pub struct InputError {
    /// Path of the file as the user gave it; for a built-in robot `<built-in NAME>`.
    pub file: PathBuf,
    /// Line in the file, counted from 1.
    pub line: Option<usize>,
    /// Column, counted from 1, and its name: field number and header in a CSV file, character and key in a TOML file.
    pub column: Option<(usize, String)>,
    /// What was found; text from the file is in double quotes.
    pub found: String,
    /// What was expected instead.
    pub expected: String,
    /// What the user can do next.
    pub help: Option<String>,
}

impl InputError {
    /// Creates an error about the file as a whole.
    pub fn new(
        file: impl AsRef<Path>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self {
            file: file.as_ref().to_path_buf(),
            line: None,
            column: None,
            found: found.into(),
            expected: expected.into(),
            help: None,
        }
    }

    /// Sets the line of the error, counted from 1.
    #[must_use]
    pub fn at_line(mut self, line: usize) -> Self {
        self.line = Some(line);
        self
    }

    /// Sets the column of the error, counted from 1, and the column's name or "".
    #[must_use]
    pub fn at_column(mut self, column: usize, name: impl Into<String>) -> Self {
        self.column = Some((column, name.into()));
        self
    }

    /// Adds a help text: what the user can do next.
    #[must_use]
    pub fn with_help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Creates the error for a file that cannot be read at all.
    pub fn unreadable(file: &Path, error: &std::io::Error, expected: &str) -> Self {
        let found = match error.kind() {
            std::io::ErrorKind::NotFound => "no such file".to_owned(),
            std::io::ErrorKind::IsADirectory => "a directory".to_owned(),
            _ => format!("a file that cannot be read ({error})"),
        };
        Self::new(file, found, expected)
    }
}

fn location(file: &Path, line: &Option<usize>, column: &Option<(usize, String)>) -> String {
    let mut location = format!("{}:", file.display());
    if let Some(line) = line {
        location += &format!("{line}:");
    }
    location.push(' ');
    match column {
        Some((number, name)) if name.is_empty() => location += &format!("column {number}: "),
        Some((number, name)) => location += &format!("column {number} ({name}): "),
        None => {}
    }
    location
}

fn help_line(help: &Option<String>) -> String {
    help.as_ref()
        .map_or_else(String::new, |help| format!("\nhelp: {help}"))
}

/// Returns a count and a noun, such as `1 row` or `2 rows`; the plural of `noun` must end with an s.
pub fn counted(count: usize, noun: &str) -> String {
    let s = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{s}")
}

/// Formats a number for a message: by its digits, or with an exponent where these are many, as in `1e300`.
pub fn number(value: f64) -> String {
    match value.abs() {
        size if size >= 1e9 || (size > 0.0 && size < 1e-9) => format!("{value:e}"),
        _ => value.to_string(),
    }
}

/// Joins the first `most` items with commas, and shows that there are more.
pub fn some_of<T: ToString>(items: &[T], most: usize) -> String {
    let shown: Vec<String> = items.iter().take(most).map(T::to_string).collect();
    let more = if items.len() > most { ", …" } else { "" };
    shown.join(", ") + more
}

/// Returns whether a terminal and a line of a file show a text as it is: it has no control characters, and none that change
/// the direction of the text after them.
pub fn is_printable(text: &str) -> bool {
    let turns = |c| matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    !text.chars().any(|c| c.is_control() || turns(c))
}

#[cfg(test)]
mod tests {
    use super::{InputError, counted, number};

    #[test]
    fn no_number_has_hundreds_of_digits() {
        let values = [0.0, -0.25, 123_456.5, 1e9, -1e300, 1e-300];
        let said = values.map(number);
        assert_eq!(said, ["0", "-0.25", "123456.5", "1e9", "-1e300", "1e-300"]);
        assert_eq!([f64::NAN, f64::INFINITY].map(number), ["NaN", "inf"]);
    }

    #[test]
    fn one_is_no_plural() {
        let said = [0, 1, 2].map(|count| counted(count, "row"));
        assert_eq!(said, ["0 rows", "1 row", "2 rows"]);
    }

    #[test]
    fn display_names_the_place() {
        let error = InputError::new("train.csv", "\"abc\"", "a number in degrees");
        assert_eq!(
            error.to_string(),
            "train.csv: found \"abc\", expected a number in degrees"
        );
        let error = error.at_line(17).at_column(4, "q4_deg");
        assert_eq!(
            error.to_string(),
            "train.csv:17: column 4 (q4_deg): found \"abc\", expected a number in degrees"
        );
        let error = error.at_column(4, "").with_help("write a number");
        assert_eq!(
            error.to_string(),
            "train.csv:17: column 4: found \"abc\", expected a number in degrees\nhelp: write a number"
        );
    }
}
