//! The JSON document of `trainer check`.

use std::path::Path;

use clap::ValueEnum;
use serde::Serialize;

use crate::cli::check::programs::CorrectedProgram;
use crate::cli::check::unexplained;
use crate::cli::inputs::now;
use crate::report::certificate::Certificate;
use crate::report::{FileSummary, Provenance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::validation::command_change::CommandChange;
use poegp_calibration::verification::result::Report as Findings;
use poegp_calibration::verification::touches::TouchReport;

/// What `--max-mm` is the bound of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Statistic {
    /// Mean, the most certain for few poses.
    Mean,
    /// 95th percentile.
    P95,
    /// Maximum.
    Max,
}

impl Statistic {
    pub fn of(self, summary: &Summary) -> f64 {
        match self {
            Self::Mean => summary.mean,
            Self::P95 => summary.p95,
            Self::Max => summary.max,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::P95 => "95 %",
            Self::Max => "largest",
        }
    }

    /// Key of this statistic in a summary of the JSON document.
    pub fn key(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::P95 => "p95",
            Self::Max => "max",
        }
    }
}

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct CheckJson<'a> {
    pub version: &'static str,
    pub method: &'a str,
    #[serde(skip)]
    pub training_poses: u32,
    pub name: String,
    /// Whether the calibration holds, which decides the exit code.
    pub holds: bool,
    pub statistic: Statistic,
    pub max_mm: f64,
    pub tolerance_met: bool,
    pub max_drift_mm: f64,
    /// Whether `max_drift_mm` is the default.
    #[serde(skip)]
    pub is_default_drift: bool,
    /// Whether a drift was found that moves the target by more than `max_drift_mm`.
    pub drift_matters: bool,
    /// Change of the commands against those of an earlier blob.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commands_move: Option<CommandChange>,
    /// Programs that a model has corrected.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub programs: Vec<CorrectedProgram>,
    /// Whether the arm conforms to a tolerance.
    pub certificate: Certificate,
    /// Whether orientations were compared with a tolerance.
    pub orientation_judged: bool,
    /// Sentence about the frames that were fitted to the measurements before the check.
    #[serde(skip)]
    pub fitted: Option<String>,
    #[serde(flatten)]
    pub findings: Findings,
    /// Advice on what to do next.
    pub advice: Vec<String>,
    pub provenance: Provenance,
}

impl CheckJson<'_> {
    /// States that orientations were not judged; `None` if they were, or none was measured.
    pub fn orientation(&self) -> Option<String> {
        match self.orientation_judged {
            true => None,
            false => unexplained::orientation(&self.findings),
        }
    }
}

/// The JSON document that `--json` writes of a check by touches.
#[derive(Serialize)]
pub struct CheckTouchesJson<'a> {
    pub version: &'static str,
    pub method: &'a str,
    pub name: String,
    /// Whether the calibration holds, which decides the exit code.
    pub holds: bool,
    pub statistic: Statistic,
    pub max_mm: f64,
    pub tolerance_met: bool,
    pub max_drift_mm: f64,
    pub drift_matters: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commands_move: Option<CommandChange>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub programs: Vec<CorrectedProgram>,
    pub touches: TouchReport,
    pub advice: Vec<String>,
    pub provenance: Provenance,
}

/// Returns the provenance of a check: the model, and the measured `files`.
pub fn provenance(loaded: &BlobModel, blob: &Path, mut files: Vec<FileSummary>) -> Provenance {
    let path = blob.display().to_string();
    files.push(FileSummary::of_bytes("model", path, loaded.bytes()));
    let robot = &loaded.blob().robot;
    let date = now().date().to_string();
    Provenance::new(robot.name, robot.serial_number, date, files)
}
