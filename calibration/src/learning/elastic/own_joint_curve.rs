//! The own-joint curve as a Gaussian process: an error of each revolute joint that repeats with its own angle.
//!
//! k(d) = a² (exp((cos d − 1)/l²) − its mean over a turn), with one amplitude a and one lengthscale l for all joints. As
//! a Fourier series, the curve is a linear block with a diagonal prior, var(sin kq) = var(cos kq) = a² v_k(l) with v_k =
//! 2 e^(−z) I_k(z), z = 1/l² (I_k: modified Bessel function of the first kind). Order 0 is the joint's zero, which
//! belongs to the geometry. The series ends at [`MAX_CURVE_ORDER`], in the fit as on the device: nothing is cut off
//! afterwards.

use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_CURVE_ORDER;
use poegp_runtime::kinematics::poe::JointTrig;
use poegp_runtime::math::fourier::cosine_series;

use crate::numeric::matrix::{Mat, columns_mut};
use crate::numeric::product::{Become, Operand, multiply_lower, product};

/// Range of lengthscales that the evidence may choose from, in rad.
pub const LENGTH_SCALES: (f64, f64) = (0.05, 2.0);
/// Number of reciprocal lengthscales beyond which orders have no amplitude: v_k falls as exp(−k²l²/2).
const ORDERS_BY_SCALE: f64 = 5.0;

/// Returns the number of orders of a curve of lengthscale `l` (rad).
pub fn orders(l: f64) -> usize {
    ((ORDERS_BY_SCALE / l).ceil() as usize).clamp(1, MAX_CURVE_ORDER)
}

/// Spectrum of the curve: v_k(l) of orders 1, 2, … and their derivatives by ln l.
#[derive(Clone, Debug)]
pub struct Spectrum {
    /// Prior variance of each order, relative to a².
    pub variance: Vec<f64>,
    /// Derivative of each variance by ln l.
    pub slope: Vec<f64>,
}

impl Spectrum {
    /// Computes the spectrum for lengthscale `l` in rad.
    pub fn new(l: f64) -> Self {
        let z = 1.0 / (l * l);
        let bessel = scaled_bessel(z, MAX_CURVE_ORDER + 1);
        // I_k′ = (I_{k−1} + I_{k+1})/2; the derivative of e^(−z) I_k has a further −e^(−z) I_k. dz/d ln l = −2z.
        let slope = |k: usize| 0.5 * (bessel[k - 1] + bessel[k + 1]) - bessel[k];
        Self {
            variance: (1..=MAX_CURVE_ORDER).map(|k| 2.0 * bessel[k]).collect(),
            slope: (1..=MAX_CURVE_ORDER).map(|k| -4.0 * z * slope(k)).collect(),
        }
    }

    /// Returns k(0)/a²: the prior variance of the curve at any angle, relative to a².
    pub fn total(&self) -> f64 {
        self.variance.iter().sum()
    }
}

/// Computes e^(−z) I_k(z) for k = 0 … `last` by Miller's downward recurrence I_{k−1} = I_{k+1} + (2k/z) I_k, scaled by
/// e^z = I_0 + 2 Σ I_k (Abramowitz and Stegun, 9.6.26 and 9.6.37).
fn scaled_bessel(z: f64, last: usize) -> Vec<f64> {
    // Start far enough beyond both the orders that are wanted and those that matter at z.
    let start = last + 32 + (10.0 * z.sqrt()) as usize;
    let mut out = vec![0.0; last + 1];
    let (mut above, mut here, mut sum) = (0.0, 1e-300, 0.0);
    for k in (0..=start).rev() {
        if k <= last {
            out[k] = here;
        }
        sum += if k == 0 { here } else { 2.0 * here };
        let below = above + 2.0 * k as f64 / z * here;
        (above, here) = (here, below);
        if here > 1e250 {
            for value in out.iter_mut().chain([&mut above, &mut here, &mut sum]) {
                *value *= 1e-250;
            }
        }
    }
    for value in &mut out {
        *value /= sum;
    }
    out
}

/// sin kq and cos kq of one joint at every pose: columns sin q, cos q, sin 2q, ….
pub type Waves = Mat<f64>;

/// Computes the waves of every joint; `None` for a prismatic one.
pub fn waves(features: &[JointTrig<f64>], kinds: &[JointKind]) -> Vec<Option<Waves>> {
    let of = |c: usize| {
        let mut out = Mat::zeros(features.len(), 2 * MAX_CURVE_ORDER);
        for (i, feature) in features.iter().enumerate() {
            for (k, wave) in wave(feature[c]).into_iter().enumerate() {
                out[(i, k)] = wave;
            }
        }
        out
    };
    let revolute = |(c, kind): (usize, &JointKind)| (*kind == JointKind::Revolute).then(|| of(c));
    kinds.iter().enumerate().map(revolute).collect()
}

/// Returns sin q, cos q, sin 2q, cos 2q, … from sin q and cos q, by repeated rotation.
pub(super) fn wave([sin, cos]: [f64; 2]) -> [f64; 2 * MAX_CURVE_ORDER] {
    let mut out = [0.0; 2 * MAX_CURVE_ORDER];
    let (mut s, mut c) = (0.0, 1.0);
    for pair in out.as_chunks_mut::<2>().0 {
        (s, c) = (s * cos + c * sin, c * cos - s * sin);
        *pair = [s, c];
    }
    out
}

/// Prior of the own-joint curve.
#[derive(Clone, Debug)]
pub struct CurvePrior {
    /// Squared amplitude a², in the squared unit of the user.
    pub amplitude: f64,
    /// Spectrum v_k.
    pub spectrum: Spectrum,
}

impl CurvePrior {
    /// Writes K(i, j) of one joint to `out`: at least its lower triangle.
    pub fn gram(&self, waves: &Waves, out: &mut Mat<f64>) {
        let weight = |k: usize| (self.amplitude * self.spectrum.variance[k / 2]).sqrt();
        let scaled = Mat::from_fn(waves.nrows(), waves.ncols(), |i, k| {
            weight(k) * waves[(i, k)]
        });
        let scaled = Operand::from(&scaled);
        multiply_lower(
            &mut columns_mut(out),
            Become::Product,
            &scaled,
            &scaled.clone().transposed(),
        );
    }

    /// Returns k(q − q′) of two angles of one joint, each given as sine and cosine.
    pub fn between(&self, [s, c]: [f64; 2], [other_s, other_c]: [f64; 2]) -> f64 {
        let cos = c * other_c + s * other_s;
        self.amplitude * cosine_series(&self.spectrum.variance, cos)
    }

    /// Returns the most probable amplitudes of sin q, cos q, sin 2q, … of one joint, given the weights of its process at
    /// every pose.
    pub fn coefficients(&self, waves: &Waves, weights: impl Fn(usize) -> f64) -> Vec<f64> {
        let along =
            |k: usize| -> f64 { (0..waves.nrows()).map(|i| waves[(i, k)] * weights(i)).sum() };
        (0..waves.ncols())
            .map(|k| self.amplitude * self.spectrum.variance[k / 2] * along(k))
            .collect()
    }
}

/// Returns Σ_ij G(i, j) sin kq_i sin kq_j (and of cosines) for every column of `waves`: the derivative of −log p by the
/// variance of each column. Of G, the lower triangle is given, and every entry of it, diagonal included, is summed once.
pub fn gradient_by_order(lower: &Mat<f64>, waves: &Waves) -> Vec<f64> {
    let product = product(lower, waves);
    (0..waves.ncols())
        .map(|k| {
            (0..waves.nrows())
                .map(|i| waves[(i, k)] * product[(i, k)])
                .sum()
        })
        .collect()
}
