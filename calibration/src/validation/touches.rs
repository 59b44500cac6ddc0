//! Judges models by touches: each arm stays as its blob says, and features, tips and instrument are fitted to it.
//!
//! The runtime computes the poses from the bytes of the blob. The nominal model gets the same rows and the same freedom, so
//! that the two differ in the arm alone. Known distances are not used as equations: the touches show what they find without
//! them.

use poegp_protocol::blob::Correction;
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use nalgebra::Vector3;

use crate::blob::predict::{BlobModel, poses};
use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::identification::touch::jet::RowJet;
use crate::measurement::sample::BaseSample;
use crate::measurement::touch::{KnownDistance, TouchRow, TouchSet};
use crate::model::config::Config;
use crate::model::touches::USUAL_CLASS;
use crate::model::touches::summary::{
    DistanceSummary, FeatureSummary, NoiseSummary, TouchOutlier, features, length, noise, outliers,
    tips_mm, tracker, unit,
};

/// What touches show of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchEvaluation {
    /// Number of rows in the file.
    pub rows: usize,
    /// Number of scalar equations that the rows give.
    pub equations: usize,
    /// Number of states of the arm.
    pub states: usize,
    /// Number of states whose prediction has a status other than `ok`.
    pub flagged: usize,
    /// Ratio of two root mean squares of all components in units of their stated noise: that of the model over that of the
    /// nominal model.
    pub ratio: f64,
    /// Touched features, nominal and by the model.
    pub features: Vec<FeatureSummary>,
    /// Residuals of a tracker's rows: positions and rotations.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tracker: Vec<FeatureSummary>,
    /// Known distances and their errors; nothing is fitted to them.
    pub distances: Vec<DistanceSummary>,
    /// Noise of each kind of reading.
    pub noise: Vec<NoiseSummary>,
    /// Positions of the tips in the flange frame by the model, mm.
    pub tips_mm: Vec<[f64; 3]>,
    /// Rows that do not belong to the others.
    pub outliers: Vec<TouchOutlier>,
    /// Residuals of all rows, in the order of the file.
    pub residuals: Vec<TouchResidual>,
}

/// Residual of one row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchResidual {
    /// Line of the row in the file.
    pub line: usize,
    /// Name of the touched feature; `None` for a tracker's row.
    pub feature: Option<String>,
    /// Errors of the nominal model and of the model, in `unit`; for a tracker's row that of the position.
    pub error: [f64; 2],
    /// Unit of `error`.
    pub unit: &'static str,
    /// Whether the row belongs to the others.
    pub belongs: bool,
}

/// Returns the frames of the nominal model from base to flange, without the tool of the blob.
pub fn nominal_arm(loaded: &BlobModel) -> Vec<Pose<f64>> {
    let mut frames = poses(&loaded.blob().geometry.nominal);
    if let Some(last) = frames.last_mut() {
        *last = *last * flange_from_target(loaded).inverse();
    }
    frames
}

/// Returns flange_from_target of the first tool, as the blob states it.
pub fn flange_from_target(loaded: &BlobModel) -> Pose<f64> {
    Pose::from_rows(&loaded.host().gauge.flange_from_target)
}

/// Returns base_from_flange at each state as the runtime computes it, with the status.
pub fn flanges(loaded: &BlobModel, states: &[BaseSample]) -> Vec<(Pose<f64>, Status)> {
    let base_from_instrument = loaded.instrument_from_base().inverse();
    let target_from_flange = flange_from_target(loaded).inverse();
    let of = |state: &BaseSample| {
        let found = loaded.predict(&state.joints, state.payload_kg);
        let pose = base_from_instrument * found.pose * target_from_flange;
        (pose, found.status)
    };
    states.iter().map(of).collect()
}

/// Returns gravity in the base frame, m/s²: the blob's if it has one, else the default.
pub fn gravity(loaded: &BlobModel) -> Vector3<f64> {
    match &loaded.blob().correction {
        Correction::Elastic(elastic) if elastic.gravity != [0.0; 3] => {
            Vector3::from(elastic.gravity.map(f64::from))
        }
        _ => Vector3::from(Config::default().gravity_m_s2),
    }
}

/// Judges `blobs` by the same rows of `set`: those that belong for all blobs. `nominal` is the chain from base to flange.
pub fn evaluate_touches(
    set: &TouchSet,
    nominal: &Poe<f64>,
    coupling: Option<&Vec<Vec<f64>>>,
    blobs: &[&BlobModel],
) -> Vec<TouchEvaluation> {
    let alone = TouchSet {
        distances: Vec::new(),
        ..set.clone()
    };
    let down = blobs.first().map(|blob| gravity(blob));
    let problem = TouchProblem::new(
        &alone,
        nominal,
        coupling.cloned(),
        down.unwrap_or_default(),
        USUAL_CLASS,
    );
    let flanges: Vec<Vec<(Pose<f64>, Status)>> = blobs
        .iter()
        .map(|blob| flanges(blob, &problem.states))
        .collect();
    let poses =
        |of: &Vec<(Pose<f64>, Status)>| -> Vec<Pose<f64>> { of.iter().map(|f| f.0).collect() };
    let mut fits: Vec<TouchFit> = flanges
        .iter()
        .map(|of| TouchFit::on_known(&problem, &poses(of)))
        .collect();
    let mut weights = vec![1.0_f64; alone.rows.len()];
    for fit in &fits {
        for (weight, own) in weights.iter_mut().zip(&fit.weights) {
            *weight = weight.min(*own);
        }
    }
    fits = fits
        .into_iter()
        .map(|fit| match fit.weights == weights {
            true => fit,
            false => fit.weighted(&problem, &weights),
        })
        .collect();
    let nominal_fit = TouchFit::on_nominal_without(&problem, &weights);
    let nominal_residuals = nominal_fit.residuals(&problem);
    let distance = |known: &KnownDistance, fit: &TouchFit| {
        let measured = fit.distance_by_touches(&problem, known.between);
        DistanceSummary::new(set, known, [&nominal_fit, fit], measured)
    };
    let of = |(fit, flanges): (TouchFit, &Vec<(Pose<f64>, Status)>)| {
        let residuals: [Vec<RowJet>; 2] = [nominal_residuals.clone(), fit.residuals(&problem)];
        TouchEvaluation {
            rows: alone.rows.len(),
            equations: problem.equations(),
            states: problem.states.len(),
            flagged: flanges.iter().filter(|(_, status)| !status.is_ok()).count(),
            ratio: ratio(&problem, &weights, &residuals),
            features: features(&problem, &fit, &residuals),
            tracker: tracker(&problem, &fit, &residuals),
            distances: set.distances.iter().map(|d| distance(d, &fit)).collect(),
            noise: noise(&problem, &fit),
            tips_mm: tips_mm(&problem, &fit),
            outliers: outliers(&problem, &fit, &residuals[1]),
            residuals: each(&alone, &weights, &residuals),
        }
    };
    fits.into_iter().zip(&flanges).map(of).collect()
}

fn each(set: &TouchSet, weights: &[f64], residuals: &[Vec<RowJet>; 2]) -> Vec<TouchResidual> {
    let of = |(k, row): (usize, &TouchRow)| {
        let (unit, factor) = unit(Noise::of(&row.reading, 0));
        TouchResidual {
            line: row.line,
            feature: row.reading.feature().map(|f| set.features[f].name.clone()),
            error: [0, 1].map(|i: usize| factor * length(&residuals[i][k])),
            unit,
            belongs: weights[k] > 0.0,
        }
    };
    set.rows.iter().enumerate().map(of).collect()
}

/// Returns the root mean square of `residuals[1]` over that of `residuals[0]`, in units of the stated noise.
fn ratio(problem: &TouchProblem, weights: &[f64], residuals: &[Vec<RowJet>; 2]) -> f64 {
    let squares = |jets: &[RowJet]| -> f64 {
        let rows = jets
            .iter()
            .enumerate()
            .filter(|(row, _)| weights[*row] > 0.0);
        rows.flat_map(|(row, jet)| {
            (0..jet.count).map(move |i| jet.residual[i].powi(2) / problem.stated_variance(row, i))
        })
        .sum()
    };
    (squares(&residuals[1]) / squares(&residuals[0]).max(1e-300)).sqrt()
}
