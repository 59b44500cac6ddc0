//! Shared parts of the TOML readers: positions of errors, and numbers whose key carries their unit.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, Range};
use std::path::Path;

use poegp_runtime::math::se3::Pose;
use serde::de::{Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use toml::Spanned;

use crate::input_error::{InputError, number};
use crate::robot::normal_form;

/// A key with its unit, the factor to SI, and the value if it is given.
pub type Unit<'a, T> = (&'static str, f64, &'a Option<Spanned<T>>);
/// The key that was given, its factor to SI, and its value.
pub type Quantity<'a, T> = (&'static str, f64, &'a Spanned<T>);

/// Factor to SI for a key that ends in `_m`.
pub const METRE: f64 = 1.0;
/// Factor to SI for a key that ends in `_mm`.
pub const MILLIMETRE: f64 = 1e-3;
/// Factor to SI for a key that ends in `_rad`.
pub const RADIAN: f64 = 1.0;
/// Factor to SI for a key that ends in `_deg`.
pub const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Largest radius of a link, in m: a larger one is in another unit.
const LARGEST_RADIUS: f64 = 2.0;

/// A list of exactly N values. Arrays of serde ignore what follows in a list, such as the digits after a decimal comma.
#[derive(Clone, Copy, PartialEq)]
pub struct Exactly<T, const N: usize>(pub [T; N]);

/// A list of exactly N numbers.
pub type Numbers<const N: usize> = Exactly<f64, N>;

impl<T: fmt::Debug, const N: usize> fmt::Debug for Exactly<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<T, const N: usize> Deref for Exactly<T, N> {
    type Target = [T; N];

    fn deref(&self) -> &[T; N] {
        &self.0
    }
}

impl<'de, T: Deserialize<'de>, const N: usize> Deserialize<'de> for Exactly<T, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(ListOf(PhantomData)).map(Self)
    }
}

/// Reads the array of an [`Exactly`], for fields of that type.
///
/// # Errors
/// Returns an error if the list has fewer or more values.
pub fn exactly<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize>(
    deserializer: D,
) -> Result<[T; N], D::Error> {
    Exactly::deserialize(deserializer).map(|list| list.0)
}

struct ListOf<T, const N: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for ListOf<T, N> {
    type Value = [T; N];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an array of length {N}")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<[T; N], A::Error> {
        let mut values = Vec::with_capacity(N);
        while values.len() < N
            && let Some(value) = list.next_element()?
        {
            values.push(value);
        }
        let mut length = values.len();
        while length >= N && list.next_element::<IgnoredAny>()?.is_some() {
            length += 1;
        }
        match values.try_into() {
            Ok(values) if length == N => Ok(values),
            _ => Err(A::Error::invalid_length(length, &self)),
        }
    }
}

/// A frame relative to the one before it, as in a URDF: position, then roll, pitch and yaw.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    xyz_m: Option<Spanned<Numbers<3>>>,
    xyz_mm: Option<Spanned<Numbers<3>>>,
    rpy_deg: Option<Spanned<Numbers<3>>>,
    rpy_rad: Option<Spanned<Numbers<3>>>,
}

/// Translates a message of serde into the terms of the file's author: what was found and, if the message says so, what was
/// expected.
pub fn found_and_expected(message: &str) -> (String, Option<String>) {
    let parts: Vec<&str> = message.split_whitespace().collect();
    let message = parts.join(" ");
    // Splits at the last occurrence, because a text in the file may contain the same phrase.
    let Some((found, expected)) = message.rsplit_once(", expected ") else {
        return match message.strip_prefix("missing field ") {
            Some(key) => (format!("no {key}"), Some(format!("the key {key}"))),
            None => (message, None),
        };
    };
    let expected = match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a sequence" => "a list".to_owned(),
        "a map" => "a table".to_owned(),
        other if other.starts_with("struct ") => "a table".to_owned(),
        other => match other.strip_prefix("an array of length ") {
            Some(length) => format!("a list of {length} values"),
            None => other.to_owned(),
        },
    };
    (found_value(found), Some(expected))
}

/// Beginnings of serde's messages and what replaces them for the author of the file; the rest of a message is kept.
const BEGINNINGS: [(&str, &str); 8] = [
    ("unknown field ", "the unknown key "),
    ("unknown variant ", ""),
    ("invalid length ", "a list of length "),
    ("integer ", "the number "),
    ("floating point ", "the number "),
    ("string ", "the text "),
    ("map", "a table"),
    ("sequence", "a list"),
];

/// Returns the value that serde's message names.
fn found_value(found: &str) -> String {
    let kinds = ["invalid type: ", "invalid value: "];
    let found = kinds
        .iter()
        .find_map(|kind| found.strip_prefix(kind))
        .unwrap_or(found);
    let is_number = found.starts_with("integer ") || found.starts_with("floating point ");
    if let Some(truth) = found.strip_prefix("boolean ") {
        return truth.trim_matches('`').to_owned();
    }
    let begun = BEGINNINGS
        .iter()
        .find_map(|(serde, said)| Some(format!("{said}{}", found.strip_prefix(serde)?)));
    match begun {
        Some(number) if is_number => number.replace('`', ""),
        Some(said) => said,
        None => found.to_owned(),
    }
}

/// The text of a TOML file.
#[derive(Clone, Copy)]
pub struct TomlSource<'a> {
    /// Path of the file, for messages.
    pub file: &'a Path,
    /// The whole text.
    pub text: &'a str,
}

impl TomlSource<'_> {
    /// Returns line and column, from 1, of a byte offset.
    pub fn line_and_column(&self, at: usize) -> (usize, usize) {
        let before = self.text.get(..at).unwrap_or(self.text);
        let column = 1 + before.rsplit('\n').next().unwrap_or("").chars().count();
        (1 + before.matches('\n').count(), column)
    }

    /// Creates an error at the start of `span`.
    pub fn error(
        &self,
        span: Range<usize>,
        key: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        let (line, column) = self.line_and_column(span.start);
        InputError::new(self.file, found, expected)
            .at_line(line)
            .at_column(column, key)
    }

    /// Splits a message of toml or serde into found and expected; `whole` describes the file.
    pub fn refused(&self, error: &toml::de::Error, whole: &str) -> InputError {
        let (found, expected) = found_and_expected(error.message());
        let expected = expected.unwrap_or_else(|| whole.to_owned());
        match error.span() {
            Some(span) => self.error(span, "", found, expected),
            None => InputError::new(self.file, found, expected),
        }
    }

    /// Returns the one of the `units` that is given, if any; a second one is refused.
    pub fn at_most_one_unit<'a, T>(
        &self,
        units: &[Unit<'a, T>],
    ) -> Result<Option<Quantity<'a, T>>, InputError> {
        let mut given: Option<Quantity<'a, T>> = None;
        for (key, factor, value) in units {
            let Some(value) = value.as_ref() else {
                continue;
            };
            if let Some((other, _, _)) = given {
                let found = format!("{key} beside {other}");
                return Err(self.error(value.span(), key, found, "the quantity once, in one unit"));
            }
            given = Some((*key, *factor, value));
        }
        Ok(given)
    }

    /// Reads finite numbers of one quantity in SI units.
    pub fn vector<const N: usize>(
        &self,
        units: &[Unit<'_, Numbers<N>>],
    ) -> Result<Option<[f64; N]>, InputError> {
        let Some((key, factor, value)) = self.at_most_one_unit(units)? else {
            return Ok(None);
        };
        if let Some(bad) = value.get_ref().iter().find(|number| !number.is_finite()) {
            return Err(self.error(value.span(), key, number(*bad), "finite numbers"));
        }
        Ok(Some(value.get_ref().0.map(|number| to_si(number, factor))))
    }

    /// Reads a single finite number in SI units.
    pub fn number(&self, units: &[Unit<'_, f64>]) -> Result<Option<f64>, InputError> {
        let Some((key, factor, value)) = self.at_most_one_unit(units)? else {
            return Ok(None);
        };
        if !value.get_ref().is_finite() {
            let found = number(*value.get_ref());
            return Err(self.error(value.span(), key, found, "a finite number"));
        }
        Ok(Some(to_si(*value.get_ref(), factor)))
    }

    /// Reads the radius of links, in m: 0, which leaves them without thickness, or more.
    pub fn radius(
        &self,
        metres: &Option<Spanned<f64>>,
        millimetres: &Option<Spanned<f64>>,
    ) -> Result<Option<f64>, InputError> {
        let units = [
            ("link_radius_m", METRE, metres),
            ("link_radius_mm", MILLIMETRE, millimetres),
        ];
        let radius = self.number(&units)?;
        match self.at_most_one_unit(&units)? {
            Some((key, factor, value))
                if !(0.0..=LARGEST_RADIUS).contains(&radius.unwrap_or(0.0)) =>
            {
                let found = number(*value.get_ref());
                let expected = format!("a radius from 0 to {}", LARGEST_RADIUS / factor);
                Err(self.error(value.span(), key, found, expected))
            }
            _ => Ok(radius),
        }
    }

    /// Converts an origin to the frame relative to the one before it.
    pub fn origin(&self, origin: &Origin) -> Result<Pose<f64>, InputError> {
        let xyz = self.vector(&[
            ("xyz_m", METRE, &origin.xyz_m),
            ("xyz_mm", MILLIMETRE, &origin.xyz_mm),
        ])?;
        let rpy = self.vector(&[
            ("rpy_rad", RADIAN, &origin.rpy_rad),
            ("rpy_deg", DEGREE, &origin.rpy_deg),
        ])?;
        Ok(normal_form::origin(
            xyz.unwrap_or_default(),
            rpy.unwrap_or_default(),
        ))
    }
}

/// Converts to SI with a single rounding if possible: a decimal number of millimetres is divided, not multiplied by 1e-3.
fn to_si(value: f64, factor: f64) -> f64 {
    if factor == MILLIMETRE {
        value / 1e3
    } else {
        value * factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> (String, Option<String>) {
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[allow(dead_code, reason = "read, never used")]
        struct File {
            count: u32,
            length: Option<f64>,
            place: Option<Numbers<3>>,
            all: Option<bool>,
            inner: Option<Inner>,
        }
        #[derive(Debug, Deserialize)]
        struct Inner {}
        found_and_expected(toml::from_str::<File>(text).unwrap_err().message())
    }

    #[test]
    fn numbers_show_as_a_list() {
        assert_eq!(format!("{:?}", Exactly([1.0, 1e300])), "[1.0, 1e300]");
    }

    #[test]
    fn serde_speaks_as_the_author_of_a_file_does() {
        for (text, found, expected) in [
            (
                "count = \"x\"",
                "the text \"x\"",
                Some("a whole number, 0 or more"),
            ),
            (
                "count = 0.5",
                "the number 0.5",
                Some("a whole number, 0 or more"),
            ),
            (
                "count = -1",
                "the number -1",
                Some("a whole number, 0 or more"),
            ),
            (
                "count = 1\nlength = \"1, expected 2\"",
                "the text \"1, expected 2\"",
                Some("a number"),
            ),
            ("count = 1\nlength = true", "true", Some("a number")),
            ("count = 1\nlength = []", "a list", Some("a number")),
            ("count = 1\nall = 1", "the number 1", Some("true or false")),
            (
                "count = 1\nplace = [1, 2]",
                "a list of length 2",
                Some("a list of 3 values"),
            ),
            (
                "count = 1\nplace = [1,5, 2, 0]",
                "a list of length 4",
                Some("a list of 3 values"),
            ),
            ("count = 1\ninner = 3", "the number 3", Some("a table")),
            ("length = 1", "no `count`", Some("the key `count`")),
        ] {
            let said = refused(text);
            assert_eq!(
                said,
                (found.to_owned(), expected.map(str::to_owned)),
                "{text}"
            );
        }
        let (found, expected) = refused("cuont = 1");
        assert_eq!(found, "the unknown key `cuont`");
        assert_eq!(
            expected.unwrap(),
            "one of `count`, `length`, `place`, `all`, `inner`"
        );
    }
}
