//! External axes of RAPID: where one is not at zero, a target with 9E9 in its place is somewhere else.

use std::collections::HashSet;

use crate::robot_programs::correction::program::{Goal, Location};
use crate::robot_programs::correction::rapid::Reader;
use crate::robot_programs::correction::rapid::data::{Read, moves_axes, target};
use crate::robot_programs::correction::rapid::statements::Statement;
use crate::robot_programs::correction::tokens::{Text, Value};

/// Instructions that move external axes besides the moves to targets.
const MOVING: [&str; 6] = [
    "eoffson", "eoffsset", "indamove", "indcmove", "inddmove", "indrmove",
];

/// Returns whether a list of lists that ends before a token ends with six numbers 9E9, as most targets do: it need not be read.
fn has_no_axes(text: &Text<'_>, end: usize) -> bool {
    let is_unset = |k: usize| {
        let at = end.checked_sub(3 + 2 * k);
        at.and_then(|at| text.number(at))
            .is_some_and(|n| n.value == 9e9)
    };
    (0..6).all(is_unset)
}

impl Reader<'_> {
    /// Returns the first line that moves an external axis from zero.
    pub(super) fn external_axes(&self, all: &[Statement]) -> Option<String> {
        let joints: HashSet<String> = (self.texts.iter())
            .flat_map(|text| {
                let is_type = |at: &usize| text.has_name(*at, "jointtarget");
                let names = (0..text.tokens.len()).filter(is_type);
                names.map(|at| text.name(at + 1))
            })
            .collect();
        let moves = |s: &Statement| {
            let text = self.texts[s.file];
            let word = text.name(s.from);
            let is_own = self.by_name.contains_key(&word);
            let behind = s.from + 1;
            let is_moved = match word.as_str() {
                _ if is_own => false,
                // \Conc may come first.
                "moveextj" => {
                    let stop = text.find(behind, s.end, b",");
                    let is_switch = text.is(behind, b'\\');
                    let from = if is_switch { stop + 1 } else { behind };
                    let stop = if is_switch {
                        text.find(from, s.end, b",")
                    } else {
                        stop
                    };
                    match text.value(from, stop) {
                        Value::Name(name) => !joints.contains(&name),
                        value => moves_axes(&value).unwrap_or(true),
                    }
                }
                word => MOVING.contains(&word),
            };
            let set = self
                .assignment(s)
                .filter(|(_, component, _)| component.split('.').any(|part| part == "extax"));
            let is_set =
                set.is_some_and(|(.., from)| moves_axes(&text.value(from, s.end)).unwrap_or(true));
            let is_literal = || {
                let starts = (s.from..s.end).filter(|at| text.is(*at, b'['));
                let mut lists = starts.filter(|at| text.is(at + 1, b'['));
                lists.any(|at| {
                    let end = (text.find(at + 1, s.end, b"]") + 1).min(s.end);
                    if has_no_axes(&text, end) {
                        return false;
                    }
                    let value = text.value(at, end);
                    let location = Location {
                        file: s.file,
                        at: 0,
                    };
                    !matches!(target(&value, location), Read::Nothing)
                        && moves_axes(&value).unwrap_or(true)
                })
            };
            is_moved || is_set || is_literal()
        };
        let first = all.iter().find(|s| moves(s))?;
        Some(self.program.line_of(self.location(first, first.from)))
    }

    /// Reads a list as a target. A pose without external axes is left where something moves them.
    pub(super) fn read_target(&self, value: &Value, location: Location) -> Read {
        match (target(value, location), &self.external) {
            (Read::Target(found), Some(line)) if matches!(found.goal, Goal::Pose { .. }) => {
                Read::Left(format!(
                    "its external axes are 9E9, so the controller leaves them where {line} puts them"
                ))
            }
            (read, _) => read,
        }
    }
}
