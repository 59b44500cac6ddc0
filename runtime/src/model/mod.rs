//! A calibrated arm in fixed memory: T_gp(q, m)·f(q) (paper, eq. 9) for every input, with a [`Status`].
//!
//! [`Model::load`] is the only way from a blob's words to a model. It checks every number first and changes nothing
//! when one is refused, so that the last good model survives. After it, [`Model::evaluate`] cannot fail: it bounds what
//! is too large, says what is outside the trained range, and answers the uncorrected pose for input that is none.
//!
//! `WORDS` is the room for support rows; no result depends on it.

mod checked;
mod correct;
mod elastic;
mod task_space;
mod variance;
mod view;

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, Transform};
use poegp_protocol::limits::{MAX_INPUTS, MAX_JOINTS};

use crate::bound::bounded;
use crate::chain::{Chain, MinimalForm, MovedFrames};
use crate::deflection::{self, CouplingMatrix};
use crate::load_error::LoadError;
use crate::newton::{Equations, Place};
pub use crate::newton::{pose_error, squares};
pub use crate::observer::{Observer, Stages};
use crate::poe::{Motions, no_motions};
use crate::posterior;
use crate::scalar::{MAX_ANGLE, Scalar};
use crate::se3::{Pose, Twist};
use crate::status::Status;
pub use correct::{CORRECTED_WITHIN, Corrected, MAX_JOINT_CHANGE};

use crate::trust::Trust;
use checked::{
    MAX_COEFFICIENT, checked_chain, checked_coupling, checked_range, checked_rows, feature_limit,
    is_within,
};
use elastic::ElasticCorrection;
use task_space::TaskSpaceCorrection;
pub use view::{Compiled, View};

/// Words of support rows for `points` points of the longest row.
pub const fn words_for(points: usize) -> usize {
    points * posterior::row_words(MAX_INPUTS)
}

/// Largest payload in kilograms that is taken for one.
pub const MAX_PAYLOAD_KG: f32 = 100_000.0;

/// Places at which a model looks how far its nominal arm is off.
const PLACES: u16 = 16;
/// The least [`Arm::lever`] in metres.
const LEAST_LEVER: f64 = 0.01;
/// Steps of each joint from place to place, in 65 536ths of its range: powers of the root of x⁹ = x + 1, whose reciprocal is
/// what spreads best in eight dimensions.
const SPREAD: [u16; MAX_JOINTS] = [
    60_399, 55_663, 51_299, 47_277, 43_571, 40_155, 37_007, 34_105,
];

/// The answer of [`Model::evaluate`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation<T> {
    /// `base_from_target`, compensated.
    pub pose: Pose<T>,
    /// The correction g(q, m), a twist of the base frame in m and rad, after bounding.
    pub correction: Twist<T>,
    /// What it is worth.
    pub status: Status,
    /// How much of the correction's prior the trained ranges explain at this input, from 1 within them to 0 far away;
    /// see [`crate::trust`]. 0 for input that is none.
    pub trust: T,
    /// Standard deviation of one position component of a new measurement about this pose, metres, root mean square over
    /// the three axes: of an elastic model with a variance (see [`crate::deflection::PositionVariance`]), for input
    /// that is one.
    pub position_sigma: Option<T>,
}

/// A calibrated arm.
#[derive(Debug)]
pub struct Model<T, const WORDS: usize> {
    arm: Slot<Arm<T>>,
    rows: Vec<T, WORDS>,
}

/// An `Option` whose empty state is all zeros, so that a static model takes no flash for its initial value: `None`
/// would be one byte that is not zero, and with it the whole model a copy in flash.
#[derive(Debug)]
#[repr(u8)]
enum Slot<T> {
    Empty = 0,
    Full(T) = 1,
}

impl<T> Slot<T> {
    #[inline(always)]
    fn as_ref(&self) -> Option<&T> {
        match self {
            Self::Empty => None,
            Self::Full(value) => Some(value),
        }
    }
}

/// Everything but the support rows.
#[derive(Clone, Debug)]
struct Arm<T> {
    calibrated: Chain<T>,
    nominal: Chain<T>,
    coupling: Option<CouplingMatrix<T>>,
    joint_ranges: [(T, T); MAX_JOINTS],
    payload_range: Option<(T, T)>,
    /// Root mean square of the angle (rad) between nominal and calibrated target within the trained ranges.
    usual_rotation: T,
    /// Root mean square of the length of J_p (m) within the trained ranges: Scale::lever.
    lever: T,
    trust: Trust<T>,
    correction: ArmCorrection<T>,
}

/// What is done beside the chain.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // nothing can be boxed
enum ArmCorrection<T> {
    None,
    TaskSpace(TaskSpaceCorrection<T>),
    Elastic(ElasticCorrection<T>),
}

impl<T: Scalar, const WORDS: usize> Default for Model<T, WORDS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar, const WORDS: usize> Model<T, WORDS> {
    /// No model: every evaluation answers [`Status::NO_MODEL`].
    pub const fn new() -> Self {
        Self {
            arm: Slot::Empty,
            rows: Vec::new(),
        }
    }

    /// Takes over the arm of `blob`. All or nothing: after an error the model is what it was.
    ///
    /// # Errors
    /// [`LoadError`] names the first number that is not one a robot may be moved by.
    // Inlined, its copies of the arm would lie on the stack beside those of the decoder.
    #[inline(never)]
    pub fn load(&mut self, blob: &Blob<'_>) -> Result<(), LoadError> {
        // Once on the stack, filled in place: every name in between would be a copy of the arm.
        let mut slot = Slot::Full(Arm::empty());
        if let Slot::Full(arm) = &mut slot {
            arm.fill(blob)?;
        }
        let bytes = checked_support(blob, WORDS)?;
        let landmarks = variance::checked(blob, WORDS - bytes.len() / 4)?;
        self.rows.clear();
        for word in [bytes, landmarks].iter().flat_map(|b| b.as_chunks::<4>().0) {
            // Cannot fail: the length was compared with the capacity.
            let _ = self.rows.push(T::from_f32(f32::from_le_bytes(*word)));
        }
        self.arm = slot;
        Ok(())
    }

    /// Number of the controller's joints; 0 without a model.
    pub fn joints(&self) -> usize {
        self.arm
            .as_ref()
            .map_or(0, |arm| arm.calibrated.kinds().len())
    }

    /// Number of support points.
    pub fn support(&self) -> usize {
        match self.arm.as_ref().map(|arm| &arm.correction) {
            Some(ArmCorrection::TaskSpace(task)) => {
                self.rows.len() / posterior::row_words(task.header.inputs)
            }
            Some(ArmCorrection::Elastic(elastic)) => elastic.deflection.processes.points(),
            _ => 0,
        }
    }

    /// Forgets the model.
    pub fn unload(&mut self) {
        self.arm = Slot::Empty;
        self.rows.clear();
    }

    /// T_gp(q, m)·f(q) for the controller's joints (rad or m) and the payload in kg (0 when the model knows none).
    #[inline(always)]
    pub fn evaluate(&self, joints: &[T], payload_kg: T) -> Evaluation<T> {
        self.evaluate_in_stages(joints, payload_kg, &mut Stages::new())
    }

    /// The same, with its intermediate results.
    #[inline(always)]
    pub fn evaluate_in_stages(
        &self,
        joints: &[T],
        payload_kg: T,
        stages: &mut Stages<T>,
    ) -> Evaluation<T> {
        T::evaluate(self.view(), joints, payload_kg, stages)
    }

    /// The same, with every intermediate result shown to `observer`: one source for product and bit comparison.
    #[inline(always)]
    pub fn evaluate_observed(
        &self,
        joints: &[T],
        payload_kg: T,
        observer: &mut impl Observer<T>,
    ) -> Evaluation<T> {
        self.view().evaluate_observed(joints, payload_kg, observer)
    }

    /// The joints at which the calibrated arm stands where the nominal one would at `joints` (rad or m), with a payload
    /// in kg. No joint is changed by more than [`MAX_JOINT_CHANGE`]. Without a model or for bad input the answer is
    /// the command as it came, zeros in place of what is not finite.
    #[inline(always)]
    pub fn correct(&self, joints: &[T], payload_kg: T) -> Corrected<T> {
        T::correct(self.view(), joints, payload_kg)
    }

    #[inline(always)]
    fn view(&self) -> View<'_, T> {
        View {
            arm: self.arm.as_ref(),
            rows: &self.rows,
        }
    }

    /// `base_from_target` of the nominal chain (base and tool of the base-tool calibration) at the controller's joints,
    /// or `None` without a model or for bad input.
    pub fn nominal(&self, joints: &[T]) -> Option<Pose<T>> {
        let arm = self.arm.as_ref()?;
        let mut x = [T::ZERO; MAX_JOINTS];
        if !arm.take_joints(joints, &mut x) {
            return None;
        }
        let mut motions = no_motions();
        arm.motions(&x, &mut motions);
        Some(arm.nominal.forward_at(&motions))
    }
}

impl<T: Scalar> View<'_, T> {
    #[inline(always)]
    fn evaluate_observed(
        &self,
        joints: &[T],
        payload_kg: T,
        observer: &mut impl Observer<T>,
    ) -> Evaluation<T> {
        let nothing = |status| Evaluation {
            pose: Pose::identity(),
            correction: Twist::zero(),
            status,
            trust: T::ZERO,
            position_sigma: None,
        };
        let Some(arm) = self.arm else {
            return nothing(Status::NO_MODEL);
        };
        let mut x = [T::ZERO; MAX_JOINTS];
        if !arm.take_joints(joints, &mut x) {
            return nothing(Status::BAD_INPUT);
        }
        let believable = is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG));
        let mut motions = no_motions();
        arm.motions(&x, &mut motions);
        observer.motions(motions.get(..joints.len()).unwrap_or(&[]));
        let (trust, status) = arm.range(&x, payload_kg);
        let mut position_sigma = None;
        let (pose, correction, bounded) = match &arm.correction {
            ArmCorrection::TaskSpace(task) if believable => {
                let chain = arm.calibrated.forward_at(&motions);
                observer.chain(&chain);
                let x = arm.inputs(&x, payload_kg);
                let mean = task.header.mean(self.rows, &x);
                observer.mean(&mean);
                let (twist, bounded) =
                    bounded(&task.bound, &Twist::from_array(&mean), &chain.translation);
                (chain.corrected(&twist), twist, bounded)
            }
            ArmCorrection::Elastic(elastic) if believable => {
                let payload = elastic.held(payload_kg);
                let at = deflection::Configuration {
                    chain: &arm.calibrated,
                    coupling: arm.coupling.as_ref(),
                    joints: &x,
                    motions: &motions,
                    payload_kg: payload,
                };
                let result =
                    elastic
                        .deflection
                        .compensate(&at, self.rows, Some(&elastic.bound), observer);
                position_sigma = result.position_sigma;
                (result.pose, result.twist, result.bounded)
            }
            _ => {
                let chain = arm.calibrated.forward_at(&motions);
                observer.chain(&chain);
                (chain, Twist::zero(), false)
            }
        };
        let (status, trust) = if believable {
            (status.with_if(bounded, Status::CORRECTION_BOUNDED), trust)
        } else {
            (Status::BAD_INPUT, T::ZERO)
        };
        Evaluation {
            pose,
            correction,
            status,
            trust,
            position_sigma,
        }
    }
}

/// The bytes of the support rows, after every word was looked at.
fn checked_support<'a>(blob: &Blob<'a>, capacity: usize) -> Result<&'a [u8], LoadError> {
    match &blob.correction {
        Correction::None => Ok(&[]),
        Correction::TaskSpace(task) => task_space::checked_support(task, capacity),
        Correction::Elastic(elastic) if !elastic.sets.is_empty() => {
            elastic::checked_sets(elastic, &blob.robot.joints, capacity)
        }
        Correction::Elastic(elastic) => {
            let joints = &blob.robot.joints;
            let limit = |index: usize| {
                let joint = joints.get(index / 2);
                joint.map_or(MAX_COEFFICIENT, |joint| feature_limit(joint.kind))
            };
            checked_rows(
                elastic.rows,
                deflection::row_words(joints.len()),
                limit,
                capacity,
            )
        }
    }
}

/// The chain of these frames.
// A function of its own, and once: its copies of the frames are on the stack no longer than it runs.
#[inline(never)]
fn minimal<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Transform<f32>],
) -> Result<MinimalForm<T>, LoadError> {
    Ok(MinimalForm::new(&checked_chain(kinds, frames)?))
}

impl<T: Scalar> Arm<T> {
    /// One without joints.
    #[inline(always)]
    fn empty() -> Self {
        Self {
            calibrated: Chain::empty(),
            nominal: Chain::empty(),
            coupling: None,
            joint_ranges: [(T::ZERO, T::ZERO); MAX_JOINTS],
            payload_range: None,
            usual_rotation: T::ZERO,
            lever: T::ONE,
            trust: Trust::none(),
            correction: ArmCorrection::None,
        }
    }

    /// The arm of `blob` in place of an empty one, which after an error is nothing.
    #[inline(never)]
    fn fill(&mut self, blob: &Blob<'_>) -> Result<(), LoadError> {
        let joints = blob.robot.joints.len();
        let mut kinds = [JointKind::Revolute; MAX_JOINTS];
        for (kind, joint) in kinds.iter_mut().zip(&blob.robot.joints) {
            *kind = joint.kind;
            if joint
                .limits
                .is_some_and(|(lower, upper)| !is_within(lower, f32::MIN, upper))
            {
                return Err(LoadError::JointLimits);
            }
        }
        let kinds = kinds.get(..joints).ok_or(LoadError::Chain)?;
        if blob.ranges.joints.len() != joints {
            return Err(LoadError::Ranges);
        }
        for (slot, range) in self.joint_ranges.iter_mut().zip(&blob.ranges.joints) {
            *slot = checked_range(*range, MAX_ANGLE)?;
        }
        self.nominal = Chain::new(&minimal(kinds, &blob.geometry.nominal)?);
        self.coupling = checked_coupling(&blob.robot.coupling, joints)?;
        self.payload_range = blob
            .ranges
            .payload_kg
            .map(|range| checked_range(range, MAX_PAYLOAD_KG))
            .transpose()?;
        self.trust = Trust::of(blob);
        let calibrated = minimal(kinds, &blob.geometry.calibrated)?;
        self.calibrated = Chain::new(&calibrated);
        (self.usual_rotation, self.lever) = self.measured_scale();
        match &blob.correction {
            Correction::None => {}
            Correction::TaskSpace(task) => {
                let inputs = joints + usize::from(blob.ranges.payload_kg.is_some());
                let task = TaskSpaceCorrection::from_wire(task, inputs)?;
                self.correction = ArmCorrection::TaskSpace(task);
            }
            Correction::Elastic(elastic) => {
                self.correction = ArmCorrection::Elastic(ElasticCorrection::empty());
                if let ArmCorrection::Elastic(found) = &mut self.correction {
                    let variance = blob.variance.as_ref();
                    found.fill(elastic, variance, &calibrated, blob.ranges.payload_kg)?;
                }
            }
        }
        Ok(())
    }

    /// [`Arm::usual_rotation`] and [`Arm::lever`], from [`PLACES`] places that fill the ranges evenly.
    #[inline(never)]
    fn measured_scale(&self) -> (T, T) {
        let (mut rotations, mut levers) = (T::ZERO, T::ZERO);
        let mut frames = MovedFrames::new();
        let mut equations = Equations::new();
        let mut place = 1_u16;
        while place <= PLACES {
            let mut joints = [T::ZERO; MAX_JOINTS];
            let ranges = self.joint_ranges.iter().zip(SPREAD);
            for (slot, ((lower, upper), spread)) in joints.iter_mut().zip(ranges) {
                let along = f32::from(place.wrapping_mul(spread)) * (1.0 / 65_536.0);
                *slot = *lower + T::from_f32(along) * (*upper - *lower);
            }
            let mut motions = no_motions();
            self.motions(&joints, &mut motions);
            let nominal = self.nominal.forward_at(&motions);
            let calibrated = self.calibrated.moved_frames_at(&motions, &mut frames);
            rotations += squares(&pose_error(&nominal, &calibrated)).1;
            equations.form(&Place {
                kinds: self.calibrated.kinds(),
                frames: &frames,
                point: &calibrated.translation,
                coupling: self.coupling.as_ref(),
            });
            let [[x, ..], [_, y, ..], [_, _, z, ..], ..] = equations.gram();
            levers += *x + *y + *z;
            place += 1;
        }
        let mean = T::from_f64(1.0 / PLACES as f64);
        let least = T::from_f64(LEAST_LEVER * LEAST_LEVER);
        let levers = levers * mean;
        let levers = if levers > least { levers } else { least };
        ((rotations * mean).sqrt(), levers.sqrt())
    }

    /// Copies the joints into an array of zeros. Whether there are as many as the arm has, all finite and within reason.
    // Not an `Option` of an array, which is copied twice.
    #[inline(always)]
    fn take_joints(&self, joints: &[T], out: &mut [T; MAX_JOINTS]) -> bool {
        if joints.len() != self.calibrated.kinds().len() {
            return false;
        }
        let limit = T::from_f32(MAX_ANGLE);
        for (slot, value) in out.iter_mut().zip(joints) {
            if !is_within(*value, -limit, limit) {
                return false;
            }
            *slot = *value;
        }
        true
    }

    /// What the serial joints do at the controller's joints `x`.
    #[inline(always)]
    fn motions(&self, x: &[T; MAX_JOINTS], out: &mut Motions<T>) {
        match &self.coupling {
            None => self.calibrated.motions_into(x, out),
            coupling => self
                .calibrated
                .motions_into(&deflection::coupled(coupling.as_ref(), x), out),
        }
    }

    /// x = [q, m].
    #[inline(always)]
    fn inputs(&self, joints: &[T; MAX_JOINTS], payload_kg: T) -> [T; MAX_INPUTS] {
        let mut x = [T::ZERO; MAX_INPUTS];
        for (slot, value) in x.iter_mut().zip(joints) {
            *slot = *value;
        }
        if let (Some(_), Some(slot)) = (
            &self.payload_range,
            x.get_mut(self.calibrated.kinds().len()),
        ) {
            *slot = payload_kg;
        }
        x
    }

    /// Trust in finite joints and payload, and which of them are outside the trained ranges.
    #[inline(always)]
    fn range(&self, joints: &[T; MAX_JOINTS], payload_kg: T) -> (T, Status) {
        let joints = joints.get(..self.calibrated.kinds().len());
        self.trust.at(
            joints.unwrap_or(&[]),
            &self.joint_ranges,
            payload_kg,
            self.payload_range,
        )
    }
}
