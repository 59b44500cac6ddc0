//! The JSON document of `trainer calibrate`.

use std::path::Path;

use serde::Serialize;

use crate::cli::calibrate::elastic_summary::ElasticSummary;
use crate::cli::calibrate::gauge::GaugeSummary;
use crate::cli::calibrate::job::Job;
use crate::report::certificate::Certificate;
use crate::report::controller::ControllerSummary;
use crate::report::sections::{BlobSummary, ListedOutlier, LossJson};
use crate::report::{HeldOutSummary, Provenance};
use poegp_calibration::blob::precision_loss::SinglePrecisionLoss;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::identification::frame_fit::FrameFit;
use poegp_calibration::identification::identifiability::IdentifyReport;
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::learning::elastic::outliers::{Outlier, Reason};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::DriftReport;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Calibration;
use poegp_calibration::model::frame_changes::{FrameChange, changes};
use poegp_calibration::model::touches::record::ArmRecord;
use poegp_calibration::model::touches::summary::TouchSummary;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::device_budget::BudgetTrial;
use poegp_calibration::validation::model_selection::Row;
use poegp_calibration::validation::next_steps::NextSteps;
use poegp_calibration::validation::work_volume::ExpectedError;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct CalibrateJson {
    pub version: &'static str,
    pub method: &'static str,
    pub robot: String,
    pub training_poses: usize,
    pub training: ErrorSummary,
    /// Errors on poses that the model was not trained on, if they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOutSummary>,
    /// Whether the arm conforms to its tolerance, and who measured it with which instrument; present with `held_out`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
    /// Expected position error with joints anywhere in their measured ranges, or of the held-out rows if the model's standard
    /// deviation is the same everywhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_error: Option<ExpectedError>,
    /// Steps that would lower the expected error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_steps: Option<NextSteps>,
    pub step1: Option<Step1>,
    pub hyperparameters: Vec<Hyperparameters>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elastic: Option<ElasticSummary>,
    /// Sources of base and tool, and how far commands move.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gauge: Option<GaugeSummary>,
    /// Training measurements that contradict the others, by their lines.
    pub outliers: Vec<ListedOutlier>,
    /// Warnings that the user must look at.
    pub warnings: Vec<Finding>,
    /// The method that was chosen, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chosen: Option<String>,
    /// Candidates that were compared: those of the automatic choice, or a named method and the simpler ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub choice: Option<Vec<Row>>,
    /// Trials by which the model was fitted to a budget; the first row is the model without a budget.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget: Option<Vec<BudgetTrial>>,
    pub correction_limit_mm: f64,
    pub correction_limit_mrad: f64,
    pub single_precision_loss_um: LossJson,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift: Option<DriftReport>,
    pub identifiability: Option<IdentifyReport>,
    /// Numbers of the calibrated arm beside those of the nominal model, and signed errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<ControllerSummary>,
    /// Differences of the frames from the nominal model.
    pub frames: Vec<FrameChange>,
    pub blob: BlobSummary,
    /// Whether the blob is byte for byte the one that the project file states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeats: Option<bool>,
    pub provenance: Provenance,
}

#[derive(Serialize)]
pub struct Step1 {
    pub parameters: usize,
    pub identifiable: usize,
    pub iterations: usize,
    pub rms: f64,
}

#[derive(Serialize)]
pub struct Hyperparameters {
    pub theta: [f64; 4],
    pub noise_variance: f64,
}

/// States the loss of single precision in µm.
pub fn loss(loss: &SinglePrecisionLoss) -> LossJson {
    LossJson {
        mean: 1e6 * loss.mean_m,
        max: 1e6 * loss.max_m,
    }
}

/// Summarises a blob that will be written to `path`.
pub fn summarised(path: &Path, blob: &BlobModel) -> BlobSummary {
    BlobSummary {
        file: path.display().to_string(),
        bytes: blob.bytes().len(),
        inducing_points: blob.model().inducing_points(),
        instructions: blob.model().size().map_or(0, |size| size.command_bound()),
    }
}

/// The JSON document that `--json` writes of a calibration by touches.
#[derive(Serialize)]
pub struct TouchJson {
    pub version: &'static str,
    pub robot: String,
    pub touches: TouchSummary,
    /// Record of this arm, which `--prior` reads when a sister arm is calibrated.
    pub arm: ArmRecord,
    /// Warnings that the user must look at.
    pub warnings: Vec<Finding>,
    /// Numbers of the calibrated arm beside those of the nominal model.
    pub controller: ControllerSummary,
    /// Certificate; present with `--report` or a tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
    pub correction_limit_mm: f64,
    pub correction_limit_mrad: f64,
    pub single_precision_loss_um: LossJson,
    pub blob: BlobSummary,
    /// Whether the blob is byte for byte the one that the project file states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeats: Option<bool>,
    pub provenance: Provenance,
}

pub fn document(
    a: &Job,
    calibration: &Calibration,
    blob: &BlobModel,
    precision_loss: &SinglePrecisionLoss,
    training: ErrorSummary,
    provenance: Provenance,
) -> CalibrateJson {
    let step1 = |fit: &FrameFit| Step1 {
        parameters: fit.parameters,
        identifiable: fit.rank,
        iterations: fit.iterations,
        rms: fit.rms,
    };
    let hyperparameters = calibration
        .correction
        .task_space()
        .into_iter()
        .flat_map(|task_space| &task_space.gp.hyperparameters)
        .map(|h| {
            let [a, b, c, d, noise_variance] = h.to_array();
            Hyperparameters {
                theta: [a, b, c, d],
                noise_variance,
            }
        });
    CalibrateJson {
        version: env!("CARGO_PKG_VERSION"),
        method: calibration.config.method.name(),
        robot: blob.blob().robot.name.to_owned(),
        training_poses: training.poses,
        training,
        held_out: None,
        certificate: None,
        expected_error: None,
        next_steps: None,
        step1: calibration.frame_fit().map(step1),
        hyperparameters: hyperparameters.collect(),
        elastic: None,
        gauge: None,
        outliers: Vec::new(),
        warnings: Vec::new(),
        chosen: None,
        choice: None,
        budget: None,
        correction_limit_mm: 1e3 * calibration.correction_limit.0,
        correction_limit_mrad: 1e3 * calibration.correction_limit.1,
        single_precision_loss_um: loss(precision_loss),
        drift: None,
        identifiability: None,
        controller: None,
        frames: changes(calibration),
        blob: summarised(&a.out, blob),
        repeats: None,
        provenance,
    }
}

/// Lists the outliers of a calibration with `samples`, which are the rows of `set`.
pub fn outliers(
    calibration: &Calibration,
    set: &MeasurementSet,
    samples: &[InstrumentSample],
) -> Vec<ListedOutlier> {
    let listed = |o: &Outlier| {
        let [position_sigmas, rotation_sigmas] = o.sigmas;
        let is_turned = samples[o.sample].observation.has_orientation();
        ListedOutlier {
            line: set.measurements[o.sample].line,
            reason: match o.reason {
                Reason::Robust => "far from the calibrated arm",
                Reason::LeaveOneOut => "far from what all other measurements predict",
            },
            chi_squared: o.chi_squared,
            position_sigmas,
            rotation_sigmas: is_turned.then_some(rotation_sigmas),
            rejected: calibration.config.outliers == OutlierPolicy::Reject,
        }
    };
    calibration.outliers.iter().map(listed).collect()
}
