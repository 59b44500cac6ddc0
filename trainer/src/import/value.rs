//! Reads one field: a number in the unit of the map, or an error that names line and column.

use time::format_description::well_known::Iso8601;
use time::{OffsetDateTime, PrimitiveDateTime};

use crate::import::column_map::{AngleUnit, Decimal, JointUnit, LengthUnit, TimeUnit};
use crate::import::text::{Line, Table};
use poegp_calibration::input_error::InputError;

/// Time of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Seconds of the file's own clock; of a date and time, seconds since 1970.
    pub seconds: f64,
    /// Whether it is a date and time without a time zone, which cannot be compared with any other clock.
    pub is_local: bool,
}

/// A row together with its table.
#[derive(Clone, Copy)]
pub struct RowValues<'a> {
    pub table: &'a Table,
    pub line: &'a Line,
}

impl<'a> RowValues<'a> {
    /// Returns the text of a column, counted from 0.
    pub fn text(&self, index: usize) -> &'a str {
        self.line.fields.get(index).map_or("", String::as_str)
    }

    /// Returns whether a column has no value here: it is empty, or "NaN" as programs write that measure nothing.
    pub fn is_missing(&self, index: usize) -> bool {
        let text = self.text(index);
        text.is_empty() || text.eq_ignore_ascii_case("nan")
    }

    /// Returns an error at a column of this row.
    pub fn error(
        &self,
        index: usize,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        InputError::new(&self.table.path, found, expected)
            .at_line(self.line.number)
            .at_column(index + 1, self.table.name(index))
    }

    /// Returns the text of a column, and refuses an empty one.
    pub fn label(&self, index: usize) -> Result<String, InputError> {
        match self.text(index) {
            "" => Err(self.error(index, "an empty cell", "a name")),
            text => Ok(text.to_owned()),
        }
    }

    /// Returns the digits of a number as they are in the file, but with a decimal point.
    fn digits(&self, index: usize, expected: &str) -> Result<String, InputError> {
        let text = self.text(index);
        let error = |help: &str| {
            let found = if text.is_empty() {
                "an empty cell".to_owned()
            } else {
                format!("{text:?}")
            };
            let error = self.error(index, found, expected);
            if help.is_empty() {
                error
            } else {
                error.with_help(help)
            }
        };
        if self.is_missing(index) {
            return Err(error(
                "rows without a measurement: incomplete = \"leave-out\" in the map leaves them out and lists them",
            ));
        }
        let mark = match self.table.decimal {
            Decimal::Point => '.',
            Decimal::Comma => ',',
        };
        let mut digits = match self.table.thousands {
            Some(thousands) => without_groups(text, thousands, mark),
            None => text.to_owned(),
        };
        let (other, other_help) = match self.table.decimal {
            Decimal::Point => (
                ',',
                "is the comma the decimal point? Then decimal = \",\" in [file] of the map",
            ),
            Decimal::Comma if self.table.thousands == Some('.') => (
                '.',
                "the map says that the decimal point is a comma, and a point groups thousands: three digits follow it",
            ),
            Decimal::Comma => (
                '.',
                "the map says that the decimal point is a comma; a point that groups thousands is thousands = \".\"",
            ),
        };
        if digits.contains(other) {
            return Err(error(other_help));
        }
        if self.table.decimal == Decimal::Comma {
            digits = digits.replace(',', ".");
        }
        // `parse` accepts "inf", "nan" and "infinity", which no instrument writes.
        let numeric = digits
            .bytes()
            .all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
        match digits.parse::<f64>() {
            Ok(number) if numeric && number.is_finite() => Ok(digits),
            _ => Err(error("")),
        }
    }

    /// Returns a number without a unit.
    pub fn number(&self, index: usize, expected: &str) -> Result<f64, InputError> {
        Ok(shifted(&self.digits(index, expected)?, 0))
    }

    /// Returns a length in millimetres, rounded once.
    pub fn millimetres(&self, index: usize, unit: LengthUnit) -> Result<f64, InputError> {
        let (name, locations) = match unit {
            LengthUnit::Mm => ("a number in millimetres", 0),
            LengthUnit::M => ("a number in metres", 3),
            LengthUnit::Um => ("a number in micrometres", -3),
            LengthUnit::In => return Ok(25.4 * self.number(index, "a number in inches")?),
        };
        Ok(shifted(&self.digits(index, name)?, locations))
    }

    /// Returns a time.
    pub fn moment(&self, index: usize, unit: TimeUnit) -> Result<Moment, InputError> {
        let (name, locations) = match unit {
            TimeUnit::S => ("a time in seconds", 0),
            TimeUnit::Ms => ("a time in milliseconds", -3),
            TimeUnit::Us => ("a time in microseconds", -6),
            TimeUnit::Ns => ("a time in nanoseconds", -9),
            TimeUnit::Iso8601 => return self.date_and_time(index),
        };
        Ok(Moment {
            seconds: shifted(&self.digits(index, name)?, locations),
            is_local: false,
        })
    }

    /// Returns a date and a time of day, with or without a time zone.
    fn date_and_time(&self, index: usize) -> Result<Moment, InputError> {
        // Many programs write a blank in place of the T.
        let text = self.text(index).replacen(' ', "T", 1);
        let seconds = |at: OffsetDateTime| {
            let whole = at.unix_timestamp() as f64;
            whole + 1e-9 * f64::from(at.nanosecond())
        };
        if let Ok(at) = OffsetDateTime::parse(&text, &Iso8601::PARSING) {
            return Ok(Moment {
                seconds: seconds(at),
                is_local: false,
            });
        }
        match PrimitiveDateTime::parse(&text, &Iso8601::PARSING) {
            Ok(at) => Ok(Moment {
                seconds: seconds(at.assume_utc()),
                is_local: true,
            }),
            Err(_) => {
                let found = match self.text(index) {
                    "" => "an empty cell".to_owned(),
                    text => format!("{text:?}"),
                };
                let expected = "a date and a time of ISO 8601, as 2026-11-23T14:05:09.125Z";
                Err(self.error(index, found, expected))
            }
        }
    }

    /// Returns an angle in radians.
    pub fn radians(&self, index: usize, unit: AngleUnit) -> Result<f64, InputError> {
        Ok(match unit {
            AngleUnit::Deg => self.number(index, "a number in degrees")?.to_radians(),
            AngleUnit::Rad => self.number(index, "a number in radians")?,
            AngleUnit::Mrad => shifted(&self.digits(index, "a number in milliradians")?, -3),
        })
    }

    /// Returns a joint value in degrees, or in millimetres.
    pub fn joint(&self, index: usize, unit: JointUnit) -> Result<f64, InputError> {
        match unit {
            JointUnit::Deg => self.number(index, "a number in degrees"),
            JointUnit::Rad => Ok(self.number(index, "a number in radians")?.to_degrees()),
            JointUnit::Mm => self.millimetres(index, LengthUnit::Mm),
            JointUnit::M => self.millimetres(index, LengthUnit::M),
        }
    }
}

/// Returns a number without the marks that group thousands. They stand in the integer part, each before exactly three digits;
/// a number with others is returned as it is, and is none.
fn without_groups(text: &str, thousands: char, mark: char) -> String {
    let end = text.find([mark, 'e', 'E']).unwrap_or(text.len());
    let (whole, rest) = text.split_at(end);
    let mut groups = whole.split(thousands);
    let first = groups.next().unwrap_or("").trim_start_matches(['-', '+']);
    let is_group = |group: &str| group.len() == 3 && group.bytes().all(|b| b.is_ascii_digit());
    let is_first = (1..=3).contains(&first.len()) && first.bytes().all(|b| b.is_ascii_digit());
    match is_first && groups.all(is_group) {
        true => whole.replace(thousands, "") + rest,
        false => text.to_owned(),
    }
}

/// Moves the point of a decimal number by `locations` digits in its text. Returns the nearest `f64`, without the second
/// rounding of a multiplication.
fn shifted(digits: &str, locations: i64) -> f64 {
    let (mantissa, exponent) = digits.split_once(['e', 'E']).unwrap_or((digits, "0"));
    let exponent = exponent
        .parse::<i64>()
        .unwrap_or(0)
        .saturating_add(locations);
    format!("{mantissa}e{exponent}").parse().unwrap_or(f64::NAN)
}
