//! A family of distributions of errors, in which the size of the model's error differs from pose to pose.
//!
//! The residual of pose i, in position or in rotation, is modelled as
//!
//! ```text
//! r_i ~ N(0, (s_i² + v) I₃)        ln s_i ~ N(μ, τ²)
//! ```
//!
//! where v is the known variance of its noise. The posterior distribution is computed on a grid over (μ, τ). The prior is
//! uniform in exp μ and in τ (Gelman, Bayesian Analysis 2006, on the standard deviation of groups). With a prior uniform in
//! μ, an arm that is better than its noise would be taken for one that has hardly any error.

use std::f64::consts::{PI, SQRT_2};

/// Share of the poses whose error does not exceed the quantile.
pub(super) const SHARE: f64 = 0.95;
/// Number of values of μ. The first grid reaches from [`BELOW`] under to [`ABOVE`] over the ln s that
/// all poses have in the mean.
const LOCATIONS: usize = 25;
const BELOW: f64 = 2.2;
const ABOVE: f64 = 1.0;
/// Number of values of τ. The first grid reaches up to [`MOST_SPREAD`], where one pose of twenty has fourteen times the
/// error of the median.
const SPREADS: usize = 13;
const MOST_SPREAD: f64 = 1.6;
/// Half-width of the second grid about the mean of the first, in standard deviations of the first.
const REACH: f64 = 4.5;
/// Number of values of s for each pair of μ and τ, half a standard deviation of ln s apart (trapezoidal rule).
const NODES: usize = 15;
const NODE_STEP: f64 = 0.5;
/// Number of values of s in the mixture over all pairs.
const VALUES: usize = 150;
/// Number of ratios of s to the noise in a table of quantiles, in equal logarithmic steps from far below the noise to far
/// above it.
const RATIOS: usize = 40;
const LEAST_RATIO: f64 = -3.0;
const LARGEST_RATIO: f64 = 6.0;
/// Relative precision of a quantile, and the most halvings of its range.
const PRECISION: f64 = 1e-9;
const MOST_HALVINGS: usize = 60;
/// Pairs whose probability is below this share of the most probable one's are left out.
const NEGLIGIBLE: f64 = 1e-6;
/// Least share of the residuals' mean square that is taken to remain without the noise, where the grid is centred.
const LEAST_LEFT: f64 = 0.02;

/// The distribution of s for μ = 0.
struct Shape {
    /// Squares of the values of s, with their weights.
    squares: [(f64, f64); NODES],
}

impl Shape {
    /// Creates the distribution for τ = `spread`.
    fn new(spread: f64) -> Self {
        let squares = core::array::from_fn(|k| {
            let z = NODE_STEP * (k as f64 - (NODES / 2) as f64);
            let weight = NODE_STEP / (2.0 * PI).sqrt() * libm::exp(-0.5 * z * z);
            (libm::exp(2.0 * spread * z), weight)
        });
        Self { squares }
    }

    /// Returns the probability that the error is at most `x`, for s scaled by `scale` and the noise variance `noise`.
    fn below(&self, x: f64, scale: f64, noise: f64) -> f64 {
        let of = |(square, weight): &(f64, f64)| {
            weight * chi_3(x / (scale * scale * square + noise).sqrt())
        };
        self.squares.iter().map(of).sum()
    }

    /// Returns the quantile of the error, which lies between `lower` and `upper`.
    fn quantile(&self, scale: f64, noise: f64, (mut lower, mut upper): (f64, f64)) -> f64 {
        // Bisection works because the function rises from 0 to 1.
        for _ in 0..MOST_HALVINGS {
            if upper - lower <= PRECISION * upper {
                break;
            }
            let middle = 0.5 * (lower + upper);
            match self.below(middle, scale, noise) < SHARE {
                true => lower = middle,
                false => upper = middle,
            }
        }
        0.5 * (lower + upper)
    }
}

/// Returns the probability that the length of three standard normal components is at most `x`.
fn chi_3(x: f64) -> f64 {
    libm::erf(x / SQRT_2) - (2.0 / PI).sqrt() * x * libm::exp(-0.5 * x * x)
}

/// The posterior distribution of the family.
pub(super) struct ErrorFamily {
    /// For each τ, its distribution of s and, for each μ, the factor of s and the probability of the pair.
    spreads: Vec<(Shape, Vec<(f64, f64)>)>,
    /// Squares of s over all pairs, with their probabilities.
    mixture: Vec<(f64, f64)>,
    /// Noise variance of one component.
    noise: f64,
    /// Logarithm of the probability of the errors with this noise, up to a constant.
    pub(super) evidence: f64,
}

impl ErrorFamily {
    /// Fits the family to `squares`, those of the errors; `sigma` is the noise of one component of one measurement. Returns
    /// `None` if all errors are zero.
    pub(super) fn fitted(squares: &[f64], sigma: f64) -> Option<Self> {
        let poses = squares.len() as f64;
        let variance = sigma * sigma;
        let of = |square: &f64| (square / 3.0, (square - 3.0 * variance) / 3.0);
        let (all, left) = squares
            .iter()
            .map(of)
            .fold((0.0, 0.0), |sum, x| (sum.0 + x.0, sum.1 + x.1));
        let centre = 0.5 * libm::log(left.max(LEAST_LEFT * all) / poses);
        if !centre.is_finite() {
            return None;
        }
        let whole = Grid::new(
            squares,
            sigma,
            (centre - BELOW, centre + ABOVE),
            (0.0, MOST_SPREAD),
        );
        let about = |mean: f64, deviation: f64, least: f64, most: f64| {
            let reach = REACH * deviation;
            ((mean - reach).max(least), (mean + reach).min(most))
        };
        let (location, spread) = (whole.moments(|p| p.location), whole.moments(|p| p.spread));
        // At least one step of the first grid, which may have missed the maximum.
        let locations = location.1.max((BELOW + ABOVE) / (LOCATIONS - 1) as f64);
        let spreads = spread.1.max(MOST_SPREAD / (SPREADS - 1) as f64);
        let near = Grid::new(
            squares,
            sigma,
            about(location.0, locations, centre - BELOW, centre + ABOVE),
            about(spread.0, spreads, 0.0, MOST_SPREAD),
        );
        let spreads = near.by_spread();
        Some(Self {
            mixture: mixture(&spreads),
            spreads,
            noise: variance,
            evidence: near.evidence(),
        })
    }

    /// Returns the probability that an error, including its noise, is at most `x`.
    pub(super) fn below(&self, x: f64) -> f64 {
        let of = |(square, weight): &(f64, f64)| weight * chi_3(x / (square + self.noise).sqrt());
        self.mixture.iter().map(of).sum()
    }

    /// Returns, for each τ, the table that turns a quantile with noise into one without.
    pub(super) fn without_noise(&self) -> Vec<Denoised> {
        let of = |(shape, locations): &(Shape, Vec<(f64, f64)>)| {
            let sigma = self.noise.sqrt();
            let mut quantiles = Vec::new();
            if sigma > 0.0 {
                let of_noise = shape.quantile(0.0, self.noise, (0.0, 10.0 * sigma));
                let own = shape.quantile(1.0, 0.0, (0.0, 1e3));
                quantiles.push((of_noise, 0.0));
                let step = (LARGEST_RATIO - LEAST_RATIO) / (RATIOS - 1) as f64;
                let mut before = of_noise;
                for i in 0..RATIOS {
                    let scale = sigma * libm::exp(LEAST_RATIO + step * i as f64);
                    // If the noise were scaled with s, the quantile would grow by exp(step).
                    let most = match i {
                        0 => 1.1 * (of_noise + scale * own),
                        _ => before * libm::exp(step),
                    };
                    before = shape.quantile(scale, self.noise, (before, most));
                    quantiles.push((before, scale * own));
                }
            }
            Denoised {
                probability: locations.iter().map(|(_, p)| p).sum(),
                quantiles,
            }
        };
        self.spreads.iter().map(of).collect()
    }
}

/// Collects the values of s of all pairs on [`VALUES`] logarithmically even steps; each value is shared by its two
/// neighbouring steps.
fn mixture(spreads: &[(Shape, Vec<(f64, f64)>)]) -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = Vec::new();
    for (shape, locations) in spreads {
        for (scale, probability) in locations {
            let of = |(square, weight): &(f64, f64)| {
                (libm::log(scale * scale * square), weight * probability)
            };
            all.extend(shape.squares.iter().map(of));
        }
    }
    let logs = all.iter().map(|(log, _)| *log);
    let first = logs.clone().fold(f64::INFINITY, f64::min);
    let last = logs.fold(f64::NEG_INFINITY, f64::max);
    let step = ((last - first) / (VALUES - 1) as f64).max(f64::MIN_POSITIVE);
    let mut weights = vec![0.0; VALUES + 1];
    for (log, weight) in all {
        let at = (log - first) / step;
        let before = (at as usize).min(VALUES - 1);
        let part = at - before as f64;
        weights[before] += weight * (1.0 - part);
        weights[before + 1] += weight * part;
    }
    let value = |(i, weight): (usize, f64)| (libm::exp(first + step * i as f64), weight);
    weights.into_iter().enumerate().map(value).collect()
}

/// Table of quantiles with noise and without, for one τ.
pub(super) struct Denoised {
    pub(super) probability: f64,
    /// Pairs of a quantile with noise and the one without, rising; empty if there is no noise.
    quantiles: Vec<(f64, f64)>,
}

impl Denoised {
    /// Returns the quantile without noise that becomes `x` with noise; 0 if the quantile of the noise alone is larger than
    /// `x`.
    pub(super) fn quantile(&self, x: f64) -> f64 {
        let table = &self.quantiles;
        let Some((last, of_last)) = table.last() else {
            return x;
        };
        let after = table.partition_point(|(with, _)| *with <= x);
        if after == 0 {
            return 0.0;
        }
        if after == table.len() {
            return x * of_last / last;
        }
        let ((x0, y0), (x1, y1)) = (table[after - 1], table[after]);
        y0 + (y1 - y0) * (x - x0) / (x1 - x0)
    }
}

/// A pair of μ and τ, with the logarithm of its likelihood times its prior.
struct Pair {
    location: f64,
    spread: f64,
    log: f64,
}

/// Evenly spaced pairs of μ and τ.
struct Grid(Vec<Pair>);

impl Grid {
    fn new(squares: &[f64], sigma: f64, locations: (f64, f64), spreads: (f64, f64)) -> Self {
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
                // Rate and factor of the density at every node.
                let density = shape.squares.map(|(square, weight)| {
                    let v = scale * scale * square + sigma * sigma;
                    (-0.5 / v, weight / (v * v.sqrt()))
                });
                let likelihood = |square: &f64| {
                    let at_node = |(rate, weight): &(f64, f64)| weight * libm::exp(rate * square);
                    // A pose far beyond the reach of a pair rules the pair out.
                    libm::log(density.iter().map(at_node).sum::<f64>())
                };
                pairs.push(Pair {
                    location,
                    spread,
                    log: location + squares.iter().map(likelihood).sum::<f64>(),
                });
            }
        }
        Self(pairs)
    }

    fn most_probable(&self) -> f64 {
        let logs = self.0.iter().map(|p| p.log);
        logs.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the logarithm of the probability of the errors, which is the integral over the grid.
    fn evidence(&self) -> f64 {
        let (Some(first), Some(last)) = (self.0.first(), self.0.last()) else {
            return f64::NEG_INFINITY;
        };
        let most = self.most_probable();
        let sum: f64 = self.0.iter().map(|p| libm::exp(p.log - most)).sum();
        let area = (last.location - first.location) / (LOCATIONS - 1) as f64
            * ((last.spread - first.spread) / (SPREADS - 1) as f64);
        most + libm::log(sum * area)
    }

    /// Returns the mean and the standard deviation of a function of the pair.
    fn moments(&self, of: impl Fn(&Pair) -> f64) -> (f64, f64) {
        let most = self.most_probable();
        let expected = |of: &dyn Fn(&Pair) -> f64| -> f64 {
            let weighted = |p: &Pair| libm::exp(p.log - most) * of(p);
            self.0.iter().map(weighted).sum()
        };
        let whole = expected(&|_| 1.0);
        let mean = expected(&|p| of(p)) / whole;
        let variance = expected(&|p| (of(p) - mean).powi(2)) / whole;
        (mean, variance.sqrt())
    }

    /// Returns, for each τ, the distribution of s with the factors and probabilities of its pairs.
    fn by_spread(&self) -> Vec<(Shape, Vec<(f64, f64)>)> {
        let most = self.most_probable();
        let share = |p: &Pair| Some(libm::exp(p.log - most)).filter(|share| *share > NEGLIGIBLE);
        let whole: f64 = self.0.iter().filter_map(share).sum();
        let pairs = self.0.chunk_by(|a, b| a.spread == b.spread);
        let of = |pairs: &[Pair]| {
            let pair = |p: &Pair| Some((libm::exp(p.location), share(p)? / whole));
            let found: Vec<(f64, f64)> = pairs.iter().filter_map(pair).collect();
            let shape = Shape::new(pairs[0].spread);
            (!found.is_empty()).then_some((shape, found))
        };
        pairs.filter_map(of).collect()
    }
}
