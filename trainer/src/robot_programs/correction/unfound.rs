//! Tells which routines a program calls that are in none of the files.

use std::collections::BTreeMap;

use crate::robot_programs::correction::program::{Location, Program};

/// Largest number of routines that the remark names.
const NAMED: usize = 8;

/// Adds a remark on the routines that are in none of the files, each with its first call.
pub fn note(program: &mut Program, calls: impl IntoIterator<Item = (String, Location)>) {
    let mut first: BTreeMap<String, (Location, String)> = BTreeMap::new();
    for (name, location) in calls {
        let key = name.to_lowercase();
        first.entry(key).or_insert((location, name));
    }
    let mut all: Vec<(Location, String)> = first.into_values().collect();
    all.sort();
    let Some((location, _)) = all.first() else {
        return;
    };
    let line = program.line_of(*location);
    let names: Vec<&str> = all
        .iter()
        .take(NAMED)
        .map(|(_, name)| name.as_str())
        .collect();
    let more = match all.len() - names.len() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    program.remarks.push(format!(
        "{line}: routines in none of the files: {}{more}: it is assumed that they set no tool, frame or payload; if \
         they do, give their files with --with",
        names.join(", ")
    ));
}
