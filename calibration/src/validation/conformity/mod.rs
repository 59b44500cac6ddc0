//! Whether an arm conforms to a tolerance, and how certain that is.
//!
//! The characteristic is the error E that 95 of 100 poses of the measured kind do not exceed, of position or of rotation.
//! Its estimate comes from the errors of held-out poses, without the noise of the instrument ([`error_quantile`]). Its
//! uncertainty follows the GUM (JCGM 100:2008): sources of uncertainty with a standard uncertainty each ([`budget`]),
//!
//! ```text
//! u_c² = Σ u_i²        ν = u_c⁴ / Σ (u_i⁴ / ν_i)        U = t_(1+p)/2(ν) u_c
//! ```
//!
//! (equations 10, G.2b and 6.2.1). The decision is that of ISO 14253-1, whose guard band is U: an arm conforms where
//! E + U is within the tolerance, does not where E − U is beyond it, and cannot be judged between.

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

/// Held-out poses below which nothing is said.
pub const LEAST_POSES: usize = 10;
/// Degrees of freedom from which on the quantile of Student's distribution is expanded about the normal one.
const MANY: f64 = 200.0;
/// Degrees of freedom that are as good as infinite.
const INFINITE: f64 = 1e6;
/// Coverage probability of the expanded uncertainty, if no other is asked for.
pub const COVERAGE: f64 = 0.95;

/// What was found.
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

/// What the error is known from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// Measured poses that the model was not trained on.
    HeldOutPoses,
    /// Touches and the class of the arm: no poses were held out.
    Touches,
}

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Largest position error in mm of 95 of 100 poses.
    pub position_mm: Option<f64>,
    /// Largest rotation error in mrad of 95 of 100 poses.
    pub orientation_mrad: Option<f64>,
    /// Coverage probability p of the expanded uncertainty.
    pub coverage: f64,
}

impl Tolerances {
    /// Whether something is asked for.
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
    /// Held-out poses that differ; measurements of the same pose count once.
    pub poses: usize,
    /// E: what 95 of 100 poses do not exceed.
    pub error: f64,
    /// The sources of uncertainty.
    pub budget: Vec<Contribution>,
    /// u_c.
    pub combined: f64,
    /// ν, its effective degrees of freedom; absent where they are infinite.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// The coverage factor t_(1+p)/2(ν).
    pub coverage_factor: f64,
    /// U.
    pub expanded: f64,
    /// E + U: the smallest tolerance that the arm would meet.
    pub met: f64,
    /// What was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Whether it is met.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
}

/// Both characteristics.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Conformity {
    /// What the errors are known from.
    pub evidence: Evidence,
    /// Coverage probability of the expanded uncertainties.
    pub coverage: f64,
    /// Characteristic of position, mm.
    pub position: Characteristic,
    /// Characteristic of rotation, mrad; absent where only positions were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<Characteristic>,
    /// The worst of the verdicts; absent without a tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
}

impl Conformity {
    /// Judges a calibration by touches: no poses were held out, so the error is that of poses of the work volume, by
    /// what is known of the arm. Touches are not judged by rotations.
    pub fn of_touches(known: &Exceeded, tolerances: &Tolerances) -> Self {
        let position = Characteristic::judged(
            "mm",
            known.poses,
            known.error_mm,
            of_touches(known.standard_uncertainty_mm),
            tolerances.position_mm,
            tolerances.coverage,
        );
        Self {
            evidence: Evidence::Touches,
            coverage: tolerances.coverage,
            verdict: position.verdict,
            position,
            orientation: None,
        }
    }

    /// Judges held-out poses; `None` for fewer than [`LEAST_POSES`] that differ.
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
        let noise = Noise::of(&distinct);
        let found = estimate(&distinct, &noise);
        let budget = sources(
            &found,
            &noise,
            distinct.repeated.is_some(),
            knowledge,
            usize::from(rotation),
        );
        Some(Self::judged(
            if rotation { "mrad" } else { "mm" },
            distinct.poses(),
            found.error,
            budget,
            tolerance,
            coverage,
        ))
    }

    /// An error with the budget of its uncertainty.
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

/// t_(1+p)/2(ν): the factor of an expanded uncertainty of coverage probability p; `None` is infinitely many degrees.
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
