//! The error that 95 of 100 poses do not exceed, estimated from few poses and without the noise of the instrument.
//!
//! The distribution F of the measured errors e_i = |r_i| has a Dirichlet process as its prior (Ferguson, Annals of
//! Statistics 1973). Its base distribution F₀ is a fitted family (`error_family`) and counts as much as α poses. So the
//! family gives the tail beyond the largest error, and the poses themselves give everything below, whatever their
//! distribution:
//!
//! ```text
//! F(x) ~ Beta(α F₀(x) + N(x), α (1 − F₀(x)) + n − N(x))        N(x) = #{e_i ≤ x}
//! P(Q ≤ x) = P(F(x) ≥ 0.95)
//! ```
//!
//! Without noise, the quantile Q of the measured errors is that of the arm. With noise, the family says which quantile of
//! the arm becomes Q, for each of the values that the noise may have. The mean over x, τ and these values is the estimate E,
//! and the standard deviation is its standard uncertainty (JCGM 101:2008, 6.4). So few poses give a large uncertainty, and
//! the noise is removed from the distribution rather than from a single number.

use std::collections::BTreeMap;
use std::convert::Infallible;

use poegp_protocol::cause::Cause;
use statrs::function::beta::beta_reg;

use crate::numeric::parallel::in_order;
use crate::progress::threads;
use crate::trust::{Finding, Tier};
use crate::validation::conformity::error_family::{ErrorFamily, SHARE};
use crate::validation::held_out::HeldOutPose;

/// α: number of poses that the base distribution F₀ counts as much as.
const GUESS: f64 = 10.0;
/// Number of values of x, in equal ratios from the median of the errors to [`REACH`] times the largest.
const VALUES: usize = 400;
const REACH: f64 = 4.0;
/// Poses for each degree of freedom of the uncertainty: from n poses, the relative uncertainty of the uncertainty is √(2/n)
/// (GUM G.3).
const POSES_PER_FREEDOM: f64 = 4.0;

/// The errors of the distinct poses: for each pose the mean square of its measurements, so that the arm's repeatability is in
/// them, however often a pose was measured.
#[derive(Clone, Debug)]
pub struct Distinct {
    /// Mean square of the errors of each distinct pose, in mm² or mrad².
    squares: Vec<f64>,
    /// Pooled variance of one component of repeated measurements, mm² or mrad², and its degrees of freedom; `None` if no
    /// pose repeats.
    pub repeated: Option<(f64, f64)>,
    /// Standard deviation of one component that the rows declare (root mean square), mm or mrad; `None` if a row declares
    /// none.
    pub declared: Option<f64>,
}

impl Distinct {
    /// Collects the errors of position or rotation. `repeats` holds, for each pose, the number of its distinct pose, or is
    /// empty if none repeats. Returns `None` if rotations are asked for and a pose has none.
    pub fn of(poses: &[HeldOutPose], repeats: &[usize], rotation: bool) -> Option<Self> {
        let first = if rotation { 3 } else { 0 };
        let mut groups: BTreeMap<usize, Vec<[f64; 3]>> = BTreeMap::new();
        let mut declared = Some(0.0);
        for (i, pose) in poses.iter().enumerate() {
            if rotation && pose.error.orientation_mrad.is_none() {
                return None;
            }
            let residual = core::array::from_fn(|axis| 1e3 * pose.residual[first + axis]);
            let group = repeats.get(i).copied().unwrap_or(i);
            groups.entry(group).or_default().push(residual);
            let own = match rotation {
                true => pose.noise.orientation,
                false => pose.noise.position,
            };
            declared = declared
                .zip(own)
                .map(|(sum, sigma)| sum + (1e3 * sigma).powi(2));
        }
        let square = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
        let mut squares = Vec::with_capacity(groups.len());
        let (mut scatter, mut freedom) = (0.0, 0.0);
        for group in groups.values() {
            let count = group.len() as f64;
            let mean: [f64; 3] =
                core::array::from_fn(|axis| group.iter().map(|r| r[axis]).sum::<f64>() / count);
            squares.push(group.iter().map(|r| square(*r)).sum::<f64>() / count);
            let from_mean = |r: &[f64; 3]| square(core::array::from_fn(|i| r[i] - mean[i]));
            scatter += group.iter().map(from_mean).sum::<f64>();
            freedom += 3.0 * (count - 1.0);
        }
        Some(Self {
            squares,
            repeated: (freedom > 0.0).then(|| (scatter / freedom, freedom)),
            declared: declared.map(|sum| (sum / poses.len().max(1) as f64).sqrt()),
        })
    }

    /// Returns the number of distinct poses.
    pub fn poses(&self) -> usize {
        self.squares.len()
    }
}

/// The noise of a measured error, as far as it is known.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// Standard deviation of one component of one measurement, mm or mrad; zero if it is not known.
    pub sigma: f64,
    /// Degrees of freedom of `sigma` if repeated measurements show that it is less than the file declares.
    pub repeated: Option<f64>,
    /// Whether the errors are certainly smaller than the stated noise, which then is not removed from them.
    pub is_contradicted: bool,
    /// Whether `sigma` is that of the fit, because the file declares much more.
    pub is_fitted: bool,
}

/// Share of the declared noise below which a fitted one counts in its place: two standard uncertainties of a declared noise, and
/// some for the parameters that follow the noise.
const OVERSTATED: f64 = 0.5;

/// Returns the finding that a file declares much more noise of positions than a fit finds, both in mm. A verdict then removes
/// the fitted noise.
pub fn overstated(declared_mm: f64, fitted_mm: f64) -> Option<Finding> {
    let (ratio, most) = (declared_mm / fitted_mm, 1.0 / OVERSTATED);
    let text = format!(
        "a standard uncertainty of {declared_mm:.4} mm is stated, but the fitted noise of one component is {fitted_mm:.4} mm: \
         state the standard uncertainty of one component (--position-sigma-mm, or the column sigma_mm); a verdict uses the \
         fitted noise"
    );
    (ratio > most).then(|| Finding::new(Cause::Noise, Tier::Warning, text, ratio, most))
}

/// Degrees of freedom from which repeated measurements limit the noise that the file declares.
const ENOUGH: f64 = 10.0;
/// Relative standard uncertainty of a noise that a file declares.
pub const DECLARED_NOISE_UNCERTAINTY: f64 = 0.2;
/// Number of values of the noise's standard deviation that are tried. They are evenly spaced and reach [`REACH_OF_NOISES`]
/// standard uncertainties to both sides of the known value.
const NOISES: usize = 9;
const REACH_OF_NOISES: f64 = 3.0;
/// Largest relative standard uncertainty of the noise's standard deviation; it keeps the least value that is tried above 0.
const LARGEST_UNCERTAINTY: f64 = 0.3;
/// Number of standard uncertainties by which the noise may credibly be smaller than its known value.
const CREDIBLE: f64 = 2.0;
/// Number of standard deviations of a mean square below its expectation from which it is certainly smaller.
const CONTRADICTION: f64 = 3.0;

impl Noise {
    /// Takes the noise that the rows declare. The scatter of repeated measurements has the arm's repeatability in it, too, which
    /// is an error of the arm. It therefore only limits the noise. So does the standard deviation `fitted` of one component, in
    /// mm or mrad, that the model found: it has errors of the arm in it that the model does not describe.
    pub fn of(distinct: &Distinct, fitted: Option<f64>) -> Self {
        let declared = distinct.declared.unwrap_or(0.0);
        let fitted = fitted.filter(|fitted| *fitted < OVERSTATED * declared);
        let declared = fitted.unwrap_or(declared).powi(2);
        let is_less = |(variance, freedom): &(f64, f64)| *freedom >= ENOUGH && *variance < declared;
        let repeated = distinct.repeated.filter(is_less);
        let variance = repeated.map_or(declared, |(variance, _)| variance);
        let repeated = repeated.map(|(_, freedom)| freedom);
        // The errors contradict the noise if they are certainly smaller than its least credible value.
        let least = variance * (1.0 - CREDIBLE * relative_uncertainty(repeated)).powi(2);
        let freedom = 3.0 * distinct.poses() as f64;
        let found = distinct.squares.iter().sum::<f64>() / freedom;
        let is_contradicted = found < least * (1.0 - CONTRADICTION * (2.0 / freedom).sqrt());
        Self {
            sigma: if is_contradicted {
                0.0
            } else {
                variance.sqrt()
            },
            repeated,
            is_contradicted,
            is_fitted: fitted.is_some(),
        }
    }

    /// Returns the relative standard uncertainty of the noise's standard deviation.
    pub fn relative_uncertainty(&self) -> f64 {
        relative_uncertainty(self.repeated)
    }
}

/// Returns the relative standard uncertainty of a standard deviation with these degrees of freedom, or of a declared one for
/// `None`.
fn relative_uncertainty(repeated: Option<f64>) -> f64 {
    repeated.map_or(DECLARED_NOISE_UNCERTAINTY, |freedom| {
        (1.0 / (2.0 * freedom).sqrt()).min(LARGEST_UNCERTAINTY)
    })
}

/// The estimate of the quantile, mm or mrad.
#[derive(Clone, Copy, Debug)]
pub struct Quantile {
    /// E: the quantile.
    pub error: f64,
    /// Standard uncertainty of E from the small number of poses.
    pub of_few_poses: f64,
    /// Degrees of freedom of `of_few_poses`.
    pub freedom: f64,
    /// Standard uncertainty of E from the uncertainty of the noise.
    pub of_noise: f64,
}

/// Estimates the quantile of the errors of these poses, with `noise` removed.
///
/// The standard deviation of the noise is itself uncertain. Each of its values is weighted by its prior and by the
/// probability of the errors with it. By the law of total variance, the uncertainty of E has two parts: the mean of the
/// variances at these values comes from the small number of poses, and the variance of the means comes from the noise.
pub fn estimate(distinct: &Distinct, noise: &Noise) -> Quantile {
    let change = noise.relative_uncertainty();
    let count = if noise.sigma > 0.0 { NOISES } else { 1 };
    let with = |i: usize| {
        let z = REACH_OF_NOISES * (2.0 * i as f64 / (NOISES - 1) as f64 - 1.0);
        let sigma = noise.sigma * (1.0 + change * z);
        Some((libm::exp(-0.5 * z * z), posterior(distinct, sigma)?))
    };
    let mut found: Vec<(f64, Posterior)> = Vec::new();
    let mut noises = 0..count;
    let Ok(()) = in_order(
        threads(),
        || Ok::<_, Infallible>(noises.next()),
        with,
        |result| {
            found.extend(result);
            Ok(())
        },
    );
    let most = found.iter().map(|(_, p)| p.evidence);
    let most = most.fold(f64::NEG_INFINITY, f64::max);
    let weight = |(p, found): &(f64, Posterior)| p * libm::exp(found.evidence - most);
    let whole: f64 = found.iter().map(weight).sum();
    let mean = |of: &dyn Fn(&Posterior) -> f64| match found.is_empty() {
        true => 0.0,
        false => found.iter().map(|x| weight(x) * of(&x.1)).sum::<f64>() / whole,
    };
    let error = mean(&|p| p.mean);
    Quantile {
        error,
        of_few_poses: mean(&|p| p.variance).sqrt(),
        freedom: distinct.poses() as f64 / POSES_PER_FREEDOM,
        of_noise: mean(&|p| (p.mean - error).powi(2)).sqrt(),
    }
}

/// The posterior distribution of the quantile for a known noise.
struct Posterior {
    mean: f64,
    variance: f64,
    /// Logarithm of the probability of the errors with this noise.
    evidence: f64,
}

/// Computes the posterior for noise of `sigma` in one component of one measurement; returns `None` if all errors are zero.
fn posterior(distinct: &Distinct, sigma: f64) -> Option<Posterior> {
    let family = ErrorFamily::fitted(&distinct.squares, sigma)?;
    let mut errors: Vec<f64> = distinct.squares.iter().map(|e| e.sqrt()).collect();
    errors.sort_by(f64::total_cmp);
    let count = errors.len();
    let largest = errors[count - 1];
    let first = errors[count / 2].max(1e-3 * largest);
    let ratio = libm::pow(REACH * largest / first, 1.0 / (VALUES - 1) as f64);
    let tables = family.without_noise();
    let (mut sum, mut sum_of_squares, mut before) = (0.0, 0.0, 0.0);
    for i in 0..VALUES {
        let x = first * ratio.powi(i as i32);
        let guess = GUESS * family.below(x);
        let below = errors.partition_point(|e| *e <= x) as f64;
        let above = (GUESS - guess + count as f64 - below).max(1e-9);
        // All probability beyond the last value of x counts as that value.
        let until = match i + 1 < VALUES {
            true => 1.0 - beta_reg(guess + below, above, SHARE),
            false => 1.0,
        };
        for table in &tables {
            let weight = table.probability * (until - before).max(0.0);
            let quantile = table.quantile(x);
            sum += weight * quantile;
            sum_of_squares += weight * quantile * quantile;
        }
        before = until.max(before);
    }
    Some(Posterior {
        mean: sum,
        variance: (sum_of_squares - sum * sum).max(0.0),
        evidence: family.evidence,
    })
}
