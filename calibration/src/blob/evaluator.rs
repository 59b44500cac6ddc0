//! Evaluates a blob in `f32`, as the device does, or in `f64`; all arguments and results are in `f64`.
//!
//! The formulas are the runtime's. This module adds the instrument's frame, in which poses are measured.

use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::correct::inverse::Inverse;
use poegp_runtime::correct::{CompiledCorrection, Corrected};
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::newton::Jacobian;
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::{Model, words_for};

use crate::blob::predict::{BlobModel, orthonormal};
use crate::learning::task_space::MAX_POINTS;

const CAPACITY: usize = words_for(MAX_POINTS);

/// The number type of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// `f32`, bit-identical to the device.
    Single,
    /// `f64`.
    Double,
}

/// The frame in which poses are stated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// The instrument's frame of the calibration. Rotations are orthonormal to `f64`.
    Instrument,
    /// The base frame of the model; poses are as the runtime computes them.
    Base,
}

/// One prediction of an [`Evaluator`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted {
    /// Pose of the target in the requested frame.
    pub pose: Pose<f64>,
    /// The status flags of the prediction.
    pub status: Status,
    /// Trust: 1 within the trained ranges, falling to 0 outside.
    pub trust: f64,
    /// Standard deviation of one position component of a new measurement, in metres, if the blob has a variance.
    pub position_sigma: Option<f64>,
}

/// A blob that is evaluated in one precision.
#[derive(Debug)]
pub struct Evaluator {
    blob: BlobModel,
    /// The model in double precision, if it is evaluated so; `blob` has the model in single precision.
    wide: Option<Box<Model<f64, CAPACITY>>>,
}

impl Evaluator {
    /// Creates an evaluator for a blob.
    ///
    /// # Errors
    /// [`LoadError`], which cannot occur for a [`BlobModel`], because it was checked when it was decoded.
    pub fn new(blob: BlobModel, precision: Precision) -> Result<Self, LoadError> {
        let wide = match precision {
            Precision::Single => None,
            Precision::Double => {
                let mut model = Box::new(Model::new());
                model.load_decoded(blob.blob())?;
                Some(model)
            }
        };
        Ok(Self { blob, wide })
    }

    /// Returns the blob.
    pub fn blob(&self) -> &BlobModel {
        &self.blob
    }

    /// Returns the precision of the evaluation.
    pub fn precision(&self) -> Precision {
        match self.wide {
            Some(_) => Precision::Double,
            None => Precision::Single,
        }
    }

    /// Predicts the pose of the calibrated arm at the controller's joints (rad or m) with a payload in kg. In single
    /// precision and the instrument's frame the result is that of [`BlobModel::predict`].
    pub fn predict(&self, joints: &[f64], payload_kg: f64, frame: Frame) -> Predicted {
        match &self.wide {
            Some(model) => self.predicted(model, joints, payload_kg, frame),
            None => self.predicted(self.blob.model(), joints, payload_kg, frame),
        }
    }

    /// Returns the pose of the nominal arm with base and tool of the gauge; `None` for invalid joints.
    pub fn nominal(&self, joints: &[f64], frame: Frame) -> Option<Pose<f64>> {
        let pose = match &self.wide {
            Some(model) => model.nominal(joints)?,
            None => self
                .blob
                .model()
                .nominal(rounded(joints, &mut [0.0; MAX_JOINTS]))?
                .cast(),
        };
        Some(self.seen(pose, frame))
    }

    /// Returns the joints to command so that the calibrated arm stands where the nominal one would.
    pub fn correct(&self, joints: &[f64], payload_kg: f64) -> Corrected<f64> {
        match &self.wide {
            Some(model) => model.correct(joints, payload_kg),
            None => {
                let found = self
                    .blob
                    .model()
                    .correct(rounded(joints, &mut [0.0; MAX_JOINTS]), payload_kg as f32);
                Corrected {
                    joints: found.joints.map(f64::from),
                    applied: found.applied.into(),
                    position_error: found.position_error.into(),
                    rotation_error: found.rotation_error.into(),
                    status: found.status,
                }
            }
        }
    }

    /// Returns the joints near `seed` at which the calibrated arm's tool, `target_from_tool`, is at the given pose.
    pub fn inverse(
        &self,
        (pose, frame): (&Pose<f64>, Frame),
        target_from_tool: &Pose<f64>,
        seed: &[f64],
        payload_kg: f64,
    ) -> Inverse<f64> {
        let wanted = match frame {
            Frame::Base => *pose,
            Frame::Instrument => self.blob.instrument_from_base().inverse() * *pose,
        };
        match &self.wide {
            Some(model) => model.tool_inverse(&wanted, target_from_tool, seed, payload_kg),
            None => {
                let model = self.blob.model();
                let (wanted, tool) = (wanted.cast(), target_from_tool.cast());
                let mut room = [0.0; MAX_JOINTS];
                let seed = rounded(seed, &mut room);
                let found = model.tool_inverse(&wanted, &tool, seed, payload_kg as f32);
                Inverse {
                    joints: found.joints.map(f64::from),
                    position_error: found.position_error.into(),
                    rotation_error: found.rotation_error.into(),
                    status: found.status,
                }
            }
        }
    }

    /// Returns the Jacobian of the target by columns, with zeros after the last joint:
    /// [`tool_jacobian`](poegp_runtime::model::Model::tool_jacobian) without a tool.
    pub fn jacobian(&self, joints: &[f64], payload_kg: f64) -> Jacobian<f64> {
        match &self.wide {
            Some(model) => {
                let found = model.tool_jacobian(&Pose::identity(), joints, payload_kg);
                found.columns
            }
            None => {
                let model = self.blob.model();
                let kg = payload_kg as f32;
                let found = model.tool_jacobian(
                    &Pose::identity(),
                    rounded(joints, &mut [0.0; MAX_JOINTS]),
                    kg,
                );
                found.columns.map(|column| column.map(f64::from))
            }
        }
    }

    fn predicted<T: CompiledCorrection>(
        &self,
        model: &Model<T, CAPACITY>,
        joints: &[f64],
        payload_kg: f64,
        frame: Frame,
    ) -> Predicted {
        let mut room = [T::ZERO; MAX_JOINTS];
        let found = model.evaluate(rounded(joints, &mut room), T::from_f64(payload_kg));
        Predicted {
            pose: self.seen(found.pose.cast(), frame),
            status: found.status,
            trust: found.trust.to_f64(),
            position_sigma: found.position_sigma.map(Scalar::to_f64),
        }
    }

    /// Transforms a pose from the base frame to the requested frame.
    fn seen(&self, base_from_target: Pose<f64>, frame: Frame) -> Pose<f64> {
        match frame {
            Frame::Base => base_from_target,
            Frame::Instrument => {
                orthonormal(&(self.blob.instrument_from_base() * base_from_target))
            }
        }
    }
}

/// Converts joints to the number type of the model. Too many joints become an empty slice: the model rejects both as bad
/// input.
fn rounded<'a, T: Scalar>(joints: &[f64], room: &'a mut [T; MAX_JOINTS]) -> &'a [T] {
    for (slot, joint) in room.iter_mut().zip(joints) {
        *slot = T::from_f64(*joint);
    }
    room.get(..joints.len()).unwrap_or(&[])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use nalgebra::Matrix3;

    fn example(precision: Precision) -> Evaluator {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/capi/examples/arm.blob");
        Evaluator::new(BlobModel::read(&path).unwrap(), precision).unwrap()
    }

    fn questions() -> impl Iterator<Item = ([f64; 6], f64)> {
        (0..50).map(|i| {
            let at = |j: i32| 0.01 * f64::from((i * 37 + j * 53) % 161 - 80);
            (
                [at(1), at(2), at(3), at(4), at(5), at(6)],
                0.1 * f64::from(i),
            )
        })
    }

    #[test]
    fn single_precision_has_the_bits_of_the_device_and_double_is_near() {
        let (single, double) = (example(Precision::Single), example(Precision::Double));
        for (q, kg) in questions() {
            let device = single.blob().predict(&q, Some(kg));
            let found = single.predict(&q, kg, Frame::Instrument);
            assert_eq!(found.pose, device.pose);
            assert_eq!(found.status, device.status);
            assert_eq!(found.trust, f64::from(device.trust));
            assert_eq!(found.position_sigma, device.position_sigma.map(f64::from));
            let wide = double.predict(&q, kg, Frame::Instrument);
            let apart = (wide.pose.translation - found.pose.translation).norm();
            assert!(apart > 0.0 && apart < 3e-6, "{apart:e}");
            let [a, b] = [&single, &double].map(|e| e.correct(&q, kg));
            assert_eq!(a.status, b.status);
            for (a, b) in a.joints.iter().zip(&b.joints) {
                assert!((a - b).abs() < 1e-5);
            }
            let [a, b] = [&single, &double].map(|e| e.jacobian(&q, kg));
            for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
                assert!((a - b).abs() < 1e-5);
            }
        }
    }

    /// Poses of both frames lead back to the joints, and differ by where the instrument stands.
    #[test]
    fn frames_belong_together() {
        for precision in [Precision::Single, Precision::Double] {
            let arm = example(precision);
            assert_eq!(arm.precision(), precision);
            let near = match precision {
                Precision::Single => 3e-6,
                Precision::Double => 1e-6,
            };
            for (q, kg) in questions() {
                let [seen, base] =
                    [Frame::Instrument, Frame::Base].map(|frame| arm.predict(&q, kg, frame).pose);
                let carried = arm.blob().instrument_from_base() * base;
                assert!((carried.translation - seen.translation).norm() < 1e-12);
                let square = seen.rotation * seen.rotation.transpose();
                assert!((square - Matrix3::identity()).amax() < 1e-14);
                let [a, b] = [Frame::Instrument, Frame::Base]
                    .map(|frame| arm.nominal(&q, frame).unwrap().translation);
                assert!((arm.blob().instrument_from_base().transform_point(&b) - a).norm() < 1e-12);
                for (pose, frame) in [(seen, Frame::Instrument), (base, Frame::Base)] {
                    let found = arm.inverse((&pose, frame), &Pose::identity(), &q, kg);
                    let there = arm.predict(&found.joints[..6], kg, frame).pose;
                    assert!((there.translation - pose.translation).norm() < near);
                }
            }
            assert_eq!(arm.nominal(&[f64::NAN; 6], Frame::Base), None);
            let answer = arm.predict(&[0.0; 9], 0.0, Frame::Base);
            assert!(answer.status.contains(Status::BAD_INPUT));
        }
    }
}
