//! Reads RAPID's motions with their targets, tools and work objects.

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::program::{Frame, Line, Literal, Way};
use crate::robot_programs::correction::rapid::data::{FrameData, Read, Setting};
use crate::robot_programs::correction::rapid::statements::Statement;
use crate::robot_programs::correction::rapid::states::{DISPLACED, LOADED, MONITORED};
use crate::robot_programs::correction::rapid::syntax::{arguments, shape};
use crate::robot_programs::correction::rapid::{Reader, State};

/// Returns why a program displacement, whose setting is `switched`, keeps a motion from being corrected.
fn displaced(switched: Result<Setting, String>) -> Option<String> {
    match switched {
        Ok(Setting::Is(false)) => None,
        Ok(_) => Some("a program displacement is active (PDispOn, PDispSet)".to_owned()),
        Err(reason) => Some(format!("a program displacement may be active: {reason}")),
    }
}

impl Reader<'_> {
    /// Notes a motion and the targets to which it goes.
    pub(super) fn motion(
        &mut self,
        s: &Statement,
        name: &str,
        state: &mut State<'_>,
    ) -> Result<(), InputError> {
        let before = state.before.take();
        let text = self.texts[s.file];
        let Some((way, points, tool_at)) = shape(name) else {
            self.leave_unread(s, name);
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
        let goals: Vec<(usize, usize)> = positional.iter().take(points).copied().collect();
        if switch("corr").is_some() || switch("track").is_some() {
            self.leave_motion(s, &goals, "a sensor corrects its path".to_owned());
            return Ok(());
        }
        let (states, step) = (state.states, state.step);
        let switched = |key: usize| states.certain.value(step, key, &self.program);
        let is_monitored = switched(MONITORED[usize::from(way != Way::Joints)]);
        let displaced = displaced(switched(DISPLACED));
        if let Some(reason) = displaced.filter(|_| !is_joints) {
            self.leave_motion(s, &goals, reason);
            return Ok(());
        }
        let tool = self.tool(s, (tool_from, tool_end), state, is_joints)?;
        let object = match (switch("wobj"), is_joints) {
            (Some(value), false) => self.object(s, value, state)?,
            _ => Ok(Frame::own("wobj0", false)),
        };
        let (mut tool, base) = match (tool, object) {
            (Ok(tool), Ok(base)) => (tool, base),
            (Err(reason), _) | (_, Err(reason)) => {
                self.leave_motion(s, &goals, reason);
                return Ok(());
            }
        };
        let why = self.unknown_mass(s, &text.name(tool_from), state);
        let added = switched(LOADED).ok();
        tool.payload_kg = self.payload(s, tool.payload_kg, switch("tload"), added);
        let (tool, base) = (self.program.frame(tool), self.program.frame(base));
        let first = self.program.moves.len();
        for (i, point) in goals.iter().enumerate() {
            let way = if i + 1 < points { Way::Arc } else { way };
            for target in self.targets_of(s, *point) {
                if let Some(configuration) = &mut self.program.targets[target].configuration {
                    configuration.is_monitored = is_monitored != Ok(Setting::Is(false));
                }
                self.program.move_to(target, way, tool, base);
                if let Some(why) = &why {
                    self.program.unknown_payloads.insert(target, why.clone());
                }
            }
        }
        let last = self.program.moves.len();
        // A computed element of an array stands for several targets, and a target that is left for none.
        if last == first + points {
            let is_plain = switches.iter().all(|(s, _)| s == "wobj" || s == "tload");
            let is_line = name == "movel" && positional.len() == 4 && is_plain;
            let is_next = before.is_some_and(|(step, _)| step + 1 == first);
            if is_line && is_next {
                self.line(s, &positional, first);
            }
            state.before = Some((last - 1, s.blocks.clone()));
        }
        Ok(())
    }

    /// Leaves a motion as it is whose arguments are not known.
    fn leave_unread(&mut self, s: &Statement, name: &str) {
        let location = self.location(s, s.from);
        let word = self.texts[s.file].spelling(s.from);
        let reason = match name {
            "moveextj" => format!("{word} is not corrected"),
            _ => format!(
                "{word} is not read: a target of it is corrected only if another move goes there"
            ),
        };
        self.program.leave(location, reason);
    }

    /// Notes a straight line that `--split` may divide; `step` is its move.
    fn line(&mut self, s: &Statement, positional: &[(usize, usize)], step: usize) {
        let text = self.texts[s.file];
        let Some((from, end)) = positional.first() else {
            return;
        };
        let is_stop = |zone: &&(usize, usize)| text.name(zone.0) == "fine" && zone.1 == zone.0 + 1;
        let stop = positional.get(2).filter(is_stop);
        let zone = stop.map(|(from, _)| (text.byte(*from), text.end_of(*from)));
        self.program.lines.push(Line {
            step,
            file: s.file,
            at: text.byte(s.from),
            before: Vec::new(),
            instruction: (text.byte(s.from), text.byte(s.end) + 1),
            target: (text.byte(*from), text.end_of(*end - 1)),
            blend: zone.map(|zone| (zone, "z1")),
            literal: Literal::Robtarget,
        });
    }

    /// Leaves a motion as it is, and its targets: another motion to them would correct them for another place.
    fn leave_motion(&mut self, s: &Statement, goals: &[(usize, usize)], reason: String) {
        let location = self.location(s, s.from);
        let line = self.program.line_of(location);
        let text = self.texts[s.file];
        for (from, _) in goals {
            let named = self.named.find(&text.name(*from), s.file, s.routine);
            let all = named
                .and_then(|named| named.clone().ok())
                .unwrap_or_default();
            for index in all.into_iter().flatten() {
                let target = self.program.targets[index].location;
                let reason = format!("the move at {line} goes to it, and is left as it is");
                self.program.leave(target, reason);
            }
        }
        self.program.leave(location, reason);
    }

    /// Returns the targets to which an argument may refer.
    fn targets_of(&mut self, s: &Statement, (from, end): (usize, usize)) -> Vec<usize> {
        let text = self.texts[s.file];
        let location = self.location(s, from);
        if text.is(from, b'[') {
            match self.read_target(&text.value(from, end), location) {
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
            Some(Err(reason)) => {
                self.program.leave(location, reason.clone());
                Vec::new()
            }
            Some(Ok(all)) => match text
                .number(from + 2)
                .filter(|_| is_element && end == from + 4)
            {
                // Elements are counted from one.
                Some(number) => match (1..=all.len()).find(|i| *i as f64 == number.value) {
                    Some(i) => all[i - 1].into_iter().collect(),
                    None => {
                        self.program
                            .leave(location, format!("its target {quoted} does not exist"));
                        Vec::new()
                    }
                },
                None => all.iter().copied().flatten().collect(),
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

    /// Returns the tool of an argument, or the reason why it is not known.
    pub(super) fn tool(
        &self,
        s: &Statement,
        (from, end): (usize, usize),
        state: &State<'_>,
        is_joints: bool,
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
        if !is_joints {
            self.contradiction(&name, s)?;
        }
        match &self.frame_at(&name, s, state.states, state.step) {
            Some(FrameData::Tool { is_held: false, .. }) => Ok(Err(format!(
                "{name} stands still, and the robot holds the part"
            ))),
            // Joints need no tool, but its weight.
            Some(FrameData::Tool {
                pose: Err(_), mass, ..
            }) if is_joints => Ok(Ok(frame(Pose::identity(), *mass, self.origin(&name, s)))),
            Some(FrameData::Tool {
                pose: Err(reason), ..
            }) => Ok(Err(format!("tool {name}: {reason}"))),
            Some(FrameData::Tool {
                pose: Ok(pose),
                mass,
                ..
            }) => Ok(Ok(frame(*pose, *mass, self.origin(&name, s)))),
            Some(FrameData::Object { .. }) => Ok(Err(format!("{name} is not a tool"))),
            None if name == "tool0" => Ok(Ok(Frame {
                payload_kg: Some(0.0),
                ..Frame::own(text.spelling(from), true)
            })),
            None => Err(self.given.unknown(
                text.source,
                text.byte(from),
                "tool",
                &text.spelling(from),
                "tooldata",
            )),
        }
    }

    /// Returns the work object of an argument, or the reason why it is not known.
    pub(super) fn object(
        &self,
        s: &Statement,
        (from, end): (usize, usize),
        state: &State<'_>,
    ) -> Result<Result<Frame, String>, InputError> {
        let text = self.texts[s.file];
        let name = text.name(from);
        if end != from + 1 {
            return Ok(Err("its work object is computed".to_owned()));
        }
        self.contradiction(&name, s)?;
        Ok(match &self.frame_at(&name, s, state.states, state.step) {
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
            }) => Ok(Frame {
                name: text.spelling(from),
                is_tool: false,
                pose: *user * *object,
                payload_kg: None,
                origin: self.origin(&name, s),
            }),
            Some(FrameData::Tool { .. }) => Err(format!("{name} is not a work object")),
            None if name == "wobj0" => Ok(Frame::own(name, false)),
            None => {
                return Err(self.given.unknown(
                    text.source,
                    text.byte(from),
                    "base",
                    &text.spelling(from),
                    "wobjdata",
                ));
            }
        })
    }
}
