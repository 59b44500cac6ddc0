//! The predictive variance that fits on the device: eq. 7 as a quadratic form in the kernels of a few training poses.
//!
//! What a subset of the poses knows overestimates eq. 7 where the others help: up to twice with 12 of 100 poses, by half with 64
//! of 300. But eq. 7 is itself a quadratic form in kernels and a smooth function of x, so its values at many poses give the
//! coefficients of the few in least relative squares. Poses are drawn from the trained ranges, from twice these, and from
//! close to the training poses, where the variance has its valleys.

use poegp_protocol::limits::{MAX_INPUTS, MAX_TASK_SPACE_LANDMARKS};
use poegp_runtime::gp::quadratic_posterior::{MAX_SCALED_INPUT, input_scale};
use poegp_runtime::gp::quadratic_variance::{BLOCK, landmark_words, variance_words};
use poegp_runtime::math::vector::squared_distance;

use crate::learning::landmarks::landmarks;
use crate::learning::task_space::TaskSpaceGp;
use crate::numeric::cholesky::Factor;
use crate::numeric::halton::halton;
use crate::numeric::matrix::{Mat, columns_mut};
use crate::numeric::product::{Become, Operand, multiply_lower, product};
use crate::numeric::statistics::extremes;

/// Poses from the trained ranges, from twice the ranges of some inputs, and from close to the training poses.
const WITHIN: usize = 2_000;
const AROUND: usize = 2_400;
const CLOSE: usize = 1_600;
/// How far from these at most, as a share of the half of each range.
const DISTANCE: f64 = 0.4;
/// What is added to the diagonal of the normal equations, for each pose; keeps the coefficients small enough for single precision.
const RIDGE: f64 = 3e-8;
/// How much larger than eq. 7 the variance is aimed at, so that few poses have too small a one.
const AIM: f64 = 0.03;
/// Poses whose equations are in memory together.
const TOGETHER: usize = 500;
/// Fewer landmarks are not worth their time.
const LEAST_LANDMARKS: usize = 12;

/// What the device needs, in f64.
#[derive(Clone, Debug)]
pub struct DeviceVariance {
    /// Number of landmarks.
    pub landmarks: usize,
    /// Their words.
    pub rows: Vec<f64>,
}

impl TaskSpaceGp {
    /// With as many landmarks as `room` numbers hold. `None` with hyperparameters for each output, without that room, when
    /// the equations cannot be solved, or when a number of the rows is larger than single precision can add up.
    pub fn device_variance(&self, room: usize) -> Option<DeviceVariance> {
        if self.hyperparameters.len() != 1 {
            return None;
        }
        let inputs = self.inputs.first()?.len();
        let fits = |count: &usize| variance_words(inputs, *count) <= room;
        let most = (LEAST_LANDMARKS..=MAX_TASK_SPACE_LANDMARKS.min(self.inputs.len()))
            .rev()
            .find(fits)?;
        let fit = Fit::new(self, most);
        let coefficients = fit.coefficients()?;
        let rows = fit.rows(&coefficients);
        let is_usable = rows.iter().all(|x| x.abs() <= MAX_SCALED_INPUT);
        is_usable.then_some(DeviceVariance {
            landmarks: fit.chosen.len(),
            rows,
        })
    }
}

/// What the coefficients are fitted with; variances in units of the signal's.
struct Fit<'a> {
    gp: &'a TaskSpaceGp,
    /// √(θ₁ log₂e/2).
    scale: f64,
    noise: f64,
    /// The landmarks' inputs.
    chosen: Vec<&'a Vec<f64>>,
}

impl<'a> Fit<'a> {
    fn new(gp: &'a TaskSpaceGp, most: usize) -> Self {
        let shared = gp.output(0);
        let mut fit = Self {
            gp,
            scale: input_scale(shared.kernel.inverse_squared_lengthscale),
            noise: shared.noise_variance / shared.kernel.signal_variance,
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

    /// The poses that the coefficients are found from.
    fn poses(&self) -> Vec<Vec<f64>> {
        let trained = &self.gp.inputs;
        let range = |d: usize| extremes(trained.iter().map(|x: &Vec<f64>| x[d]));
        let dimensions = trained.first().map_or(0, Vec::len);
        let ranges: Vec<(f64, f64)> = (0..dimensions).map(range).collect();
        let drawn = |index: u32, share: &dyn Fn(usize) -> f64, centre: Option<&Vec<f64>>| {
            let coordinate = |(d, (lower, upper)): (usize, &(f64, f64))| {
                let centre = centre.map_or(0.5 * (lower + upper), |x| x[d]);
                centre + share(d) * (upper - lower) * (halton(index, d) - 0.5)
            };
            ranges.iter().enumerate().map(coordinate).collect()
        };
        let within = (1_u32..).take(WITHIN).map(|i| drawn(i, &|_| 1.0, None));
        // One input beyond its range, two neighbours, … all.
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

    /// u of eq. 7 at `poses`.
    fn exact(&self, poses: &[Vec<f64>]) -> Vec<f64> {
        let signal = self.gp.output(0).kernel.signal_variance;
        let variances = self.gp.unit_variances(poses);
        variances.iter().map(|v| (v / signal).max(0.0)).collect()
    }

    /// Products of the kernels at `pose`, in the order of the coefficients: k_i, then k_i k_0, …, k_i k_i.
    fn products(&self, pose: &[f64]) -> Vec<f64> {
        let kernels: Vec<f64> = self.chosen.iter().map(|x| self.kernel(x, pose)).collect();
        let mut out = Vec::with_capacity(kernels.len() * (kernels.len() + 3) / 2);
        for (i, kernel) in kernels.iter().enumerate() {
            out.push(*kernel);
            out.extend(kernels[..=i].iter().map(|other| kernel * other));
        }
        out
    }

    /// b and B, row by row, of least relative squares of u + noise.
    fn coefficients(&self) -> Option<Vec<f64>> {
        let poses = self.poses();
        let exact = self.exact(&poses);
        let count = self.products(poses.first()?).len();
        let mut normal = Mat::identity(count, count) * (RIDGE * poses.len() as f64);
        let mut right = Mat::zeros(count, 1);
        for (poses, exact) in poses.chunks(TOGETHER).zip(exact.chunks(TOGETHER)) {
            let weights: Vec<f64> = exact.iter().map(|u| 1.0 / (u + self.noise)).collect();
            let weighted = |(pose, weight): (&Vec<f64>, &f64)| -> Vec<f64> {
                let products = self.products(pose);
                products.iter().map(|product| weight * product).collect()
            };
            let left: Vec<Vec<f64>> = poses.iter().zip(&weights).map(weighted).collect();
            let left = Operand::new(left.iter().map(Vec::as_slice).collect());
            let across = left.clone().transposed();
            let values = weights.iter().zip(exact).map(|(w, u)| AIM + w * (u - 1.0));
            let values = Mat::from_iterator(weights.len(), 1, values);
            multiply_lower(&mut columns_mut(&mut normal), Become::Sum, &left, &across);
            right += product(left, &values);
        }
        let found = Factor::new(normal, 1).ok()?.solve(&right);
        let found: Vec<f64> = found.iter().copied().collect();
        found.iter().all(|x| x.is_finite()).then_some(found)
    }

    /// As the device has them.
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
        // Before those of landmark i there are i (i + 3)/2.
        let own = |i: usize| match i < landmarks {
            true => &coefficients[i * (i + 3) / 2..][..i + 2],
            false => &[],
        };
        let of = |i: usize, column: usize| own(i).get(column).copied().unwrap_or(0.0);
        for block in 0..landmarks.div_ceil(BLOCK) {
            let four = BLOCK * block..BLOCK * (block + 1);
            rows.extend(four.clone().map(|i| of(i, 0)));
            for other in 0..=block {
                for i in four.clone() {
                    rows.extend((0..BLOCK).map(|j| of(i, 1 + BLOCK * other + j)));
                }
            }
        }
        rows
    }
}
