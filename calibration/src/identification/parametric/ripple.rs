//! Search for gear ripple: a periodogram of the residual through each joint's Jacobian column.
//!
//! Strain-wave and similar gears make errors of tens to hundreds of cycles per turn of the joint that no smooth
//! process can learn. For every frequency the residual is regressed on J_c sin kq and J_c cos kq; a term is accepted
//! when χ² drops by more than [`SIGNIFICANT`], which chance does less than once in several hundred searches.

use poegp_runtime::elastic::ripple::RippleTerm;

use crate::identification::parametric::state::ROWS;
use crate::measurement::sample::BaseSample;
use crate::numeric::matrix::Mat;
use crate::numeric::statistics::extremes;

/// Least drop of χ² of a significant term: two degrees of freedom, some 10⁴ independent frequencies a search, p ≈ 10⁻³.
pub const SIGNIFICANT: f64 = 32.0;
/// Range of frequencies that are searched, in cycles per turn.
pub const RANGE: (f64, f64) = (8.0, 420.0);

/// A peak of one joint's periodogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Frequency in cycles per turn of the joint.
    pub cycles: f64,
    /// Drop of χ² by a term of this frequency.
    pub drop: f64,
    /// Another frequency that fits the measured joint values as well, if there is one.
    pub alias: Option<f64>,
}

/// Least difference of two drops of χ² that distinguishes their frequencies: odds of 400 to 1.
const DISTINGUISHED: f64 = 12.0;
/// Least share of a term that its alias explains at the measured joint values.
const ALIKE: f64 = 0.5;
/// Lowest frequency of an alias, in cycles per turn.
const LOWEST_ALIAS: f64 = 1.0;

/// Residuals of all poses contracted with one joint's Jacobian column: all that is needed to test a frequency.
struct Contracted {
    q: Vec<f64>,
    /// J_cᵀ e of each pose.
    projection: Vec<f64>,
    /// J_cᵀ J_c of each pose.
    weight: Vec<f64>,
}

impl Contracted {
    /// Returns the drop of χ² by a term of `cycles`.
    fn drop(&self, cycles: f64) -> f64 {
        self.regressed(cycles, &self.projection).0
    }

    /// Returns the drop of χ² by a term of `cycles` for the given J_cᵀ e, with the term's sine and cosine amplitudes.
    fn regressed(&self, cycles: f64, projection: &[f64]) -> (f64, [f64; 2]) {
        let waves = self.q.iter().map(|q| libm::sincos(cycles * q));
        self.regressed_on(waves, projection)
    }

    /// Returns the frequencies from `first` to `last` in steps, each with its drop of χ². Sines and cosines of each
    /// frequency follow from those of the one before by rotation.
    fn scan(&self, first: f64, last: f64, step: f64) -> impl Iterator<Item = (f64, f64)> {
        let turned: Vec<(f64, f64)> = self.q.iter().map(|q| libm::sincos(step * q)).collect();
        let mut waves: Vec<(f64, f64)> = self.q.iter().map(|q| libm::sincos(first * q)).collect();
        let count = ((last - first) / step).max(-1.0) + 1.0;
        (0..count as usize).map(move |i| {
            let drop = self.regressed_on(waves.iter().copied(), &self.projection).0;
            for ((s, c), (by_s, by_c)) in waves.iter_mut().zip(&turned) {
                (*s, *c) = (*s * by_c + *c * by_s, *c * by_c - *s * by_s);
            }
            (first + step * i as f64, drop)
        })
    }

    /// Does [`Self::regressed`] for a term whose sine and cosine at the poses are `waves`.
    fn regressed_on(
        &self,
        waves: impl Iterator<Item = (f64, f64)>,
        projection: &[f64],
    ) -> (f64, [f64; 2]) {
        let (mut ss, mut sc, mut cc, mut bs, mut bc) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (((s, c), b), w) in waves.zip(projection).zip(&self.weight) {
            ss += w * s * s;
            sc += w * s * c;
            cc += w * c * c;
            bs += b * s;
            bc += b * c;
        }
        let determinant = ss * cc - sc * sc;
        // A joint that hardly moves cannot separate sine from cosine.
        if determinant < 1e-3 * ss * cc || ss * cc <= 0.0 {
            return (0.0, [0.0; 2]);
        }
        let drop = (cc * bs * bs - 2.0 * sc * bs * bc + ss * bc * bc) / determinant;
        let sin = (cc * bs - sc * bc) / determinant;
        let cos = (ss * bc - sc * bs) / determinant;
        (drop, [sin, cos])
    }

    /// Returns a frequency that explains the residual as well as `peak` does, because it resembles `peak` at these joint
    /// values.
    fn alias(&self, peak: &Peak, step: f64, width: f64) -> Option<f64> {
        let (whole, [sin, cos]) = self.regressed(peak.cycles, &self.projection);
        let term: Vec<f64> = self
            .q
            .iter()
            .zip(&self.weight)
            .map(|(q, w)| {
                let (s, c) = libm::sincos(peak.cycles * q);
                w * (sin * s + cos * c)
            })
            .collect();
        self.scan(LOWEST_ALIAS, RANGE.1, step)
            .filter(|(k, _)| (k - peak.cycles).abs() > width)
            .find(|(k, drop)| {
                whole - drop < DISTINGUISHED && self.regressed(*k, &term).0 > ALIKE * whole
            })
            .map(|(k, _)| k)
    }
}

impl Contracted {
    /// Contracts the residuals of all poses for one joint; residuals and Jacobian are in units of their noise.
    fn new(
        joint: usize,
        samples: &[BaseSample],
        residuals: &[[f64; ROWS]],
        jacobian: &Mat<f64>,
    ) -> Self {
        let row = |k: usize, b: usize| jacobian[(ROWS * k + b, joint)];
        let contract = |f: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
            (0..samples.len())
                .map(|k| (0..ROWS).map(|b| f(k, b)).sum())
                .collect()
        };
        Self {
            projection: contract(&|k, b| row(k, b) * residuals[k][b]),
            weight: contract(&|k, b| row(k, b) * row(k, b)),
            q: samples.iter().map(|s| s.joints[joint]).collect(),
        }
    }

    /// Returns the difference in frequency, in cycles per turn, that the range of the joint resolves.
    fn resolution(&self) -> f64 {
        let (lowest, highest) = extremes(self.q.iter().copied());
        std::f64::consts::TAU / (highest - lowest)
    }
}

/// Coarsest resolution, in cycles per turn, at which a joint is searched: that of a joint that moves by 0.01 rad.
const COARSEST: f64 = 100.0 * std::f64::consts::TAU;

/// Finds the most significant frequency of each joint above `above` cycles per turn, from the residuals (in units of
/// their noise) and the Jacobian of all poses.
pub fn peaks(
    samples: &[BaseSample],
    residuals: &[[f64; ROWS]],
    jacobian: &Mat<f64>,
    above: f64,
) -> Vec<Peak> {
    let of = |joint: usize| {
        let data = Contracted::new(joint, samples, residuals, jacobian);
        let resolution = data.resolution();
        if resolution > COARSEST {
            return None;
        }
        // Step by a quarter of the resolution that the span allows, and start at no less than one cycle within the span.
        let step = (0.25 * resolution).min(0.5);
        let first = above.max(resolution);
        let mut best = Peak {
            joint,
            cycles: first,
            drop: 0.0,
            alias: None,
        };
        for (cycles, drop) in data.scan(first, RANGE.1, step) {
            if drop > best.drop {
                best = Peak {
                    cycles,
                    drop,
                    ..best
                };
            }
        }
        let mut best = refine(&data, best, step);
        if best.drop > SIGNIFICANT {
            // Closer frequencies belong to the same peak: their slow beat is nearly the same between the measured values.
            best.alias = data.alias(&best, step, 2.0 * resolution);
        }
        Some(best)
    };
    (0..jacobian.ncols()).filter_map(of).collect()
}

/// Refines the frequency of a term, given all terms found since, near the frequency at which it was found.
pub fn refined_frequency(
    term: &RippleTerm<f64>,
    samples: &[BaseSample],
    residuals: &[[f64; ROWS]],
    jacobian: &Mat<f64>,
) -> f64 {
    let mut data = Contracted::new(term.joint, samples, residuals, jacobian);
    for ((projection, weight), q) in data.projection.iter_mut().zip(&data.weight).zip(&data.q) {
        *projection += weight * term.deflection(*q);
    }
    let here = Peak {
        joint: term.joint,
        cycles: term.cycles,
        drop: data.drop(term.cycles),
        alias: None,
    };
    refine(&data, here, 0.25 * data.resolution()).cycles
}

/// Finds the top of a peak within one step by repeated trisection.
fn refine(data: &Contracted, coarse: Peak, step: f64) -> Peak {
    let (mut lower, mut upper) = (coarse.cycles - step, coarse.cycles + step);
    for _ in 0..24 {
        let (a, b) = (lower + (upper - lower) / 3.0, upper - (upper - lower) / 3.0);
        if data.drop(a) < data.drop(b) {
            lower = a;
        } else {
            upper = b;
        }
    }
    let cycles = 0.5 * (lower + upper);
    let drop = data.drop(cycles);
    if drop > coarse.drop {
        Peak {
            cycles,
            drop,
            ..coarse
        }
    } else {
        coarse
    }
}
