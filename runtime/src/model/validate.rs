//! Checks of a blob's numbers before a robot is moved by them.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{CorrectionLimit, Transform};
use poegp_protocol::limits::{MAX_COUPLING, MAX_FRAMES};

use crate::guard::limit::Limit;
use crate::kinematics::coupling::Coupling;
use crate::kinematics::poe::Poe;
use crate::math::scalar::{MAX_ANGLE, Scalar};
use crate::math::se3::{Pose, cross, dot};
use crate::model::load_error::LoadError;

/// Largest payload, in kg, that is accepted as one.
pub const MAX_PAYLOAD_KG: f32 = 100_000.0;

/// Largest displacement of a chain's fixed frame along an axis, in m.
const MAX_FRAME_LENGTH: f32 = 100.0;
/// Largest deviation of a stored rotation from orthonormal, see [`is_rigid`].
const MAX_ROTATION_ERROR: f32 = 1e-4;
/// Largest deviation of a requested pose's rotation from orthonormal: four decimals are enough.
const MAX_ASKED_ROTATION_ERROR: f32 = 1e-3;
/// Largest coordinate of a requested pose, in m.
const FARTHEST: f32 = 1e4;
/// Largest weight, constant or slope of a correction: with it no sum of the posterior mean can overflow
/// ((8·4096 + 10⁵)·10³⁰ of the slopes and 10³⁰ for each of a million points stay below f32::MAX).
pub(super) const MAX_COEFFICIENT: f32 = 1e30;
/// Largest Σ_d W_d of a kernel: with it, exponents stay within the range of `exp2`.
pub(super) const MAX_RATE_SUM: f32 = 100_000.0;
/// Largest limit of a correction's displacement that a blob may set, in m.
const MAX_LIMIT_M: f32 = 1.0;
/// Largest limit of a correction's rotation that a blob may set, in rad.
const MAX_LIMIT_RAD: f32 = 0.5;

/// Upper bound on the words of a row of inducing points.
const MAX_ROW_WORDS: usize = 64;

pub(super) fn checked_limit<T: Scalar>(limit: &CorrectionLimit) -> Result<Limit<T>, LoadError> {
    if !is_within(limit.position_m, 0.0, MAX_LIMIT_M)
        || !is_within(limit.angle_rad, 0.0, MAX_LIMIT_RAD)
    {
        return Err(LoadError::CorrectionLimit);
    }
    Ok(Limit {
        position: T::from_f32(limit.position_m),
        angle: T::from_f32(limit.angle_rad),
    })
}

/// Returns the bytes of rows of inducing points, `words` words each, after checking every word: word i of a row must be
/// within ±`limit(i)`.
pub(super) fn checked_rows(
    rows: &[u8],
    words: usize,
    limit: impl Fn(usize) -> f32,
    capacity: usize,
) -> Result<&[u8], LoadError> {
    // Clamped for the compiler, which would otherwise link a panic for empty chunks.
    let row_bytes = 4 * words.clamp(1, MAX_ROW_WORDS);
    if !rows.len().is_multiple_of(row_bytes) {
        return Err(LoadError::PartialRow {
            bytes: rows.len() as u32,
        });
    }
    if rows.len() / 4 > capacity {
        return Err(LoadError::InducingPointsTooLarge {
            needed: (rows.len() / 4) as u32,
            capacity: capacity as u32,
        });
    }
    for row in rows.chunks_exact(row_bytes) {
        for (index, word) in row.as_chunks::<4>().0.iter().enumerate() {
            let limit = limit(index);
            if !is_within(f32::from_le_bytes(*word), -limit, limit) {
                return Err(LoadError::Row);
            }
        }
    }
    Ok(rows)
}

/// Returns the largest magnitude of a joint's word in a row of inducing points.
pub(super) fn feature_limit(kind: JointKind) -> f32 {
    match kind {
        // A sine or cosine, which rounding may have moved beyond 1.
        JointKind::Revolute => 1.000_001,
        JointKind::Prismatic => MAX_ANGLE,
    }
}

/// Returns whether lower ≤ value ≤ upper; false for NaN.
#[inline(always)]
pub(crate) fn is_within<T: Scalar>(value: T, lower: T, upper: T) -> bool {
    value >= lower && value <= upper
}

pub(super) fn checked_range<T: Scalar>(
    (lower, upper): (f32, f32),
    limit: f32,
) -> Result<(T, T), LoadError> {
    if is_within(lower, -limit, upper) && is_within(upper, lower, limit) {
        Ok((T::from_f32(lower), T::from_f32(upper)))
    } else {
        Err(LoadError::Ranges)
    }
}

/// Returns whether a frame is a rotation and a displacement: no element of R Rᵀ differs from the identity by more than
/// `rotation`, and no component of the displacement exceeds `length`, in m. False for NaN.
#[inline(always)]
pub(crate) fn is_rigid<T: Scalar>(pose: &Pose<T>, rotation: T, length: T) -> bool {
    let square = crate::math::se3::product(&pose.rotation, &pose.rotation.transpose());
    let identity = Pose::<T>::identity().rotation;
    let column = |j: usize| pose.rotation.column(j).into_owned();
    // The determinant, because a reflection is orthonormal, too.
    let volume = dot(&cross(&column(0), &column(1)), &column(2));
    square
        .iter()
        .zip(identity.iter())
        .all(|(a, b)| is_within(*a - *b, -rotation, rotation))
        && is_within(volume, T::ZERO, T::from_f64(2.0))
        && pose
            .translation
            .iter()
            .all(|t| is_within(*t, -length, length))
}

/// Returns whether a caller's twelve numbers are a rigid transform within plausible bounds.
pub(crate) fn is_pose<T: Scalar>(pose: &Pose<T>) -> bool {
    let rotation = T::from_f32(MAX_ASKED_ROTATION_ERROR);
    is_rigid(pose, rotation, T::from_f32(FARTHEST))
}

pub(super) fn checked_chain<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Transform<f32>],
) -> Result<Poe<T>, LoadError> {
    let mut poses = [Pose::identity(); MAX_FRAMES];
    for (index, (slot, frame)) in poses.iter_mut().zip(frames).enumerate() {
        let pose = Pose::<f32>::from_rows(frame);
        if !is_rigid(&pose, MAX_ROTATION_ERROR, MAX_FRAME_LENGTH) {
            return Err(LoadError::Frame { index: index as u8 });
        }
        *slot = orthonormal(pose.cast());
    }
    Poe::new(kinds, poses.get(..frames.len()).unwrap_or(&[])).map_err(|_| LoadError::Chain)
}

/// Replaces the rotation R of a pose stored in single precision with the nearest one, R (3 I − Rᵀ R)/2, if `T` is finer. As
/// stored, its columns have lengths and angles correct to seven digits, and other programs' results would differ by as much.
fn orthonormal<T: Scalar>(mut pose: Pose<T>) -> Pose<T> {
    if T::ROUNDING < T::from_f32(f32::ROUNDING) {
        let r = pose.rotation;
        let off = crate::math::se3::product(&r.transpose(), &r);
        let twice = crate::math::se3::product(&r, &off);
        let half = T::from_f64(0.5);
        for (value, part) in pose.rotation.iter_mut().zip(twice.iter()) {
            *value = half * ((*value + *value + *value) - *part);
        }
    }
    pose
}

pub(super) fn checked_coupling<T: Scalar>(
    coupling: &[f32],
    joints: usize,
) -> Result<Option<Coupling<T>>, LoadError> {
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
    let elements = coupling.iter().map(|value| T::from_f32(*value));
    Ok(Some(Coupling::new(joints, elements)))
}
