//! What gravity does to the joints: regressors of links and payload, and their coefficients.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use super::PerJoint;
use crate::scalar::Scalar;
use crate::se3::{Pose, cross, dot, scale, subtract};

/// Gravity at one configuration: everything that its regressors are made of.
#[derive(Clone, Copy, Debug)]
pub struct GravityRegressors<'a, T> {
    kinds: &'a [JointKind],
    /// Frames of the joints before they move; that of joint j + 1 is link j.
    frames: &'a [Pose<T>; MAX_JOINTS],
    /// The last link, with the target as its origin.
    target: &'a Pose<T>,
    /// g.
    gravity: &'a Vector3<T>,
}

impl<'a, T: Scalar> GravityRegressors<'a, T> {
    /// From the frames of the joints before they move (see [`crate::poe::Poe::joint_frames`]) and the target.
    #[inline(always)]
    pub fn new(
        kinds: &'a [JointKind],
        frames: &'a [Pose<T>; MAX_JOINTS],
        target: &'a Pose<T>,
        gravity: &'a Vector3<T>,
    ) -> Self {
        Self {
            kinds,
            frames,
            target,
            gravity,
        }
    }

    /// The three regressors of joint `c` and link `link` ≥ c in m/s²; of a prismatic joint only the first is not zero.
    pub fn link(&self, c: usize, link: usize) -> Vector3<T> {
        let zero = Vector3::new(T::ZERO, T::ZERO, T::ZERO);
        let (Some(kind), Some(frame)) = (self.kinds.get(c), self.frames.get(c)) else {
            return zero;
        };
        let last = link + 1 >= self.kinds.len();
        let rotation = match self.frames.get(link + 1) {
            Some(next) if !last => &next.rotation,
            _ => &self.target.rotation,
        };
        let axis = third_column(frame);
        match kind {
            JointKind::Revolute => {
                let w = cross(self.gravity, &axis);
                let component = |i: usize| {
                    rotation[(0, i)] * w[0] + rotation[(1, i)] * w[1] + rotation[(2, i)] * w[2]
                };
                Vector3::new(component(0), component(1), component(2))
            }
            JointKind::Prismatic => Vector3::new(dot(&axis, self.gravity), T::ZERO, T::ZERO),
        }
    }

    /// The regressors of joint `c` for a payload of 1 kg: the lever to the target (m²/s²), and three of its offset.
    pub fn payload(&self, c: usize) -> (T, Vector3<T>) {
        let offset = self.link(c, self.kinds.len().saturating_sub(1));
        let lever = match (self.kinds.get(c), self.frames.get(c)) {
            (Some(JointKind::Revolute), Some(frame)) => dot(
                &subtract(&self.target.translation, &frame.translation),
                &cross(self.gravity, &third_column(frame)),
            ),
            _ => T::ZERO,
        };
        (lever, offset)
    }
}

/// z of a frame.
#[inline(always)]
pub(super) fn third_column<T: Scalar>(frame: &Pose<T>) -> Vector3<T> {
    let r = &frame.rotation;
    Vector3::new(r[(0, 2)], r[(1, 2)], r[(2, 2)])
}

/// Coefficients of the gravity terms.
#[derive(Clone, Copy, Debug)]
pub struct GravityTerms<T> {
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<T>,
    /// a_cj for c ≤ j; the others are zero.
    pub links: [[Vector3<T>; MAX_JOINTS]; MAX_JOINTS],
    /// b_c0.
    pub payload_lever: PerJoint<T>,
    /// b_c.
    pub payload_offset: [Vector3<T>; MAX_JOINTS],
}

impl<T: Scalar> GravityTerms<T> {
    /// No effect, with gravity along −z.
    pub fn zero() -> Self {
        let zero = Vector3::new(T::ZERO, T::ZERO, T::ZERO);
        Self {
            gravity: Vector3::new(T::ZERO, T::ZERO, T::from_f64(-9.81)),
            links: [[zero; MAX_JOINTS]; MAX_JOINTS],
            payload_lever: [T::ZERO; MAX_JOINTS],
            payload_offset: [zero; MAX_JOINTS],
        }
    }

    /// What gravity does to every joint, rad or m: the regressors times the coefficients, w_c taken out of the sum,
    /// w_c·(Σ_j R_j a_cj + m ((o_t − o_c) b_c0 + R_n b_c)).
    // A function of its own: evaluation and trace share its code.
    #[inline(never)]
    pub fn deflection(&self, at: &GravityRegressors<'_, T>, payload_kg: T) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        let n = at.kinds.len();
        let joints = at.kinds.iter().zip(at.frames).zip(&self.links);
        let payload = self.payload_lever.iter().zip(&self.payload_offset);
        for ((c, sum), (((kind, frame), links), (lever, offset))) in
            out.iter_mut().enumerate().zip(joints.zip(payload))
        {
            // The payload acts on the last link, at its offset from the target.
            let mut last = scale(payload_kg, offset);
            if let Some(a) = links.get(n.wrapping_sub(1)) {
                add(&mut last, a);
            }
            let inner = links.get(c..n.wrapping_sub(1)).unwrap_or(&[]);
            let axis = third_column(frame);
            *sum = match kind {
                JointKind::Revolute => {
                    let arm = subtract(&at.target.translation, &frame.translation);
                    let mut moment = scale(payload_kg * *lever, &arm);
                    add(&mut moment, &turned(at.target, &last));
                    let after = at.frames.get(c + 1..).unwrap_or(&[]);
                    for (a, link) in inner.iter().zip(after) {
                        add(&mut moment, &turned(link, a));
                    }
                    dot(&moment, &cross(at.gravity, &axis))
                }
                JointKind::Prismatic => {
                    let mut weight = last[0];
                    for a in inner {
                        weight += a[0];
                    }
                    dot(&axis, at.gravity) * weight
                }
            };
        }
        out
    }
}

/// R v.
#[inline(always)]
fn turned<T: Scalar>(frame: &Pose<T>, v: &Vector3<T>) -> Vector3<T> {
    let r = &frame.rotation;
    let row = |i: usize| r[(i, 0)] * v[0] + r[(i, 1)] * v[1] + r[(i, 2)] * v[2];
    Vector3::new(row(0), row(1), row(2))
}

#[inline(always)]
fn add<T: Scalar>(sum: &mut Vector3<T>, v: &Vector3<T>) {
    for i in 0..3 {
        sum[i] += v[i];
    }
}
