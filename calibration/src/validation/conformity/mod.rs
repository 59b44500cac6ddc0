//! Whether an arm conforms to a tolerance, and how certain that verdict is.
//!
//! The characteristic is the error E that 95 of 100 poses of the measured kind do not exceed, in position or in rotation. It
//! is estimated from the errors of held-out poses, without the noise that the instrument states ([`error_quantile`]). Its
//! uncertainty follows the GUM (JCGM 100:2008): each source has a standard uncertainty ([`budget`]), and these combine to
//!
//! ```text
//! u_c² = Σ u_i²        ν = u_c⁴ / Σ (u_i⁴ / ν_i)        U = t_(1+p)/2(ν) u_c
//! ```
//!
//! (equations 10, G.2b and 6.2.1). The decision is that of ISO 14253-1, whose guard band is U. An arm conforms if E + U is
//! within the tolerance. It does not conform if E − U is beyond the tolerance. Between these, the verdict is undecided.

pub mod budget;
mod error_family;
pub mod error_quantile;
#[cfg(test)]
mod tests;

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use crate::identification::touch::volume::Exceeded;
pub use crate::validation::conformity::budget::Knowledge;
use crate::validation::conformity::budget::{Contribution, of_touches, sources};
use crate::validation::conformity::error_quantile::{Distinct, Noise, estimate};
use crate::validation::held_out::HeldOutPose;

/// Fewest distinct held-out poses for which a verdict is given.
pub const LEAST_POSES: usize = 10;
/// Degrees of freedom from which the quantile of Student's distribution is expanded about the normal one.
const MANY: f64 = 200.0;
/// Degrees of freedom that are treated as infinite.
const INFINITE: f64 = 1e6;
/// Coverage probability of the expanded uncertainty, unless another one is asked for.
pub const COVERAGE: f64 = 0.95;

/// Result of comparing an error and its expanded uncertainty with a tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// E + U is within the tolerance.
    Conforms,
    /// The tolerance is between E − U and E + U.
    Undecided,
    /// E − U is beyond the tolerance.
    DoesNotConform,
}

/// The evidence that the error is estimated from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// Measured poses that the model was not trained on.
    HeldOutPoses,
    /// Touches and the class of the arm; no poses were held out.
    Touches,
}

/// The tolerances that the arm is judged by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Largest position error that 95 of 100 poses may have, in mm.
    pub position_mm: Option<f64>,
    /// Largest rotation error that 95 of 100 poses may have, in mrad.
    pub orientation_mrad: Option<f64>,
    /// Coverage probability p of the expanded uncertainty.
    pub coverage: f64,
}

impl Tolerances {
    /// Returns whether a tolerance is stated.
    pub fn is_stated(&self) -> bool {
        self.position_mm.is_some() || self.orientation_mrad.is_some()
    }
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            position_mm: None,
            orientation_mrad: None,
            coverage: COVERAGE,
        }
    }
}

/// The error of position or of rotation, its uncertainty and the verdict. Lengths are in mm, angles in mrad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Characteristic {
    /// `mm` or `mrad`.
    pub unit: &'static str,
    /// Number of distinct held-out poses; measurements of the same pose count once.
    pub poses: usize,
    /// E: the error that 95 of 100 poses do not exceed.
    pub error: f64,
    /// Sources of uncertainty.
    pub budget: Vec<Contribution>,
    /// u_c: combined standard uncertainty.
    pub combined: f64,
    /// ν: effective degrees of freedom of u_c; absent if infinite.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// Coverage factor t_(1+p)/2(ν).
    pub coverage_factor: f64,
    /// U: expanded uncertainty.
    pub expanded: f64,
    /// E + U: the smallest tolerance that the arm would meet.
    pub met: f64,
    /// Tolerance that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Verdict for that tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
}

/// Conformity of an arm in position and in rotation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Conformity {
    /// The evidence that the errors are estimated from.
    pub evidence: Evidence,
    /// Coverage probability of the expanded uncertainties.
    pub coverage: f64,
    /// Characteristic of position, mm.
    pub position: Characteristic,
    /// Characteristic of rotation, mrad; absent if only positions were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<Characteristic>,
    /// The worse of the two verdicts; absent without a tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// Why the verdict is not [`Verdict::Conforms`] although E + U is within the tolerance, or would not be for a tolerance of
    /// E + U where none was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub withheld: Option<String>,
}

impl Conformity {
    /// Judges a calibration from touches. No poses were held out, so the error is that of poses all over the work volume,
    /// from what is known of the arm. Touches are not judged by rotations. What the touches leave to the class of the arm
    /// (`by_class` says what) is no evidence that an arm conforms.
    pub fn of_touches(
        known: &Exceeded,
        tolerances: &Tolerances,
        by_class: impl FnOnce(f64) -> Option<String>,
    ) -> Self {
        let mut position = Characteristic::judged(
            "mm",
            known.poses,
            known.error_mm,
            of_touches(known.standard_uncertainty_mm),
            tolerances.position_mm,
            tolerances.coverage,
        );
        let withheld = match (position.tolerance, position.verdict) {
            (Some(tolerance), Some(Verdict::Conforms)) => by_class(tolerance),
            (None, _) => by_class(position.met),
            _ => None,
        };
        if withheld.is_some() {
            position.verdict = position.verdict.map(|_| Verdict::Undecided);
        }
        Self {
            evidence: Evidence::Touches,
            coverage: tolerances.coverage,
            verdict: position.verdict,
            position,
            orientation: None,
            withheld,
        }
    }

    /// Judges held-out poses; returns `None` for fewer than [`LEAST_POSES`] distinct ones.
    pub fn new(
        poses: &[HeldOutPose],
        knowledge: &Knowledge,
        tolerances: &Tolerances,
    ) -> Option<Self> {
        let of = |rotation: bool, tolerance: Option<f64>| {
            Characteristic::new(poses, knowledge, rotation, tolerance, tolerances.coverage)
        };
        let position = of(false, tolerances.position_mm)?;
        let orientation = of(true, tolerances.orientation_mrad);
        let verdicts = [Some(&position), orientation.as_ref()];
        let verdict = verdicts.into_iter().flatten().filter_map(|c| c.verdict);
        Some(Self {
            evidence: Evidence::HeldOutPoses,
            coverage: tolerances.coverage,
            verdict: verdict.max(),
            position,
            orientation,
            withheld: None,
        })
    }
}

impl Characteristic {
    fn new(
        poses: &[HeldOutPose],
        knowledge: &Knowledge,
        rotation: bool,
        tolerance: Option<f64>,
        coverage: f64,
    ) -> Option<Self> {
        let distinct = Distinct::of(poses, knowledge.repeats, rotation)?;
        if distinct.poses() < LEAST_POSES {
            return None;
        }
        let component = usize::from(rotation);
        let noise = Noise::of(&distinct, knowledge.fitted_noise[component]);
        let found = estimate(&distinct, &noise);
        let budget = sources(&found, &noise, knowledge, component);
        Some(Self::judged(
            if rotation { "mrad" } else { "mm" },
            distinct.poses(),
            found.error,
            budget,
            tolerance,
            coverage,
        ))
    }

    /// Combines an error and the budget of its uncertainty into a characteristic.
    fn judged(
        unit: &'static str,
        poses: usize,
        error: f64,
        budget: Vec<Contribution>,
        tolerance: Option<f64>,
        coverage: f64,
    ) -> Self {
        let variance = budget
            .iter()
            .filter_map(|c| c.standard_uncertainty)
            .map(|u| u * u);
        let combined = variance.sum::<f64>().sqrt();
        let fourth = |c: &Contribution| {
            let (u, freedom) = c.standard_uncertainty.zip(c.degrees_of_freedom)?;
            Some(u.powi(4) / freedom)
        };
        let fourths: f64 = budget.iter().filter_map(fourth).sum();
        let degrees_of_freedom =
            Some(combined.powi(4) / fourths).filter(|freedom| fourths > 0.0 && *freedom < INFINITE);
        let coverage_factor = student(degrees_of_freedom, coverage);
        let expanded = coverage_factor * combined;
        let verdict = |tolerance: f64| {
            if error + expanded <= tolerance {
                Verdict::Conforms
            } else if error - expanded > tolerance {
                Verdict::DoesNotConform
            } else {
                Verdict::Undecided
            }
        };
        Self {
            unit,
            poses,
            error,
            budget,
            combined,
            degrees_of_freedom,
            coverage_factor,
            expanded,
            met: error + expanded,
            tolerance,
            verdict: tolerance.map(verdict),
        }
    }
}

/// Returns t_(1+p)/2(ν), the coverage factor for coverage probability p; `None` stands for infinitely many degrees of
/// freedom.
fn student(degrees_of_freedom: Option<f64>, coverage: f64) -> f64 {
    let at = 0.5 * (1.0 + coverage);
    let few = degrees_of_freedom.filter(|freedom| *freedom < MANY);
    if let Some(Ok(t)) = few.map(|freedom| StudentsT::new(0.0, 1.0, freedom.max(1.0))) {
        return t.inverse_cdf(at);
    }
    // Abramowitz and Stegun 26.7.5: beyond MANY the next term is 1e-8.
    let z = Normal::standard().inverse_cdf(at);
    let inverse = degrees_of_freedom.map_or(0.0, |freedom| 1.0 / freedom);
    let cube = z * z * z;
    let second = (5.0 * cube * z * z + 16.0 * cube + 3.0 * z) / 96.0;
    z + inverse * ((cube + z) / 4.0 + inverse * second)
}
