//! Own-joint curves: the prior against its Fourier integral, the likelihood against curves written as parameters, and arms
//! whose joints err as a function of their own angle.

use nalgebra::Vector3;
use poegp_calibration::identification::parametric::state::{
    Layout, ParametricModel, ROWS, prior_variance,
};
use poegp_calibration::learning::elastic::hyperparameters::{DEFLECTION_UNIT, HyperLayout};
use poegp_calibration::learning::elastic::inputs::Inputs;
use poegp_calibration::learning::elastic::likelihood::MarginalLikelihood;
use poegp_calibration::learning::elastic::own_joint_curve::{CurvePrior, Spectrum};
use poegp_calibration::measurement::noise::NoiseScales;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{
    Base, BaseSample, Instrument, InstrumentSample, Sample,
};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::lbfgs::Objective;
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_protocol::limits::MAX_CURVE_ORDER;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::calibrated;

/// Noise of one component of the simulated instrument, m and rad.
const NOISE: (f64, f64) = (2e-5, 5e-5);

/// The kernel exp((cos d − 1)/l²) without its mean is Σ v_k cos kd. v_k is its Fourier integral, here by the trapezoidal
/// rule, which is exact for a smooth periodic function.
#[test]
fn the_spectrum_is_the_fourier_integral_of_the_kernel() {
    const POINTS: usize = 4_096;
    let integral = |l: f64, k: usize| {
        let at = |i: usize| {
            let d = std::f64::consts::TAU * i as f64 / POINTS as f64;
            libm::exp((libm::cos(d) - 1.0) / (l * l)) * libm::cos(k as f64 * d)
        };
        2.0 * (0..POINTS).map(at).sum::<f64>() / POINTS as f64
    };
    for l in [0.05, 0.0541, 0.1, 0.3, 1.0, 2.0] {
        let found = Spectrum::new(l);
        let (above, below) = (
            Spectrum::new(l * libm::exp(1e-5_f64)),
            Spectrum::new(l * libm::exp(-1e-5_f64)),
        );
        for k in 1..=MAX_CURVE_ORDER {
            let expected = integral(l, k);
            let error = (found.variance[k - 1] - expected).abs();
            assert!(error < 1e-14, "l {l}, order {k}: {error:e}");
            let slope = (above.variance[k - 1] - below.variance[k - 1]) / 2e-5;
            let error = (found.slope[k - 1] - slope).abs();
            assert!(error < 1e-9, "l {l}, order {k}: slope {error:e}");
        }
        let prior = CurvePrior {
            amplitude: 4.0,
            spectrum: found,
        };
        let between = prior.between([0.0, 1.0], libm::sincos(0.3_f64).into());
        let expected: f64 = (1..=MAX_CURVE_ORDER)
            .map(|k| 4.0 * integral(l, k) * libm::cos(0.3 * k as f64))
            .sum();
        assert!((between - expected).abs() < 1e-12);
    }
}

/// Returns an arm whose description states no gear lines.
pub fn robot() -> Robot {
    let mut robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    robot.joints.iter_mut().for_each(|j| j.gear_lines.clear());
    robot
}

/// The error of each joint of a simulated arm as a function of its own angle.
pub struct Curves {
    /// Amplitudes of sin kq and cos kq, by joint.
    pub orders: Vec<Vec<[f64; 2]>>,
}

impl Curves {
    /// Draws curves of `size` rad RMS in total, spread evenly over orders 1 to `orders`.
    pub fn draw(joints: usize, orders: usize, size: f64, random: &mut ChaCha8Rng) -> Self {
        let each = size / (orders as f64).sqrt();
        let mut normal = || -> f64 {
            let drawn: f64 = StandardNormal.sample(random);
            each * drawn
        };
        let joint = |_| (0..orders).map(|_| [normal(), normal()]).collect();
        Self {
            orders: (0..joints).map(joint).collect(),
        }
    }

    fn at(&self, joint: usize, q: f64) -> f64 {
        let term = |(i, [sin, cos]): (usize, &[f64; 2])| {
            let angle = (i + 1) as f64 * q;
            sin * libm::sin(angle) + cos * libm::cos(angle)
        };
        self.orders[joint].iter().enumerate().map(term).sum()
    }
}

/// Measures an arm with these curves and displaced frames, at joints that `draw` gives.
pub fn measured(
    curves: &Curves,
    count: usize,
    random: &mut ChaCha8Rng,
    mut draw: impl FnMut(usize, &mut ChaCha8Rng) -> f64,
) -> Vec<InstrumentSample> {
    let mut chain = robot().chain().unwrap();
    // Every call displaces the frames in the same way.
    let mut frames = ChaCha8Rng::seed_from_u64(3);
    let normal = |size: f64, random: &mut ChaCha8Rng| {
        Vector3::from_fn(|_, _| {
            let drawn: f64 = StandardNormal.sample(random);
            size * drawn
        })
    };
    for frame in chain.frames_mut() {
        let (linear, angular) = (normal(5e-4, &mut frames), normal(5e-4, &mut frames));
        *frame = *frame * Pose::exp(&Twist { linear, angular });
    }
    (0..count)
        .map(|_| {
            let joints: Vec<f64> = (0..6).map(|c| draw(c, random)).collect();
            let moved: Vec<f64> = joints
                .iter()
                .enumerate()
                .map(|(c, q)| q + curves.at(c, *q))
                .collect();
            let mut pose = chain.forward(&moved);
            let turn = Twist {
                linear: Vector3::zeros(),
                angular: normal(NOISE.1, random),
            };
            pose.rotation = Pose::exp(&turn).rotation * pose.rotation;
            pose.translation += normal(NOISE.0, random);
            Sample::new(joints.clone(), joints, Observation::Pose(pose), Instrument)
        })
        .collect()
}

pub fn anywhere(_: usize, random: &mut ChaCha8Rng) -> f64 {
    random.random_range(-1.5..1.5)
}

fn config(curve: bool) -> Config {
    Config {
        curve,
        ..Config::new(Method::Elastic)
    }
}

fn state(curves: &Curves, poses: usize) -> (ParametricModel, Vec<BaseSample>) {
    let chain = robot().chain().unwrap();
    let layout = Layout {
        joints: 6,
        tools: 1,
        gravity: true,
        payload: false,
        ripple: Vec::new(),
    };
    let tool = chain.frames()[6];
    let down = Vector3::new(0.0, 0.0, -9.81);
    let samples = measured(curves, poses, &mut ChaCha8Rng::seed_from_u64(5), anywhere)
        .into_iter()
        .map(|s| Sample::new(s.joints, s.serial_joints, s.observation, Base))
        .collect();
    (
        ParametricModel::new(&chain, vec![tool], None, layout, down),
        samples,
    )
}

const SCALES: NoiseScales = NoiseScales::uniform(1e-3, 1e-3);

const LAYOUT: HyperLayout = HyperLayout {
    joints: 6,
    payload: false,
    curve: true,
};

/// Calls `use_it` with the likelihood of these samples.
fn with_likelihood<T>(
    state: &ParametricModel,
    samples: &[BaseSample],
    (layout, processes): (HyperLayout, bool),
    use_it: impl FnOnce(&MarginalLikelihood<'_>) -> T,
) -> T {
    let inputs = Inputs::new(state, samples);
    use_it(&MarginalLikelihood {
        linear: &state.linearise(samples, SCALES),
        groups: &state.layout.groups(),
        similarities: &inputs.similarities(),
        waves: &inputs.waves(layout),
        inputs: &inputs,
        layout,
        processes,
        threads: 2,
    })
}

/// The solution equals that of the curves written as parameters: S = A Λ Aᵀ with columns J_c sin kq and J_c cos kq.
#[test]
fn curves_are_parameters_with_the_spectrum_as_prior() {
    let (state, samples) = state(
        &Curves {
            orders: vec![Vec::new(); 6],
        },
        14,
    );
    let layout = LAYOUT;
    let (mut h, _) = layout.start_and_bounds(1.0);
    h[layout.curve_scale()] = libm::log(0.2_f64);
    let solved = with_likelihood(&state, &samples, (layout, false), |likelihood| {
        likelihood.solve(&h).unwrap()
    });
    let linear = state.linearise(&samples, SCALES);
    let groups = state.layout.groups();
    let prior = layout.curve_prior(&h).unwrap();
    let rows = linear.y.nrows();
    let mut s = Mat::from_fn(rows, rows, |i, j| {
        let column = |(k, group)| {
            let k: usize = k;
            linear.a[(i, k)] * prior_variance(group, &h) * linear.a[(j, k)]
        };
        groups.iter().copied().enumerate().map(column).sum::<f64>()
    });
    for i in 0..rows {
        for j in 0..rows {
            for c in 0..6 {
                let (q, other) = (samples[i / ROWS].joints[c], samples[j / ROWS].joints[c]);
                let jacobians = linear.jacobian[(i, c)] * linear.jacobian[(j, c)];
                for k in 1..=MAX_CURVE_ORDER {
                    let (x, y) = (k as f64 * q, k as f64 * other);
                    let waves = libm::sin(x) * libm::sin(y) + libm::cos(x) * libm::cos(y);
                    let variance = prior.amplitude * prior.spectrum.variance[k - 1];
                    s[(i, j)] += DEFLECTION_UNIT.powi(2) * variance * jacobians * waves;
                }
            }
        }
        s[(i, i)] += libm::exp(h[usize::from(i % ROWS >= 3)]);
    }
    let alpha = s.cholesky().unwrap().solve(&linear.y);
    let largest = (0..rows).map(|i| alpha[(i, 0)].abs()).fold(0.0, f64::max);
    for i in 0..rows {
        let error = (solved.alpha[(i, 0)] - alpha[(i, 0)]).abs();
        assert!(error < 1e-9 * largest, "{i}: {error:e} of {largest:e}");
    }
}

#[test]
fn the_gradient_is_that_of_differences() {
    let curves = Curves::draw(6, 20, 3e-4, &mut ChaCha8Rng::seed_from_u64(1));
    let (state, samples) = state(&curves, 10);
    for processes in [false, true] {
        let layout = LAYOUT;
        let (h, _) = layout.start_and_bounds(1.0);
        with_likelihood(&state, &samples, (layout, processes), |likelihood| {
            let (_, gradient) = likelihood.value_and_gradient(&h);
            for i in 0..h.len() {
                let at = |step: f64| {
                    let mut h = h.clone();
                    h[i] += step;
                    likelihood.value_and_gradient(&h).0
                };
                let difference = (at(1e-4) - at(-1e-4)) / 2e-4;
                let error = (gradient[i] - difference).abs();
                let largest = 1e-5 * (1.0 + difference.abs());
                assert!(error < largest, "{i}: {} {difference}", gradient[i]);
            }
        });
    }
}

/// Returns the mean error in mm at `test` of a fit to `train`, whether the fit has a curve, and the cycles per turn of its
/// ripple.
fn found(
    train: &[InstrumentSample],
    test: &[InstrumentSample],
    curve: bool,
) -> (f64, bool, Vec<f64>) {
    let found = calibrated(&robot(), train, &config(curve));
    let report = &found.calibration.correction.elastic().unwrap().report;
    let mean = ErrorSummary::new(&found.blob.errors(test)).position_mm.mean;
    let ripple = report.ripple.iter().map(|line| line.1).collect();
    (mean, report.curve.is_some(), ripple)
}

/// Joints err by 300 µrad as a function of their own angle, in orders that no smooth process follows. The fit finds the curve
/// and gains by it, and takes no part of it for ripple. From 120 poses a model without a curve may explain the same orders
/// as ripple, so there the test bounds the error itself.
#[test]
fn a_curve_is_found_where_there_is_one() {
    for (count, largest_share, largest_mm) in [(60, 0.6, 0.06), (120, 1.0, 0.042)] {
        let mut sums = (0.0, 0.0);
        for seed in 0..4 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let curves = Curves::draw(6, 18, 3e-4, &mut random);
            let test = measured(&curves, 100, &mut random, anywhere);
            let train = measured(&curves, count, &mut random, anywhere);
            let (with, is_found, ripple) = found(&train, &test, true);
            let (without, _, _) = found(&train, &test, false);
            println!(
                "{count} poses: {with:.4} mm with a curve, {without:.4} without, ripple {ripple:?}"
            );
            assert!(is_found && ripple.is_empty(), "{is_found} {ripple:?}");
            assert!(with <= 1.03 * without, "{with} {without}");
            sums.0 += with;
            sums.1 += without;
        }
        assert!(sums.0 < largest_share * sums.1, "{sums:?}");
        assert!(sums.0 / 4.0 < largest_mm, "{sums:?}");
    }
}

/// An arm whose joints have no curves gets none: its blob equals, byte for byte, that of a fit that may not have a curve.
#[test]
fn no_curve_is_found_where_there_is_none() {
    let nothing = Curves {
        orders: vec![Vec::new(); 6],
    };
    for (seed, count) in [(1, 30), (2, 60), (3, 120)] {
        let train = measured(
            &nothing,
            count,
            &mut ChaCha8Rng::seed_from_u64(seed),
            anywhere,
        );
        let bytes = |curve| {
            let found = calibrated(&robot(), &train, &config(curve));
            found.blob.bytes().to_vec()
        };
        assert_eq!(bytes(true), bytes(false), "{count} poses");
    }
}

/// At angles that were never measured the curve is unknown: the stated standard deviation grows there, and it covers the
/// errors.
#[test]
fn the_standard_deviation_knows_the_gaps() {
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let curves = Curves::draw(6, 15, 4e-4, &mut random);
    // Joint 2 avoids 0.3 to 0.8 rad.
    let around = |c: usize, random: &mut ChaCha8Rng| loop {
        let q = random.random_range(-1.5..1.5);
        if c != 1 || !(0.3..0.8).contains(&q) {
            return q;
        }
    };
    let within = |c: usize, random: &mut ChaCha8Rng| match c {
        1 => random.random_range(0.4..0.7),
        _ => random.random_range(-1.5..1.5),
    };
    let train = measured(&curves, 250, &mut random, around);
    let found = calibrated(&robot(), &train, &config(true));
    let judged = |test: &[InstrumentSample]| {
        let errors = found.blob.errors(test);
        let mut squares = (0.0, 0.0);
        for (sample, error) in test.iter().zip(&errors) {
            let sigma = found.calibration.standard_deviation(sample).unwrap();
            let variance: f64 = sigma[..3].iter().map(|s| s * s).sum();
            squares.0 += error.position_mm.powi(2) / (1e6 * variance);
            squares.1 += variance;
        }
        let n = test.len() as f64;
        ((squares.0 / n).sqrt(), 1e3 * (squares.1 / n).sqrt())
    };
    let (outside, usual) = judged(&measured(&curves, 150, &mut random, around));
    let (inside, gap) = judged(&measured(&curves, 150, &mut random, within));
    println!("outside: {outside:.2} of {usual:.4} mm; in the gap: {inside:.2} of {gap:.4} mm");
    assert!(gap > 1.5 * usual, "{gap} {usual}");
    assert!((0.75..1.3).contains(&outside), "{outside}");
    assert!((0.6..1.4).contains(&inside), "{inside}");
}

/// On a grid of 34 values a turn, 3 cycles cannot be distinguished from 37 or 377. A frequency with such an alias is not
/// fitted as ripple. With joints anywhere, it is.
#[test]
fn a_line_on_a_grid_is_no_ripple() {
    let line = |cycles: usize| {
        let mut orders = vec![vec![[0.0; 2]; cycles]; 6];
        for joint in &mut orders {
            joint[cycles - 1] = [1.5e-4, 1e-4];
        }
        Curves { orders }
    };
    let step = std::f64::consts::TAU / 34.0;
    let grid =
        move |_: usize, random: &mut ChaCha8Rng| step * f64::from(random.random_range(-8..=8_i32));
    let mut random = ChaCha8Rng::seed_from_u64(12);
    for cycles in [80, 111] {
        let on_grid = measured(&line(cycles), 150, &mut random, grid);
        let (_, _, ripple) = found(&on_grid, &on_grid, true);
        assert!(ripple.is_empty(), "{cycles} cycles on a grid: {ripple:?}");
        // Without a curve, which could explain an alias, the report names the frequency as ambiguous.
        let plain = calibrated(&robot(), &on_grid, &config(false)).calibration;
        let unclear = &plain.correction.elastic().unwrap().report.ambiguous;
        assert!(unclear.len() >= 4, "{cycles} cycles: {unclear:?}");
        for k in unclear.iter().flat_map(|line| [line.cycles, line.alias]) {
            let is_alias = |sign: f64| {
                let turns = (k + sign * cycles as f64) / 34.0;
                (turns - turns.round()).abs() < 1.0 / 34.0
            };
            assert!(is_alias(1.0) || is_alias(-1.0), "{cycles} cycles: {k}");
        }
        let anywhere_measured = measured(&line(cycles), 150, &mut random, anywhere);
        let (_, _, ripple) = found(&anywhere_measured, &anywhere_measured, true);
        let right = ripple.iter().filter(|k| (**k - cycles as f64).abs() < 0.2);
        assert_eq!(right.count(), 6, "{cycles} cycles anywhere: {ripple:?}");
        assert!(ripple.len() <= 6, "{ripple:?}");
    }
}
