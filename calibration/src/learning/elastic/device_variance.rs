//! The standard deviation that fits on the device: its landmarks, and the numbers that bring it close to the trainer's.
//!
//! The formula is the runtime's (`deflection::PositionVariance`). This module finds its numbers:
//!
//! - one kernel for all joints: the mean of the joints' rates, weighted by how far each process moves the tool, times the
//!   factor that fits best;
//! - landmarks among the training poses, each the one that explains most of what the ones before leave;
//! - ν, the noise of one pose as information about a process, the floor and the gain, by least relative squares. They are
//!   fitted to the exact posterior, inflation included: at every training pose when it is left out
//!   (`outliers::leave_one_out`), and at poses drawn from twice the trained ranges. Without the latter, the device stated
//!   half of the trainer's standard deviation far from all data.
//!
//! The share that measurements leave unexplained at a pose, with K = C Cᵀ, V = C⁻¹ K_LN, V Vᵀ = Q Λ Qᵀ and v = C⁻¹ k, is
//! 1 − |v|² + s, s = Σ_i (Qᵀv)_i² / (1 + λ_i/ν). For a configuration that was measured r times and is left out,
//! s/(1 − r s/ν) replaces s.

use std::ops::RangeInclusive;

use nalgebra::Vector3;
use poegp_protocol::limits::{MAX_JOINTS, MAX_LANDMARKS};
use poegp_runtime::elastic::configuration::Configuration;
use poegp_runtime::elastic::position_variance::{PositionVariance, landmark_feature, prior};
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::kinematics::coupling::{Coupling, coupled};
use poegp_runtime::kinematics::minimal_chain::{MinimalChain, MinimalForm};

use crate::identification::parametric::state::ROWS;
use crate::learning::elastic::inputs::{Inputs, kernel};
use crate::learning::elastic::posterior_covariance::PosteriorCovariance;
use crate::learning::elastic::solution::ElasticFit;
use crate::learning::landmarks::landmarks;
use crate::measurement::folds::configurations;
use crate::measurement::observation::Observation;
use crate::measurement::sample::BaseSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::halton::halton;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::extremes;

/// Number of landmarks of a blob. Ratio to the trainer's standard deviation on held-out poses of the wild arm, range of
/// 90 % of them: 0.948 to 1.071 with 8, 0.955 to 1.034 with 12, 0.957 to 1.031 with 16, 0.950 to 1.029 with 32.
pub const LANDMARKS: usize = 12;
const _: () = assert!(LANDMARKS <= MAX_LANDMARKS);

/// Variance data that the device needs, in f64.
#[derive(Clone, Debug)]
pub struct DeviceVariance {
    /// Floor, gain and number of landmarks.
    pub header: PositionVariance<f64>,
    /// Noise variance that the floor contains, in m².
    pub noise: f64,
    /// Numbers of the landmarks, in the order of a blob.
    pub rows: Vec<f64>,
}

/// Computes the device variance of a fit. `None` when a matrix cannot be factored.
///
/// `left_out` is the variance of each of its samples as predicted by the others (m²), and `inflation` is the factor for
/// standard deviations of positions.
pub fn device_variance(
    posterior: &PosteriorCovariance,
    left_out: &[Option<f64>],
    inflation: f64,
    coupling: Option<&Coupling<f64>>,
) -> Option<DeviceVariance> {
    let (fit, samples) = (posterior.fit(), posterior.samples());
    let inflation = inflation.powi(2);
    let noise = fit.scales.position.powi(2) * libm::exp(fit.hyperparameters[0]);
    let noise = inflation * (noise + posterior.excess_of_rows()[0]);
    let kernels = fit.layout.kernels(&fit.hyperparameters);
    // The device states the noise of one row, also of a pose that was trained with the mean of several.
    let single_rows = posterior.single_rows();
    let excess = |(row, sample)| fit.scales.excess(row)[0] - fit.scales.excess(sample)[0];
    let excess = single_rows.iter().zip(samples).map(excess);
    let left_out = (left_out.iter().zip(excess)).map(|(variance, more)| Some((*variance)? + more));
    let around = around(single_rows, coupling, 2.0);
    let all = [samples, &around].concat();
    let exact = posterior.of_predictions(&around).deviations(0..AROUND);
    let exact = exact
        .iter()
        .map(|d| d.iter().map(|d| d * d).sum::<f64>() / 3.0);
    let variances = left_out.chain(exact.map(Some));
    let priors = priors(fit, &all, coupling, &kernels)
        .into_iter()
        .enumerate();
    let known = priors
        .zip(variances)
        .filter_map(|((pose, prior), variance)| {
            Some(Known {
                pose,
                prior: inflation / 3.0 * prior,
                variance: inflation * variance?,
            })
        });
    let known: Vec<Known> = known.collect();
    let inputs = Inputs::new(&fit.state, &all);
    let mut repeats = vec![1.0; samples.len()];
    for group in configurations(samples, fit.state.kinds()) {
        for pose in &group {
            repeats[*pose] = group.len() as f64;
        }
    }
    let common = common_kernel(fit, samples, &kernels)?;
    let trial = |factor: &f64| {
        let kernel = scaled(&common, *factor);
        Landmarks::new(&inputs, &repeats, kernel)?.fitted(&known, noise)
    };
    let best = SHORTER.iter().filter_map(trial);
    let best = best.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let h = reversed_factor(&best.landmarks.information(best.nu))?;
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
            gain: inflation / 3.0 * best.gain,
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

/// Number of poses that are drawn from twice the trained ranges.
const AROUND: usize = 40;
/// Total weight of these poses in the fit, as a share of that of the training poses.
const SHARE_AROUND: f64 = 0.25;

/// Limits of the gain, as a factor of the prior variance of the processes. Below 1, shorter lengthscales fitted as well,
/// but farther away the device stated two thirds of the trainer's standard deviation. Above 1, the gain also covers
/// parameters that are uncertain there; but where the processes have all but vanished, no factor of their prior is right.
const GAIN: RangeInclusive<f64> = 1.0..=4.0;

/// A pose whose exact variance is known, for a training pose the variance when it is left out; in m².
struct Known {
    /// Index of the pose; training poses come first, then those of [`around`].
    pose: usize,
    /// Variance of the processes at the pose before any measurement.
    prior: f64,
    /// Variance that measurements leave.
    variance: f64,
}

/// Draws poses from `width` times the ranges of `samples`, each with the payload and the tool of one of them. Their
/// observations have no meaning: only the uncertainty at these poses is of interest.
pub(crate) fn around(
    samples: &[BaseSample],
    coupling: Option<&Coupling<f64>>,
    width: f64,
) -> Vec<BaseSample> {
    let joints = samples.first().map_or(0, |sample| sample.joints.len());
    let range = |joint| extremes(samples.iter().map(|s: &BaseSample| s.joints[joint]));
    let ranges: Vec<(f64, f64)> = (0..joints).map(range).collect();
    let pose = |(index, like): (u32, &BaseSample)| {
        let mut own = [0.0; MAX_JOINTS];
        for (joint, (lower, upper)) in ranges.iter().enumerate() {
            own[joint] =
                0.5 * (lower + upper) + (upper - lower) * width * (halton(index, joint) - 0.5);
        }
        BaseSample {
            joints: own[..joints].to_vec(),
            serial_joints: coupled(coupling, &own)[..joints].to_vec(),
            observation: Observation::Position(Vector3::zeros()),
            ..like.clone()
        }
    };
    let poses = (1..).zip(samples.iter().cycle()).take(AROUND);
    poses.map(pose).collect()
}

/// Returns one kernel for all joints: rates weighted by how far each joint's process moves the tool, with amplitude 1.
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

/// Returns the kernel with all rates times `factor`.
fn scaled(kernel: &JointKernel<f64>, factor: f64) -> JointKernel<f64> {
    let mut out = *kernel;
    out.set_rates(kernel.rates().iter().map(|rate| factor * rate));
    out.payload_rate *= factor;
    out
}

/// Landmarks of one kernel, and the information that measurements at all poses give about them.
struct Landmarks {
    kernel: JointKernel<f64>,
    /// Indices of the landmarks' poses.
    poses: Vec<usize>,
    /// Number of measurements of the configuration of each measured pose; these poses come first.
    repeats: Vec<f64>,
    /// Cholesky factor C of K = C Cᵀ.
    factor: Factor,
    /// Columns v = C⁻¹ k of all poses; those of the measured poses form V.
    v: Mat<f64>,
    /// Eigenvectors Q and eigenvalues Λ of V Vᵀ, and Qᵀ v.
    q: Mat<f64>,
    lambda: Vec<f64>,
    w: Mat<f64>,
}

/// Best ν, floor and gain for some landmarks; the gain is in units of the prior.
struct Fitted {
    landmarks: Landmarks,
    nu: f64,
    floor: f64,
    gain: f64,
    cost: f64,
}

impl Landmarks {
    fn new(inputs: &Inputs, repeats: &[f64], common: JointKernel<f64>) -> Option<Self> {
        let trained = repeats.len();
        let input = |i: usize| (&inputs.features[i], inputs.payloads[i]);
        let between = |i: usize, j: usize| kernel(&common, &inputs.kinds, input(i), input(j));
        let poses = landmarks(&Mat::from_fn(trained, trained, between), LANDMARKS);
        let count = poses.len();
        let own = Mat::from_fn(count, count, |i, j| between(poses[i], poses[j]));
        let factor = Factor::new(own, 1).ok()?;
        let to_all = Mat::from_fn(count, inputs.payloads.len(), |i, k| between(poses[i], k));
        let v = factor.half_solve(&to_all);
        let measured = v.columns(0, trained).into_owned();
        let eigen = product(&measured, Transposed(&measured)).symmetric_eigen();
        let q = eigen.eigenvectors;
        Some(Self {
            w: product(Transposed(&q), &v),
            lambda: (0..count).map(|i| eigen.eigenvalues[i].max(0.0)).collect(),
            q,
            v,
            factor,
            poses,
            repeats: repeats.to_vec(),
            kernel: common,
        })
    }

    /// Returns the share of the prior that measurements with noise ν leave unexplained at a pose; for a measured pose,
    /// that which the measurements of other configurations leave.
    fn unexplained(&self, pose: usize, nu: f64) -> f64 {
        let count = self.poses.len();
        let v2: f64 = (0..count).map(|i| self.v[(i, pose)].powi(2)).sum();
        let s: f64 = (0..count)
            .map(|i| self.w[(i, pose)].powi(2) / (1.0 + self.lambda[i] / nu))
            .sum();
        let left = match self.repeats.get(pose) {
            Some(repeats) => s / (1.0 - repeats * s / nu).max(1e-9),
            None => s,
        };
        (1.0 - v2 + left).clamp(0.0, 1.0)
    }

    /// Fits ν, floor and gain by least relative squares.
    fn fitted(self, known: &[Known], noise: f64) -> Option<Fitted> {
        let is_trained = |known: &Known| known.pose < self.repeats.len();
        let trained = known.iter().filter(|known| is_trained(known)).count();
        let of_one_around = SHARE_AROUND * trained as f64 / AROUND as f64;
        let trial = |nu: f64| {
            let of = |known: &Known| {
                let weight = if is_trained(known) {
                    1.0
                } else {
                    of_one_around
                };
                Relative {
                    weight,
                    floor: 1.0 / known.variance,
                    gain: known.prior * self.unexplained(known.pose, nu).powi(2) / known.variance,
                }
            };
            let equations: Vec<Relative> = known.iter().map(of).collect();
            let (floor, gain, cost) = floor_and_gain(&equations, noise)?;
            Some((nu, floor, gain, cost))
        };
        let (nu, floor, gain, cost) = (0..=80)
            .map(|step| libm::pow(10_f64, -4.0 + 0.1 * f64::from(step)))
            .filter_map(trial)
            .min_by(|a, b| a.3.total_cmp(&b.3))?;
        Some(Fitted {
            landmarks: self,
            nu,
            floor,
            gain,
            cost,
        })
    }

    /// Returns the information HᵀH.
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
        // Form C⁻ᵀ I C⁻¹, where I is the information in `shares`.
        let inverse = self.factor.half_solve(&Mat::identity(count, count));
        product(Transposed(&inverse), &product(&shares, &inverse))
    }
}

/// Returns the prior variance Σ_c |J_c|² a_c at every pose, in m².
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

/// Equation of one pose: floor and gain, multiplied by these coefficients, should add up to 1.
struct Relative {
    weight: f64,
    floor: f64,
    gain: f64,
}

/// Returns the least-squares floor ≥ noise and gain within [`GAIN`], and the remaining cost.
fn floor_and_gain(equations: &[Relative], noise: f64) -> Option<(f64, f64, f64)> {
    let sum =
        |of: &dyn Fn(&Relative) -> f64| -> f64 { equations.iter().map(|e| e.weight * of(e)).sum() };
    let (ff, fg, gg) = (
        sum(&|e| e.floor * e.floor),
        sum(&|e| e.floor * e.gain),
        sum(&|e| e.gain * e.gain),
    );
    let (f, g) = (sum(&|e| e.floor), sum(&|e| e.gain));
    let gain_with = |floor: f64| ((g - fg * floor) / gg).clamp(*GAIN.start(), *GAIN.end());
    let free = (f * gg - g * fg) / (ff * gg - fg * fg);
    let free = if free.is_finite() { free } else { f / ff };
    let gain = if gg > 0.0 {
        gain_with(free.max(noise))
    } else {
        *GAIN.start()
    };
    // The best floor for that gain; differs from `free` where the gain is at a limit.
    let floor = ((f - fg * gain) / ff).max(noise);
    let cost = sum(&|e| (e.floor * floor + e.gain * gain - 1.0).powi(2));
    cost.is_finite().then_some((floor, gain, cost))
}

/// Returns the lower triangular H with HᵀH = `a`: the factor of the matrix with reversed rows and columns, reversed back.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Equations of poses with such variances; an argument is what measurements leave of the processes.
    fn equations(of: impl Fn(f64) -> f64) -> Vec<Relative> {
        let equation = |left: f64| Relative {
            weight: 1.0 + left,
            floor: 1.0 / of(left),
            gain: left / of(left),
        };
        (0..9).map(f64::from).map(equation).collect()
    }

    #[test]
    fn floor_and_gain_are_those_of_the_variances() {
        let (floor, gain, cost) = floor_and_gain(&equations(|left| 4.0 + 1.5 * left), 1.0).unwrap();
        assert!((floor - 4.0).abs() < 1e-12 && (gain - 1.5).abs() < 1e-12);
        assert!(cost < 1e-24, "{cost}");
    }

    /// Each time the best that is left.
    #[test]
    fn floor_and_gain_have_bounds() {
        for (of, noise) in [(4.0, 5.0), (4.0, 1.0)] {
            for slope in [1.5, 0.5, -0.3, 6.0] {
                let equations = equations(|left| of + slope * left);
                let (floor, gain, cost) = floor_and_gain(&equations, noise).unwrap();
                let allowed = |floor, gain| floor >= noise && GAIN.contains(&gain);
                assert!(allowed(floor, gain));
                let left = |floor: f64, gain: f64| -> f64 {
                    let left = |e: &Relative| (e.floor * floor + e.gain * gain - 1.0).powi(2);
                    equations.iter().map(|e| e.weight * left(e)).sum()
                };
                assert!((left(floor, gain) - cost).abs() < 1e-12);
                for (more, steeper) in [(0.01, 0.0), (-0.01, 0.0), (0.0, 0.01), (0.0, -0.01)] {
                    let (floor, gain) = (floor + more, gain + steeper);
                    if allowed(floor, gain) {
                        assert!(
                            left(floor, gain) > cost,
                            "{noise} {slope}: {more} {steeper}"
                        );
                    }
                }
            }
        }
    }
}
