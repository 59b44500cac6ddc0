//! A calibrated arm in fixed memory: T_gp(q, m)·f(q) (paper, eq. 9) for every input, with a [`Status`](crate::Status).
//!
//! [`Model::load`] is the only way from a blob's words to a model. It checks every number first and changes nothing
//! when one is refused, so that the last good model survives. After it, [`Model::evaluate`] cannot fail: it bounds what
//! is too large, says what is outside the trained range, and answers the uncorrected pose for input that is not finite.
//!
//! `WORDS` is the room for rows of inducing points; no result depends on it.

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

/// Words of rows of inducing points for `points` points of the longest row.
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

impl<T: Scalar, const WORDS: usize> Default for Model<T, WORDS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar, const WORDS: usize> Model<T, WORDS> {
    /// No model: every evaluation answers [`Status::NO_MODEL`](crate::Status::NO_MODEL).
    pub const fn new() -> Self {
        Self {
            arm: Slot::Empty,
            rows: Vec::new(),
        }
    }

    /// Takes over the model in the bytes of a blob. All or nothing: after an error the model is what it was. A signature is
    /// not verified; see [`Model::load_signed`].
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

    /// Takes over the model in the bytes of a blob that the holder of `public_key` (Ed25519) has signed. All or nothing.
    ///
    /// # Errors
    /// [`ModelError`].
    // Not inlined: the large stack frames of the two steps must not lie on top of each other.
    #[inline(never)]
    pub fn load_signed(&mut self, bytes: &[u8], public_key: &[u8; 32]) -> Result<(), ModelError> {
        signature::verify(bytes, public_key)?;
        self.load(bytes)
    }

    /// Takes over the model of a decoded blob. All or nothing: after an error the model is what it was.
    ///
    /// # Errors
    /// [`LoadError`] names the first number that is not one a robot may be moved by.
    // Inlined, its copies of the arm would lie on the stack beside those of the decoder.
    #[inline(never)]
    pub fn load_decoded(&mut self, blob: &Blob<'_>) -> Result<(), LoadError> {
        // Once on the stack, filled in place: every name in between would be a copy of the arm.
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

    /// Number of the controller's joints; 0 without a model.
    pub fn joints(&self) -> usize {
        self.arm
            .as_ref()
            .map_or(0, |arm| arm.calibrated.kinds().len())
    }

    /// Number of inducing points.
    pub fn inducing_points(&self) -> usize {
        match self.arm.as_ref().map(|arm| &arm.correction) {
            Some(ArmCorrection::TaskSpace(task)) => task.points(),
            Some(ArmCorrection::Elastic(elastic)) => elastic.deflection.processes.points(),
            _ => 0,
        }
    }

    /// Its sizes; `None` when there is no model.
    pub fn size(&self) -> Option<ModelSize> {
        self.arm.as_ref().map(Arm::size)
    }

    /// Forgets the model.
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

    /// `base_from_target` of the nominal chain (base and tool of the base-tool calibration) at the controller's joints,
    /// or `None` without a model or for bad input.
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
}

/// The bytes of the rows of inducing points, after every word was looked at.
fn checked_inducing_points<'a>(blob: &Blob<'a>, capacity: usize) -> Result<&'a [u8], LoadError> {
    match &blob.correction {
        Correction::None => Ok(&[]),
        Correction::TaskSpace(task) => task_space::checked_inducing_points(task, capacity),
        Correction::Elastic(elastic) => {
            elastic::checked_points(elastic, &blob.robot.joints, capacity)
        }
    }
}
