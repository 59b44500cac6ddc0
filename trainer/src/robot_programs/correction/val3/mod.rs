//! Reads Stäubli VAL3 data (`.dtx`): joint targets (`jointRx`) and points (`pointRx`) that motions of the programs beside
//! the data use.
//!
//! Angles of points, frames and tools are about x, the new y and the new z. A point is in the frame that its `fatherId`
//! names. The programs (`.pgx`) say with which tool a point is used (`movej(jJoint[0],tTool[0],…)`); they are read but not
//! changed.

mod changes;
mod tags;

use std::collections::{HashMap, HashSet};

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{
    Configuration, Frame, Goal, Location, Program, Target, Way,
};
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, tokens};
use crate::robot_programs::correction::val3::tags::{Tag, is_comment, tags};
use crate::robot_programs::dialect::{Orientation, VAL3};

/// Components of points, frames and tools.
const COMPONENTS: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];
/// Attributes of a point that state its configuration, each with the names of its two sides.
const LETTERS: [(&str, &str, &str); 3] = [
    ("wrist", "wpositive", "wnegative"),
    ("elbow", "epositive", "enegative"),
    ("shoulder", "righty", "lefty"),
];
/// Largest depth of nested frames.
const DEEPEST: usize = 16;

const LEXICON: Lexicon = Lexicon {
    comment: 0,
    quotes: b"\"",
    in_names: b"",
    has_pairs: false,
};

/// Reads a data file and the programs that use it.
///
/// # Errors
/// [`InputError`] for a frame that is nowhere.
pub fn read(sources: Vec<Source>, frames: &FrameFile) -> Result<Program, InputError> {
    let copies = sources.clone();
    let mut reader = Reader {
        program: Program::new("Stäubli VAL3", VAL3, sources),
        sources: &copies,
        given: frames,
        named: HashMap::new(),
        frames: HashMap::new(),
        changed: HashMap::new(),
        own: HashSet::new(),
    };
    for (file, source) in copies.iter().enumerate() {
        if is_data(source) {
            reader.data(file);
        }
    }
    let programs = copies.iter().enumerate().filter(|(_, s)| !is_data(s));
    let programs: Vec<(usize, Vec<Token>)> = programs
        .map(|(file, source)| {
            let mut all = tokens(&source.bytes, &LEXICON);
            all.retain(|token| token.kind != Kind::LineEnd && !is_comment(source, token));
            (file, all)
        })
        .collect();
    let texts = || {
        programs.iter().map(|(file, tokens)| Text {
            file: *file,
            source: &copies[*file],
            tokens,
        })
    };
    for (file, source) in copies.iter().enumerate().filter(|(_, s)| !is_data(s)) {
        let is_own = |tag: &Tag| matches!(tag.name.as_str(), "Local" | "Parameter");
        for tag in tags(source).into_iter().filter(is_own) {
            let name = tag.value(source, "name");
            reader.own.extend(name.map(|name| (file, name)));
        }
    }
    let texts_of_programs: Vec<Text<'_>> = texts().collect();
    reader.changes(&texts_of_programs);
    for text in texts() {
        reader.code(&text)?;
    }
    Ok(reader.program)
}

fn is_data(source: &Source) -> bool {
    let ending = source.path.extension().unwrap_or_default();
    ending.eq_ignore_ascii_case("dtx")
}

/// A frame or tool of the data.
#[derive(Clone, PartialEq)]
struct FrameData {
    /// Its pose in its father, or why it is not known.
    pose: Result<Pose<f64>, &'static str>,
    father: String,
}

struct Reader<'a> {
    program: Program,
    sources: &'a [Source],
    given: &'a FrameFile,
    /// Targets by `name[key]`, each with the frame of a point.
    named: HashMap<String, (Option<usize>, String)>,
    frames: HashMap<String, FrameData>,
    /// Data that the programs change, as `name[key]`, or as `name` for all of its elements, each with the line.
    changed: HashMap<String, String>,
    /// Files and names of the variables and parameters of programs, which hide the data.
    own: HashSet<(usize, String)>,
}

impl Reader<'_> {
    fn data(&mut self, file: usize) {
        let source = &self.sources[file];
        let (mut name, mut kind) = (String::new(), String::new());
        for tag in tags(source) {
            let value = |key: &str| {
                let found = tag.attributes.iter().find(|(k, _)| k == key);
                found.map(|(_, span)| String::from_utf8_lossy(source.slice(span)).into_owned())
            };
            let number = |key: &str| -> Option<Number> {
                let (_, span) = tag.attributes.iter().find(|(k, _)| k == key)?;
                Number::parse(file, source, span)
            };
            if tag.name == "Data" {
                (name, kind) = (
                    value("name").unwrap_or_default(),
                    value("type").unwrap_or_default(),
                );
                continue;
            }
            if tag.name != "Value" {
                continue;
            }
            let key = format!("{name}[{}]", value("key").unwrap_or_default());
            let father = value("fatherId").unwrap_or_default();
            let all = |names: &[&str]| -> Option<Vec<Number>> {
                names.iter().map(|n| number(n)).collect()
            };
            let goal = match kind.as_str() {
                "jointRx" => all(&["j1", "j2", "j3", "j4", "j5", "j6"]).map(Goal::Joints),
                "pointRx" => all(&COMPONENTS).map(|n| Goal::pose(&n)),
                "frame" | "tool" => {
                    // A component that is not written is 0.
                    let component = |name: &&str| match value(name) {
                        Some(_) => number(name).map(|n| n.value),
                        None => Some(0.0),
                    };
                    let all: Option<Vec<f64>> = COMPONENTS.iter().map(component).collect();
                    let pose = all.and_then(|v| {
                        let rotation = Orientation::TurnedXyz.rotation(&v[3..])?;
                        Some(Pose {
                            rotation,
                            translation: Vector3::new(v[0], v[1], v[2]) / 1000.0,
                        })
                    });
                    let pose = pose.ok_or("is not written out");
                    let new = FrameData { pose, father };
                    let known = self.frames.entry(key).or_insert_with(|| new.clone());
                    if *known != new {
                        known.pose = Err("is declared in two ways");
                    }
                    continue;
                }
                _ => continue,
            };
            let letters = LETTERS.map(|(key, one, other)| match value(key) {
                Some(text) if text == one => Some(false),
                Some(text) if text == other => Some(true),
                _ => None,
            });
            let is_stated = letters.iter().any(Option::is_some);
            let configuration = is_stated.then(|| Configuration {
                letters,
                ..Configuration::monitored(Vec::new())
            });
            let location = Location { file, at: tag.at };
            let target = goal.filter(|_| source.is_corrected).map(|goal| {
                let target = Target::new(location, goal, configuration);
                self.program.targets.push(target);
                self.program.targets.len() - 1
            });
            if target.is_none() && source.is_corrected {
                self.program
                    .leave(location, "a part of it is not a number, or is not written");
            }
            let targets = [Some((target, father)), self.named.get(&key).cloned()];
            if targets[1].is_some() {
                for target in targets.iter().flatten().filter_map(|(target, _)| *target) {
                    let location = self.program.targets[target].location;
                    self.program.leave(location, "its name is declared twice");
                }
            }
            let [new, _] = targets;
            self.named.extend(new.map(|new| (key, new)));
        }
    }

    /// Notes the motions of a program.
    fn code(&mut self, text: &Text<'_>) -> Result<(), InputError> {
        let all = text.tokens;
        for at in 0..all.len() {
            let way = match text.name(at).as_str() {
                "movej" => Way::Joints,
                "movel" => Way::Line,
                "movec" => Way::Arc,
                _ => continue,
            };
            if !text.is(at + 1, b'(') {
                continue;
            }
            let end = text.find(at + 2, all.len(), b")");
            let arguments = text.arguments(at + 2, end);
            let points = if way == Way::Arc { 2 } else { 1 };
            let Some(tool) = arguments.get(points).copied() else {
                continue;
            };
            for point in arguments.iter().take(points) {
                self.motion(text, *point, tool, way)?;
            }
        }
        Ok(())
    }

    /// Returns `name[key]` of an argument; a name alone stands for its first element.
    fn element(text: &Text<'_>, (from, end): (usize, usize)) -> Option<String> {
        let name = text.spelling(from);
        if end == from + 1 {
            return Some(format!("{name}[0]"));
        }
        let key = text.number(from + 2)?;
        let is_element = text.is(from + 1, b'[') && text.is(from + 3, b']') && end == from + 4;
        is_element.then(|| format!("{name}[{}]", key.value))
    }

    fn motion(
        &mut self,
        text: &Text<'_>,
        point: (usize, usize),
        tool: (usize, usize),
        way: Way,
    ) -> Result<(), InputError> {
        let location = Location {
            file: text.file,
            at: text.byte(point.0),
        };
        let found = self.named_by(text, point);
        if found.is_empty() {
            let quoted = text
                .source
                .quoted(&(text.byte(point.0)..text.byte(point.1)));
            self.program
                .leave(location, format!("its target is computed: {quoted}"));
        }
        for (target, father) in found {
            if let Some(target) = target {
                self.move_to(text, (location, target), &father, tool, way)?;
            }
        }
        Ok(())
    }

    /// Returns the targets that an argument may be, with their frames: all elements of `name[key]` for a computed key.
    fn named_by(
        &self,
        text: &Text<'_>,
        (from, end): (usize, usize),
    ) -> Vec<(Option<usize>, String)> {
        let name = text.spelling(from);
        if self.own.contains(&(text.file, name.clone())) {
            return Vec::new();
        }
        if let Some(key) = Self::element(text, (from, end)) {
            return self.named.get(&key).cloned().into_iter().collect();
        }
        let is_element = text.is(from + 1, b'[') && text.find(from + 2, end, b"]") + 1 == end;
        let all = format!("{name}[");
        let mut keys: Vec<_> = self.named.keys().collect();
        keys.retain(|key| is_element && key.starts_with(&all));
        keys.sort_by_key(|key| (key.len(), (*key).clone()));
        keys.into_iter()
            .map(|key| self.named[key].clone())
            .collect()
    }

    /// Notes a motion to a target.
    fn move_to(
        &mut self,
        text: &Text<'_>,
        (location, target): (Location, usize),
        father: &str,
        tool: (usize, usize),
        way: Way,
    ) -> Result<(), InputError> {
        let is_joints = matches!(self.program.targets[target].goal, Goal::Joints(_));
        let is_own = self.own.contains(&(text.file, text.spelling(tool.0)));
        let tool = match Self::element(text, tool).filter(|_| !is_own) {
            Some(key) => self.frame(text, location.at, &key, true)?,
            None => Err("its tool is computed".to_owned()),
        };
        let tool = match tool {
            // Joints need no tool.
            Err(_) if is_joints => Ok(Frame::own("none", true)),
            tool => tool,
        };
        let base = match is_joints {
            true => self.frame(text, location.at, "world[0]", false)?,
            false => self.frame(text, location.at, father, false)?,
        };
        self.program.move_in(target, way, tool, base);
        Ok(())
    }

    /// Returns a tool or frame, with all frames around it applied.
    fn frame(
        &self,
        text: &Text<'_>,
        at: usize,
        key: &str,
        is_tool: bool,
    ) -> Result<Result<Frame, String>, InputError> {
        let (kind, root) = if is_tool {
            ("tool", "flange[0]")
        } else {
            ("base", "world[0]")
        };
        // A program states no weights.
        let weight = |name: &str| self.given.named(&name.to_lowercase(), is_tool)?.payload_kg;
        let payload_kg = weight(key).or_else(|| weight(key.strip_suffix("[0]")?));
        let mut pose = Pose::identity();
        let mut next = key.to_owned();
        let mut origin = "the program".to_owned();
        for _ in 0..DEEPEST {
            if next == root || next.is_empty() {
                return Ok(Ok(Frame {
                    name: key.to_owned(),
                    is_tool,
                    pose,
                    payload_kg: payload_kg.filter(|_| is_tool),
                    origin,
                }));
            }
            let name = next.split('[').next().unwrap_or("");
            if let Some(line) = self.changed.get(&next).or(self.changed.get(name)) {
                return Ok(Err(format!("the program changes {name} at {line}")));
            }
            let Some(data) = self.frames.get(&next) else {
                let given = self.given.named(&next.to_lowercase(), is_tool);
                let Some(given) = given else {
                    return Err(self.given.unknown(text.source, at, kind, &next, kind));
                };
                origin = self.given.origin();
                pose = given.pose * pose;
                next = root.to_owned();
                continue;
            };
            let own = match data.pose {
                Ok(own) => own,
                Err(reason) => return Ok(Err(format!("{next} {reason}"))),
            };
            pose = own * pose;
            next = data.father.clone();
        }
        Ok(Err(format!("{key} is nested in too many frames")))
    }
}
