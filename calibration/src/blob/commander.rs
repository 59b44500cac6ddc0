//! Inverse kinematics and corrections in `f64` for the targets of a robot program: the nominal joints of a pose, and the
//! joints to command instead.
//!
//! A controller computes the joints for a pose of its flange from the nominal model. [`Commander::branches`] returns all
//! joints that it may choose, [`Commander::nominal_joints`] those near given joints, and [`Commander::correct_target`] the
//! joints at which the real arm is where the controller believes it to be. "Flange" and "base" are those of the base-tool
//! calibration.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::correct::inverse::Inverse;
use poegp_runtime::correct::{CORRECTED_WITHIN, Corrected, MAX_JOINT_CHANGE};
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::{Evaluation, Model, words_for};

use crate::blob::predict::{BlobModel, orthonormal};
use crate::learning::task_space::MAX_POINTS;
use crate::numeric::rotation::angle_between;

/// One value for each joint; zeros after the last joint.
pub type Joints = [f64; MAX_JOINTS];

/// Number of seeds of a search for all branches, in addition to those that mirror a branch that was found.
const SEEDS: u32 = 48;
/// How far beyond a limit a joint still counts as within, in rad or m: a blob has the limits in single precision.
const ROUNDING: f64 = 1e-6;
/// Joints that differ by less than this, in rad or m, are the same solution.
const SAME: f64 = 1e-5;
/// Largest number of steps from a corrected command back to the nominal one; each step reduces the error to a few
/// thousandths.
const STEPS_BACK: usize = 12;
/// Largest error that may remain after these steps, in rad or m.
const CAME_BACK: f64 = 1e-10;
/// Reciprocals of the powers of the root of x⁹ = x + 1; their multiples give seeds that spread evenly in up to eight
/// dimensions.
const SPREAD: [f64; MAX_JOINTS] = [
    0.921599319633983,
    0.84934530594982,
    0.782756056097671,
    0.721387448738994,
    0.664830181950351,
    0.612707043357581,
    0.564670394293296,
    0.520399851198154,
];

/// The `f64` model that [`Commander`] evaluates.
type WideModel = Model<f64, { words_for(MAX_POINTS) }>;

/// Inverse kinematics and corrections of one blob.
#[derive(Debug)]
pub struct Commander {
    model: Box<WideModel>,
    flange_from_target: Pose<f64>,
    kinds: Vec<JointKind>,
    /// Limits of each joint in the robot's description.
    limits: Vec<Option<(f64, f64)>>,
    /// The middle of the trained ranges.
    middle: Joints,
    /// Trained payloads in kg, if the model depends on them.
    payloads: Option<(f64, f64)>,
}

impl Commander {
    /// Creates a commander for the model in a blob.
    ///
    /// # Errors
    /// [`LoadError`], which cannot occur for a [`BlobModel`], because it was checked when it was decoded.
    pub fn new(blob: &BlobModel) -> Result<Self, LoadError> {
        let mut model = Box::new(WideModel::new());
        model.load_decoded(blob.blob())?;
        let robot = &blob.blob().robot;
        let limit = |joint: &poegp_protocol::blob::Joint| {
            let wide = |(lower, upper)| (f64::from(lower) - ROUNDING, f64::from(upper) + ROUNDING);
            joint.limits.map(wide)
        };
        let mut middle = [0.0; MAX_JOINTS];
        for (slot, (lower, upper)) in middle.iter_mut().zip(&blob.blob().ranges.joints) {
            *slot = 0.5 * (f64::from(*lower) + f64::from(*upper));
        }
        Ok(Self {
            model,
            flange_from_target: Pose::from_rows(&blob.host().gauge.flange_from_target),
            kinds: robot.joints.iter().map(|joint| joint.kind).collect(),
            limits: robot.joints.iter().map(limit).collect(),
            middle,
            payloads: (blob.blob().ranges.payload_kg)
                .map(|(light, heavy)| (f64::from(light), f64::from(heavy))),
        })
    }

    /// Returns the kinds of the joints, base first.
    pub fn kinds(&self) -> &[JointKind] {
        &self.kinds
    }

    /// Returns the middle of the trained ranges.
    pub fn middle(&self) -> Joints {
        self.middle
    }

    /// Returns the lightest and the heaviest trained payload in kg; `None` if the model does not depend on the payload.
    pub fn payloads(&self) -> Option<(f64, f64)> {
        self.payloads
    }

    fn of<'a>(&self, joints: &'a Joints) -> &'a [f64] {
        &joints[..self.kinds.len()]
    }

    /// Returns the index of the first joint that is beyond a limit.
    pub fn beyond_limit(&self, joints: &Joints) -> Option<usize> {
        let is_beyond = |(q, limits): (&f64, &Option<(f64, f64)>)| {
            limits.is_some_and(|(lower, upper)| !(*q >= lower && *q <= upper))
        };
        joints.iter().zip(&self.limits).position(is_beyond)
    }

    /// Returns the range in which a joint is searched: its limits, otherwise one turn or one metre in either direction.
    fn ranges(&self) -> impl Iterator<Item = (f64, f64)> {
        let all = self.limits.iter().zip(&self.kinds);
        all.map(|(limits, kind)| {
            let far = match kind {
                JointKind::Revolute => std::f64::consts::TAU,
                JointKind::Prismatic => 1.0,
            };
            limits.unwrap_or((-far, far))
        })
    }

    /// Returns whether the range in which a joint is searched overlaps with `lower` to `upper`, in rad or m.
    pub fn can_be_within(&self, joint: usize, lower: f64, upper: f64) -> bool {
        let own = self.ranges().nth(joint);
        own.is_some_and(|(least, most)| lower <= most && upper >= least)
    }

    /// Returns the joints to command in a path for the wanted `joints`; see [`Model::correct`].
    pub fn correct(&self, joints: &Joints, payload_kg: f64) -> Corrected<f64> {
        self.model.correct(self.of(joints), payload_kg)
    }

    /// Returns the joints to command for the wanted `joints` of a single target, to which the frame `flange_from_tool` moves.
    ///
    /// Beside singularities, [`Commander::correct`] gives up part of a correction, because it is also asked along paths: there
    /// joints would have to race. The controller plans the path to a target itself. So a target is corrected completely
    /// wherever no joint changes by more than [`MAX_JOINT_CHANGE`], and elsewhere as [`Commander::correct`] does; what then
    /// stays is that of the model at the answer, not an estimate.
    ///
    /// An arm of fewer than six joints cannot turn its flange every way. It brings the origin of the tool to its target, and
    /// the remaining errors are those of the tool.
    pub fn correct_target(
        &self,
        joints: &Joints,
        payload_kg: f64,
        flange_from_tool: &Pose<f64>,
    ) -> Corrected<f64> {
        let mut out = self.correct(joints, payload_kg);
        let Some(nominal) = self.model.nominal(self.of(joints)) else {
            return out;
        };
        let can_turn = self.kinds.len() >= 6;
        let is_complete = !out.status.contains(Status::PARTLY_CORRECTED);
        if is_complete && can_turn || out.status.contains(Status::BAD_INPUT) {
            return out;
        }
        let tool = match can_turn {
            true => Pose::identity(),
            false => self.flange_from_target.inverse() * *flange_from_tool,
        };
        let wanted = nominal * tool;
        let found = self
            .model
            .tool_inverse(&wanted, &tool, self.of(&out.joints), payload_kg);
        let is_there = |position: f64, rotation: f64| {
            position <= CORRECTED_WITHIN && (rotation <= CORRECTED_WITHIN || !can_turn)
        };
        let change = found
            .joints
            .iter()
            .zip(joints)
            .map(|(to, q)| (to - q).abs());
        if is_there(found.position_error, found.rotation_error)
            && change.fold(0.0, f64::max) <= MAX_JOINT_CHANGE
        {
            out.joints = found.joints;
            out.applied = 1.0;
        }
        let reached = self.evaluate(&out.joints, payload_kg).pose * tool;
        (out.position_error, out.rotation_error) = pose_distance(&reached, &wanted);
        let is_there = is_there(out.position_error, out.rotation_error);
        out.status = out
            .status
            .without(Status::PARTLY_CORRECTED)
            .with_if(!is_there, Status::PARTLY_CORRECTED);
        out
    }

    /// Predicts the pose of the real arm at `joints`; see [`Model::evaluate`].
    pub fn evaluate(&self, joints: &Joints, payload_kg: f64) -> Evaluation<f64> {
        self.model.evaluate(self.of(joints), payload_kg)
    }

    /// Returns the joints of the target whose corrected command is `command`, or `None` if the search does not converge. The
    /// frame `flange_from_tool` moves to the target.
    pub fn uncorrected_target(
        &self,
        command: &Joints,
        payload_kg: f64,
        flange_from_tool: &Pose<f64>,
    ) -> Option<Joints> {
        let real = self.evaluate(command, payload_kg).pose;
        // Where the correction is complete, this is the answer.
        let mut joints = self.model.nominal_inverse(&real, self.of(command)).joints;
        for _ in 0..STEPS_BACK {
            let there = self.correct_target(&joints, payload_kg, flange_from_tool);
            if there.status.contains(Status::BAD_INPUT) {
                return None;
            }
            let mut off = 0.0_f64;
            for ((q, wanted), found) in joints.iter_mut().zip(command).zip(&there.joints) {
                *q += wanted - found;
                off = off.max((wanted - found).abs());
            }
            if off < CAME_BACK {
                return Some(joints);
            }
        }
        None
    }

    /// Returns `base_from_flange` of the nominal arm, with a rotation that is orthonormal to `f64`.
    pub fn nominal_flange(&self, joints: &Joints) -> Pose<f64> {
        let target = self.model.nominal(self.of(joints));
        let target = target.unwrap_or_else(Pose::identity);
        orthonormal(&(target * self.flange_from_target.inverse()))
    }

    /// Returns `base_from_flange` of the real arm, as the model predicts it.
    pub fn real_flange(&self, joints: &Joints, payload_kg: f64) -> Pose<f64> {
        let target = self.evaluate(joints, payload_kg).pose;
        orthonormal(&(target * self.flange_from_target.inverse()))
    }

    /// Returns the nominal joints at `base_from_flange` that a search from `near` finds.
    pub fn nominal_joints(&self, base_from_flange: &Pose<f64>, near: &Joints) -> Inverse<f64> {
        let wanted = *base_from_flange * self.flange_from_target;
        self.model.nominal_inverse(&wanted, self.of(near))
    }

    /// Returns all nominal joints at `base_from_flange` within the limits, including those that differ by whole turns; empty
    /// if the arm cannot reach the pose.
    ///
    /// An arm with more than six joints has infinitely many solutions; this function finds some of them.
    pub fn branches(&self, base_from_flange: &Pose<f64>) -> Vec<Joints> {
        let mut found: Vec<Joints> = Vec::new();
        let mut seeds: Vec<Joints> = vec![self.middle];
        for index in 1..=SEEDS {
            let mut seed = [0.0; MAX_JOINTS];
            for ((slot, (lower, upper)), spread) in seed.iter_mut().zip(self.ranges()).zip(SPREAD) {
                let along = (f64::from(index) * spread).fract();
                *slot = lower + along * (upper - lower);
            }
            seeds.push(seed);
        }
        while let Some(seed) = seeds.pop() {
            let answer = self.nominal_joints(base_from_flange, &seed);
            if answer.status.contains(Status::PARTLY_CORRECTED)
                || answer.status.contains(Status::BAD_INPUT)
            {
                continue;
            }
            let joints = self.principal(&answer.joints);
            if found.iter().all(|other| !self.is_same(other, &joints)) {
                found.push(joints);
                seeds.extend(self.mirrored(&joints));
            }
            // The arm has infinitely many solutions.
            if found.len() >= 64 {
                break;
            }
        }
        found.iter().flat_map(|joints| self.turns(joints)).collect()
    }

    /// Returns the joints with every revolute joint reduced to within half a turn of 0.
    fn principal(&self, joints: &Joints) -> Joints {
        let mut out = *joints;
        for (q, kind) in out.iter_mut().zip(&self.kinds) {
            if *kind == JointKind::Revolute {
                *q -= std::f64::consts::TAU * (*q / std::f64::consts::TAU).round();
            }
        }
        out
    }

    fn is_same(&self, a: &Joints, b: &Joints) -> bool {
        let mut apart = [0.0; MAX_JOINTS];
        for ((slot, a), b) in apart.iter_mut().zip(a).zip(b) {
            *slot = a - b;
        }
        self.principal(&apart).iter().all(|d| d.abs() < SAME)
    }

    /// Returns seeds at which the other branches of arms with a wrist and a shoulder are expected.
    fn mirrored(&self, joints: &Joints) -> Vec<Joints> {
        if self.kinds.len() != 6 {
            return Vec::new();
        }
        let half = std::f64::consts::PI;
        let mut flipped = *joints;
        let mut over = *joints;
        let mut elbow = *joints;
        flipped[3] += half;
        flipped[4] = -flipped[4];
        flipped[5] += half;
        over[0] += half;
        over[1] = -over[1];
        over[2] = half - over[2];
        elbow[2] = -elbow[2];
        [flipped, over, elbow]
            .map(|seed| self.principal(&seed))
            .to_vec()
    }

    /// Returns the joints with every combination of whole turns that the limits allow.
    fn turns(&self, joints: &Joints) -> Vec<Joints> {
        let mut all = vec![*joints];
        for (joint, (kind, (lower, upper))) in self.kinds.iter().zip(self.ranges()).enumerate() {
            let mut more = Vec::new();
            for joints in &all {
                for turn in -2..=2 {
                    let mut turned = *joints;
                    if *kind == JointKind::Revolute {
                        turned[joint] += f64::from(turn) * std::f64::consts::TAU;
                    } else if turn != 0 {
                        continue;
                    }
                    if turned[joint] >= lower && turned[joint] <= upper {
                        more.push(turned);
                    }
                }
            }
            all = more;
        }
        all
    }
}

/// Returns the largest difference between two sets of joints, in rad or m.
pub fn joint_distance(a: &Joints, b: &Joints) -> f64 {
    let largest = |most: f64, (a, b): (&f64, &f64)| most.max((a - b).abs());
    a.iter().zip(b).fold(0.0, largest)
}

/// Returns the displacement in metres and the angle in radians between two poses.
pub fn pose_distance(a: &Pose<f64>, b: &Pose<f64>) -> (f64, f64) {
    let moved: Vector3<f64> = a.translation - b.translation;
    (moved.norm(), angle_between(a, b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use poegp_runtime::math::scalar::Scalar;

    fn example() -> Commander {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/capi/examples/arm.blob");
        Commander::new(&BlobModel::read(&path).unwrap()).unwrap()
    }

    /// Joints all over the limits, without order.
    fn scattered(commander: &Commander, index: u32) -> Joints {
        let mut out = [0.0; MAX_JOINTS];
        for ((slot, (lower, upper)), spread) in out.iter_mut().zip(commander.ranges()).zip(SPREAD) {
            *slot = lower + (upper - lower) * (0.37 + f64::from(index) * 1.7 * spread).fract();
        }
        out
    }

    /// Each is one, and the joints that were asked for are among them.
    #[test]
    fn branches_reach_the_pose_and_none_is_missing() {
        let commander = example();
        for index in 0..60 {
            let joints = scattered(&commander, index);
            let flange = commander.nominal_flange(&joints);
            let branches = commander.branches(&flange);
            for branch in &branches {
                let (moved, turned) = pose_distance(&commander.nominal_flange(branch), &flange);
                assert!(moved < 1e-6 && turned < 1e-6, "{moved:e} {turned:e}");
                assert_eq!(commander.beyond_limit(branch), None);
            }
            let nearest = branches.iter().map(|b| joint_distance(b, &joints));
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            // Near a singularity of the wrist two joints turn against each other.
            let singular = Scalar::sin_cos(joints[4]).0.abs() < 0.05;
            assert!(
                singular || nearest < 1e-5,
                "{index}: {nearest:e} of {}",
                branches.len()
            );
        }
    }

    /// A blob has them in single precision, the program's joints in more digits.
    #[test]
    fn a_joint_at_its_limit_is_within_it() {
        let commander = example();
        let degrees = [165.0, 96.0, 65.0, 200.0, 120.0, 400.0_f64];
        let mut joints = commander.middle();
        for (joint, limit) in degrees.into_iter().enumerate() {
            for (by, found) in [(0.0, None), (1e-4, Some(joint))] {
                joints[joint] = limit.to_radians() + by;
                assert_eq!(commander.beyond_limit(&joints), found);
            }
            joints[joint] = 0.0;
        }
    }

    #[test]
    fn a_pose_out_of_reach_has_no_branch() {
        let commander = example();
        let mut flange = commander.nominal_flange(&commander.middle());
        flange.translation[0] += 9.0;
        assert!(commander.branches(&flange).is_empty());
    }

    /// Also near singularities, where a path is corrected in part.
    #[test]
    fn targets_are_reached_and_come_back() {
        let commander = example();
        let (mut complete, mut only_in_part, mut undone) = (0, 0, 0);
        for index in 0..200 {
            let joints = scattered(&commander, index);
            let target = commander.flange_from_target;
            let corrected = commander.correct_target(&joints, 2.0, &target);
            let wanted = commander.nominal_flange(&joints) * target;
            let left =
                |to: &Joints| pose_distance(&(commander.real_flange(to, 2.0) * target), &wanted).0;
            assert!((left(&corrected.joints) - corrected.position_error).abs() < CORRECTED_WITHIN);
            assert!(left(&corrected.joints) <= left(&joints) + 1e-6, "{index}");
            if let Some(back) = commander.uncorrected_target(&corrected.joints, 2.0, &target) {
                assert!(joint_distance(&back, &joints) < 1e-8, "{index}");
                undone += 1;
            }
            if corrected.status.contains(Status::PARTLY_CORRECTED) {
                continue;
            }
            assert!(left(&corrected.joints) < 2.0 * CORRECTED_WITHIN, "{index}");
            complete += 1;
            let on_a_path = commander.correct(&joints, 2.0);
            only_in_part += usize::from(on_a_path.status.contains(Status::PARTLY_CORRECTED));
        }
        println!("complete {complete}, on a path only in part {only_in_part}, undone {undone}");
        assert!(complete > 180 && only_in_part > 10 && undone > 190);
    }
}
