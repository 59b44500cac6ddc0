//! The contents of a program as its reader found them: targets with their frames and tools, and what cannot be corrected.

use std::collections::{BTreeSet, HashMap};

use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::seeds::Seeds;
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::dialect::Dialect;

/// Position of a byte in the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Location {
    /// Index of the file.
    pub file: usize,
    /// Index of the byte in the file.
    pub at: usize,
}

/// The numbers of a target.
#[derive(Clone, Debug, PartialEq)]
pub enum Goal {
    /// Joints in the unit of the language.
    Joints(Vec<Number>),
    /// A pose of the tool in its base.
    Pose {
        /// Position x, y, z.
        position: [Number; 3],
        /// Orientation in the notation of the language.
        orientation: Vec<Number>,
    },
}

impl Goal {
    /// Creates a pose of three numbers for the position and the others for the orientation.
    pub fn pose(numbers: &[Number]) -> Self {
        Self::Pose {
            position: [numbers[0], numbers[1], numbers[2]],
            orientation: numbers[3..].to_vec(),
        }
    }
}

/// Index of the joint at whose zero the wrist of a six-axis arm is singular.
pub const WRIST: usize = 4;

/// Index of a joint, and the lower and upper end in rad of the range that a configuration leaves it.
pub type Bound = (usize, f64, f64);

/// What a number of a configuration says of the joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Says {
    /// Quarter turn in which a joint is.
    Quarter(usize),
    /// Number of whole turns, of which a joint is within half a turn.
    Turn(usize),
    /// Signs of the joints as bits, of joint 1 as the lowest.
    Signs {
        /// Base in which the bits are written.
        radix: u32,
    },
}

/// A number of a configuration that follows from the joints, so that it changes where a correction takes a joint over a
/// boundary: with the old number, the controller would go a whole turn round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stated {
    /// The number.
    pub number: Number,
    /// What it says.
    pub says: Says,
}

impl Stated {
    /// Returns the number at the joints `to`, in rad. What did not fit the joints `from` stays.
    pub fn at(&self, from: &[f64], to: &[f64]) -> f64 {
        let old = self.number.value;
        let moved = |joint: usize, piece: f64, offset: f64| {
            let (Some(from), Some(to)) = (from.get(joint), to.get(joint)) else {
                return old;
            };
            let lower = piece * old - offset;
            let is_fit = (lower - SLACK..lower + piece + SLACK).contains(from);
            match is_fit && from != to {
                true => ((to + offset + NOISE) / piece).floor(),
                false => old,
            }
        };
        match self.says {
            Says::Quarter(joint) => moved(joint, std::f64::consts::FRAC_PI_2, 0.0),
            Says::Turn(joint) => moved(joint, std::f64::consts::TAU, std::f64::consts::PI),
            Says::Signs { .. } => {
                let mut bits = old as u32;
                for (joint, (from, to)) in from.iter().zip(to).enumerate().take(6) {
                    let is_negative = bits >> joint & 1 == 1;
                    let is_fit = if is_negative {
                        *from < SLACK
                    } else {
                        *from > -SLACK
                    };
                    if is_fit && from != to && is_negative != (*to < -NOISE) {
                        bits ^= 1 << joint;
                    }
                }
                f64::from(bits)
            }
        }
    }

    /// Returns whether the number follows a joint. Signs are those of turns: the side of the wrist is stated a second time.
    pub fn is_of(&self, joint: usize) -> bool {
        match self.says {
            Says::Quarter(own) | Says::Turn(own) => own == joint,
            Says::Signs { .. } => joint != WRIST,
        }
    }

    /// Returns the text of another value.
    pub fn text(&self, value: f64) -> String {
        let width = self.number.span().len();
        match self.says {
            Says::Signs { radix: 2 } => format!("{:0width$b}", value as u32),
            Says::Signs { radix: 16 } => format!("{:0width$X}", value as u32),
            _ => format!("{}", value as i64),
        }
    }
}

/// Language whose configuration states sides by bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Convention {
    /// RAPID's `cfx`: 4 for a wrist centre behind axis 1, 2 for one behind the lower arm, 1 for a negative axis 5. ABB's lower
    /// arm is the link between axes 2 and 3. ("RAPID Instructions, Functions and Data types", 3HAC050917, `confdata`.)
    Cfx,
    /// KRL's `S`: bit 0 for a wrist centre behind axis 1 (the overhead area), bit 1 for an axis 3 beyond the angle at which the
    /// arm is stretched, bit 2 for a negative axis 5. ("Operating and Programming Instructions for System Integrators", KSS 8.)
    Status,
}

/// Sides that a number of a configuration states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Posture {
    /// Meaning of the bits.
    pub convention: Convention,
    /// The number.
    pub bits: u32,
    /// Whether the number is stated for sure. `cfx` is 0 also where a controller does not use it.
    pub is_certain: bool,
}

/// Branch of the inverse kinematics that a controller takes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Configuration {
    /// Ranges of the joints.
    pub bounds: Vec<Bound>,
    /// Numbers of the file that state these ranges, where a correction can change them.
    pub stated: Vec<Stated>,
    /// Joints in rad or m near the branch; `None` where they are not known, and those of the target before are used.
    pub near: Option<Vec<f64>>,
    /// Letters of the sides of wrist, elbow and shoulder, as one of two each. Which side a letter is depends on the robot: the
    /// first pose of a program shows it.
    pub letters: [Option<bool>; 3],
    /// Sides of wrist, elbow and shoulder that a number states.
    pub posture: Option<Posture>,
    /// Number of the configuration that limits no joint; targets inserted on the way to this target get it, too.
    pub rest: Option<Number>,
    /// Whether the controller stops where no branch is within `bounds`; otherwise it takes the nearest branch.
    pub is_monitored: bool,
}

impl Configuration {
    /// Creates the configuration of a controller that stops where no solution is within `bounds`.
    pub fn monitored(bounds: Vec<Bound>) -> Self {
        Self {
            bounds,
            is_monitored: true,
            ..Self::default()
        }
    }

    /// Returns whether it states the side of the wrist: a letter, `cfx`, `S`, or the sign of joint 5.
    pub fn states_wrist(&self) -> bool {
        let is_bound = self.bounds.iter().any(|bound| bound.0 == WRIST);
        let is_stated = self.rest.is_some() || self.posture.is_some();
        is_bound || self.letters[0].is_some() || is_stated
    }
}

/// How far beyond its stated range a joint still counts as in it, in rad.
pub const SLACK: f64 = 0.02;
/// A joint that is this near to the beginning of a range, in rad, is in the range: the decimals of a pose leave it as much.
pub const NOISE: f64 = 1e-5;

/// Returns the range of a joint on one side of zero.
pub fn of_sign(joint: usize, is_negative: bool) -> Bound {
    let far = 4.0 * std::f64::consts::TAU;
    match is_negative {
        true => (joint, -far, SLACK),
        false => (joint, -SLACK, far),
    }
}

/// Returns the range of a joint within half a turn of `turn` whole turns.
pub fn of_turn(joint: usize, turn: f64) -> Bound {
    let (middle, half) = (std::f64::consts::TAU * turn, std::f64::consts::PI + SLACK);
    (joint, middle - half, middle + half)
}

/// A target of a program.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Position of the target in the files.
    pub location: Location,
    /// Numbers of the target.
    pub goal: Goal,
    /// Index of its tool in [`Program::frames`], once a move uses it.
    pub tool: Option<usize>,
    /// Index of its base frame in [`Program::frames`].
    pub base: Option<usize>,
    /// Configuration of the controller at the target.
    pub configuration: Option<Configuration>,
}

impl Target {
    /// Creates a target that no move uses yet.
    pub fn new(location: Location, goal: Goal, configuration: Option<Configuration>) -> Self {
        Self {
            location,
            goal,
            tool: None,
            base: None,
            configuration,
        }
    }
}

/// A tool, or a base frame of targets.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Name in the program.
    pub name: String,
    /// Whether the frame is a tool.
    pub is_tool: bool,
    /// `flange_from_tool` or `base_from_frame`.
    pub pose: Pose<f64>,
    /// Weight of the tool that the program states, in kg.
    pub payload_kg: Option<f64>,
    /// Origin of the values, for users.
    pub origin: String,
}

impl Frame {
    /// Creates the frame of the flange, or else of the robot's base, to which every controller gives a name.
    pub fn own(name: impl Into<String>, is_tool: bool) -> Self {
        Self {
            name: name.into(),
            is_tool,
            pose: Pose::identity(),
            payload_kg: None,
            origin: "the controller".to_owned(),
        }
    }

    fn key(&self) -> FrameKey {
        let pose = self.pose.rotation.iter().chain(&self.pose.translation);
        let numbers = pose.chain(&self.payload_kg).map(|x| x.to_bits());
        (self.name.clone(), self.is_tool, numbers.collect())
    }
}

/// Name, kind, and the bits of pose and payload of a frame.
type FrameKey = (String, bool, Vec<u64>);

/// A part of a program that is left as it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    /// Position in the files.
    pub location: Location,
    /// Reason why it is left.
    pub reason: String,
}

/// Path of the tool to a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Joint motion, whose path is not used.
    Joints,
    /// Straight line.
    Line,
    /// Circle through the point before.
    Arc,
}

/// A move to a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// Index of the target.
    pub target: usize,
    /// Path to the target.
    pub way: Way,
}

/// Notation in which an instruction has its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Literal {
    /// `[[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[9E9,…]]`
    Robtarget,
    /// `{X …,Y …,Z …,A …,B …,C …}`
    Frame,
    /// `p[x, y, z, rx, ry, rz]`
    Pose,
}

/// A straight move before which moves can be inserted as copies of its instruction with other targets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Index of the move. Nothing moves the arm between the move before and this one.
    pub step: usize,
    /// Index of the file.
    pub file: usize,
    /// Byte before which moves are inserted.
    pub at: usize,
    /// Lines that prepare the inserted moves.
    pub before: Vec<Vec<u8>>,
    /// First byte of the instruction, and the byte behind its last.
    pub instruction: (usize, usize),
    /// First byte of the target, and the byte behind its last.
    pub target: (usize, usize),
    /// Span behind the target by which the arm stops at its end, and what the inserted moves have there to pass theirs.
    pub blend: Option<((usize, usize), &'static str)>,
    /// Notation of the target.
    pub literal: Literal,
}

/// The parts of a program that concern a correction.
#[derive(Clone, Debug)]
pub struct Program {
    /// Name of the language.
    pub language: &'static str,
    /// Units and orientations of the language.
    pub dialect: Dialect,
    /// Radians in a unit of each joint, where they differ from [`Dialect::radian`].
    pub joint_units: Option<Vec<f64>>,
    /// Seed columns of a table.
    pub seeds: Option<Seeds>,
    /// Whether each move begins where the one before has ended: not in a table without seeds.
    pub is_path: bool,
    /// Files of the program.
    pub sources: Vec<Source>,
    /// All targets.
    pub targets: Vec<Target>,
    /// All frames and tools that the moves use.
    pub frames: Vec<Frame>,
    /// Indices of the frames by their contents.
    known: HashMap<FrameKey, usize>,
    /// Moves in the order of the text.
    pub moves: Vec<Move>,
    /// Straight moves before which moves can be inserted, in their order.
    pub lines: Vec<Line>,
    /// Indices of the targets to which moves with different payloads go.
    pub loaded_differently: BTreeSet<usize>,
    /// Reasons why the payload of targets is not known, by index.
    pub unknown_payloads: HashMap<usize, String>,
    /// Indices of targets to which a move goes that is left as it is: the move is named, and they are not.
    pub reached_otherwise: BTreeSet<usize>,
    /// Indices of joint targets in files that are not corrected: the arm goes there, and they stay.
    pub fixed: BTreeSet<usize>,
    /// Parts that the reader leaves as they are.
    pub left: Vec<Left>,
    /// Other remarks for the user.
    pub remarks: Vec<String>,
}

impl Program {
    /// Creates a program without contents.
    pub fn new(language: &'static str, dialect: Dialect, sources: Vec<Source>) -> Self {
        Self {
            language,
            dialect,
            joint_units: None,
            seeds: None,
            is_path: true,
            sources,
            targets: Vec::new(),
            frames: Vec::new(),
            known: HashMap::new(),
            moves: Vec::new(),
            lines: Vec::new(),
            loaded_differently: BTreeSet::new(),
            unknown_payloads: HashMap::new(),
            reached_otherwise: BTreeSet::new(),
            fixed: BTreeSet::new(),
            left: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// Returns the radians in a unit of a joint.
    pub fn radian(&self, joint: usize) -> f64 {
        let own = self.joint_units.as_ref().and_then(|units| units.get(joint));
        own.copied().unwrap_or(self.dialect.radian)
    }

    /// Returns the index of a frame, and adds the frame if it is new.
    pub fn frame(&mut self, frame: Frame) -> usize {
        let new = self.frames.len();
        let index = *self.known.entry(frame.key()).or_insert(new);
        if index == new {
            self.frames.push(frame);
        }
        index
    }

    /// Returns the tools and bases that targets have.
    pub fn used_frames(&self) -> impl Iterator<Item = &Frame> {
        let mut is_used = vec![false; self.frames.len()];
        for target in &self.targets {
            // Joint targets have no base.
            let is_pose = matches!(target.goal, Goal::Pose { .. });
            let base = target.base.filter(|_| is_pose);
            for index in base.into_iter().chain(target.tool) {
                is_used[index] = true;
            }
        }
        let frames = self.frames.iter().zip(is_used);
        frames.filter_map(|(frame, is_used)| is_used.then_some(frame))
    }

    /// Leaves the target or move at a location as it is, for a reason.
    pub fn leave(&mut self, location: Location, reason: impl Into<String>) {
        let reason = reason.into();
        let is_said = self
            .left
            .iter()
            .rev()
            .take(4)
            .any(|left| left.location == location);
        if !is_said {
            self.left.push(Left { location, reason });
        }
    }

    /// Returns file and line of a location, such as `part.mod:17`.
    pub fn line_of(&self, location: Location) -> String {
        let source = &self.sources[location.file];
        let (line, _) = source.line_and_column(location.at);
        format!("{}:{line}", source.path.display())
    }

    /// Notes that a move goes to a target with a tool in a base. A target that other moves use with other frames is left as
    /// it is.
    pub fn move_to(&mut self, target: usize, way: Way, tool: usize, base: usize) {
        let found = &mut self.targets[target];
        let location = found.location;
        let (old_tool, old_base) = (found.tool.unwrap_or(tool), found.base.unwrap_or(base));
        let of = |index: usize| &self.frames[index];
        // The frames of joints do not matter.
        let is_other = matches!(found.goal, Goal::Pose { .. })
            && (of(old_tool).pose != of(tool).pose || of(old_base).pose != of(base).pose);
        if is_other {
            let names =
                |tool: usize, base: usize| format!("{} in {}", of(tool).name, of(base).name);
            let (old, new) = (names(old_tool, old_base), names(tool, base));
            let reason = match old == new {
                true => format!("its moves use different frames, all of them {new}"),
                false => format!("its moves use different frames: {old} and {new}"),
            };
            self.leave(location, reason);
            return;
        }
        if of(old_tool).payload_kg != of(tool).payload_kg {
            self.loaded_differently.insert(target);
        }
        (found.tool, found.base) = (Some(tool), Some(base));
        self.moves.push(Move { target, way });
    }

    /// Notes a move to a target with a tool in a base. Without one of them the target is left as it is.
    pub fn move_in(
        &mut self,
        target: usize,
        way: Way,
        tool: Result<Frame, String>,
        base: Result<Frame, String>,
    ) {
        match (tool, base) {
            (Ok(tool), Ok(base)) => {
                let (tool, base) = (self.frame(tool), self.frame(base));
                self.move_to(target, way, tool, base);
            }
            (Err(reason), _) | (_, Err(reason)) => {
                self.leave(self.targets[target].location, reason);
            }
        }
    }
}
