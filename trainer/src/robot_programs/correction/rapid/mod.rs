//! Reads ABB RAPID: `robtarget` and `jointtarget` data, and targets that are written in their moves.
//!
//! Tool and work object of a move come from the program, with what the code has assigned to them before, from files beside
//! it or from a frame file. Computed targets, external axes, displacements and tools that the robot does not hold are left
//! as they are. ("RAPID Instructions, Functions and Data types", 3HAC050917.)

mod data;
mod motion;
mod statements;
mod states;
mod steps;
mod syntax;

use std::collections::HashMap;

use poegp_calibration::input_error::InputError;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{Location, Program};
use crate::robot_programs::correction::rapid::data::{FrameData, Names, Read, target};
use crate::robot_programs::correction::rapid::statements::{
    Parameter, Routine, Statement, is_instruction, statements,
};
use crate::robot_programs::correction::rapid::states::States;
use crate::robot_programs::correction::rapid::syntax::{list_starts, stays};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, tokens};

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
        routines: Vec::new(),
        by_name: HashMap::new(),
    };
    let mut all = Vec::new();
    for text in &reader.texts {
        let (found, routines) = statements(text);
        all.extend(found);
        reader.routines.extend(routines);
    }
    reader.note_routines();
    for statement in &all {
        reader.declare(statement);
    }
    for statement in &all {
        reader.note_changed_parameter(statement);
    }
    for statement in &all {
        reader.note_change(statement);
    }
    let states = reader.states(&all);
    reader.run(&all, &states)?;
    Ok(reader.program)
}

struct Reader<'a> {
    program: Program,
    texts: Vec<Text<'a>>,
    given: &'a FrameFile,
    /// Indices of the targets of each name; an array has several.
    named: Names<Vec<usize>>,
    frames: Names<FrameData>,
    routines: Vec<Routine>,
    /// Indices of the routines of each name.
    by_name: HashMap<String, Vec<usize>>,
}

/// State of the program at a statement.
struct State<'a> {
    states: &'a States,
    /// Index of the statement's step.
    step: usize,
    /// Index of the previous move and the conditions around it, as long as nothing else may have moved the arm since.
    before: Option<(usize, Vec<usize>)>,
}

impl Reader<'_> {
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
        let is_local = text.name(at) == "local";
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
                self.named.add(&name, s.file, s.routine, is_local, indices);
            }
            "tooldata" | "wobjdata" => {
                let found = match kind.as_str() {
                    "tooldata" => FrameData::tool(&value),
                    _ => FrameData::object(&value),
                };
                if let Some(found) = found {
                    self.frames.add(&name, s.file, s.routine, is_local, found);
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

    /// Notes names of the routines, and their parameters: these hide data of the module.
    fn note_routines(&mut self) {
        for (index, routine) in self.routines.iter().enumerate() {
            let all = self.by_name.entry(routine.name.clone()).or_default();
            all.push(index);
            let (file, number) = (routine.file, routine.number);
            for p in &routine.parameters {
                if let Some(frame) = FrameData::parameter(&p.kind) {
                    self.frames.add(&p.name, file, number, true, frame);
                } else if matches!(p.kind.as_str(), "robtarget" | "jointtarget") {
                    self.named.add(&p.name, file, number, true, Vec::new());
                }
            }
        }
    }

    /// Returns the routine to which a name refers in a file.
    fn routine(&self, name: &str, file: usize) -> Option<usize> {
        let all = self.by_name.get(name)?;
        let is_own = |index: &&usize| self.routines[**index].file == file;
        let is_seen = |index: &&usize| !self.routines[**index].is_local;
        let own = all.iter().find(is_own);
        own.or_else(|| all.iter().find(is_seen)).copied()
    }

    /// Notes a routine that assigns to what its caller gives it.
    fn note_changed_parameter(&mut self, s: &Statement) {
        let Some((name, ..)) = self.assignment(s) else {
            return;
        };
        let is_own = |r: &&mut Routine| (r.file, r.number) == (s.file, s.routine);
        if let Some(routine) = self.routines.iter_mut().find(is_own) {
            let is_it = |p: &Parameter| p.is_reference && p.name == name;
            routine.has_changes |= routine.parameters.iter().any(is_it);
        }
    }

    /// Leaves the targets that a statement changes as they are.
    fn note_change(&mut self, s: &Statement) {
        let text = self.texts[s.file];
        let is_search = text.name(s.from).starts_with("search");
        let changed = match self.assignment(s) {
            Some((name, ..)) => vec![name],
            None if is_search => (s.from + 1..s.end).map(|at| text.name(at)).collect(),
            None => self.changed_arguments(s),
        };
        for name in changed {
            let Some(indices) = self.named.find(&name, s.file, s.routine) else {
                continue;
            };
            let line = self.program.line_of(self.location(s, s.from));
            for index in indices.clone() {
                let location = self.program.targets[index].location;
                self.program
                    .leave(location, format!("the program changes it at {line}"));
            }
        }
    }

    fn run(&mut self, all: &[Statement], states: &States) -> Result<(), InputError> {
        let mut of = None;
        let mut state = State {
            states,
            step: 0,
            before: None,
        };
        for (s, step) in all.iter().zip(&states.steps) {
            if of != Some((s.file, s.routine)) {
                state.before = None;
                of = Some((s.file, s.routine));
            }
            if self.texts[s.file].source.is_corrected {
                state.step = *step;
                self.statement(s, &mut state)?;
            }
        }
        Ok(())
    }

    fn statement(&mut self, s: &Statement, state: &mut State<'_>) -> Result<(), InputError> {
        let text = self.texts[s.file];
        let name = text.name(s.from);
        let is_motion = is_instruction(&name) && self.routine(&name, s.file).is_none();
        let is_same = state
            .before
            .as_ref()
            .is_some_and(|(_, blocks)| *blocks == s.blocks);
        if !is_same || !(stays(&name) || is_motion) {
            state.before = None;
        }
        match name.as_str() {
            "gripload" if text.name(s.from + 1) != "load0" => {
                let line = self.program.line_of(self.location(s, s.from));
                self.program.remarks.push(format!(
                    "{line}: GripLoad adds a load, which is not counted: give the sum as --payload-kg"
                ));
            }
            "const" | "pers" | "var" | "local" | "task" => {}
            _ if is_motion => self.motion(s, &name, state)?,
            _ if self.assignment(s).is_some() => {}
            _ => self.leave_literals(s, "it stands in an instruction that is not corrected"),
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
