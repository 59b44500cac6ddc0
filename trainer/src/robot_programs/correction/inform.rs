//! Reads Yaskawa INFORM jobs (`.jbi`): the positions of `//POS` to which motions of `//INST` go.
//!
//! Lines of `//POS` say what the positions below them are: `///PULSE`, or `///RECTAN` in the robot's frame, its base or
//! `///USER n`, with `///TOOL n`. The number of pulses in a degree is a setting of the controller: a frame file states it,
//! or positions in pulses are left as they are. Tools and user frames are settings of the controller, too: its condition
//! files or a frame file state them.

use std::collections::BTreeMap;

use poegp_calibration::input_error::InputError;

use crate::robot_programs::correction::flow::{Flow, Step};
use crate::robot_programs::correction::frames::{FrameFile, Numbered};
use crate::robot_programs::correction::inform_conditions::conditions;
use crate::robot_programs::correction::program::{
    Configuration, Frame, Goal, Location, Program, Target, Way, of_turn,
};
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::dialect::INFORM;

/// Reads a job; `others` are condition files.
///
/// # Errors
/// [`InputError`] for a frame that is not in the frame file.
pub fn read(source: Source, others: &[Source], frames: &FrameFile) -> Result<Program, InputError> {
    let copy = source.clone();
    let mut reader = Reader {
        program: Program::new("Yaskawa INFORM", INFORM, vec![source]),
        source: &copy,
        given: frames,
        conditions: conditions(others),
        positions: BTreeMap::new(),
        changed: BTreeMap::new(),
    };
    let units = frames.pulses_per_degree();
    reader.program.joint_units =
        units.map(|all| all.iter().map(|n| (1.0 / n).to_radians()).collect());
    let mut state = Header::default();
    let mut is_code = false;
    let mut code = Vec::new();
    let mut at = 0;
    for line in copy
        .bytes
        .split_inclusive(|byte| matches!(byte, b'\n' | b'\r'))
    {
        let text = String::from_utf8_lossy(line);
        // Only comments have letters that are not UTF-8.
        let text = text.trim_end();
        if let Some(rest) = text.strip_prefix("//") {
            is_code |= rest.starts_with("INST");
            state.read(rest.trim_start_matches('/'));
        } else if !is_code {
            reader.position(text, at, &state);
        } else {
            code.push((text.trim_start().to_owned(), at));
        }
        at += line.len();
    }
    let shifts = reader.shifts(&code);
    reader.find_changed(&code);
    for ((text, at), shift) in code.iter().zip(shifts) {
        reader.instruction(text, *at, shift.as_deref())?;
    }
    Ok(reader.program)
}

/// Returns what an instruction does to the order of the lines, and whether it switches a shift.
fn steps(text: &str) -> Vec<Step<bool>> {
    let word = text.split_whitespace().next().unwrap_or("");
    let is_conditional = text.split_whitespace().any(|word| word == "IF");
    let jump = match (word, text.split_whitespace().nth(1)) {
        ("JUMP", Some(label)) if label.starts_with('*') => Step::Jump(label.to_owned()),
        ("RET" | "END", _) => Step::Return,
        _ => Step::Other,
    };
    match word {
        "SFTON" => vec![Step::Set(0, Some(true))],
        "SFTOF" => vec![Step::Set(0, Some(false))],
        "JUMP" | "RET" if is_conditional => vec![Step::Branch, jump, Step::End],
        "JUMP" | "RET" | "END" => vec![jump],
        "IFTHEN" | "IFTHENEXP" => vec![Step::Branch],
        "ELSEIF" | "ELSEIFEXP" | "CASE" => vec![Step::Next(false)],
        "ELSE" | "DEFAULT" => vec![Step::Next(true)],
        "SWITCH" => vec![Step::Cases],
        "WHILE" | "WHILEEXP" | "FOR" => vec![Step::Loop],
        "ENDIF" | "ENDSWITCH" | "ENDWHILE" | "NEXT" => vec![Step::End],
        _ if word.starts_with('*') => vec![Step::Label(word.to_owned())],
        _ => vec![Step::Other],
    }
}

/// Returns whether a word is the position of an external axis, such as `BC00001` or `EX002`.
fn is_axis(word: &str) -> bool {
    ["BC", "EC", "BP", "EX"].iter().any(|start| {
        let number = word.strip_prefix(start);
        number.is_some_and(|n| n.starts_with(|c: char| c.is_ascii_digit() || c == '['))
    })
}

/// Settings that the lines above a position state.
#[derive(Clone, Debug, Default)]
struct Header {
    tool: String,
    kind: String,
    user: String,
    configuration: Option<Configuration>,
}

impl Header {
    fn read(&mut self, text: &str) {
        let (key, value) = text.split_once(' ').unwrap_or((text, ""));
        let value = value.trim();
        match key {
            "TOOL" => self.tool = value.to_owned(),
            "POSTYPE" => self.kind = value.to_owned(),
            "USER" => self.user = value.to_owned(),
            "RCONF" => self.configuration = configuration(value),
            _ => {}
        }
    }
}

/// Reads a configuration `0,0,0,0,0,0,…`: wrist flipped, elbow, front or back, and whether joints 4, 6 and 1 stay within
/// half a turn.
fn configuration(text: &str) -> Option<Configuration> {
    let numbers: Vec<u8> = text
        .split(',')
        .map_while(|n| n.trim().parse::<u8>().ok())
        .collect();
    let [wrist, elbow, front, four, six, one, ..] = numbers[..] else {
        return None;
    };
    let within = [(3, four), (5, six), (0, one)].into_iter();
    let within = within.filter(|(_, is_beyond)| *is_beyond == 0);
    Some(Configuration {
        letters: [wrist, elbow, front].map(|number| Some(number == 0)),
        ..Configuration::monitored(within.map(|(joint, _)| of_turn(joint, 0.0)).collect())
    })
}

struct Reader<'a> {
    program: Program,
    source: &'a Source,
    given: &'a FrameFile,
    conditions: Numbered,
    positions: BTreeMap<String, (Option<usize>, Header)>,
    /// Tools (true) and user frames that the job sets, by number, each with the line; no number is any number.
    changed: BTreeMap<(bool, Option<u32>), String>,
}

impl Reader<'_> {
    /// Reads a position such as `C00002=1430.701,416.002,600.807,144.15,1.24,159.14`.
    fn position(&mut self, text: &str, at: usize, header: &Header) {
        let Some((name, values)) = text.split_once('=') else {
            return;
        };
        let is_name = name.starts_with('C') && name[1..].bytes().all(|b| b.is_ascii_digit());
        if !is_name || name.len() < 2 {
            if name.starts_with("EC") || name.starts_with("BC") {
                self.leave(at, "it has external axes");
            }
            return;
        }
        let target = match self.read_position(values, at, name.len() + 1, header) {
            Ok(target) => {
                self.program.targets.push(target);
                Some(self.program.targets.len() - 1)
            }
            Err(reason) => {
                self.leave(at, reason);
                None
            }
        };
        self.positions
            .insert(name.to_owned(), (target, header.clone()));
    }

    fn read_position(
        &self,
        values: &str,
        at: usize,
        from: usize,
        header: &Header,
    ) -> Result<Target, &'static str> {
        let pulses = self.given.pulses_per_degree();
        let is_pulses = header.kind == "PULSE";
        match (header.kind.as_str(), pulses) {
            ("PULSE", None) => {
                return Err("it is in pulses: give pulses_per_degree in a file of --frames");
            }
            ("PULSE" | "BASE" | "ROBOT" | "USER", _) => {}
            _ => return Err("its frame is not one of BASE, ROBOT and USER"),
        }
        let mut start = at + from;
        let mut numbers: Vec<Number> = Vec::new();
        for value in values.split(',') {
            let number = Number::parse(0, self.source, &(start..start + value.len()));
            numbers.push(number.ok_or("a part of it is not a number")?);
            start += value.len() + 1;
        }
        let goal = match (numbers.as_slice(), pulses) {
            (all, Some(pulses)) if is_pulses && all.len() == pulses.len() => Goal::Joints(numbers),
            ([_, _, _, _, _, _], _) if !is_pulses => Goal::pose(&numbers),
            _ => return Err("it has external axes"),
        };
        let configuration = header.configuration.clone().filter(|_| !is_pulses);
        Ok(Target::new(Location { file: 0, at }, goal, configuration))
    }

    fn leave(&mut self, at: usize, reason: impl Into<String>) {
        self.program.leave(Location { file: 0, at }, reason);
    }

    /// Returns for each line the reason why a shift moves its position, if one may be active.
    fn shifts(&self, code: &[(String, usize)]) -> Vec<Option<String>> {
        let mut flow = Flow::new();
        // The controller ends it with the job.
        flow.key(Some(false), false);
        let mut first = Vec::new();
        for (text, at) in code {
            let location = Location { file: 0, at: *at };
            let all = steps(text).into_iter();
            let all: Vec<usize> = all.map(|step| flow.push(0, step, location)).collect();
            first.push(all[0]);
        }
        let certain = flow.certain();
        let reason = |step: &usize| match certain.value(*step, 0, &self.program) {
            Ok(false) => None,
            Ok(true) => Some("a shift is active (SFTON)".to_owned()),
            Err(reason) => Some(format!("a shift may be active: {reason}")),
        };
        first.iter().map(reason).collect()
    }

    /// Notes the tools and user frames that the job sets: `MFRAME UF#(2) …`, `SETTOOL TL#(3) …`.
    fn find_changed(&mut self, code: &[(String, usize)]) {
        for (text, at) in code {
            let word = text.split_whitespace().next().unwrap_or("");
            let (is_tool, name) = match word {
                "SETTOOL" => (true, "TL#("),
                "MFRAME" | "SETUFRAME" => (false, "UF#("),
                _ => continue,
            };
            let number = text
                .split_once(name)
                .and_then(|(_, rest)| rest.split_once(')'));
            let number = number.and_then(|(number, _)| number.trim().parse().ok());
            let line = self.program.line_of(Location { file: 0, at: *at });
            self.changed.entry((is_tool, number)).or_insert(line);
        }
    }

    fn instruction(
        &mut self,
        text: &str,
        at: usize,
        shift: Option<&str>,
    ) -> Result<(), InputError> {
        let mut parts = text.split_whitespace();
        let name = parts.next().unwrap_or("");
        let way = match name {
            "MOVJ" => Way::Joints,
            "MOVL" => Way::Line,
            // The points of circles come one by one, three or more: the path between them is not checked.
            "MOVC" => Way::Joints,
            "IMOV" | "MOVS" | "SMOVL" | "SMOVC" => {
                self.leave(at, format!("{name} is not corrected"));
                return Ok(());
            }
            _ => return Ok(()),
        };
        let position = parts.next().unwrap_or("");
        if parts.any(is_axis) {
            if let Some((Some(target), _)) = self.positions.get(position) {
                self.leave(
                    self.program.targets[*target].location.at,
                    "it has external axes",
                );
            }
            return Ok(());
        }
        self.move_to(position, way, at, shift)
    }

    fn move_to(
        &mut self,
        name: &str,
        way: Way,
        at: usize,
        shift: Option<&str>,
    ) -> Result<(), InputError> {
        if let Some(reason) = shift {
            self.leave(at, reason);
            let target = self.positions.get(name).and_then(|(target, _)| *target);
            self.program.reached_otherwise.extend(target);
            return Ok(());
        }
        let Some((target, header)) = self.positions.get(name).cloned() else {
            self.leave(at, format!("its position {name} is computed"));
            return Ok(());
        };
        let Some(target) = target else {
            return Ok(());
        };
        let location = self.program.targets[target].location.at;
        let is_joints = matches!(self.program.targets[target].goal, Goal::Joints(_));
        let user = if header.kind == "USER" && !is_joints {
            header.user.as_str()
        } else {
            ""
        };
        let mut used = [(true, header.tool.as_str()), (false, user)].into_iter();
        let changed = used.find_map(|(is_tool, number)| {
            let number: u32 = number.parse().ok()?;
            let of = |number| self.changed.get(&(is_tool, number));
            of(Some(number)).or_else(|| of(None))
        });
        if let Some(line) = changed.filter(|_| !is_joints) {
            let reason = format!("its frame or tool is set at {line}");
            self.leave(location, reason);
            return Ok(());
        }
        let tool = match self.frame(location, &header.tool, true) {
            Ok(tool) => tool,
            // Joint positions need no frame.
            Err(_) if is_joints => Frame::own(format!("TOOL {}", header.tool), true),
            Err(error) => return Err(error),
        };
        let base = self.frame(location, user, false)?;
        let (tool, base) = (self.program.frame(tool), self.program.frame(base));
        self.program.move_to(target, way, tool, base);
        Ok(())
    }

    /// Returns a tool or user frame by its number; positions in the base have none.
    fn frame(&self, at: usize, number: &str, is_tool: bool) -> Result<Frame, InputError> {
        let given = self.given.named(number, is_tool);
        let own = number
            .parse()
            .ok()
            .and_then(|n| self.conditions.get(&(is_tool, n)));
        let found = match own {
            Some((own, origin)) => Some((*own, origin.clone())),
            None => given.map(|given| (given, self.given.origin())),
        };
        let (kind, name) = if is_tool {
            ("tool", "TOOL")
        } else {
            ("base", "USER")
        };
        match found {
            Some((found, origin)) => Ok(Frame {
                name: format!("{name} {number}"),
                is_tool,
                pose: found.pose,
                payload_kg: found.payload_kg,
                origin,
            }),
            None if number.is_empty() && !is_tool => Ok(Frame::own("base", is_tool)),
            None => Err(self
                .given
                .unknown(self.source, at, kind, number, &format!("{name} of"))),
        }
    }
}
