//! Reads KUKA KRL: points of a data list, and points that are written in a motion of the source.
//!
//! Tool and base of a motion are those of its frame data (`FDAT_ACT=FP1`, `STOOL2(FP1)`), or those that `$TOOL`, `$BASE` and
//! `BAS` have set before. Their values are `TOOL_DATA[n]` and `BASE_DATA[n]` in the program, in files beside it or in a
//! frame file. Points with missing components, relative motions and computed points are left as they are. ("Operating and
//! Programming Instructions for System Integrators", KSS 8.)

mod motion;

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{
    Configuration, Goal, Location, Program, Target, Way, of_sign,
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
    let files = copies.iter().zip(&tokens).enumerate();
    let texts: Vec<Text<'_>> = files
        .map(|(file, (source, tokens))| Text {
            file,
            source,
            tokens,
        })
        .collect();
    let mut reader = Reader {
        program: Program::new("KUKA KRL", Language::Krl.dialect(), sources),
        texts,
        given: frames,
        points: HashMap::new(),
        frame_data: HashMap::new(),
        numbered: BTreeMap::new(),
    };
    for file in 0..reader.texts.len() {
        for (from, end) in lines(&reader.texts[file]) {
            reader.declare(file, from, end);
        }
    }
    for file in 0..reader.texts.len() {
        if reader.texts[file].source.is_corrected {
            let mut state = State::default();
            for (from, end) in lines(&reader.texts[file]) {
                reader.line(file, from, end, &mut state)?;
            }
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

/// A tool or base as a line names it.
#[derive(Clone, Debug, PartialEq)]
enum Named {
    /// Number of the tool or base.
    Number(u32),
    /// Pose that is written in the line.
    Written(Pose<f64>),
    /// The tool or base is not known, for this reason.
    Unknown(String),
}

/// Frame data of a motion: tool, base, and whether the robot holds the part.
#[derive(Clone, Debug)]
struct FrameData {
    tool: Named,
    base: Named,
    is_fixed_tool: bool,
}

/// State of the program at a line.
#[derive(Debug, Default)]
struct State {
    tool: Option<Named>,
    base: Option<Named>,
    is_fixed_tool: bool,
    /// Index of the previous move, as long as nothing else may have moved the arm since.
    before: Option<usize>,
}

struct Reader<'a> {
    program: Program,
    texts: Vec<Text<'a>>,
    given: &'a FrameFile,
    /// Targets of points by name; `None` for points that are left as they are.
    points: HashMap<String, Option<usize>>,
    frame_data: HashMap<String, FrameData>,
    /// Values of `TOOL_DATA` (true) and `BASE_DATA` (false) by number.
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
                out.insert(text.name(a), if b == a + 2 { a + 1 } else { usize::MAX });
            }
        }
        Some(out)
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
        let (mut configuration, goal);
        if let Some(n) = self.all_of(file, &map, &joints) {
            (configuration, goal) = (None, Goal::Joints(n));
        } else if let Some(n) = self.all_of(file, &map, &["x", "y", "z", "a", "b", "c"]) {
            goal = Goal::Pose {
                position: [n[0], n[1], n[2]],
                orientation: n[3..].to_vec(),
            };
            configuration = None;
            if let Some([turn]) = self.all_of(file, &map, &["t"]).as_deref() {
                configuration = Some(turns(turn.value as u32));
            }
        } else {
            return Err(
                "components that it does not name stay as they are, or are computed".to_owned(),
            );
        }
        Ok(Target {
            location: self.location(file, from),
            goal,
            tool: None,
            base: None,
            configuration,
        })
    }

    /// Returns the index n of an element `NAME[n]`, and the token behind it.
    fn element(&self, file: usize, at: usize) -> Option<(u32, usize)> {
        let text = self.texts[file];
        let number = text.number(at + 2)?;
        (text.is(at + 1, b'[') && text.is(at + 3, b']')).then_some((number.value as u32, at + 4))
    }

    /// Notes the points, frame data and frames that a line declares or sets.
    fn declare(&mut self, file: usize, from: usize, end: usize) {
        let text = self.texts[file];
        let mut at = from;
        let is_declared = matches!(text.name(from).as_str(), "decl" | "global" | "const");
        while matches!(text.name(at).as_str(), "decl" | "global" | "const") {
            at += 1;
        }
        let kind = text.name(at);
        let is_type = matches!(
            kind.as_str(),
            "e6pos" | "pos" | "e6axis" | "axis" | "frame" | "fdat"
        );
        if is_type && text.is(at + 2, b'=') {
            let name = text.name(at + 1);
            if kind == "fdat" {
                let data = self.frame_data_of(file, at + 3, end);
                self.frame_data.insert(name, data);
                return;
            }
            let point = self.point(file, at + 3, end);
            let location = self.location(file, at + 3);
            let index = match point {
                Ok(point) if text.source.is_corrected && kind != "frame" => {
                    self.program.targets.push(point);
                    Some(self.program.targets.len() - 1)
                }
                Err(reason) if text.source.is_corrected && kind != "frame" => {
                    self.program.leave(location, reason);
                    None
                }
                _ => None,
            };
            self.points.insert(name, index);
        } else if matches!(kind.as_str(), "tool_data" | "base_data")
            && let Some((number, behind)) = self.element(file, at)
        {
            let is_tool = kind == "tool_data";
            let line = self.program.line_of(self.location(file, at));
            let found = match text.is(behind, b'=') {
                true => self
                    .pose(file, behind + 1, end)
                    .ok_or(format!("it is computed at {line}")),
                false => Err(format!("it is changed at {line}")),
            };
            let other = self
                .numbered
                .get(&(is_tool, number))
                .is_some_and(|old| *old != found);
            let found = if other && !text.source.is_corrected {
                // The values of the program itself take precedence.
                return;
            } else if other && !is_declared {
                Err(format!("it is set again at {line}"))
            } else {
                found
            };
            self.numbered.insert((is_tool, number), found);
        } else if !is_declared
            && let Some(Some(index)) = self.points.get(&kind).copied()
            && (text.is(at + 1, b'=') || text.is(at + 1, b'.'))
        {
            let line = self.program.line_of(self.location(file, at));
            let location = self.program.targets[index].location;
            self.program
                .leave(location, format!("the program changes it at {line}"));
        }
    }

    fn frame_data_of(&self, file: usize, from: usize, end: usize) -> FrameData {
        let text = self.texts[file];
        let map = self.components(file, from, end).unwrap_or_default();
        let number = |name: &str| {
            let found = map.get(name).and_then(|at| text.number(*at));
            found.map_or(
                Named::Unknown("its frame data are computed".to_owned()),
                |n| Named::Number(n.value as u32),
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
        file: usize,
        from: usize,
        end: usize,
        state: &mut State,
    ) -> Result<(), InputError> {
        let text = self.texts[file];
        let name = text.name(from);
        let equals = text.is(from + 1, b'=');
        let before = state.before.take();
        if stays(&name) {
            state.before = before;
        }
        match name.as_str() {
            "def" | "deffct" | "global" => *state = State::default(),
            "fdat_act" if equals => {
                let data = match text.is(from + 2, b'{') {
                    true => Some(self.frame_data_of(file, from + 2, end)),
                    false => self.frame_data.get(&text.name(from + 2)).cloned(),
                };
                self.take(state, data);
            }
            "$tool" | "$base" if equals => {
                let is_tool = name == "$tool";
                let list = if is_tool { "tool_data" } else { "base_data" };
                let found = match (self.element(file, from + 2), text.name(from + 2)) {
                    (Some((number, behind)), data) if data == list && behind == end => {
                        Named::Number(number)
                    }
                    (_, data) if data == "$nullframe" => Named::Number(0),
                    _ => match self.pose(file, from + 2, end) {
                        Some(pose) => Named::Written(pose),
                        None => Named::Unknown(format!("{name} is computed")),
                    },
                };
                *(if is_tool {
                    &mut state.tool
                } else {
                    &mut state.base
                }) = Some(found);
            }
            "$tool" | "$base" => {
                let found = Named::Unknown(format!("{name} is changed in part"));
                *(if name == "$tool" {
                    &mut state.tool
                } else {
                    &mut state.base
                }) = Some(found);
            }
            "$ipo_mode" if equals => state.is_fixed_tool = text.name(from + 2) == "#tcp",
            "bas" if text.is(from + 1, b'(') => {
                let number = text.number(from + 4).map(|n| Named::Number(n.value as u32));
                match text.name(from + 2).as_str() {
                    "#tool" => state.tool = number.or(state.tool.take()),
                    "#base" => state.base = number.or(state.base.take()),
                    _ => {}
                }
            }
            "ptp" | "sptp" => self.motion(file, from, end, Way::Joints, state)?,
            "lin" | "slin" => {
                let first = self.program.moves.len();
                self.motion(file, from, end, Way::Line, state)?;
                self.note_line(file, (from, end), before.filter(|step| step + 1 == first));
            }
            "circ" | "scirc" => self.motion(file, from, end, Way::Arc, state)?,
            "ptp_rel" | "lin_rel" | "circ_rel" | "sptp_rel" | "slin_rel" | "scirc_rel" | "spl"
            | "asyptp" => {
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

    fn take(&self, state: &mut State, data: Option<FrameData>) {
        let unknown = || Named::Unknown("its frame data are in none of the files".to_owned());
        let (tool, base, is_fixed) = match data {
            Some(data) => (data.tool, data.base, data.is_fixed_tool),
            None => (unknown(), unknown(), false),
        };
        (state.tool, state.base, state.is_fixed_tool) = (Some(tool), Some(base), is_fixed);
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

/// Returns the configuration from the turn bits of a point, which are the signs of the joints.
fn turns(bits: u32) -> Configuration {
    let bound = |joint: usize| of_sign(joint, bits >> joint & 1 == 1);
    Configuration::monitored((0..6).map(bound).collect())
}
