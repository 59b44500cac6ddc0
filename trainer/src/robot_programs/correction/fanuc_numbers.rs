//! Follows which user frame and tool are in use at each instruction of Fanuc listings: `UFRAME_NUM=2`, `UTOOL_NUM=3`, on
//! every way through labels, conditions, loops and called listings.
//!
//! A motion to a position that was taught in another frame stops with an alarm, or goes somewhere else, as the controller is
//! set up.

use std::collections::HashMap;

use crate::robot_programs::correction::flow::{Flow, Step};
use crate::robot_programs::correction::held::Certain;
use crate::robot_programs::correction::program::{Location, Program};
use crate::robot_programs::correction::tokens::{Kind, Text};

/// Keys of the user frame and the tool in use. `None` is whatever was in use before the listing.
const NAMES: [&str; 2] = ["UFRAME_NUM", "UTOOL_NUM"];

/// What is certain at the instructions of a listing.
pub struct InUse {
    certain: Certain<Option<u32>>,
    /// Step of each instruction, by its first token.
    steps: HashMap<usize, usize>,
}

/// Returns the instructions of a listing: tokens behind the number of the line, up to the semicolon.
pub fn instructions(text: &Text<'_>) -> Vec<(usize, usize)> {
    let end = text.tokens.len();
    let mut out = Vec::new();
    let mut from = 0;
    while from < end {
        let stop = (from..end).find(|at| text.is(*at, b';')).unwrap_or(end);
        // A line begins with its number and a colon.
        let start =
            from + usize::from(text.number(from).is_some()) + usize::from(text.is(from + 1, b':'));
        out.push((start, stop));
        from = stop + 1;
    }
    out
}

/// Returns the tokens of the names that instructions call or start.
pub fn calls(text: &Text<'_>) -> Vec<usize> {
    let is_call = |at: &usize| {
        let is_word = matches!(text.name(at - 1).as_str(), "call" | "run");
        is_word && text.at(*at).is_some_and(|token| token.kind == Kind::Name)
    };
    (1..text.tokens.len()).filter(is_call).collect()
}

/// Returns the name of a listing, which is that of its file, in lower case.
pub fn name_of(text: &Text<'_>) -> String {
    let stem = text.source.path.file_stem().unwrap_or_default();
    stem.to_string_lossy().to_ascii_lowercase()
}

impl InUse {
    /// Follows a listing, which is the first of `texts`, and the others that it calls.
    pub fn new(texts: &[Text<'_>]) -> Self {
        let mut flow = Flow::new();
        for _ in NAMES {
            flow.key(Some(None), false);
        }
        let mut routines = HashMap::new();
        for (index, text) in texts.iter().enumerate().skip(1) {
            debug_assert_eq!(index, text.file);
            routines.insert(name_of(text), flow.routine());
        }
        let mut steps = HashMap::new();
        for text in texts {
            let routine = match text.file {
                0 => 0,
                _ => routines[&name_of(text)],
            };
            for (start, stop) in instructions(text) {
                let location = Location {
                    file: text.file,
                    at: text.byte(start),
                };
                let mut first = None;
                for step in steps_of(text, (start, stop), &routines) {
                    let index = flow.push(routine, step, location);
                    first.get_or_insert(index);
                }
                if let (0, Some(first)) = (text.file, first) {
                    steps.insert(start, first);
                }
            }
        }
        Self {
            certain: flow.certain(),
            steps,
        }
    }

    /// Returns the reason why a position that was taught in a user frame and with a tool is not the end of the motion that
    /// begins at a token.
    pub fn other(&self, start: usize, taught: (&str, &str), program: &Program) -> Option<String> {
        let step = *self.steps.get(&start)?;
        let taught = [("UF", taught.0), ("UT", taught.1)];
        (0..2).find_map(|key| {
            let (kind, number) = taught[key];
            let name = NAMES[key];
            match self.certain.value(step, key, program) {
                Ok(None) => None,
                Ok(Some(used)) => (number.parse() != Ok(used)).then(|| {
                    format!(
                        "{name} is {used} at the motion to it, and it was taught in {kind} {number}"
                    )
                }),
                Err(reason) => Some(format!("{name}: {reason}")),
            }
        })
    }
}

/// Returns the steps of an instruction.
fn steps_of(
    text: &Text<'_>,
    (start, stop): (usize, usize),
    routines: &HashMap<String, usize>,
) -> Vec<Step<Option<u32>>> {
    let word = text.name(start);
    let is_block = stop > start && text.name(stop - 1) == "then";
    // SELECT goes on over lines such as: ELSE,JMP LBL[3]
    let is_alone = stop == start + 1;
    match word.as_str() {
        "if" if is_block => return vec![Step::Branch],
        "else" if is_alone => return vec![Step::Next(true)],
        "endif" | "endfor" => return vec![Step::End],
        "for" => return vec![Step::Loop],
        "end" | "abort" => return vec![Step::Return],
        "lbl" => return vec![Step::Label(label(text, start, stop).unwrap_or_default())],
        _ => {}
    }
    let mut out = vec![Step::Other];
    for at in start..stop {
        let step = match text.name(at).as_str() {
            "lbl" if text.is(at + 1, b'[') => match label(text, at, stop) {
                Some(label) => Step::Jump(label),
                // A computed label is any.
                None => {
                    for label in labels(text) {
                        out.extend([Step::Branch, Step::Jump(label), Step::End]);
                    }
                    continue;
                }
            },
            "call" | "run" => match routines.get(&text.name(at + 1)) {
                Some(routine) => Step::Call(vec![*routine]),
                None => continue,
            },
            name => match set(text, (at, stop), name) {
                Some((key, number)) => Step::Set(key, number.map(Some)),
                None => continue,
            },
        };
        // All but the first word stands behind a condition.
        let is_variable = at == start + 1 && text.is(start, b'$');
        let is_certain = at == start || word == "jmp" || is_variable;
        match is_certain {
            true => out.push(step),
            false => out.extend([Step::Branch, step, Step::End]),
        }
    }
    out
}

/// Returns all labels of a listing.
fn labels(text: &Text<'_>) -> Vec<String> {
    let all = instructions(text).into_iter();
    let of_labels = all.filter(|(start, _)| text.name(*start) == "lbl");
    of_labels
        .filter_map(|(start, stop)| label(text, start, stop))
        .collect()
}

/// Returns the label at a token, unless it is computed.
fn label(text: &Text<'_>, at: usize, stop: usize) -> Option<String> {
    let number = text.number(at + 2)?;
    let is_plain = text.find(at + 2, stop, b"]") == at + 3;
    is_plain.then(|| number.value.to_string())
}

/// Returns the key that an assignment at a token sets, and its number unless it is computed: `UFRAME_NUM[GP1]=2`.
fn set(text: &Text<'_>, (at, stop): (usize, usize), name: &str) -> Option<(usize, Option<u32>)> {
    let key = match name {
        "uframe_num" | "mnuframenum" => 0,
        "utool_num" | "mnutoolnum" => 1,
        _ => return None,
    };
    let equals = match text.is(at + 1, b'[') {
        true => text.find(at + 2, stop, b"]") + 1,
        false => at + 1,
    };
    let number = text.number(equals + 1).filter(|_| equals + 2 == stop);
    let number = number.filter(|n| n.value >= 0.0).map(|n| n.value as u32);
    text.is(equals, b'=').then_some((key, number))
}
