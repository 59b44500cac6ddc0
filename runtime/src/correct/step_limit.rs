//! The step that corrects a command, limited so that it is a continuous function of the command with a bounded slope.
//!
//! Near a singularity the exact step d, with J d = e, grows without bound and reverses within a small part of the path.
//! Let d = Jᵀ x. Where the arm moves in a direction by σ per radian, x = e/σ², and d changes by about |x| radians per radian
//! of the commanded path. So a bound on |x| is a bound on the slope. The step solves (J Jᵀ + Λ) x = e, with one damping λ_p
//! for displacements and one λ_r for rotations. Position comes first:
//!
//! - **λ_r** depends on the pose alone. With A, B, C the blocks of J Jᵀ, position first, S = C − Bᵀ A⁻¹ B says how well the
//!   arm turns its target while it holds the position. Where S is small, λ_r grows to a size in proportion to the arm's
//!   usual error. Elsewhere it is zero, nearly.
//! - **λ_p** is the least with which |x_p| is within its limit, and the rotation that x_p costs within what may be left. It
//!   follows from Newton's method on 1/|x_p|, which is nearly linear in λ, with T = A − B (C + λ_r)⁻¹ Bᵀ: a position that the
//!   arm reaches by turning its target a little costs little. Where T is small, λ_p has a least value as well, in proportion
//!   to the arm's usual error: the error of one pose may be small only because it changes its sign there.
//!
//! A larger λ gives up part of e, no more than it must, in exactly the directions in which the arm can hardly move, and
//! keeps the others. It needs no singular values, and works for any number of such directions.
//!
//! The step is the sum of a **shift** against (e_p, 0) and a **turn** against (0, e_r). What λ_r leaves of the rotation is asked
//! for once more. Nothing becomes worse, because both are scaled: the shift so that it leaves no more rotation than allowed (the
//! larger of the uncorrected one and the arm's usual one), then the turn so that it takes no more of the position than the shift
//! has gained, and in the end both, should the scaled turn leave too much rotation.
//!
//! docs/evidence/singularities.md records how the limits were chosen.

use crate::correct::blocks::{
    Factors, Matrix, Vector, difference, dot, larger, product, scaled, schur, squared, sum,
    transposed_product,
};
use crate::kinematics::newton::{Damping, Gram, PoseError6};
use crate::math::scalar::Scalar;

/// Limit on |x_p|, times √(tr J_p J_pᵀ): radians of joint motion per radian of path, per metre of position error, of an arm
/// whose joints move its target by a metre per radian.
pub const SHIFT_LIMIT: f64 = 0.3;
/// Largest λ_r, per radian of usual rotation error.
const TURN_DAMPING: f64 = 20.0;
/// Largest λ_p that depends on the pose alone, in units of tr A, per radian of usual rotation error.
pub const SHIFT_DAMPING: f64 = 0.8;
/// Least eigenvalue of S or T above which the damping that depends on the pose vanishes, in units of its largest value.
const HELD: f64 = 2.0;
/// Usual rotation error in radians below which the damping falls no further.
const LEAST_USUAL: f64 = 5e-4;
/// Least λ of displacements and of rotations. Two steps leave (λ/σ²)² of an error: 5e-5 where σ is 0.15.
pub const FLOOR: Damping<f64> = Damping {
    position: 5e-5,
    rotation: 2e-5,
};
/// λ_r of an arm that cannot turn its target every way: a shift need not hold the rotations that the arm cannot hold.
const FREE: f64 = 0.1;
/// λ of A in S, in units of tr A: a position that the arm can hardly move need not be held.
const HOLD: f64 = 1e-4;
/// Number of Newton steps on 1/|x_p| for λ_p. More steps have no visible effect.
const SHIFT_ROUNDS: usize = 3;
/// Share of what the shift brings that the turn may take; the rest is left for the second derivative.
const TAKEN: f64 = 0.9;
/// Distance in metres by which the turn may push the target in any case.
const LEAST_PUSH: f64 = 0.5e-6;
/// Rotation in units of the usual one up to which the shift may turn the target.
const ROOM: f64 = 1.15;
/// Rotation in radians that the step may add in any case.
const LEAST_ROOM: f64 = 8e-5;
/// Least tr A, in m².
const LEAST_LEVER: f64 = 1e-4;

/// Limited step, and what later steps need of it.
#[derive(Clone, Copy, Debug)]
pub struct LimitedStep<T> {
    /// Solution x; the joint changes are Jᵀ x.
    pub x: PoseError6<T>,
    /// Part of the error that the step leaves on purpose: all that it leaves of the rotation, and of the position all except
    /// what [`FLOOR`] leaves.
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

/// Displacement and rotation.
type Halves<T> = (Vector<T>, Vector<T>);

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
        let (p, r) = halves(x);
        joined(
            &scaled(self.damping.position, &p),
            &scaled(self.damping.rotation, &r),
        )
    }

    /// Returns x of the turn (J Jᵀ + Λ)⁻¹ (0, r). It pushes the position by −λ_p x_p.
    fn turn(&self, r: &Vector<T>) -> Halves<T> {
        let held = self.shifting.solve(&transposed_product(&self.along, r));
        let mut turn = self.turning.solve(r);
        for (value, part) in turn.iter_mut().zip(&product(&self.along, &held)) {
            *value += *part;
        }
        (scaled(-T::ONE, &held), turn)
    }
}

/// Equations of one command, from which its steps are computed.
pub struct StepLimit<T> {
    /// Largest rotation error that a shift may cause, rad; `None` for an arm that cannot turn its target every way.
    room: Option<T>,
    /// √(tr A)/[`SHIFT_LIMIT`], in m: the unit of |x_p|.
    shift_unit: T,
    /// λ_r.
    rotation: T,
    /// Least λ_p at this pose.
    position: T,
    turning: Factors<T>,
    along: Matrix<T>,
    /// T.
    shifting: Matrix<T>,
}

impl<T: Scalar> StepLimit<T> {
    /// Prepares the limits from J Jᵀ at the command, for an arm whose rotation error without correction is usually
    /// `usual_rotation` (rad); `None` for an arm that cannot turn its target every way, whose shift may leave any rotation.
    pub fn new(gram: &Gram<T>, usual_rotation: Option<T>) -> Self {
        let (a, b) = (block(gram, 0, 0), block(gram, 0, 3));
        let lever = larger(a[0][0] + a[1][1] + a[2][2], T::from_f64(LEAST_LEVER));
        let usual = usual_rotation.map(|usual| larger(usual, T::from_f64(LEAST_USUAL)));
        let rotation = match usual {
            Some(usual) => {
                let holding = Factors::of(&a, T::from_f64(HOLD) * lever);
                let turning = schur(
                    &block(gram, 3, 3),
                    &block(gram, 3, 0),
                    &holding.solve_columns(&b),
                );
                let floor = T::from_f64(FLOOR.rotation);
                damping_at(&turning, floor, T::from_f64(TURN_DAMPING) * usual)
            }
            None => T::from_f64(FREE),
        };
        let turning = Factors::of(&block(gram, 3, 3), rotation);
        let along = turning.solve_columns(&block(gram, 3, 0));
        let shifting = schur(&a, &b, &along);
        let position = match usual {
            Some(usual) => {
                let largest = T::from_f64(SHIFT_DAMPING) * usual * lever;
                damping_at(&shifting, T::from_f64(FLOOR.position), largest)
            }
            None => T::from_f64(FLOOR.position),
        };
        Self {
            room: usual_rotation.map(|usual| T::from_f64(ROOM) * usual),
            shift_unit: T::from_f64(1.0 / SHIFT_LIMIT) * lever.sqrt(),
            rotation,
            position,
            turning,
            along,
            shifting,
        }
    }

    /// Returns the largest rotation error that may be left, if that is limited.
    fn allowed_rotation(&self, r: &Vector<T>) -> Option<T> {
        self.room
            .map(|room| larger(room, squared(r).sqrt()) + T::from_f64(LEAST_ROOM))
    }

    /// Returns the equations with the λ_p that limits |x_p| of the step against `error`.
    #[inline(always)]
    fn damped_for(&self, error: &PoseError6<T>) -> DampedGram<T> {
        let (p, r) = halves(error);
        let rest = difference(&p, &transposed_product(&self.along, &r));
        let side_unit = match self.allowed_rotation(&r) {
            Some(allowed) => self.rotation / allowed,
            None => T::ZERO,
        };
        let mut position = self.position;
        let mut shifting = Factors::of(&self.shifting, position);
        for _ in 0..SHIFT_ROUNDS {
            position += shifting.missing(&rest, self.shift_unit, &self.along, side_unit);
            shifting = Factors::of(&self.shifting, position);
        }
        DampedGram {
            damping: Damping {
                position,
                rotation: self.rotation,
            },
            turning: self.turning,
            along: self.along,
            shifting,
        }
    }

    /// Returns x of a step that is limited but not scaled, an estimate of where a command will be.
    #[inline(never)]
    pub fn estimate(&self, error: &PoseError6<T>) -> PoseError6<T> {
        self.damped_for(error).solve(error)
    }

    /// Computes the limited step against `error`.
    pub fn step(&self, error: &PoseError6<T>) -> LimitedStep<T> {
        let damped = self.damped_for(error);
        let (p, r) = halves(error);
        let Damping { position, rotation } = damped.damping;
        let beyond_floor = position - T::from_f64(FLOOR.position);
        // The shift turns the target by λ_r turned, which is turned back as far as λ_r allows.
        let shift = damped.shifting.solve(&p);
        let turned = product(&damped.along, &shift);
        let (back, back_turn) = damped.turn(&scaled(-rotation, &turned));
        let (mut turn_shift, mut turn) = damped.turn(&r);
        let (again, last_turn) = damped.turn(&scaled(rotation, &turn));
        turn_shift = sum(&turn_shift, &again);
        turn = sum(&turn, &last_turn);
        let shift = sum(&shift, &back);
        let shift_turn = difference(&back_turn, &turned);
        // The shift's share, if the whole turn follows it, then the turn's beside it, then that of both.
        let allowed = self.allowed_rotation(&r);
        let leaves = |shift: T, turn: T| {
            let damped = sum(&scaled(shift, &back_turn), &scaled(turn, &last_turn));
            sum(&scaled(T::ONE - turn, &r), &scaled(rotation, &damped))
        };
        let shift_share = largest_share(&leaves(T::ZERO, T::ONE), &leaves(T::ONE, T::ONE), allowed);
        let left = left_after(shift_share, &p, &scaled(position, &shift));
        let turn_share = turn_share(&p, &left, &scaled(beyond_floor, &turn_shift));
        let rotation_left = leaves(shift_share, turn_share);
        let taken = largest_share(&r, &rotation_left, allowed);
        let (shift_share, turn_share) = (taken * shift_share, taken * turn_share);
        let x = joined(
            &sum(
                &scaled(shift_share, &shift),
                &scaled(turn_share, &turn_shift),
            ),
            &sum(
                &scaled(shift_share, &shift_turn),
                &scaled(turn_share, &turn),
            ),
        );
        let left = left_after(shift_share, &p, &scaled(beyond_floor, &shift));
        let pushed = scaled(turn_share * beyond_floor, &turn_shift);
        let given_up = joined(&sum(&left, &pushed), &left_after(taken, &r, &rotation_left));
        LimitedStep {
            x,
            given_up,
            damped,
        }
    }
}

/// Returns the damping at a pose where the arm moves its target as `m` says: `floor`, and up to `largest` more where it can
/// hardly move it in some direction.
#[inline(never)]
fn damping_at<T: Scalar>(m: &Matrix<T>, floor: T, largest: T) -> T {
    let least = Factors::of(m, floor).least();
    let shortfall = larger(T::ONE - least / (T::from_f64(HELD) * largest), T::ZERO);
    floor + largest * (shortfall * shortfall)
}

/// Returns the share of a turn that pushes the target by `push` and takes no more of the position `p` than the shift, which
/// leaves `left` of it, has brought.
fn turn_share<T: Scalar>(p: &Vector<T>, left: &Vector<T>, push: &Vector<T>) -> T {
    let brought = squared(p).sqrt() - squared(left).sqrt();
    let brought = T::from_f64(TAKEN) * larger(brought, T::ZERO) + T::from_f64(LEAST_PUSH);
    // A share of min(brought/push, 1) would change abruptly where the two are equal.
    brought / (brought + squared(push).sqrt())
}

/// Returns what is left of an error after this share of a step that, taken whole, leaves `leaves`.
fn left_after<T: Scalar>(share: T, error: &Vector<T>, leaves: &Vector<T>) -> Vector<T> {
    sum(error, &scaled(share, &difference(leaves, error)))
}

/// Returns the largest share, from 0 to 1, of a step after which |e| is at most `allowed`, if the whole step leaves `left` of e.
fn largest_share<T: Scalar>(e: &Vector<T>, left: &Vector<T>, allowed: Option<T>) -> T {
    let Some(allowed) = allowed else {
        return T::ONE;
    };
    // |e + s m|² = allowed², with the step's motion m: s² m·m + 2 s e·m − c = 0. The root is above 1 where the whole step is
    // allowed. No branch: every command takes as long.
    let motion = difference(left, e);
    let along = dot(e, &motion);
    let slack = larger(allowed * allowed - squared(e), T::ZERO);
    let root = larger(along * along + squared(&motion) * slack, T::ZERO).sqrt();
    let share = slack / (along + root);
    if share < T::ONE { share } else { T::ONE }
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
