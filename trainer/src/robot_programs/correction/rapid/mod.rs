//! A reader of ABB RAPID: `robtarget` and `jointtarget` data, and targets that stand in their moves.
//!
//! Tool and work object of a move are those of the program, with what the code has assigned to them until then, of files
//! beside it or of a frame file. Computed targets, external axes, displacements and tools that the robot does not hold are
//! left. ("RAPID Instructions, Functions and Data types", 3HAC050917.)

mod data;
mod statements;

use std::collections::HashMap;

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{Frame, Location, Program, Way};
use crate::robot_programs::correction::rapid::data::{FrameData, Names, Read, target};
use crate::robot_programs::correction::rapid::statements::{
    Routine, Statement, is_instruction, statements,
};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, Value, tokens};

const LEXICON: Lexicon = Lexicon {
    comment: b'!',
    quotes: b"\"",
    in_names: b"",
    has_pairs: false,
};

/// Reads modules that belong together.
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

/// What the code assigns to a tool or work object.
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
    /// Indices of the targets of each name, several for an array.
    named: Names<Vec<usize>>,
    frames: Names<FrameData>,
    assigned: Vec<Assignment>,
    routines: HashMap<String, Routine>,
}

/// What holds at a statement.
struct State {
    frames: Names<FrameData>,
    /// Assignments under a condition, which hold there alone.
    conditional: Vec<(Vec<usize>, Assignment)>,
    is_displaced: bool,
    /// Of joint and of straight moves.
    is_monitored: [bool; 2],
}

impl<'a> Reader<'a> {
    fn location(&self, s: &Statement, token: usize) -> Location {
        Location {
            file: s.file,
            at: self.texts[s.file].byte(token),
        }
    }

    /// The data that a statement declares.
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

    /// The assignment that a statement is: name, component, its value's first token.
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

    /// Tools and work objects where a routine begins: as declared, or as any routine sets them if all set the same.
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
        };
        for s in all {
            if of != Some((s.file, s.routine)) {
                state.frames = self.at_routine(s.file, s.routine);
                state.conditional.clear();
                state.is_displaced = false;
                of = Some((s.file, s.routine));
            }
            if self.texts[s.file].source.is_corrected {
                self.end_conditions(s, &mut state);
                self.statement(s, &mut state)?;
            }
        }
        Ok(())
    }

    /// What was assigned under a condition is not known behind it.
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

    /// Names every target that is written out in a statement.
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

    fn motion(&mut self, s: &Statement, name: &str, state: &State) -> Result<(), InputError> {
        let text = self.texts[s.file];
        let Some((way, points, tool_at)) = shape(name) else {
            let location = self.location(s, s.from);
            self.program.leave(
                location,
                format!("{} is not corrected", text.spelling(s.from)),
            );
            return Ok(());
        };
        let (positional, switches) = arguments(&text, s.from + 1, s.end);
        let location = self.location(s, s.from);
        let Some((tool_from, tool_end)) = positional.get(tool_at).copied() else {
            self.program
                .leave(location, "its arguments are not those of its instruction");
            return Ok(());
        };
        let switch = |wanted: &str| {
            switches
                .iter()
                .find(|(name, _)| name == wanted)
                .map(|(_, v)| *v)
        };
        let is_joints = name.contains("absj");
        if switch("corr").is_some() {
            self.program.leave(location, "a sensor corrects its path");
            return Ok(());
        }
        if state.is_displaced && !is_joints {
            self.program.leave(
                location,
                "a program displacement is active (PDispOn, PDispSet)",
            );
            return Ok(());
        }
        let tool = self.tool(s, (tool_from, tool_end), state)?;
        let object = match (switch("wobj"), is_joints) {
            (Some(value), false) => self.object(s, value, state)?,
            _ => Ok((
                "wobj0".to_owned(),
                Pose::identity(),
                "the controller".to_owned(),
            )),
        };
        let (tool, object) = match (tool, object) {
            (Ok(tool), Ok(object)) => (tool, object),
            (Err(reason), _) | (_, Err(reason)) => {
                self.program.leave(location, reason);
                return Ok(());
            }
        };
        let base = Frame {
            name: object.0,
            is_tool: false,
            pose: object.1,
            payload_kg: None,
            origin: object.2,
        };
        let (tool, base) = (self.program.frame(tool), self.program.frame(base));
        let is_monitored = state.is_monitored[usize::from(way != Way::Joints)];
        for (i, point) in positional.iter().take(points).enumerate() {
            let way = if i + 1 < points { Way::Arc } else { way };
            for target in self.targets_of(s, *point) {
                if let Some(configuration) = &mut self.program.targets[target].configuration {
                    configuration.is_monitored = is_monitored;
                }
                self.program.move_to(target, way, tool, base);
            }
        }
        Ok(())
    }

    /// The targets that an argument may be.
    fn targets_of(&mut self, s: &Statement, (from, end): (usize, usize)) -> Vec<usize> {
        let text = self.texts[s.file];
        let location = self.location(s, from);
        if text.is(from, b'[') {
            match target(&text.value(from, end), location) {
                Read::Target(found) => {
                    self.program.targets.push(*found);
                    return vec![self.program.targets.len() - 1];
                }
                Read::Left(reason) => self.program.leave(location, reason),
                Read::Nothing => self.program.leave(location, "a part of it is computed"),
            }
            return Vec::new();
        }
        let name = text.name(from);
        let quoted = text
            .source
            .quoted(&(text.byte(from)..text.byte(end.max(1) - 1) + 1));
        let is_name = end == from + 1;
        let is_element = text.is(from + 1, b'{') && text.find(from + 2, end, b"}") + 1 == end;
        if name.is_empty() || !(is_name || is_element) {
            let shown = if name.is_empty() {
                quoted
            } else {
                format!("{}(…)", text.spelling(from))
            };
            self.program
                .leave(location, format!("its target is computed: {shown}"));
            return Vec::new();
        }
        match self.named.find(&name, s.file, s.routine) {
            Some(all) if all.is_empty() => {
                self.program.leave(
                    location,
                    format!("{name} is not a target that is corrected"),
                );
                Vec::new()
            }
            Some(all) => match text
                .number(from + 2)
                .filter(|_| is_element && end == from + 4)
            {
                Some(number) => all
                    .get(number.value as usize - usize::from(number.value >= 1.0))
                    .copied()
                    .into_iter()
                    .collect(),
                None => all.clone(),
            },
            None => {
                self.program.leave(
                    location,
                    format!("its target {name} is in none of the files"),
                );
                Vec::new()
            }
        }
    }

    /// The tool that an argument is, or why it is none that is known.
    fn tool(
        &self,
        s: &Statement,
        (from, end): (usize, usize),
        state: &State,
    ) -> Result<Result<Frame, String>, InputError> {
        let text = self.texts[s.file];
        let name = text.name(from);
        let frame = |pose, payload_kg, origin: String| Frame {
            name: text.spelling(from),
            is_tool: true,
            pose,
            payload_kg,
            origin,
        };
        if end != from + 1 {
            return Ok(Err("its tool is computed".to_owned()));
        }
        match state.frames.find(&name, s.file, s.routine) {
            Some(FrameData::Tool { is_held: false, .. }) => Ok(Err(format!(
                "{name} stands still, and the robot holds the part"
            ))),
            Some(FrameData::Tool {
                pose: Err(reason), ..
            }) => Ok(Err(format!("tool {name}: {reason}"))),
            Some(FrameData::Tool {
                pose: Ok(pose),
                mass,
                ..
            }) => Ok(Ok(frame(*pose, *mass, "the program".to_owned()))),
            Some(FrameData::Object { .. }) => Ok(Err(format!("{name} is no tool"))),
            None if name == "tool0" => Ok(Ok(frame(
                Pose::identity(),
                Some(0.0),
                "the controller".to_owned(),
            ))),
            None => match self.given.tool(&name) {
                Some(given) => Ok(Ok(frame(given.pose, given.payload_kg, self.given.origin()))),
                None => Err(self.given.unknown(
                    text.source,
                    text.byte(from),
                    "tool",
                    &text.spelling(from),
                    "tooldata",
                )),
            },
        }
    }

    /// The work object that an argument is: name, `base_from_object`, where from.
    #[allow(clippy::type_complexity)]
    fn object(
        &self,
        s: &Statement,
        (from, end): (usize, usize),
        state: &State,
    ) -> Result<Result<(String, Pose<f64>, String), String>, InputError> {
        let text = self.texts[s.file];
        let name = text.name(from);
        if end != from + 1 {
            return Ok(Err("its work object is computed".to_owned()));
        }
        Ok(match state.frames.find(&name, s.file, s.routine) {
            Some(FrameData::Object { is_held: true, .. }) => {
                Err(format!("the robot holds work object {name}"))
            }
            Some(FrameData::Object { is_moved: true, .. }) => {
                Err(format!("a mechanical unit moves work object {name}"))
            }
            Some(
                FrameData::Object {
                    user: Err(reason), ..
                }
                | FrameData::Object {
                    object: Err(reason),
                    ..
                },
            ) => Err(format!("work object {name}: {reason}")),
            Some(FrameData::Object {
                user: Ok(user),
                object: Ok(object),
                ..
            }) => Ok((
                text.spelling(from),
                *user * *object,
                "the program".to_owned(),
            )),
            Some(FrameData::Tool { .. }) => Err(format!("{name} is no work object")),
            None if name == "wobj0" => Ok((name, Pose::identity(), "the controller".to_owned())),
            None => match self.given.base(&name) {
                Some(given) => Ok((text.spelling(from), given.pose, self.given.origin())),
                None => {
                    return Err(self.given.unknown(
                        text.source,
                        text.byte(from),
                        "base",
                        &text.spelling(from),
                        "wobjdata",
                    ));
                }
            },
        })
    }
}

/// How a motion goes, its points, and which argument is its tool.
fn shape(name: &str) -> Option<(Way, usize, usize)> {
    let known = |start: &str, tool: usize| {
        let rest = name.strip_prefix(start)?;
        let kinds = [
            ("absj", Way::Joints, 1),
            ("l", Way::Line, 1),
            ("j", Way::Joints, 1),
            ("c", Way::Arc, 2),
        ];
        kinds.into_iter().find_map(|(kind, way, points)| {
            let suffix = rest.strip_prefix(kind)?;
            let is_known = matches!(suffix, "" | "sync" | "do" | "ao" | "go");
            is_known.then_some((way, points, tool + points - 1))
        })
    };
    known("move", 3).or_else(|| known("trigg", 4))
}

/// Positional arguments, and optional ones with the tokens of their values.
#[allow(clippy::type_complexity)]
fn arguments(
    text: &Text<'_>,
    from: usize,
    end: usize,
) -> (Vec<(usize, usize)>, Vec<(String, (usize, usize))>) {
    let (mut positional, mut switches) = (Vec::new(), Vec::new());
    for (start, stop) in text.arguments(from, end) {
        let mut slash = text.find(start, stop, b"\\");
        if slash > start {
            positional.push((start, slash));
        }
        while slash < stop {
            let next = text.find(slash + 1, stop, b"\\");
            let equals = text.find(slash + 1, next, b":");
            switches.push((text.name(slash + 1), ((equals + 2).min(next), next)));
            slash = next;
        }
    }
    (positional, switches)
}

/// The elements of a list in `depth` dimensions, as tokens; the list itself for none.
fn list_starts(text: &Text<'_>, from: usize, end: usize, depth: usize) -> Vec<(usize, usize)> {
    let is_list = text.is(from, b'[') && text.is(end.max(1) - 1, b']');
    if depth == 0 || !is_list {
        return vec![(from, end)];
    }
    let elements = text.arguments(from + 1, end - 1);
    // Of several dimensions: what is no target has elements that are.
    let is_deeper = elements.first().is_some_and(|(a, b)| {
        let value = text.value(*a, *b);
        matches!(target(&value, Location { file: 0, at: 0 }), Read::Nothing)
            && matches!(&value, Value::List(inner) if inner.first().is_some_and(|v| {
                !matches!(target(v, Location { file: 0, at: 0 }), Read::Nothing)
            }))
    });
    elements
        .into_iter()
        .flat_map(|(a, b)| list_starts(text, a, b, usize::from(is_deeper)))
        .collect()
}

/// The same numbers and names, wherever they stand.
fn is_equal(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a.value == b.value,
        (Value::List(a), Value::List(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_equal(a, b))
        }
        (Value::Name(a), Value::Name(b)) => a == b,
        (Value::Text, Value::Text) => true,
        _ => false,
    }
}
