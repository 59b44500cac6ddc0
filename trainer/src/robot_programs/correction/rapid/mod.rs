//! Reads ABB RAPID: `robtarget` and `jointtarget` data, and targets that are written in their moves.
//!
//! Tool and work object of a move come from the program, with what the code has assigned to them before, from files beside
//! it or from a frame file. Computed targets, external axes, displacements and tools that the robot does not hold are left
//! as they are. ("RAPID Instructions, Functions and Data types", 3HAC050917.)

mod data;
mod motion;
mod statements;
mod syntax;

use std::collections::HashMap;

use poegp_calibration::input_error::InputError;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{Location, Program};
use crate::robot_programs::correction::rapid::data::{FrameData, Names, Read, target};
use crate::robot_programs::correction::rapid::statements::{
    Routine, Statement, is_instruction, statements,
};
use crate::robot_programs::correction::rapid::syntax::{is_equal, list_starts, stays};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, Value, tokens};

const LEXICON: Lexicon = Lexicon {
    comment: b'!',
    quotes: b"\"",
    in_names: b"",
    has_pairs: false,
};

/// Reads the modules of one program.
///
/// # Errors
/// [`InputError`] for a tool or work object that is nowhere.
pub fn read(sources: Vec<Source>, frames: &FrameFile) -> Result<Program, InputError> {
    let tokens: Vec<Vec<Token>> = sources
        .iter()
        .map(|source| {
            let mut all = tokens(&source.bytes, &LEXICON);
            all.retain(|token| token.kind != Kind::LineEnd);
            all
        })
        .collect();
    let copies = sources.clone();
    let texts: Vec<Text<'_>> = copies
        .iter()
        .zip(&tokens)
        .enumerate()
        .map(|(file, (source, tokens))| Text {
            file,
            source,
            tokens,
        })
        .collect();
    let mut reader = Reader {
        program: Program::new("ABB RAPID", Language::Rapid.dialect(), sources),
        texts,
        given: frames,
        named: Names::default(),
        frames: Names::default(),
        assigned: Vec::new(),
        routines: HashMap::new(),
    };
    let mut all = Vec::new();
    for text in &reader.texts {
        let (found, routines) = statements(text);
        all.extend(found);
        for routine in routines {
            reader
                .routines
                .entry(routine.name.clone())
                .or_insert(routine);
        }
    }
    for statement in &all {
        reader.declare(statement);
    }
    for statement in &all {
        reader.note_assignment(statement);
    }
    reader.run(&all)?;
    Ok(reader.program)
}

/// An assignment of the code to a tool or work object.
#[derive(Clone, Debug)]
struct Assignment {
    name: String,
    component: String,
    value: Value,
    file: usize,
    routine: usize,
    at: usize,
    is_conditional: bool,
}

struct Reader<'a> {
    program: Program,
    texts: Vec<Text<'a>>,
    given: &'a FrameFile,
    /// Indices of the targets of each name; an array has several.
    named: Names<Vec<usize>>,
    frames: Names<FrameData>,
    assigned: Vec<Assignment>,
    routines: HashMap<String, Routine>,
}

/// State of the program at a statement.
struct State {
    frames: Names<FrameData>,
    /// Assignments under a condition, with the blocks in which alone they hold.
    conditional: Vec<(Vec<usize>, Assignment)>,
    is_displaced: bool,
    /// Whether configurations are monitored: in joint moves, and in straight moves.
    is_monitored: [bool; 2],
    /// Index of the previous move and the conditions around it, as long as nothing else may have moved the arm since.
    before: Option<(usize, Vec<usize>)>,
}

impl<'a> Reader<'a> {
    fn location(&self, s: &Statement, token: usize) -> Location {
        Location {
            file: s.file,
            at: self.texts[s.file].byte(token),
        }
    }

    /// Notes the data that a statement declares.
    fn declare(&mut self, s: &Statement) {
        let text = self.texts[s.file];
        let mut at = s.from;
        while matches!(text.name(at).as_str(), "local" | "task") {
            at += 1;
        }
        if !matches!(text.name(at).as_str(), "const" | "pers" | "var") {
            return;
        }
        let (kind, name) = (text.name(at + 1), text.name(at + 2));
        let equals = (at + 3..s.end).find(|i| text.is(*i, b':') && text.is(i + 1, b'='));
        let Some(equals) = equals else {
            return;
        };
        let value = text.value(equals + 2, s.end);
        match kind.as_str() {
            "robtarget" | "jointtarget" => {
                let mut indices = Vec::new();
                let starts =
                    list_starts(&text, equals + 2, s.end, usize::from(text.is(at + 3, b'{')));
                for (from, end) in starts {
                    let location = self.location(s, from);
                    match target(&text.value(from, end), location) {
                        Read::Target(found) if text.source.is_corrected => {
                            indices.push(self.program.targets.len());
                            self.program.targets.push(*found);
                        }
                        Read::Left(reason) => self.program.leave(location, reason),
                        Read::Nothing => self.program.leave(location, "a part of it is computed"),
                        Read::Target(_) => {}
                    }
                }
                self.named.add(&name, s.file, s.routine, indices);
            }
            "tooldata" | "wobjdata" => {
                let found = match kind.as_str() {
                    "tooldata" => FrameData::tool(&value),
                    _ => FrameData::object(&value),
                };
                if let Some(found) = found {
                    self.frames.add(&name, s.file, s.routine, found);
                }
            }
            _ => {}
        }
    }

    /// Returns name, component and first token of the value, if a statement is an assignment.
    fn assignment(&self, s: &Statement) -> Option<(String, String, usize)> {
        let text = self.texts[s.file];
        let equals = text.find(s.from, s.end, b":");
        if !text.is(equals + 1, b'=') || text.at(s.from)?.kind != Kind::Name {
            return None;
        }
        if matches!(
            text.name(s.from).as_str(),
            "const" | "pers" | "var" | "local" | "task"
        ) {
            return None;
        }
        let mut component = Vec::new();
        let mut at = s.from + 1;
        while text.is(at, b'.') {
            component.push(text.name(at + 1));
            at += 2;
        }
        Some((text.name(s.from), component.join("."), equals + 2))
    }

    fn note_assignment(&mut self, s: &Statement) {
        let Some((name, component, from)) = self.assignment(s) else {
            return;
        };
        let text = self.texts[s.file];
        if self.frames.find(&name, s.file, s.routine).is_some() {
            self.assigned.push(Assignment {
                name,
                component,
                value: text.value(from, s.end),
                file: s.file,
                routine: s.routine,
                at: text.byte(s.from),
                is_conditional: !s.blocks.is_empty(),
            });
        } else if let Some(indices) = self.named.find(&name, s.file, s.routine) {
            let line = self.program.line_of(self.location(s, s.from));
            for index in indices.clone() {
                let location = self.program.targets[index].location;
                self.program
                    .leave(location, format!("the program changes it at {line}"));
            }
        }
    }

    /// Returns tools and work objects at the beginning of a routine: as declared, or as the routines set them if all set the
    /// same value.
    fn at_routine(&self, file: usize, routine: usize) -> Names<FrameData> {
        let mut frames = self.frames.clone();
        for (i, first) in self.assigned.iter().enumerate() {
            let same = |a: &&Assignment| a.name == first.name && a.component == first.component;
            if self.assigned[..i].iter().any(|a| same(&a)) {
                continue;
            }
            let Some(data) = frames.find_mut(&first.name, file, routine) else {
                continue;
            };
            let others = self.assigned.iter().filter(same);
            let is_one = others
                .clone()
                .all(|a| is_equal(&a.value, &first.value) && !a.is_conditional);
            let line = self.program.line_of(Location {
                file: first.file,
                at: first.at,
            });
            match is_one {
                true => data.assign(&first.component, &first.value, &line),
                false => data.assign(
                    &first.component,
                    &Value::Computed,
                    &format!("{line} and elsewhere"),
                ),
            }
        }
        frames
    }

    fn run(&mut self, all: &[Statement]) -> Result<(), InputError> {
        let mut of = None;
        let mut state = State {
            frames: Names::default(),
            conditional: Vec::new(),
            is_displaced: false,
            is_monitored: [true; 2],
            before: None,
        };
        for s in all {
            if of != Some((s.file, s.routine)) {
                state.frames = self.at_routine(s.file, s.routine);
                state.conditional.clear();
                state.is_displaced = false;
                state.before = None;
                of = Some((s.file, s.routine));
            }
            if self.texts[s.file].source.is_corrected {
                self.end_conditions(s, &mut state);
                self.statement(s, &mut state)?;
            }
        }
        Ok(())
    }

    /// Marks as unknown, behind a condition, what was assigned under it.
    fn end_conditions(&self, s: &Statement, state: &mut State) {
        let (inside, behind): (Vec<_>, Vec<_>) = std::mem::take(&mut state.conditional)
            .into_iter()
            .partition(|(blocks, _)| s.blocks.starts_with(blocks));
        state.conditional = inside;
        for (_, a) in behind {
            if let Some(data) = state.frames.find_mut(&a.name, s.file, s.routine) {
                let line = self.program.line_of(Location {
                    file: a.file,
                    at: a.at,
                });
                data.assign(
                    &a.component,
                    &Value::Computed,
                    &format!("{line}, under a condition"),
                );
            }
        }
    }

    fn assign(&self, state: &mut State, a: &Assignment, s: &Statement) {
        if let Some(data) = state.frames.find_mut(&a.name, s.file, s.routine) {
            let line = self.program.line_of(Location {
                file: a.file,
                at: a.at,
            });
            data.assign(&a.component, &a.value, &line);
            if !s.blocks.is_empty() {
                state.conditional.push((s.blocks.clone(), a.clone()));
            }
        }
    }

    fn statement(&mut self, s: &Statement, state: &mut State) -> Result<(), InputError> {
        let text = self.texts[s.file];
        let name = text.name(s.from);
        let at = text.byte(s.from);
        let is_same = state
            .before
            .as_ref()
            .is_some_and(|(_, blocks)| *blocks == s.blocks);
        if !is_same || !(stays(&name) || is_instruction(&name)) {
            state.before = None;
        }
        if let Some(a) = self
            .assigned
            .iter()
            .find(|a| a.file == s.file && a.at == at)
            .cloned()
        {
            self.assign(state, &a, s);
            return Ok(());
        }
        match name.as_str() {
            "confl" | "confj" => {
                let is_on = (s.from..s.end).any(|i| text.name(i) == "on");
                state.is_monitored[usize::from(name == "confl")] = is_on;
            }
            "pdispon" | "pdispset" => state.is_displaced = true,
            "pdispoff" => state.is_displaced = false,
            "gripload" if text.name(s.from + 1) != "load0" => {
                let line = self.program.line_of(self.location(s, s.from));
                self.program.remarks.push(format!(
                    "{line}: GripLoad adds a load, which is not counted: give the sum as --payload-kg"
                ));
            }
            "const" | "pers" | "var" | "local" | "task" => {}
            _ if is_instruction(&name) => self.motion(s, &name, state)?,
            _ => {
                if let Some(routine) = self.routines.get(&name).cloned() {
                    let by =
                        |a: &&Assignment| a.file == routine.file && a.routine == routine.number;
                    for a in self.assigned.iter().filter(by).cloned().collect::<Vec<_>>() {
                        self.assign(state, &a, s);
                    }
                }
                self.leave_literals(s, "it stands in an instruction that is not corrected");
            }
        }
        Ok(())
    }

    /// Leaves every target that is written in a statement as it is, for a reason.
    fn leave_literals(&mut self, s: &Statement, reason: &str) {
        let text = self.texts[s.file];
        for at in s.from..s.end {
            if !text.is(at, b'[') || !text.is(at + 1, b'[') {
                continue;
            }
            let end = (text.find(at + 1, s.end, b"]") + 1).min(s.end);
            let location = self.location(s, at);
            if !matches!(target(&text.value(at, end), location), Read::Nothing) {
                self.program.leave(location, reason);
            }
        }
    }
}
