//! Solves for the weights of a few kernel functions together with all parameters, from any number of measurements.
//!
//! The objective is |y − A x − Σ_c J_c (Φ_c κ_c + K_c β_c)|² with priors x ~ N(0, Λ), β_c ~ N(0, K_c⁻¹) (subset of
//! regressors) and, where there are more measurements than in the dense solution, κ_c ~ N(0, a² v_k) for the own-joint
//! curves. The normal equations are accumulated block by block, so that memory does not grow with the number of
//! measurements.

use poegp_protocol::JointKind;
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::kinematics::poe::JointTrig;

use crate::identification::parametric::state::{
    Linearised, MAX_LINEARISATION_ERROR, MAX_STEPS, ROWS, prior_variance,
};
use crate::learning::elastic::hyperparameters::DEFLECTION_UNIT;
use crate::learning::elastic::inputs::{ClusteredInput, Inputs, kernel};
use crate::learning::elastic::own_joint_curve::wave;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::sample::BaseSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::{Mat, columns_mut};
use crate::numeric::product::{Become, Operand, multiply, multiply_lower};

/// Number of poses in a block.
const BLOCK: usize = 100;
/// Jitter: shares of an inducing point's own variance that are added to it until the equations can be factored and single
/// precision holds their solution. Chosen points may be near neighbours in one joint's kernel, which then has large
/// weights that almost cancel.
const JITTER: [f64; 9] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0];
/// Largest position error that single precision may cause in the processes, in m, as estimated by
/// [`Equations::rounding`]. The blob as a whole may lose 2 µm at most and 0.5 µm on average, of which the chain takes a
/// part.
const MAX_ROUNDING_M: f64 = 0.8e-6;

/// Solved weights of the inducing points.
pub struct Solution {
    /// Weight of each inducing point, on the device's scale.
    pub weights: Vec<f64>,
    /// RMS displacement of the target over the measurements, in m, caused by the smaller weights that single precision
    /// needs; `None` where single precision holds the weights as they are.
    pub single_precision_cost: Option<f64>,
}

/// Solves for the weights of `functions`, sorted by joint, together with all parameters, which change in `fit`. Repeats
/// the Gauss–Newton step until its linearisation error is small. Returns `None` when the equations cannot be solved.
pub fn solve(
    fit: &mut ElasticFit,
    samples: &[BaseSample],
    kernels: &[JointKernel<f64>],
    functions: &[ClusteredInput],
) -> Option<Solution> {
    let is_larger = samples.len() > fit.inputs.payloads.len();
    let inputs = match is_larger {
        true => Inputs::new(&fit.state, samples),
        false => fit.inputs.clone(),
    };
    let joints = fit.inputs.kinds.len();
    let orders = match is_larger {
        true => fit.state.curves.len() / (2 * joints),
        false => 0,
    };
    if orders > 0 {
        fit.state.curves.clear();
    }
    let (mut steps, mut level) = (0, 0);
    loop {
        let linear = fit.state.linearise(samples, fit.scales);
        let equations = Equations {
            fit,
            linear: &linear,
            inputs: &inputs,
            kernels,
            functions,
            curves: curve_columns(fit, orders),
        };
        let found = equations.solve(level)?;
        level = found.level;
        let error = fit
            .state
            .step(&found.parameters, &linear, samples, fit.scales);
        steps += 1;
        if error < MAX_LINEARISATION_ERROR || steps == MAX_STEPS {
            if orders > 0 {
                fit.state.curves = found.curves;
            }
            return Some(Solution {
                weights: found.weights,
                single_precision_cost: found.single_precision_cost,
            });
        }
    }
}

/// Returns, for every column of the own-joint curves, its joint, its index within the joint (both from 0) and its prior
/// standard deviation in rad.
fn curve_columns(fit: &ElasticFit, orders: usize) -> Vec<(usize, usize, f64)> {
    let Some(prior) = fit.layout.curve_prior(&fit.hyperparameters) else {
        return Vec::new();
    };
    let column = |c: usize, k: usize| {
        let variance = prior.amplitude * prior.spectrum.variance[k / 2];
        let is_there = fit.inputs.kinds[c] == JointKind::Revolute;
        let sd = if is_there { variance.sqrt() } else { 0.0 };
        (c, k, DEFLECTION_UNIT * sd)
    };
    (0..fit.inputs.kinds.len())
        .flat_map(|c| (0..2 * orders).map(move |k| (c, k)))
        .map(|(c, k)| column(c, k))
        .collect()
}

/// Solution of the equations at one state.
struct Step {
    parameters: Vec<f64>,
    curves: Vec<f64>,
    weights: Vec<f64>,
    /// Index of the jitter that was needed.
    level: usize,
    single_precision_cost: Option<f64>,
}

/// The equations at one state.
struct Equations<'a> {
    fit: &'a ElasticFit,
    linear: &'a Linearised,
    inputs: &'a Inputs,
    kernels: &'a [JointKernel<f64>],
    functions: &'a [ClusteredInput],
    curves: Vec<(usize, usize, f64)>,
}

impl Equations<'_> {
    /// Returns the kernel k_c in squared units of the processes.
    fn between(&self, c: usize, a: (&JointTrig<f64>, f64), b: (&JointTrig<f64>, f64)) -> f64 {
        let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
        kernel(&self.kernels[c], &self.fit.inputs.kinds, a, b) / unit
    }

    /// Solves for parameters, own-joint curves and weights, with the jitter of `level` or the least above it that
    /// suffices.
    fn solve(&self, level: usize) -> Option<Step> {
        let groups = self.fit.state.layout.groups();
        let sd: Vec<f64> = groups
            .iter()
            .map(|group| prior_variance(*group, &self.fit.hyperparameters).sqrt())
            .collect();
        let (p, before) = (sd.len(), sd.len() + self.curves.len());
        let (mut normal, right) = self.gathered(&sd);
        for i in 0..before {
            normal[(i, i)] += 1.0;
        }
        for (i, (c, (features, payload))) in self.functions.iter().enumerate() {
            for (j, (other, (other_features, mass))) in self.functions[..=i].iter().enumerate() {
                if c == other {
                    let between = self.between(*c, (features, *payload), (other_features, *mass));
                    normal[(before + i, before + j)] += between;
                }
            }
        }
        let solved = |jitter: f64| {
            let mut matrix = normal.clone();
            for (i, (c, (features, payload))) in self.functions.iter().enumerate() {
                let own = self.between(*c, (features, *payload), (features, *payload));
                matrix[(before + i, before + i)] += jitter * own;
            }
            let solution = Factor::new(matrix, 1).ok()?.solve(&right);
            let finite = (0..solution.nrows()).all(|i| solution[(i, 0)].is_finite());
            finite.then_some(solution)
        };
        // The kernel is in rad² on the device and in units of the processes here; deflections come in those units, too.
        let of_device = |solution: &Mat<f64>| -> Vec<f64> {
            let weights = (before..solution.nrows()).map(|i| solution[(i, 0)] / DEFLECTION_UNIT);
            weights.collect()
        };
        let parameters = |solution: &Mat<f64>| -> Vec<f64> {
            (0..p).map(|i| sd[i] * solution[(i, 0)]).collect()
        };
        let mut first: Option<(Vec<f64>, Vec<f64>)> = None;
        let mut found: Option<(usize, Mat<f64>)> = None;
        for (index, jitter) in JITTER.iter().enumerate().skip(level) {
            let Some(solution) = solved(*jitter) else {
                continue;
            };
            let weights = of_device(&solution);
            let is_held = self.rounding(&weights) <= MAX_ROUNDING_M;
            if !is_held {
                first.get_or_insert((parameters(&solution), weights));
            }
            found = Some((index, solution));
            if is_held {
                break;
            }
        }
        let (level, solution) = found?;
        let (parameters, weights) = (parameters(&solution), of_device(&solution));
        let curves = self.curves.iter().enumerate();
        let curves = curves.map(|(i, column)| column.2 * solution[(p + i, 0)]);
        Some(Step {
            curves: curves.collect(),
            single_precision_cost: first
                .map(|(x, w)| self.moved((&x, &parameters), (&w, &weights))),
            parameters,
            weights,
            level,
        })
    }

    /// Calls `part` with every measurement, joint and contribution of an inducing point to the deflection there, in rad
    /// or m.
    fn parts(&self, weights: &[f64], mut part: impl FnMut(usize, usize, f64)) {
        let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
        for (k, (features, payload)) in self
            .inputs
            .features
            .iter()
            .zip(&self.inputs.payloads)
            .enumerate()
        {
            for ((c, (centre, other)), weight) in self.functions.iter().zip(weights) {
                let between = self.between(*c, (features, *payload), (centre, *other));
                part(k, *c, unit * weight * between);
            }
        }
    }

    /// Returns how far joint `c` moves the target at measurement `k`, in m/rad or m/m.
    fn lever(&self, k: usize, c: usize) -> f64 {
        let squares = (0..3).map(|i| self.linear.jacobian[(ROWS * k + i, c)].powi(2));
        self.fit.scales.position * squares.sum::<f64>().sqrt()
    }

    /// Estimates the position error by single precision with these weights at the worst measurement, in m. Every
    /// contribution is off by a rounding of itself and of its exponent, and these errors add up as independent ones.
    fn rounding(&self, weights: &[f64]) -> f64 {
        let joints = self.kernels.len();
        let mut squares = vec![0.0; joints * self.inputs.payloads.len()];
        self.parts(weights, |k, c, part| squares[k * joints + c] += part * part);
        let exponents: Vec<f64> = self
            .kernels
            .iter()
            .map(|kernel| 1.0 + kernel.rates().iter().sum::<f64>())
            .collect();
        let epsilon = f64::from(f32::EPSILON);
        let of_pose = |k: usize| {
            let of_joint = |c: usize| {
                let off = epsilon * exponents[c] * self.lever(k, c);
                off * off * squares[k * joints + c]
            };
            (0..joints).map(of_joint).sum::<f64>().sqrt()
        };
        (0..self.inputs.payloads.len())
            .map(of_pose)
            .fold(0.0, f64::max)
    }

    /// Returns by how much two solutions, pairs of parameters and weights, differ at the target: RMS over the
    /// measurements, in m.
    fn moved(&self, parameters: (&[f64], &[f64]), weights: (&[f64], &[f64])) -> f64 {
        let joints = self.kernels.len();
        let difference = |(a, b): (&[f64], &[f64])| -> Vec<f64> {
            a.iter().zip(b).map(|(a, b)| a - b).collect()
        };
        let (parameters, differences) = (difference(parameters), difference(weights));
        let mut sums = vec![0.0; joints * self.inputs.payloads.len()];
        self.parts(&differences, |k, c, part| sums[k * joints + c] += part);
        let count = self.inputs.payloads.len();
        let of_pose = |k: usize| {
            let along = |i: usize| {
                let row = ROWS * k + i;
                let joints =
                    (0..joints).map(|c| self.linear.jacobian[(row, c)] * sums[k * joints + c]);
                let parameters = parameters
                    .iter()
                    .enumerate()
                    .map(|(j, x)| self.linear.a[(row, j)] * x);
                joints.chain(parameters).sum::<f64>().powi(2)
            };
            (0..3).map(along).sum::<f64>()
        };
        let square = (0..count).map(of_pose).sum::<f64>() / count as f64;
        self.fit.scales.position * square.sqrt()
    }

    /// Accumulates Dᵀ D (lower triangle) and Dᵀ y of the whitened design matrix D.
    fn gathered(&self, sd: &[f64]) -> (Mat<f64>, Mat<f64>) {
        let linear = self.linear;
        let (p, before) = (sd.len(), sd.len() + self.curves.len());
        let columns = before + self.functions.len();
        let mut normal = Mat::zeros(columns, columns);
        let mut right = Mat::zeros(columns, 1);
        let poses: Vec<usize> = (0..self.inputs.payloads.len()).collect();
        for block in poses.chunks(BLOCK) {
            let first = ROWS * block[0];
            let rows = ROWS * block.len();
            let weight: Vec<f64> = (first..first + rows)
                .map(|row| {
                    let h = self.fit.hyperparameters[usize::from(row % ROWS >= 3)];
                    libm::exp(-0.5 * h) / linear.relative_noise(row, h)
                })
                .collect();
            let mut design = Mat::zeros(rows, columns);
            for (i, sd) in sd.iter().enumerate() {
                for row in 0..rows {
                    design[(row, i)] = weight[row] * sd * linear.a[(first + row, i)];
                }
            }
            for (at, k) in block.iter().enumerate() {
                let (features, payload) = (&self.inputs.features[*k], self.inputs.payloads[*k]);
                let mut put = |column: usize, joint: usize, value: f64| {
                    for row in ROWS * at..ROWS * (at + 1) {
                        let moved = linear.jacobian[(first + row, joint)];
                        design[(row, column)] = weight[row] * moved * value;
                    }
                };
                let mut waves = None;
                for (i, (c, order, sd)) in self.curves.iter().enumerate() {
                    if *order == 0 {
                        waves = Some(wave(features[*c]));
                    }
                    let value = waves.as_ref().map_or(0.0, |waves| waves[*order]);
                    put(p + i, *c, sd * value);
                }
                for (j, (c, (centre, other))) in self.functions.iter().enumerate() {
                    let between = self.between(*c, (features, payload), (centre, *other));
                    put(before + j, *c, DEFLECTION_UNIT * between);
                }
            }
            let y = Mat::from_fn(rows, 1, |row, _| weight[row] * linear.y[(first + row, 0)]);
            let design = Operand::from(&design);
            let across = design.clone().transposed();
            let mut normal = columns_mut(&mut normal);
            multiply_lower(&mut normal, Become::Sum, &across, &design);
            let mut right = columns_mut(&mut right);
            multiply(&mut right, Become::Sum, &across, &Operand::from(&y));
        }
        (normal, right)
    }
}
