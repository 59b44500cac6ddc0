//! The standard deviation that fits on the device: landmarks, and what makes it that of the trainer.
//!
//! The formula is the runtime's (`deflection::PositionVariance`). Here its numbers are found:
//!
//! - one kernel for all joints: the mean of the joints' rates, weighted by what each process moves the tool, times the
//!   factor that fits best;
//! - landmarks among the training poses, each the one that explains most of what the ones before leave;
//! - ν, the noise of one pose as information about a process, and the floor, so that the variance of every training pose when it is left out
//!   is that of the exact posterior (`outliers::leave_one_out`), inflation included, in least relative squares.
//!
//! The gain is not fitted: far from all data the variance must be the prior's. With the gain free (and u instead of u²) poses
//! left out were met no better, and the device said half of what the trainer did far away.
//!
//! The share that the other poses leave unexplained at pose k: with K = C Cᵀ, V = C⁻¹ K_LN and V Vᵀ = Q Λ Qᵀ it is
//! 1 − |v_k|² + s/(1 − s/ν), s = Σ_i (Qᵀv_k)_i² / (1 + λ_i/ν).

use poegp_protocol::limits::MAX_LANDMARKS;
use poegp_runtime::elastic::configuration::Configuration;
use poegp_runtime::elastic::position_variance::{PositionVariance, landmark_feature, prior};
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::kinematics::coupling::Coupling;
use poegp_runtime::kinematics::minimal_chain::{MinimalChain, MinimalForm};

use crate::identification::parametric::state::ROWS;
use crate::learning::elastic::fit::RobustFit;
use crate::learning::elastic::inputs::kernel;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::sample::BaseSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

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

/// Of a fit to `samples`. `None` when a matrix cannot be factored.
pub fn device_variance(
    robust: &RobustFit,
    samples: &[BaseSample],
    coupling: Option<&Coupling<f64>>,
) -> Option<DeviceVariance> {
    let fit = &robust.fit;
    let inflation = robust.inflation[0].powi(2);
    let noise = inflation * fit.scales.position.powi(2) * libm::exp(fit.hyperparameters[0]);
    let kernels = fit.layout.kernels(&fit.hyperparameters);
    let priors = priors(fit, samples, coupling, &kernels);
    let left_out: Vec<Known> = robust
        .left_out
        .iter()
        .zip(&priors)
        .enumerate()
        .filter_map(|(pose, (variance, prior))| {
            Some(Known {
                pose,
                prior: inflation / 3.0 * prior,
                variance: inflation * (*variance)?,
            })
        })
        .collect();
    let common = common_kernel(fit, samples, &kernels)?;
    let trial = |factor: &f64| {
        let kernel = scaled(&common, *factor);
        Landmarks::new(fit, kernel)?.fitted(&left_out, noise)
    };
    let best = SHORTER.iter().filter_map(trial);
    let best = best.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let h = reversed_factor(&best.landmarks.information(best.nu))?;
    let inputs = &fit.inputs;
    let mut rows = Vec::new();
    for (row, i) in best.landmarks.poses.iter().enumerate() {
        for (kind, feature) in inputs.kinds.iter().zip(&inputs.features[*i]) {
            rows.extend(landmark_feature(*kind, feature));
        }
        rows.push(inputs.payloads[*i]);
        rows.extend((0..=row).map(|column| h[(row, column)]));
    }
    Some(DeviceVariance {
        header: PositionVariance {
            floor: best.floor,
            gain: inflation / 3.0,
            rates: *best.landmarks.kernel.rates(),
            payload_rate: best.landmarks.kernel.payload_rate,
            landmarks: best.landmarks.poses.len(),
        },
        noise: noise.min(best.floor),
        rows,
    })
}

/// Factors of the common kernel's rates that are tried.
const SHORTER: [f64; 9] = [0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0];

/// A training pose and its variance when it is left out, m².
struct Known {
    pose: usize,
    /// The variance that the processes have there before any measurement.
    prior: f64,
    variance: f64,
}

/// One kernel for all joints: rates weighted by what each joint's process moves the tool, with amplitude 1.
fn common_kernel(
    fit: &ElasticFit,
    samples: &[BaseSample],
    kernels: &[JointKernel<f64>],
) -> Option<JointKernel<f64>> {
    let payloads = &fit.inputs.payloads;
    let square = payloads.iter().map(|m| m * m).sum::<f64>() / payloads.len().max(1) as f64;
    let linear = fit.state.linearise(samples, fit.scales);
    let weight = |(c, kernel): (usize, &JointKernel<f64>)| {
        let moved = (0..linear.jacobian.nrows()).filter(|row| row % ROWS < 3);
        let moved: f64 = moved.map(|row| linear.jacobian[(row, c)].powi(2)).sum();
        moved * (kernel.amplitude + kernel.payload_amplitude * square)
    };
    let weights: Vec<f64> = kernels.iter().enumerate().map(weight).collect();
    let total: f64 = weights.iter().sum();
    let mean = |of: &dyn Fn(&JointKernel<f64>) -> f64| {
        let sum: f64 = kernels.iter().zip(&weights).map(|(k, w)| w * of(k)).sum();
        sum / total
    };
    let mut out = JointKernel::zero();
    out.set_rates((0..fit.layout.joints).map(|d| mean(&|kernel| kernel.rates()[d])));
    out.payload_rate = mean(&|kernel| kernel.payload_rate);
    out.amplitude = 1.0;
    (total > 0.0 && total.is_finite()).then_some(out)
}

/// The kernel with all rates times `factor`.
fn scaled(kernel: &JointKernel<f64>, factor: f64) -> JointKernel<f64> {
    let mut out = *kernel;
    out.set_rates(kernel.rates().iter().map(|rate| factor * rate));
    out.payload_rate *= factor;
    out
}

/// Landmarks of one kernel, and what measurements at all poses say about them.
struct Landmarks {
    kernel: JointKernel<f64>,
    /// Poses that they stand at.
    poses: Vec<usize>,
    /// C of K = C Cᵀ.
    lower: Mat<f64>,
    /// V = C⁻¹ K_LN.
    v: Mat<f64>,
    /// Q and Λ of V Vᵀ, and Qᵀ V.
    q: Mat<f64>,
    lambda: Vec<f64>,
    w: Mat<f64>,
}

/// The best ν and floor for some landmarks.
struct Fitted {
    landmarks: Landmarks,
    nu: f64,
    floor: f64,
    cost: f64,
}

impl Landmarks {
    fn new(fit: &ElasticFit, common: JointKernel<f64>) -> Option<Self> {
        let inputs = &fit.inputs;
        let n = inputs.payloads.len();
        let input = |i: usize| (&inputs.features[i], inputs.payloads[i]);
        let gram = Mat::from_fn(n, n, |i, j| {
            kernel(&common, &inputs.kinds, input(i), input(j))
        });
        let poses = landmarks(&gram);
        let count = poses.len();
        let between = Mat::from_fn(count, count, |i, j| gram[(poses[i], poses[j])]);
        let lower = Factor::new(between, 1).ok()?.lower();
        let v = solve_lower(&lower, &Mat::from_fn(count, n, |i, k| gram[(poses[i], k)]));
        let eigen = product(&v, Transposed(&v)).symmetric_eigen();
        let q = eigen.eigenvectors;
        Some(Self {
            w: product(Transposed(&q), &v),
            lambda: (0..count).map(|i| eigen.eigenvalues[i].max(0.0)).collect(),
            q,
            v,
            lower,
            poses,
            kernel: common,
        })
    }

    /// The share of the prior that the other poses leave unexplained at pose `k` with noise ν.
    fn unexplained(&self, k: usize, nu: f64) -> f64 {
        let count = self.poses.len();
        let v2: f64 = (0..count).map(|i| self.v[(i, k)].powi(2)).sum();
        let s: f64 = (0..count)
            .map(|i| self.w[(i, k)].powi(2) / (1.0 + self.lambda[i] / nu))
            .sum();
        (1.0 - v2 + s / (1.0 - s / nu).max(1e-9)).clamp(0.0, 1.0)
    }

    /// ν and floor of least relative squares.
    fn fitted(self, left_out: &[Known], noise: f64) -> Option<Fitted> {
        let trial = |nu: f64| {
            let pair = |known: &Known| {
                let beside = known.prior * self.unexplained(known.pose, nu).powi(2);
                (beside, known.variance)
            };
            let pairs: Vec<(f64, f64)> = left_out.iter().map(pair).collect();
            let (floor, cost) = floor_of(&pairs, noise)?;
            Some((nu, floor, cost))
        };
        let (nu, floor, cost) = (0..=80)
            .map(|step| libm::pow(10_f64, -4.0 + 0.1 * f64::from(step)))
            .filter_map(trial)
            .min_by(|a, b| a.2.total_cmp(&b.2))?;
        Some(Fitted {
            landmarks: self,
            nu,
            floor,
            cost,
        })
    }

    /// HᵀH.
    fn information(&self, nu: f64) -> Mat<f64> {
        let (q, count) = (&self.q, self.poses.len());
        let shares = Mat::from_fn(count, count, |i, j| {
            (0..count)
                .map(|e| {
                    let ratio = self.lambda[e] / nu;
                    q[(i, e)] * q[(j, e)] * ratio / (1.0 + ratio)
                })
                .sum::<f64>()
        });
        // C⁻ᵀ I C⁻¹, with the information I, symmetric.
        let half = solve_upper(&self.lower, &shares);
        solve_upper(&self.lower, &half.transpose())
    }
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
    coupling: Option<&Coupling<f64>>,
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
    let factor = Factor::new(turned, 1).ok()?;
    let g = factor.lower();
    Some(Mat::from_fn(n, n, |i, j| {
        if j <= i {
            g[(n - 1 - j, n - 1 - i)]
        } else {
            0.0
        }
    }))
}
