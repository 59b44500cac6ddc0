//! Reads ABB RAPID: `robtarget` and `jointtarget` data, and targets that are written in their moves.
//!
//! Tool and work object of a move come from the program, with what the code has assigned to them before, from files beside
//! it or from a frame file. Computed targets, external axes, displacements and tools that the robot does not hold are left
//! as they are. ("RAPID Instructions, Functions and Data types", 3HAC050917.)

mod changes;
mod data;
mod external;
mod instructions;
mod motion;
mod names;
mod others;
mod statements;
mod states;
mod steps;
mod syntax;

use std::collections::{HashMap, HashSet};

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{Location, Program};
use crate::robot_programs::correction::rapid::data::{FrameData, Read, target};
use crate::robot_programs::correction::rapid::names::{Change, Names};
use crate::robot_programs::correction::rapid::statements::{
    Routine, Statement, is_instruction, statements,
};
use crate::robot_programs::correction::rapid::states::{Other, States};
use crate::robot_programs::correction::rapid::syntax::{list_starts, stays};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, Value, tokens};
use crate::robot_programs::correction::unfound;

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
    let texts = Text::of_files(&copies, &tokens);
    let mut reader = Reader {
        program: Program::new("ABB RAPID", Language::Rapid.dialect(), sources),
        texts,
        given: frames,
        named: Names::default(),
        loads: Names::default(),
        frames: Names::default(),
        routines: Vec::new(),
        by_name: HashMap::new(),
        others: Vec::new(),
        external: None,
        changed_frames: HashSet::new(),
        contradictions: HashMap::new(),
    };
    let mut all = Vec::new();
    for text in &reader.texts {
        let (found, routines) = statements(text);
        all.extend(found);
        reader.routines.extend(routines);
    }
    reader.note_routines();
    reader.external = reader.external_axes(&all);
    for statement in &all {
        reader.declare(statement);
    }
    reader.add_given_frames();
    reader.note_changed_parameters(&all);
    reader.changed_frames = reader.all_changed_frames(&all);
    for statement in &all {
        reader.note_change(statement);
    }
    let unfound = reader.unfound(&all);
    unfound::note(&mut reader.program, unfound);
    let states = reader.states(&all);
    reader.run(&all, &states)?;
    reader.leave_shared(&all);
    Ok(reader.program)
}

/// Indices of the targets of a name, `None` for those that are left; an array has several. Or the reason why it has none.
type Points = Result<Vec<Option<usize>>, String>;

struct Reader<'a> {
    program: Program,
    texts: Vec<Text<'a>>,
    given: &'a FrameFile,
    named: Names<Points>,
    /// Masses of loads in kg; `None` for those that are not known, or that the program changes.
    loads: Names<Option<f64>>,
    frames: Names<FrameData>,
    routines: Vec<Routine>,
    /// Indices of the routines of each name.
    by_name: HashMap<String, Vec<usize>>,
    /// Moves besides those that are corrected.
    others: Vec<Other>,
    /// A line that moves an external axis from zero.
    external: Option<String>,
    /// Tools and work objects that any statement changes, by name and index.
    changed_frames: HashSet<(String, usize)>,
    /// Tools and work objects that two files declare differently, neither of which is corrected.
    contradictions: HashMap<String, (Location, Location)>,
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
            let reason = "it has no value where it is declared";
            if let Some(frame) =
                FrameData::unknown(&kind, reason).filter(|_| text.name(at) == "var")
            {
                self.frames.add(&name, s.file, s.routine, is_local, frame);
            } else if matches!(kind.as_str(), "robtarget" | "jointtarget") {
                let reason = format!("its target {name} is computed");
                self.named
                    .add(&name, s.file, s.routine, is_local, Err(reason));
            }
            return;
        };
        let value = text.value(equals + 2, s.end);
        match kind.as_str() {
            "robtarget" | "jointtarget" if !text.source.is_corrected => {
                let reason = format!("its target {name} is in a file that is not corrected");
                self.named
                    .add(&name, s.file, s.routine, is_local, Err(reason));
            }
            "robtarget" | "jointtarget" => {
                let mut indices = Vec::new();
                let starts =
                    list_starts(&text, equals + 2, s.end, usize::from(text.is(at + 3, b'{')));
                for (from, end) in starts {
                    let location = self.location(s, from);
                    let index = match self.read_target(&text.value(from, end), location) {
                        Read::Target(found) => {
                            self.program.targets.push(*found);
                            Ok(self.program.targets.len() - 1)
                        }
                        Read::Left(reason) => Err(reason),
                        Read::Nothing => Err("a part of it is computed".to_owned()),
                    };
                    if let Err(reason) = &index {
                        self.program.leave(location, reason.clone());
                    }
                    indices.push(index.ok());
                }
                self.named
                    .add(&name, s.file, s.routine, is_local, Ok(indices));
            }
            "loaddata" => {
                let mass = match &value {
                    Value::List(parts) => parts.first().and_then(Value::number),
                    _ => None,
                };
                self.loads.add(&name, s.file, s.routine, is_local, mass);
            }
            "tooldata" | "wobjdata" => {
                let found = match kind.as_str() {
                    "tooldata" => FrameData::tool(&value),
                    _ => FrameData::object(&value),
                };
                if let Some(found) = found {
                    if !is_local && s.routine == 0 {
                        self.note_contradiction(&name, &found, self.location(s, at));
                    }
                    self.frames.add(&name, s.file, s.routine, is_local, found);
                }
            }
            _ => {}
        }
    }

    /// Returns name, component and first token of the value, if a statement is an assignment.
    fn assignment(&self, s: &Statement) -> Option<(String, String, usize)> {
        let text = self.texts[s.file];
        if text.at(s.from)?.kind != Kind::Name {
            return None;
        }
        // Indices and components stand between the name and the mark: p{2}.trans.x:=5
        let mut component = Vec::new();
        let mut at = s.from + 1;
        loop {
            if text.is(at, b'{') {
                at = text.find(at + 1, s.end, b"}") + 1;
            } else if text.is(at, b'.') {
                component.push(text.name(at + 1));
                at += 2;
            } else {
                break;
            }
        }
        let is_assignment = text.is(at, b':') && text.is(at + 1, b'=');
        is_assignment.then(|| (text.name(s.from), component.join("."), at + 2))
    }

    /// Notes names of the routines, and their parameters: these hide data of the module.
    fn note_routines(&mut self) {
        for (index, routine) in self.routines.iter().enumerate() {
            let all = self.by_name.entry(routine.name.clone()).or_default();
            all.push(index);
            let (file, number) = (routine.file, routine.number);
            for p in &routine.parameters {
                let reason = "it is a parameter of its routine";
                if let Some(frame) = FrameData::unknown(&p.kind, reason) {
                    self.frames.add(&p.name, file, number, true, frame);
                } else if matches!(p.kind.as_str(), "robtarget" | "jointtarget") {
                    let reason = format!("its target {} is a parameter of its routine", p.name);
                    self.named.add(&p.name, file, number, true, Err(reason));
                } else if p.kind == "loaddata" {
                    self.loads.add(&p.name, file, number, true, None);
                }
            }
        }
    }

    /// Adds the tools and work objects of the frame file, which the program may change like its own.
    fn add_given_frames(&mut self) {
        // No file of the program has this number.
        let file = self.texts.len();
        for (name, tool) in self.given.tools() {
            let tool = FrameData::Tool {
                is_held: true,
                pose: Ok(tool.pose),
                mass: tool.payload_kg,
            };
            self.frames.add(name, file, 0, false, tool);
        }
        for (name, base) in self.given.bases() {
            let object = FrameData::Object {
                is_held: false,
                is_moved: false,
                user: Ok(base.pose),
                object: Ok(Pose::identity()),
            };
            self.frames.add(name, file, 0, false, object);
        }
    }

    /// Notes that files which are only read declare a tool or work object differently.
    fn note_contradiction(&mut self, name: &str, new: &FrameData, at: Location) {
        let is_read = |file: usize| !self.texts[file].source.is_corrected;
        let mut others = self.frames.seen(name);
        let other = others.find(|(file, old)| is_read(*file) && *file != at.file && *old != new);
        if let Some((file, _)) = other.filter(|_| is_read(at.file)) {
            let text = self.texts[file];
            let is_kind = |at: usize| matches!(text.name(at).as_str(), "tooldata" | "wobjdata");
            let mut tokens = 1..text.tokens.len();
            let first = tokens.find(|at| text.name(*at) == name && is_kind(at - 1));
            let at_first = text.byte(first.unwrap_or(0));
            let first = Location { file, at: at_first };
            let key = name.to_owned();
            self.contradictions.entry(key).or_insert((first, at));
        }
    }

    /// Returns the error for a tool or work object that a move takes from files which declare it differently.
    fn contradiction(&self, name: &str, s: &Statement) -> Result<(), InputError> {
        let file = self.frames.file_of(name, s.file, s.routine);
        let is_read = file.and_then(|file| self.texts.get(file));
        let is_read = is_read.is_some_and(|text| !text.source.is_corrected);
        let Some((first, other)) = self.contradictions.get(name).filter(|_| is_read) else {
            return Ok(());
        };
        let first = self.program.line_of(*first);
        Err(self.program.sources[other.file]
            .error(
                other.at,
                format!("another {name} than at {first}"),
                "the same value in all files of --with",
            )
            .with_help("give the files of one task of one controller alone"))
    }

    /// Returns where the values of a tool or work object come from.
    fn origin(&self, name: &str, s: &Statement) -> String {
        let file = self.frames.file_of(name, s.file, s.routine);
        match file.and_then(|file| self.program.sources.get(file)) {
            Some(source) if source.is_corrected => "the program".to_owned(),
            Some(source) => source.path.display().to_string(),
            None => self.given.origin(),
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

    /// Leaves the targets that a statement changes as they are.
    fn note_change(&mut self, s: &Statement) {
        let assigned = self.assignment(s).map(|(name, ..)| Change::of(name, true));
        for change in self.changes(s).into_iter().chain(assigned) {
            for (name, index) in self.loads.changed(&change, s.file, s.routine) {
                if let Some(mass) = self.loads.at_mut(&name, index) {
                    *mass = None;
                }
            }
            let line = self.program.line_of(self.location(s, s.from));
            let verb = match change.is_certain {
                true => "changes",
                false => "may change",
            };
            let changed = self.named.changed(&change, s.file, s.routine);
            let points = |(name, index): (String, usize)| self.named.at(&name, index);
            let points = changed.into_iter().filter_map(points).flatten();
            for target in points.flatten().copied().flatten() {
                let location = self.program.targets[target].location;
                self.program
                    .leave(location, format!("the program {verb} it at {line}"));
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
            self.note_others(s, states, *step);
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
            "gripload" if matches!(self.grip_load(s), Some(None)) => {
                let line = self.program.line_of(self.location(s, s.from));
                self.program.remarks.push(format!(
                    "{line}: GripLoad adds a load, which is not counted: give the sum as --payload-kg"
                ));
            }
            "const" | "pers" | "var" | "local" | "task" => {}
            _ if is_motion => self.motion(s, &name, state)?,
            _ if self.assignment(s).is_some() => {}
            _ => self.leave_literals(s, "it is used in an instruction that is not corrected"),
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
