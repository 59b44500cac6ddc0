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
    Bound, Configuration, Convention, NOISE, Posture, Program, SLACK, Says, Stated, Target, Way,
};
use crate::robot_programs::correction::target_poses::{frames_of, written_pose};

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

/// What the letters of configurations are, as far as poses have shown it: for wrist, elbow and shoulder a letter and its side.
pub type Meaning = [Option<(bool, bool)>; 3];

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
    /// Joints on other sides of wrist, elbow or shoulder that it could as well be, for all that is stated.
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

/// Returns whether a letter has no meaning yet.
pub fn has_new_letter(letters: &[Option<bool>; 3], meaning: &Meaning) -> bool {
    let mut all = letters.iter().zip(meaning);
    all.any(|(letter, meaning)| letter.is_some() && meaning.is_none())
}

/// Returns the sides that a configuration states by letters whose meaning is known.
fn sides_of_letters(configuration: &Configuration, meaning: &Meaning) -> Sides {
    let mut out = Sides::default();
    for (slot, (letter, meaning)) in out
        .iter_mut()
        .zip(configuration.letters.iter().zip(meaning))
    {
        *slot = letter
            .zip(*meaning)
            .map(|(letter, (known, side))| (letter == known) == side);
    }
    out
}

/// Returns whether joints are on these sides. `None` is either side.
fn is_on(commander: &Commander, joints: &Joints, wanted: &Sides) -> bool {
    if wanted.iter().all(Option::is_none) {
        return true;
    }
    let mut all = sides(commander, joints).into_iter().zip(wanted);
    all.all(|(side, wanted)| side.zip(*wanted).is_none_or(|(a, b)| a == b))
}

/// What a target states of its branch.
struct Wanted<'a> {
    commander: &'a Commander,
    configuration: &'a Configuration,
    /// Sides without which the controller does not go to the target.
    must: Sides,
    /// All sides that are stated, also those that a controller takes only where the path does not decide.
    should: Sides,
}

impl<'a> Wanted<'a> {
    fn new(
        commander: &'a Commander,
        arm: &Arm,
        configuration: &'a Configuration,
        meaning: &Meaning,
    ) -> Self {
        let mut must = sides_of_letters(configuration, meaning);
        let mut should = must;
        if let Some(posture) = &configuration.posture {
            let stated = arm.stated(posture);
            let add = |to: &mut Sides| {
                for (slot, side) in to.iter_mut().zip(stated) {
                    *slot = slot.or(side);
                }
            };
            add(&mut should);
            if posture.is_certain && configuration.is_monitored {
                add(&mut must);
            }
        }
        Self {
            commander,
            configuration,
            must,
            should,
        }
    }

    /// Returns the slack that is tried first. Where a controller monitors turns, a joint on the other side of a boundary
    /// counts only if no solution is on this one.
    fn least(&self) -> f64 {
        let is_quarter = |stated: &Stated| matches!(stated.says, Says::Quarter(_));
        let is_loose =
            !self.configuration.is_monitored || self.configuration.stated.iter().any(is_quarter);
        if is_loose { SLACK } else { NOISE }
    }

    /// Returns whether joints have the configuration.
    fn fits(&self, joints: &Joints, slack: f64) -> bool {
        let less = SLACK - slack;
        let within = |(joint, lower, upper): &Bound| {
            let range = lower + less..=upper - less;
            joints.get(*joint).is_some_and(|q| range.contains(q))
        };
        self.configuration.bounds.iter().all(within) && is_on(self.commander, joints, &self.must)
    }

    /// Returns the branches that have the configuration, as far as any has it.
    fn fitting<'b>(&self, branches: &'b [Joints]) -> Vec<&'b Joints> {
        let of = |slack: f64| -> Vec<&Joints> {
            let fits = |joints: &&Joints| self.fits(joints, slack);
            branches.iter().filter(fits).collect()
        };
        let all = match of(self.least()) {
            none if none.is_empty() => of(SLACK),
            some => some,
        };
        let is_preferred = |joints: &&Joints| is_on(self.commander, joints, &self.should);
        let preferred: Vec<&Joints> = all.iter().copied().filter(is_preferred).collect();
        match preferred.is_empty() {
            true => all,
            false => preferred,
        }
    }

    /// Returns whether the target leaves a side of the arm open, so that a controller with a configuration has to take it from
    /// elsewhere.
    fn is_open(&self, joints: &Joints) -> bool {
        let mut all = self.should.iter().zip(sides(self.commander, joints));
        self.configuration.is_monitored
            && all.any(|(stated, side)| stated.is_none() && side.is_some())
    }

    /// Returns those of the fitting branches that are on other sides than `joints`.
    fn rivals(&self, fitting: &[&Joints], joints: &Joints) -> Vec<Joints> {
        let own = sides(self.commander, joints);
        let others = fitting.iter().copied().copied();
        others
            .filter(|other| !is_on(self.commander, other, &own))
            .collect()
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
    let flange = base * pose * tool.inverse();
    let configuration = target.configuration.clone().unwrap_or_default();
    let wanted = Wanted::new(commander, arm, &configuration, meaning);
    let known = match &configuration.near {
        Some(near) => Some(seed(program, commander, target, near)?),
        None => *last,
    };
    if configuration.near.is_none() && commander.kinds().len() >= REDUNDANT {
        return Err(Refused::Left(format!(
            "an arm of {} joints reaches it in infinitely many ways, and no joints near it are stated",
            commander.kinds().len()
        )));
    }
    if let Some((joint, lower, upper)) = impossible(commander, &configuration) {
        return Err(Refused::Left(format!(
            "its configuration has joint {} between {:.0}° and {:.0}°, where it cannot turn",
            joint + 1,
            (lower + SLACK).to_degrees(),
            (upper - SLACK).to_degrees()
        )));
    }
    let near = known.unwrap_or_else(|| commander.middle());
    // A letter without a meaning is most likely that of the joints before. On a line no side changes.
    let is_guessed = has_new_letter(&configuration.letters, meaning);
    let is_possible = |joints: &Joints| {
        commander.beyond_limit(joints).is_none() && wanted.fits(joints, wanted.least())
    };
    // A joint motion goes to the sides that are stated, a line to those that it leads to.
    let is_led = |joints: &Joints| way != Way::Joints || is_on(commander, joints, &wanted.should);
    let is_doubtful = way == Way::Joints && configuration.near.is_none() && !is_guessed;
    if known.is_some() {
        let found = commander.nominal_joints(&flange, &near);
        let far = joint_distance(&found.joints, &near);
        if !found.status.contains(Status::PARTLY_CORRECTED)
            && !found.status.contains(Status::BAD_INPUT)
            && far < NEAR
            && is_possible(&found.joints)
            && is_led(&found.joints)
        {
            let mut rivals = Vec::new();
            if is_doubtful && far > ON_THE_SPOT && wanted.is_open(&found.joints) {
                let branches = commander.branches(&flange);
                rivals = wanted.rivals(&wanted.fitting(&branches), &found.joints);
            }
            return Ok(Solution {
                is_letter_guessed: is_guessed && way == Way::Joints && far > ON_THE_SPOT,
                rivals,
                ..Solution::certain(found.joints)
            });
        }
    }
    let is_line = way == Way::Line && known.is_some() && configuration.near.is_none();
    let followed = is_line
        .then(|| along(commander, &near, &flange, &tool))
        .flatten();
    if let Some(joints) = followed.filter(is_possible) {
        return Ok(Solution::certain(joints));
    }
    let branches = commander.branches(&flange);
    let nearest = |all: &mut dyn Iterator<Item = &Joints>| {
        let far = |joints: &&Joints| joint_distance(joints, &near);
        all.min_by(|a, b| far(a).total_cmp(&far(b))).copied()
    };
    let solutions = |count: usize| if known.is_some() { 1 } else { count };
    let mut fitting = wanted.fitting(&branches);
    let before = known
        .filter(|_| is_guessed)
        .map(|joints| sides(commander, &joints));
    let same: Vec<&Joints> = fitting
        .iter()
        .copied()
        .filter(|joints| before.is_some_and(|before| is_on(commander, joints, &before)))
        .collect();
    let is_letter_guessed = before.is_some() && fitting.len() > 1 && way == Way::Joints;
    let is_line_lost = is_line && fitting.len() > 1;
    if !same.is_empty() {
        fitting = same;
    }
    if let Some(joints) = nearest(&mut fitting.iter().copied()) {
        let rivals = match is_doubtful && known.is_some() && configuration.is_monitored {
            true => wanted.rivals(&fitting, &joints),
            false => Vec::new(),
        };
        return Ok(Solution {
            joints,
            solutions: solutions(fitting.len()),
            is_letter_guessed,
            is_line_lost,
            rivals,
        });
    }
    if branches.is_empty() {
        return Err(Refused::Left(
            "the arm does not reach it within its joint limits".to_owned(),
        ));
    }
    let nearest = nearest(&mut branches.iter());
    match nearest {
        Some(joints) if !configuration.is_monitored => Ok(Solution {
            solutions: solutions(branches.len()),
            is_letter_guessed,
            is_line_lost: is_line && branches.len() > 1,
            ..Solution::certain(joints)
        }),
        _ => {
            let nearest =
                nearest.and_then(|joints| written(commander, arm, &configuration, &joints));
            let error = unmatched(program, target, branches.len(), nearest);
            Err(Refused::Program(error))
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
