//! The weights of few functions and all parameters with them, from any number of measurements.
//!
//! min |y − A x − Σ_c J_c (Φ_c κ_c + K_c β_c)|² with priors x ~ N(0, Λ), β_c ~ N(0, K_c⁻¹) (subset of regressors) and, where
//! there are more measurements than the dense solution saw, κ_c ~ N(0, a² v_k), the own-joint curves. The normal equations
//! are gathered block by block: memory does not grow with the measurements.

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, Par, Side};
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

/// Poses of one block.
const BLOCK: usize = 100;
/// Shares of a function's own variance that are added to it until the equations can be factored: chosen points may be near
/// neighbours in one joint's kernel, and a kernel may be so smooth that few of them are different in double precision.
const JITTER: [f64; 6] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3];

/// The weights of `functions`, sorted by joint, together with all parameters, which move in `fit`. Repeats the
/// Gauss-Newton step until its linearisation error is small.
pub(super) fn solve(
    fit: &mut ElasticFit,
    samples: &[BaseSample],
    kernels: &[JointKernel<f64>],
    functions: &[ClusteredInput],
) -> Option<Vec<f64>> {
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
    let mut steps = 0;
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
        let (parameters, curves, weights) = equations.solve()?;
        let error = fit.state.step(&parameters, &linear, samples, fit.scales);
        steps += 1;
        if error < MAX_LINEARISATION_ERROR || steps == MAX_STEPS {
            if orders > 0 {
                fit.state.curves = curves;
            }
            return Some(weights);
        }
    }
}

/// Joint and order from 0 of every column of the own-joint curves, and the column's prior standard deviation in rad.
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
    /// k_c in units of the processes.
    fn between(&self, c: usize, a: (&JointTrig<f64>, f64), b: (&JointTrig<f64>, f64)) -> f64 {
        let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
        kernel(&self.kernels[c], &self.fit.inputs.kinds, a, b) / unit
    }

    /// Parameters, own-joint curves and weights.
    fn solve(&self) -> Option<(Vec<f64>, Vec<f64>, Vec<f64>)> {
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
        let solution = JITTER.iter().find_map(|jitter| {
            let mut matrix = normal.clone();
            for (i, (c, (features, payload))) in self.functions.iter().enumerate() {
                let own = self.between(*c, (features, *payload), (features, *payload));
                matrix[(before + i, before + i)] += jitter * own;
            }
            let solution = matrix.llt(Side::Lower).ok()?.solve(&right);
            let finite = (0..solution.nrows()).all(|i| solution[(i, 0)].is_finite());
            finite.then_some(solution)
        })?;
        let parameters = (0..p).map(|i| sd[i] * solution[(i, 0)]).collect();
        let curves = self.curves.iter().enumerate();
        let curves = curves.map(|(i, column)| column.2 * solution[(p + i, 0)]);
        // k is in rad² on the device, in units of the processes here; deflections come in those units, too.
        let weights = (before..solution.nrows()).map(|i| solution[(i, 0)] / DEFLECTION_UNIT);
        Some((parameters, curves.collect(), weights.collect()))
    }

    /// Dᵀ D (lower triangle) and Dᵀ y of the whitened design D.
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
                    (-0.5 * h).exp() / linear.relative_noise(row, h)
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
            matmul(
                normal.as_mut(),
                BlockStructure::TriangularLower,
                Accum::Add,
                design.transpose(),
                BlockStructure::Rectangular,
                design.as_ref(),
                BlockStructure::Rectangular,
                1.0,
                Par::Seq,
            );
            right += design.transpose() * &y;
        }
        (normal, right)
    }
}
