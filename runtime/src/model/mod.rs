//! A calibrated arm in fixed memory, which evaluates T_gp(q, m)·f(q) (paper, eq. 9) with a [`Status`](crate::Status).
//!
//! [`Model::load`] is the only way to make a model from the bytes of a blob. It checks every number first and changes
//! nothing if it refuses one, so that the last good model survives. After a load, [`Model::evaluate`] cannot fail: it bounds
//! a correction that is too large, flags inputs outside the trained ranges, and corrects nothing if the input is not finite.
//!
//! `WORDS` is the capacity for rows of inducing points; it affects no result.

pub(crate) mod arm;
pub mod cost;
pub(crate) mod elastic;
pub mod evaluate;
pub mod load_error;
mod model_error;
mod position_variance;
pub mod signature;
pub(crate) mod task_space;
pub(crate) mod validate;

use heapless::Vec;
use poegp_protocol::blob::{self, Blob, Correction};
use poegp_protocol::limits::{MAX_INPUTS, MAX_JOINTS};

use crate::gp::quadratic_posterior;
use crate::kinematics::poe::zero_joint_trig;
use crate::math::scalar::Scalar;
use crate::math::se3::Pose;
use crate::trace::{Observer, Stages};
use arm::{Arm, ArmCorrection};
use cost::ModelSize;
pub use evaluate::Evaluation;
use evaluate::{CompiledEvaluation, View};
use load_error::LoadError;
pub use model_error::ModelError;
pub use validate::MAX_PAYLOAD_KG;

/// A model in single precision with room for 400 inducing points.
pub type Model400 = Model<f32, { words_for(400) }>;

/// Returns the number of words that `points` inducing points with rows of the greatest length take.
pub const fn words_for(points: usize) -> usize {
    points * quadratic_posterior::row_words(MAX_INPUTS)
}

/// A calibrated arm.
#[derive(Debug)]
pub struct Model<T, const WORDS: usize> {
    arm: Slot<Arm<T>>,
    rows: Vec<T, WORDS>,
}

/// An `Option` whose empty state is all zeros, so that a static model takes no flash for its initial value: `None`
/// would be a nonzero byte, for which the whole model would be copied to flash.
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

impl<T: Scalar, const WORDS: usize> Default for Model<T, WORDS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar, const WORDS: usize> Model<T, WORDS> {
    /// Creates an empty model, whose evaluations all return [`Status::NO_MODEL`](crate::Status::NO_MODEL).
    pub const fn new() -> Self {
        Self {
            arm: Slot::Empty,
            rows: Vec::new(),
        }
    }

    /// Loads the model in the bytes of a blob. All or nothing: after an error the previous model is unchanged. Does not
    /// verify a signature; see [`signature::verify`].
    ///
    /// # Errors
    /// [`ModelError::Decode`], [`ModelError::Load`].
    pub fn load(&mut self, bytes: &[u8]) -> Result<(), ModelError> {
        // By reference: every move would be a copy of the blob on the stack.
        match &blob::decode(bytes) {
            Ok(blob) => Ok(self.load_decoded(blob)?),
            Err(error) => Err(ModelError::Decode(*error)),
        }
    }

    /// Loads the model of a decoded blob. All or nothing: after an error the previous model is unchanged.
    ///
    /// # Errors
    /// [`LoadError`] names the first number that a robot must not be moved by.
    // Not inlined: its copies of the arm would otherwise lie on the stack beside those of the decoder.
    #[inline(never)]
    pub fn load_decoded(&mut self, blob: &Blob<'_>) -> Result<(), LoadError> {
        // One arm on the stack, filled in place: every intermediate variable would be another copy of it.
        let mut slot = Slot::Full(Arm::empty());
        if let Slot::Full(arm) = &mut slot {
            arm.fill(blob)?;
        }
        let bytes = checked_inducing_points(blob, WORDS)?;
        let curves = match &blob.correction {
            Correction::Elastic(elastic) => {
                elastic::checked_curves(elastic, blob.robot.joints.len(), WORDS - bytes.len() / 4)?
            }
            _ => &[],
        };
        let room = WORDS - (bytes.len() + curves.len()) / 4;
        let landmarks = match &blob.correction {
            Correction::TaskSpace(task) if blob.variance.is_none() => {
                task_space::checked_landmarks(task, room)?
            }
            _ => position_variance::checked(blob, room)?,
        };
        self.rows.clear();
        for word in [bytes, curves, landmarks]
            .iter()
            .flat_map(|b| b.as_chunks::<4>().0)
        {
            // Cannot fail: the length was compared with the capacity.
            let _ = self.rows.push(T::from_f32(f32::from_le_bytes(*word)));
        }
        if let Slot::Full(arm) = &slot
            && let ArmCorrection::Elastic(elastic) = &arm.correction
        {
            let processes = &elastic.deflection.processes;
            processes.arrange(&mut self.rows);
        }
        self.arm = slot;
        Ok(())
    }

    /// Returns the number of the controller's joints; 0 without a model.
    pub fn joints(&self) -> usize {
        self.arm
            .as_ref()
            .map_or(0, |arm| arm.calibrated.kinds().len())
    }

    /// Returns the number of inducing points.
    pub fn inducing_points(&self) -> usize {
        match self.arm.as_ref().map(|arm| &arm.correction) {
            Some(ArmCorrection::TaskSpace(task)) => task.points(),
            Some(ArmCorrection::Elastic(elastic)) => elastic.deflection.processes.points(),
            _ => 0,
        }
    }

    /// Returns the sizes of the model, which determine its cost; `None` without a model.
    pub fn size(&self) -> Option<ModelSize> {
        self.arm.as_ref().map(Arm::size)
    }

    /// Discards the model.
    pub fn unload(&mut self) {
        self.arm = Slot::Empty;
        self.rows.clear();
    }

    #[inline(always)]
    pub(crate) fn view(&self) -> View<'_, T> {
        View {
            arm: self.arm.as_ref(),
            rows: &self.rows,
        }
    }

    /// Returns `base_from_target` of the nominal chain (base and tool of the base-tool calibration) at the controller's
    /// joints, or `None` without a model or for bad input.
    pub fn nominal(&self, joints: &[T]) -> Option<Pose<T>> {
        let arm = self.arm.as_ref()?;
        let mut x = [T::ZERO; MAX_JOINTS];
        if !arm.take_joints(joints, &mut x) {
            return None;
        }
        let mut motions = zero_joint_trig();
        arm.motions(&x, &mut motions);
        Some(arm.nominal.forward_at(&motions))
    }
}

impl<T: CompiledEvaluation, const WORDS: usize> Model<T, WORDS> {
    /// Evaluates T_gp(q, m)·f(q) for the controller's joints (rad or m) and the payload in kg (0 if the model knows none).
    #[inline(always)]
    pub fn evaluate(&self, joints: &[T], payload_kg: T) -> Evaluation<T> {
        self.evaluate_in_stages(joints, payload_kg, &mut Stages::new())
    }

    /// Evaluates the model like [`Model::evaluate`] and writes the intermediate results to `stages`.
    #[inline(always)]
    pub fn evaluate_in_stages(
        &self,
        joints: &[T],
        payload_kg: T,
        stages: &mut Stages<T>,
    ) -> Evaluation<T> {
        T::evaluate(self.view(), joints, payload_kg, stages)
    }

    /// Evaluates the model like [`Model::evaluate`] and passes every intermediate result to `observer`: the product and the
    /// bit comparison share one source.
    #[inline(always)]
    pub fn evaluate_observed(
        &self,
        joints: &[T],
        payload_kg: T,
        observer: &mut impl Observer<T>,
    ) -> Evaluation<T> {
        self.view().evaluate_observed(joints, payload_kg, observer)
    }
}

/// Returns the bytes of the rows of inducing points after checking every word.
fn checked_inducing_points<'a>(blob: &Blob<'a>, capacity: usize) -> Result<&'a [u8], LoadError> {
    match &blob.correction {
        Correction::None => Ok(&[]),
        Correction::TaskSpace(task) => task_space::checked_inducing_points(task, capacity),
        Correction::Elastic(elastic) => {
            elastic::checked_points(elastic, &blob.robot.joints, capacity)
        }
    }
}
