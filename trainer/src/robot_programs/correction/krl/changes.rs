//! What a line of KRL changes by name: points, frame data, and frames, tools and bases that it gives to a routine.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::robot_programs::correction::krl::Reader;
use crate::robot_programs::correction::krl::states::{BASE, LOAD, Line, Named, TOOL};
use crate::robot_programs::correction::program::Goal;

/// Words before a bracket that compute or tell something of a point, and do not go there.
const READING: [&str; 9] = [
    "and", "forward", "if", "inv_pos", "inverse", "not", "or", "varstate", "while",
];

impl Reader<'_> {
    /// Notes the points and frame data that a line changes.
    pub(super) fn note_change(&mut self, line: Line) {
        let text = self.texts[line.file];
        let (at, _) = self.declared(line);
        if at > line.from || text.name(at).starts_with("def") {
            return;
        }
        let is_set = text.is(at + 1, b'=') || text.is(at + 1, b'.');
        let is_element_set = text.is(at + 1, b'[') && self.is_code(line.file);
        let mut changed = vec![at; usize::from(is_set || is_element_set)];
        changed.extend(self.given(line).into_iter().flatten());
        for at in changed.iter().filter(|at| text.name(**at) == "load_data") {
            self.forget_load(line.file, *at);
        }
        let reason = format!(
            "the program changes it at {}",
            self.program.line_of(self.location(line.file, at))
        );
        for at in changed {
            let name = text.name(at);
            let targets = self.targets_at(line.file, at);
            for index in &targets {
                let location = self.program.targets[*index].location;
                self.program.leave(location, reason.clone());
            }
            if !targets.is_empty() {
                continue;
            }
            if let Some(data) = self.frame_data.find_mut(&name, line.file) {
                let unknown = Named::Unknown(format!("frame data {name}: {reason}"));
                (data.tool, data.base) = (unknown.clone(), unknown);
            } else if let Some(pose) = self.named_frames.find_mut(&name, line.file) {
                *pose = None;
            }
        }
        self.leave_passed(line);
    }

    /// Leaves the points that a line passes to a routine, which may go to them with other frames.
    fn leave_passed(&mut self, line: Line) {
        let text = self.texts[line.file];
        let is_call = |at: &usize| {
            let name = text.name(*at);
            !name.is_empty() && text.is(at + 1, b'(') && !READING.contains(&name.as_str())
        };
        for call in (line.from..line.end).filter(is_call) {
            let close = text.find(call + 2, line.end, b")");
            for (from, end) in text.arguments(call + 2, close) {
                let is_element = text.is(from + 1, b'[') && text.is(end - 1, b']');
                if end != from + 1 && !is_element {
                    continue;
                }
                for index in self.targets_at(line.file, from) {
                    if !matches!(self.program.targets[index].goal, Goal::Pose { .. }) {
                        continue;
                    }
                    let line = self.program.line_of(self.location(line.file, call));
                    let reason = format!("{} at {line} also receives it", text.spelling(call));
                    let location = self.program.targets[index].location;
                    self.program.leave(location, reason);
                }
            }
        }
    }

    /// Returns the tokens between the brackets of each call of a routine that changes what its caller gives it.
    fn given(&self, line: Line) -> Vec<Range<usize>> {
        let text = self.texts[line.file];
        let is_header = text.name(self.declared(line).0).starts_with("def");
        let calls = (line.from..line.end).filter(|at| {
            !is_header && text.is(at + 1, b'(') && self.changing.contains(&text.name(*at))
        });
        calls
            .map(|call| call + 2..text.find(call + 2, line.end, b")"))
            .collect()
    }

    /// Returns the tools (true) and bases that a line changes besides `TOOL_DATA[n]=…`: those that it gives to a routine, by
    /// number, and those of a computed number. No number is any number.
    pub(super) fn given_numbered(&self, line: Line) -> Vec<(bool, Option<u32>)> {
        let text = self.texts[line.file];
        let kind = |at: usize| match text.name(at).as_str() {
            "tool_data" => Some(true),
            "base_data" => Some(false),
            _ => None,
        };
        let number = |at: usize| self.element(line.file, at).map(|(number, _)| number);
        let mut out = Vec::new();
        for at in self.given(line).into_iter().flatten() {
            out.extend(kind(at).map(|is_tool| (is_tool, number(at))));
        }
        let is_computed = text.is(line.from + 1, b'[') && number(line.from).is_none();
        out.extend(
            kind(line.from)
                .filter(|_| is_computed)
                .map(|is_tool| (is_tool, None)),
        );
        out
    }

    /// Returns the keys of what a line changes by a routine or a computed number, with the reason why they are not known.
    pub(super) fn given_keys(
        &self,
        line: Line,
        numbered: &BTreeMap<(bool, u32), usize>,
    ) -> Vec<(usize, Named)> {
        let text = self.texts[line.file];
        let mut keys = Vec::new();
        for at in self.given(line).into_iter().flatten() {
            match text.name(at).as_str() {
                "$tool" => keys.push(TOOL),
                "$base" => keys.push(BASE),
                "$load" => keys.push(LOAD),
                _ => {}
            }
        }
        for (is_tool, number) in self.given_numbered(line) {
            let is_it = |key: &(bool, u32)| key.0 == is_tool && number.is_none_or(|n| n == key.1);
            let all = numbered.iter().filter(|(key, _)| is_it(key));
            keys.extend(all.map(|(_, key)| *key));
        }
        let at = self.program.line_of(self.location(line.file, line.from));
        let value = Named::Unknown(format!("it is changed at {at}"));
        keys.into_iter().map(|key| (key, value.clone())).collect()
    }
}
