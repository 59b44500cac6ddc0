//! The product of exponentials with the fewest constants, for a controller's cycle.
//!
//! A rotation about a joint's axis, or a translation along it, commutes with the joint: Rz(a) Tz(z) Rz(q) =
//! Rz(q) Rz(a) Tz(z). Every fixed frame between two joints is
//!
//! ```text
//! F_i = Rz(a) Tz(z) · T(x, y, 0) Rx(α) · Rz(b)
//! ```
//!
//! so its first two factors can be moved to the frame before, F_{i−1} Rz(a) Tz(z), without a change to any joint value or
//! pose. That leaves four constants for each joint but the first: x, y, α and b. These are all that measurements of a chain
//! can show of a joint; unlike Denavit–Hartenberg parameters they stay small for parallel axes, for which a may be any
//! angle. A joint then costs 54 multiplications and additions instead of 81 ([`Poe::forward_with`]).
//!
//! [`MinimalForm`] moves the factors for a [`Poe`]; the trainer stores frames in that form, so that the constants of the
//! device are the stored numbers. Frames in any other form are converted when a model is loaded.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::kinematics::poe::{JointTrig, Poe, joint_trig_into};
use crate::math::scalar::Scalar;
use crate::math::se3::Pose;

/// `base_from_joint` of each joint after it moved.
pub type JointFrames<T> = Vec<Pose<T>, MAX_JOINTS>;

/// Sine and cosine of a rotation about z.
type Turn<T> = [T; 2];

/// A chain whose frames between joints are T(x, y, 0) Rx(α) Rz(b).
#[derive(Clone, Copy, Debug)]
pub struct MinimalForm<T> {
    /// The chain with its frames in this form.
    pub poe: Poe<T>,
    /// Sine and cosine of a_i. The frame of joint i before it moves was turned by a_i+1 about the joint's axis.
    turns: [Turn<T>; MAX_JOINTS],
}

impl<T: Scalar> MinimalForm<T> {
    /// Builds the minimal form of any chain. Frames that already have the form stay bit-identical.
    pub fn new(poe: &Poe<T>) -> Self {
        let mut out = Self {
            poe: *poe,
            turns: [[T::ZERO, T::ONE]; MAX_JOINTS],
        };
        let joints = poe.kinds().len();
        let (frames, turns) = (out.poe.frames_mut(), &mut out.turns);
        for i in (1..joints).rev() {
            let (Some(frame), Some(turn)) = (frames.get(i).copied(), turns.get_mut(i)) else {
                break;
            };
            let (left, rest) = minimal(&frame);
            *turn = left;
            let along = frame.translation[2];
            if let Some(slot) = frames.get_mut(i) {
                *slot = rest;
            }
            if let Some(before) = frames.get_mut(i - 1)
                && (left != [T::ZERO, T::ONE] || along != T::ZERO)
            {
                let r = &before.rotation;
                for k in 0..3 {
                    before.translation[k] += along * r[(k, 2)];
                }
                before.rotation = turned(before, left).rotation;
            }
        }
        out
    }

    /// Returns the sine and cosine of the angle by which the frame of joint `joint` (from 0) was turned about its axis.
    pub fn turn_of(&self, joint: usize) -> [T; 2] {
        self.turns
            .get(joint + 1)
            .copied()
            .unwrap_or([T::ZERO, T::ONE])
    }
}

/// Splits a frame Rz(a) Tz(z) · T(x, y, 0) Rx(α) Rz(b): returns the sine and cosine of a, and T(x, y, 0) Rx(α) Rz(b).
fn minimal<T: Scalar>(frame: &Pose<T>) -> (Turn<T>, Pose<T>) {
    let (r, t) = (&frame.rotation, &frame.translation);
    if r[(0, 2)] == T::ZERO && t[2] == T::ZERO {
        return ([T::ZERO, T::ONE], *frame);
    }
    let tilt = (r[(0, 2)] * r[(0, 2)] + r[(1, 2)] * r[(1, 2)]).sqrt();
    // For parallel axes any angle will do.
    let a = if tilt > T::ZERO {
        [r[(0, 2)] / tilt, -r[(1, 2)] / tilt]
    } else {
        [T::ZERO, T::ONE]
    };
    let back = |x: T, y: T| [a[1] * x + a[0] * y, a[1] * y - a[0] * x];
    let [sin_alpha, cos_alpha] = unit([tilt, r[(2, 2)]]);
    // One by one: in a `map`, compilers may keep the check of the index, and with it a panic.
    let cos_b = back(r[(0, 0)], r[(1, 0)])[0];
    let minus_sin_b = back(r[(0, 1)], r[(1, 1)])[0];
    let [sin_b, cos_b] = unit([-minus_sin_b, cos_b]);
    let [x, y] = back(t[0], t[1]);
    let zero = T::ZERO;
    let rest = Pose::from_rows(&[
        cos_b,
        -sin_b,
        zero,
        x, //
        cos_alpha * sin_b,
        cos_alpha * cos_b,
        -sin_alpha,
        y, //
        sin_alpha * sin_b,
        sin_alpha * cos_b,
        cos_alpha,
        zero,
    ]);
    (a, rest)
}

/// Returns the pair divided by its length, or (0, 1) for zeros.
fn unit<T: Scalar>([a, b]: [T; 2]) -> [T; 2] {
    let length = (a * a + b * b).sqrt();
    if length > T::ZERO {
        [a / length, b / length]
    } else {
        [T::ZERO, T::ONE]
    }
}

/// Returns T · Rz for the sine and cosine of the angle.
#[inline(always)]
fn turned<T: Scalar>(pose: &Pose<T>, [s, c]: Turn<T>) -> Pose<T> {
    let mut out = *pose;
    for k in 0..3 {
        let (x, y) = (pose.rotation[(k, 0)], pose.rotation[(k, 1)]);
        out.rotation[(k, 0)] = x * c + y * s;
        out.rotation[(k, 1)] = y * c - x * s;
    }
    out
}

/// The fixed frame T(x, y, 0) Rx(α) Rz(b) before a joint.
#[derive(Clone, Copy, Debug)]
struct Link<T> {
    x: T,
    y: T,
    sin_alpha: T,
    cos_alpha: T,
    sin_b: T,
    cos_b: T,
}

/// A chain of up to [`MAX_JOINTS`] joints in minimal form.
#[derive(Clone, Copy, Debug)]
pub struct MinimalChain<T> {
    joints: usize,
    kinds: [JointKind; MAX_JOINTS],
    base: Pose<T>,
    /// Fixed frames before each joint but the first.
    links: [Link<T>; MAX_JOINTS],
    target: Pose<T>,
}

impl<T: Scalar> MinimalChain<T> {
    /// Returns a chain without joints, all zeros.
    #[inline(always)]
    pub fn empty() -> Self {
        let nothing = Pose::from_rows(&[T::ZERO; 12]);
        let none = Link {
            x: T::ZERO,
            y: T::ZERO,
            sin_alpha: T::ZERO,
            cos_alpha: T::ZERO,
            sin_b: T::ZERO,
            cos_b: T::ZERO,
        };
        Self {
            joints: 0,
            kinds: [JointKind::Revolute; MAX_JOINTS],
            base: nothing,
            links: [none; MAX_JOINTS],
            target: nothing,
        }
    }

    /// Creates the chain from its minimal form.
    pub fn new(form: &MinimalForm<T>) -> Self {
        let none = Link {
            x: T::ZERO,
            y: T::ZERO,
            sin_alpha: T::ZERO,
            cos_alpha: T::ONE,
            sin_b: T::ZERO,
            cos_b: T::ONE,
        };
        let identity = Pose::identity();
        let (kinds, frames) = (form.poe.kinds(), form.poe.frames());
        let mut out = Self {
            joints: kinds.len(),
            kinds: [JointKind::Revolute; MAX_JOINTS],
            base: frames.first().copied().unwrap_or(identity),
            links: [none; MAX_JOINTS],
            target: frames.last().copied().unwrap_or(identity),
        };
        for (slot, kind) in out.kinds.iter_mut().zip(kinds) {
            *slot = *kind;
        }
        let between = frames.get(1..kinds.len()).unwrap_or(&[]);
        for (slot, frame) in out.links.iter_mut().zip(between) {
            let r = &frame.rotation;
            *slot = Link {
                x: frame.translation[0],
                y: frame.translation[1],
                sin_alpha: -r[(1, 2)],
                cos_alpha: r[(2, 2)],
                sin_b: -r[(0, 1)],
                cos_b: r[(0, 0)],
            };
        }
        out
    }

    /// Returns the kinds of the joints, base first.
    pub fn kinds(&self) -> &[JointKind] {
        self.kinds.get(..self.joints).unwrap_or(&[])
    }

    /// Writes the [`JointTrig`] of the joints at `q` to `out`, see [`Poe::joint_trig_into`].
    #[inline(always)]
    pub fn joint_trig_into(&self, q: &[T], out: &mut JointTrig<T>) {
        if T::SINES_TOGETHER && self.all_revolute() {
            let joints = self.kinds().len();
            T::sines_and_cosines(q.get(..joints).unwrap_or(q), out);
        } else {
            joint_trig_into(self.kinds(), q, out);
        }
    }

    /// Returns whether no joint is prismatic.
    // Compared as two words: a separate flag would make the model larger, and comparing joint by joint takes 22
    // instructions.
    #[inline(always)]
    fn all_revolute(&self) -> bool {
        const ALL: [u8; MAX_JOINTS] = [JointKind::Revolute as u8; MAX_JOINTS];
        u64::from_ne_bytes(self.kinds.map(|kind| kind as u8)) == u64::from_ne_bytes(ALL)
    }

    /// Computes f(q), `base_from_target`.
    // A separate function, for callers that need it more than once.
    #[inline(never)]
    pub fn forward_at(&self, motions: &JointTrig<T>) -> Pose<T> {
        self.walk(motions, |_| {})
    }

    /// Replaces `frames` with the frames of the joints after they moved, and returns f(q). On a Cortex-M4F, a returned array
    /// costs 400 instructions of copying, and one that must be cleared first 160.
    #[inline(never)]
    pub fn moved_frames_at(&self, motions: &JointTrig<T>, frames: &mut JointFrames<T>) -> Pose<T> {
        frames.clear();
        self.walk(motions, |frame| {
            // There are never more joints than fit.
            let _ = frames.push(*frame);
        })
    }

    #[inline(always)]
    fn walk(&self, motions: &JointTrig<T>, mut visit: impl FnMut(&Pose<T>)) -> Pose<T> {
        let mut joints = motions.iter().zip(self.kinds());
        let mut pose = self.base;
        if let Some((motion, kind)) = joints.next() {
            pose = moved(&pose, *kind, motion, [T::ZERO, T::ONE]);
            visit(&pose);
        }
        for ((motion, kind), link) in joints.zip(&self.links) {
            let mut after = pose;
            for k in 0..3 {
                let (x, y, z) = (
                    pose.rotation[(k, 0)],
                    pose.rotation[(k, 1)],
                    pose.rotation[(k, 2)],
                );
                after.translation[k] += x * link.x + y * link.y;
                after.rotation[(k, 1)] = y * link.cos_alpha + z * link.sin_alpha;
                after.rotation[(k, 2)] = z * link.cos_alpha - y * link.sin_alpha;
            }
            pose = moved(&after, *kind, motion, [link.sin_b, link.cos_b]);
            visit(&pose);
        }
        pose * self.target
    }
}

/// Returns T · Rz(b) · e^ẑ q.
#[inline(always)]
fn moved<T: Scalar>(
    pose: &Pose<T>,
    kind: JointKind,
    motion: &[T; 2],
    [sin_b, cos_b]: Turn<T>,
) -> Pose<T> {
    match kind {
        JointKind::Revolute => {
            let [s, c] = *motion;
            turned(pose, [s * cos_b + c * sin_b, c * cos_b - s * sin_b])
        }
        JointKind::Prismatic => {
            let mut out = turned(pose, [sin_b, cos_b]);
            for k in 0..3 {
                out.translation[k] += pose.rotation[(k, 2)] * motion[0];
            }
            out
        }
    }
}
