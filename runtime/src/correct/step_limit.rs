//! The step that corrects a command, limited so that it is a continuous function of the command with a bounded slope.
//!
//! Near a singularity the exact step d, with J d = e, grows without bound and reverses within a small part of the path.
//! Let d = Jᵀ x. Where the arm moves in a direction by σ per radian, x = e/σ², and d changes by about |x| radians per radian
//! of the commanded path. So a bound on |x| is a bound on the slope, and the solution of
//!
//! ```text
//! minimise  ½ |d|² + s_p |e_p − J_p d| + s_r |e_r − J_r d|           which implies |x_p| ≤ s_p and |x_r| ≤ s_r
//! ```
//!
//! is the exact step wherever that changes slowly enough. J_p changes by about the length of the arm per radian, so s_p is
//! relative to that length. Elsewhere the solution gives up part of e, no more than it must, in exactly the directions in
//! which the arm can hardly move, and keeps the others. It needs no singular values, and works for any number of such
//! directions. The problem is convex, so its solution does not jump. Its dual is (J Jᵀ + Λ) x = e with one λ for
//! displacements and one for rotations; both follow from Newton's method on 1/|x|, which is nearly linear in λ. A least λ
//! bounds the slope where e changes its sign along such a direction.
//!
//! Displacement and rotation are two demands on the same equations, x = shift + turn. Each is within the limits and has a
//! share of its own, so that neither is met at the expense of the other:
//!
//! - the **turn**, for e = (0, e_r), may push the position by no more than the shift has gained;
//! - the **shift**, for e = (e_p, 0), may leave a rotation up to the larger of the uncorrected one and the arm's usual one.
//!
//! What one of them may take from the other can be very little: 50 µm of position, or a tenth of a milliradian. A large step
//! would then have to end within a few milliradians of the path, as soon as the arm can hardly meet the other demand. So the
//! **size** |d| of each step is limited there, too: to what it takes up to a singularity of the other demand (σ for the
//! turn, σ² for the shift), and beyond it to √(s b), where b is what it may take. The slope that b causes is then of the
//! order of s, however small b is.
//!
//! With A, B, C the blocks of J Jᵀ, position first, all computations are on 3×3 matrices: S = C − Bᵀ A⁻¹ B for λ_r, then
//! T = A − B (C + λ_r)⁻¹ Bᵀ for λ_p. docs/evidence/singularities.md records how the limits were chosen.

use crate::correct::blocks::{
    Factors, Matrix, Vector, difference, larger, product, scaled, schur, squared,
    transposed_product,
};
use crate::kinematics::newton::{Damping, Gram, PoseError6};
use crate::math::scalar::Scalar;

/// Limit s_r on |x_r|: radians of joint motion per radian of path, per radian of rotation error.
pub const TURN_LIMIT: f64 = 0.11;
/// Usual rotation in radians above which s_r falls in inverse proportion to it, because the error changes that much faster.
const MUCH_ROTATION: f64 = 4e-3;
/// Limit s_p on |x_p|, times [`Scale::lever`]: radians of joint motion per radian of path, per metre of position error, of
/// an arm whose joints move its target by a metre per radian.
pub const SHIFT_LIMIT: f64 = 0.2;
/// Least λ of displacements and of rotations. Two steps leave (λ/σ²)² of an error: 5e-5 where σ is 0.15.
pub const FLOOR: Damping<f64> = Damping {
    position: 1.6e-4,
    rotation: 2e-5,
};
/// Least λ_r of an arm that cannot turn its target every way: a shift need not hold the rotations that the arm cannot hold.
/// About a tenth of a rotation that its joints can make is left, too.
const FREE: f64 = 0.1;
/// λ of A in S, in units of lever²: a position that the arm can hardly move need not be held.
const HOLD: f64 = 1e-4;
/// Least λ, in units of lever², of the shift that the turn has to follow while λ_r is computed: a shift that the arm can
/// hardly make need not be followed.
pub const FOLLOW: f64 = 1e-3;
/// Least λ_r of [`StepLimit::damped`], whose least λ_p is [`FOLLOW`].
pub const DAMPED: f64 = 1e-3;
/// Number of Newton steps on 1/|x| for λ_p; λ_r takes two. More steps have no visible effect.
const SHIFT_ROUNDS: usize = 3;
/// Factors of s_p σ and √(s_p b) in the largest size of the turn: σ of T, b the displacement that the shift may bring, s_p
/// in 1/m.
const TURN_SIZE: (f64, f64) = (0.5, 0.7);
/// Factors of s_r σ² and √(s_r b) in the largest size of the shift: σ of S, b the rotation that may be left.
const SHIFT_SIZE: (f64, f64) = (2.0, 0.7);
/// Share of what the shift brings that the turn may take; the rest is left for the second derivative.
const TAKEN: f64 = 0.9;
/// Rotation in radians that the shift may leave in any case.
const LEAST_ROOM: f64 = 1e-4;
/// Distance in metres by which the turn may push the target in any case.
const LEAST_PUSH: f64 = 0.5e-6;

/// Limited step, and what later steps need of it.
#[derive(Clone, Copy, Debug)]
pub struct LimitedStep<T> {
    /// Solution x; the joint changes are Jᵀ x.
    pub x: PoseError6<T>,
    /// Part of the error that the step leaves on purpose: all that it leaves except what [`FLOOR`] leaves.
    pub given_up: PoseError6<T>,
    /// Damped equations for later steps, so that these do not bring back what was given up.
    pub damped: DampedGram<T>,
}

/// Factored J Jᵀ + Λ, with the λ of a limited step.
#[derive(Clone, Copy, Debug)]
pub struct DampedGram<T> {
    /// Damping Λ.
    pub damping: Damping<T>,
    /// Factors of C + λ_r.
    turning: Factors<T>,
    /// (C + λ_r)⁻¹ Bᵀ.
    along: Matrix<T>,
    /// Factors of T + λ_p.
    shifting: Factors<T>,
}

impl<T: Scalar> DampedGram<T> {
    /// Returns (J Jᵀ + Λ)⁻¹ e.
    #[inline(always)]
    pub fn solve(&self, error: &PoseError6<T>) -> PoseError6<T> {
        let (p, r) = halves(error);
        let rest = difference(&p, &transposed_product(&self.along, &r));
        let shift = self.shifting.solve(&rest);
        let turned = product(&self.along, &shift);
        joined(&shift, &difference(&self.turning.solve(&r), &turned))
    }

    /// Returns Λ x, which a step with solution x leaves of the error.
    #[inline(always)]
    pub fn left(&self, x: &PoseError6<T>) -> PoseError6<T> {
        left_by(&self.damping, x)
    }
}

/// Sizes of an arm to which its limits are relative.
#[derive(Clone, Copy, Debug)]
pub struct Scale<T> {
    /// Usual √(tr J_p J_pᵀ) in m: by how much the joints together displace the target per radian.
    pub lever: T,
    /// Usual rotation error (rad) without correction; `None` for an arm that cannot turn its target every way, whose shift
    /// may leave any rotation.
    pub usual_rotation: Option<T>,
}

/// J Jᵀ at the command, with the parts that every step there needs.
#[derive(Clone, Debug)]
pub struct StepLimit<'a, T> {
    gram: &'a Gram<T>,
    scale: Scale<T>,
    /// Least λ of the shift that the turn has to follow, and the factors of A with it.
    follow: T,
    following: Factors<T>,
    /// Schur complement S.
    turning: Matrix<T>,
    /// Factors of S plus the least λ_r.
    turning_factors: Factors<T>,
}

impl<'a, T: Scalar> StepLimit<'a, T> {
    /// Prepares the limits from J Jᵀ at the command.
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

    /// Returns the rotation that the shift within its limit causes, which the turn has to compensate.
    fn follows(&self, p: &Vector<T>, unit: T) -> Vector<T> {
        let position = self.follow + self.following.missing(p, unit, None);
        let shift = Factors::of(&block(self.gram, 0, 0), position).solve(p);
        transposed_product(&block(self.gram, 0, 3), &shift)
    }

    /// Returns x of a damped step, an estimate of where a command will be: nearly exact away from singularities, and beside
    /// them of the order of the limits.
    ///
    /// With K = J Jᵀ + Λ it solves K x = e + Λ K⁻¹ e, which asks once more for what the damping has left of the error. Each
    /// λ is one Newton step away from its least value, towards half of the limit for K⁻¹ e, because x is up to twice as
    /// long.
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

    /// Computes the limited step against `error`.
    pub fn step(&self, error: &PoseError6<T>) -> LimitedStep<T> {
        let Scale {
            lever,
            usual_rotation,
        } = self.scale;
        let floor = floor(&self.scale);
        let (p, r) = halves(error);
        // 1/s_p in m, and 1/s_r.
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
            rotation: rotation - T::from_f64(FLOOR.rotation),
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

/// Returns the factors of A + λ, (A + λ)⁻¹ B, and S with this λ.
fn held<T: Scalar>(gram: &Gram<T>, position: T) -> (Factors<T>, Matrix<T>, Matrix<T>) {
    let factors = Factors::of(&block(gram, 0, 0), position);
    let follow = factors.solve_columns(&block(gram, 0, 3));
    let turning = schur(&block(gram, 3, 3), &block(gram, 3, 0), &follow);
    (factors, follow, turning)
}

/// Returns Λ x.
#[inline(always)]
fn left_by<T: Scalar>(damping: &Damping<T>, x: &PoseError6<T>) -> PoseError6<T> {
    let (p, r) = halves(x);
    joined(&scaled(damping.position, &p), &scaled(damping.rotation, &r))
}

#[inline(always)]
fn floor<T: Scalar>(scale: &Scale<T>) -> Damping<T> {
    let rotation = match scale.usual_rotation {
        Some(_) => FLOOR.rotation,
        None => FREE,
    };
    Damping {
        position: T::from_f64(FLOOR.position),
        rotation: T::from_f64(rotation),
    }
}

/// Effects of shift and turn on each other, from which their shares follow.
struct Shares<T> {
    /// Position error e_p.
    position: Vector<T>,
    rotation: Vector<T>,
    /// Largest rotation that may be left, rad; `None` if it is not limited.
    largest: Option<T>,
    /// Position error that the whole shift leaves.
    shift_leaves: Vector<T>,
    /// Angle by which the whole shift turns the target, rad.
    shift_turns: T,
    /// Rotation error that the whole turn leaves.
    turn_leaves: Vector<T>,
    /// Distance by which the whole turn pushes the target, m.
    turn_pushes: T,
}

impl<T: Scalar> Shares<T> {
    /// Returns the shares of the shift and of the turn that are taken, each from 0 to 1.
    fn fair(&self) -> (T, T) {
        // The shift may turn the target as far as a turn beside the whole shift would allow.
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

    /// Returns the turn's share beside this share of the shift.
    fn turn_beside(&self, shift: T) -> T {
        let left = left_after(shift, &self.position, &self.shift_leaves);
        let brought = squared(&self.position).sqrt() - squared(&left).sqrt();
        let brought = T::from_f64(TAKEN) * larger(brought, T::ZERO) + T::from_f64(LEAST_PUSH);
        // A share of min(brought/pushed, 1) would change abruptly where the two are equal.
        brought / (brought + self.turn_pushes)
    }
}

/// Returns what is left of an error after this share of a step that, taken whole, leaves `leaves`.
fn left_after<T: Scalar>(share: T, error: &Vector<T>, leaves: &Vector<T>) -> Vector<T> {
    let mut left = *error;
    for (value, leaves) in left.iter_mut().zip(leaves) {
        *value -= share * (*value - *leaves);
    }
    left
}

/// Returns the angle by which a shift may turn the target while `left` of the rotation remains.
#[inline(always)]
fn room<T: Scalar>(largest: T, left: &Vector<T>) -> T {
    larger(largest - squared(left).sqrt(), T::from_f64(LEAST_ROOM))
}

/// Returns |d| of the step d = Jᵀ x that removes this error; for a step that leaves something, a little more than |d|.
#[inline(always)]
fn size<T: Scalar>(error: &Vector<T>, x: &Vector<T>) -> T {
    larger(error[0] * x[0] + error[1] * x[1] + error[2] * x[2], T::ZERO).sqrt()
}

/// Returns the 3×3 block of J Jᵀ that begins at this row and column: 0 for displacements, 3 for rotations.
#[inline(always)]
fn block<T: Scalar>(gram: &Gram<T>, row: usize, column: usize) -> Matrix<T> {
    // Copied one by one: loops over slices take longer than the copies, and compilers may keep a panic of a `map`.
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

/// Returns the share of `all` that does not exceed `limit`: limit/all, at most 1.
#[inline(always)]
fn share<T: Scalar>(limit: T, all: T) -> T {
    let share = limit / all;
    // The comparison also turns NaN (0/0) into 1.
    if share < T::ONE { share } else { T::ONE }
}
