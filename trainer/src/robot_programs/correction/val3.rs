//! Reads Stäubli VAL3 data (`.dtx`): joint targets (`jointRx`) and points (`pointRx`) that motions of the programs beside
//! the data use.
//!
//! Angles of points, frames and tools are about x, the new y and the new z. A point is in the frame that its `fatherId`
//! names. The programs (`.pgx`) say with which tool a point is used (`movej(jJoint[0],tTool[0],…)`); they are read but not
//! changed.

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
use crate::robot_programs::dialect::{Orientation, VAL3};

/// Components of points, frames and tools.
const COMPONENTS: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];
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
            let name = tag.attributes.iter().find(|(key, _)| key == "name");
            let name = name.map(|(_, span)| String::from_utf8_lossy(source.slice(span)));
            reader
                .own
                .extend(name.map(|name| (file, name.into_owned())));
        }
    }
    for text in texts() {
        reader.changes(&text);
    }
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
struct FrameData {
    pose: Option<Pose<f64>>,
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

/// A start tag: its name, and the positions of its attributes' values.
struct Tag {
    name: String,
    at: usize,
    attributes: Vec<(String, std::ops::Range<usize>)>,
}

/// Returns the start tags of an XML file, without comments.
fn tags(source: &Source) -> Vec<Tag> {
    let bytes = &source.bytes;
    let mut out = Vec::new();
    let mut at = 0;
    while let Some(open) = bytes[at..].iter().position(|b| *b == b'<').map(|i| at + i) {
        let rest = &bytes[open..];
        if rest.starts_with(b"<!--") {
            let end = rest.windows(3).position(|w| w == b"-->");
            at = open + end.map_or(rest.len(), |end| end + 3);
            continue;
        }
        let is_name = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b':' | b'-');
        let name_end = open + 1 + bytes[open + 1..].iter().take_while(|b| is_name(b)).count();
        let mut tag = Tag {
            name: String::from_utf8_lossy(&bytes[open + 1..name_end]).into_owned(),
            at: open,
            attributes: Vec::new(),
        };
        at = name_end.max(open + 1);
        while let Some(byte) = bytes.get(at) {
            if *byte == b'>' {
                at += 1;
                break;
            }
            let length = bytes[at..].iter().take_while(|b| is_name(b)).count();
            let quote_at = at + length + 1;
            if length > 0
                && bytes.get(at + length) == Some(&b'=')
                && matches!(bytes.get(quote_at), Some(b'"' | b'\''))
            {
                let quote = bytes[quote_at];
                let inside = bytes[quote_at + 1..]
                    .iter()
                    .take_while(|b| **b != quote)
                    .count();
                let span = quote_at + 1..quote_at + 1 + inside;
                let key = String::from_utf8_lossy(&bytes[at..at + length]).into_owned();
                at = (span.end + 1).min(bytes.len());
                tag.attributes.push((key, span));
            } else {
                at += length.max(1);
            }
        }
        if !tag.name.is_empty() {
            out.push(tag);
        }
    }
    out
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
                "pointRx" => all(&COMPONENTS).map(|n| Goal::Pose {
                    position: [n[0], n[1], n[2]],
                    orientation: n[3..].to_vec(),
                }),
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
                    self.frames.insert(key, FrameData { pose, father });
                    continue;
                }
                _ => continue,
            };
            let is_wrist_flipped = match value("wrist").as_deref() {
                Some("wpositive") => Some(false),
                Some("wnegative") => Some(true),
                _ => None,
            };
            let configuration = is_wrist_flipped.map(|is_flipped| Configuration {
                is_wrist_flipped: Some(is_flipped),
                ..Configuration::monitored(Vec::new())
            });
            let location = Location { file, at: tag.at };
            let target = goal.filter(|_| source.is_corrected).map(|goal| {
                self.program.targets.push(Target {
                    location,
                    goal,
                    tool: None,
                    base: None,
                    configuration,
                });
                self.program.targets.len() - 1
            });
            if target.is_none() && source.is_corrected {
                self.program
                    .leave(location, "a part of it is no number, or is not written");
            }
            self.named.insert(key, (target, father));
        }
    }

    /// Notes the data that a program changes: `fPart.trsf=…`, `pPoint[1].trsf.z=…`, `tGun=…`, `setFrame(…,fPart)`, `link(p,f)`.
    fn changes(&mut self, text: &Text<'_>) {
        for at in 1..text.tokens.len() {
            let name = text.name(at);
            if matches!(name.as_str(), "setframe" | "link") && text.is(at + 1, b'(') {
                let end = text.find(at + 2, text.tokens.len(), b")");
                let arguments = text.arguments(at + 2, end);
                let changed = match name.as_str() {
                    "setframe" => arguments.last(),
                    _ => arguments.first(),
                };
                if let Some((from, _)) = changed {
                    self.change(text, *from);
                }
            }
            let is_compared = text.is(at + 1, b'=')
                || [b'=', b'!', b'<', b'>']
                    .iter()
                    .any(|mark| text.is(at - 1, *mark));
            if !text.is(at, b'=') || is_compared {
                continue;
            }
            // The name stands before its key and its components.
            let (mut from, mut depth) = (at, 0_usize);
            while from > 0 {
                from -= 1;
                depth += usize::from(text.is(from, b']'));
                depth = depth.saturating_sub(usize::from(text.is(from, b'[')));
                let is_component = from > 0 && text.is(from - 1, b'.');
                let is_name = text.at(from).is_some_and(|t| t.kind == Kind::Name);
                if depth == 0 && is_name && !is_component {
                    break;
                }
            }
            self.change(text, from);
        }
    }

    /// Notes that a program changes the data that are named at a token.
    fn change(&mut self, text: &Text<'_>, from: usize) {
        let behind = match text.is(from + 1, b'[') {
            true => text.find(from + 2, text.tokens.len(), b"]") + 1,
            false => from + 1,
        };
        let name = Self::element(text, (from, behind)).unwrap_or_else(|| text.spelling(from));
        let location = Location {
            file: text.file,
            at: text.byte(from),
        };
        let line = self.program.line_of(location);
        if let Some((Some(target), _)) = self.named.get(&name) {
            let location = self.program.targets[*target].location;
            let reason = format!("the program changes it at {line}");
            self.program.leave(location, reason);
        }
        let all = format!("{name}[");
        for (key, (target, _)) in &self.named {
            if let Some(target) = target.filter(|_| key.starts_with(&all)) {
                let location = self.program.targets[target].location;
                let reason = format!("the program changes one of {name} at {line}");
                self.program.leave(location, reason);
            }
        }
        self.changed.entry(name).or_insert(line);
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
            Err(_) if is_joints => Ok(Frame {
                name: "none".to_owned(),
                is_tool: true,
                pose: Pose::identity(),
                payload_kg: None,
                origin: "the controller".to_owned(),
            }),
            tool => tool,
        };
        let target_at = self.program.targets[target].location;
        let base = match is_joints {
            true => self.frame(text, location.at, "world[0]", false)?,
            false => self.frame(text, location.at, father, false)?,
        };
        match (tool, base) {
            (Ok(tool), Ok(base)) => {
                let (tool, base) = (self.program.frame(tool), self.program.frame(base));
                self.program.move_to(target, way, tool, base);
            }
            (Err(reason), _) | (_, Err(reason)) => self.program.leave(target_at, reason),
        }
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
        let mut pose = Pose::identity();
        let mut next = key.to_owned();
        let mut origin = "the program".to_owned();
        for _ in 0..DEEPEST {
            if next == root || next.is_empty() {
                return Ok(Ok(Frame {
                    name: key.to_owned(),
                    is_tool,
                    pose,
                    payload_kg: None,
                    origin,
                }));
            }
            let name = next.split('[').next().unwrap_or("");
            if let Some(line) = self.changed.get(&next).or(self.changed.get(name)) {
                return Ok(Err(format!("the program changes {name} at {line}")));
            }
            let Some(data) = self.frames.get(&next) else {
                let lower = next.to_ascii_lowercase();
                let given = if is_tool {
                    self.given.tool(&lower)
                } else {
                    self.given.base(&lower)
                };
                let Some(given) = given else {
                    return Err(self.given.unknown(text.source, at, kind, &next, kind));
                };
                origin = self.given.origin();
                pose = given.pose * pose;
                next = root.to_owned();
                continue;
            };
            let Some(own) = data.pose else {
                return Ok(Err(format!("{next} is not written out")));
            };
            pose = own * pose;
            next = data.father.clone();
        }
        Ok(Err(format!("{key} stands in too many frames")))
    }
}

/// Returns whether a token is in a comment, from `//` to the end of the line.
fn is_comment(source: &Source, token: &Token) -> bool {
    let before = &source.bytes[..token.start as usize];
    let start = before
        .iter()
        .rposition(|b| matches!(b, b'\n' | b'\r'))
        .map_or(0, |i| i + 1);
    before[start..].windows(2).any(|w| w == b"//")
}
