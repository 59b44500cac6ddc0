//! The noise of measurements: the part common to all rows and the excess of single rows over it.
//!
//! An instrument may state a standard uncertainty σ_k for every row. All other effects on a measurement (the arm's own
//! repeatability, what no model explains) are stated nowhere and are the same in all rows. The variance of row k is
//! therefore
//!
//! ```text
//! v_k = v + (σ_k² − σ_q²),   v ≥ σ_q²        σ_q: the quietest row,  v: fitted
//! ```
//!
//! Weighting by σ_k alone would trust a row of 3 µm 36 times as much as one of 18 µm, on an arm that repeats only to 30 µm.
//! Without stated uncertainties, or with the same one in all rows, v_k = v to the last bit.

use crate::measurement::sample::Sample;
use crate::numeric::statistics::median;

pub use crate::measurement::observation::InstrumentNoise;

impl InstrumentNoise {
    /// Returns the smallest noise that the samples state; unknown if any sample states none.
    pub fn min_over<F>(samples: &[Sample<F>]) -> Self {
        Self::pooled(samples, |values| {
            values.iter().copied().fold(f64::INFINITY, f64::min)
        })
    }

    /// Returns the root mean square of the noise that the samples state; unknown if any sample states none.
    pub fn rms_over<F>(samples: &[Sample<F>]) -> Self {
        Self::pooled(samples, |values| {
            let sum: f64 = values.iter().map(|s| s * s).sum();
            (sum / values.len() as f64).sqrt()
        })
    }

    fn pooled<F>(samples: &[Sample<F>], pool: impl Fn(&[f64]) -> f64) -> Self {
        let of = |one: fn(&Sample<F>) -> Option<f64>| -> Option<f64> {
            let values: Option<Vec<f64>> = samples.iter().map(one).collect();
            values.filter(|v| !v.is_empty()).map(|v| pool(&v))
        };
        Self {
            position: of(|s| s.declared_noise.position),
            orientation: of(|s| s.declared_noise.orientation),
        }
    }
}

/// Noise scales of the quietest row: the lengths in m and angles in rad that weigh as one unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseScales {
    /// √v of one position component, in m.
    pub position: f64,
    /// √v of one rotation component, in rad.
    pub orientation: f64,
    /// σ_q, the noise stated for the quietest row; if unknown, all rows have the same weight.
    pub quietest: InstrumentNoise,
}

/// Lower bound on the noise of any instrument: standard deviation of one component, in m and rad.
pub const QUIETEST: (f64, f64) = (1e-6, 1e-6);

/// Share of the equations of positions or of rotations above which the parameters of a fit follow the noise. Parameters and
/// noise are estimated in turn, so the residuals of such a fit would vanish, round by round.
pub const FOLLOWED: f64 = 0.6;

/// Estimates the noise from the residuals of fits, round by round.
#[derive(Debug, Default)]
pub struct NoiseOfFits {
    /// Whether the parameters followed the noise in this round or an earlier one.
    is_followed: bool,
}

impl NoiseOfFits {
    /// Returns the noise for the RMS of the residuals of a round and, where it may be large, the share of the equations of
    /// positions and of rotations that the parameters follow.
    pub fn of(&mut self, rms: NoiseScales, share: Option<[f64; 2]>) -> NoiseScales {
        let Some(share) = share else {
            return rms;
        };
        self.is_followed |= share.iter().any(|share| *share > FOLLOWED);
        match self.is_followed {
            true => rms.beside(&share),
            false => rms,
        }
    }
}

impl NoiseScales {
    /// Unit scales: metres and radians have the same weight.
    pub const ONE: Self = Self::uniform(1.0, 1.0);
    /// Noise of a laser tracker, where none is stated.
    pub const TRACKER: Self = Self::uniform(30e-6, 50e-6);

    /// Creates scales that are the same for all rows, in m and rad.
    pub const fn uniform(position: f64, orientation: f64) -> Self {
        Self {
            position,
            orientation,
            quietest: InstrumentNoise::UNKNOWN,
        }
    }

    /// Returns the excess variance σ_k² − σ_q² of a row, in m² and rad².
    pub fn excess<F>(&self, sample: &Sample<F>) -> [f64; 2] {
        let of = |own: Option<f64>, quietest: Option<f64>| match (own, quietest) {
            (Some(own), Some(quietest)) => (own * own - quietest * quietest).max(0.0),
            _ => 0.0,
        };
        let (own, quietest) = (&sample.declared_noise, &self.quietest);
        [
            of(own.position, quietest.position),
            of(own.orientation, quietest.orientation),
        ]
    }

    /// Returns the scales √v_k of one row.
    #[must_use]
    pub fn of<F>(&self, sample: &Sample<F>) -> Self {
        let own = |scale: f64, excess: f64| {
            if excess > 0.0 {
                (scale * scale + excess).sqrt()
            } else {
                scale
            }
        };
        let [position, orientation] = self.excess(sample);
        Self::uniform(
            own(self.position, position),
            own(self.orientation, orientation),
        )
    }

    /// Returns v / v_k for position and rotation: 1 in the quietest row.
    pub fn common_share<F>(&self, sample: &Sample<F>) -> [f64; 2] {
        let [position, orientation] = self.excess(sample);
        let share = |scale: f64, excess: f64| scale * scale / (scale * scale + excess);
        [
            share(self.position, position),
            share(self.orientation, orientation),
        ]
    }

    /// Estimates the scales from residuals in metres and radians: v such that the mean of r²/v_k is one (the estimate of
    /// Mandel and Paule), or the mean square if all rows have the same weight. The first three of the six residuals are
    /// those of position; those of rotation are used only in samples with an orientation.
    pub fn estimated<F>(residuals: &[[f64; 6]], samples: &[Sample<F>]) -> Self {
        Self::pooled(residuals, samples, |rows| {
            let components = (3 * rows.len()).max(1) as f64;
            let all: f64 = rows.iter().flat_map(|row| &row.0).map(|x| x * x).sum();
            let sum = |v: f64| {
                let of = |(r, excess): &([f64; 3], f64)| norm(r).powi(2) / (v + excess);
                rows.iter().map(of).sum::<f64>()
            };
            if rows.iter().all(|(_, excess)| *excess == 0.0) {
                return all / components;
            }
            root(all / components, |v| sum(v) - components)
        })
    }

    /// Same as [`NoiseScales::estimated`], but from the median, so that up to half of the rows may have arbitrary errors.
    pub fn robust<F>(residuals: &[[f64; 6]], samples: &[Sample<F>]) -> Self {
        Self::pooled(residuals, samples, |rows| {
            let middle = |v: f64| {
                let of = |(r, excess): &([f64; 3], f64)| norm(r) / (v + excess).sqrt();
                median(rows.iter().map(of).collect())
            };
            let plain = median(rows.iter().map(|(r, _)| norm(r)).collect()) / MEDIAN_NORM;
            if rows.iter().all(|(_, excess)| *excess == 0.0) {
                return plain * plain;
            }
            root(plain * plain, |v| middle(v) - MEDIAN_NORM)
        })
    }

    /// Applies `variance` to the residuals and excesses of all rows, once for position and once for rotation.
    fn pooled<F>(
        residuals: &[[f64; 6]],
        samples: &[Sample<F>],
        variance: impl Fn(&[([f64; 3], f64)]) -> f64,
    ) -> Self {
        let mut out = Self {
            quietest: InstrumentNoise::min_over(samples),
            ..Self::ONE
        };
        let rows = |first: usize| -> Vec<([f64; 3], f64)> {
            residuals
                .iter()
                .zip(samples)
                .filter(|(_, s)| first == 0 || s.observation.has_orientation())
                .map(|(r, s)| ([0, 1, 2].map(|i| r[first + i]), out.excess(s)[first / 3]))
                .collect()
        };
        let scale = |rows: Vec<([f64; 3], f64)>, quietest: Option<f64>| {
            let least = quietest.filter(|_| rows.iter().any(|(_, excess)| *excess > 0.0));
            variance(&rows).sqrt().max(least.unwrap_or(0.0))
        };
        let (position, orientation) = (rows(0), rows(3));
        out.position = scale(position, out.quietest.position);
        out.orientation = scale(orientation, out.quietest.orientation);
        out
    }

    /// Converts the RMS of residuals to the noise, where the parameters follow these shares of the equations of positions and of
    /// rotations.
    #[must_use]
    fn beside(self, followed: &[f64; 2]) -> Self {
        let noise = |scale: f64, share: f64| scale / (1.0 - share).max(1e-12).sqrt();
        Self {
            position: noise(self.position, followed[0]),
            orientation: noise(self.orientation, followed[1]),
            ..self
        }
    }

    /// Raises both scales to at least `least`. A rotation scale of zero, which position-only samples give, becomes one.
    #[must_use]
    pub fn at_least(self, least: f64) -> Self {
        Self {
            position: self.position.max(least),
            orientation: if self.orientation > 0.0 {
                self.orientation.max(least)
            } else {
                1.0
            },
            ..self
        }
    }
}

/// Median of the norm of three standard normal numbers.
const MEDIAN_NORM: f64 = 1.5382;

fn norm(r: &[f64; 3]) -> f64 {
    r.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Finds by bisection where the decreasing function `f` changes sign between 0 and `upper`, at which it must not be
/// positive. Returns 0 if `f` is never positive.
fn root(upper: f64, f: impl Fn(f64) -> f64) -> f64 {
    let (mut below, mut above) = (0.0, upper);
    // A hundred bisections reach the resolution of f64 for any root above 10⁻³⁰ of `upper`.
    for _ in 0..100 {
        let middle = 0.5 * (below + above);
        if f(middle) > 0.0 {
            below = middle;
        } else {
            above = middle;
        }
    }
    below
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::observation::Observation;
    use crate::measurement::sample::{Base, BaseSample};
    use poegp_runtime::math::se3::Pose;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// `count` rows, every third stated and made `factor` times as noisy; all have a common noise of 40 µm besides.
    fn drawn(count: usize, factor: f64) -> (Vec<[f64; 6]>, Vec<BaseSample>) {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        (0..count)
            .map(|k| {
                let sigma = if k % 3 == 0 { factor * 30e-6 } else { 30e-6 };
                let residual = [0; 6].map(|_| sigma * normal() + 40e-6 * normal());
                let observation = Observation::Pose(Pose::identity());
                let declared = InstrumentNoise {
                    position: Some(sigma),
                    orientation: Some(sigma),
                };
                let sample = Sample::new(Vec::new(), Vec::new(), observation, Base);
                (residual, sample.with_noise(declared))
            })
            .unzip()
    }

    #[test]
    fn the_common_noise_is_found_beneath_that_of_the_rows() {
        let (mut residuals, samples) = drawn(3000, 10.0);
        let found = NoiseScales::estimated(&residuals, &samples);
        // The quietest row: 30 µm stated and 40 µm common.
        assert!((found.position / 50e-6 - 1.0).abs() < 0.03, "{found:?}");
        assert!((found.orientation / 50e-6 - 1.0).abs() < 0.03, "{found:?}");
        let noisy = found.of(&samples[0]);
        let expected = (40e-6_f64.powi(2) + 300e-6_f64.powi(2)).sqrt();
        assert!((noisy.position / expected - 1.0).abs() < 0.01, "{noisy:?}");
        residuals.iter_mut().step_by(5).for_each(|r| r[0] += 0.1);
        let robust = NoiseScales::robust(&residuals, &samples);
        assert!((robust.position / 50e-6 - 1.0).abs() < 0.3, "{robust:?}");
    }

    #[test]
    fn equal_statements_are_no_statements() {
        let (residuals, mut samples) = drawn(30, 1.0);
        let stated = NoiseScales::estimated(&residuals, &samples);
        let robust = NoiseScales::robust(&residuals, &samples);
        assert_eq!(stated.of(&samples[0]).position, stated.position);
        assert_eq!(stated.common_share(&samples[0]), [1.0; 2]);
        for sample in &mut samples {
            sample.declared_noise = InstrumentNoise::UNKNOWN;
        }
        let silent = NoiseScales::estimated(&residuals, &samples);
        assert_eq!(silent.position, stated.position);
        assert_eq!(silent.orientation, stated.orientation);
        let silent = NoiseScales::robust(&residuals, &samples);
        assert_eq!(silent.position, robust.position);
    }
}
