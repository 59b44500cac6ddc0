//! Reads KRL's motions with their points, tools and bases.

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::krl::folds::inline_form;
use crate::robot_programs::correction::krl::states::{
    BASE, COPIES, LOAD, Line, MODE, Named, States, TOOL,
};
use crate::robot_programs::correction::krl::{Point, Reader};
use crate::robot_programs::correction::program;
use crate::robot_programs::correction::program::{Frame, Goal, Literal, Location, Way};
use crate::robot_programs::correction::tokens::Kind;

/// Words by which a motion passes its point without a stop.
const BLENDING: [&str; 5] = ["c_dis", "c_ori", "c_ptp", "c_spl", "c_vel"];

impl Reader<'_> {
    /// Notes a motion and the points to which it goes. Returns the index of its last move, if all its points are known.
    pub(super) fn motion(
        &mut self,
        line: Line,
        way: Way,
        (states, step): (&States, usize),
    ) -> Result<Option<usize>, InputError> {
        let Line { file, from, end } = line;
        let text = self.texts[file];
        let with = (from..end)
            .find(|at| text.name(*at) == "with")
            .unwrap_or(end);
        let own = self.settings_with(line);
        let held = |key: usize| {
            let own = own.iter().rev().find(|(k, _)| *k == key);
            let value = match own {
                Some((_, value)) => Ok(value.clone()),
                None => states.certain.value(step, key, &self.program),
            };
            (value, own.is_some())
        };
        let (tool, base, (mode, _)) = (held(TOOL), held(BASE), held(MODE));
        let payload_kg = self.payload(&held(LOAD).0, &tool.0);
        let points = if way == Way::Arc { 2 } else { 1 };
        let is_monitored = matches!(text.name(from).as_str(), "ptp" | "sptp");
        let first = self.program.moves.len();
        for (a, b) in text.arguments(from + 1, with).into_iter().take(points) {
            let location = self.location(file, a);
            // Approximation follows the point: C_PTP, C_DIS.
            let stop = match text.is(a, b'{') {
                true => (text.find(a + 1, b, b"}") + 1).min(b),
                false => self
                    .point_name(file, a)
                    .map_or(b, |(_, behind)| behind)
                    .min(b),
            };
            let is_alone = text
                .at(stop)
                .is_none_or(|t| stop >= b || t.kind == Kind::Name);
            let name = self.point_name(file, a).map(|(name, _)| name);
            let is_alone = is_alone && name.is_some();
            let name = name.unwrap_or_default();
            let shown = match text.is(a + 1, b'[') {
                true => text.find(a + 2, b, b"]").min(b - 1),
                false => a,
            };
            let shown = text.source.slice(&(text.byte(a)..text.end_of(shown)));
            let shown = String::from_utf8_lossy(shown);
            let computed = || format!("its point is computed: {shown}");
            let found = match text.is(a, b'{') {
                true if !is_alone => Err(computed()),
                true => self.point(file, a, stop).map(|point| {
                    self.program.targets.push(point);
                    Some(self.program.targets.len() - 1)
                }),
                // The arm is there already.
                false if matches!(name.as_str(), "$axis_act" | "$pos_act") && is_alone => Ok(None),
                false if !is_alone => Err(computed()),
                false => match self.points.find(&name, file) {
                    Some(Point::Target(target)) => Ok(Some(*target)),
                    Some(Point::Left) => Ok(None),
                    Some(Point::Elsewhere) => Err(format!(
                        "its point {} is in a file that is not corrected",
                        text.spelling(a)
                    )),
                    Some(Point::Unset | Point::Array) => Err(computed()),
                    None => Err(format!("its point {shown} is in none of the files")),
                },
            };
            match found {
                Ok(Some(target)) => {
                    if self.program.fixed.contains(&target) {
                        self.note_fixed(&name, target);
                    }
                    let is_joints = matches!(self.program.targets[target].goal, Goal::Joints(_));
                    let location = self.program.targets[target].location;
                    if mode != Ok(Named::HoldsPart(false)) && !is_joints {
                        let reason = match &mode {
                            Err(reason) => format!("$IPO_MODE: {reason}"),
                            Ok(Named::Unknown(reason)) => reason.clone(),
                            Ok(_) => "the robot holds the part (IPO_FRAME #TCP)".to_owned(),
                        };
                        self.program.leave(location, reason);
                        continue;
                    }
                    let at = (states, step);
                    let tool = self.frame(location, &tool, at, true, is_joints)?;
                    let tool = tool.map(|tool| Frame { payload_kg, ..tool });
                    let base = self.frame(location, &base, at, false, is_joints)?;
                    self.move_to(target, is_monitored, way, tool, base);
                }
                Ok(None) => {}
                Err(reason) => self.program.leave(location, reason),
            }
        }
        let last = self.program.moves.len();
        Ok((last == first + points).then(|| last - 1))
    }

    /// Tells that a motion goes to joints which stay as they are.
    fn note_fixed(&mut self, name: &str, target: usize) {
        let line = self.program.line_of(self.program.targets[target].location);
        let name = name.to_ascii_uppercase();
        let remark = format!(
            "{line}: joints {name} are in a file that is not corrected: they show where the arm is, and stay as they are"
        );
        if !self.program.remarks.contains(&remark) {
            self.program.remarks.push(remark);
        }
    }

    /// Notes that moves can be inserted before a line, if the move before it is known.
    pub(super) fn note_line(
        &mut self,
        file: usize,
        (from, end): (usize, usize),
        before: Option<usize>,
    ) {
        let text = self.texts[file];
        let behind = match text.is(from + 1, b'{') {
            true => text.find(from + 2, end, b"}") + 1,
            false => self
                .point_name(file, from + 1)
                .map_or(end, |(_, behind)| behind),
        };
        if let Some(step) = before.map(|before| before + 1)
            && step + 1 == self.program.moves.len()
        {
            let instruction = (text.byte(from), text.end_of(end - 1));
            let is_blended = (behind..end).any(|at| BLENDING.contains(&text.name(at).as_str()));
            let word = match text.name(from).as_str() {
                "slin" => " C_SPL",
                _ => " C_DIS",
            };
            let form = inline_form(text.source, instruction.0);
            let (at, before) = form.unwrap_or((instruction.0, Vec::new()));
            self.program.lines.push(program::Line {
                step,
                file,
                at,
                before,
                instruction,
                target: (text.byte(from + 1), text.end_of(behind - 1)),
                blend: (!is_blended).then_some(((instruction.1, instruction.1), word)),
                literal: Literal::Frame,
            });
        }
    }

    fn move_to(
        &mut self,
        target: usize,
        is_monitored: bool,
        way: Way,
        tool: Result<Frame, String>,
        base: Result<Frame, String>,
    ) {
        if !is_monitored
            && let Some(configuration) = &mut self.program.targets[target].configuration
        {
            configuration.is_monitored = false;
        }
        self.program.move_in(target, way, tool, base);
    }

    /// Returns where a value comes from: the program, or another file by its path.
    fn origin(&self, file: usize) -> String {
        let source = &self.program.sources[file];
        match source.is_corrected {
            true => "the program".to_owned(),
            false => source.path.display().to_string(),
        }
    }

    /// Returns a tool or base by its name, and whether the motion itself states it; joint targets need none.
    fn frame(
        &self,
        location: Location,
        (named, is_own): &(Result<Named, String>, bool),
        (states, step): (&States, usize),
        is_tool: bool,
        is_joints: bool,
    ) -> Result<Result<Frame, String>, InputError> {
        let (kind, data) = if is_tool {
            ("tool", "TOOL_DATA")
        } else {
            ("base", "BASE_DATA")
        };
        let frame = |name: String, pose, origin: String| {
            Ok(Ok(Frame {
                name,
                is_tool,
                pose,
                payload_kg: None,
                origin,
            }))
        };
        let (number, name) = match named {
            Ok(Named::Number(number)) => (*number, format!("{data}[{number}]")),
            Ok(Named::Written(pose)) => {
                let name = format!("${}", kind.to_ascii_uppercase());
                return frame(name, *pose, "the program".to_owned());
            }
            _ if is_joints => return Ok(Ok(Frame::own("none", is_tool))),
            Ok(Named::Unknown(reason)) => return Ok(Err(reason.clone())),
            Ok(_) => return Ok(Err(format!("its {kind} is computed"))),
            Err(reason) => return Ok(Err(format!("its {kind}: {reason}"))),
        };
        let key = number.to_string();
        let given = self.given.named(&key, is_tool);
        let declared = self.numbered.get(&(is_tool, number));
        let moved = self.moved.get(&number).filter(|_| !(is_tool || is_joints));
        if let Some(line) = moved {
            return Ok(Err(format!("an external kinematic moves {name} ({line})")));
        }
        let value = match states.numbered.get(&(is_tool, number)) {
            Some(key) => Some(
                match states.certain.value(
                    step,
                    // $TOOL is a copy of TOOL_DATA[n].
                    if *is_own {
                        *key
                    } else {
                        COPIES[usize::from(!is_tool)]
                    },
                    &self.program,
                ) {
                    Ok(Named::Written(pose)) => Ok(pose),
                    Ok(Named::Unknown(reason)) | Err(reason) => Err(reason),
                    Ok(_) => Err("it is computed".to_owned()),
                },
            ),
            None => {
                self.contradiction(&name, declared)?;
                declared.map(|declared| declared.value.clone())
            }
        };
        let origin = || match declared {
            Some(declared) if !states.numbered.contains_key(&(is_tool, number)) => {
                self.origin(declared.at.file)
            }
            _ => "the program".to_owned(),
        };
        match (value, given) {
            (Some(Ok(pose)), _) => frame(name, pose, origin()),
            (Some(Err(_)), _) if is_joints => frame(name, Pose::identity(), origin()),
            (Some(Err(reason)), _) => Ok(Err(format!("{name}: {reason}"))),
            (None, Some(given)) => frame(name, given.pose, self.given.origin()),
            (None, None) if number == 0 || is_joints => Ok(Ok(Frame::own(name, is_tool))),
            (None, None) => {
                let source = &self.program.sources[location.file];
                Err(self
                    .given
                    .unknown(source, location.at, kind, &key, &format!("{data} of")))
            }
        }
    }
}
