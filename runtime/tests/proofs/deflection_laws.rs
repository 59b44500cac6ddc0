//! The formulas of the elastic correction, compared with the same formulas written differently: with angles instead of sines
//! and cosines, natural exponentials, single regressors, and general exponentials of se(3).

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::elastic::deflection::{deflected, deflection_twist};
use poegp_runtime::elastic::gravity::{Gravity, GravityRegressors, GravityTerms};
use poegp_runtime::gp::KernelLoops;
use poegp_runtime::gp::inducing_sets::InducingSet;
use poegp_runtime::gp::joint_kernel::{JointKernel, similarity};
use poegp_runtime::gp::joint_processes::JointProcesses;
use poegp_runtime::kinematics::coupling::PerJoint;
use poegp_runtime::kinematics::minimal_chain::{JointFrames, MinimalChain, MinimalForm};
use poegp_runtime::kinematics::poe::{JointTrig, zero_joint_trig};
use poegp_runtime::math::se3::{dot, residual};
use proptest::prelude::*;

use crate::seeded::{chains, config, distance, poe};

/// Returns the joints in the form that the kernel compares, computed without the runtime.
fn places<T: KernelLoops>(kinds: &[JointKind], q: &[f64]) -> JointTrig<T> {
    let mut out = [[T::ZERO; 2]; 8];
    for ((slot, kind), q) in out.iter_mut().zip(kinds).zip(q) {
        *slot = match kind {
            JointKind::Revolute => [libm::sin(*q), libm::cos(*q)],
            JointKind::Prismatic => [*q, 0.0],
        }
        .map(T::from_f64);
    }
    out
}

/// Natural parameters of one kernel: w_d, w_m, a0, a1.
type Natural = (Vec<f64>, f64, f64, f64);

/// Returns exp(−½ Σ w_d d²), where d is the chord of a revolute joint and the displacement of a prismatic one.
fn direct_joint_factor(kinds: &[JointKind], natural: &Natural, a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (d, kind) in kinds.iter().enumerate() {
        let squared = match kind {
            JointKind::Revolute => 2.0 - 2.0 * libm::cos(a[d] - b[d]),
            JointKind::Prismatic => (a[d] - b[d]) * (a[d] - b[d]),
        };
        sum += natural.0[d] * squared;
    }
    libm::exp(-0.5 * sum)
}

fn direct_payload_factor(natural: &Natural, m: f64, other: f64) -> f64 {
    let (_, rate, constant, slope) = natural;
    (constant + slope * m * other) * libm::exp(-0.5 * rate * (m - other) * (m - other))
}

fn kernel<T: KernelLoops>(natural: &Natural) -> JointKernel<T> {
    let rates: Vec<T> = natural.0.iter().map(|w| T::from_f64(*w)).collect();
    JointKernel::from_natural(
        &rates,
        T::from_f64(natural.1),
        T::from_f64(natural.2),
        T::from_f64(natural.3),
    )
}

fn similarities<T: KernelLoops>(kinds: &[JointKind], a: &JointTrig<T>, b: &JointTrig<T>) -> Vec<T> {
    let pairs = a.iter().zip(b);
    kinds
        .iter()
        .zip(pairs)
        .map(|(kind, (a, b))| similarity(*kind, a, b))
        .collect()
}

fn kinds() -> impl Strategy<Value = Vec<JointKind>> {
    let any = prop_oneof![Just(JointKind::Revolute), Just(JointKind::Prismatic)];
    let turning = (1_usize..=8).prop_map(|n| vec![JointKind::Revolute; n]);
    prop_oneof![turning, prop::collection::vec(any, 1..=8)]
}

/// Returns parameters of eight kernels, with weights up to `steepest`.
fn naturals(steepest: f64) -> impl Strategy<Value = Vec<Natural>> {
    let weights = prop::collection::vec(0.0..steepest, 8);
    prop::collection::vec((weights, 0.0..0.2_f64, 0.0..2.0_f64, 0.0..0.1_f64), 8)
}

/// Joint values, payload, weights of an inducing point.
type Point = (Vec<f64>, f64, Vec<f64>);

fn points(count: usize) -> impl Strategy<Value = Vec<Point>> {
    let point = (
        prop::collection::vec(-3.0..3.0_f64, 8),
        (0..4_u8).prop_map(|m| 2.5 * f64::from(m)),
        prop::collection::vec(-1.0..1.0_f64, 8),
    );
    prop::collection::vec(point, 0..=count)
}

/// Returns the processes at (q, m), by the runtime and by the formula. `ranges` are the trained ranges of all joints, or
/// empty; see [`JointProcesses::choose_loops`]. Point j is in the set of joint c unless j + c is a multiple of three.
fn mean<T: KernelLoops>(
    kinds: &[JointKind],
    naturals: &[Natural],
    points: &[Point],
    ranges: &[(f64, f64)],
    (q, m): (&[f64], f64),
) -> (PerJoint<T>, PerJoint<f64>) {
    let n = kinds.len();
    let mut points: Vec<(usize, &Point)> = points.iter().enumerate().collect();
    points.sort_by(|a, b| a.1.1.total_cmp(&b.1.1));
    let mut payloads: Vec<f64> = points.iter().map(|(_, point)| point.1).collect();
    payloads.dedup();
    let mut processes = JointProcesses::none();
    processes
        .group_payloads_kg
        .extend(payloads.iter().map(|payload| T::from_f64(*payload)));
    let (mut rows, mut expected) = (Vec::new(), [0.0; 8]);
    for c in 0..n {
        let mut natural = naturals[c].clone();
        natural.0.truncate(n);
        processes.kernels[c] = kernel(&natural);
        let members = points.iter().filter(|(j, _)| (j + c) % 3 != 0);
        let members: Vec<&Point> = members.map(|(_, point)| *point).collect();
        let of = |payload: &f64| members.iter().filter(|point| point.1 == *payload).count();
        let counts: Vec<u16> = payloads.iter().map(|payload| of(payload) as u16).collect();
        let set = InducingSet::new(&processes.kernels[c], &counts);
        for (place, payload, weights) in &members {
            let all = places::<T>(kinds, place);
            rows.extend(set.joints().iter().flat_map(|d| all[usize::from(*d)]));
            rows.push(T::from_f64(weights[c]));
            expected[c] += direct_payload_factor(&naturals[c], m, *payload)
                * direct_joint_factor(kinds, &naturals[c], q, place)
                * weights[c];
        }
        processes.sets.push(set).unwrap();
    }
    assert_eq!(processes.words(), rows.len());
    let in_numbers = |(lower, upper): &(f64, f64)| (T::from_f64(*lower), T::from_f64(*upper));
    let ranges: Vec<(T, T)> = ranges.iter().map(in_numbers).collect();
    processes.choose_loops(kinds, &ranges);
    processes.arrange(&mut rows);
    let (found, _) = processes.mean(kinds, &rows, &places(kinds, q), T::from_f64(m));
    (found, expected)
}

fn mean_is_the_formula(
    kinds: &[JointKind],
    naturals: &[Natural],
    points: &[Point],
    ranges: &[(f64, f64)],
    at: (&[f64], f64),
) -> Result<(), TestCaseError> {
    let (double, expected) = mean::<f64>(kinds, naturals, points, ranges, at);
    let error = distance(&double, &expected);
    prop_assert!(error < 1e-11, "f64 {:e}", error);
    let (single, expected) = mean::<f32>(kinds, naturals, points, ranges, at);
    // In f32 a kernel of rate W has an exponent with W steps of 2^-24. The weights are up to 1, the amplitudes up to 17.
    let steepest = naturals
        .iter()
        .flat_map(|n| &n.0)
        .fold(1.0, |a: f64, b| a.max(*b));
    let tolerance = 2e-5 * steepest * points.len().max(1) as f64;
    let error = distance(&single.map(f64::from), &expected);
    prop_assert!(error < tolerance, "f32 {:e}, {:e}", error, tolerance);
    Ok(())
}

proptest! {
    #![proptest_config(config(61, 500))]

    #[test]
    fn kernel_is_the_formula(
        kinds in kinds(),
        natural in naturals(4.0),
        a in prop::collection::vec(-3.0..3.0_f64, 8),
        b in prop::collection::vec(-3.0..3.0_f64, 8),
        (m, other) in (0.0..10.0_f64, 0.0..10.0_f64),
    ) {
        let mut natural = natural[0].clone();
        natural.0.truncate(kinds.len());
        let (x, y) = (places::<f64>(&kinds, &a), places::<f64>(&kinds, &b));
        let kernel = kernel::<f64>(&natural);
        let found = kernel.joint_factor(&similarities(&kinds, &x, &y));
        let expected = direct_joint_factor(&kinds, &natural, &a, &b);
        prop_assert!((found - expected).abs() < 1e-13, "{} {}", found, expected);
        let found = kernel.payload_factor(m, other);
        let expected = direct_payload_factor(&natural, m, other);
        prop_assert!((found - expected).abs() < 1e-13, "{} {}", found, expected);
        // A configuration has correlation 1 with itself.
        prop_assert!((kernel.joint_factor(&similarities(&kinds, &x, &x)) - 1.0).abs() < 1e-13);
    }

    #[test]
    fn gram_matrix_is_symmetric_and_positive_semidefinite(
        kinds in kinds(),
        natural in naturals(2.0),
        points in points(12),
    ) {
        let mut natural = natural[0].clone();
        natural.0.truncate(kinds.len());
        let kernel = kernel::<f64>(&natural);
        let n = points.len();
        let value = |i: usize, j: usize| {
            let place = |i: usize| places(&kinds, &points[i].0);
            kernel.payload_factor(points[i].1, points[j].1)
                * kernel.joint_factor(&similarities(&kinds, &place(i), &place(j)))
        };
        let mut factor = vec![vec![0.0; n]; n];
        for i in 0..n {
            for j in 0..=i {
                prop_assert_eq!(value(i, j), value(j, i));
                let mut rest = value(i, j) + if i == j { 1e-10 } else { 0.0 };
                for (a, b) in factor[i].iter().zip(&factor[j]).take(j) {
                    rest -= a * b;
                }
                if i == j {
                    prop_assert!(rest > 0.0, "pivot {} of {}: {:e}", i, n, rest);
                    factor[i][i] = libm::sqrt(rest);
                } else {
                    factor[i][j] = rest / factor[j][j];
                }
            }
        }
    }

    /// Covers the unrolled loops for revolute joints, the general loop, and joints that are skipped because their rate is zero.
    #[test]
    fn posterior_mean_is_the_formula(
        kinds in kinds(),
        naturals in naturals(1.5),
        left_out in prop::collection::vec(any::<u8>(), 8),
        points in points(12),
        q in prop::collection::vec(-3.0..3.0_f64, 8),
        m in 0.0..12.0_f64,
    ) {
        let mut naturals = naturals;
        for (natural, left_out) in naturals.iter_mut().zip(&left_out) {
            for (d, rate) in natural.0.iter_mut().enumerate() {
                if left_out & (1 << d) != 0 {
                    *rate = 0.0;
                }
            }
        }
        mean_is_the_formula(&kinds, &naturals, &points, &[], (&q, m))?;
        // The unrolled loops also take prismatic joints if the scales allow it; all points are within these ranges.
        mean_is_the_formula(&kinds, &naturals, &points, &[(-3.0, 3.5); 8], (&q, m))?;
        let gentle: Vec<Natural> = naturals.iter().cloned().map(|mut natural| {
            natural.0.iter_mut().for_each(|weight| *weight *= 0.05);
            natural
        }).collect();
        mean_is_the_formula(&kinds, &gentle, &points, &[(-3.0, 3.5); 8], (&q, m))?;
    }

    /// Beyond its trained range, a prismatic joint has the values at the end of the range, however far it is, whatever the
    /// rows contain.
    #[test]
    fn sliding_joints_are_held_in_their_range(
        kinds in kinds(),
        naturals in naturals(0.2),
        points in points(12),
        q in prop::collection::vec(-3.0..3.0_f64, 8),
        far in 0.0..4096.0_f64,
        m in 0.0..12.0_f64,
    ) {
        let ranges = [(-1.0, 1.5); 8];
        let slides = |d: usize| kinds.get(d) == Some(&JointKind::Prismatic);
        let beyond: Vec<f64> = (0..8).map(|d| if slides(d) { 1.5 + far } else { q[d] }).collect();
        let at_the_end: Vec<f64> = (0..8).map(|d| if slides(d) { 1.5 } else { q[d] }).collect();
        // Steep kernels take the general loop, as eight joints in one kernel do.
        for steeper in [1.0, 300.0] {
            let steep: Vec<Natural> = naturals.iter().cloned().map(|mut natural| {
                natural.0.iter_mut().for_each(|weight| *weight *= steeper);
                natural
            }).collect();
            let (found, _) = mean::<f32>(&kinds, &steep, &points, &ranges, (&beyond, m));
            let (expected, _) = mean::<f32>(&kinds, &steep, &points, &ranges, (&at_the_end, m));
            prop_assert!(distance(&found.map(f64::from), &expected.map(f64::from)) < 1e-5 * steeper);
        }
        let mut wild = points;
        for (place, _, _) in &mut wild {
            for d in (0..8).filter(|d| slides(*d)) {
                place[d] = far;
            }
        }
        let (found, _) = mean::<f32>(&kinds, &naturals, &wild, &ranges, (&q, m));
        prop_assert!(found.iter().all(|value| value.is_finite()), "{:?}", found);
    }

    /// Kernels so steep that the exponential needs its clamp.
    #[test]
    fn posterior_mean_of_steep_kernels(
        joints in 5_usize..=7,
        naturals in naturals(100.0),
        points in points(4),
        at in prop::sample::select(vec![0_usize, 1, 2, 3]),
        m in 0.0..12.0_f64,
    ) {
        let kinds = vec![JointKind::Revolute; joints];
        // At an inducing point, because elsewhere these kernels are zero.
        let q = points.get(at).map_or(vec![0.5; 8], |point| point.0.clone());
        mean_is_the_formula(&kinds, &naturals, &points, &[], (&q, m))?;
    }

    /// Compared with the sum over single regressors; a prismatic joint is moved by the weight alone.
    #[test]
    fn gravity_is_regressors_times_coefficients(
        (kinds, frames, q) in chains(),
        numbers in prop::collection::vec(-1.0..1.0_f64, 8 * 8 * 3 + 8 * 4 + 3),
        m in 0.0..10.0_f64,
        pull in 0..4_usize,
        idle in 0..3_usize,
        parts in prop::array::uniform8(0..8_usize),
    ) {
        let (chain, n) = (poe::<f64>(&kinds, &frames), kinds.len());
        let (frames, target) = chain.joint_frames(&q);
        let mut moved = JointFrames::new();
        let form = MinimalForm::new(&chain);
        MinimalChain::new(&form).moved_frames_at(&chain.motions(&q), &mut moved);
        let mut numbers = numbers.into_iter();
        let mut vector = || Vector3::from_fn(|_, _| numbers.next().unwrap());
        let mut terms = GravityTerms::<f64>::zero();
        // Gravity along one axis, along two as on a wall, or in any direction.
        terms.gravity = match pull {
            0 => Vector3::new(0.0, 0.0, -9.81),
            1 => Vector3::new(9.81, 0.0, -1.0),
            2 => Vector3::new(0.0, 9.81, -1.0),
            _ => vector() * 9.81,
        };
        for (c, parts) in parts.iter().enumerate().take(n).skip(idle) {
            // Each part may be absent.
            let part = |bit: usize| f64::from(u8::from(parts & bit != 0));
            for j in c..n {
                terms.links[c][j] = vector() * part(1);
            }
            terms.payload_offset[c] = vector() * part(2);
            terms.payload_lever[c] = vector()[0] * part(4);
        }
        let at = GravityRegressors::new(&kinds, &frames, &target, &terms.gravity);
        let found = terms.deflection(&at, m);
        let mut turned = terms;
        turned.turn_into(&form);
        let fast = Gravity::new(&turned, &form).deflection(&kinds, &moved, &target, m);
        for c in 0..n {
            let (lever, offset) = at.payload(c);
            let mut expected =
                m * (lever * terms.payload_lever[c] + dot(&offset, &terms.payload_offset[c]));
            for j in c..n {
                let regressors = at.link(c, j);
                expected += dot(&regressors, &terms.links[c][j]);
                if kinds[c] == JointKind::Prismatic {
                    prop_assert_eq!((regressors[1], regressors[2], lever), (0.0, 0.0, 0.0));
                }
            }
            prop_assert!((found[c] - expected).abs() < 1e-10, "{} {}", found[c], expected);
            prop_assert!((fast[c] - expected).abs() < 1e-10, "{} {}", fast[c], expected);
        }
        prop_assert!(found[n..].iter().chain(&fast[n..]).all(|value| *value == 0.0));
    }

    /// The series leaves out δ⁵/120.
    #[test]
    fn a_small_turn_is_the_sine_of_the_sum(q in -4.0..4.0_f64, delta in -0.1..0.1_f64, way in -1.0..1.0_f64) {
        let mut motions = zero_joint_trig();
        motions[0] = [libm::sin(q), libm::cos(q)];
        motions[1][0] = way;
        let kinds = [JointKind::Revolute, JointKind::Prismatic];
        let mut deflection = [delta; 8];
        let moved = deflected(&motions, &kinds, &deflection);
        let left_out = libm::pow(delta.abs(), 5.0) / 100.0 + 3e-16;
        prop_assert!((moved[0][0] - libm::sin(q + delta)).abs() <= left_out);
        prop_assert!((moved[0][1] - libm::cos(q + delta)).abs() <= left_out);
        prop_assert_eq!(moved[1], [way + delta, 0.0]);
        // Other joints do not move, and a deflection of zero changes nothing.
        prop_assert_eq!(moved[2], [0.0; 2]);
        deflection.fill(0.0);
        let still = deflected(&motions, &kinds, &deflection);
        prop_assert_eq!(still[0], motions[0]);
    }

    #[test]
    fn deflection_twist_against_differences(
        (kinds, frames, q) in chains(),
        direction in prop::array::uniform8(-1.0..1.0_f64),
    ) {
        let chain = poe::<f64>(&kinds, &frames);
        let (joint_frames, target) = chain.joint_frames(&q);
        let found = deflection_twist(&kinds, &joint_frames, &direction).to_array();
        let step = 1e-5;
        let at = |by: f64| {
            let moved: Vec<f64> = q.iter().zip(&direction).map(|(q, d)| q + by * d).collect();
            residual(&chain.forward(&moved), &target).to_array()
        };
        let (ahead, behind) = (at(step), at(-step));
        let expected: [f64; 6] = core::array::from_fn(|i| (ahead[i] - behind[i]) / (2.0 * step));
        let error = distance(&found, &expected);
        prop_assert!(error < 1e-6, "{:e}", error);
    }
}

#[test]
fn motions_are_sines_and_cosines_of_revolute_joints_and_values_of_prismatic_ones() {
    let kinds = [JointKind::Revolute, JointKind::Prismatic];
    let frames = [[0.0; 6]; 3];
    let found = poe::<f64>(&kinds, &frames).motions(&[0.7, 0.3]);
    assert_eq!(
        found[..3],
        [[libm::sin(0.7), libm::cos(0.7)], [0.3, 0.0], [0.0, 0.0]]
    );
}

/// A prismatic joint can be so far away that the exponent exceeds the range of a power of two.
#[test]
fn far_along_a_slide_the_factor_is_zero() {
    fn factor<T: KernelLoops>(metres: f64) -> f64 {
        let similarity = similarity(
            JointKind::Prismatic,
            &[T::from_f64(metres), T::ZERO],
            &[T::ZERO, T::ZERO],
        );
        let kernel: JointKernel<T> = kernel(&(vec![10.0], 0.0, 1.0, 0.0));
        kernel.joint_factor(&[similarity]).to_f64()
    }
    for metres in [10.0, 1e3, 2e3, 1e4, 1e6] {
        assert!(factor::<f64>(metres) <= 1e-37, "{metres}");
        assert!(factor::<f32>(metres) <= 1e-37, "{metres}");
    }
    assert_eq!(factor::<f32>(0.0), 1.0);
}
