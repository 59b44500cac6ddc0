//! What a reader finds in a program: targets, the frames and tools that they are in, and what cannot be corrected.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::dialect::Dialect;

/// A byte of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Location {
    /// Index of the file.
    pub file: usize,
    /// Byte in it.
    pub at: usize,
}

/// What a target says.
#[derive(Clone, Debug, PartialEq)]
pub enum Goal {
    /// Joints in the language's unit.
    Joints(Vec<Number>),
    /// A pose of the tool in its base.
    Pose {
        /// x, y, z.
        position: [Number; 3],
        /// As the language writes it.
        orientation: Vec<Number>,
    },
}

/// A joint and the range in rad that a target's configuration leaves it.
pub type Bound = (usize, f64, f64);

/// Which of the branches a controller takes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Configuration {
    /// Ranges of joints.
    pub bounds: Vec<Bound>,
    /// Joints in rad or m that the branch is near; those of the target before where it is not known.
    pub near: Option<Vec<f64>>,
    /// Which of two ways the wrist is turned. What a language calls either way depends on how its robot counts joint 5, so that
    /// the first pose of a program says which sign of joint 5 is meant.
    pub is_wrist_flipped: Option<bool>,
    /// A number of it that says no joint's range; targets that are inserted on the way there get it, too.
    pub rest: Option<Number>,
    /// Whether the controller stops where no branch is within them; otherwise it takes the nearest.
    pub is_monitored: bool,
}

impl Configuration {
    /// Creates one for a controller that stops where no solution is within `bounds`.
    pub fn monitored(bounds: Vec<Bound>) -> Self {
        Self {
            bounds,
            is_monitored: true,
            ..Self::default()
        }
    }
}

/// How far a joint may be beyond the end of a range, rad: a corrected target stays in its own.
pub const SLACK: f64 = 0.02;

/// The range of a joint on a side of zero.
pub fn of_sign(joint: usize, is_negative: bool) -> Bound {
    let far = 4.0 * std::f64::consts::TAU;
    match is_negative {
        true => (joint, -far, SLACK),
        false => (joint, -SLACK, far),
    }
}

/// The range of a joint within half a turn of so many whole turns.
pub fn of_turn(joint: usize, turn: f64) -> Bound {
    let (middle, half) = (std::f64::consts::TAU * turn, std::f64::consts::PI + SLACK);
    (joint, middle - half, middle + half)
}

/// One target.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Where it is.
    pub location: Location,
    /// Its numbers.
    pub goal: Goal,
    /// Index of its tool in [`Program::frames`], once a move uses it.
    pub tool: Option<usize>,
    /// Index of its base frame.
    pub base: Option<usize>,
    /// Its configuration.
    pub configuration: Option<Configuration>,
}

/// A tool, or a frame that targets are in.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Its name in the program.
    pub name: String,
    /// Whether it is a tool.
    pub is_tool: bool,
    /// `flange_from_tool` or `base_from_frame`.
    pub pose: Pose<f64>,
    /// What the program says that it weighs, kg.
    pub payload_kg: Option<f64>,
    /// Where it comes from, for people.
    pub origin: String,
}

/// Something that is left as it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    /// Where.
    pub location: Location,
    /// Why.
    pub reason: String,
}

/// How the tool moves to a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Any way.
    Joints,
    /// Straight.
    Line,
    /// On a circle through the point before.
    Arc,
}

/// A move to a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// Index of the target.
    pub target: usize,
    /// The way there.
    pub way: Way,
}

/// How an instruction has a target written into it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Literal {
    /// `[[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[9E9,…]]`
    Robtarget,
    /// `{X …,Y …,Z …,A …,B …,C …}`
    Frame,
    /// `p[x, y, z, rx, ry, rz]`
    Pose,
}

/// A straight move that others can be inserted before: copies of its instruction with other targets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Index of the move. Nothing moves the arm between the move before and this one.
    pub step: usize,
    /// Index of the file.
    pub file: usize,
    /// First byte of the instruction, and the one behind its last.
    pub instruction: (usize, usize),
    /// The bytes of its target.
    pub target: (usize, usize),
    /// How a target is written.
    pub literal: Literal,
}

/// A program, as far as it concerns a correction.
#[derive(Clone, Debug)]
pub struct Program {
    /// Name of the language.
    pub language: &'static str,
    /// Its units.
    pub dialect: Dialect,
    /// Radians of a unit of each joint, where these are not [`Dialect::radian`].
    pub joint_units: Option<Vec<f64>>,
    /// Its files.
    pub sources: Vec<Source>,
    /// All targets.
    pub targets: Vec<Target>,
    /// All frames and tools that moves use.
    pub frames: Vec<Frame>,
    /// In the order of the text.
    pub moves: Vec<Move>,
    /// Moves that others can be inserted before, in their order.
    pub lines: Vec<Line>,
    /// What is left, found by the reader.
    pub left: Vec<Left>,
    /// What else should be known.
    pub remarks: Vec<String>,
}

impl Program {
    /// Nothing yet.
    pub fn new(language: &'static str, dialect: Dialect, sources: Vec<Source>) -> Self {
        Self {
            language,
            dialect,
            joint_units: None,
            sources,
            targets: Vec::new(),
            frames: Vec::new(),
            moves: Vec::new(),
            lines: Vec::new(),
            left: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// Radians of a unit of a joint.
    pub fn radian(&self, joint: usize) -> f64 {
        let own = self.joint_units.as_ref().and_then(|units| units.get(joint));
        own.copied().unwrap_or(self.dialect.radian)
    }

    /// The index of a frame, which is added if it is new.
    pub fn frame(&mut self, frame: Frame) -> usize {
        let same = |other: &Frame| {
            (&other.name, other.is_tool) == (&frame.name, frame.is_tool)
                && (other.pose, other.payload_kg) == (frame.pose, frame.payload_kg)
        };
        match self.frames.iter().position(same) {
            Some(index) => index,
            None => {
                self.frames.push(frame);
                self.frames.len() - 1
            }
        }
    }

    /// Leaves what is at a location.
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

    /// `part.mod:17` of a location.
    pub fn line_of(&self, location: Location) -> String {
        let source = &self.sources[location.file];
        let (line, _) = source.line_and_column(location.at);
        format!("{}:{line}", source.path.display())
    }

    /// Notes that a move goes to a target with a tool in a base. A target that others use with other frames is left.
    pub fn move_to(&mut self, target: usize, way: Way, tool: usize, base: usize) {
        let found = &mut self.targets[target];
        let location = found.location;
        let kg = |index: usize| self.frames[index].payload_kg;
        let is_other = match found.goal {
            // The frames do not matter, but what the tool weighs may.
            Goal::Joints(_) => found.tool.is_some_and(|t| kg(t) != kg(tool)),
            Goal::Pose { .. } => {
                found.tool.is_some_and(|t| t != tool) || found.base.is_some_and(|b| b != base)
            }
        };
        if is_other {
            let (old_tool, old_base) = (found.tool.unwrap_or(tool), found.base.unwrap_or(base));
            let name = |index: usize| self.frames[index].name.clone();
            let reason = format!(
                "its moves use different frames: {} in {} and {} in {}",
                name(old_tool),
                name(old_base),
                name(tool),
                name(base)
            );
            self.leave(location, reason);
            return;
        }
        (found.tool, found.base) = (Some(tool), Some(base));
        self.moves.push(Move { target, way });
    }
}

/// The written pose of a target; `None` for an orientation that is none.
pub fn written_pose(program: &Program, target: &Target) -> Option<Pose<f64>> {
    let Goal::Pose {
        position,
        orientation,
    } = &target.goal
    else {
        return None;
    };
    let dialect = &program.dialect;
    let numbers: Vec<f64> = orientation.iter().map(|n| n.value).collect();
    let [x, y, z] = position.map(|n| dialect.metre * n.value);
    Some(Pose {
        rotation: dialect.orientation.rotation(&numbers)?,
        translation: Vector3::new(x, y, z),
    })
}

/// `flange_from_tool` and `base_from_frame` of a target.
pub fn frames_of(program: &Program, target: &Target) -> (Pose<f64>, Pose<f64>) {
    let of = |index: Option<usize>| {
        let frame = index.and_then(|index| program.frames.get(index));
        frame.map_or_else(Pose::identity, |frame| frame.pose)
    };
    (of(target.tool), of(target.base))
}
