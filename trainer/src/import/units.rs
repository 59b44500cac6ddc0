//! Units of columns, stated by the map or by the header of the file: `X [mm]`, `X (mm)`, or a second line of the header.
//!
//! One statement is enough. Two that differ are refused, because nothing says which of them is right.

use crate::import::column_map::{AngleUnit, JointUnit, LengthUnit, Map, MassUnit, TimeUnit};
use crate::import::text::Table;
use poegp_calibration::input_error::InputError;

/// A kind of units that a header can state.
pub trait Unit: Copy + PartialEq + 'static {
    /// Every unit with its names; a map uses the first name. A header may write names of several letters in capitals, too.
    const UNITS: &'static [(Self, &'static [&'static str])];

    /// Returns the unit with this name.
    fn named(text: &str) -> Option<Self> {
        let mut units = Self::UNITS.iter();
        let found = units.find(|(_, names)| is_among(names, text));
        found.map(|(unit, _)| *unit)
    }

    /// Returns the unit's name in a map.
    fn name(self) -> &'static str {
        let mut units = Self::UNITS.iter();
        let found = units.find(|(unit, _)| *unit == self);
        found.map_or("", |(_, names)| names[0])
    }
}

const MILLIMETRE: &[&str] = &[
    "mm",
    "millimeter",
    "millimeters",
    "millimetre",
    "millimetres",
];
const METRE: &[&str] = &["m", "M", "meter", "meters", "metre", "metres"];

impl Unit for LengthUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::Mm, MILLIMETRE),
        (Self::M, METRE),
        (
            Self::Um,
            &[
                "um",
                "µm",
                "μm",
                "micron",
                "microns",
                "micrometer",
                "micrometre",
            ],
        ),
        (Self::In, &["in", "inch", "inches", "zoll", "\""]),
    ];
}

const DEGREE: &[&str] = &["deg", "°", "º", "degree", "degrees"];
const RADIAN: &[&str] = &["rad", "radian", "radians"];

impl Unit for AngleUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::Deg, DEGREE),
        (Self::Rad, RADIAN),
        (Self::Mrad, &["mrad", "milliradian", "milliradians"]),
        (
            Self::Urad,
            &["urad", "µrad", "μrad", "microradian", "microradians"],
        ),
    ];
}

impl Unit for JointUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::Deg, DEGREE),
        (Self::Rad, RADIAN),
        (Self::Mm, MILLIMETRE),
        (Self::M, METRE),
    ];
}

impl Unit for TimeUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] = &[
        (Self::S, &["s", "sec", "second", "seconds"]),
        (Self::Ms, &["ms", "msec", "millisecond", "milliseconds"]),
        (Self::Us, &["us", "µs", "μs", "microsecond", "microseconds"]),
        (Self::Ns, &["ns", "nsec", "nanosecond", "nanoseconds"]),
        (Self::Iso8601, &["iso8601", "ISO 8601"]),
        (Self::Clock, &["clock", "hh:mm:ss", "h:mm:ss"]),
    ];
}

impl Unit for MassUnit {
    const UNITS: &'static [(Self, &'static [&'static str])] =
        &[(Self::Kg, &["kg"]), (Self::G, &["g"])];
}

/// Units that headers state and no import converts.
const OTHERS: &[&str] = &[
    "nm", "cm", "dm", "mil", "mils", "thou", "ft", "foot", "feet", "gon", "arcmin", "arcsec",
    "rev", "turn", "turns", "mg", "t", "lb", "lbs", "oz", "min", "h",
];

/// Returns whether a text is one of these names. The letters of a single one must agree in case: "S" is an axis of a robot.
fn is_among(names: &[&str], text: &str) -> bool {
    let same = |name: &str| match text.chars().nth(1) {
        None => name == text,
        Some(_) => name.eq_ignore_ascii_case(text),
    };
    names.iter().any(|name| same(name))
}

/// Returns whether a text is the name of any unit.
fn is_unit(text: &str) -> bool {
    LengthUnit::named(text).is_some()
        || AngleUnit::named(text).is_some()
        || MassUnit::named(text).is_some()
        || TimeUnit::named(text).is_some()
        || is_among(OTHERS, text)
}

/// Returns the unit of a column: the one that the map states under `key` (`stated`), or the one of the header.
pub fn unit_of<U: Unit>(
    map: &Map,
    table: &Table,
    column: usize,
    stated: Option<U>,
    key: &str,
) -> Result<U, InputError> {
    let names: Vec<&str> = U::UNITS.iter().map(|(_, names)| names[0]).collect();
    let names = names.join(", ");
    let error = |line: usize, found: String, expected: String| {
        InputError::new(&table.path, found, expected)
            .at_line(line)
            .at_column(column + 1, table.name(column))
    };
    let mut unit = stated;
    let mut source = format!("which {} states as {key}", map.path.display());
    for (line, text) in table.units(column) {
        let found = format!("the unit {text:?}");
        match (unit, U::named(text)) {
            (None, None) => return Err(error(line, found, format!("one of {names}"))),
            (None, named) => {
                unit = named;
                source = format!("as line {line} says");
            }
            (Some(unit), named) if named != Some(unit) && is_unit(text) => {
                return Err(error(line, found, format!("{}, {source}", unit.name())));
            }
            // A text in brackets that is no unit, such as that of a frame.
            _ => {}
        }
    }
    if let Some(unit) = unit {
        return Ok(unit);
    }
    let expected =
        format!("{key} = \"…\" ({names}) in the map, or the unit in brackets after the name");
    let Some(header) = &table.header else {
        let found = format!("no {key}, and no header in {}", table.path.display());
        return Err(InputError::new(&map.path, found, expected));
    };
    let found = "a column without a unit".to_owned();
    Err(error(header.number, found, expected))
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
            .at_line(table.units(*column).next().map_or(line, |(line, _)| line))
            .at_column(column + 1, table.name(*column)));
        }
        shared = Some(unit);
    }
    shared.ok_or_else(|| InputError::new(&map.path, format!("no column for {key}"), "at least one"))
}
