//! Checks the device's figures that documents quote: the table "Record" of `docs/evidence/performance.md`.

use std::fs;

use crate::firmware_build::{Toolchain, firmware};
use crate::workspace;

/// Compares a measured figure with its row of the record. Compilers generate different code from the same source, so the
/// tolerance is 2 % with the prebuilt `core` and 15 % otherwise.
///
/// # Panics
/// When the record has no such row, or another number.
pub fn assert_recorded(row: &str, measured: f64) {
    let page =
        fs::read_to_string(workspace().join("docs/evidence/performance.md")).expect("the record");
    let start = format!("| {row} |");
    let line = page.lines().find_map(|line| line.strip_prefix(&start));
    let line = line.unwrap_or_else(|| panic!("no record of {row}"));
    let number: String = line
        .split('|')
        .next()
        .unwrap_or("")
        .split_whitespace()
        .collect();
    let recorded: f64 = number.parse().expect("a number");
    let tolerance = match firmware().map(|image| &image.toolchain) {
        Ok(Toolchain::Prebuilt { .. }) => 0.02,
        _ => 0.15,
    };
    assert!(
        (measured - recorded).abs() <= tolerance * recorded,
        "{row}: measured {measured:.0}, recorded {recorded:.0}; update docs/evidence/performance.md"
    );
}
