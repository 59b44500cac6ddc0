//! Reads URScript: joints and poses that are written in a move, and variables that are set once and to which a move goes.
//!
//! The tool is that of `set_tcp` before the move. A pose is in the base, or, with `pose_trans`, in a written feature. Poses
//! of `set_tcp`, features and offsets are no targets: only what reaches a move is. ("The URScript Programming Language",
//! module motion.)

use std::collections::HashMap;

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program;
use crate::robot_programs::correction::program::{
    Frame, Goal, Literal, Location, Program, Target, Way,
};
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, tokens};
use crate::robot_programs::correction::urscript_lines::{Line, lines_of};
use crate::robot_programs::dialect::Orientation;

const LEXICON: Lexicon = Lexicon {
    comment: b'#',
    quotes: b"\"'",
    in_names: b"",
    has_pairs: false,
};

/// Motions whose targets are not corrected.
const OTHER_MOTIONS: [&str; 8] = [
    "servoj",
    "servol",
    "servoc",
    "speedj",
    "speedl",
    "movep_relative",
    "path_offset_set",
    "force_mode",
];

/// Calls that leave the arm where it is, so that the next line begins where the move before has ended.
const STAYS: [&str; 9] = [
    "set_tcp",
    "set_payload",
    "set_target_payload",
    "sleep",
    "textmsg",
    "popup",
    "set_digital_out",
    "set_standard_digital_out",
    "set_standard_analog_out",
];

/// Reads a script.
///
/// # Errors
/// [`InputError`] for a tool that is nowhere.
pub fn read(source: Source, frames: &FrameFile) -> Result<Program, InputError> {
    let mut depth = 0_usize;
    let mut all = tokens(&source.bytes, &LEXICON);
    // Expressions in brackets go on over the ends of lines.
    all.retain(|token| {
        match token.kind {
            Kind::Mark(b'(' | b'[') => depth += 1,
            Kind::Mark(b')' | b']') => depth = depth.saturating_sub(1),
            _ => {}
        }
        token.kind != Kind::LineEnd || depth == 0
    });
    let copy = source.clone();
    let text = Text {
        file: 0,
        source: &copy,
        tokens: &all,
    };
    let mut reader = Reader {
        program: Program::new("URScript", Language::UrScript.dialect(), vec![source]),
        text,
        given: frames,
        set: HashMap::new(),
        tools: Vec::new(),
        lines: lines_of(&text),
    };
    reader.find_variables();
    reader.run()?;
    reader.program.remarks.push(
        "the controller of a Universal Robots arm has parameters of its own calibration: with them the correction would count \
         twice, unless the model was calibrated against them"
            .to_owned(),
    );
    Ok(reader.program)
}

/// Value of a variable.
enum Variable {
    /// Written once: the tokens of its value, and its target once a move goes there.
    Written {
        from: usize,
        end: usize,
        target: Option<usize>,
    },
    /// Computed, or set more than once.
    Unknown,
}

/// A tool, or the reason why it is not known.
type Tool = Result<Pose<f64>, String>;

struct Reader<'a> {
    program: Program,
    text: Text<'a>,
    given: &'a FrameFile,
    set: HashMap<String, Variable>,
    /// The tool of every `set_tcp`.
    tools: Vec<Tool>,
    lines: Vec<Line>,
}

impl Reader<'_> {
    fn find_variables(&mut self) {
        let text = self.text;
        for line in self.lines.clone() {
            let at = line.from
                + usize::from(matches!(text.name(line.from).as_str(), "global" | "local"));
            let name = text.spelling(at);
            if text.name(line.from) == "set_tcp" {
                let (tool, _) = self.tool(&line);
                self.tools.push(tool);
            }
            if text.is(at + 1, b'=') && !text.is(at + 2, b'=') {
                let is_first = !self.set.contains_key(&name);
                let written = Variable::Written {
                    from: at + 2,
                    end: line.end,
                    target: None,
                };
                self.set
                    .insert(name, if is_first { written } else { Variable::Unknown });
            } else if text.name(line.from) == "def" {
                // Calls set the parameters of a function.
                for at in line.from + 2..line.end {
                    if text.at(at).is_some_and(|token| token.kind == Kind::Name) {
                        self.set.insert(text.spelling(at), Variable::Unknown);
                    }
                }
            }
        }
    }

    /// Returns the arguments of a call that is the whole line.
    fn first(&self, line: &Line) -> Vec<(usize, usize)> {
        let text = self.text;
        match text.is(line.from + 1, b'(') {
            true => text.arguments(line.from + 2, text.find(line.from + 2, line.end, b")")),
            false => Vec::new(),
        }
    }

    /// Returns the tool that a `set_tcp` sets.
    fn tool(&self, line: &Line) -> (Tool, usize) {
        let at = self.text.byte(line.from);
        let unknown = || {
            let line = self.program.line_of(Location { file: 0, at });
            Err(format!("its tool is computed at {line}"))
        };
        let first = self.first(line).first().copied();
        let pose = first.and_then(|(from, end)| self.pose_of(from, end));
        (pose.map_or_else(unknown, Ok), at)
    }

    /// Returns the numbers of `p[x, y, z, rx, ry, rz]`, written directly or referred to by a name.
    fn numbers(&self, from: usize, end: usize) -> Option<[Number; 6]> {
        let text = self.text;
        if text.name(from) == "p" && text.is(from + 1, b'[') {
            return text.value(from + 1, end).numbers();
        }
        None
    }

    fn pose_of(&self, from: usize, end: usize) -> Option<Pose<f64>> {
        let numbers = match self.numbers(from, end) {
            Some(numbers) => numbers,
            None => match self.set.get(&self.text.spelling(from)) {
                Some(Variable::Written {
                    from: a, end: b, ..
                }) if end == from + 1 => self.numbers(*a, *b)?,
                _ => return None,
            },
        };
        let n = numbers.map(|n| n.value);
        Some(Pose {
            rotation: Orientation::RotationVector.rotation(&n[3..])?,
            translation: Vector3::new(n[0], n[1], n[2]),
        })
    }

    fn run(&mut self) -> Result<(), InputError> {
        let text = self.text;
        let mut tool: Option<(Tool, Vec<usize>)> = None;
        let mut payload = None;
        let mut function = usize::MAX;
        let mut before: Option<(usize, Vec<usize>)> = None;
        for line in self.lines.clone() {
            let first = self.program.moves.len();
            let is_same = before.as_ref().is_some_and(|(step, blocks)| {
                line.function == function && *blocks == line.blocks && step + 1 == first
            });
            if !is_same {
                before = None;
            }
            if line.function != function {
                function = line.function;
                tool = self.tool_of_all().map(|tool| (tool, Vec::new()));
            }
            // A tool that is set under a condition is known only there.
            if let Some((known, blocks)) = &mut tool
                && !line.blocks.starts_with(blocks)
            {
                *known = Err("its tool is set under a condition".to_owned());
                blocks.clear();
            }
            match text.name(line.from).as_str() {
                "set_tcp" => tool = Some((self.tool(&line).0, line.blocks.clone())),
                "set_payload" | "set_target_payload" => {
                    let first = self.first(&line).first().copied();
                    payload = first
                        .and_then(|(from, _)| text.number(from))
                        .map(|n| n.value);
                }
                "movej" => self.motion(&line, Way::Joints, &tool, payload)?,
                "movel" | "movep" => self.motion(&line, Way::Line, &tool, payload)?,
                "movec" => self.motion(&line, Way::Arc, &tool, payload)?,
                name if OTHER_MOTIONS.contains(&name) => {
                    let location = self.location(line.from);
                    self.program
                        .leave(location, format!("{name} is not corrected"));
                }
                _ => {
                    let hidden = (line.from + 1..line.end).find(|at| {
                        matches!(
                            text.name(*at).as_str(),
                            "movej" | "movel" | "movep" | "movec"
                        ) && text.is(at + 1, b'(')
                    });
                    if let Some(at) = hidden.filter(|_| text.name(line.from) != "def") {
                        let location = self.location(at);
                        self.program
                            .leave(location, "a move within a line of something else");
                    }
                }
            }
            let name = text.name(line.from);
            let (points, last) = (1 + usize::from(name == "movec"), self.program.moves.len());
            if name == "movel" && last == first + 1 && before.is_some() {
                self.note_line(&line, first);
            }
            if matches!(name.as_str(), "movej" | "movel" | "movep" | "movec") {
                let is_known = last == first + points;
                before = is_known.then(|| (last - 1, line.blocks.clone()));
            } else if !STAYS.contains(&name.as_str()) {
                before = None;
            }
        }
        Ok(())
    }

    /// Notes that moves can be inserted before a line, which must state no time of its own.
    fn note_line(&mut self, line: &Line, step: usize) {
        let text = self.text;
        let arguments = self.first(line);
        let is_named_time =
            |(from, _): &(usize, usize)| text.name(*from) == "t" && text.is(from + 1, b'=');
        let mut positional = arguments
            .iter()
            .filter(|(from, _)| !text.is(from + 1, b'='));
        // The fourth argument is a time; 0 stands for none.
        let is_timed = positional.nth(3).is_some_and(|(from, end)| {
            let is_zero = text.number(*from).is_some_and(|n| n.value == 0.0);
            !(is_zero && *end == from + 1)
        });
        if is_timed || arguments.iter().any(is_named_time) {
            return;
        }
        let Some((mut from, mut end)) = arguments.first().copied() else {
            return;
        };
        // Unwraps the pose in its feature.
        while text.is(from + 1, b'(') {
            let inner = text.arguments(from + 2, end - 1);
            let at = usize::from(text.name(from) == "pose_trans");
            match inner.get(at) {
                Some(pose) => (from, end) = *pose,
                None => return,
            }
        }
        self.program.lines.push(program::Line {
            step,
            file: 0,
            instruction: (text.byte(line.from), text.end_of(line.end - 1)),
            target: (text.byte(from), text.end_of(end - 1)),
            literal: Literal::Pose,
        });
    }

    /// Returns the tool at the beginning of a function: the one that all `set_tcp` of the script set.
    fn tool_of_all(&self) -> Option<Tool> {
        let first = self.tools.first()?;
        let is_one = self.tools.iter().all(|tool| tool == first);
        Some(match is_one {
            true => first.clone(),
            false => Err("its tool depends on what was called before".to_owned()),
        })
    }

    fn location(&self, token: usize) -> Location {
        Location {
            file: 0,
            at: self.text.byte(token),
        }
    }

    fn motion(
        &mut self,
        line: &Line,
        way: Way,
        tool: &Option<(Tool, Vec<usize>)>,
        payload_kg: Option<f64>,
    ) -> Result<(), InputError> {
        let points = if way == Way::Arc { 2 } else { 1 };
        let (pose, origin) = match tool {
            Some((Ok(pose), _)) => (*pose, "set_tcp".to_owned()),
            Some((Err(reason), _)) => {
                let location = self.location(line.from);
                self.program.leave(location, reason.clone());
                return Ok(());
            }
            None => match self.given.tool("tcp") {
                Some(given) => (given.pose, self.given.origin()),
                None => {
                    let at = self.text.byte(line.from);
                    return Err(self.given.unknown(
                        self.text.source,
                        at,
                        "tool",
                        "tcp",
                        "set_tcp of",
                    ));
                }
            },
        };
        let name = "tcp".to_owned();
        let tool = self.program.frame(Frame {
            name,
            is_tool: true,
            pose,
            payload_kg,
            origin,
        });
        for (from, end) in self.first(line).into_iter().take(points) {
            match self.target(from, end) {
                Ok((target, base)) => {
                    let base = self.program.frame(base);
                    self.program.move_to(target, way, tool, base);
                }
                Err(reason) => {
                    let location = self.location(from);
                    self.program.leave(location, reason);
                }
            }
        }
        Ok(())
    }

    /// Returns the target of an argument, and its base frame.
    fn target(&mut self, from: usize, end: usize) -> Result<(usize, Frame), String> {
        let text = self.text;
        let base = Frame {
            name: "base".to_owned(),
            is_tool: false,
            pose: Pose::identity(),
            payload_kg: None,
            origin: "the controller".to_owned(),
        };
        let name = text.name(from);
        let is_call = text.is(from + 1, b'(') && text.find(from + 2, end, b")") + 1 == end;
        let arguments = || text.arguments(from + 2, end - 1);
        match name.as_str() {
            "pose_trans" if is_call => {
                let [feature, (a, b)] = arguments()[..] else {
                    return Err("its pose is computed".to_owned());
                };
                let name = text.spelling(feature.0);
                let pose = self.pose_of(feature.0, feature.1);
                let pose = pose.ok_or_else(|| format!("its feature {name} is computed"))?;
                let (target, _) = self.target(a, b)?;
                Ok((
                    target,
                    Frame {
                        name,
                        pose,
                        origin: "the script".to_owned(),
                        ..base
                    },
                ))
            }
            "get_inverse_kin" if is_call => {
                let (a, b) = arguments().first().copied().ok_or("its pose is computed")?;
                self.target(a, b)
            }
            "" | "p" => {
                let target = self.written(from, end).ok_or("a part of it is computed")?;
                self.program.targets.push(target);
                Ok((self.program.targets.len() - 1, base))
            }
            _ => {
                let name = text.spelling(from);
                let written = match self.set.get(&name) {
                    Some(Variable::Written {
                        from: a,
                        end: b,
                        target,
                    }) if end == from + 1 => (*a, *b, *target),
                    _ => return Err(format!("its target is computed: {name}")),
                };
                let index = match written {
                    (_, _, Some(index)) => index,
                    (a, b, None) => {
                        let target = self
                            .written(a, b)
                            .ok_or_else(|| format!("{name} is computed"))?;
                        self.program.targets.push(target);
                        self.program.targets.len() - 1
                    }
                };
                if let Some(Variable::Written { target, .. }) = self.set.get_mut(&name) {
                    *target = Some(index);
                }
                Ok((index, base))
            }
        }
    }

    /// Reads a written target.
    fn written(&self, from: usize, end: usize) -> Option<Target> {
        let goal = match self.numbers(from, end) {
            Some([x, y, z, rx, ry, rz]) => Goal::Pose {
                position: [x, y, z],
                orientation: vec![rx, ry, rz],
            },
            None => Goal::Joints(self.text.value(from, end).numbers::<6>()?.to_vec()),
        };
        Some(Target {
            location: self.location(from),
            goal,
            tool: None,
            base: None,
            configuration: None,
        })
    }
}
