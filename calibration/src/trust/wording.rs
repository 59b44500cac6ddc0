//! Formats numbers and lines for the findings.

use crate::input_error::some_of;

/// What to do about rows of several set-ups of the instrument or the robot.
pub const ONE_SET_UP: &str = "calibrate from the rows of one set-up, or transform those of each by fixed points that were \
    measured from all of them";

/// Formats position and rotation, for example "1.06 mm and 2.2 mrad", or only the position.
pub fn lengths(metres: f64, radians: f64, with_rotation: bool) -> String {
    let position = length(metres);
    if with_rotation {
        format!("{position} and {} mrad", three_digits(1e3 * radians))
    } else {
        position
    }
}

/// Formats a length in mm, or in µm if it is below a tenth of a millimetre.
pub fn length(metres: f64) -> String {
    if metres < 1e-4 {
        format!("{} µm", three_digits(1e6 * metres))
    } else {
        format!("{} mm", three_digits(1e3 * metres))
    }
}

/// Lists what explains the rows as well as what was named.
pub fn fits_equally(others: &[String]) -> String {
    match others.is_empty() {
        true => String::new(),
        false => format!(" (fits equally: {})", others.join("; ")),
    }
}

/// Formats a number with three significant digits, without an exponent.
pub fn three_digits(value: f64) -> String {
    let size = value.abs();
    if size >= 100.0 {
        format!("{value:.0}")
    } else if size >= 10.0 {
        format!("{value:.1}")
    } else {
        format!("{value:.2}")
    }
}

/// Largest number of ranges in a list.
const RANGES: usize = 6;

/// Formats lines of the file as ranges: "line 7", "lines 7–9, 12".
pub fn lines(lines: &[usize]) -> String {
    let mut sorted = lines.to_vec();
    sorted.sort_unstable();
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for line in sorted {
        match ranges.last_mut() {
            Some((_, last)) if line <= *last + 1 => *last = line,
            _ => ranges.push((line, line)),
        }
    }
    let shown: Vec<String> = ranges
        .iter()
        .map(|(first, last)| match first == last {
            true => first.to_string(),
            false => format!("{first}–{last}"),
        })
        .collect();
    let plural = if lines.len() == 1 { "line" } else { "lines" };
    format!("{plural} {}", some_of(&shown, RANGES))
}
