//! Reads one field: a number in the unit of the map, or an error that names line and column.

use time::format_description::well_known::Iso8601;
use time::{OffsetDateTime, PrimitiveDateTime};

use crate::import::column_map::{AngleUnit, Decimal, JointUnit, LengthUnit, TimeUnit};
use crate::import::marks::{Shown, is_grouped, shown};
use crate::import::text::{Line, Table};
use poegp_calibration::input_error::InputError;

/// Time of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Seconds of the file's own clock; of a date and time, seconds since 1970; of a time of day, since midnight.
    pub seconds: f64,
    /// Whether it is a time of day, or a date and time, without a time zone: it cannot be compared with any other clock.
    pub is_local: bool,
}

/// A row together with its table.
#[derive(Clone, Copy)]
pub struct RowValues<'a> {
    pub table: &'a Table,
    pub line: &'a Line,
}

impl<'a> RowValues<'a> {
    /// Returns the values of a line of `table`.
    pub fn new(table: &'a Table, line: &'a Line) -> Self {
        Self { table, line }
    }

    /// Returns the text of a column, counted from 0.
    pub fn text(&self, index: usize) -> &'a str {
        self.line.fields.get(index).map_or("", String::as_str)
    }

    /// Returns whether a column has no value here: it is empty, or "NaN" as programs write that measure nothing.
    pub fn is_missing(&self, index: usize) -> bool {
        let text = self.text(index);
        text.is_empty() || text.eq_ignore_ascii_case("nan")
    }

    /// Returns the line of this row and the file, for a list of rows of several files.
    pub fn location(&self) -> String {
        format!("{} of {}", self.line.number, self.table.path.display())
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

    /// Describes the contents of a column for an error.
    fn found(&self, index: usize) -> String {
        match self.text(index) {
            "" => "an empty cell".to_owned(),
            text => format!("{text:?}"),
        }
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
            let error = self.error(index, self.found(index), expected);
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
        let mark = self.table.decimal.mark();
        let mut digits = match self.table.thousands {
            Some(thousands) => without_groups(text, thousands, mark),
            None => text.to_owned(),
        };
        let (other, other_help) = match self.table.decimal {
            Decimal::Point if shown(text) == Some(Shown::Either(Decimal::Comma)) => (
                ',',
                "does the comma group thousands, or is it the decimal point? State thousands = \",\" or decimal = \",\" in [file] of the \
                 map",
            ),
            Decimal::Point => (
                ',',
                "is the comma the decimal point? Then decimal = \",\" in [file] of the map",
            ),
            Decimal::Comma if self.table.thousands == Some('.') => (
                '.',
                "the numbers of this file have a decimal comma, and a point groups thousands: three digits follow it",
            ),
            Decimal::Comma => (
                '.',
                "the numbers of this file have a decimal comma; if a point groups thousands, state thousands = \".\" in [file] of a map",
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
            TimeUnit::Clock => return self.time_of_day(index),
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
                let expected = "a date and a time of ISO 8601, as 2026-11-23T14:05:09.125Z";
                Err(self.error(index, self.found(index), expected))
            }
        }
    }

    /// Returns a time of day: hours, minutes and seconds, with AM or PM behind them or without.
    fn time_of_day(&self, index: usize) -> Result<Moment, InputError> {
        let seconds = seconds_of_day(self.text(index)).ok_or_else(|| {
            let expected = "a time of day in hours, minutes and seconds, as 14:05:09.125";
            self.error(index, self.found(index), expected)
        })?;
        Ok(Moment {
            seconds,
            is_local: true,
        })
    }

    /// Returns an angle in radians.
    pub fn radians(&self, index: usize, unit: AngleUnit) -> Result<f64, InputError> {
        Ok(match unit {
            AngleUnit::Deg => self.number(index, "a number in degrees")?.to_radians(),
            AngleUnit::Rad => self.number(index, "a number in radians")?,
            AngleUnit::Mrad => shifted(&self.digits(index, "a number in milliradians")?, -3),
            AngleUnit::Urad => shifted(&self.digits(index, "a number in microradians")?, -6),
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
    match is_grouped(whole.trim_start_matches(['-', '+']), thousands) {
        true => whole.replace(thousands, "") + rest,
        false => text.to_owned(),
    }
}

/// Returns the seconds since midnight of `14:05:09.125`, or of `2:05:09 PM`.
fn seconds_of_day(text: &str) -> Option<f64> {
    let upper = text.to_ascii_uppercase();
    let half = [(" AM", 0), (" PM", 12)]
        .into_iter()
        .find_map(|(mark, hours)| Some((upper.strip_suffix(mark)?.trim_end(), hours)));
    let parts: Vec<&str> = half
        .map_or(upper.as_str(), |(time, _)| time)
        .split(':')
        .collect();
    let [hours, minutes, seconds] = *parts.as_slice() else {
        return None;
    };
    let whole = |text: &str, digits: usize, most: u32| {
        let is_whole =
            (1..=digits).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_digit());
        let number = text.parse::<u32>().ok()?;
        (is_whole && number <= most).then_some(number)
    };
    let hours = match (whole(hours, 2, 23)?, half) {
        (hours, None) => hours,
        (hours @ 1..=12, Some((_, more))) => hours % 12 + more,
        _ => return None,
    };
    let (of_minute, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, "0"));
    let is_fraction = fraction.bytes().all(|b| b.is_ascii_digit());
    let fraction: f64 = format!("0.{fraction}")
        .parse()
        .ok()
        .filter(|_| is_fraction)?;
    let minutes = 60 * hours + whole(minutes, 2, 59)?;
    Some(f64::from(60 * minutes + whole(of_minute, 2, 59)?) + fraction)
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
