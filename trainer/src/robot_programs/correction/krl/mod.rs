//! Reads KUKA KRL: points of a data list, and points that are written in a motion of the source.
//!
//! Tool and base of a motion are those of its frame data (`FDAT_ACT=FP1`, `STOOL2(FP1)`), or those that `$TOOL`, `$BASE` and
//! `BAS` have set before, on every way to it. Their values are `TOOL_DATA[n]` and `BASE_DATA[n]` in the program, in files beside it or in a
//! frame file. Points with missing components, relative motions and computed points are left as they are. ("Operating and
//! Programming Instructions for System Integrators", KSS 8.)

mod changes;
mod data;
mod folds;
mod motion;
mod names;
mod points;
mod routines;
mod states;
mod steps;

use std::collections::{BTreeMap, BTreeSet};

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::krl::names::Names;
use crate::robot_programs::correction::krl::states::{Declared, Line, Named, States};
use crate::robot_programs::correction::program::{Goal, Location, Program, Target, Way};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, tokens};
use crate::robot_programs::correction::unfound;

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
        loads: BTreeMap::new(),
        moved: BTreeMap::new(),
        has_loads: false,
        external: BTreeMap::new(),
    };
    reader.external = reader.external_axes();
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
    let unfound = reader.unfound(&all);
    unfound::note(&mut reader.program, unfound);
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
    /// An array, whose elements have names of their own: `p[1]`.
    Array,
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
    numbered: BTreeMap<(bool, u32), Declared<Pose<f64>>>,
    /// Masses of `LOAD_DATA` in kg by number.
    loads: BTreeMap<u32, Declared<f64>>,
    /// Bases that an external kinematic moves, each with the line that says so.
    moved: BTreeMap<u32, String>,
    /// Whether the code sets `$LOAD`.
    has_loads: bool,
    /// External axes that anything moves from zero, each with a line.
    external: BTreeMap<String, String>,
}

impl Reader<'_> {
    fn location(&self, file: usize, token: usize) -> Location {
        Location {
            file,
            at: self.texts[file].byte(token),
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
            if kind == "frame" {
                let pose = self.pose(file, at + 3, end);
                self.named_frames.add(name.clone(), file, is_global, pose);
                self.points.add(name, file, is_global, Point::Unset);
            } else {
                self.declare_point(name, (file, is_global), at + 3, end);
            }
        } else if is_type && kind != "fdat" {
            // DECL E6POS XP1, XP2[5]
            for (from, _) in text.arguments(at + 1, end) {
                let point = match text.is(from + 1, b'[') && kind != "frame" {
                    true => Point::Array,
                    false => Point::Unset,
                };
                self.points.add(text.name(from), file, is_global, point);
            }
        } else if !self.is_code(file)
            && let Some((number, behind)) = self.element(file, at)
            && text.is(behind, b'=')
            && matches!(self.points.find(&kind, file), Some(Point::Array))
        {
            self.declare_point(
                format!("{kind}[{number}]"),
                (file, is_global),
                behind + 1,
                end,
            );
        } else {
            self.declare_numbered(line);
        }
    }

    /// Notes a point with its value.
    fn declare_point(
        &mut self,
        name: String,
        (file, is_global): (usize, bool),
        from: usize,
        end: usize,
    ) {
        let is_corrected = self.texts[file].source.is_corrected;
        let point = match self.point(file, from, end) {
            Ok(point) if is_corrected => self.add_target(point),
            Ok(point) if matches!(point.goal, Goal::Joints(_)) => {
                let point = self.add_target(point);
                self.program.fixed.insert(self.program.targets.len() - 1);
                point
            }
            _ if !is_corrected => Point::Elsewhere,
            Ok(_) => Point::Unset,
            Err(reason) => {
                let location = self.location(file, from);
                self.program.leave(location, reason);
                Point::Left
            }
        };
        self.points.add(name, file, is_global, point);
    }

    fn add_target(&mut self, target: Target) -> Point {
        self.program.targets.push(target);
        Point::Target(self.program.targets.len() - 1)
    }

    /// Returns the name of the point at a token, `p[1]` for an element of an array, and the token behind it. An element
    /// whose index is computed has no name.
    fn point_name(&self, file: usize, at: usize) -> Option<(String, usize)> {
        let text = self.texts[file];
        match text.is(at + 1, b'[') {
            true => {
                let (number, behind) = self.element(file, at)?;
                Some((format!("{}[{number}]", text.name(at)), behind))
            }
            false => Some((text.name(at), at + 1)),
        }
    }

    /// Returns the targets that the datum at a token may be, each of an array whose index is computed.
    fn targets_at(&self, file: usize, at: usize) -> Vec<usize> {
        let array = || self.points.elements(&self.texts[file].name(at));
        let names = match self.point_name(file, at) {
            Some((name, _)) if !matches!(self.points.find(&name, file), Some(Point::Array)) => {
                vec![name]
            }
            _ => array(),
        };
        let found = names.iter().filter_map(|name| self.points.find(name, file));
        let target = |point: &Point| match point {
            Point::Target(index) => Some(*index),
            _ => None,
        };
        found.filter_map(target).collect()
    }

    /// Returns whether a file has instructions; others declare data.
    fn is_code(&self, file: usize) -> bool {
        let ending = self.texts[file].source.path.extension();
        ending.is_some_and(|ending| ending.eq_ignore_ascii_case("src"))
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
