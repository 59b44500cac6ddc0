//! Finds the joints of a pose on the branch that the controller takes: within its configuration, along a line, or nearest to
//! the preceding joints.

use poegp_calibration::blob::commander::{Commander, Joints, joint_distance, pose_distance};
use poegp_calibration::input_error::{InputError, counted};
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::between::at;
use crate::robot_programs::correction::posture::{Arm, Sides, sides};
use crate::robot_programs::correction::program::{
    Bound, Configuration, Convention, Posture, Program, SLACK, Says, Target, Way,
};
use crate::robot_programs::correction::target_poses::{frames_of, written_pose};
use crate::robot_programs::correction::wanted::{Meaning, Wanted, has_new_letter, is_on};

/// A search that ends farther than this from its start, in rad or m, may be on another branch.
pub const NEAR: f64 = 0.6;

/// A joint motion in which every joint moves by less than this, in rad or m, takes no part of the arm to its other side: a
/// wrist flips by half a turn.
const ON_THE_SPOT: f64 = 0.2;
/// Largest rotation in rad, and largest distance in m, between two points at which a line is followed.
const STEP: (f64, f64) = (0.1, 0.05);
/// Largest number of these points.
const MOST_STEPS: f64 = 200.0;
/// Number of joints from which on a pose has finitely many solutions no more.
const REDUNDANT: usize = 7;

/// Reason why a target has no joints.
pub enum Refused {
    /// The target is left as it is, for this reason.
    Left(String),
    /// The whole program is refused, and nothing is written.
    Program(InputError),
}

/// Joints of a pose.
pub struct Solution {
    /// Joints in rad or m.
    pub joints: Joints,
    /// Number of solutions among which they are a guess.
    pub solutions: usize,
    /// Whether a letter of its configuration is a guess.
    pub is_letter_guessed: bool,
    /// Whether it is the nearest of several, because the line to it could not be followed.
    pub is_line_lost: bool,
    /// Joints on other sides of wrist, elbow or shoulder that it could as well be, for all that is stated; all other solutions
    /// of a pose that is not on a path.
    pub rivals: Vec<Joints>,
}

impl Solution {
    /// Creates a solution without doubt.
    pub fn certain(joints: Joints) -> Self {
        Self {
            joints,
            solutions: 1,
            is_letter_guessed: false,
            is_line_lost: false,
            rivals: Vec::new(),
        }
    }
}

/// Follows the line from joints to a pose, as the controller does. Returns the joints at its end; `None` where they jump on
/// the way, or the pose is not reached.
fn along(
    commander: &Commander,
    from: &Joints,
    flange: &Pose<f64>,
    tool: &Pose<f64>,
) -> Option<Joints> {
    let ends = [commander.nominal_flange(from) * *tool, *flange * *tool];
    let (moved, turned) = pose_distance(&ends[0], &ends[1]);
    let steps = (turned / STEP.0).max(moved / STEP.1).ceil();
    if !(1.0..=MOST_STEPS).contains(&steps) {
        return None;
    }
    let mut joints = *from;
    for k in 1..=steps as usize {
        let flange = at(&ends, k as f64 / steps) * tool.inverse();
        let found = commander.nominal_joints(&flange, &joints);
        let is_lost = [Status::PARTLY_CORRECTED, Status::BAD_INPUT];
        let is_lost = is_lost.into_iter().any(|bit| found.status.contains(bit));
        if is_lost || joint_distance(&found.joints, &joints) > NEAR {
            return None;
        }
        joints = found.joints;
    }
    Some(joints)
}

/// Returns the first range of a monitored configuration that its joint does not reach, such as that of nine whole turns.
fn impossible(commander: &Commander, configuration: &Configuration) -> Option<Bound> {
    let mut bounds = configuration.bounds.iter().copied();
    let is_apart = |(joint, lower, upper): &Bound| !commander.can_be_within(*joint, *lower, *upper);
    bounds.find(|bound| configuration.is_monitored && is_apart(bound))
}

/// Returns the joints of the pose of a target to which a move goes.
pub fn pose_joints(
    program: &Program,
    (commander, arm): (&Commander, &Arm),
    (target, way): (&Target, Way),
    last: &Option<Joints>,
    meaning: &Meaning,
) -> Result<Solution, Refused> {
    let Some(pose) = written_pose(program, target) else {
        return Err(Refused::Left("its orientation is invalid".to_owned()));
    };
    let (tool, base) = frames_of(program, target);
    let configuration = target.configuration.clone().unwrap_or_default();
    let known = match &configuration.near {
        Some(near) => Some(seed(program, commander, target, near)?),
        None => last.filter(|_| program.is_path),
    };
    refuse_undecidable(commander, &configuration)?;
    let search = Search {
        commander,
        configuration: &configuration,
        wanted: Wanted::new(commander, arm, &configuration, meaning),
        way,
        is_alone: !program.is_path,
        flange: base * pose * tool.inverse(),
        tool,
        known,
        near: known.unwrap_or_else(|| commander.middle()),
        is_guessed: has_new_letter(&configuration.letters, meaning),
    };
    if let Some(found) = search.close_by().or_else(|| search.along_line()) {
        return Ok(found);
    }
    let branches = commander.branches(&search.flange);
    if let Some(found) = search.among(&branches) {
        return Ok(found);
    }
    if branches.is_empty() {
        return Err(Refused::Left(
            "the arm does not reach it within its joint limits".to_owned(),
        ));
    }
    let nearest = search.nearest(branches.iter());
    match nearest {
        Some(joints) if !configuration.is_monitored => {
            Ok(search.regardless(joints, branches.len()))
        }
        _ => {
            let nearest =
                nearest.and_then(|joints| written(commander, arm, &configuration, &joints));
            let error = unmatched(program, target, branches.len(), nearest);
            Err(Refused::Program(error))
        }
    }
}

/// Refuses a pose whose branch nothing decides, or whose configuration no joints have.
fn refuse_undecidable(commander: &Commander, configuration: &Configuration) -> Result<(), Refused> {
    if configuration.near.is_none() && commander.kinds().len() >= REDUNDANT {
        return Err(Refused::Left(format!(
            "an arm of {} joints reaches it in infinitely many ways, and no joints near it are stated",
            commander.kinds().len()
        )));
    }
    if let Some((joint, lower, upper)) = impossible(commander, configuration) {
        return Err(Refused::Left(format!(
            "its configuration has joint {} between {:.0}° and {:.0}°, where it cannot turn",
            joint + 1,
            (lower + SLACK).to_degrees(),
            (upper - SLACK).to_degrees()
        )));
    }
    Ok(())
}

/// The search for the joints of one pose.
struct Search<'a> {
    commander: &'a Commander,
    configuration: &'a Configuration,
    wanted: Wanted<'a>,
    way: Way,
    /// Whether the pose is not on a path, so that nothing states its branch.
    is_alone: bool,
    flange: Pose<f64>,
    tool: Pose<f64>,
    /// Joints that are stated as near, or those before the move.
    known: Option<Joints>,
    /// Joints at which the search begins.
    near: Joints,
    /// Whether a letter of the configuration has no meaning yet. It is most likely that of the joints before.
    is_guessed: bool,
}

impl Search<'_> {
    fn is_possible(&self, joints: &Joints) -> bool {
        self.commander.beyond_limit(joints).is_none()
            && self.wanted.fits(joints, self.wanted.least())
    }

    /// Returns whether the sides of the joints may be others than those before. On a line no side changes.
    fn is_doubtful(&self) -> bool {
        self.way == Way::Joints && self.configuration.near.is_none() && !self.is_guessed
    }

    /// Returns whether the arm comes on a line from joints that are known.
    fn is_line(&self) -> bool {
        self.way == Way::Line && self.known.is_some() && self.configuration.near.is_none()
    }

    /// Returns the joints to which those that are known lead directly.
    fn close_by(&self) -> Option<Solution> {
        self.known?;
        let (commander, wanted) = (self.commander, &self.wanted);
        let found = commander.nominal_joints(&self.flange, &self.near);
        let far = joint_distance(&found.joints, &self.near);
        // A joint motion goes to the sides that are stated, a line to those that it leads to.
        let is_led =
            |joints: &Joints| self.way != Way::Joints || is_on(commander, joints, &wanted.should);
        let is_found = !found.status.contains(Status::PARTLY_CORRECTED)
            && !found.status.contains(Status::BAD_INPUT)
            && far < NEAR
            && self.is_possible(&found.joints)
            && is_led(&found.joints);
        if !is_found {
            return None;
        }
        let mut rivals = Vec::new();
        if self.is_doubtful() && far > ON_THE_SPOT && wanted.is_open(&found.joints) {
            let branches = commander.branches(&self.flange);
            rivals = wanted.rivals(&wanted.fitting(&branches), &found.joints);
        }
        Some(Solution {
            is_letter_guessed: self.is_guessed && self.way == Way::Joints && far > ON_THE_SPOT,
            rivals,
            ..Solution::certain(found.joints)
        })
    }

    /// Returns the joints to which the line from those that are known leads.
    fn along_line(&self) -> Option<Solution> {
        let followed = self
            .is_line()
            .then(|| along(self.commander, &self.near, &self.flange, &self.tool))
            .flatten();
        let possible = followed.filter(|joints| self.is_possible(joints));
        possible.map(Solution::certain)
    }

    /// Returns those of the joints that are nearest to the beginning of the search.
    fn nearest<'b>(&self, all: impl Iterator<Item = &'b Joints>) -> Option<Joints> {
        let far = |joints: &&Joints| joint_distance(joints, &self.near);
        all.min_by(|a, b| far(a).total_cmp(&far(b))).copied()
    }

    /// Returns the sides of the joints before, if they stand for a letter without a meaning.
    fn sides_before(&self) -> Option<Sides> {
        let known = self.known.filter(|_| self.is_guessed);
        known.map(|joints| sides(self.commander, &joints))
    }

    /// Returns the number of solutions among which joints are a guess: with known joints, they are none. Those of a pose that
    /// is not on a path are its rivals.
    fn solutions(&self, count: usize) -> usize {
        if self.known.is_some() || self.is_alone {
            1
        } else {
            count
        }
    }

    /// Returns the nearest of the branches that have the configuration.
    fn among(&self, branches: &[Joints]) -> Option<Solution> {
        let mut fitting = self.wanted.fitting(branches);
        let before = self.sides_before();
        let is_same =
            |joints: &&Joints| before.is_some_and(|before| is_on(self.commander, joints, &before));
        let same: Vec<&Joints> = fitting.iter().copied().filter(is_same).collect();
        let is_letter_guessed = before.is_some() && fitting.len() > 1 && self.way == Way::Joints;
        let is_line_lost = self.is_line() && fitting.len() > 1;
        if !same.is_empty() {
            fitting = same;
        }
        let joints = self.nearest(fitting.iter().copied())?;
        let is_open = self.is_doubtful() && self.known.is_some() && self.configuration.is_monitored;
        Some(Solution {
            joints,
            solutions: self.solutions(fitting.len()),
            is_letter_guessed,
            is_line_lost,
            rivals: match (self.is_alone, is_open) {
                (true, _) => fitting
                    .into_iter()
                    .copied()
                    .filter(|q| *q != joints)
                    .collect(),
                (false, true) => self.wanted.rivals(&fitting, &joints),
                (false, false) => Vec::new(),
            },
        })
    }

    /// Returns joints that do not have the configuration as a solution: of `count` branches none has it.
    fn regardless(&self, joints: Joints, count: usize) -> Solution {
        Solution {
            solutions: self.solutions(count),
            is_line_lost: self.is_line() && count > 1,
            ..Solution::certain(joints)
        }
    }
}

/// Returns the joints that a target states as near, or the error for another number of joints.
fn seed(
    program: &Program,
    commander: &Commander,
    target: &Target,
    near: &[f64],
) -> Result<Joints, Refused> {
    let count = commander.kinds().len();
    if near.len() != count {
        let source = &program.sources[target.location.file];
        let found = format!("a seed of {} joints", near.len());
        let expected = format!("{count}, as the robot of the model has");
        let error = source.error(target.location.at, found, expected);
        return Err(Refused::Program(error));
    }
    let mut joints = [0.0; MAX_JOINTS];
    joints[..count].copy_from_slice(near);
    Ok(joints)
}

/// Returns the numbers that a configuration would state at joints: `[0,-1,0,0]` or `S 2,T 35`.
fn written(
    commander: &Commander,
    arm: &Arm,
    configuration: &Configuration,
    joints: &Joints,
) -> Option<String> {
    let number = |says: Says| match says {
        Says::Quarter(joint) => (joints[joint] / std::f64::consts::FRAC_PI_2).floor(),
        Says::Turn(joint) => (joints[joint] / std::f64::consts::TAU).round(),
        Says::Signs { .. } => {
            let sign = |joint: usize| f64::from(u32::from(joints[joint] < 0.0) << joint);
            (0..6).map(sign).sum()
        }
    };
    let posture = configuration.posture.and_then(|own| {
        let is_it = |bits: &u32| {
            let stated = arm.stated(&Posture { bits: *bits, ..own });
            is_on(commander, joints, &stated)
        };
        Some((own.convention, (0..8).find(is_it)?))
    });
    let numbers = configuration
        .stated
        .iter()
        .map(|stated| number(stated.says));
    let numbers: Vec<String> = numbers.map(|number| number.to_string()).collect();
    match posture {
        Some((Convention::Status, bits)) => {
            let turn = numbers.first().map(|turn| format!(",T {turn}"));
            Some(format!("S {bits}{}", turn.unwrap_or_default()))
        }
        Some((Convention::Cfx, bits)) if numbers.len() == 3 => {
            Some(format!("[{},{bits}]", numbers.join(",")))
        }
        _ => None,
    }
}

/// Returns the error for a target none of whose solutions has its configuration. `nearest` is the configuration of one that
/// it has.
fn unmatched(
    program: &Program,
    target: &Target,
    solutions: usize,
    nearest: Option<String>,
) -> InputError {
    let source = &program.sources[target.location.file];
    let configuration = target.configuration.as_ref();
    let ends = configuration.and_then(|c| Some((c.stated.first()?.number, c.rest?)));
    let of_span = ends.map(|(first, last)| {
        let span = first.span().start..last.span().end;
        format!(" [{}]", String::from_utf8_lossy(source.slice(&span)))
    });
    let of_bits = || {
        let bits = configuration?.posture.map(|posture| posture.bits)?;
        let turn = configuration?.stated.first();
        let turn = turn.map(|stated| format!(",T {}", stated.number.value));
        Some(format!(" S {bits}{}", turn.unwrap_or_default()))
    };
    let found = format!(
        "none of this target's {} in its stated configuration{}",
        counted(solutions, "joint solution"),
        of_span.or_else(of_bits).unwrap_or_default()
    );
    let nearest = nearest
        .map(|nearest| format!(" The solution nearest to the preceding joints has {nearest}."));
    let help = format!(
        "wrong robot model, tool or frame?{}",
        nearest.unwrap_or_default()
    );
    source
        .error(target.location.at, found, "one")
        .with_help(help)
}
