//! The uncertainty budget of an arm's error, as the GUM asks for: for each source its type of evaluation, distribution,
//! standard uncertainty and share. A source that was not measured is listed without a number.

use serde::Serialize;

use crate::measurement::instrument_drift::DriftReport;
use crate::validation::conformity::error_quantile::{Noise, Quantile};

/// What is known of the held-out poses besides their errors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Knowledge<'a> {
    /// For each held-out pose, the number of the distinct pose that it repeats.
    pub repeats: &'a [usize],
    /// Drift of the instrument, if reference points were measured, and whether it was removed from the poses.
    pub drift: Option<(&'a DriftReport, bool)>,
    /// Standard uncertainty of the instrument by its certificate, common to all poses: in mm for position and in mrad for
    /// rotation.
    pub instrument: [Option<f64>; 2],
    /// Standard deviation of one component that the model found at its training poses: in mm for position and in mrad for
    /// rotation.
    pub fitted_noise: [Option<f64>; 2],
}

/// A source of uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// Systematic error of the instrument, the same at all poses, and its noise if the file declares it.
    Instrument,
    /// Scatter of the arm at the same pose.
    Repeatability,
    /// Error of the model, which is known only at the held-out poses.
    Model,
    /// Motion of the instrument during the measurement.
    Drift,
    /// Position and orientation of base and tool.
    BaseAndTool,
}

impl Source {
    /// Returns the name of the source in a table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Instrument => "instrument",
            Self::Repeatability => "repeatability",
            Self::Model => "model",
            Self::Drift => "drift",
            Self::BaseAndTool => "base and tool",
        }
    }
}

/// Type of evaluation of an uncertainty (GUM 2.3.2, 2.3.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Evaluation {
    /// Type A: from the scatter of observations.
    A,
    /// Type B: by other means.
    B,
}

/// Contribution of one source to the uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Contribution {
    /// Source of the contribution.
    pub source: Source,
    /// Type of evaluation.
    pub evaluation: Evaluation,
    /// Distribution: `normal` or `rectangular`.
    pub distribution: &'static str,
    /// u_i: standard uncertainty of the error due to this source, in mm or mrad; absent if it was not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub standard_uncertainty: Option<f64>,
    /// ν_i: degrees of freedom of u_i; absent if infinite.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// Share of the combined variance, u_i²/u_c².
    pub share: f64,
    /// Where the number comes from, or which measurement would give it.
    pub basis: &'static str,
}

impl Contribution {
    fn normal(source: Source, evaluation: Evaluation, basis: &'static str) -> Self {
        Self {
            source,
            evaluation,
            distribution: "normal",
            standard_uncertainty: None,
            degrees_of_freedom: None,
            share: 0.0,
            basis,
        }
    }

    fn of(self, standard_uncertainty: f64) -> Self {
        Self {
            standard_uncertainty: Some(standard_uncertainty),
            ..self
        }
    }
}

/// Returns all sources of the uncertainty of the estimate `found`; `component` is 0 for position and 1 for rotation.
pub fn sources(
    found: &Quantile,
    noise: &Noise,
    knowledge: &Knowledge,
    component: usize,
) -> Vec<Contribution> {
    let model = Contribution::normal(
        Source::Model,
        Evaluation::A,
        "scatter of the errors of the held-out poses",
    );
    // The errors are those of poses in the instrument's frame, which the arm reached: the frames of base and tool and the arm's
    // repeatability are in them.
    let included = |source| {
        Contribution::normal(source, Evaluation::A, "included in the errors of the poses").of(0.0)
    };
    let mut out = vec![
        instrument(found, noise, knowledge.instrument[component]),
        included(Source::Repeatability),
        Contribution {
            degrees_of_freedom: Some(found.freedom),
            ..model.of(found.of_few_poses)
        },
        drift(knowledge.drift, component),
        included(Source::BaseAndTool),
    ];
    share(&mut out);
    out
}

/// Returns the sources of uncertainty of an error that is estimated from touches; the standard uncertainty is in mm.
pub fn of_touches(standard_uncertainty: f64) -> Vec<Contribution> {
    let row = |source, evaluation, basis| Contribution::normal(source, evaluation, basis);
    let mut out = vec![
        row(
            Source::Instrument,
            Evaluation::B,
            "included in the model's row, in the misses of the touches",
        )
        .of(0.0),
        row(
            Source::Repeatability,
            Evaluation::A,
            "not measured: touches differ in their poses",
        ),
        row(
            Source::Model,
            Evaluation::B,
            "errors of the arm that the touches do not determine, by its class",
        )
        .of(standard_uncertainty),
        row(
            Source::BaseAndTool,
            Evaluation::B,
            "touches cannot show them: the errors are those after their best registration",
        ),
    ];
    share(&mut out);
    out
}

/// Sets the share that each contribution has in the sum of squares.
fn share(out: &mut [Contribution]) {
    let square = |c: &Contribution| c.standard_uncertainty.map_or(0.0, |u| u * u);
    let all: f64 = out.iter().map(square).sum();
    for contribution in out {
        contribution.share = if all > 0.0 {
            square(contribution) / all
        } else {
            0.0
        };
    }
}

fn instrument(found: &Quantile, noise: &Noise, certificate: Option<f64>) -> Contribution {
    let (basis, known) = match (certificate, noise.sigma > 0.0, noise.is_contradicted) {
        (Some(_), true, _) => ("certificate, and noise removed from the errors", true),
        (Some(_), false, true) => (
            "certificate; the noise stays in the errors, which are smaller than it",
            true,
        ),
        (Some(_), false, false) => (
            "certificate; its noise is unknown and stays in the errors",
            true,
        ),
        (None, true, _) => (
            "noise removed from the errors; no certificate is stated",
            true,
        ),
        (None, false, true) => (
            "the noise stays in the errors, which are smaller than it; state the certificate",
            false,
        ),
        (None, false, false) => (
            "not stated: its noise stays in the errors; state its certificate",
            false,
        ),
    };
    let basis = match (noise.is_fitted && noise.sigma > 0.0, certificate) {
        (true, Some(_)) => {
            "certificate, and the fitted noise removed: the stated noise is too large"
        }
        (true, None) => {
            "the fitted noise removed, because the stated noise is too large; state the certificate"
        }
        (false, _) => basis,
    };
    let row = Contribution::normal(Source::Instrument, Evaluation::B, basis);
    match known {
        true => Contribution {
            degrees_of_freedom: noise.repeated,
            ..row.of(libm::hypot(found.of_noise, certificate.unwrap_or(0.0)))
        },
        false => row,
    }
}

fn drift(known: Option<(&DriftReport, bool)>, component: usize) -> Contribution {
    let norm = |axes: [f64; 3]| axes.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (basis, half_width) = match known {
        None => (
            "not measured: measure reference points beside the poses",
            None,
        ),
        Some((drift, false)) => (
            "largest motion of the reference points, not removed",
            Some([1e-3 * norm(drift.max_um), 1e-3 * drift.max_urad][component]),
        ),
        Some((drift, true)) => (
            "residual motion of the reference points after the correction",
            // Beyond that, nothing is known for rotation.
            Some([1e-3 * drift.left_out_um[1] * 3.0_f64.sqrt(), 0.0][component]),
        ),
    };
    Contribution {
        source: Source::Drift,
        evaluation: Evaluation::B,
        distribution: "rectangular",
        standard_uncertainty: half_width.map(|a| a / 3.0_f64.sqrt()),
        degrees_of_freedom: None,
        share: 0.0,
        basis,
    }
}
