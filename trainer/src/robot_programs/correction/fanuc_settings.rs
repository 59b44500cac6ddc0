//! What a Fanuc listing sets for its motions besides their positions: frames, payloads, sensors, and a conveyor.

use std::collections::BTreeMap;

use crate::robot_programs::correction::fanuc_numbers::instructions;
use crate::robot_programs::correction::program::{Location, Program};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::Text;

/// Returns whether the instructions set other payloads than one before all motions: `PAYLOAD[2]`. Which mass a number stands
/// for is in the controller, and what one run of the listing sets holds when the next one begins.
pub fn has_payloads(text: &Text<'_>, program: &mut Program) -> bool {
    let is_set = |at: &usize| text.name(*at) == "payload" && text.is(at + 1, b'[');
    let set: Vec<usize> = (0..text.tokens.len()).filter(is_set).collect();
    let Some(first) = set.first() else {
        return false;
    };
    let is_motion = |at: usize| {
        matches!(text.name(at).as_str(), "j" | "l" | "c" | "a")
            && matches!(text.name(at + 1).as_str(), "p" | "pr")
            && text.is(at + 2, b'[')
    };
    let is_same = |at: &usize| {
        let close = |at: usize| text.find(at + 2, text.tokens.len(), b"]");
        let shown = |at: usize| {
            (at..close(at))
                .map(|at| text.spelling(at))
                .collect::<String>()
        };
        text.number(at + 2).is_some() && shown(*at) == shown(*first)
    };
    if set.iter().all(is_same) && !(0..*first).any(is_motion) {
        return false;
    }
    note_payload(text, *first, program);
    true
}

/// Returns whether a listing that is called sets a payload.
pub fn sets_payload(text: &Text<'_>, program: &mut Program) -> bool {
    let mut all = 0..text.tokens.len();
    let set = all.find(|at| text.name(*at) == "payload" && text.is(at + 1, b'['));
    if let Some(at) = set {
        note_payload(text, at, program);
    }
    set.is_some()
}

fn note_payload(text: &Text<'_>, at: usize, program: &mut Program) {
    let line = program.line_of(Location {
        file: text.file,
        at: text.byte(at),
    });
    program.remarks.push(format!(
        "{line}: PAYLOAD selects a mass that is stored in the controller: state it with --payload-kg"
    ));
}

/// Returns the tools and user frames that the instructions set, by number, each with the line: `UFRAME[2]=PR[1]`,
/// `$MNUTOOL[1,3]=PR[2]`. No number is any number.
pub fn changed_frames(
    text: &Text<'_>,
    program: &Program,
) -> BTreeMap<(bool, Option<String>), String> {
    let mut out = BTreeMap::new();
    for at in 0..text.tokens.len() {
        let name = text.name(at);
        let (is_tool, is_variable) = match name.as_str() {
            "uframe" | "utool" => (name == "utool", false),
            "mnuframe" | "mnutool" if at > 0 && text.is(at - 1, b'$') => (name == "mnutool", true),
            _ => continue,
        };
        if !text.is(at + 1, b'[') {
            continue;
        }
        let close = text.find(at + 2, text.tokens.len(), b"]");
        if !(text.is(close + 1, b'=') || is_variable && text.is(close + 1, b'.')) {
            continue;
        }
        // A variable has the number of the group first.
        let indices = text.arguments(at + 2, close);
        let value = |(from, end): (usize, usize)| {
            let number = text.number(from).filter(|_| end == from + 1);
            number.map(|n| n.value)
        };
        let group = indices.first().copied().and_then(value);
        if is_variable && group.is_some_and(|group| group != 1.0) {
            continue;
        }
        let number = indices.get(usize::from(is_variable)).copied();
        let number = number.and_then(value).map(|n| n.to_string());
        let at = text.byte(at);
        let line = program.line_of(Location {
            file: text.file,
            at,
        });
        out.entry((is_tool, number)).or_insert(line);
    }
    out
}

/// Returns the reason why the positions are none of the arm alone: the listing tracks a conveyor. Its header ends at a byte.
pub fn conveyor(source: &Source, header_end: usize) -> Option<String> {
    let header = String::from_utf8_lossy(&source.bytes[..header_end]).to_ascii_uppercase();
    let name = "LINE_TRACK_SCHEDULE_NUMBER";
    let value = |line: &str| {
        let (_, value) = line.trim().strip_prefix(name)?.split_once(':')?;
        Some(value.trim().trim_end_matches(';').trim().to_owned())
    };
    // Schedule 0 tracks nothing.
    let schedule = header
        .lines()
        .find_map(value)
        .filter(|value| value != "0")?;
    Some(format!(
        "the listing follows a conveyor ({name} {schedule})"
    ))
}

/// Sensors that shift motions between two instructions.
#[derive(Clone, Debug, Default)]
pub struct Sensors {
    /// Sensors that are on, each with the line that switches it on.
    on: BTreeMap<&'static str, String>,
    /// Whether the listing has labels: jumps may go round any instruction, so that sensors stay on.
    has_labels: bool,
}

impl Sensors {
    /// Returns what is on where the instructions begin.
    pub fn new(text: &Text<'_>, program: &Program) -> Self {
        let mut out = Self::default();
        let all = 0..text.tokens.len();
        let is_label = |at: usize| text.name(at) == "lbl" && text.is(at + 1, b'[');
        if all.clone().any(is_label) {
            for at in all.filter(|at| sensor(text, *at).is_some_and(|(_, is_on)| is_on)) {
                out.note(text, at, program);
            }
            out.has_labels = true;
        }
        out
    }

    /// Notes the sensors that a called listing leaves on.
    pub fn note_called(&mut self, text: &Text<'_>, program: &Program) {
        let mut own = Self::new(text, program);
        for (start, _) in instructions(text) {
            own.note(text, start, program);
        }
        self.on.extend(own.on);
    }

    /// Notes the sensor that an instruction switches on or off.
    pub fn note(&mut self, text: &Text<'_>, start: usize, program: &Program) {
        let Some((sensor, is_on)) = sensor(text, start).filter(|_| !self.has_labels) else {
            return;
        };
        if is_on {
            let at = text.byte(start);
            let line = program.line_of(Location {
                file: text.file,
                at,
            });
            self.on.entry(sensor).or_insert(line);
        } else {
            self.on.remove(sensor);
        }
    }

    /// Returns the reason why a motion here does not end at its position.
    pub fn reason(&self) -> Option<String> {
        let (sensor, line) = self.on.first_key_value()?;
        Some(format!("{sensor} at {line} shifts its end"))
    }
}

/// Returns the sensor of an instruction, and whether it switches the sensor on.
fn sensor(text: &Text<'_>, start: usize) -> Option<(&'static str, bool)> {
    let (first, second) = (text.name(start), text.name(start + 1));
    let (sensor, next) = match (first.as_str(), second.as_str()) {
        ("touch", "offset") => ("Touch Offset", start + 2),
        ("mp", "offset") => ("MP Offset", start + 2),
        ("track", _) => ("Track", start + 1),
        _ => return None,
    };
    Some((sensor, text.name(next) != "end"))
}
