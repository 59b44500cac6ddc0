//! The predictive variance that fits on the device: eq. 7 as a quadratic form in the kernels of a few training poses.
//!
//! Conditioning on a subset of the poses overestimates eq. 7 where the others help: up to twice with 12 of 100 poses, by
//! half with 64 of 300. But eq. 7 is itself a quadratic form in kernels and a smooth function of x, so the coefficients
//! of the few poses can be fitted to its values at many poses by least relative squares. These poses are drawn from the
//! trained ranges, from twice these, and from close to the training poses, where the variance has its valleys.

use poegp_protocol::limits::{MAX_INPUTS, MAX_TASK_SPACE_LANDMARKS, OUTPUTS};
use poegp_runtime::gp::quadratic_posterior::{MAX_SCALED_INPUT, input_scale};
use poegp_runtime::gp::quadratic_variance::{
    BLOCK, QuadraticVariance, landmark_words, mean_rate, variance_words,
};
use poegp_runtime::math::vector::squared_distance;

use crate::learning::landmarks::landmarks;
use crate::learning::task_space::TaskSpaceGp;
use crate::numeric::cholesky::Factor;
use crate::numeric::halton::halton;
use crate::numeric::matrix::{Mat, columns_mut};
use crate::numeric::product::{Become, Operand, multiply_lower, product};
use crate::numeric::statistics::extremes;

/// Numbers of poses from the trained ranges, from twice the ranges of some inputs, and from close to the training poses.
const WITHIN: usize = 2_000;
const AROUND: usize = 2_400;
const CLOSE: usize = 1_600;
/// Largest distance of close poses from the training poses, as a share of half of each range.
const DISTANCE: f64 = 0.4;
/// Ridge added to the diagonal of the normal equations for each pose; keeps the coefficients small enough for single
/// precision.
const RIDGE: f64 = 3e-8;
/// Relative amount by which the variance is aimed above eq. 7, so that few poses get too small a value.
const AIM: f64 = 0.03;
/// Number of poses whose equations are in memory together.
const TOGETHER: usize = 500;
/// Number of other poses of the trained ranges at which the result is checked in single precision.
const COMPARED: usize = 400;
/// Largest relative deviation of σ from eq. 7 that nine in ten of the compared poses must respect.
const FOLLOWED: f64 = 0.2;
/// Least number of landmarks that is worth its time.
const LEAST_LANDMARKS: usize = 12;

/// Function from inputs (rad, m, kg) to the squared distances of the target from the axes of the base, in m².
pub type Levers<'a> = dyn Fn(&[f64]) -> [f64; 3] + 'a;

/// Variance data that the device needs, in f64.
#[derive(Clone, Debug)]
pub struct DeviceVariance {
    /// Number of landmarks.
    pub landmarks: usize,
    /// Numbers of the landmarks, in the order of a blob.
    pub rows: Vec<f64>,
}

impl TaskSpaceGp {
    /// Computes the device variance with as many landmarks as `room` numbers hold. Returns `None` when there is not
    /// enough room, when the equations cannot be solved, or when their solution in single precision is not near eq. 7.
    pub fn device_variance(&self, room: usize, levers: &Levers<'_>) -> Option<DeviceVariance> {
        let inputs = self.inputs.first()?.len();
        let fits = |count: &usize| variance_words(inputs, *count) <= room;
        let most = (LEAST_LANDMARKS..=MAX_TASK_SPACE_LANDMARKS.min(self.inputs.len()))
            .rev()
            .find(fits)?;
        let fit = Fit::new(self, most, levers);
        let coefficients = fit.coefficients()?;
        let rows = fit.rows(&coefficients);
        let is_usable = rows.iter().all(|x| x.abs() <= MAX_SCALED_INPUT);
        (is_usable && fit.is_followed_by(&rows)).then_some(DeviceVariance {
            landmarks: fit.chosen.len(),
            rows,
        })
    }
}

/// The data from which the coefficients are fitted; variances are in units of the signal's.
struct Fit<'a> {
    gp: &'a TaskSpaceGp,
    /// Input scale √(θ₁ log₂e/2).
    scale: f64,
    levers: &'a Levers<'a>,
    /// Inputs of the landmarks.
    chosen: Vec<&'a Vec<f64>>,
}

impl<'a> Fit<'a> {
    fn new(gp: &'a TaskSpaceGp, most: usize, levers: &'a Levers<'a>) -> Self {
        let rate = |c: usize| gp.output(c).kernel.inverse_squared_lengthscale;
        let variance = |c: usize| gp.output_scale[c].powi(2) * gp.output(c).kernel.signal_variance;
        let rate = mean_rate(&std::array::from_fn(variance), &std::array::from_fn(rate));
        let mut fit = Self {
            gp,
            scale: input_scale(rate),
            levers,
            chosen: Vec::new(),
        };
        let n = gp.inputs.len();
        let between = |i: usize, j: usize| fit.kernel(&gp.inputs[i], &gp.inputs[j]);
        let chosen = landmarks(&Mat::from_fn(n, n, between), most);
        fit.chosen = chosen.iter().map(|i| &gp.inputs[*i]).collect();
        fit
    }

    fn kernel(&self, a: &[f64], b: &[f64]) -> f64 {
        libm::exp2(-self.scale * self.scale * squared_distance(a, b))
    }

    /// Returns the least and the largest value of each training input.
    fn ranges(&self) -> Vec<(f64, f64)> {
        let trained = &self.gp.inputs;
        let range = |d: usize| extremes(trained.iter().map(|x: &Vec<f64>| x[d]));
        (0..trained.first().map_or(0, Vec::len))
            .map(range)
            .collect()
    }

    /// Returns whether the device's σ is near that of eq. 7. If each output has its own kernel, one quadratic form may be
    /// unable to follow them all; and where the noise is a very small share of the prior, single precision cannot resolve
    /// what is left.
    fn is_followed_by(&self, rows: &[f64]) -> bool {
        let ranges = self.ranges();
        let value = |(d, (lower, upper)): (usize, &(f64, f64)), index: u32| {
            lower + (upper - lower) * halton(index, d)
        };
        let pose = |i: usize| -> Vec<f64> {
            let index = (WITHIN + 1 + i) as u32;
            ranges
                .iter()
                .enumerate()
                .map(|range| value(range, index))
                .collect()
        };
        let poses: Vec<Vec<f64>> = (0..COMPARED).map(pose).collect();
        let rows: Vec<f32> = rows.iter().map(|x| *x as f32).collect();
        let scale = vec![self.scale as f32; ranges.len()];
        let device = QuadraticVariance::<f32> {
            root_rate: 1.0,
            signal: [1.0; OUTPUTS],
            noise: [0.0; OUTPUTS],
            landmarks: self.chosen.len(),
        };
        let exact = self.exact(&poses).into_iter().zip(&poses);
        let is_near = |((u, noise), pose): ((f64, f64), &Vec<f64>)| {
            let x: Vec<f32> = pose.iter().map(|x| *x as f32).collect();
            let found = f64::from(device.unexplained(&rows, &scale, &x));
            let ratio = ((found + noise) / (u + noise)).sqrt();
            (ratio - 1.0).abs() < FOLLOWED
        };
        let near = exact.map(is_near).filter(|is_near| *is_near).count();
        10 * near >= 9 * COMPARED
    }

    /// Returns the poses to which the coefficients are fitted.
    fn poses(&self) -> Vec<Vec<f64>> {
        let trained = &self.gp.inputs;
        let ranges = self.ranges();
        let dimensions = ranges.len();
        let drawn = |index: u32, share: &dyn Fn(usize) -> f64, centre: Option<&Vec<f64>>| {
            let coordinate = |(d, (lower, upper)): (usize, &(f64, f64))| {
                let centre = centre.map_or(0.5 * (lower + upper), |x| x[d]);
                centre + share(d) * (upper - lower) * (halton(index, d) - 0.5)
            };
            ranges.iter().enumerate().map(coordinate).collect()
        };
        let within = (1_u32..).take(WITHIN).map(|i| drawn(i, &|_| 1.0, None));
        // Take one input beyond its range, then two neighbours, … up to all of them.
        let beyond = |i: u32, d: usize| {
            let turn = i as usize / dimensions;
            (i as usize + d) % dimensions <= turn % dimensions
        };
        let around = (1_u32..).take(AROUND);
        let around = around.map(|i| drawn(i, &|d| if beyond(i, d) { 2.0 } else { 1.0 }, None));
        let close = (1_u32..).zip(trained.iter().cycle()).take(CLOSE);
        let close =
            close.map(|(i, x)| drawn(i, &|_| DISTANCE * halton(i, MAX_INPUTS - 1), Some(x)));
        within.chain(around).chain(close).collect()
    }

    /// Returns the variances of the target's position at `pose` before any measurement, one for each kernel, and that of
    /// the noise.
    fn prior(&self, pose: &[f64]) -> (Vec<f64>, f64) {
        let levers = (self.levers)(pose);
        let mut signal = vec![0.0; self.gp.hyperparameters.len()];
        let mut noise = 0.0;
        for c in 0..OUTPUTS {
            let lever = if c < 3 { 1.0 } else { levers[c - 3] };
            let weight = self.gp.output_scale[c].powi(2) * lever;
            let own = self.gp.output(c);
            signal[c.min(self.gp.hyperparameters.len() - 1)] += weight * own.kernel.signal_variance;
            noise += weight * own.noise_variance;
        }
        (signal, noise)
    }

    /// Returns u of eq. 7 at `poses`, and the noise in the same units.
    fn exact(&self, poses: &[Vec<f64>]) -> Vec<(f64, f64)> {
        let kernels = 0..self.gp.hyperparameters.len();
        let variances: Vec<Vec<f64>> = kernels.map(|k| self.gp.unit_variances(k, poses)).collect();
        let of = |(i, pose): (usize, &Vec<f64>)| {
            let (prior, noise) = self.prior(pose);
            let whole: f64 = prior.iter().sum();
            let left = |(k, prior): (usize, &f64)| {
                prior * (variances[k][i] / self.gp.output(k).kernel.signal_variance).max(0.0)
            };
            let left: f64 = prior.iter().enumerate().map(left).sum();
            (left / whole, noise / whole)
        };
        poses.iter().enumerate().map(of).collect()
    }

    /// Returns the products of the kernels at `pose` in the order of the coefficients: k_i, then k_i k_0, …, k_i k_i.
    fn products(&self, pose: &[f64]) -> Vec<f64> {
        let kernels: Vec<f64> = self.chosen.iter().map(|x| self.kernel(x, pose)).collect();
        let mut out = Vec::with_capacity(kernels.len() * (kernels.len() + 3) / 2);
        for (i, kernel) in kernels.iter().enumerate() {
            out.push(*kernel);
            out.extend(kernels[..=i].iter().map(|other| kernel * other));
        }
        out
    }

    /// Returns the coefficients b and B, row by row, that fit u + noise by least relative squares.
    fn coefficients(&self) -> Option<Vec<f64>> {
        let poses = self.poses();
        let exact = self.exact(&poses);
        let count = self.products(poses.first()?).len();
        let mut normal = Mat::identity(count, count) * (RIDGE * poses.len() as f64);
        let mut right = Mat::zeros(count, 1);
        for (poses, exact) in poses.chunks(TOGETHER).zip(exact.chunks(TOGETHER)) {
            let weights: Vec<f64> = exact.iter().map(|(u, noise)| 1.0 / (u + noise)).collect();
            let weighted = |(pose, weight): (&Vec<f64>, &f64)| -> Vec<f64> {
                let products = self.products(pose);
                products.iter().map(|product| weight * product).collect()
            };
            let left: Vec<Vec<f64>> = poses.iter().zip(&weights).map(weighted).collect();
            let left = Operand::new(left.iter().map(Vec::as_slice).collect());
            let across = left.clone().transposed();
            let values = weights
                .iter()
                .zip(exact)
                .map(|(w, (u, _))| AIM + w * (u - 1.0));
            let values = Mat::from_iterator(weights.len(), 1, values);
            multiply_lower(&mut columns_mut(&mut normal), Become::Sum, &left, &across);
            right += product(left, &values);
        }
        let found = Factor::new(normal, 1).ok()?.solve(&right);
        let found: Vec<f64> = found.iter().copied().collect();
        found.iter().all(|x| x.is_finite()).then_some(found)
    }

    /// Arranges landmarks and coefficients in the order that the device reads.
    fn rows(&self, coefficients: &[f64]) -> Vec<f64> {
        let mut rows = Vec::new();
        for x in &self.chosen {
            let begin = rows.len();
            rows.extend(x.iter().map(|v| v * self.scale));
            let square: f64 = rows[begin..].iter().map(|z| z * z).sum();
            rows.push(-square);
            rows.resize(begin + landmark_words(x.len()), 0.0);
        }
        let landmarks = self.chosen.len();
        // The coefficients of landmark i are preceded by i (i + 3)/2 others.
        let own = |i: usize| match i < landmarks {
            true => &coefficients[i * (i + 3) / 2..][..i + 2],
            false => &[],
        };
        let of = |i: usize, column: usize| own(i).get(column).copied().unwrap_or(0.0);
        for block in 0..landmarks.div_ceil(BLOCK) {
            let four = BLOCK * block..BLOCK * (block + 1);
            rows.extend(four.clone().map(|i| of(i, 0)));
            for other in 0..=block {
                for j in 0..BLOCK {
                    rows.extend(four.clone().map(|i| of(i, 1 + BLOCK * other + j)));
                }
            }
        }
        rows
    }
}
