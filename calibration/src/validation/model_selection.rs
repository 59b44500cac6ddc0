//! The right model for the data, chosen by cross-validation within the training data only.
//!
//! Every candidate predicts every training pose with a model that did not see it. The candidate with the least mean
//! error is the best; shipped is the *simplest* whose errors are not larger by more than one standard error of the
//! difference, pose by pose: thirty poses do not get a process that they cannot support, and an arm whose residual is not
//! a joint effect is not forced into joint space.

use serde::Serialize;

use crate::learning::task_space::fit::HyperparameterSharing;
use crate::measurement::sample::InstrumentSample;
use crate::model::Method;
use crate::model::config::{Config, Weighting};
use crate::numeric::statistics::Summary;
use crate::validation::cross_validation::{CompareError, Task, applicable};

/// Folds of the choice.
pub const FOLDS: usize = 5;

/// A model that may be chosen.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// What it is called in the table.
    pub name: &'static str,
    /// How it is calibrated.
    pub config: Config,
}

/// One row of the table that the choice was made from.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the candidate.
    pub candidate: &'static str,
    /// Held-out position errors in mm.
    pub position_mm: Summary,
    /// Mean of the pose-by-pose difference to the best in mm, and its standard error.
    pub behind_best_mm: f64,
    /// Standard error of that mean.
    pub standard_error_mm: f64,
    /// Whether it was chosen.
    pub chosen: bool,
}

/// A candidate that cannot be used on these data.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// Name of the candidate.
    pub candidate: &'static str,
    /// Why a model of it could not be made of some folds.
    pub reason: String,
}

/// A choice with its reasons.
#[derive(Clone, Debug)]
pub struct Choice {
    /// How to calibrate.
    pub config: Config,
    /// The table, simplest first.
    pub table: Vec<Row>,
    /// Candidates that are not in it.
    pub left_out: Vec<LeftOut>,
}

/// All candidates that the data allow, simplest first; `base` has the settings that they share.
pub fn candidates(samples: &[InstrumentSample], joints: usize, base: &Config) -> Vec<Candidate> {
    let allowed = applicable(samples);
    let gp = if allowed.contains(&Method::PoeGpLoad) {
        Method::PoeGpLoad
    } else {
        Method::PoeGp
    };
    let of = |name, method| Candidate {
        name,
        config: Config {
            method,
            weighting: Weighting::Noise,
            hyperparameters: HyperparameterSharing::Shared,
            ..*base
        },
    };
    let mut parameters_only = of("elastic, parameters alone", Method::Elastic);
    parameters_only.config.processes = false;
    let mut without_gravity = of("elastic without gravity terms", Method::Elastic);
    without_gravity.config.gravity_terms = false;
    let mut out = vec![
        of("base-tool", Method::BaseTool),
        of("poe --weighting noise", Method::Poe),
        parameters_only,
        of(
            if gp == Method::PoeGp {
                "poe-gp --weighting noise"
            } else {
                "poe-gp-load --weighting noise"
            },
            gp,
        ),
        without_gravity,
        of("elastic", Method::Elastic),
    ];
    let smallest = samples.len() - samples.len().div_ceil(FOLDS);
    out.retain(|c| {
        allowed.contains(&c.config.method) && c.config.method.min_poses(joints) <= smallest
    });
    out
}

/// Cross-validates the candidates on `task.train` and chooses. `progress` is called after every calibration. A candidate
/// that cannot be calibrated, or not for a device, on some of the folds would not be a safe choice: it is left out.
///
/// # Errors
/// [`CompareError`] of the first one when no candidate can be calibrated.
pub fn select_model(
    task: &Task<'_>,
    candidates: &[Candidate],
    progress: &mut dyn FnMut(),
) -> Result<Choice, CompareError> {
    let mut errors: Vec<Vec<f64>> = Vec::new();
    let (mut usable, mut left_out, mut first) = (Vec::new(), Vec::new(), None);
    for candidate in candidates {
        match task.held_out(&candidate.config, progress) {
            Ok(held_out) => {
                errors.push(held_out.iter().map(|e| e.position_mm).collect());
                usable.push(candidate);
            }
            Err(error) => {
                left_out.push(LeftOut {
                    candidate: candidate.name,
                    reason: error.error.to_string(),
                });
                first.get_or_insert(error);
            }
        }
    }
    if let (true, Some(error)) = (usable.is_empty(), first) {
        return Err(error);
    }
    let candidates = usable;
    let mean = |e: &Vec<f64>| e.iter().sum::<f64>() / e.len().max(1) as f64;
    let best = (0..errors.len())
        .min_by(|a, b| mean(&errors[*a]).total_cmp(&mean(&errors[*b])))
        .unwrap_or(0);
    let behind = |i: usize| -> (f64, f64) {
        let d: Vec<f64> = errors[i]
            .iter()
            .zip(&errors[best])
            .map(|(a, b)| a - b)
            .collect();
        let (n, m) = (
            d.len() as f64,
            d.iter().sum::<f64>() / d.len().max(1) as f64,
        );
        let variance = d.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        (m, (variance / n).sqrt())
    };
    let chosen = (0..errors.len())
        .find(|i| {
            let (m, standard_error) = behind(*i);
            m <= standard_error
        })
        .unwrap_or(best);
    let table = candidates.iter().enumerate().map(|(i, c)| {
        let (behind_best_mm, standard_error_mm) = behind(i);
        Row {
            candidate: c.name,
            position_mm: Summary::new(&errors[i]),
            behind_best_mm,
            standard_error_mm,
            chosen: i == chosen,
        }
    });
    Ok(Choice {
        table: table.collect(),
        config: candidates[chosen].config,
        left_out,
    })
}
