//! The JSON document of `trainer calibrate`.

use std::path::Path;

use serde::Serialize;

use crate::cli::calibrate::calibrated::Calibrated;
use crate::cli::calibrate::elastic_summary::ElasticSummary;
use crate::cli::calibrate::gauge::GaugeSummary;
use crate::cli::calibrate::held_out::SEED;
use crate::cli::calibrate::provenance::provenance;
use crate::cli::failure::Failure;
use crate::cli::instrument_drift;
use crate::cli::terminal::print::warning;
use crate::cli::terminal::warnings;
use crate::report::certificate::{Certificate, Judged};
use crate::report::controller::ControllerSummary;
use crate::report::sections::{BlobSummary, ListedOutlier, LossJson};
use crate::report::{FileSummary, HeldOutSummary, Provenance, ReportData};
use poegp_calibration::blob::precision_loss::SinglePrecisionLoss;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::CalibratedBlob;
use poegp_calibration::identification::frame_fit::FrameFit;
use poegp_calibration::identification::identifiability::IdentifyReport;
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::learning::elastic::outliers::{Outlier, Reason};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::DriftReport;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Calibration;
use poegp_calibration::model::frame_changes::{FrameChange, changes};
use poegp_calibration::model::identified::of_calibration;
use poegp_calibration::model::touches::record::ArmRecord;
use poegp_calibration::model::touches::summary::TouchSummary;
use poegp_calibration::numeric::statistics::{ErrorSummary, Summary};
use poegp_calibration::trust::{Finding, leaves_ranges_out};
use poegp_calibration::validation::conformity::error_quantile::overstated;
use poegp_calibration::validation::device_budget::BudgetTrial;
use poegp_calibration::validation::model_selection::{Choice, Row};
use poegp_calibration::validation::next_steps::{self, Knowledge, NextSteps};
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
    /// Whether the poses leave much of the joint ranges out, where the expected error is a guess.
    #[serde(skip)]
    pub leaves_ranges_out: bool,
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
    #[serde(skip)]
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

/// Returns the document of a calibration. `evidence` are its held-out errors, `choice` how its method was chosen, and
/// `warnings` those about all its measurements.
///
/// # Errors
/// [`Failure`] if base and tool cannot be compared with those that are known.
pub fn document(
    c: &Calibrated<'_>,
    evidence: Option<&ReportData>,
    choice: Option<&Choice>,
    warnings: Vec<Finding>,
) -> Result<CalibrateJson, Failure> {
    let (a, measured) = (c.job, c.measured);
    let (robot, samples) = (&measured.arm.robot, &measured.samples);
    let (calibration, blob) = (&c.found.calibration, &c.found.blob);
    let seed = evidence.is_some().then_some(SEED);
    let mut document = of_fit(c, provenance(c, seed));
    let written = FileSummary::of_bytes("result", a.out.display().to_string(), blob.bytes());
    document.repeats = a.repeats(&written.sha256);
    document.provenance.files.push(written);
    document.gauge = Some(measured.known.summary(calibration, blob, samples)?);
    document.held_out = evidence.map(ReportData::summary);
    let drift = measured.drift.as_ref().map(|d| &d.report);
    document.elastic = ElasticSummary::new(calibration, samples);
    let fitted_noise = (document.elastic.as_ref()).map_or([None; 2], ElasticSummary::noise);
    document.certificate = evidence.map(|evidence| {
        let drift = instrument_drift::known(drift, &measured.set);
        let judged = Judged {
            fitted_noise,
            ..evidence.judged(&c.tests.trained)
        };
        Certificate::new(judged, &a.statement, drift, &a.serial_number)
    });
    document.outliers = outliers(calibration, &measured.set, samples);
    document.choice = choice.map(|choice| choice.table.clone());
    document.chosen = choice.map(Choice::reason);
    document.warnings = warnings;
    document.drift = drift.cloned();
    document.identifiability = of_calibration(calibration, robot, samples);
    let knowledge = Knowledge::new(calibration, robot, samples);
    let own = (knowledge.expected_error()).filter(|_| calibration.has_local_deviation());
    document.expected_error = own
        .map(|own| own.at_least(choice))
        .or_else(|| ExpectedError::new(calibration, robot, samples, choice));
    document.leaves_ranges_out = leaves_ranges_out(samples, &robot.kinds());
    if let Some(worse) = document.worse_anywhere() {
        warnings::add_finding(&worse);
        document.warnings.push(worse);
    }
    let stated = InstrumentNoise::rms_over(samples).position;
    let stated = stated.or(a.statement.noise.position).map(|m| 1e3 * m);
    if let (Some(stated), Some(fitted)) = (stated, fitted_noise[0])
        && let Some(overstated) = overstated(stated, fitted)
    {
        warnings::add_finding(&overstated);
        warning(format_args!("{} [{}]", overstated.text, overstated.cause));
        document.warnings.push(overstated);
    }
    if let Some(text) = document.unlike_training(!a.tests.is_empty()) {
        warnings::add(text);
    }
    document.next_steps = Some(NextSteps::new(&next_steps::Task {
        calibration,
        robot,
        samples,
        knowledge: &knowledge,
        expected: document.expected_error,
        identifiability: document.identifiability.as_ref(),
        instrument_moved_mm: match a.correct_drift {
            true => None,
            false => instrument_drift::clear_motion(&measured.arm, &measured.set, samples),
        },
        warnings: &document.warnings,
    }));
    let predictions = knowledge.predictions();
    document.controller = Some(ControllerSummary::new(blob, robot, predictions, evidence));
    Ok(document)
}

/// Fewest poses, and ratio of their error to the one that the folds expect, from which on a warning asks what differs.
const UNLIKE: (usize, f64) = (5, 3.0);

impl CalibrateJson {
    /// Returns the held-out errors of the chosen model, in mm, if folds were run.
    pub fn held_out_by_folds(&self) -> Option<&Summary> {
        let mut rows = self.choice.iter().flatten();
        rows.find(|row| row.chosen).map(|row| &row.position_mm)
    }

    /// Returns a warning if there are test files that are off by far more than the folds expect: something differs between the
    /// files.
    pub fn unlike_training(&self, has_tests: bool) -> Option<String> {
        let tested = &self.held_out.as_ref()?.calibrated.errors;
        let expected = self.held_out_by_folds()?.mean;
        let ratio = tested.position_mm.mean / expected;
        let is_unlike = has_tests && tested.poses >= UNLIKE.0 && ratio > UNLIKE.1;
        is_unlike.then(|| {
            format!(
                "the error of the test files is {ratio:.1} times the {expected:.3} mm that cross-validation expects: between \
                 training and test, the robot, its payload, the target or the instrument changed, or the test poses are unlike \
                 the measured ones; `trainer check` names a change"
            )
        })
    }

    /// Returns the warning that the model may be worse than the nominal robot where no pose was measured.
    pub fn worse_anywhere(&self) -> Option<Finding> {
        self.expected_error?.finding(self.choice.as_deref()?)
    }
}

/// Returns the part of the document that the fit and its blob decide.
fn of_fit(c: &Calibrated<'_>, provenance: Provenance) -> CalibrateJson {
    let CalibratedBlob {
        calibration,
        blob,
        precision_loss,
    } = c.found;
    let trained_on = calibration.trained_on(&c.measured.samples);
    let training = ErrorSummary::new(&blob.errors(&calibration.without_warm_up(trained_on)));
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
        leaves_ranges_out: false,
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
        blob: summarised(&c.job.out, blob),
        repeats: None,
        provenance,
    }
}

/// Lists the outliers of a calibration with `samples`, which are the rows of `set`.
fn outliers(
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
