//! The benefit of a calibration by touches over the work volume: expected position errors before and after.
//!
//! Touches cannot see the base frame, and the tip is known only as well as it was touched. Errors are therefore those
//! that remain after base (6) and tip (3) are registered over the volume. Stated errors are parameters ⊕ τ: the share of
//! gears that no parameter describes is no noise of the parameters.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::{Pose, skew};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use crate::identification::touch::beyond::Stated;
use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Sample};
use crate::measurement::touch::Reading;
use crate::numeric::cholesky::Factor;
use crate::numeric::halton::halton;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::{Summary, extremes};
use crate::robot::Robot;

/// Number of poses in the volume.
const POSES: u32 = 300;
/// Gauss–Hermite nodes for the scale of the class: standard deviations from the most probable scale, and weights.
const NODES: [(f64, f64); 3] = [
    (0.0, 2.0 / 3.0),
    (-1.732_050_807_568_877_2, 1.0 / 6.0),
    (1.732_050_807_568_877_2, 1.0 / 6.0),
];
/// Number of parameter draws for each scale.
const DRAWS: usize = 400;
/// Number of registered parameters: base 6, tip 3.
const GAUGE: usize = 9;
/// Assumed range of a revolute joint without limits, to both sides, in rad.
const WITHOUT_LIMITS: f64 = std::f64::consts::FRAC_PI_2;

/// Poses at which the arm works.
#[derive(Clone, Debug)]
pub struct WorkVolume {
    /// States of the arm with the first tip.
    pub states: Vec<BaseSample>,
}

impl WorkVolume {
    /// Draws poses from the middle half of the joint ranges, extended to all that was touched.
    pub fn new(robot: &Robot, problem: &TouchProblem) -> Self {
        let range = |joint: usize| {
            let (lower, upper) = extremes(problem.states.iter().map(|s| s.joints[joint]));
            let of = &robot.joints[joint];
            match (of.limits, of.kind) {
                (Some((least, most)), _) => {
                    let (middle, quarter) = (0.5 * (least + most), 0.25 * (most - least));
                    (lower.min(middle - quarter), upper.max(middle + quarter))
                }
                (None, JointKind::Revolute) => {
                    (lower.min(-WITHOUT_LIMITS), upper.max(WITHOUT_LIMITS))
                }
                (None, JointKind::Prismatic) => (lower, upper),
            }
        };
        let ranges: Vec<(f64, f64)> = (0..robot.joints.len()).map(range).collect();
        let poses = (1..=POSES).map(|index| {
            let of = |(i, (lower, upper)): (usize, &(f64, f64))| {
                lower + (upper - lower) * halton(index, i)
            };
            ranges.iter().enumerate().map(of).collect()
        });
        Self::of(robot, poses, problem.states[0].payload_kg)
    }

    /// Creates a work volume from given joints, in rad or m.
    pub fn of(
        robot: &Robot,
        joints: impl Iterator<Item = Vec<f64>>,
        payload_kg: Option<f64>,
    ) -> Self {
        let state = |joints: Vec<f64>| {
            let unseen = Observation::Pose(Pose::identity());
            let mut sample =
                Sample::new(joints.clone(), robot.serial_joints(&joints), unseen, Base);
            sample.payload_kg = payload_kg;
            sample
        };
        Self {
            states: joints.map(state).collect(),
        }
    }
}

/// Expected position errors, in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expected {
    /// Mean error over the volume.
    pub mean_mm: f64,
    /// Error that 95 % of the errors do not exceed.
    pub p95_mm: f64,
}

/// Position error that 95 of 100 poses of the volume do not exceed, in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exceeded {
    /// Mean of that error over the posterior of the arm.
    pub error_mm: f64,
    /// Standard deviation of that error.
    pub standard_uncertainty_mm: f64,
    /// Number of poses in the volume.
    pub poses: usize,
}

/// What a fit knows of the arm over a work volume.
pub struct Knowledge {
    /// Displacements at the poses of the volume by the arm's parameters in units of their priors, after removal of what
    /// base and tip take up: three rows for each pose, in m.
    pub field: Mat<f64>,
    /// Standard deviations of the parameters before the touches, the units of `field`; wider than the fit's where the arm
    /// is beyond its class.
    pub priors: Vec<f64>,
    /// Covariance of the parameters in units of `priors`.
    pub covariance: Mat<f64>,
    /// How many times farther from its nominal model the arm is than its class.
    pub beyond_class: Option<f64>,
    /// Stated τ of a position, in m.
    pub tau: f64,
    /// Expected errors of the nominal arm, judged by the touches.
    pub before: Expected,
    /// Expected errors of the arm as calibrated.
    pub after: Expected,
    /// Error that 95 of 100 poses do not exceed as calibrated.
    pub exceeded: Exceeded,
    /// Probability that the mean error over the volume is larger as calibrated than nominal.
    pub worse: f64,
}

impl Knowledge {
    /// Computes what a fit knows over the volume; `None` when its equations cannot be solved.
    pub fn new(problem: &TouchProblem, fit: &TouchFit, volume: &WorkVolume) -> Option<Self> {
        let stated = fit.as_stated(problem, 0.0)?;
        let tau = stated_tau(problem, fit);
        let field = field(fit, &volume.states, &stated.priors);
        let found = pairs(fit, &stated, &field, tau)?;
        let (before, after) = (found.before, found.after);
        let mut probability = NODES[0].1 * found.worse;
        let mut moments = found.moments.map(|x| NODES[0].1 * x);
        for (deviations, weight) in &NODES[1..] {
            let other = fit.as_stated(problem, *deviations)?;
            let ratio = |j: usize| match stated.priors[j] {
                sd if sd > 0.0 => other.priors[j] / sd,
                _ => 0.0,
            };
            let (rows, columns) = field.shape();
            let scaled = Mat::from_fn(rows, columns, |i, j| field[(i, j)] * ratio(j));
            let found = pairs(fit, &other, &scaled, tau)?;
            probability += weight * found.worse;
            for (sum, x) in moments.iter_mut().zip(found.moments) {
                *sum += weight * x;
            }
        }
        let [mean, square] = moments;
        Some(Self {
            before,
            after,
            exceeded: Exceeded {
                error_mm: mean,
                standard_uncertainty_mm: (square - mean * mean).max(0.0).sqrt(),
                poses: volume.states.len(),
            },
            worse: probability,
            tau,
            beyond_class: stated.beyond_class,
            covariance: stated.covariance,
            priors: stated.priors,
            field,
        })
    }

    /// Returns the standard deviations of the position along the base axes at every pose of the volume, in m.
    pub fn deviations(&self) -> Vec<Vector3<f64>> {
        let spread = product(&self.field, &self.covariance);
        let variance = |row: usize| -> f64 {
            (0..self.field.ncols())
                .map(|j| spread[(row, j)] * self.field[(row, j)])
                .sum()
        };
        let poses = self.field.nrows() / 3;
        let of = |k: usize| {
            Vector3::from_fn(|i, _| (variance(3 * k + i).max(0.0) + self.tau * self.tau).sqrt())
        };
        (0..poses).map(of).collect()
    }
}

/// Expected errors for one scale of the class.
struct Pairs {
    before: Expected,
    after: Expected,
    /// Probability that the mean error of `after` is larger.
    worse: f64,
    /// Means of the calibrated arm's 95 % error and of its square.
    moments: [f64; 2],
}

/// Computes the expected errors, nominal and calibrated; `None` when the covariance cannot be factored.
fn pairs(fit: &TouchFit, stated: &Stated, field: &Mat<f64>, tau: f64) -> Option<Pairs> {
    let off = fit.arm.theta.iter().zip(&stated.priors).zip(&stated.mean);
    let nominal: Vec<f64> = off
        .map(|((x, sd), mean)| if *sd > 0.0 { x / sd + mean } else { 0.0 })
        .collect();
    let mut regular = stated.covariance.clone();
    for i in 0..regular.nrows() {
        regular[(i, i)] += 1e-12;
    }
    let lower = Factor::new(regular, 1).ok()?.lower();
    let (before, as_nominal) = expected(field, &nominal, &lower, tau);
    let (after, as_calibrated) = expected(field, &stated.mean, &lower, tau);
    let both = as_calibrated.iter().zip(&as_nominal);
    let worse = both.filter(|((a, _), (b, _))| a > b).count() as f64 / DRAWS as f64;
    let mean = |of: fn(f64) -> f64| {
        let all = as_calibrated.iter().map(|(_, p95)| of(*p95));
        all.sum::<f64>() / DRAWS as f64
    };
    Some(Pairs {
        before,
        after,
        worse,
        moments: [mean(|x| x), mean(|x| x * x)],
    })
}

/// Computes the displacements over the volume by the parameters, with base and tip registered.
fn field(fit: &TouchFit, states: &[BaseSample], priors: &[f64]) -> Mat<f64> {
    let jets = fit.arm.linearise(states);
    let mut field = Mat::zeros(3 * jets.len(), priors.len());
    for (k, jet) in jets.iter().enumerate() {
        for i in 0..3 {
            for (j, sd) in priors.iter().enumerate() {
                field[(3 * k + i, j)] = jet.jacobian[(i, j)] * sd;
            }
        }
    }
    let poses: Vec<Pose<f64>> = jets.iter().map(|jet| jet.pose).collect();
    let basis = registered(&poses);
    let taken = product(Transposed(&basis), &field);
    field -= product(&basis, &taken);
    field
}

/// Returns orthonormal columns that span the displacements at `poses` that base and tip take up: three rows for each
/// pose.
pub fn registered(poses: &[Pose<f64>]) -> Mat<f64> {
    let mut gauge = Mat::zeros(3 * poses.len(), GAUGE);
    let middle = poses.iter().map(|p| p.translation).sum::<Vector3<f64>>() / poses.len() as f64;
    for (k, pose) in poses.iter().enumerate() {
        let turn = -skew(&(pose.translation - middle));
        for i in 0..3 {
            gauge[(3 * k + i, i)] = 1.0;
            for c in 0..3 {
                gauge[(3 * k + i, 3 + c)] = turn[(i, c)];
                gauge[(3 * k + i, 6 + c)] = pose.rotation[(i, c)];
            }
        }
    }
    gauge.qr().q()
}

/// Returns τ of a position, enlarged by its uncertainty: the standard error of a variance estimated from so many rows. What
/// no parameter describes is alike where the tip is at the same place, so the touches of a socket count as one.
fn stated_tau(problem: &TouchProblem, fit: &TouchFit) -> f64 {
    let rows = || problem.set.rows.iter().zip(&fit.weights);
    let used = || rows().filter(|(_, weight)| **weight > 0.0);
    let sockets: BTreeSet<usize> = used()
        .filter(|(row, _)| matches!(row.reading, Reading::Point { .. }))
        .filter_map(|(row, _)| row.reading.feature())
        .collect();
    let (mut sum, mut count) = (0.0, 0.0);
    for (row, _) in used() {
        let kind = Noise::of(&row.reading, 0);
        if !kind.is_length() {
            continue;
        }
        let equations = row.reading.equations().min(3) as f64;
        let sigma = problem.set.sigma(row).unwrap_or(0.0);
        let tau = fit.tau[kind as usize].powi(2);
        let freedom = match kind {
            Noise::Point => fit.freedom[kind as usize].min(sockets.len() as f64),
            _ => fit.freedom[kind as usize],
        };
        let error = (sigma * sigma + tau) * (2.0 / (1.0 + freedom)).sqrt();
        sum += equations * (tau + error);
        count += equations;
    }
    for motions in problem.joint_motions.iter().flatten() {
        // The mean square of three components of the position.
        let lever = motions.rows(0, 3).norm_squared();
        sum += fit.joint_scatter.powi(2) * lever;
        count += 3.0;
    }
    if count > 0.0 {
        (sum / count).sqrt()
    } else {
        Noise::Point.usual()
    }
}

/// Draws parameters with mean `mean` and covariance L Lᵀ. Returns their errors over the volume, and for each draw the
/// mean error and the error that 95 of 100 poses do not exceed, in mm.
fn expected(
    field: &Mat<f64>,
    mean: &[f64],
    lower: &Mat<f64>,
    tau: f64,
) -> (Expected, Vec<(f64, f64)>) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let drawn = Mat::from_fn(field.ncols(), DRAWS, |_, _| normal());
    let mut parameters = product(lower, &drawn);
    for mut draw in parameters.column_iter_mut() {
        for (x, mean) in draw.iter_mut().zip(mean) {
            *x += mean;
        }
    }
    let errors = product(field, &parameters);
    let mut norms = Vec::with_capacity(errors.len() / 3);
    let mut each = Vec::with_capacity(DRAWS);
    for draw in 0..DRAWS {
        let first = norms.len();
        for k in 0..errors.nrows() / 3 {
            let error = Vector3::from_fn(|i, _| errors[(3 * k + i, draw)] + tau * normal());
            norms.push(1e3 * error.norm());
        }
        let own = Summary::new(&norms[first..]);
        each.push((own.mean, own.p95));
    }
    let summary = Summary::new(&norms);
    let expected = Expected {
        mean_mm: summary.mean,
        p95_mm: summary.p95,
    };
    (expected, each)
}
