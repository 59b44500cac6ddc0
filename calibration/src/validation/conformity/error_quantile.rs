//! The error that 95 of 100 poses do not exceed, from few poses, without the noise of the instrument.
//!
//! Poses differ in how far the model is off. The residual of pose i, of position or of rotation, is taken as
//!
//! ```text
//! r_i ~ N(0, (s_i² + v_i) I₃)        ln s_i ~ N(μ, τ²)
//! ```
//!
//! with the known variance v_i of its noise. A grid over (μ, τ), flat in both, carries the posterior distribution of the
//! quantile of s χ₃; its mean is the estimate E and its standard deviation the standard uncertainty (JCGM 101:2008, 6.4).
//! So few poses state a large uncertainty, and the noise is taken out of the distribution, not out of a number.

use std::collections::BTreeMap;
use std::f64::consts::{PI, SQRT_2};

use crate::validation::held_out::HeldOutPose;

/// Share of the poses whose error does not exceed the quantile.
const SHARE: f64 = 0.95;
/// Values of μ, at first from [`BELOW`] under to [`ABOVE`] over what all poses have in the mean.
const LOCATIONS: usize = 25;
const BELOW: f64 = 2.2;
const ABOVE: f64 = 1.0;
/// Values of τ, at first up to the largest: with it, one pose of twenty is fourteen times as far off as the median.
const SPREADS: usize = 13;
const MOST_SPREAD: f64 = 1.6;
/// The grid is laid again, so many standard deviations of the first about its mean.
const REACH: f64 = 4.5;
/// Values of s for each pair, half a standard deviation of ln s apart (trapezoidal rule).
const NODES: usize = 15;
const NODE_STEP: f64 = 0.5;
/// The least share of the mean square of the residuals that noise is taken to leave, where the grid is centred.
const LEAST_LEFT: f64 = 0.02;

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
    /// Of position or rotation; `repeats` has the number of the distinct pose of each, or is empty where none repeats. `None`
    /// without rotations.
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
const DECLARED: f64 = 0.2;
/// Standard deviations of a mean square from which on it is certainly smaller.
const CONTRADICTION: f64 = 3.0;

impl Noise {
    /// Of repeated measurements where there are enough, else what the rows declare.
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
        // Errors that are certainly smaller than the noise in them contradict it.
        let freedom = 3.0 * distinct.poses() as f64;
        let of = |(square, count): &(f64, f64)| square * count;
        let found = distinct.squares.iter().map(of).sum::<f64>() / freedom;
        let is_contradicted = found < variance * (1.0 - CONTRADICTION * (2.0 / freedom).sqrt());
        Self {
            sigma: if is_contradicted {
                0.0
            } else {
                variance.sqrt()
            },
            repeated: repeated.map(|(_, freedom)| freedom),
            is_contradicted,
        }
    }

    /// Relative standard uncertainty of the standard deviation.
    pub fn relative_uncertainty(&self) -> f64 {
        self.repeated
            .map_or(DECLARED, |freedom| 1.0 / (2.0 * freedom).sqrt())
    }
}

/// The estimate of the quantile, mm or mrad.
#[derive(Clone, Copy, Debug)]
pub struct Quantile {
    /// E.
    pub error: f64,
    /// Its standard uncertainty: so few poses were seen.
    pub of_few_poses: f64,
    /// What the uncertainty of the noise adds to it.
    pub of_noise: f64,
}

/// The quantile of the errors of these poses, `noise` taken out.
pub fn estimate(distinct: &Distinct, noise: &Noise) -> Quantile {
    let (error, of_few_poses) = posterior(distinct, noise.sigma);
    let change = noise.relative_uncertainty();
    // Outwards, for the estimate stops at 0 inwards.
    let of_noise = match noise.sigma > 0.0 {
        true => error - posterior(distinct, noise.sigma * (1.0 + change)).0,
        false => 0.0,
    };
    Quantile {
        error,
        of_few_poses,
        of_noise: of_noise.abs(),
    }
}

/// A distribution of s for μ = 0.
struct Shape {
    /// Squares of the values, and their weights.
    squares: [(f64, f64); NODES],
    /// The quantile of s χ₃.
    quantile: f64,
}

impl Shape {
    /// Of τ.
    fn new(spread: f64) -> Self {
        let squares: [(f64, f64); NODES] = core::array::from_fn(|k| {
            let z = NODE_STEP * (k as f64 - (NODES / 2) as f64);
            let weight = NODE_STEP / (2.0 * PI).sqrt() * libm::exp(-0.5 * z * z);
            (libm::exp(2.0 * spread * z), weight)
        });
        let below = |x: f64| -> f64 {
            let of = |(square, weight): &(f64, f64)| weight * chi_3(x / square.sqrt());
            squares.iter().map(of).sum()
        };
        // Bisection: the function rises from 0 to 1.
        let (mut lower, mut upper) = (0.0, 1e3);
        for _ in 0..60 {
            let middle = 0.5 * (lower + upper);
            match below(middle) < SHARE {
                true => lower = middle,
                false => upper = middle,
            }
        }
        Self {
            squares,
            quantile: 0.5 * (lower + upper),
        }
    }
}

/// Probability that the length of three standard normal components is at most `x`.
fn chi_3(x: f64) -> f64 {
    libm::erf(x / SQRT_2) - (2.0 / PI).sqrt() * x * libm::exp(-0.5 * x * x)
}

/// Mean and standard deviation of the quantile, where one component of one measurement has noise of `sigma`.
fn posterior(distinct: &Distinct, sigma: f64) -> (f64, f64) {
    let poses = distinct.poses() as f64;
    let of =
        |(square, count): &(f64, f64)| (square / 3.0, (square - 3.0 * sigma * sigma / count) / 3.0);
    let (all, left) = distinct
        .squares
        .iter()
        .map(of)
        .fold((0.0, 0.0), |sum, x| (sum.0 + x.0, sum.1 + x.1));
    let centre = 0.5 * libm::log(left.max(LEAST_LEFT * all) / poses);
    if !centre.is_finite() {
        return (0.0, 0.0);
    }
    let whole = Grid::new(
        distinct,
        sigma,
        (centre - BELOW, centre + ABOVE),
        (0.0, MOST_SPREAD),
    );
    let about = |mean: f64, deviation: f64, least: f64, most: f64| {
        let reach = REACH * deviation;
        ((mean - reach).max(least), (mean + reach).min(most))
    };
    let (location, spread) = (whole.moments(|p| p.location), whole.moments(|p| p.spread));
    // No narrower than between two values of the first: it may have missed the top.
    let locations = location.1.max((BELOW + ABOVE) / (LOCATIONS - 1) as f64);
    let spreads = spread.1.max(MOST_SPREAD / (SPREADS - 1) as f64);
    let near = Grid::new(
        distinct,
        sigma,
        about(location.0, locations, centre - BELOW, centre + ABOVE),
        about(spread.0, spreads, 0.0, MOST_SPREAD),
    );
    near.moments(|p| p.quantile)
}

/// A pair of μ and τ, with the logarithm of its likelihood.
struct Pair {
    location: f64,
    spread: f64,
    quantile: f64,
    log: f64,
}

/// Evenly spaced pairs.
struct Grid(Vec<Pair>);

impl Grid {
    fn new(distinct: &Distinct, sigma: f64, locations: (f64, f64), spreads: (f64, f64)) -> Self {
        let at = |(from, to): (f64, f64), i: usize, count: usize| {
            from + (to - from) * i as f64 / (count - 1) as f64
        };
        let mut pairs = Vec::with_capacity(LOCATIONS * SPREADS);
        for j in 0..SPREADS {
            let spread = at(spreads, j, SPREADS);
            let shape = Shape::new(spread);
            for i in 0..LOCATIONS {
                let location = at(locations, i, LOCATIONS);
                let scale = libm::exp(location);
                let squares = shape.squares.map(|(square, w)| (scale * scale * square, w));
                let likelihood = |(square, count): &(f64, f64)| {
                    let density = |(s, weight): &(f64, f64)| {
                        let v = s + sigma * sigma / count;
                        weight * libm::exp(-0.5 * square / v) / (v * v.sqrt())
                    };
                    // A pose beyond all reach of a pair rules it out.
                    libm::log(squares.iter().map(density).sum::<f64>())
                };
                pairs.push(Pair {
                    location,
                    spread,
                    quantile: scale * shape.quantile,
                    log: distinct.squares.iter().map(likelihood).sum(),
                });
            }
        }
        Self(pairs)
    }

    /// Mean and standard deviation of a function of the pair.
    fn moments(&self, of: impl Fn(&Pair) -> f64) -> (f64, f64) {
        let most = self
            .0
            .iter()
            .map(|p| p.log)
            .fold(f64::NEG_INFINITY, f64::max);
        let expected = |of: &dyn Fn(&Pair) -> f64| -> f64 {
            let weighted = |p: &Pair| libm::exp(p.log - most) * of(p);
            self.0.iter().map(weighted).sum()
        };
        let whole = expected(&|_| 1.0);
        let mean = expected(&|p| of(p)) / whole;
        let variance = expected(&|p| (of(p) - mean).powi(2)) / whole;
        (mean, variance.sqrt())
    }
}
