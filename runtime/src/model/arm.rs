//! All parts of a model except its rows of inducing points.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, Transform};
use poegp_protocol::limits::{MAX_INPUTS, MAX_JOINTS};

use super::cost::{CorrectionSize, ModelSize};
use super::elastic::ElasticCorrection;
use super::load_error::LoadError;
use super::task_space::TaskSpaceCorrection;
use super::validate::{MAX_PAYLOAD_KG, checked_chain, checked_coupling, checked_range, is_within};
use crate::guard::status::Status;
use crate::guard::trust::Trust;
use crate::kinematics::coupling::{Coupling, coupled};
use crate::kinematics::minimal_chain::{MinimalChain, MinimalForm};
use crate::kinematics::newton::{pose_error, squared_norms};
use crate::kinematics::poe::{JointTrig, zero_joint_trig};
use crate::math::scalar::{MAX_ANGLE, Scalar};

/// Number of configurations at which [`Arm::usual_rotation`] is sampled.
const SCALE_SAMPLES: u16 = 16;
/// Step of each joint from sample to sample, in 65 536ths of its range: powers of 1/x for the root of x⁹ = x + 1, which
/// spread the samples most evenly in eight dimensions.
const SPREAD: [u16; MAX_JOINTS] = [
    60_399, 55_663, 51_299, 47_277, 43_571, 40_155, 37_007, 34_105,
];

/// A model without its rows of inducing points.
#[derive(Clone, Debug)]
pub(crate) struct Arm<T> {
    pub(crate) calibrated: MinimalChain<T>,
    pub(crate) nominal: MinimalChain<T>,
    pub(crate) coupling: Option<Coupling<T>>,
    pub(crate) joint_ranges: [(T, T); MAX_JOINTS],
    pub(crate) payload_range: Option<(T, T)>,
    /// Root mean square angle between the nominal and the calibrated target within the trained ranges, in rad.
    pub(crate) usual_rotation: T,
    trust: Trust<T>,
    /// Standard deviation of a position component in m, if it is constant.
    pub(super) constant_sigma: Option<T>,
    pub(crate) correction: ArmCorrection<T>,
}

/// Correction that a model applies beyond its calibrated chain.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // nothing can be boxed
pub(crate) enum ArmCorrection<T> {
    None,
    TaskSpace(TaskSpaceCorrection<T>),
    Elastic(ElasticCorrection<T>),
}

/// Returns the minimal form of the chain with these joints and frames.
// A separate function, compiled once: its copies of the frames are on the stack only while it runs.
#[inline(never)]
fn minimal<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Transform<f32>],
) -> Result<MinimalForm<T>, LoadError> {
    Ok(MinimalForm::new(&checked_chain(kinds, frames)?))
}

impl<T: Scalar> Arm<T> {
    /// Returns an arm without joints.
    #[inline(always)]
    pub(crate) fn empty() -> Self {
        Self {
            calibrated: MinimalChain::empty(),
            nominal: MinimalChain::empty(),
            coupling: None,
            joint_ranges: [(T::ZERO, T::ZERO); MAX_JOINTS],
            payload_range: None,
            usual_rotation: T::ZERO,
            trust: Trust::none(),
            constant_sigma: None,
            correction: ArmCorrection::None,
        }
    }

    /// Fills an empty arm with that of `blob`. After an error the arm must not be used.
    #[inline(never)]
    pub(crate) fn fill(&mut self, blob: &Blob<'_>) -> Result<(), LoadError> {
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
        self.nominal = MinimalChain::new(&minimal(kinds, &blob.geometry.nominal)?);
        self.coupling = checked_coupling(&blob.robot.coupling, joints)?;
        self.payload_range = blob
            .ranges
            .payload_kg
            .map(|range| checked_range(range, MAX_PAYLOAD_KG))
            .transpose()?;
        self.trust = Trust::of(blob);
        self.constant_sigma = super::position_variance::constant(blob.variance.as_ref());
        let calibrated = minimal(kinds, &blob.geometry.calibrated)?;
        self.calibrated = MinimalChain::new(&calibrated);
        self.usual_rotation = self.measured_rotation();
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
                    let (ranges, payload) = (&self.joint_ranges, blob.ranges.payload_kg);
                    found.fill(elastic, variance, &calibrated, ranges, payload)?;
                }
            }
        }
        Ok(())
    }

    /// Returns the sizes of the model, which determine its cost.
    pub(super) fn size(&self) -> ModelSize {
        let (kinds, coupling) = (self.calibrated.kinds(), self.coupling.as_ref());
        let correction = match &self.correction {
            ArmCorrection::None => CorrectionSize::None,
            ArmCorrection::TaskSpace(task) => task.size(),
            ArmCorrection::Elastic(elastic) => CorrectionSize::Elastic(elastic.size(kinds)),
        };
        ModelSize {
            joints: kinds.len(),
            sliding: kinds
                .iter()
                .filter(|kind| **kind == JointKind::Prismatic)
                .count(),
            coupling_terms: coupling.map_or(0, |c| c.terms().count()),
            coupled_joints: coupling.map_or(0, Coupling::coupled_joints),
            correction,
        }
    }

    /// Computes [`Arm::usual_rotation`] from [`SCALE_SAMPLES`] configurations that fill the ranges evenly.
    #[inline(never)]
    fn measured_rotation(&self) -> T {
        let mut rotations = T::ZERO;
        let mut index = 1_u16;
        while index <= SCALE_SAMPLES {
            let mut joints = [T::ZERO; MAX_JOINTS];
            let ranges = self.joint_ranges.iter().zip(SPREAD);
            for (slot, ((lower, upper), spread)) in joints.iter_mut().zip(ranges) {
                let along = f32::from(index.wrapping_mul(spread)) * (1.0 / 65_536.0);
                *slot = *lower + T::from_f32(along) * (*upper - *lower);
            }
            let mut motions = zero_joint_trig();
            self.motions(&joints, &mut motions);
            let nominal = self.nominal.forward_at(&motions);
            let calibrated = self.calibrated.forward_at(&motions);
            rotations += squared_norms(&pose_error(&nominal, &calibrated)).1;
            index += 1;
        }
        (rotations * T::from_f64(1.0 / SCALE_SAMPLES as f64)).sqrt()
    }

    /// Copies the joints into an array of zeros. Returns whether the arm has as many and all are within ±[`MAX_ANGLE`].
    // Not an `Option` of an array, which would be copied twice.
    #[inline(always)]
    pub(crate) fn take_joints(&self, joints: &[T], out: &mut [T; MAX_JOINTS]) -> bool {
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

    /// Computes the [`JointTrig`] of the serial joints at the controller's joints `x`.
    #[inline(always)]
    pub(crate) fn motions(&self, x: &[T; MAX_JOINTS], out: &mut JointTrig<T>) {
        match &self.coupling {
            None => self.calibrated.joint_trig_into(x, out),
            coupling => self
                .calibrated
                .joint_trig_into(&coupled(coupling.as_ref(), x), out),
        }
    }

    /// Returns the inputs x = [q, m] of a task-space correction, without m if the model knows no payload.
    #[inline(always)]
    pub(crate) fn inputs(&self, joints: &[T; MAX_JOINTS], payload_kg: T) -> [T; MAX_INPUTS] {
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

    /// Returns the trust in finite joints and payload, and a status that flags those outside the trained ranges.
    #[inline(always)]
    pub(crate) fn range(&self, joints: &[T; MAX_JOINTS], payload_kg: T) -> (T, Status) {
        let joints = joints.get(..self.calibrated.kinds().len());
        self.trust.at(
            joints.unwrap_or(&[]),
            &self.joint_ranges,
            payload_kg,
            self.payload_range,
        )
    }
}
