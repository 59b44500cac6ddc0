//! What a statement of RAPID may change besides the left side of an assignment: data that it gives to routines and
//! instructions.
//!
//! A routine of the files changes what it assigns, or gives to another one that changes it. Of instructions and functions
//! that are in none of the files, those of [`READING`] and [`PROCESSES`] leave their arguments as they are; any other may
//! change them.

use std::collections::HashMap;

use crate::robot_programs::correction::flow::Step;
use crate::robot_programs::correction::rapid::Reader;
use crate::robot_programs::correction::rapid::names::Change;
use crate::robot_programs::correction::rapid::others::PROCESSES;
use crate::robot_programs::correction::rapid::statements::{Statement, is_instruction};
use crate::robot_programs::correction::rapid::syntax::{Piece, pieces, shape};
use crate::robot_programs::correction::tokens::{Kind, Text};

/// Instructions and functions of the controller that get points, tools, frames or loads, or their numbers, and leave them as
/// they are.
pub(super) const READING: &[&str] = &[
    // Motions besides those that are corrected, displacements, loads and areas.
    "moveextj",
    "triggjios",
    "trigglios",
    "eoffson",
    "eoffsset",
    "gripload",
    "mechunitload",
    "pdispon",
    "pdispset",
    "setsysdata",
    "wzboxdef",
    "wzcyldef",
    "wzhomejointdef",
    "wzlimjointdef",
    "wzsphdef",
    // Output, waiting and settings.
    "accset",
    "corrwrite",
    "errlog",
    "errwrite",
    "pathacclim",
    "setao",
    "setdo",
    "setgo",
    "socketsend",
    "tpwrite",
    "uimsgbox",
    "velset",
    "waittime",
    "waituntil",
    "worldacclim",
    "write",
    "writeanybin",
    "writebin",
    "writestrbin",
    // Functions of points and frames.
    "calcrobt",
    "calcrotaxframez",
    "calcrotaxisframe",
    "cjointt",
    "cpos",
    "crobt",
    "ctool",
    "cwobj",
    "defaccframe",
    "defdframe",
    "defframe",
    "dim",
    "distance",
    "dotprod",
    "euler",
    "eulerzyx",
    "mirpos",
    "norient",
    "offs",
    "orientzyx",
    "orobt",
    "paridposvalid",
    "poseinv",
    "posemult",
    "posevect",
    "reltool",
    "vectmagn",
    // Functions of numbers and texts.
    "abs",
    "absdnum",
    "acos",
    "asin",
    "atan",
    "atan2",
    "cos",
    "dnumtonum",
    "dnumtostr",
    "exp",
    "ispers",
    "isvar",
    "numtodnum",
    "numtostr",
    "pow",
    "present",
    "round",
    "rounddnum",
    "sin",
    "sqrt",
    "tan",
    "trunc",
    "type",
    "valtostr",
];

/// Words after which a bracket encloses an expression.
pub(super) const KEYWORDS: [&str; 20] = [
    "and", "case", "connect", "default", "div", "do", "else", "elseif", "exit", "for", "from",
    "goto", "if", "mod", "not", "or", "raise", "return", "test", "while",
];

/// Who gets the data of an argument.
enum Receiver {
    /// A parameter of a routine, by the indices of both.
    Parameter(usize, usize),
    /// An instruction or function that is in none of the files, or one whose name is computed.
    Unknown,
}

impl Reader<'_> {
    /// Notes which parameters the routines change, in further calls too.
    pub(super) fn note_changed_parameters(&mut self, all: &[Statement]) {
        let mut by_number = HashMap::new();
        for (index, routine) in self.routines.iter().enumerate() {
            if routine.parameters.iter().any(|p| p.is_reference) {
                by_number.insert((routine.file, routine.number), index);
            }
        }
        // Parameters that are given to each parameter.
        let mut givers: HashMap<(usize, usize), Vec<(usize, usize)>> = HashMap::new();
        let mut open = Vec::new();
        for s in all {
            let Some(index) = by_number.get(&(s.file, s.routine)).copied() else {
                continue;
            };
            let own = |name: &str| {
                let mut all = self.routines[index].parameters.iter();
                let number = all.position(|p| p.is_reference && p.name == name)?;
                Some((index, number))
            };
            open.extend(self.assignment(s).and_then(|(name, ..)| own(&name)));
            for (receiver, name) in self.given(s) {
                match (own(&name), receiver) {
                    (Some(own), Receiver::Parameter(routine, number)) => {
                        givers.entry((routine, number)).or_default().push(own);
                    }
                    (own, Receiver::Unknown) => open.extend(own),
                    _ => {}
                }
            }
        }
        while let Some((routine, number)) = open.pop() {
            let parameter = &mut self.routines[routine].parameters[number];
            if !std::mem::replace(&mut parameter.is_changed, true) {
                open.extend(givers.remove(&(routine, number)).unwrap_or_default());
            }
        }
    }

    /// Returns the data that a statement may change by the routines and instructions to which it gives them.
    pub(super) fn changes(&self, s: &Statement) -> Vec<Change> {
        let text = self.texts[s.file];
        let word = text.name(s.from);
        let is_own = || self.routine(&word, s.file).is_some();
        // Most statements are moves that call no function.
        let is_move = is_instruction(&word) && shape(&word).is_some();
        if is_move && !(s.from..s.end).any(|at| text.is(at, b'(')) && !is_own() {
            return Vec::new();
        }
        // SearchL gives the point that it finds to its second argument.
        if word.starts_with("search") && !is_own() {
            let given = pieces(&text, s.from + 1, s.end).into_iter();
            let mut found = given.filter(|piece| piece.switch.is_none());
            let found = found.nth(1).map(|piece| text.name(piece.from));
            return found
                .into_iter()
                .map(|name| Change::of(name, true))
                .collect();
        }
        let mut out = Vec::new();
        for (receiver, name) in self.given(s) {
            match receiver {
                Receiver::Parameter(routine, number) => {
                    if self.routines[routine].parameters[number].is_changed {
                        out.push(Change::of(name, true));
                    }
                }
                Receiver::Unknown => out.push(Change::of(name, false)),
            }
        }
        if matches!(word.as_str(), "setdataval" | "setalldataval") && !is_own() {
            let is_written = text.at(s.from + 1).is_some_and(|t| t.kind == Kind::Text)
                && (text.is(s.from + 2, b',') || text.is(s.from + 2, b'\\'));
            let name = text.spelling(s.from + 1).to_lowercase();
            let name = name.trim_matches('"').trim().to_owned();
            out.push(Change {
                name: Some(name).filter(|_| is_written && word == "setdataval"),
                is_anywhere: true,
                is_certain: true,
            });
        }
        out
    }

    /// Returns the names that a statement gives to routines and instructions, each with its receiver. Those that only read
    /// are left out.
    fn given(&self, s: &Statement) -> Vec<(Receiver, String)> {
        let text = self.texts[s.file];
        let mut out = Vec::new();
        let word = text.name(s.from);
        let is_declaration = matches!(
            word.as_str(),
            "const" | "pers" | "var" | "local" | "task" | "alias"
        );
        if is_declaration || matches!(s.step, Step::Label(_) | Step::End) {
            return out;
        }
        // A name that the program computes stands for any routine.
        if text.is(s.from, b'%') {
            let behind = text.find(s.from + 1, s.end, b"%") + 1;
            self.give(&text, None, (behind, s.end), &mut out);
        } else if matches!(s.step, Step::Other)
            && !KEYWORDS.contains(&word.as_str())
            && self.assignment(s).is_none()
        {
            self.give(&text, Some(&word), (s.from + 1, s.end), &mut out);
        }
        let is_call = |at: &usize| {
            let is_name = text.at(*at).is_some_and(|t| t.kind == Kind::Name);
            is_name && text.is(at + 1, b'(')
        };
        for at in (s.from..s.end).filter(is_call) {
            let name = text.name(at);
            if !KEYWORDS.contains(&name.as_str()) {
                let close = text.find(at + 2, s.end, b")");
                self.give(&text, Some(&name), (at + 2, close), &mut out);
            }
        }
        out
    }

    /// Returns the names that a statement gives to parameters of routines, each with the indices of routine and parameter.
    pub(super) fn given_by_value_too(&self, s: &Statement) -> Vec<((usize, usize), String)> {
        let text = self.texts[s.file];
        let is_call = |at: &usize| {
            let is_name = text.at(*at).is_some_and(|t| t.kind == Kind::Name);
            is_name && (*at == s.from && self.assignment(s).is_none() || text.is(at + 1, b'('))
        };
        let mut out = Vec::new();
        for at in (s.from..s.end).filter(is_call) {
            let Some(index) = self.routine(&text.name(at), text.file) else {
                continue;
            };
            let (from, end) = match text.is(at + 1, b'(') {
                true => (at + 2, text.find(at + 2, s.end, b")")),
                false => (at + 1, s.end),
            };
            let mut position = 0;
            for piece in pieces(&text, from, end) {
                let found = self.parameter(index, &piece, position);
                position += usize::from(piece.switch.is_none());
                let name = datum(&text, &piece);
                out.extend(
                    found
                        .zip(name)
                        .map(|(number, name)| ((index, number), name)),
                );
            }
        }
        out
    }

    /// Returns the index of the parameter to which an argument belongs; positional ones are counted.
    fn parameter(&self, routine: usize, piece: &Piece, position: usize) -> Option<usize> {
        let mut all = self.routines[routine].parameters.iter().enumerate();
        let found = match &piece.switch {
            Some(switch) => all.find(|(_, p)| p.is_optional && p.name == *switch),
            None => all.filter(|(_, p)| !p.is_optional).nth(position),
        };
        found.map(|(number, _)| number)
    }

    /// Adds the names that a call gives to what it calls; `None` for a name that the program computes.
    fn give(
        &self,
        text: &Text<'_>,
        called: Option<&str>,
        (from, end): (usize, usize),
        out: &mut Vec<(Receiver, String)>,
    ) {
        let routine = called.and_then(|name| self.routine(name, text.file));
        let is_reading = |name: &str| {
            let is_motion = is_instruction(name) && shape(name).is_some();
            // SearchL changes the point that it finds.
            let is_process = PROCESSES.contains(&name) && !name.starts_with("search");
            is_motion || is_process || READING.contains(&name)
        };
        if routine.is_none() && called.is_some_and(is_reading) {
            return;
        }
        let mut number = 0;
        for piece in pieces(text, from, end) {
            let position = number;
            number += usize::from(piece.switch.is_none());
            let Some(name) = datum(text, &piece) else {
                continue;
            };
            let Some(index) = routine else {
                out.push((Receiver::Unknown, name));
                continue;
            };
            let parameters = &self.routines[index].parameters;
            match self.parameter(index, &piece, position) {
                Some(number) if parameters[number].is_reference => {
                    out.push((Receiver::Parameter(index, number), name));
                }
                Some(_) => {}
                None => out.push((Receiver::Unknown, name)),
            }
        }
    }
}

/// Returns the name of the datum that an argument is, if it is one or a component of one: `p{2}.trans.x`.
fn datum(text: &Text<'_>, piece: &Piece) -> Option<String> {
    let name = Some(text.name(piece.from)).filter(|name| !name.is_empty())?;
    let mut at = piece.from + 1;
    while at < piece.end {
        at = match (text.is(at, b'{'), text.is(at, b'.')) {
            (true, _) => text.find(at + 1, piece.end, b"}") + 1,
            (_, true) => at + 2,
            _ => return None,
        };
    }
    (piece.from < piece.end).then_some(name)
}
