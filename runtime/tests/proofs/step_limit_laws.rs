//! The limited step: exact where it is slow enough, within its limits elsewhere, never worse than no step, and continuous.

use nalgebra::{SMatrix, SVector};
use poegp_runtime::correct::step_limit::{
    FLOOR, LimitedStep, SHIFT_DAMPING, SHIFT_LIMIT, StepLimit,
};
use poegp_runtime::kinematics::newton::{Gram, PoseError6};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

use crate::seeded::config;

type Matrix = SMatrix<f64, 6, 6>;
type Vector = SVector<f64, 6>;

/// Usual rotation error of an arm, which the step may leave, rad.
const USUAL: f64 = 2e-3;

/// Returns a Jacobian with these singular values, between two rotations of all six dimensions.
fn jacobian(values: &[f64; 6], seed: &[f64; 72]) -> Matrix {
    let turned = |seed: &[f64]| Matrix::from_row_slice(seed).qr().q();
    turned(&seed[..36]) * Matrix::from_diagonal(&Vector::from(*values)) * turned(&seed[36..])
}

fn gram(jacobian: &Matrix) -> Gram<f64> {
    let gram = jacobian * jacobian.transpose();
    core::array::from_fn(|i| core::array::from_fn(|j| gram[(i, j)]))
}

/// Returns the step against an error: the step, its joint changes, and the remaining error.
fn step(jacobian: &Matrix, error: &Vector) -> (LimitedStep<f64>, Vector, Vector) {
    let gram = gram(jacobian);
    let error_in: PoseError6<f64> = core::array::from_fn(|i| error[i]);
    let step = StepLimit::new(&gram, Some(USUAL)).step(&error_in);
    let joints = jacobian.transpose() * Vector::from(step.x);
    (step, joints, error - jacobian * joints)
}

/// Returns the damping matrix, with one λ for displacements and one for rotations.
fn diagonal(position: f64, rotation: f64) -> Matrix {
    let damping = [position, position, position, rotation, rotation, rotation];
    Matrix::from_diagonal(&Vector::from(damping))
}

fn position(v: &Vector) -> f64 {
    v.fixed_rows::<3>(0).norm()
}

fn rotation(v: &Vector) -> f64 {
    v.fixed_rows::<3>(3).norm()
}

/// Returns singular values of arms, some of them nearly zero.
fn values() -> impl Strategy<Value = [f64; 6]> {
    prop::array::uniform6(prop_oneof![3 => 0.15..2.0, 1 => 0.0..0.15, 1 => 0.0..1e-3])
}

fn errors() -> impl Strategy<Value = Vector> {
    prop::array::uniform6(-3e-3..3e-3).prop_map(Vector::from)
}

fn seeds() -> impl Strategy<Value = [f64; 72]> {
    prop::collection::vec(-1.0..1.0, 72).prop_map(|v| v.try_into().unwrap())
}

proptest! {
    #![proptest_config(config(94, 4_000))]

    /// Where the exact step is within the limits, it is taken. Only the least damping leaves something to later steps.
    #[test]
    fn a_slow_step_is_exact(
        values in prop::array::uniform6(0.45..2.0_f64),
        seed in seeds(),
        error in prop::array::uniform6(-1e-3..1e-3_f64),
    ) {
        let (jacobian, error) = (jacobian(&values, &seed), Vector::from(error));
        let (found, _, left) = step(&jacobian, &error);
        let share = FLOOR.position.max(FLOOR.rotation) / (0.45 * 0.45);
        prop_assert!(left.norm() <= 2.0 * share * error.norm(), "{:e}", left.norm());
        let given_up = Vector::from(found.given_up).norm();
        prop_assert!(given_up <= 4.0 * share * share * error.norm(), "{given_up:e}");
    }

    /// Where the arm can move its target every way, the position is exact, whatever is given up of the rotation.
    #[test]
    fn position_comes_first(
        values in prop::array::uniform6(0.15..2.0_f64),
        seed in seeds(),
        error in prop::array::uniform6(-5e-4..5e-4_f64),
    ) {
        let (found, _, _) = step(&jacobian(&values, &seed), &Vector::from(error));
        let given_up = position(&Vector::from(found.given_up));
        prop_assert!(given_up <= 1e-9, "{given_up:e}");
    }

    /// A step leaves what it gives up, and what the least damping leaves.
    #[test]
    fn what_is_given_up_is_left(values in values(), seed in seeds(), error in errors()) {
        let (found, _, left) = step(&jacobian(&values, &seed), &error);
        let floor = diagonal(FLOOR.position, 0.0) * Vector::from(found.x);
        let apart = (left - floor - Vector::from(found.given_up)).norm();
        prop_assert!(apart <= 1e-9 * error.norm(), "{apart:e}");
    }

    /// Later steps solve the whole equations with the damping of the limited step.
    #[test]
    fn later_steps_are_damped_as_the_first(values in values(), seed in seeds(), error in errors(), later in errors()) {
        let jacobian = jacobian(&values, &seed);
        let (found, _, _) = step(&jacobian, &error);
        let damping = found.damped.damping;
        let damping = diagonal(damping.position, damping.rotation);
        let whole = jacobian * jacobian.transpose() + damping;
        let later: PoseError6<f64> = core::array::from_fn(|i| later[i]);
        let x = found.damped.solve(&later);
        let expected = whole.cholesky().unwrap().solve(&Vector::from(later));
        prop_assert!((Vector::from(x) - expected).norm() <= 1e-9 * expected.norm());
        prop_assert!((Vector::from(found.damped.left(&x)) - damping * Vector::from(x)).norm() <= 1e-12);
    }

    /// For an error too small for any limit, of an arm that moves its target well, the step is that of the whole equations,
    /// which `nalgebra` solves, and what their damping has left of the rotation is asked for once more.
    #[test]
    fn a_rotation_is_asked_for_twice(
        values in prop::array::uniform6(0.45..2.0_f64),
        seed in seeds(),
        turns in prop_oneof![0.0..1.0, 0.0..1e-3],
        error in errors(),
    ) {
        let mut jacobian = jacobian(&values, &seed);
        // An arm that hardly turns its target about one axis.
        jacobian.row_mut(5).scale_mut(turns);
        let error = 1e-4 * error;
        let (found, _, _) = step(&jacobian, &error);
        let damping = found.damped.damping;
        prop_assert_eq!(damping.position, FLOOR.position);
        let whole = jacobian * jacobian.transpose() + diagonal(damping.position, damping.rotation);
        let whole = whole.cholesky().unwrap();
        let expected = whole.solve(&(error + diagonal(0.0, damping.rotation) * whole.solve(&error)));
        let apart = (Vector::from(found.x) - expected).norm();
        prop_assert!(apart <= 1e-9 * expected.norm(), "{apart:e}");
    }

    /// An error far below the usual one, which changes its sign within a short path, turns no joint quickly.
    #[test]
    fn a_small_error_is_damped_as_the_usual_one(values in values(), seed in seeds(), error in errors()) {
        let jacobian = jacobian(&values, &seed);
        let mut error = 1e-4 * error;
        error.fixed_rows_mut::<3>(3).fill(0.0);
        let (_, joints, _) = step(&jacobian, &error);
        let lever = jacobian.fixed_rows::<3>(0).norm();
        let gain = joints.norm() / error.norm() * lever;
        prop_assert!(gain * gain * SHIFT_DAMPING * USUAL <= 1.0, "{gain}");
    }

    /// The estimate of the corrected command is the first part of the step: the whole equations with its damping.
    #[test]
    fn the_estimate_is_damped_as_the_step(values in values(), seed in seeds(), error in errors()) {
        let jacobian = jacobian(&values, &seed);
        let (found, _, _) = step(&jacobian, &error);
        let error_in: PoseError6<f64> = core::array::from_fn(|i| error[i]);
        let estimate = StepLimit::new(&gram(&jacobian), Some(USUAL)).estimate(&error_in);
        prop_assert!(estimate == found.damped.solve(&error_in));
    }

    /// |x_p| of the whole equations is within its limit. Shift and turn are parts of it, each at most as long.
    #[test]
    fn no_step_is_steep(values in values(), seed in seeds(), error in errors()) {
        let jacobian = jacobian(&values, &seed);
        let (found, _, _) = step(&jacobian, &error);
        let error_in: PoseError6<f64> = core::array::from_fn(|i| error[i]);
        let limit = SHIFT_LIMIT / jacobian.fixed_rows::<3>(0).norm();
        let whole = position(&Vector::from(found.damped.solve(&error_in)));
        prop_assert!(whole <= 1.05 * limit, "{whole} of {limit}");
    }

    /// The position error never exceeds the one without the step, and the rotation error never exceeds what it may be.
    #[test]
    fn nothing_gets_worse(values in values(), seed in seeds(), error in errors()) {
        let (found, joints, left) = step(&jacobian(&values, &seed), &error);
        prop_assert!(joints.iter().all(|d| d.is_finite()));
        // Later steps bring what the least damping leaves.
        let worse = position(&Vector::from(found.given_up)) - position(&error);
        prop_assert!(worse <= 0.6e-6, "{worse:e}");
        let most = rotation(&error).max(1.15 * USUAL) + 0.9e-4;
        prop_assert!(rotation(&left) <= most, "{:e} of {most:e}", rotation(&left));
    }

    /// A small change of the Jacobian or the error causes a small change of the step.
    #[test]
    fn it_is_continuous(
        values in values(),
        seed in seeds(),
        error in errors(),
        other in seeds(),
        towards in errors(),
    ) {
        let here = jacobian(&values, &seed);
        let there = Matrix::from_row_slice(&other[..36]);
        let mut last = f64::INFINITY;
        for way in [1e-4, 1e-6, 1e-8] {
            let (_, a, _) = step(&here, &error);
            let (_, b, _) = step(&(here + way * there), &(error + way * towards));
            let jump = (a - b).norm();
            prop_assert!(jump <= 4.0 * libm::sqrt(way), "{jump:e} after {way:e}");
            last = last.min(jump);
        }
        prop_assert!(last <= 1e-5, "{last:e}");
    }
}

/// An arm of four joints reaches the position, whatever rotation is asked of it: it need not hold one that it cannot hold.
#[test]
fn few_joints_reach_the_position() {
    let number = |i: usize, seed: f64| {
        let large = 43_758.545 * libm::sin(12.9898 * i as f64 + 78.233 * seed);
        2.0 * (large - libm::floor(large)) - 1.0
    };
    let mut tried = 0;
    for seed in (1..=400).map(|k| 0.37 * f64::from(k)) {
        let j = SMatrix::<f64, 6, 4>::from_fn(|row, joint| 1.5 * number(4 * row + joint, seed));
        let least = j.fixed_rows::<3>(0).singular_values().min();
        if least < 0.7 {
            continue;
        }
        tried += 1;
        let square = j * j.transpose();
        let gram: Gram<f64> = core::array::from_fn(|i| core::array::from_fn(|k| square[(i, k)]));
        let error = Vector::from_fn(|i, _| 1e-3 * number(i + 31, seed));
        let asked: PoseError6<f64> = core::array::from_fn(|i| error[i]);
        let step = StepLimit::new(&gram, None).step(&asked);
        let left = error - square * Vector::from(step.x);
        let share = position(&left) / position(&error);
        assert!(share < 0.05, "{share} of the position error is left");
    }
    assert!(tried > 50, "{tried}");
}

/// Zero, NaN and infinity do not panic, and an error of zero gives a step of zero.
#[test]
fn nothing_is_asked_of_nothing() {
    let singular = gram(&Matrix::zeros());
    let step = StepLimit::new(&singular, Some(0.0)).step(&[0.0; 6]);
    assert_eq!(step.x, [0.0; 6]);
    let step = StepLimit::new(&singular, None).step(&[1.0; 6]);
    assert!(step.x.iter().all(|x: &f64| x.is_finite()));
    let nan = [[f64::NAN; 6]; 6];
    let _ = StepLimit::new(&nan, Some(f64::NAN)).step(&[f64::INFINITY; 6]);
}

/// The rotation that x_p costs, λ_r (C + λ_r)⁻¹ Bᵀ x_p, is within what may be left in nine of ten steps: three Newton steps do not
/// always meet two limits.
#[test]
fn few_shifts_cost_more_rotation_than_allowed() {
    const STEPS: usize = 2_000;
    let mut runner = TestRunner::new(config(96, 1));
    let cases = (values(), seeds(), errors());
    let mut beyond = 0;
    for _ in 0..STEPS {
        let (values, seed, error) = cases.new_tree(&mut runner).unwrap().current();
        let jacobian = jacobian(&values, &seed);
        let (found, _, _) = step(&jacobian, &error);
        let whole = jacobian * jacobian.transpose();
        let damping = found.damped.damping.rotation;
        let turning = whole.fixed_view::<3, 3>(3, 3) + damping * SMatrix::<f64, 3, 3>::identity();
        let x = Vector::from(found.damped.solve(&core::array::from_fn(|i| error[i])));
        let pushed = whole.fixed_view::<3, 3>(3, 0) * x.fixed_rows::<3>(0);
        let cost = damping * turning.cholesky().unwrap().solve(&pushed).norm();
        let allowed = rotation(&error).max(1.15 * USUAL) + 0.9e-4;
        beyond += usize::from(cost > 1.02 * allowed);
    }
    println!("{beyond} of {STEPS} shifts cost more rotation than allowed");
    assert!(10 * beyond <= STEPS, "{beyond}");
}

/// Returns the steepest step, in radians per radian, along a path on which the Jacobian changes by 1 for each radian in its
/// largest singular value and loses a rank halfway.
fn steepest(path: (Matrix, Matrix), error: &Vector, usual_rotation: f64) -> f64 {
    const WAY: f64 = 0.1;
    const POINTS: i32 = 500;
    let (halfway, along) = path;
    let error: PoseError6<f64> = core::array::from_fn(|i| error[i]);
    let step = |k: i32| {
        let here = halfway + WAY * f64::from(k) / f64::from(POINTS) * along;
        let gram = gram(&here);
        let x = StepLimit::new(&gram, Some(usual_rotation)).step(&error).x;
        here.transpose() * Vector::from(x)
    };
    let mut last = step(-POINTS);
    let mut largest = 0.0_f64;
    for k in 1 - POINTS..=POINTS {
        let next = step(k);
        largest = largest.max((next - last).norm());
        last = next;
    }
    largest * f64::from(POINTS) / WAY
}

/// 19 of 20 paths through a singularity are slow, even where one limit leaves nearly nothing for the other.
#[test]
fn most_paths_are_slow() {
    const PATHS: usize = 200;
    let mut runner = TestRunner::new(config(95, 1));
    let mut draw = || {
        let mut seed = || seeds().new_tree(&mut runner).unwrap().current();
        let (at, change) = (seed(), seed());
        let values: [f64; 6] = core::array::from_fn(|i| 1.15 + 0.85 * change[36 + i]);
        let values = [0.0, values[1], values[2], values[3], values[4], values[5]];
        let along = Matrix::from_row_slice(&change[..36]);
        let direction = |from: usize| SVector::<f64, 3>::from_row_slice(&change[from..from + 3]);
        let directions = [direction(42), direction(45)].map(|v| v.normalize());
        (
            (
                jacobian(&values, &at),
                along / along.singular_values().max(),
            ),
            directions,
        )
    };
    // Position error in m, rotation error in rad, and the arm's usual rotation error in rad.
    let cases = [
        ("both errors as usual", 2e-3, 3e-3, 2e-3, 0.12),
        ("a turn and nearly no position", 5e-6, 3e-3, 3e-3, 0.08),
        ("a shift and little rotation", 2e-3, 1e-4, 1e-4, 0.12),
        ("a shift and no rotation", 2e-3, 1e-6, 1e-6, 0.08),
    ];
    for (name, position, rotation, usual, limit) in cases {
        let mut slopes: Vec<f64> = (0..PATHS)
            .map(|_| {
                let (path, [p, r]) = draw();
                let (p, r) = (position * p, rotation * r);
                let error = Vector::from([p[0], p[1], p[2], r[0], r[1], r[2]]);
                steepest(path, &error, usual)
            })
            .collect();
        slopes.sort_by(f64::total_cmp);
        let found = slopes[PATHS * 19 / 20];
        println!("{name}: {found:.3} rad/rad, limit {limit}");
        assert!(found <= limit, "{name}: {found:.3} rad/rad");
    }
}
