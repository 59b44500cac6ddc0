//! Units of columns, stated by the map or by the header of the file: `X [mm]`, `X (mm)`, or a second line of the header.
//!
//! One statement is enough. Two that differ are refused, because nothing says which of them is right.

use crate::import::column_map::{AngleUnit, JointUnit, LengthUnit, Map, MassUnit, TimeUnit};
use crate::import::text::Table;
use poegp_calibration::input_error::InputError;

/// A kind of units that a header can state.
pub trait Unit: Copy + PartialEq + 'static {
    /// Every unit with its names; a map uses the first name.
    const UNITS: &'static [(Self, &'static [&'static str])];

    /// Returns the unit with this name.
    fn named(text: &str) -> Option<Self> {
        let mut units = Self::UNITS.iter();
        let found = units.find(|(_, names)| names.contains(&text));
        found.map(|(unit, _)| *unit)
    }

    /// Returns the unit's name in a map.
    fn name(self) -> &'static str {
        let mut units = Self::UNITS.iter();
        let found = units.find(|(unit, _)| *unit == self);
        found.map_or("", |(_, names)| names[0])
    }
}

impl Unit for LengthUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::Mm, &["mm"]),
        (Self::M, &["m"]),
        (Self::Um, &["um", "µm", "μm"]),
        (Self::In, &["in", "inch", "inches"]),
    ];
}

impl Unit for AngleUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::Deg, &["deg", "°", "degrees"]),
        (Self::Rad, &["rad", "radians"]),
        (Self::Mrad, &["mrad"]),
    ];
}

impl Unit for JointUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::Deg, &["deg", "°", "degrees"]),
        (Self::Rad, &["rad", "radians"]),
        (Self::Mm, &["mm"]),
        (Self::M, &["m"]),
    ];
}

impl Unit for TimeUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::S, &["s"]),
        (Self::Ms, &["ms"]),
        (Self::Iso8601, &["iso8601", "ISO 8601"]),
    ];
}

impl Unit for MassUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] =
        &[(Self::Kg, &["kg"]), (Self::G, &["g"])];
}

/// Returns whether a text is the name of any unit.
fn is_unit(text: &str) -> bool {
    LengthUnit::named(text).is_some()
        || AngleUnit::named(text).is_some()
        || MassUnit::named(text).is_some()
        || TimeUnit::named(text).is_some()
}

/// Returns the unit of a column: the one that the map states under `key` (`stated`), or the one of the header.
pub fn unit_of<U: Unit>(
    map: &Map,
    table: &Table,
    column: usize,
    stated: Option<U>,
    key: &str,
) -> Result<U, InputError> {
    let header = table.unit(column);
    let names: Vec<&str> = U::UNITS.iter().map(|(_, names)| names[0]).collect();
    let names = names.join(", ");
    let (line, found, expected) = match (stated, header) {
        (Some(stated), Some((line, text))) if is_unit(text) && U::named(text) != Some(stated) => {
            let expected = format!(
                "{}, which {} states as {key}",
                stated.name(),
                map.path.display()
            );
            (line, format!("the unit {text:?}"), expected)
        }
        (Some(stated), _) => return Ok(stated),
        (None, Some((line, text))) => match U::named(text) {
            Some(unit) => return Ok(unit),
            None => (
                line,
                format!("the unit {text:?}"),
                format!("one of {names}"),
            ),
        },
        (None, None) => {
            let expected = format!(
                "{key} = \"…\" ({names}) in the map, or the unit in brackets behind the name"
            );
            let Some(header) = &table.header else {
                let found = format!("no {key}, and no header in {}", table.path.display());
                return Err(InputError::new(&map.path, found, expected));
            };
            (
                header.number,
                "a column without a unit".to_owned(),
                expected,
            )
        }
    };
    Err(InputError::new(&table.path, found, expected)
        .at_line(line)
        .at_column(column + 1, table.name(column)))
}

/// Returns the unit that several columns share.
pub fn shared_unit<U: Unit>(
    map: &Map,
    table: &Table,
    columns: &[usize],
    stated: Option<U>,
    key: &str,
) -> Result<U, InputError> {
    let mut shared: Option<U> = None;
    for column in columns {
        let unit = unit_of(map, table, *column, stated, key)?;
        if let Some(first) = shared.filter(|first| *first != unit) {
            let line = table.header.as_ref().map_or(1, |header| header.number);
            let expected = format!("{}, as {:?} has", first.name(), table.name(columns[0]));
            return Err(InputError::new(
                &table.path,
                format!("the unit {:?}", unit.name()),
                expected,
            )
            .at_line(table.unit(*column).map_or(line, |(line, _)| line))
            .at_column(column + 1, table.name(*column)));
        }
        shared = Some(unit);
    }
    shared.ok_or_else(|| InputError::new(&map.path, format!("no column for {key}"), "one at least"))
}
