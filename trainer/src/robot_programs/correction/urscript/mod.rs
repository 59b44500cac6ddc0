//! Reads URScript: joints and poses that are written in a move, and variables that are set once and to which a move goes.
//!
//! The tool is that of `set_tcp` before the move. A pose is in the base, or, with `pose_trans`, in written features. Poses
//! of `set_tcp`, features and offsets are no targets: only what reaches a move is. ("The URScript Programming Language",
//! module motion.)

mod calls;
mod lines;
mod states;
mod steps;
mod targets;

use std::collections::{HashMap, HashSet};

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program;
use crate::robot_programs::correction::program::{Frame, Goal, Literal, Location, Program, Way};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, tokens};
use crate::robot_programs::correction::urscript::lines::{Line, lines_of};
use crate::robot_programs::correction::urscript::states::{
    DISPLACED, Other, PAYLOAD, Setting, States, TOOL,
};

const LEXICON: Lexicon = Lexicon {
    comment: b'#',
    quotes: b"\"'",
    in_names: b"",
    has_pairs: false,
};

/// Motions whose targets are not corrected.
const OTHER_MOTIONS: [&str; 11] = [
    "mc_add_circular",
    "mc_add_linear",
    "mc_add_path",
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
    let lines = lines_of(&text).map_err(|switch| {
        let found = "a switch in a script whose blocks do not end";
        let expected = "an end for each function, condition, loop and switch, and for none or all of the cases";
        source.error(text.byte(switch), found, expected)
    })?;
    let mut reader = Reader {
        program: Program::new("URScript", Language::UrScript.dialect(), vec![source]),
        text,
        given: frames,
        set: HashMap::new(),
        reached: HashSet::new(),
        lines,
        others: Vec::new(),
    };
    reader.find_variables();
    let states = reader.states();
    reader.run(&states)?;
    reader.leave_shared();
    reader.program.remarks.push(
        "the controller of a Universal Robots arm has a calibration of its own: the targets would be corrected twice, \
         unless the model was calibrated against the controller's parameters"
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
    /// Set as a whole more than once.
    Several,
    /// Computed, or set in part.
    Unknown,
}

/// Instructions whose targets are corrected.
const MOTIONS: [&str; 6] = ["movej", "movel", "movep", "movec", "optimovej", "optimovel"];

struct Reader<'a> {
    program: Program,
    text: Text<'a>,
    given: &'a FrameFile,
    set: HashMap<String, Variable>,
    /// Variables to which moves go: they change with the correction.
    reached: HashSet<String>,
    lines: Vec<Line>,
    /// Calls besides the moves that get targets.
    others: Vec<Other>,
}

impl Reader<'_> {
    fn find_variables(&mut self) {
        let text = self.text;
        for line in self.lines.clone() {
            let word = text.name(line.from);
            if line.is_definition {
                // Calls set the parameters of a function.
                for at in line.from + 2..line.end {
                    if text.at(at).is_some_and(|token| token.kind == Kind::Name) {
                        self.set.insert(text.spelling(at), Variable::Unknown);
                    }
                }
                continue;
            }
            if MOTIONS.contains(&word.as_str()) {
                let points = self.points(&line, &word).into_iter();
                let names: Vec<String> = points.filter_map(|p| self.variable(p)).collect();
                self.reached.extend(names);
            }
            self.find_assignments(&line, &word);
        }
    }

    /// Notes the variables that a line sets, as a whole or in part.
    fn find_assignments(&mut self, line: &Line, word: &str) {
        let text = self.text;
        let begin = line.from + usize::from(matches!(word, "global" | "local"));
        let mut from = line.from;
        loop {
            let equals = text.find(from, line.end, b"=");
            if equals == line.end {
                return;
            }
            from = equals + 1;
            let is_compared = text.is(from, b'=')
                || [b'=', b'!', b'<', b'>']
                    .iter()
                    .any(|mark| equals > line.from && text.is(equals - 1, *mark));
            if is_compared {
                continue;
            }
            // The variable stands before its indices.
            let (mut name_at, mut depth) = (equals, 0_usize);
            while name_at > line.from {
                name_at -= 1;
                depth += usize::from(text.is(name_at, b']'));
                depth = depth.saturating_sub(usize::from(text.is(name_at, b'[')));
                if depth == 0 && self.is_name(name_at) {
                    break;
                }
            }
            let name = text.spelling(name_at);
            let is_whole = name_at == begin && equals == begin + 1;
            let variable = match self.set.get(&name) {
                None if is_whole => Variable::Written {
                    from: equals + 1,
                    end: line.end,
                    target: None,
                },
                Some(Variable::Written { .. } | Variable::Several)
                    if is_whole && word != "local" =>
                {
                    Variable::Several
                }
                _ => Variable::Unknown,
            };
            self.set.insert(name, variable);
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

    /// Returns the points of a move, also those with their names: `movel(pose=p[…])`.
    fn points(&self, line: &Line, word: &str) -> Vec<(usize, usize)> {
        let unnamed = |(from, end): (usize, usize)| {
            let name = self.text.name(from);
            let is_named = matches!(name.as_str(), "q" | "pose" | "pose_via" | "pose_to")
                && self.text.is(from + 1, b'=');
            (from + 2 * usize::from(is_named), end)
        };
        let all = self.first(line).into_iter().take(points_of(word));
        all.map(unnamed).collect()
    }

    fn run(&mut self, states: &States) -> Result<(), InputError> {
        let text = self.text;
        let mut function = usize::MAX;
        let mut before: Option<(usize, Vec<usize>)> = None;
        let own = self.moving_parameters();
        for (line, step) in self.lines.clone().into_iter().zip(&states.steps) {
            let first = self.program.moves.len();
            let is_same = before.as_ref().is_some_and(|(step, blocks)| {
                line.function == function && *blocks == line.blocks && step + 1 == first
            });
            if !is_same {
                before = None;
            }
            function = line.function;
            let name = text.name(line.from);
            let is_motion = MOTIONS.contains(&name.as_str());
            match name.as_str() {
                "movej" | "optimovej" => self.motion(&line, Way::Joints, (states, *step))?,
                "movel" | "movep" | "optimovel" => {
                    self.motion(&line, Way::Line, (states, *step))?
                }
                "movec" => self.motion(&line, Way::Arc, (states, *step))?,
                name if OTHER_MOTIONS.contains(&name) => {
                    let location = self.location(line.from);
                    self.program
                        .leave(location, format!("{name} is not corrected"));
                }
                _ => {
                    let is_hidden = |at: &usize| {
                        let word = text.name(*at);
                        let is_motion = MOTIONS.iter().chain(&OTHER_MOTIONS).any(|m| *m == word);
                        is_motion && text.is(at + 1, b'(')
                    };
                    for at in (line.from + 1..line.end).filter(is_hidden) {
                        let location = self.location(at);
                        self.program
                            .leave(location, "a move within a line of something else");
                    }
                }
            }
            self.note_calls(&line, &own);
            let last = self.program.moves.len();
            if name == "movel" && last == first + 1 && before.is_some() {
                self.note_line(&line, first);
            }
            if is_motion {
                let is_known = last == first + points_of(&name);
                before = is_known.then(|| (last - 1, line.blocks.clone()));
            } else if !STAYS.contains(&name.as_str()) {
                before = None;
            }
        }
        Ok(())
    }

    /// Notes that moves can be inserted before a line, which must state no time of its own, and be alone on its line of the file.
    fn note_line(&mut self, line: &Line, step: usize) {
        let text = self.text;
        let is_end = |at: usize| text.at(at).is_none_or(|token| token.kind == Kind::LineEnd);
        let behind = line.end + usize::from(text.is(line.end, b';'));
        if !(line.from == 0 || is_end(line.from - 1)) || !is_end(behind) {
            return;
        }
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
        let blend = self.blend(line, &arguments);
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
            at: text.byte(line.from),
            before: Vec::new(),
            instruction: (text.byte(line.from), text.end_of(line.end - 1)),
            target: (text.byte(from), text.end_of(end - 1)),
            blend,
            literal: Literal::Pose,
        });
    }

    /// Returns where a copy of a move that stops gets its blend radius, the fifth argument. `None` if the move has one.
    fn blend(
        &self,
        line: &Line,
        arguments: &[(usize, usize)],
    ) -> Option<((usize, usize), &'static str)> {
        let text = self.text;
        let is_named = |(from, _): &&(usize, usize)| text.is(from + 1, b'=');
        let named = arguments
            .iter()
            .filter(is_named)
            .find(|(from, _)| text.name(*from) == "r")
            .map(|(from, end)| (from + 2, *end));
        let fifth = arguments.iter().filter(|a| !is_named(a)).nth(4).copied();
        let Some((from, end)) = named.or(fifth) else {
            let close = text.find(line.from + 2, line.end, b")");
            let at = text.byte(close);
            return Some(((at, at), ", r=0.001"));
        };
        let is_stop = end == from + 1 && text.number(from).is_some_and(|n| n.value == 0.0);
        is_stop.then(|| ((text.byte(from), text.end_of(end - 1)), "0.001"))
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
        (states, step): (&States, usize),
    ) -> Result<(), InputError> {
        let at = |key: usize| states.certain.value(step, key, &self.program);
        let (tool, payload, displaced) = (at(TOOL), at(PAYLOAD), at(DISPLACED));
        let payload_kg = match payload {
            Ok(Setting::Payload(kg)) => Some(kg),
            _ => None,
        };
        let displaced = match displaced {
            Ok(Setting::Is(false)) => None,
            Ok(_) => Some("the controller moves it (a conveyor, an offset or a force)".to_owned()),
            Err(reason) => Some(format!("the controller may move it: {reason}")),
        };
        let word = self.text.name(line.from);
        for (from, end) in self.points(line, &word) {
            let (target, base) = match self.target((from, end), (states, step)) {
                Ok(found) => found,
                Err(reason) => {
                    let location = self.location(from);
                    self.program.leave(location, reason);
                    continue;
                }
            };
            let location = self.program.targets[target].location;
            let is_joints = matches!(self.program.targets[target].goal, Goal::Joints(_));
            let (pose, origin) = match &tool {
                Ok(Setting::Pose(pose)) if states.certain.is_set(step, TOOL) => {
                    (*pose, "set_tcp".to_owned())
                }
                Ok(Setting::Pose(pose)) => (*pose, self.given.origin()),
                // Joints need no tool.
                _ if is_joints => (Pose::identity(), "set_tcp".to_owned()),
                Err(reason) => {
                    self.program.leave(location, format!("tool tcp: {reason}"));
                    continue;
                }
                Ok(Setting::Unknown(reason)) => {
                    self.program.leave(location, format!("tool tcp: {reason}"));
                    continue;
                }
                Ok(_) => {
                    let expected = "set_tcp before it, or [tool.tcp] in a file of --frames";
                    let at = self.text.byte(line.from);
                    let error = self
                        .text
                        .source
                        .error(at, "a move without a tool", expected);
                    let help = "add set_tcp(p[…]) to the script, or give the numbers with --frames FILE.toml";
                    return Err(error.with_help(help));
                }
            };
            if let Some(reason) = &displaced {
                self.program.leave(location, reason.clone());
                continue;
            }
            let tool = self.program.frame(Frame {
                name: "tcp".to_owned(),
                is_tool: true,
                pose,
                payload_kg,
                origin,
            });
            let base = self.program.frame(base);
            self.program.move_to(target, way, tool, base);
        }
        Ok(())
    }

    fn is_name(&self, token: usize) -> bool {
        let token = self.text.at(token);
        token.is_some_and(|token| token.kind == Kind::Name)
    }
}

/// Returns the number of points of a move.
fn points_of(name: &str) -> usize {
    1 + usize::from(name == "movec")
}
