//! The standard deviation that fits on the device: landmarks, and what makes it that of the trainer.
//!
//! The formula is the runtime's (`deflection::PositionVariance`). Here its numbers are found:
//!
//! - landmarks among the training poses, each the one that explains most of what the ones before leave;
//! - ν, the noise of one pose as information about a process, and the floor, so that the variance of every training pose when it is left out
//!   is that of the exact posterior (`outliers::leave_one_out`), inflation included, in least relative squares.
//!
//! The gain is not fitted: far from all data the variance must be the prior's. With the gain free (and u instead of u²) poses
//! left out were met no better, and the device said half of what the trainer did far away.
//!
//! The share that the other poses leave unexplained at pose k: with K = C Cᵀ, V = C⁻¹ K_LN and V Vᵀ = Q Λ Qᵀ it is
//! 1 − |v_k|² + s/(1 − s/ν), s = Σ_i (Qᵀv_k)_i² / (1 + λ_i/ν).

use faer::{Mat, Side};
use poegp_protocol::limits::MAX_LANDMARKS;
use poegp_runtime::elastic::configuration::Configuration;
use poegp_runtime::elastic::position_variance::{PositionVariance, landmark_feature, prior};
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::kinematics::coupling::CouplingMatrix;
use poegp_runtime::kinematics::minimal_chain::{MinimalChain, MinimalForm};

use crate::learning::elastic::fit::RobustFit;
use crate::learning::elastic::inputs::kernel;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::sample::BaseSample;

/// Landmarks of a blob. Ratio to the trainer's standard deviation on held-out poses of the wild arm, 90 % of them:
/// 0.948 to 1.071 with 8, 0.955 to 1.034 with 12, 0.957 to 1.031 with 16, 0.950 to 1.029 with 32.
pub const LANDMARKS: usize = 12;
const _: () = assert!(LANDMARKS <= MAX_LANDMARKS);
/// A further landmark must have this share of its own variance left, or single precision would cancel.
const LEAST_LEFT: f64 = 1e-3;

/// What the device needs, in f64.
#[derive(Clone, Debug)]
pub struct DeviceVariance {
    /// Floor, gain and number of landmarks.
    pub header: PositionVariance<f64>,
    /// The noise in the floor, m².
    pub noise: f64,
    /// Words of the landmarks.
    pub rows: Vec<f64>,
}

/// Of a tied fit to `samples`. `None` when a matrix cannot be factored.
pub fn device_variance(
    robust: &RobustFit,
    samples: &[BaseSample],
    coupling: Option<&CouplingMatrix<f64>>,
) -> Option<DeviceVariance> {
    let fit = &robust.fit;
    let inflation = robust.inflation[0].powi(2);
    let noise = inflation * fit.scales.position.powi(2) * fit.hyperparameters[0].exp();
    let kernels = fit.layout.kernels(&fit.hyperparameters);
    let mut unit = *kernels.first()?;
    unit.amplitude = 1.0;
    unit.payload_amplitude = 0.0;
    let inputs = &fit.inputs;
    let n = inputs.payloads.len();
    let input = |i: usize| (&inputs.features[i], inputs.payloads[i]);
    let gram = Mat::from_fn(n, n, |i, j| {
        kernel(&unit, &inputs.kinds, input(i), input(j))
    });
    let chosen = landmarks(&gram);
    let count = chosen.len();
    let between = Mat::from_fn(count, count, |i, j| gram[(chosen[i], chosen[j])]);
    let factor = between.llt(Side::Lower).ok()?;
    let lower = factor.L().to_owned();
    let v = solve_lower(&lower, &Mat::from_fn(count, n, |i, k| gram[(chosen[i], k)]));
    let eigen = (&v * v.transpose()).self_adjoint_eigen(Side::Lower).ok()?;
    let (q, lambda) = (eigen.U(), eigen.S());
    let w = q.transpose() * &v;
    let priors = priors(fit, samples, coupling, &kernels);
    let gain = inflation / 3.0;
    let mut best: Option<(f64, f64, f64)> = None;
    for nu in (0..=80).map(|step| 10_f64.powf(-4.0 + 0.1 * f64::from(step))) {
        let of = |k: usize| {
            let v2: f64 = (0..count).map(|i| v[(i, k)].powi(2)).sum();
            let s: f64 = (0..count)
                .map(|i| w[(i, k)].powi(2) / (1.0 + lambda[i].max(0.0) / nu))
                .sum();
            let u = 1.0 - v2 + s / (1.0 - s / nu).max(1e-9);
            gain * priors[k] * u.clamp(0.0, 1.0).powi(2)
        };
        let pairs: Vec<(f64, f64)> = robust
            .left_out
            .iter()
            .enumerate()
            .filter_map(|(k, variance)| Some((of(k), inflation * (*variance)?)))
            .collect();
        let Some((floor, cost)) = floor_of(&pairs, noise) else {
            continue;
        };
        if best.is_none_or(|b| cost < b.2) {
            best = Some((nu, floor, cost));
        }
    }
    let (nu, floor, _) = best?;
    let information = Mat::from_fn(count, count, |i, j| {
        (0..count)
            .map(|e| {
                let ratio = lambda[e].max(0.0) / nu;
                q[(i, e)] * q[(j, e)] * ratio / (1.0 + ratio)
            })
            .sum::<f64>()
    });
    // C⁻ᵀ I C⁻¹, with the information I, symmetric.
    let half = solve_upper(&lower, &information);
    let information = solve_upper(&lower, &half.transpose().to_owned());
    let h = reversed_factor(&information)?;
    let mut rows = Vec::new();
    for (row, i) in chosen.iter().enumerate() {
        for (kind, feature) in inputs.kinds.iter().zip(&inputs.features[*i]) {
            rows.extend(landmark_feature(*kind, feature));
        }
        rows.push(inputs.payloads[*i]);
        rows.extend((0..=row).map(|column| h[(row, column)]));
    }
    Some(DeviceVariance {
        header: PositionVariance {
            floor,
            gain,
            landmarks: count,
        },
        noise: noise.min(floor),
        rows,
    })
}

/// Greedily the pose that explains most of what all poses have left.
fn landmarks(gram: &Mat<f64>) -> Vec<usize> {
    let n = gram.nrows();
    let mut left = gram.clone();
    let mut chosen = Vec::new();
    while chosen.len() < LANDMARKS.min(n) {
        let gain = |j: usize| (0..n).map(|i| left[(i, j)].powi(2)).sum::<f64>() / left[(j, j)];
        let Some(next) = (0..n)
            .filter(|j| left[(*j, *j)] > LEAST_LEFT)
            .map(|j| (j, gain(j)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(j, _)| j)
        else {
            break;
        };
        let pivot = left[(next, next)];
        let column: Vec<f64> = (0..n).map(|i| left[(i, next)]).collect();
        for j in 0..n {
            for i in 0..n {
                left[(i, j)] -= column[i] * column[j] / pivot;
            }
        }
        chosen.push(next);
    }
    chosen
}

/// Σ_c |J_c|² a_c of every pose, m².
fn priors(
    fit: &ElasticFit,
    samples: &[BaseSample],
    coupling: Option<&CouplingMatrix<f64>>,
    kernels: &[JointKernel<f64>],
) -> Vec<f64> {
    let mut padded = [JointKernel::zero(); 8];
    for (slot, kernel) in padded.iter_mut().zip(kernels) {
        *slot = *kernel;
    }
    let of = |sample: &BaseSample| {
        let poe = fit.state.chain(sample.tool);
        let motions = poe.motions(&sample.serial_joints);
        let (frames, target) = poe.joint_frames_with(&motions);
        let mut joints = [0.0; 8];
        joints[..sample.joints.len()].copy_from_slice(&sample.joints);
        let at = Configuration {
            chain: &MinimalChain::new(&MinimalForm::new(&poe)),
            coupling,
            joints: &joints,
            motions: &motions,
            payload_kg: sample.payload_kg.unwrap_or(0.0),
        };
        prior(&at, &padded, &frames, &target)
    };
    samples.iter().map(of).collect()
}

/// The floor ≥ noise of least relative squares for pairs of (variance beside the floor, variance), with what it leaves.
fn floor_of(pairs: &[(f64, f64)], noise: f64) -> Option<(f64, f64)> {
    let (mut weights, mut sum) = (0.0, 0.0);
    for (beside, variance) in pairs {
        weights += 1.0 / (variance * variance);
        sum += (variance - beside) / (variance * variance);
    }
    let floor = (sum / weights).max(noise);
    let left = |(beside, variance): &(f64, f64)| ((floor + beside) / variance - 1.0).powi(2);
    let cost = pairs.iter().map(left).sum::<f64>();
    cost.is_finite().then_some((floor, cost))
}

/// C⁻¹ b.
fn solve_lower(c: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let mut out = b.clone();
    for column in 0..b.ncols() {
        for i in 0..c.nrows() {
            let done: f64 = (0..i).map(|j| c[(i, j)] * out[(j, column)]).sum();
            out[(i, column)] = (out[(i, column)] - done) / c[(i, i)];
        }
    }
    out
}

/// C⁻ᵀ b.
fn solve_upper(c: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let mut out = b.clone();
    for column in 0..b.ncols() {
        for i in (0..c.nrows()).rev() {
            let done: f64 = (i + 1..c.nrows())
                .map(|j| c[(j, i)] * out[(j, column)])
                .sum();
            out[(i, column)] = (out[(i, column)] - done) / c[(i, i)];
        }
    }
    out
}

/// The lower triangular H with HᵀH = `a`: the factor of the matrix turned around, turned back.
fn reversed_factor(a: &Mat<f64>) -> Option<Mat<f64>> {
    let n = a.nrows();
    let scale = (0..n).map(|i| a[(i, i)]).fold(0.0, f64::max);
    // A landmark without information leaves a zero.
    let turned = Mat::from_fn(n, n, |i, j| {
        let value = a[(n - 1 - i, n - 1 - j)];
        if i == j { value + 1e-12 * scale } else { value }
    });
    let factor = turned.llt(Side::Lower).ok()?;
    let g = factor.L();
    Some(Mat::from_fn(n, n, |i, j| {
        if j <= i {
            g[(n - 1 - j, n - 1 - i)]
        } else {
            0.0
        }
    }))
}
