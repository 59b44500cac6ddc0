//! What gravity does to the joints: regressors of links and payload, and their coefficients.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use super::PerJoint;
use crate::scalar::Scalar;
use crate::se3::{Pose, cross, dot, subtract};

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
        let n = at.kinds.len();
        let mut moments = [[T::ZERO; 3]; MAX_JOINTS];
        // The payload acts on the last link, at its offset from the target.
        let to = &at.target.translation;
        let turn = rows(at.target);
        let terms = self
            .links
            .iter()
            .zip(&self.payload_lever)
            .zip(&self.payload_offset);
        for ((moment, frame), ((links, lever), offset)) in
            moments.iter_mut().zip(at.frames).zip(terms).take(n)
        {
            let Some(a) = links.get(n.wrapping_sub(1)) else {
                break;
            };
            let pull = payload_kg * *lever;
            let from = &frame.translation;
            let last = [0, 1, 2].map(|i| payload_kg * offset[i] + a[i]);
            *moment = [0, 1, 2].map(|i| pull * (to[i] - from[i]));
            add_turned(moment, &turn, &last);
        }
        // Link by link, so that each rotation is read once.
        for (link, frame) in at
            .frames
            .iter()
            .skip(1)
            .enumerate()
            .take(n.saturating_sub(1))
        {
            let turn = rows(frame);
            for (moment, links) in moments.iter_mut().zip(&self.links).take(link + 1) {
                if let Some(a) = links.get(link) {
                    add_turned(moment, &turn, &[a[0], a[1], a[2]]);
                }
            }
        }
        let mut out = [T::ZERO; MAX_JOINTS];
        let joints = at.kinds.iter().zip(at.frames).zip(&moments);
        for ((c, sum), ((kind, frame), moment)) in out.iter_mut().enumerate().zip(joints) {
            let axis = third_column(frame);
            *sum = match kind {
                JointKind::Revolute => {
                    let w = cross(at.gravity, &axis);
                    moment[0] * w[0] + moment[1] * w[1] + moment[2] * w[2]
                }
                JointKind::Prismatic => dot(&axis, at.gravity) * self.weight(c, n, payload_kg),
            };
        }
        out
    }

    /// Σ_j a_cj of a prismatic joint, with the payload on the last link.
    #[inline(never)]
    fn weight(&self, c: usize, n: usize, payload_kg: T) -> T {
        let (Some(links), Some(offset)) = (self.links.get(c), self.payload_offset.get(c)) else {
            return T::ZERO;
        };
        let last = links.get(n.wrapping_sub(1)).map_or(T::ZERO, |a| a[0]);
        let mut weight = payload_kg * offset[0] + last;
        for a in links.get(c..n.wrapping_sub(1)).unwrap_or(&[]) {
            weight += a[0];
        }
        weight
    }
}

/// The rotation of a frame, row by row.
#[inline(always)]
fn rows<T: Scalar>(frame: &Pose<T>) -> [[T; 3]; 3] {
    let r = &frame.rotation;
    [0, 1, 2].map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)]])
}

/// sum + R v.
#[inline(always)]
fn add_turned<T: Scalar>(sum: &mut [T; 3], turn: &[[T; 3]; 3], v: &[T; 3]) {
    for (slot, row) in sum.iter_mut().zip(turn) {
        *slot += row[0] * v[0] + row[1] * v[1] + row[2] * v[2];
    }
}
