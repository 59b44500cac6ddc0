//! A calibrated arm in fixed memory: T_gp(q, m)·f(q) (paper, eq. 9) for every input, with a [`Status`].
//!
//! [`Model::load`] is the only way from a blob's words to a model. It checks every number first and changes nothing
//! when one is refused, so that the last good model survives. After it, [`Model::evaluate`] cannot fail: it bounds what
//! is too large, says what is outside the trained range, and answers the uncorrected pose for input that is none.
//!
//! `WORDS` is the room for support rows; no result depends on it.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, TaskSpace, Transform};
use poegp_protocol::limits::{MAX_FRAMES, MAX_INPUTS, MAX_JOINTS, OUTPUTS};

use crate::load_error::LoadError;
use crate::poe::{JointMotion, Poe};
use crate::posterior::{MAX_SCALED_INPUT, MeanHeader, row_words};
use crate::scalar::{MAX_ANGLE, Scalar};
use crate::se3::{Pose, Twist, add, cross, dot, scale};
use crate::status::Status;

/// Words of support rows for `points` points of the longest row.
pub const fn words_for(points: usize) -> usize {
    points * row_words(MAX_INPUTS)
}

/// Largest payload in kilograms that is taken for one.
pub const MAX_PAYLOAD_KG: f32 = 100_000.0;
/// Longest fixed frame of a chain in metres.
const MAX_FRAME_LENGTH: f32 = 100.0;
/// How far a stored rotation may be from orthonormal.
const MAX_ROTATION_ERROR: f32 = 1e-4;
/// Largest bounds that a blob may ask for.
const MAX_BOUND_M: f32 = 1.0;
const MAX_BOUND_RAD: f32 = 0.5;
/// Largest weight, constant or slope of a correction: with it no sum of the posterior mean can overflow
/// ((8·4096 + 10⁵)·10³⁰ of the slopes and 10³⁰ for each of a million points stay below f32::MAX).
const MAX_COEFFICIENT: f32 = 1e30;

/// The answer of [`Model::evaluate`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation<T> {
    /// `base_from_target`, compensated.
    pub pose: Pose<T>,
    /// The correction g(q, m), a twist of the base frame in m and rad, after bounding.
    pub correction: Twist<T>,
    /// What it is worth.
    pub status: Status,
}

/// Intermediate results, shown as they arise. All methods do nothing unless overridden, and cost nothing then.
pub trait Observer<T> {
    /// Sines, cosines and travels of the serial joints.
    fn motions(&mut self, _motions: &[JointMotion<T>]) {}
    /// f(q).
    fn chain(&mut self, _pose: &Pose<T>) {}
    /// One kernel value.
    fn kernel(&mut self, _value: T) {}
    /// The posterior mean before bounding.
    fn mean(&mut self, _mean: &[T; OUTPUTS]) {}
}

/// Looks at nothing.
#[derive(Clone, Copy, Debug)]
pub struct Unobserved;
impl<T> Observer<T> for Unobserved {}

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
#[derive(Clone, Copy, Debug)]
struct Arm<T> {
    calibrated: Poe<T>,
    nominal: Poe<T>,
    coupling: Option<CouplingMatrix<T>>,
    joint_ranges: [(T, T); MAX_JOINTS],
    payload_range: Option<(T, T)>,
    correction: Option<BoundedMean<T>>,
}

/// The task-space correction and its bound.
#[derive(Clone, Copy, Debug)]
struct BoundedMean<T> {
    header: MeanHeader<T>,
    position_bound: T,
    angle_bound: T,
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
        let arm = Arm::from_blob(blob)?;
        let bytes = match &blob.correction {
            Correction::None => &[][..],
            Correction::TaskSpace(task) => checked_rows(task, WORDS)?,
        };
        self.rows.clear();
        for word in bytes.as_chunks::<4>().0 {
            // Cannot fail: `checked_rows` has compared the length with the capacity.
            let _ = self.rows.push(T::from_f32(f32::from_le_bytes(*word)));
        }
        self.arm = Slot::Full(arm);
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
        let correction = self.arm.as_ref().and_then(|arm| arm.correction.as_ref());
        correction.map_or(0, |mean| self.rows.len() / row_words(mean.header.inputs))
    }

    /// Forgets the model.
    pub fn unload(&mut self) {
        self.arm = Slot::Empty;
        self.rows.clear();
    }

    /// T_gp(q, m)·f(q) for the controller's joints (rad or m) and the payload in kg (0 when the model knows none).
    // Code generation, and with it the time of a cycle, must not depend on the caller.
    #[inline(never)]
    pub fn evaluate(&self, joints: &[T], payload_kg: T) -> Evaluation<T> {
        self.evaluate_observed(joints, payload_kg, &mut Unobserved)
    }

    /// The same, with every intermediate result shown to `observer`: one source for product and bit comparison.
    #[inline(always)]
    pub fn evaluate_observed(
        &self,
        joints: &[T],
        payload_kg: T,
        observer: &mut impl Observer<T>,
    ) -> Evaluation<T> {
        let nothing = |status| Evaluation {
            pose: Pose::identity(),
            correction: Twist::zero(),
            status,
        };
        let Some(arm) = self.arm.as_ref() else {
            return nothing(Status::NO_MODEL);
        };
        let Some(x) = arm.checked_joints(joints) else {
            return nothing(Status::BAD_INPUT);
        };
        let motions = arm.calibrated.motions(&arm.serial(&x));
        observer.motions(motions.get(..joints.len()).unwrap_or(&[]));
        let chain = arm.calibrated.forward_with(&motions);
        observer.chain(&chain);
        if !is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG)) {
            return Evaluation {
                pose: chain,
                correction: Twist::zero(),
                status: Status::BAD_INPUT,
            };
        }
        let status = arm.range_status(&x, payload_kg);
        let Some(correction) = &arm.correction else {
            return Evaluation {
                pose: chain,
                correction: Twist::zero(),
                status,
            };
        };
        let x = arm.inputs(&x, payload_kg);
        let mean = correction
            .header
            .mean(&self.rows, &x, &mut |k| observer.kernel(k));
        observer.mean(&mean);
        let (twist, bounded) = correction.bounded(&Twist::from_array(&mean), &chain);
        let status = status.with_if(bounded, Status::CORRECTION_BOUNDED);
        Evaluation {
            pose: chain.corrected(&twist),
            correction: twist,
            status,
        }
    }

    /// `base_from_target` of the nominal chain (base and tool of the base-tool calibration) at the controller's joints,
    /// or `None` without a model or for bad input.
    pub fn nominal(&self, joints: &[T]) -> Option<Pose<T>> {
        let arm = self.arm.as_ref()?;
        let x = arm.checked_joints(joints)?;
        Some(arm.nominal.forward(&arm.serial(&x)))
    }
}

impl<T: Scalar> Arm<T> {
    fn from_blob(blob: &Blob<'_>) -> Result<Self, LoadError> {
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
        let mut joint_ranges = [(T::ZERO, T::ZERO); MAX_JOINTS];
        if blob.ranges.joints.len() != joints {
            return Err(LoadError::Ranges);
        }
        for (slot, range) in joint_ranges.iter_mut().zip(&blob.ranges.joints) {
            *slot = checked_range(*range, MAX_ANGLE)?;
        }
        Ok(Self {
            calibrated: checked_chain(kinds, &blob.geometry.calibrated)?,
            nominal: checked_chain(kinds, &blob.geometry.nominal)?,
            coupling: checked_coupling(&blob.robot.coupling, joints)?,
            joint_ranges,
            payload_range: blob
                .ranges
                .payload_kg
                .map(|range| checked_range(range, MAX_PAYLOAD_KG))
                .transpose()?,
            correction: match &blob.correction {
                Correction::None => None,
                Correction::TaskSpace(task) => Some(BoundedMean::from_wire(
                    task,
                    joints + usize::from(blob.ranges.payload_kg.is_some()),
                )?),
            },
        })
    }

    /// The joints in a fixed array, or `None` unless there are as many as the arm has, all finite and within reason.
    #[inline(always)]
    fn checked_joints(&self, joints: &[T]) -> Option<[T; MAX_JOINTS]> {
        if joints.len() != self.calibrated.kinds().len() {
            return None;
        }
        let limit = T::from_f32(MAX_ANGLE);
        let mut out = [T::ZERO; MAX_JOINTS];
        for (slot, value) in out.iter_mut().zip(joints) {
            if !is_within(*value, -limit, limit) {
                return None;
            }
            *slot = *value;
        }
        Some(out)
    }

    /// q_serial = C q.
    #[inline(always)]
    fn serial(&self, joints: &[T; MAX_JOINTS]) -> [T; MAX_JOINTS] {
        let Some(coupling) = &self.coupling else {
            return *joints;
        };
        coupling.map(|row| crate::kernel::inner_product(&row, joints))
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

    #[inline(always)]
    fn range_status(&self, joints: &[T; MAX_JOINTS], payload_kg: T) -> Status {
        let mut outside = false;
        for (value, (lower, upper)) in joints.iter().zip(&self.joint_ranges) {
            outside |= *value < *lower || *value > *upper;
        }
        let payload_outside = self
            .payload_range
            .is_some_and(|(lower, upper)| payload_kg < lower || payload_kg > upper);
        Status::OK
            .with_if(outside, Status::OUTSIDE_JOINT_RANGE)
            .with_if(payload_outside, Status::OUTSIDE_PAYLOAD_RANGE)
    }
}

impl<T: Scalar> BoundedMean<T> {
    fn from_wire(task: &TaskSpace<'_>, inputs: usize) -> Result<Self, LoadError> {
        let bound = &task.bound;
        if !is_within(bound.position_m, 0.0, MAX_BOUND_M)
            || !is_within(bound.angle_rad, 0.0, MAX_BOUND_RAD)
        {
            return Err(LoadError::Bound);
        }
        if task.input_scale.len() != inputs || inputs > MAX_INPUTS {
            return Err(LoadError::Inputs {
                found: task.input_scale.len() as u8,
                expected: inputs as u8,
            });
        }
        let mut header = MeanHeader::zero(inputs);
        for (slot, scale) in header.input_scale.iter_mut().zip(&task.input_scale) {
            if !is_within(*scale, 0.0, f32::MAX) {
                return Err(LoadError::Kernel);
            }
            *slot = T::from_f32(*scale);
        }
        if let Some(rates) = &task.rates {
            // Above 1 an exponent could leave the range of exp2.
            if rates.iter().any(|rate| !is_within(*rate, 0.0, 1.0)) {
                return Err(LoadError::Kernel);
            }
            header.rates = Some(rates.map(T::from_f32));
        }
        for (slots, values) in header.affine.iter_mut().zip(&task.affine) {
            if values.len() != inputs + 1
                || values
                    .iter()
                    .any(|value| !is_within(*value, -MAX_COEFFICIENT, MAX_COEFFICIENT))
            {
                return Err(LoadError::Kernel);
            }
            for (slot, value) in slots.iter_mut().zip(values) {
                *slot = T::from_f32(*value);
            }
        }
        Ok(Self {
            header,
            position_bound: T::from_f32(bound.position_m),
            angle_bound: T::from_f32(bound.angle_rad),
        })
    }

    /// The twist, scaled back when it displaces the target (to first order) or turns it by more than the bound.
    #[inline(always)]
    fn bounded(&self, twist: &Twist<T>, chain: &Pose<T>) -> (Twist<T>, bool) {
        let displacement = add(&twist.linear, &cross(&twist.angular, &chain.translation));
        let distance = dot(&displacement, &displacement).sqrt();
        let angle = dot(&twist.angular, &twist.angular).sqrt();
        if distance <= self.position_bound && angle <= self.angle_bound {
            return (*twist, false);
        }
        if !(distance.is_finite() && angle.is_finite()) {
            return (Twist::zero(), true);
        }
        let mut factor = T::ONE;
        if distance > self.position_bound {
            factor = self.position_bound / distance;
        }
        if angle * factor > self.angle_bound {
            factor = self.angle_bound / angle;
        }
        (
            Twist {
                linear: scale(factor, &twist.linear),
                angular: scale(factor, &twist.angular),
            },
            true,
        )
    }
}

/// lower ≤ value ≤ upper; false for NaN.
#[inline(always)]
fn is_within<T: Scalar>(value: T, lower: T, upper: T) -> bool {
    value >= lower && value <= upper
}

fn checked_range<T: Scalar>((lower, upper): (f32, f32), limit: f32) -> Result<(T, T), LoadError> {
    if is_within(lower, -limit, upper) && is_within(upper, lower, limit) {
        Ok((T::from_f32(lower), T::from_f32(upper)))
    } else {
        Err(LoadError::Ranges)
    }
}

fn checked_chain<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Transform<f32>],
) -> Result<Poe<T>, LoadError> {
    let mut poses = [Pose::identity(); MAX_FRAMES];
    for (index, (slot, frame)) in poses.iter_mut().zip(frames).enumerate() {
        let pose = Pose::<f32>::from_rows(frame);
        let square = crate::se3::product(&pose.rotation, &pose.rotation.transpose());
        let identity = Pose::<f32>::identity().rotation;
        let column = |j: usize| pose.rotation.column(j).into_owned();
        // A reflection is orthonormal too.
        let volume = dot(&cross(&column(0), &column(1)), &column(2));
        if !square
            .iter()
            .zip(identity.iter())
            .all(|(a, b)| is_within(a - b, -MAX_ROTATION_ERROR, MAX_ROTATION_ERROR))
            || !is_within(volume, 0.0, 2.0)
            || !pose
                .translation
                .iter()
                .all(|t| is_within(*t, -MAX_FRAME_LENGTH, MAX_FRAME_LENGTH))
        {
            return Err(LoadError::Frame { index: index as u8 });
        }
        *slot = pose.cast();
    }
    Poe::new(kinds, poses.get(..frames.len()).unwrap_or(&[])).map_err(|_| LoadError::Chain)
}

/// n×n in the upper left corner, the rest zero.
type CouplingMatrix<T> = [[T; MAX_JOINTS]; MAX_JOINTS];

fn checked_coupling<T: Scalar>(
    coupling: &[f32],
    joints: usize,
) -> Result<Option<CouplingMatrix<T>>, LoadError> {
    if coupling.is_empty() {
        return Ok(None);
    }
    if coupling.len() != joints * joints
        || coupling
            .iter()
            .any(|c| !is_within(*c, -MAX_COUPLING, MAX_COUPLING))
    {
        return Err(LoadError::Coupling);
    }
    let mut out = [[T::ZERO; MAX_JOINTS]; MAX_JOINTS];
    // Here joints ≥ 1; `max` says so to the compiler, which would link a panic for empty chunks.
    for (slots, row) in out.iter_mut().zip(coupling.chunks(joints.max(1))) {
        for (slot, value) in slots.iter_mut().zip(row) {
            *slot = T::from_f32(*value);
        }
    }
    Ok(Some(out))
}

/// Largest element of a coupling matrix; keeps serial joints within reach of the range reduction.
const MAX_COUPLING: f32 = 2.0;

/// The bytes of the rows, after every word was looked at.
fn checked_rows<'a>(task: &TaskSpace<'a>, capacity: usize) -> Result<&'a [u8], LoadError> {
    let inputs = task.input_scale.len();
    let words = task.rows.len() / 4;
    if !task.rows.len().is_multiple_of(4 * row_words(inputs)) {
        return Err(LoadError::PartialRow {
            bytes: task.rows.len() as u32,
        });
    }
    if words > capacity {
        return Err(LoadError::SupportTooLarge {
            words: words as u32,
            capacity: capacity as u32,
        });
    }
    for row in task.rows.chunks_exact(4 * row_words(inputs)) {
        for (index, word) in row.as_chunks::<4>().0.iter().enumerate() {
            let limit = if index < inputs {
                MAX_SCALED_INPUT as f32
            } else {
                MAX_COEFFICIENT
            };
            if !is_within(f32::from_le_bytes(*word), -limit, limit) {
                return Err(LoadError::Row);
            }
        }
    }
    Ok(task.rows)
}
