//! The decimal mark of a file, as its numbers show it.
//!
//! `12.5` has a decimal point and `1,234.5` has one, too; `1,234` alone is 1.234 or 1234. All numbers of a file decide together,
//! and where they do not, nothing is guessed.

use crate::import::column_map::{Decimal, Layout};
use crate::import::text::Table;
use poegp_calibration::input_error::InputError;

/// What a number shows of the marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// It has no mark.
    Nothing,
    /// Its decimal mark, and whether the other mark groups its thousands.
    Decimal(Decimal, bool),
    /// Its only mark is a decimal mark, or groups thousands.
    Either(Decimal),
}

impl Decimal {
    /// Returns the character.
    pub fn mark(self) -> char {
        match self {
            Self::Point => '.',
            Self::Comma => ',',
        }
    }

    fn other(self) -> Self {
        match self {
            Self::Point => Self::Comma,
            Self::Comma => Self::Point,
        }
    }
}

/// Returns what a field shows; `None` if it is no number.
pub fn shown(field: &str) -> Option<Shown> {
    let unsigned = field.strip_prefix(['-', '+']).unwrap_or(field);
    let (digits, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((digits, exponent)) => (digits, Some(exponent.parse::<i32>().ok()?)),
        None => (unsigned, None),
    };
    let is_digit = |c: char| c.is_ascii_digit();
    if !digits.contains(is_digit) || !digits.chars().all(|c| is_digit(c) || c == '.' || c == ',') {
        return None;
    }
    let Some((at, last)) = digits.char_indices().rfind(|(_, c)| !is_digit(*c)) else {
        return Some(Shown::Nothing);
    };
    let last = if last == '.' {
        Decimal::Point
    } else {
        Decimal::Comma
    };
    let (before, after) = (&digits[..at], &digits[at + 1..]);
    let is_only = before.chars().all(is_digit);
    match (is_only, before.contains(last.mark())) {
        (true, _) => {
            let is_group = after.len() == 3 && (1..=3).contains(&before.len());
            let is_either = is_group && !before.starts_with('0') && exponent.is_none();
            Some(if is_either {
                Shown::Either(last)
            } else {
                Shown::Decimal(last, false)
            })
        }
        (false, false) => {
            is_grouped(before, last.other().mark()).then_some(Shown::Decimal(last, true))
        }
        (false, true) => {
            is_grouped(digits, last.mark()).then_some(Shown::Decimal(last.other(), true))
        }
    }
}

/// Returns whether a whole number without a sign has this mark before each group of three digits, and no other mark.
pub fn is_grouped(whole: &str, mark: char) -> bool {
    let mut groups = whole.split(mark);
    let is_digits = |group: &str| group.bytes().all(|b| b.is_ascii_digit());
    let is_first = |group: &str| (1..=3).contains(&group.len()) && is_digits(group);
    groups.next().is_some_and(is_first) && groups.all(|g| g.len() == 3 && is_digits(g))
}

/// What the numbers of a file show together.
#[derive(Debug, Default)]
pub struct Marks {
    points: usize,
    commas: usize,
    /// Whether a number shows that commas group thousands, and whether one shows that points do.
    has_groups: [bool; 2],
    /// Line, column and text of the first number whose mark is a decimal mark or groups thousands.
    doubtful: Option<(usize, usize, String)>,
}

impl Marks {
    /// Adds the numbers of a column that are texts. No angle is as large as a thousand degrees, so that the only mark of one is a decimal mark.
    pub fn add(&mut self, table: &Table, column: usize, is_angle: bool) {
        for line in &table.rows {
            if line.are_numbers.get(column) == Some(&true) {
                continue;
            }
            let Some(field) = line.fields.get(column) else {
                continue;
            };
            let shown = match shown(field) {
                Some(Shown::Either(mark)) if is_angle => Shown::Decimal(mark, false),
                Some(shown) => shown,
                None => continue,
            };
            match shown {
                Shown::Decimal(Decimal::Point, is_grouped) => {
                    self.points += 1;
                    self.has_groups[0] |= is_grouped;
                }
                Shown::Decimal(Decimal::Comma, is_grouped) => {
                    self.commas += 1;
                    self.has_groups[1] |= is_grouped;
                }
                Shown::Either(_) if self.doubtful.is_none() => {
                    self.doubtful = Some((line.number, column, field.clone()));
                }
                Shown::Either(_) | Shown::Nothing => {}
            }
        }
    }

    /// Puts the marks into a layout; where they are not certain, leaves it and returns the error. `key` is the layout's table in
    /// a map. Numbers that contradict the others are refused when they are read.
    pub fn decide(self, table: &Table, layout: &mut Layout, key: &str) -> Option<InputError> {
        if self.points == 0 && self.commas == 0 {
            let (line, column, text) = self.doubtful?;
            let mark = if text.contains(',') {
                Decimal::Comma
            } else {
                Decimal::Point
            };
            let (own, other) = (mark.mark(), mark.other().mark());
            let (point, whole) = (text.replace(own, "."), text.replace(own, ""));
            let found = format!(
                "{text:?}, and no other number that shows whether it is {point} or {whole}"
            );
            let error = InputError::new(&table.path, found, "an unambiguous decimal mark")
                .at_line(line)
                .at_column(column + 1, table.name(column));
            return Some(error.with_help(format!(
                "--write-map FILE writes the map: state decimal = \"{own}\" in its [{key}] if this is {point}, decimal = \"{other}\" and \
                 thousands = \"{own}\" if it is {whole}, and import with --map FILE"
            )));
        }
        let is_comma = self.commas > self.points;
        layout.decimal = if is_comma {
            Decimal::Comma
        } else {
            Decimal::Point
        };
        let is_certain = self.points == 0 || self.commas == 0;
        layout.thousands = (is_certain && self.has_groups[usize::from(is_comma)])
            .then(|| layout.decimal.other().mark());
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_shows_its_marks_or_that_it_has_two_readings() {
        use Decimal::{Comma, Point};
        for (field, expected) in [
            ("12", Shown::Nothing),
            ("-1e3", Shown::Nothing),
            ("12.5", Shown::Decimal(Point, false)),
            ("0,125", Shown::Decimal(Comma, false)),
            ("1234,567", Shown::Decimal(Comma, false)),
            ("1,234e2", Shown::Decimal(Comma, false)),
            (",5", Shown::Decimal(Comma, false)),
            ("-1,234", Shown::Either(Comma)),
            ("999.000", Shown::Either(Point)),
            ("1,234.5", Shown::Decimal(Point, true)),
            ("1.234.567,5", Shown::Decimal(Comma, true)),
            ("1,234,567", Shown::Decimal(Point, true)),
        ] {
            assert_eq!(shown(field), Some(expected), "{field}");
        }
        for field in [
            "",
            "-",
            ".",
            "a",
            "1.2.3",
            "12.05.2026",
            "1,23,456",
            "1,2.3,4",
            "1 234",
            "e5",
            "1'234",
        ] {
            assert_eq!(shown(field), None, "{field}");
        }
    }
}
