//! The error that 95 of 100 poses do not exceed, from few poses, without the noise of the instrument.
//!
//! The distribution F of the measured errors e_i = |r_i| has a Dirichlet process as its prior (Ferguson, Annals of Statistics
//! 1973), whose guess F₀ is a fitted family (`error_family`) and counts as much as α poses. So the tail beyond the
//! largest error is that of the family, and everything below is that of the poses, whatever their distribution:
//!
//! ```text
//! F(x) ~ Beta(α F₀(x) + N(x), α (1 − F₀(x)) + n − N(x))        N(x) = #{e_i ≤ x}
//! P(Q ≤ x) = P(F(x) ≥ 0.95)
//! ```
//!
//! Without noise the quantile Q of the measured errors is that of the arm; else the family says which quantile of the arm gives
//! Q with the noise, for each of the values that the noise may have. The mean over x, τ and these values is the estimate E,
//! and its standard deviation the standard uncertainty (JCGM 101:2008, 6.4). So few poses state a large uncertainty, and
//! the noise is taken out of the distribution, not out of a number.

use std::collections::BTreeMap;
use std::convert::Infallible;

use statrs::function::beta::beta_reg;

use crate::numeric::parallel::in_order;
use crate::progress::threads;
use crate::validation::conformity::error_family::{ErrorFamily, SHARE};
use crate::validation::held_out::HeldOutPose;

/// α: the poses that the guess counts as much as.
const GUESS: f64 = 10.0;
/// Values of x, from the median of the errors to [`REACH`] times the largest, in equal ratios.
const VALUES: usize = 400;
const REACH: f64 = 4.0;
/// Poses for each degree of freedom of the uncertainty: with n poses it is known to √(2/n) of itself (GUM G.3).
const POSES_PER_FREEDOM: f64 = 4.0;

/// The errors of the poses that differ: of each the mean of its measurements, which ISO 9283 calls its barycentre.
#[derive(Clone, Debug)]
pub struct Distinct {
    /// Square of the distance of each mean from what was predicted, and its measurements; mm² or mrad².
    squares: Vec<(f64, f64)>,
    /// Pooled variance of one component of repeated measurements, mm² or mrad², and its degrees of freedom.
    pub repeated: Option<(f64, f64)>,
    /// Standard deviation of one component that the rows declare (root mean square), mm or mrad.
    pub declared: Option<f64>,
}

impl Distinct {
    /// Collects the errors of position or rotation. `repeats` holds, for each pose, the number of its distinct pose, or
    /// is empty where none repeats. `None` where rotations are asked for and a pose has none.
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
            squares.push((square(mean), count));
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

    /// Poses that differ.
    pub fn poses(&self) -> usize {
        self.squares.len()
    }
}

/// The noise of a measured error, as far as it is known.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// Standard deviation of one component of one measurement, mm or mrad; zero where it is not known.
    pub sigma: f64,
    /// Its degrees of freedom where repeated measurements show it; `None` where the file declares it.
    pub repeated: Option<f64>,
    /// Whether the errors are certainly smaller than the noise that is said to be in them, which then stays in.
    pub is_contradicted: bool,
}

/// Degrees of freedom from which on repeated measurements are believed rather than the file.
const ENOUGH: f64 = 10.0;
/// Relative standard uncertainty of a noise that a file declares.
pub const DECLARED_NOISE_UNCERTAINTY: f64 = 0.2;
/// The standard deviation of the noise is tried at so many values, evenly spaced, and up to so many standard uncertainties to both
/// sides of the one that is known.
const NOISES: usize = 9;
const REACH_OF_NOISES: f64 = 3.0;
/// The largest relative standard uncertainty of it: the least value must stay above 0.
const LARGEST_UNCERTAINTY: f64 = 0.3;
/// Standard uncertainties by which the noise is credibly smaller than what is known of it.
const CREDIBLE: f64 = 2.0;
/// Standard deviations of a mean square from which on it is certainly smaller.
const CONTRADICTION: f64 = 3.0;

impl Noise {
    /// Takes the noise from repeated measurements where there are enough, else from what the rows declare.
    pub fn of(distinct: &Distinct) -> Self {
        let repeated = distinct
            .repeated
            .filter(|(_, freedom)| *freedom >= ENOUGH || distinct.declared.is_none());
        let declared = distinct.declared.map(|sigma| sigma * sigma);
        let variance = match (repeated, declared) {
            (Some((variance, _)), _) => variance,
            (None, Some(variance)) => variance,
            (None, None) => 0.0,
        };
        let repeated = repeated.map(|(_, freedom)| freedom);
        // Errors contradict a noise when they are certainly smaller than the least value that it credibly has.
        let least = variance * (1.0 - CREDIBLE * relative_uncertainty(repeated)).powi(2);
        let freedom = 3.0 * distinct.poses() as f64;
        let of = |(square, count): &(f64, f64)| square * count;
        let found = distinct.squares.iter().map(of).sum::<f64>() / freedom;
        let is_contradicted = found < least * (1.0 - CONTRADICTION * (2.0 / freedom).sqrt());
        Self {
            sigma: if is_contradicted {
                0.0
            } else {
                variance.sqrt()
            },
            repeated,
            is_contradicted,
        }
    }

    /// Relative standard uncertainty of the standard deviation.
    pub fn relative_uncertainty(&self) -> f64 {
        relative_uncertainty(self.repeated)
    }
}

/// Relative standard uncertainty of a standard deviation with these degrees of freedom, or of one that is declared.
fn relative_uncertainty(repeated: Option<f64>) -> f64 {
    repeated.map_or(DECLARED_NOISE_UNCERTAINTY, |freedom| {
        (1.0 / (2.0 * freedom).sqrt()).min(LARGEST_UNCERTAINTY)
    })
}

/// The estimate of the quantile, mm or mrad.
#[derive(Clone, Copy, Debug)]
pub struct Quantile {
    /// E.
    pub error: f64,
    /// Its standard uncertainty: so few poses were seen.
    pub of_few_poses: f64,
    /// The degrees of freedom of that.
    pub freedom: f64,
    /// What the uncertainty of the noise adds to it.
    pub of_noise: f64,
}

/// The quantile of the errors of these poses, `noise` taken out.
///
/// The standard deviation of the noise is itself uncertain. Each of its values is weighted by its prior and by the probability
/// of the errors with it. By the law of total variance the uncertainty of E has two parts: the mean of the variances at these
/// values is what few poses add, and the variance of the means is what the noise adds.
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

/// The distribution of the quantile with a noise that is known.
struct Posterior {
    mean: f64,
    variance: f64,
    /// Logarithm of the probability of the errors.
    evidence: f64,
}

/// Where one component of one measurement has noise of `sigma`; `None` of errors that are all zero.
fn posterior(distinct: &Distinct, sigma: f64) -> Option<Posterior> {
    let family = ErrorFamily::fitted(&distinct.squares, sigma)?;
    let mut errors: Vec<f64> = distinct.squares.iter().map(|(e, _)| e.sqrt()).collect();
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
        // What is beyond the last value counts as that.
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
