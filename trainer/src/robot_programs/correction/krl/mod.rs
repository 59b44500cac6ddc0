//! Reads KUKA KRL: points of a data list, and points that are written in a motion of the source.
//!
//! Tool and base of a motion are those of its frame data (`FDAT_ACT=FP1`, `STOOL2(FP1)`), or those that `$TOOL`, `$BASE` and
//! `BAS` have set before, on every way to it. Their values are `TOOL_DATA[n]` and `BASE_DATA[n]` in the program, in files beside it or in a
//! frame file. Points with missing components, relative motions and computed points are left as they are. ("Operating and
//! Programming Instructions for System Integrators", KSS 8.)

mod changes;
mod motion;
mod names;
mod states;
mod steps;

use std::collections::{BTreeMap, BTreeSet, HashMap};

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::krl::names::Names;
use crate::robot_programs::correction::krl::states::{Line, Named, States};
use crate::robot_programs::correction::program::{
    Configuration, Convention, Goal, Location, Posture, Program, Says, Stated, Target, Way, of_sign,
};
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, tokens};
use crate::robot_programs::dialect::Orientation;

const LEXICON: Lexicon = Lexicon {
    comment: b';',
    quotes: b"\"",
    in_names: b"$#",
    has_pairs: true,
};

/// Reads a source with its data list, and the files whose frames it uses.
///
/// # Errors
/// [`InputError`] for a frame that is nowhere.
pub fn read(sources: Vec<Source>, frames: &FrameFile) -> Result<Program, InputError> {
    let copies = sources.clone();
    let tokens: Vec<Vec<Token>> = copies.iter().map(|s| tokens(&s.bytes, &LEXICON)).collect();
    let texts = Text::of_files(&copies, &tokens);
    let mut reader = Reader {
        program: Program::new("KUKA KRL", Language::Krl.dialect(), sources),
        texts,
        given: frames,
        points: Names::new(&copies),
        frame_data: Names::new(&copies),
        named_frames: Names::new(&copies),
        changing: BTreeSet::new(),
        numbered: BTreeMap::new(),
    };
    let mut all = Vec::new();
    for (file, text) in reader.texts.iter().enumerate() {
        let lines = lines(text).into_iter();
        all.extend(lines.map(|(from, end)| Line { file, from, end }));
    }
    for line in &all {
        reader.declare(*line);
    }
    for line in &all {
        reader.note_change(*line);
    }
    let states = reader.states(&all);
    let mut before = None;
    for (line, step) in all.iter().zip(&states.steps) {
        if reader.texts[line.file].source.is_corrected {
            reader.line(*line, (&states, *step), &mut before)?;
        }
    }
    Ok(reader.program)
}

/// Returns the token ranges of the lines that are not empty.
fn lines(text: &Text<'_>) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut from = 0;
    for at in 0..=text.tokens.len() {
        if text.at(at).is_none_or(|token| token.kind == Kind::LineEnd) {
            if at > from {
                out.push((from, at));
            }
            from = at + 1;
        }
    }
    out
}

/// Frame data of a motion: tool, base, and whether the robot holds the part.
#[derive(Clone, Debug)]
struct FrameData {
    tool: Named,
    base: Named,
    is_fixed_tool: bool,
}

/// A declared point.
#[derive(Clone, Copy, Debug)]
enum Point {
    /// Index of its target.
    Target(usize),
    /// It is left as it is, for a reason that is said.
    Left,
    /// It is in a file that is not corrected.
    Elsewhere,
    /// Its declaration has no value.
    Unset,
}

struct Reader<'a> {
    program: Program,
    texts: Vec<Text<'a>>,
    given: &'a FrameFile,
    points: Names<Point>,
    frame_data: Names<FrameData>,
    /// Values of frames by name; `None` for those that are computed or that the program changes.
    named_frames: Names<Option<Pose<f64>>>,
    /// Routines that change what their caller gives them.
    changing: BTreeSet<String>,
    /// Values of `TOOL_DATA` (true) and `BASE_DATA` (false) by number, as data lists declare them.
    numbered: BTreeMap<(bool, u32), Result<Pose<f64>, String>>,
}

impl Reader<'_> {
    fn location(&self, file: usize, token: usize) -> Location {
        Location {
            file,
            at: self.texts[file].byte(token),
        }
    }

    /// Returns the components of a list in braces: the token of each value by the component's name.
    fn components(&self, file: usize, from: usize, end: usize) -> Option<HashMap<String, usize>> {
        let text = self.texts[file];
        if !text.is(from, b'{') || text.find(from + 1, end, b"}") + 1 != end {
            return None;
        }
        // The type may come first: {E6POS: X 1, …}
        let colon = (from + 1..end).find(|at| text.is(*at, b':'));
        let first = colon
            .filter(|at| *at <= from + 2)
            .map_or(from + 1, |at| at + 1);
        let mut out = HashMap::new();
        for (a, b) in text.arguments(first, end - 1) {
            if b >= a + 2 {
                // A component of more than one token is computed, or a list.
                let is_bits = text.is(a + 1, b'\'') && text.is(b - 1, b'\'');
                let at = if b == a + 2 || is_bits {
                    a + 1
                } else {
                    usize::MAX
                };
                out.insert(text.name(a), at);
            }
        }
        Some(out)
    }

    /// Returns a number of bits, and whether it is written as such: `35` or `'B100011'`.
    fn bits(&self, file: usize, at: usize) -> Option<(Number, bool)> {
        let text = self.texts[file];
        if !text.is(at, b'\'') {
            return text.number(at).map(|number| (number, false));
        }
        let start = text.byte(at + 1);
        let written = start..text.byte(text.find(at + 1, at + 4, b"'"));
        let written = text.source.slice(&written).trim_ascii_end();
        let digits = written.strip_prefix(b"B").or(written.strip_prefix(b"b"))?;
        let digits = std::str::from_utf8(digits).ok()?.trim_start();
        let end = start + written.len();
        let number = Number {
            file: file as u32,
            start: (end - digits.len()) as u32,
            end: end as u32,
            value: u32::from_str_radix(digits, 2).ok()?.into(),
        };
        Some((number, true))
    }

    fn all_of(
        &self,
        file: usize,
        map: &HashMap<String, usize>,
        names: &[&str],
    ) -> Option<Vec<Number>> {
        let number = |name: &&str| map.get(*name).and_then(|at| self.texts[file].number(*at));
        names.iter().map(number).collect()
    }

    fn pose(&self, file: usize, from: usize, end: usize) -> Option<Pose<f64>> {
        let map = self.components(file, from, end)?;
        let n = self.all_of(file, &map, &["x", "y", "z", "a", "b", "c"])?;
        let n: Vec<f64> = n.iter().map(|n| n.value).collect();
        Some(Pose {
            rotation: Orientation::TurnedZyx.rotation(&n[3..])?,
            translation: Vector3::new(n[0], n[1], n[2]) / 1000.0,
        })
    }

    /// Reads a written point; the error says why it cannot be corrected.
    fn point(&self, file: usize, from: usize, end: usize) -> Result<Target, String> {
        let map = self
            .components(file, from, end)
            .ok_or("a part of it is computed")?;
        for (name, at) in &map {
            let is_external = name.len() == 2 && name.starts_with('e');
            let value = self.texts[file].number(*at).map(|n| n.value);
            if is_external && value != Some(0.0) {
                return Err("it has external axes".to_owned());
            }
        }
        let joints: Vec<String> = (1..=6).map(|i| format!("a{i}")).collect();
        let joints: Vec<&str> = joints.iter().map(String::as_str).collect();
        let (configuration, goal);
        if let Some(n) = self.all_of(file, &map, &joints) {
            (configuration, goal) = (None, Goal::Joints(n));
        } else if let Some(n) = self.all_of(file, &map, &["x", "y", "z", "a", "b", "c"]) {
            goal = Goal::pose(&n);
            let turn = map.get("t").and_then(|at| self.bits(file, *at));
            let status = map.get("s").and_then(|at| self.bits(file, *at));
            configuration = Some(configured(turn, status.map(|(status, _)| status)));
        } else {
            let is_axes = joints.iter().any(|name| map.contains_key(*name));
            let pose = ["x", "y", "z", "a", "b", "c"];
            let needed = if is_axes { &joints[..] } else { &pose };
            return Err(self.not_whole(file, &map, needed));
        }
        Ok(Target::new(self.location(file, from), goal, configuration))
    }

    /// Returns the reason why a point without all of these numbers is left.
    fn not_whole(&self, file: usize, map: &HashMap<String, usize>, needed: &[&str]) -> String {
        let named = |all: Vec<&str>| all.join(", ").to_ascii_uppercase();
        let is_missing = |name: &&str| !map.contains_key(*name);
        let missing: Vec<&str> = needed.iter().copied().filter(is_missing).collect();
        match missing.len() {
            0 => {
                let is_number = |name: &str| self.texts[file].number(map[name]).is_some();
                let other = needed.iter().copied().find(|name| !is_number(name));
                let other = other.unwrap_or_default().to_ascii_uppercase();
                format!("{other} is not a plain number")
            }
            1 => format!(
                "{} is missing, so the controller keeps the previous value",
                named(missing)
            ),
            _ => format!(
                "{} are missing, so the controller keeps the previous values",
                named(missing)
            ),
        }
    }

    /// Returns the index n of an element `NAME[n]`, and the token behind it.
    fn element(&self, file: usize, at: usize) -> Option<(u32, usize)> {
        let text = self.texts[file];
        let number = text.number(at + 2)?;
        (text.is(at + 1, b'[') && text.is(at + 3, b']')).then_some((number.value as u32, at + 4))
    }

    /// Returns the first token of a line behind the words of a declaration, and whether one of them is `GLOBAL`.
    fn declared(&self, line: Line) -> (usize, bool) {
        let text = self.texts[line.file];
        let is_word = |at: &usize| matches!(text.name(*at).as_str(), "decl" | "global" | "const");
        let prefixes = (line.from..line.end).take_while(is_word);
        let is_global = prefixes.clone().any(|at| text.name(at) == "global");
        (line.from + prefixes.count(), is_global)
    }

    /// Notes the points, frame data and frames that a line declares.
    fn declare(&mut self, line: Line) {
        let Line { file, end, .. } = line;
        let text = self.texts[file];
        let (at, is_global) = self.declared(line);
        let kind = text.name(at);
        if matches!(kind.as_str(), "def" | "deffct") {
            let open = text.find(at, end, b"(");
            let parameters = text.arguments(open + 1, text.find(open + 1, end, b")"));
            // A parameter is that of the caller (OUT), unless IN is written.
            let is_in = |(from, end): &(usize, usize)| {
                (*from..*end).any(|at| text.is(at, b':') && text.name(at + 1) == "in")
            };
            if !parameters.iter().all(is_in) {
                self.changing.insert(text.name(open - 1));
            }
            return;
        }
        let is_type = matches!(
            kind.as_str(),
            "e6pos" | "pos" | "e6axis" | "axis" | "frame" | "fdat"
        );
        if is_type && text.is(at + 2, b'=') {
            let name = text.name(at + 1);
            if kind == "fdat" {
                let data = self.frame_data_of(file, at + 3, end);
                self.frame_data.add(name, file, is_global, data);
                return;
            }
            let point = self.point(file, at + 3, end);
            let location = self.location(file, at + 3);
            let point = match point {
                _ if kind == "frame" => {
                    let pose = self.pose(file, at + 3, end);
                    self.named_frames.add(name.clone(), file, is_global, pose);
                    Point::Unset
                }
                Ok(point) if !text.source.is_corrected && matches!(point.goal, Goal::Joints(_)) => {
                    self.program.targets.push(point);
                    let index = self.program.targets.len() - 1;
                    self.program.fixed.insert(index);
                    Point::Target(index)
                }
                _ if !text.source.is_corrected => Point::Elsewhere,
                Ok(point) => {
                    self.program.targets.push(point);
                    Point::Target(self.program.targets.len() - 1)
                }
                Err(reason) => {
                    self.program.leave(location, reason);
                    Point::Left
                }
            };
            self.points.add(name, file, is_global, point);
        } else if is_type && kind != "fdat" {
            // DECL E6POS XP1, XP2
            for (from, _) in text.arguments(at + 1, end) {
                self.points
                    .add(text.name(from), file, is_global, Point::Unset);
            }
        } else if !self.is_code(file)
            && let Some((is_tool, number, found)) = self.numbered_frame(line)
        {
            let line = self.program.line_of(self.location(file, at));
            match self.numbered.get(&(is_tool, number)) {
                // The values of the program itself take precedence.
                Some(old) if *old != found && text.source.is_corrected => {
                    let again = Err(format!("it is set again at {line}"));
                    self.numbered.insert((is_tool, number), again);
                }
                Some(_) => {}
                None => {
                    self.numbered.insert((is_tool, number), found);
                }
            }
        }
    }

    /// Returns the number and the value of the tool (true) or base that a line `TOOL_DATA[n]=…` sets.
    fn numbered_frame(&self, line: Line) -> Option<(bool, u32, Result<Pose<f64>, String>)> {
        let text = self.texts[line.file];
        let (at, _) = self.declared(line);
        let is_tool = match text.name(at).as_str() {
            "tool_data" => true,
            "base_data" => false,
            _ => return None,
        };
        let (number, behind) = self.element(line.file, at)?;
        let pose = match text.is(behind, b'=') {
            true => self.pose(line.file, behind + 1, line.end),
            false => None,
        };
        let at_line = self.program.line_of(self.location(line.file, at));
        Some((
            is_tool,
            number,
            pose.ok_or(format!("it is computed at {at_line}")),
        ))
    }

    /// Returns whether a file has instructions; others declare data.
    fn is_code(&self, file: usize) -> bool {
        let ending = self.texts[file].source.path.extension();
        ending.is_some_and(|ending| ending.eq_ignore_ascii_case("src"))
    }

    fn frame_data_of(&self, file: usize, from: usize, end: usize) -> FrameData {
        let text = self.texts[file];
        let map = self.components(file, from, end).unwrap_or_default();
        let number = |name: &str| {
            let found = map.get(name).and_then(|at| text.number(*at));
            found.map_or(
                Named::Unknown("its frame data are computed".to_owned()),
                |n| Named::number(n.value),
            )
        };
        let is_fixed_tool = map
            .get("ipo_frame")
            .is_some_and(|at| text.name(*at) == "#tcp");
        FrameData {
            tool: number("tool_no"),
            base: number("base_no"),
            is_fixed_tool,
        }
    }

    fn line(
        &mut self,
        line: Line,
        states: (&States, usize),
        state: &mut Option<usize>,
    ) -> Result<(), InputError> {
        let Line { file, from, end } = line;
        let text = self.texts[file];
        let name = text.name(from);
        let before = state.take();
        if stays(&name) {
            *state = before;
        }
        match name.as_str() {
            "ptp" | "sptp" => *state = self.motion(line, Way::Joints, states)?,
            "lin" | "slin" => {
                let first = self.program.moves.len();
                *state = self.motion(line, Way::Line, states)?;
                self.note_line(file, (from, end), before.filter(|step| step + 1 == first));
            }
            // The path of a spline is not checked.
            "spl" => _ = self.motion(line, Way::Joints, states)?,
            "circ" | "scirc" => *state = self.motion(line, Way::Arc, states)?,
            "ptp_rel" | "lin_rel" | "circ_rel" | "sptp_rel" | "slin_rel" | "scirc_rel"
            | "spl_rel" | "asyptp" => {
                let location = self.location(file, from);
                self.program.leave(
                    location,
                    format!("{} is not corrected", text.spelling(from)),
                );
            }
            _ => {}
        }
        Ok(())
    }
}

/// Returns whether a line of this name leaves the arm where it is, so that the next move begins where the last one ended.
fn stays(name: &str) -> bool {
    matches!(
        name,
        "pdat_act"
            | "fdat_act"
            | "ldat_act"
            | "bas"
            | "set_cd_params"
            | "wait"
            | "$bwdstart"
            | "$h_pos"
    ) || [
        "$vel",
        "$acc",
        "$apo",
        "$ori_type",
        "$out",
        "$anout",
        "$advance",
        "$tool",
        "$base",
    ]
    .iter()
    .any(|start| name.starts_with(start))
}

/// Returns the configuration from the turn bits of a point, which are the signs of the joints, and from its status, which has
/// the sides. Without them the controller keeps those of the point before.
fn configured(turn: Option<(Number, bool)>, status: Option<Number>) -> Configuration {
    let mut out = Configuration::monitored(Vec::new());
    if let Some((number, is_binary)) = turn {
        let bits = number.value as u32;
        let bound = |joint: usize| of_sign(joint, bits >> joint & 1 == 1);
        out.bounds = (0..6).map(bound).collect();
        let says = Says::Signs { is_binary };
        out.stated.push(Stated { number, says });
    }
    out.posture = status.map(|status| Posture {
        convention: Convention::Status,
        bits: status.value as u32,
        is_certain: true,
    });
    out
}
