//! The deflection of the joints by gravity: regressors of links and payload, and their coefficients.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::kinematics::coupling::PerJoint;
use crate::kinematics::minimal_chain::MinimalForm;
use crate::math::scalar::Scalar;
use crate::math::se3::{Pose, cross, dot, subtract, third_column};

/// Gravity at one configuration: everything from which its regressors are computed.
#[derive(Clone, Copy, Debug)]
pub struct GravityRegressors<'a, T> {
    kinds: &'a [JointKind],
    /// Frames of the joints before they move; the frame of joint j + 1 is that of link j.
    frames: &'a [Pose<T>; MAX_JOINTS],
    /// Frame of the last link, with the target as its origin.
    target: &'a Pose<T>,
    /// Gravity g in the base frame, in m/s².
    gravity: &'a Vector3<T>,
}

impl<'a, T: Scalar> GravityRegressors<'a, T> {
    /// Creates the regressors from the frames of the joints before they move (see
    /// [`crate::kinematics::poe::Poe::joint_frames`]) and the target.
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

    /// Computes the three regressors of joint `c` and link `link` ≥ c, in m/s²; for a prismatic joint only the first is not
    /// zero.
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

    /// Computes the regressors of joint `c` for a payload of 1 kg: that of the lever to the target (m²/s²), and the three of
    /// the payload's offset.
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

/// Coefficients of the gravity terms.
#[derive(Clone, Copy, Debug)]
pub struct GravityTerms<T> {
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<T>,
    /// Coefficients a_cj of link j for joint c, where c ≤ j; the others are zero.
    pub links: [[Vector3<T>; MAX_JOINTS]; MAX_JOINTS],
    /// Coefficient b_c0 of the lever to the target, for each joint.
    pub payload_lever: PerJoint<T>,
    /// Coefficients b_c of the payload's offset from the target, for each joint.
    pub payload_offset: [Vector3<T>; MAX_JOINTS],
}

impl<T: Scalar> GravityTerms<T> {
    /// Returns terms without effect, with gravity along −z.
    pub fn zero() -> Self {
        let zero = Vector3::new(T::ZERO, T::ZERO, T::ZERO);
        Self {
            gravity: Vector3::new(T::ZERO, T::ZERO, T::from_f64(-9.81)),
            links: [[zero; MAX_JOINTS]; MAX_JOINTS],
            payload_lever: [T::ZERO; MAX_JOINTS],
            payload_offset: [zero; MAX_JOINTS],
        }
    }

    /// Computes the deflection of every joint by gravity, in rad or m: the regressors times the coefficients. [`Gravity`]
    /// computes the same faster.
    pub fn deflection(&self, at: &GravityRegressors<'_, T>, payload_kg: T) -> PerJoint<T> {
        let n = at.kinds.len();
        let mut out = [T::ZERO; MAX_JOINTS];
        let payload = self.payload_lever.iter().zip(&self.payload_offset);
        let joints = out.iter_mut().zip(&self.links).zip(payload);
        for (c, ((sum, links), (lever, offset))) in joints.enumerate().take(n) {
            for (link, a) in links.iter().enumerate().take(n).skip(c) {
                *sum += dot(&at.link(c, link), a);
            }
            let (to_target, of_offset) = at.payload(c);
            *sum += payload_kg * (to_target * *lever + dot(&of_offset, offset));
        }
        out
    }

    /// Converts the coefficients to the frames of `form`, which are turned about the axes of their joints.
    pub fn turn_into(&mut self, form: &MinimalForm<T>) {
        // The last link's frame is that of the target.
        let inner = form.poe.kinds().len().saturating_sub(1);
        for (links, kind) in self.links.iter_mut().zip(form.poe.kinds()) {
            if *kind == JointKind::Prismatic {
                // Only the weight acts on a prismatic joint.
                continue;
            }
            for (link, a) in links.iter_mut().enumerate().take(inner) {
                let [s, c] = form.turn_of(link + 1);
                *a = Vector3::new(c * a[0] + s * a[1], c * a[1] - s * a[0], a[2]);
            }
        }
    }

    /// Returns whether gravity does not act on this joint.
    fn is_idle(&self, c: usize) -> bool {
        let zero = |v: &Vector3<T>| v.iter().all(|x| *x == T::ZERO);
        self.links.get(c).is_none_or(|links| links.iter().all(zero))
            && self.payload_lever.get(c).is_none_or(|b| *b == T::ZERO)
            && self.payload_offset.get(c).is_none_or(zero)
    }
}

/// [`GravityTerms`] of one chain, arranged for a controller's cycle.
///
/// Each link keeps only two components for each joint. The component of a link's vector along z_j, the axis of the link's
/// own joint j, is fixed on the link before it: R_j a = M_j (α, β, 0) + M_{j−1} F_j (0, 0, γ), where M_j is the frame of
/// joint j after it moved and F_j the fixed frame before the joint. So γ is added to the coefficients of link j − 1. The
/// components along joint c's own axis are not needed: z_c·(g × z_c) = 0. The last link keeps three components in the
/// frame of the target, where the payload is.
#[derive(Clone, Debug)]
pub struct Gravity<T> {
    gravity: Vector3<T>,
    /// Number of joints at the base on which gravity does not act, such as the first joint of an upright arm. `joints`
    /// begins with the next joint.
    idle: usize,
    joints: [JointTerms<T>; MAX_JOINTS],
}

/// Coefficients of gravity on one joint.
#[derive(Clone, Copy, Debug)]
struct JointTerms<T> {
    /// (α, β) of the joint's own link and all that follow except the last.
    pairs: [[T; 2]; MAX_JOINTS],
    /// Coefficients a_cn of the last link.
    link: [T; 3],
    /// Coefficients b_c of the payload's offset.
    payload: [T; 3],
    /// Coefficient b_c0 of the lever to the target.
    lever: T,
    /// Coefficient Σ_j a_cj of the weight on a prismatic joint.
    weight: T,
}

impl<T: Scalar> Gravity<T> {
    /// Creates it from the coefficients for the frames of `form`, see [`GravityTerms::turn_into`].
    pub fn new(terms: &GravityTerms<T>, form: &MinimalForm<T>) -> Self {
        let mut out = Self::zero();
        out.set(terms, form);
        out
    }

    /// Returns gravity without effect.
    #[inline(always)]
    pub fn zero() -> Self {
        Self {
            gravity: Vector3::new(T::ZERO, T::ZERO, T::ZERO),
            idle: 0,
            joints: [JointTerms {
                pairs: [[T::ZERO; 2]; MAX_JOINTS],
                link: [T::ZERO; 3],
                payload: [T::ZERO; 3],
                lever: T::ZERO,
                weight: T::ZERO,
            }; MAX_JOINTS],
        }
    }

    /// Fills [`Gravity::zero`] in place from the coefficients for the frames of `form`, as [`Gravity::new`] does.
    #[inline(never)]
    pub fn set(&mut self, terms: &GravityTerms<T>, form: &MinimalForm<T>) {
        let (kinds, fixed) = (form.poe.kinds(), form.poe.frames());
        let n = kinds.len();
        let out = self;
        out.gravity = terms.gravity;
        out.idle = (0..n).take_while(|c| terms.is_idle(*c)).count();
        for c in out.idle..n {
            let (Some(slot), Some(links), Some(lever), Some(offset)) = (
                out.joints.get_mut(c - out.idle),
                terms.links.get(c),
                terms.payload_lever.get(c),
                terms.payload_offset.get(c),
            ) else {
                break;
            };
            let a = |j: usize| links.get(j).map_or([T::ZERO; 3], |a| [a[0], a[1], a[2]]);
            slot.link = a(n - 1);
            slot.payload = [offset[0], offset[1], offset[2]];
            slot.lever = *lever;
            for j in c..n {
                slot.weight += a(j)[0];
            }
            // From the outermost link inwards: the component that is fixed on the link before is handed on to it.
            let mut handed = [T::ZERO; 3];
            for j in (c..n - 1).rev() {
                let Some(next) = fixed.get(j + 1) else { break };
                let mut vector = [T::ZERO; 3];
                add_turned(&mut vector, &rows(next), &a(j));
                // The frame of joint j after it moved is where the next fixed frame begins.
                for (sum, value) in vector.iter_mut().zip(&handed) {
                    *sum += *value;
                }
                if let Some(pair) = slot.pairs.get_mut(j - c) {
                    *pair = [vector[0], vector[1]];
                }
                let axis = fixed.get(j).map_or([T::ZERO; 3], |frame| {
                    let z = third_column(frame);
                    [z[0], z[1], z[2]]
                });
                handed = axis.map(|z| z * vector[2]);
            }
        }
    }

    /// Returns the number of revolute joints on which gravity acts, and the number of links between each of them and the
    /// last joint, summed.
    pub fn loads(&self, kinds: &[JointKind]) -> (usize, usize) {
        let (mut joints, mut links) = (0, 0);
        for (c, kind) in kinds.iter().enumerate().skip(self.idle) {
            if *kind == JointKind::Revolute {
                joints += 1;
                links += kinds.len() - 1 - c;
            }
        }
        (joints, links)
    }

    /// Returns whether gravity is parallel to the z axis of the base.
    pub fn is_upright(&self) -> bool {
        self.gravity[0] == T::ZERO && self.gravity[1] == T::ZERO
    }

    /// Returns gravity g in the base frame, in m/s².
    pub fn acceleration(&self) -> &Vector3<T> {
        &self.gravity
    }

    /// Computes the deflection of every joint by gravity, in rad or m, from the frames of the joints after they moved.
    // A separate function: evaluation and trace share its code.
    #[inline(never)]
    pub fn deflection(
        &self,
        kinds: &[JointKind],
        frames: &[Pose<T>],
        target: &Pose<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        if self.is_upright() {
            // On an upright arm, gravity has no moment about the vertical: two rows are enough.
            self.add::<2>(kinds, frames, target, payload_kg, &mut out);
        } else {
            self.add::<3>(kinds, frames, target, payload_kg, &mut out);
        }
        out
    }

    /// Computes w_c·(Σ_j R_j a_cj + m ((o_t − o_c) b_c0 + R_n b_c)) for every joint from the first ROWS components of both
    /// vectors.
    #[inline(always)]
    fn add<const ROWS: usize>(
        &self,
        kinds: &[JointKind],
        frames: &[Pose<T>],
        target: &Pose<T>,
        payload_kg: T,
        out: &mut PerJoint<T>,
    ) {
        let n = kinds.len();
        let kinds = kinds.get(self.idle..).unwrap_or(&[]);
        let frames = frames.get(self.idle..n).unwrap_or(&[]);
        let out = out.get_mut(self.idle..).unwrap_or(&mut []);
        // All links from the joint's own outwards, except the last.
        let mut links = frames.split_last().map_or(frames, |(_, links)| links);
        let turn = rows(target);
        let joints = self.joints.iter().zip(out);
        for ((terms, sum), (kind, frame)) in joints.zip(kinds.iter().zip(frames)) {
            let outwards = links;
            links = links.get(1..).unwrap_or(&[]);
            let axis = third_column(frame);
            if *kind == JointKind::Prismatic {
                let weight = payload_kg * terms.payload[0] + terms.weight;
                *sum = dot(&axis, &self.gravity) * weight;
                continue;
            }
            let lever = payload_kg * terms.lever;
            let mut v = [T::ZERO; 3];
            let mut i = 0;
            while i < 3 {
                v[i] = payload_kg * terms.payload[i] + terms.link[i];
                i += 1;
            }
            let mut moment = [T::ZERO; ROWS];
            let mut r = 0;
            while r < ROWS {
                let row = &turn[r];
                moment[r] = lever * (target.translation[r] - frame.translation[r])
                    + (row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
                r += 1;
            }
            for (link, [a, b]) in outwards.iter().zip(&terms.pairs) {
                let turn = &link.rotation;
                let mut r = 0;
                while r < ROWS {
                    moment[r] += turn[(r, 0)] * *a + turn[(r, 1)] * *b;
                    r += 1;
                }
            }
            let w = pull::<T, ROWS>(&self.gravity, &axis);
            *sum = moment[0] * w[0];
            let mut r = 1;
            while r < ROWS {
                *sum += moment[r] * w[r];
                r += 1;
            }
        }
    }
}

/// Returns the first ROWS components of g × z; if ROWS is 2, g must be vertical.
#[inline(always)]
fn pull<T: Scalar, const ROWS: usize>(gravity: &Vector3<T>, axis: &Vector3<T>) -> [T; ROWS] {
    let mut out = [T::ZERO; ROWS];
    if ROWS == 2 {
        out[0] = -(gravity[2] * axis[1]);
        out[1] = gravity[2] * axis[0];
    } else {
        let w = cross(gravity, axis);
        for (slot, value) in out.iter_mut().zip(w.iter()) {
            *slot = *value;
        }
    }
    out
}

/// Returns the rotation of a frame, row by row.
#[inline(always)]
fn rows<T: Scalar>(frame: &Pose<T>) -> [[T; 3]; 3] {
    // Written out: a loop that the compiler does not unroll keeps the check of its index, and with it a panic.
    let r = &frame.rotation;
    [
        [r[(0, 0)], r[(0, 1)], r[(0, 2)]],
        [r[(1, 0)], r[(1, 1)], r[(1, 2)]],
        [r[(2, 0)], r[(2, 1)], r[(2, 2)]],
    ]
}

/// Adds R v to `sum`.
#[inline(always)]
fn add_turned<T: Scalar>(sum: &mut [T; 3], turn: &[[T; 3]; 3], v: &[T; 3]) {
    for (slot, row) in sum.iter_mut().zip(turn) {
        *slot += row[0] * v[0] + row[1] * v[1] + row[2] * v[2];
    }
}
