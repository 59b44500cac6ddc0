//! The names of columns: each states a quantity and its unit.

/// The quantity that a column holds. The order is that in which messages mention them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Quantity {
    /// Joint number as written in the column name, from 1.
    Joint(usize),
    Payload,
    Time,
    Session,
    Target,
    /// Coordinate axis, 0 to 2.
    Position(usize),
    /// Component of the quaternion: w, x, y, z as 0 to 3.
    Orientation(usize),
    SigmaPosition,
    SigmaOrientation,
    /// Number of the reference point, from 1, and coordinate axis, 0 to 2.
    Reference(usize, usize),
    TruePosition(usize),
    TrueOrientation(usize),
    /// What a row touched. A file with this column is a touch file; the four quantities below have a meaning only in one.
    Feature,
    Value,
    Gravity(usize),
    Corner,
    /// Image coordinate: u, v as 0 and 1.
    Pixel(usize),
}

/// The unit in a column's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    Degree,
    Radian,
    Milliradian,
    Metre,
    Millimetre,
    Kilogram,
    Second,
    Pixel,
    /// A number without a unit, or a text.
    None,
}

impl Unit {
    /// Returns what a message expects of a field in this unit, for example "a number in degrees".
    pub(super) fn expected(self) -> &'static str {
        match self {
            Self::Degree => "a number in degrees",
            Self::Radian => "a number in radians",
            Self::Milliradian => "a number in milliradians",
            Self::Metre => "a number in metres",
            Self::Millimetre => "a number in millimetres",
            Self::Kilogram => "a number in kilograms",
            Self::Second => "a number in seconds",
            Self::Pixel => "a number in pixels",
            Self::None => "a number",
        }
    }
}

pub(super) const AXES: [&str; 3] = ["x", "y", "z"];
pub(super) const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
/// Name of the column that makes a file a touch file.
pub(super) const FEATURE: &str = "feature";

/// Returns the quantity and unit of a column name that has a meaning only in a touch file.
pub(super) fn meaning_of_touch(name: &str) -> Option<(Quantity, Unit)> {
    Some(match name {
        FEATURE => (Quantity::Feature, Unit::None),
        "value_mm" => (Quantity::Value, Unit::Millimetre),
        "value_m" => (Quantity::Value, Unit::Metre),
        "gx" => (Quantity::Gravity(0), Unit::None),
        "gy" => (Quantity::Gravity(1), Unit::None),
        "gz" => (Quantity::Gravity(2), Unit::None),
        "corner" => (Quantity::Corner, Unit::None),
        "u_px" => (Quantity::Pixel(0), Unit::Pixel),
        "v_px" => (Quantity::Pixel(1), Unit::Pixel),
        _ => return None,
    })
}

/// Returns the quantity and unit of a column name.
pub(super) fn meaning(name: &str) -> Option<(Quantity, Unit)> {
    let whole = match name {
        "payload_kg" => Some((Quantity::Payload, Unit::Kilogram)),
        "time_s" => Some((Quantity::Time, Unit::Second)),
        "session" => Some((Quantity::Session, Unit::None)),
        "target" => Some((Quantity::Target, Unit::None)),
        "sigma_mm" => Some((Quantity::SigmaPosition, Unit::Millimetre)),
        "sigma_m" => Some((Quantity::SigmaPosition, Unit::Metre)),
        "sigma_mrad" => Some((Quantity::SigmaOrientation, Unit::Milliradian)),
        "sigma_rad" => Some((Quantity::SigmaOrientation, Unit::Radian)),
        "sigma_deg" => Some((Quantity::SigmaOrientation, Unit::Degree)),
        _ => None,
    };
    if whole.is_some() {
        return whole;
    }
    let component = |name: &str| QUATERNION.iter().position(|component| *component == name);
    if let Some(component) = component(name) {
        return Some((Quantity::Orientation(component), Unit::None));
    }
    if let Some(component) = name.strip_prefix("true_").and_then(component) {
        return Some((Quantity::TrueOrientation(component), Unit::None));
    }
    let (stem, unit) = name.rsplit_once('_')?;
    let unit = match unit {
        "deg" => Unit::Degree,
        "rad" => Unit::Radian,
        "mm" => Unit::Millimetre,
        "m" => Unit::Metre,
        _ => return None,
    };
    if let Some(joint) = stem.strip_prefix('q').and_then(number) {
        return Some((Quantity::Joint(joint), unit));
    }
    if !matches!(unit, Unit::Millimetre | Unit::Metre) {
        return None;
    }
    let axis = |name: &str| AXES.iter().position(|axis| *axis == name);
    if let Some(axis) = axis(stem) {
        return Some((Quantity::Position(axis), unit));
    }
    let (head, tail) = stem.split_once('_')?;
    let axis = axis(tail)?;
    if head == "true" {
        return Some((Quantity::TruePosition(axis), unit));
    }
    let point = head.strip_prefix("ref").and_then(number)?;
    Some((Quantity::Reference(point, axis), unit))
}

/// Parses a number from 0 to 99 in its usual form: digits without a leading zero.
fn number(text: &str) -> Option<usize> {
    let plain = text.len() <= 2 && text.bytes().all(|byte| byte.is_ascii_digit());
    if !plain || (text.len() > 1 && text.starts_with('0')) {
        return None;
    }
    text.parse().ok()
}

/// Returns the column that an unknown name was probably meant to be: in other letters, in a unit that no column has, or
/// without its unit. `read` returns the meaning of a name.
pub(super) fn likely_name(
    name: &str,
    read: impl Fn(&str) -> Option<(Quantity, Unit)>,
) -> Option<(String, Quantity)> {
    let plain = name.trim().to_lowercase().replace([' ', '-'], "_");
    let is_bare = ["payload", "value"].contains(&plain.as_str());
    let (stem, units): (&str, &[&str]) = match plain.rsplit_once('_') {
        Some((stem, unit)) => (stem, units_for(unit)),
        None if is_bare => (&plain, &["mm", "kg"]),
        None => ("", &[]),
    };
    let with_units = units.iter().map(|unit| format!("{stem}_{unit}"));
    let component = plain.replacen("q_", "q", 1);
    let mut candidates = [plain.clone(), component].into_iter().chain(with_units);
    candidates.find_map(|name| {
        let (quantity, _) = read(&name)?;
        Some((name, quantity))
    })
}

/// Returns the units of columns that hold the quantity of a unit that no column has.
fn units_for(unit: &str) -> &'static [&'static str] {
    match unit {
        "um" | "nm" | "cm" | "dm" | "in" | "inch" | "ft" | "mil" => &["mm"],
        "urad" | "arcsec" | "arcmin" => &["mrad", "deg"],
        "gon" | "grad" | "rev" | "turns" => &["deg"],
        "lb" | "lbs" | "mg" | "g" | "t" | "n" => &["kg"],
        "ms" | "us" | "ns" | "min" | "h" => &["s"],
        _ => &[],
    }
}
