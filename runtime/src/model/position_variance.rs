//! Checks the position variance of a blob and loads it.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, Variance};
use poegp_protocol::limits::{MAX_JOINTS, MAX_LANDMARKS};

use crate::elastic::position_variance::{PositionVariance, landmark_words};
use crate::math::scalar::{MAX_ANGLE, Scalar};
use crate::model::MAX_PAYLOAD_KG;
use crate::model::load_error::LoadError;
use crate::model::validate::{MAX_COEFFICIENT, MAX_RATE_SUM, is_within};

/// Largest variance in m²: the standard deviation is at most 1 m.
const MAX_VARIANCE: f32 = 1.0;
/// Largest gain, and largest word of the triangular factor: with it, squares of 16 of them stay finite.
const MAX_FACTOR: f32 = 1e6;

/// Returns the standard deviation, in m, of a model for which it is constant; [`checked`] checks it.
pub(super) fn constant<T: Scalar>(wire: Option<&Variance<'_>>) -> Option<T> {
    let wire = wire.filter(|wire| wire.rates.is_empty())?;
    Some(T::from_f32(wire.floor_m2).sqrt())
}

/// Reads the header of a variance that depends on the input; [`checked`] checks it.
pub(super) fn header<T: Scalar>(wire: &Variance<'_>) -> PositionVariance<T> {
    let mut rates = [T::ZERO; MAX_JOINTS];
    for (slot, rate) in rates.iter_mut().zip(&wire.rates) {
        *slot = T::from_f32(*rate);
    }
    PositionVariance {
        floor: T::from_f32(wire.floor_m2),
        gain: T::from_f32(wire.gain),
        rates,
        payload_rate: T::from_f32(wire.payload_rate),
        landmarks: usize::from(wire.landmarks),
    }
}

/// Returns the bytes of the landmarks after checking every number of the variance; empty if there is no variance.
pub(super) fn checked<'a>(blob: &Blob<'a>, capacity: usize) -> Result<&'a [u8], LoadError> {
    let Some(wire) = &blob.variance else {
        return Ok(&[]);
    };
    let has_processes = match &blob.correction {
        Correction::None => false,
        Correction::Elastic(elastic) => !elastic.sets.is_empty(),
        // A task-space correction has a variance of its own.
        Correction::TaskSpace(_) => return Err(LoadError::Variance),
    };
    let varies = !wire.rates.is_empty();
    let mut rate_sum = 0.0;
    for rate in &wire.rates {
        rate_sum += if is_within(*rate, 0.0, MAX_RATE_SUM) {
            *rate
        } else {
            f32::INFINITY
        };
    }
    if varies != has_processes
        || (varies && wire.rates.len() != blob.robot.joints.len())
        || (!varies && (wire.landmarks > 0 || wire.gain != 0.0 || wire.payload_rate != 0.0))
        || !is_within(rate_sum, 0.0, MAX_RATE_SUM)
        || !is_within(wire.payload_rate, 0.0, MAX_COEFFICIENT)
        || usize::from(wire.landmarks) > MAX_LANDMARKS
        || !is_within(wire.floor_m2, 0.0, MAX_VARIANCE)
        || !is_within(wire.noise_m2, 0.0, wire.floor_m2)
        || !is_within(wire.gain, 0.0, MAX_FACTOR)
    {
        return Err(LoadError::Variance);
    }
    let joints = &blob.robot.joints;
    let mut words = wire.rows.as_chunks::<4>().0.iter();
    for landmark in 0..usize::from(wire.landmarks) {
        for index in 0..landmark_words(joints.len(), landmark) {
            let word = words.next().ok_or(LoadError::Variance)?;
            let limit = match joints.get(index / 2).map(|joint| joint.kind) {
                // A sine or cosine, which rounding may have moved beyond 1.
                Some(JointKind::Revolute) => 1.000_001,
                Some(JointKind::Prismatic) => MAX_ANGLE * MAX_ANGLE,
                None if index == 2 * joints.len() => MAX_PAYLOAD_KG,
                None => MAX_FACTOR,
            };
            if !is_within(f32::from_le_bytes(*word), -limit, limit) {
                return Err(LoadError::Variance);
            }
        }
    }
    if words.next().is_some() || !wire.rows.len().is_multiple_of(4) {
        return Err(LoadError::Variance);
    }
    if wire.rows.len() / 4 > capacity {
        return Err(LoadError::InducingPointsTooLarge {
            needed: (wire.rows.len() / 4) as u32,
            capacity: capacity as u32,
        });
    }
    Ok(wire.rows)
}
