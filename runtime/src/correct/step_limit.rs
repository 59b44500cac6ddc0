//! The step that corrects a command, limited so that it is a continuous function of the command with a bounded slope.
//!
//! Beside a singularity the exact step d, with J d = e, grows without bound and turns over within a small part of the path.
//! Let d = Jᵀ x. Where the arm moves in a direction by σ per radian, x = e/σ², and d changes by about |x| radians for each
//! radian of the commanded path. So a bound on |x| is a bound on the slope, and
//!
//! ```text
//! minimise  ½ |d|² + s_p |e_p − J_p d| + s_r |e_r − J_r d|           |x_p| ≤ s_p and |x_r| ≤ s_r follow
//! ```
//!
//! is the exact step wherever that is slow enough. J_p changes by about the length of the arm for each radian, so s_p is
//! relative to that. Elsewhere it gives up part of e in the very direction that the arm can
//! hardly move, as much as it must, and keeps the others; no singular values are needed, and it does not matter how many
//! such directions there are. It is a convex problem, so its solution does not jump. Its dual is (J Jᵀ + Λ) x = e with one λ
//! for displacements and one for rotations; both follow from Newton's method on 1/|x|, which is nearly linear in λ. A least
//! λ bounds the slope where e changes its sign along such a direction.
//!
//! Displacement and rotation are two demands on the same equations, x = shift + turn, each within the limits and each with a
//! share of its own, so that neither pays for the other:
//!
//! - the **turn**, for e = (0, e_r), may push the position by no more than the shift has brought;
//! - the **shift**, for e = (e_p, 0), may leave a rotation up to the larger of what is there without correction and what is
//!   usual for the arm.
//!
//! What one of them may take from the other can be very little: 50 µm of position, or a tenth of a milliradian. A large step
//! would then have to end as soon as the arm can hardly hold the other demand, within a few milliradians of the path. So
//! the **size** |d| of each step is limited there, too: to what it takes up to a singularity of the other demand (σ for the
//! turn, σ² for the shift), and beyond it to √(s b), with b for what it may take. The slope that b brings is then of the
//! order of s, however small b is.
//!
//! With A, B, C the blocks of J Jᵀ, position first, all of it is in 3×3 matrices: S = C − Bᵀ A⁻¹ B for λ_r, then
//! T = A − B (C + λ_r)⁻¹ Bᵀ for λ_p. How the limits were chosen: docs/evidence/singularities.md.

use crate::correct::blocks::{
    Factors, Matrix, Vector, difference, larger, product, scaled, schur, squared,
    transposed_product,
};
use crate::kinematics::newton::{Damping, Gram, PoseError6};
use crate::math::scalar::Scalar;

/// s_r: radians of joint motion for each radian of the path, for each radian that is to be corrected.
pub const TURN_LIMIT: f64 = 0.11;
/// Usual rotation in radians from which on s_r is smaller as much as it is larger: the error changes as much faster, too.
const MUCH_ROTATION: f64 = 4e-3;
/// s_p times the [`Scale::lever`]: the same for each metre, of an arm whose joints move its target by a metre per radian.
pub const SHIFT_LIMIT: f64 = 0.2;
/// The least λ. Two steps leave (λ/σ²)² of an error: 5e-5 where σ is 0.15.
pub const FLOOR: Damping<f64> = Damping {
    position: 1.6e-4,
    rotation: 2e-5,
};
/// λ of A in S, in lever²: a position that the arm can hardly move need not be held.
const HOLD: f64 = 1e-4;
/// The least λ of the shift that the turn has to follow while λ_r is sought, in lever²: a shift that the arm can hardly make
/// need not be followed.
pub const FOLLOW: f64 = 1e-3;
/// The least λ_r of [`StepLimit::damped`]; its least λ_p is [`FOLLOW`].
pub const DAMPED: f64 = 1e-3;
/// Newton steps on 1/|x| for λ_p; for λ_r there are two. More change nothing that could be seen.
const SHIFT_ROUNDS: usize = 3;
/// The size of the turn: of s_p σ, and of √(s_p b), with σ of T, b for the position that the shift may bring and s_p in 1/m.
const TURN_SIZE: (f64, f64) = (0.5, 0.7);
/// The size of the shift: of s_r σ², and of √(s_r b), with σ of S and b for the rotation that may be left.
const SHIFT_SIZE: (f64, f64) = (2.0, 0.7);
/// How much of what the shift brings the turn may take: the rest is the second derivative's.
const TAKEN: f64 = 0.9;
/// The rotation in radians that the shift may leave in any case.
const LEAST_ROOM: f64 = 1e-4;
/// The position in metres by which the turn may push the target in any case.
const LEAST_PUSH: f64 = 0.5e-6;

/// A limited step.
#[derive(Clone, Copy, Debug)]
pub struct LimitedStep<T> {
    /// x; the joint changes are Jᵀ x.
    pub x: PoseError6<T>,
    /// What it leaves of the error on purpose: everything but what the least λ leaves.
    pub given_up: PoseError6<T>,
    /// What later steps must be solved with, so that they do not bring back what was given up.
    pub damped: DampedGram<T>,
}

/// J Jᵀ + Λ with the λ of a limited step, factored.
#[derive(Clone, Copy, Debug)]
pub struct DampedGram<T> {
    /// Λ.
    pub damping: Damping<T>,
    /// Factors of C + λ_r.
    turning: Factors<T>,
    /// (C + λ_r)⁻¹ Bᵀ.
    along: Matrix<T>,
    /// Factors of T + λ_p.
    shifting: Factors<T>,
}

impl<T: Scalar> DampedGram<T> {
    /// (J Jᵀ + Λ)⁻¹ e.
    #[inline(always)]
    pub fn solve(&self, error: &PoseError6<T>) -> PoseError6<T> {
        let (p, r) = halves(error);
        let rest = difference(&p, &transposed_product(&self.along, &r));
        let shift = self.shifting.solve(&rest);
        let turned = product(&self.along, &shift);
        joined(&shift, &difference(&self.turning.solve(&r), &turned))
    }

    /// Λ x.
    #[inline(always)]
    pub fn left(&self, x: &PoseError6<T>) -> PoseError6<T> {
        left_by(&self.damping, x)
    }
}

/// What the limits of an arm are relative to.
#[derive(Clone, Copy, Debug)]
pub struct Scale<T> {
    /// √(tr J_p J_pᵀ) in m, as it usually is: by how much the joints together displace the target.
    pub lever: T,
    /// The angle (rad) that the arm is usually off by without correction; `None` for an arm that cannot turn its target every
    /// way, which leaves what it must.
    pub usual_rotation: Option<T>,
}

/// J Jᵀ at the command, in the parts that every step there needs.
#[derive(Clone, Debug)]
pub struct StepLimit<'a, T> {
    gram: &'a Gram<T>,
    scale: Scale<T>,
    /// λ of the shift that the turn has to follow, at least, and factors of A with it.
    follow: T,
    following: Factors<T>,
    /// S.
    turning: Matrix<T>,
    /// Factors of S plus the least λ_r.
    turning_factors: Factors<T>,
}

impl<'a, T: Scalar> StepLimit<'a, T> {
    /// From J Jᵀ.
    pub fn new(gram: &'a Gram<T>, scale: Scale<T>) -> Self {
        let relative = scale.lever * scale.lever;
        let (_, _, turning) = held(gram, T::from_f64(HOLD) * relative);
        let follow = T::from_f64(FOLLOW) * relative;
        Self {
            gram,
            scale,
            follow,
            following: Factors::of(&block(gram, 0, 0), follow),
            turning,
            turning_factors: Factors::of(&turning, T::from_f64(FLOOR.rotation)),
        }
    }

    /// The rotation that the turn has to follow when the shift, within its limit, is held against.
    fn follows(&self, p: &Vector<T>, unit: T) -> Vector<T> {
        let position = self.follow + self.following.missing(p, unit, None);
        let shift = Factors::of(&block(self.gram, 0, 0), position).solve(p);
        transposed_product(&block(self.gram, 0, 3), &shift)
    }

    /// x of a damped step, which tells where a command will be: nearly exact away from singularities, and beside them of the
    /// order of the limits.
    ///
    /// With K = J Jᵀ + Λ it solves K x = e + Λ K⁻¹ e: what the damping has left of the error is asked for once more. Each λ is
    /// one Newton step from its least, towards half of the limit for K⁻¹ e, because x is up to twice as long.
    pub fn damped(&self, error: &PoseError6<T>) -> PoseError6<T> {
        let (p, r) = halves(error);
        let shift_unit = T::from_f64(2.0 / SHIFT_LIMIT) * self.scale.lever;
        let turn_unit = T::from_f64(2.0 / TURN_LIMIT);
        let position = self.follow + self.following.missing(&p, shift_unit, None);
        let (holding, follow, turning) = held(self.gram, position);
        let rest = difference(&r, &transposed_product(&follow, &p));
        let rotation = T::from_f64(DAMPED);
        let lacks = Factors::of(&turning, rotation).missing(&rest, turn_unit, None);
        let rotation = rotation + lacks;
        let turning = Factors::of(&turning, rotation);
        let (mut shift, mut turn) = ([T::ZERO; 3], [T::ZERO; 3]);
        for _ in 0..2 {
            let (mut shifts, mut turns) = (p, r);
            for i in 0..3 {
                shifts[i] += position * shift[i];
                turns[i] += rotation * turn[i];
            }
            let against = transposed_product(&follow, &shifts);
            turn = turning.solve(&difference(&turns, &against));
            let back = product(&follow, &turn);
            shift = difference(&holding.solve(&shifts), &back);
        }
        joined(&shift, &turn)
    }

    /// The limited step.
    pub fn step(&self, error: &PoseError6<T>) -> LimitedStep<T> {
        let Scale {
            lever,
            usual_rotation,
        } = self.scale;
        let floor = floor();
        let (p, r) = halves(error);
        // 1/s_p in m and 1/s_r.
        let shift_unit = T::from_f64(1.0 / SHIFT_LIMIT) * lever;
        let much = usual_rotation.unwrap_or(T::ZERO) * T::from_f64(1.0 / MUCH_ROTATION);
        let turn_unit = T::from_f64(1.0 / TURN_LIMIT) * larger(much, T::ONE);
        let against = self.follows(&p, shift_unit);
        let lacks = |factors: &Factors<T>| {
            let a = factors.missing(&against, turn_unit, None);
            larger(a, factors.missing(&r, turn_unit, None))
        };
        let rotation = floor.rotation + lacks(&self.turning_factors);
        let rotation = rotation + lacks(&Factors::of(&self.turning, rotation));
        let turning = Factors::of(&block(self.gram, 3, 3), rotation);
        let along = turning.solve_columns(&block(self.gram, 3, 0));
        let shifting = schur(&block(self.gram, 0, 0), &block(self.gram, 0, 3), &along);
        let back = transposed_product(&along, &r);
        let largest = larger(usual_rotation.unwrap_or(T::ZERO), squared(&r).sqrt());
        let side_unit = match usual_rotation {
            Some(_) => rotation / larger(largest, T::from_f64(LEAST_ROOM)),
            None => T::ZERO,
        };
        let mut position = floor.position;
        for _ in 0..SHIFT_ROUNDS {
            let factors = Factors::of(&shifting, position);
            let a = factors.missing(&p, shift_unit, Some((&along, side_unit)));
            let b = factors.missing(&back, shift_unit, None);
            position += larger(a, b);
        }
        let shifting = Factors::of(&shifting, position);
        let (shift, held) = (shifting.solve(&p), shifting.solve(&back));
        let turned = product(&along, &shift);
        let mut turn = turning.solve(&r);
        for (value, part) in turn.iter_mut().zip(&product(&along, &held)) {
            *value += *part;
        }
        let brought = squared(&p).sqrt() + T::from_f64(LEAST_PUSH);
        let (near, far) = TURN_SIZE;
        let most = T::from_f64(near) * shifting.least().sqrt() / shift_unit
            + T::from_f64(far) * (brought / shift_unit).sqrt();
        let turn_size = share(most, size(&r, &turn));
        let turn_leaves = left_after(turn_size, &r, &scaled(rotation, &turn));
        let shift_size = if usual_rotation.is_some() {
            let room = room(largest, &turn_leaves);
            let (near, far) = SHIFT_SIZE;
            let most = T::from_f64(near) * self.turning_factors.least() / turn_unit
                + T::from_f64(far) * (room / turn_unit).sqrt();
            share(most, size(&p, &shift))
        } else {
            T::ONE
        };
        let (shift_share, turn_share) = Shares {
            position: p,
            rotation: r,
            largest: usual_rotation.map(|_| largest),
            shift_leaves: left_after(shift_size, &p, &scaled(position, &shift)),
            shift_turns: shift_size * rotation * squared(&turned).sqrt(),
            turn_leaves,
            turn_pushes: turn_size * (position - floor.position) * squared(&held).sqrt(),
        }
        .fair();
        let (shift_share, turn_share) = (shift_share * shift_size, turn_share * turn_size);
        let mut x = joined(&scaled(-turn_share, &held), &scaled(turn_share, &turn));
        let shift = joined(&shift, &scaled(-T::ONE, &turned));
        for (value, part) in x.iter_mut().zip(&shift) {
            *value += shift_share * *part;
        }
        // (J Jᵀ + Λ) x is the error times the shares.
        let mut given_up = joined(
            &scaled(T::ONE - shift_share, &p),
            &scaled(T::ONE - turn_share, &r),
        );
        let beyond_floor = Damping {
            position: position - floor.position,
            rotation: rotation - floor.rotation,
        };
        for (value, left) in given_up.iter_mut().zip(&left_by(&beyond_floor, &x)) {
            *value += *left;
        }
        LimitedStep {
            x,
            given_up,
            damped: DampedGram {
                damping: Damping { position, rotation },
                turning,
                along,
                shifting,
            },
        }
    }
}

/// Factors of A with this λ, (A + λ)⁻¹ B, and S with it.
fn held<T: Scalar>(gram: &Gram<T>, position: T) -> (Factors<T>, Matrix<T>, Matrix<T>) {
    let factors = Factors::of(&block(gram, 0, 0), position);
    let follow = factors.solve_columns(&block(gram, 0, 3));
    let turning = schur(&block(gram, 3, 3), &block(gram, 3, 0), &follow);
    (factors, follow, turning)
}

/// Λ x.
#[inline(always)]
fn left_by<T: Scalar>(damping: &Damping<T>, x: &PoseError6<T>) -> PoseError6<T> {
    let (p, r) = halves(x);
    joined(&scaled(damping.position, &p), &scaled(damping.rotation, &r))
}

#[inline(always)]
fn floor<T: Scalar>() -> Damping<T> {
    Damping {
        position: T::from_f64(FLOOR.position),
        rotation: T::from_f64(FLOOR.rotation),
    }
}

/// What shift and turn do to each other.
struct Shares<T> {
    /// e.
    position: Vector<T>,
    rotation: Vector<T>,
    /// The largest rotation that may be left, rad.
    largest: Option<T>,
    /// What the whole shift leaves of the position.
    shift_leaves: Vector<T>,
    /// By how much it turns the target, rad.
    shift_turns: T,
    /// What the whole turn leaves of the rotation.
    turn_leaves: Vector<T>,
    /// By how much it pushes the target, m.
    turn_pushes: T,
}

impl<T: Scalar> Shares<T> {
    /// How much of the shift and of the turn is taken, each from 0 to 1.
    fn fair(&self) -> (T, T) {
        // The shift has the room that a turn beside the whole shift would leave it.
        let shift = match self.largest {
            Some(largest) => {
                let turn = self.turn_beside(T::ONE);
                let left = left_after(turn, &self.rotation, &self.turn_leaves);
                share(room(largest, &left), self.shift_turns)
            }
            None => T::ONE,
        };
        (shift, self.turn_beside(shift))
    }

    /// The turn's share beside this share of the shift.
    fn turn_beside(&self, shift: T) -> T {
        let left = left_after(shift, &self.position, &self.shift_leaves);
        let brought = squared(&self.position).sqrt() - squared(&left).sqrt();
        let brought = T::from_f64(TAKEN) * larger(brought, T::ZERO) + T::from_f64(LEAST_PUSH);
        // A share of brought/pushed, at most 1, would change suddenly where the two are equal.
        brought / (brought + self.turn_pushes)
    }
}

/// What is left of an error when this share of a step is taken of which the whole leaves `leaves`.
fn left_after<T: Scalar>(share: T, error: &Vector<T>, leaves: &Vector<T>) -> Vector<T> {
    let mut left = *error;
    for (value, leaves) in left.iter_mut().zip(leaves) {
        *value -= share * (*value - *leaves);
    }
    left
}

/// By how much a shift may turn the target where so much of the rotation is left.
#[inline(always)]
fn room<T: Scalar>(largest: T, left: &Vector<T>) -> T {
    larger(largest - squared(left).sqrt(), T::from_f64(LEAST_ROOM))
}

/// |d| of the step d = Jᵀ x that takes this error away, and a little more of one that leaves something.
#[inline(always)]
fn size<T: Scalar>(error: &Vector<T>, x: &Vector<T>) -> T {
    larger(error[0] * x[0] + error[1] * x[1] + error[2] * x[2], T::ZERO).sqrt()
}

/// Rows and columns of J Jᵀ from these on: 0 for displacements, 3 for rotations.
#[inline(always)]
fn block<T: Scalar>(gram: &Gram<T>, row: usize, column: usize) -> Matrix<T> {
    // One by one: loops over slices take longer than what they copy, and of a `map` compilers may keep a panic.
    let [r0, r1, r2, r3, r4, r5] = gram;
    let part = |[a, b, c, d, e, f]: &PoseError6<T>| {
        if column == 0 {
            [*a, *b, *c]
        } else {
            [*d, *e, *f]
        }
    };
    if row == 0 {
        [part(r0), part(r1), part(r2)]
    } else {
        [part(r3), part(r4), part(r5)]
    }
}

#[inline(always)]
fn halves<T: Scalar>(e: &PoseError6<T>) -> (Vector<T>, Vector<T>) {
    ([e[0], e[1], e[2]], [e[3], e[4], e[5]])
}

#[inline(always)]
fn joined<T: Scalar>(p: &Vector<T>, r: &Vector<T>) -> PoseError6<T> {
    [p[0], p[1], p[2], r[0], r[1], r[2]]
}

/// How much of `all` there may be when it must not exceed `limit`: limit/all, at most 1.
#[inline(always)]
fn share<T: Scalar>(limit: T, all: T) -> T {
    let share = limit / all;
    // Also of 0/0.
    if share < T::ONE { share } else { T::ONE }
}
