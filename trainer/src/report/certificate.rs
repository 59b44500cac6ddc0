//! The certificate: whether an arm conforms to a tolerance, who measured it with which instrument, and what is missing.

use std::collections::BTreeMap;

use poegp_calibration::measurement::folds::same_configurations;
use poegp_calibration::measurement::instrument_drift::DriftReport;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::model::touches::summary::TouchSummary;
use poegp_calibration::validation::conformity::{Conformity, Knowledge, Tolerances};
use poegp_calibration::validation::held_out::HeldOutPose;
use poegp_calibration::validation::repeated_poses::{RepeatedPose, repeated_poses};
use poegp_protocol::JointKind;
use serde::{Deserialize, Serialize};

use crate::report::{FileSummary, ReportData, Row};

/// Coverage factor of the expanded uncertainty that a certificate states.
const CERTIFICATE_FACTOR: f64 = 2.0;

/// Instrument that measured the poses; the table `[instrument]` of a project file.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table [instrument] with name, certificate, expanded_uncertainty_mm and expanded_uncertainty_mrad"
)]
pub struct Instrument {
    /// Type and serial number of the instrument.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Number and day of the instrument's certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<String>,
    /// Expanded uncertainty (k = 2) of a position by the instrument's certificate, common to all poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expanded_uncertainty_mm: Option<f64>,
    /// Expanded uncertainty (k = 2) of a rotation by the instrument's certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expanded_uncertainty_mrad: Option<f64>,
}

/// Operator and site of the measurement; the table `[record]` of a project file.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table [record] with operator, site and temperature_c"
)]
pub struct Record {
    /// Name of the operator.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// Site of the measurement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub site: Option<String>,
    /// Temperature of the air in °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
}

/// Tolerances and statements on the measurement, for a certificate.
#[derive(Clone, Debug, Default)]
pub struct Statement {
    /// Tolerances that the arm has to meet.
    pub tolerances: Tolerances,
    /// Noise of rows that declare none.
    pub noise: InstrumentNoise,
    /// Instrument that measured the poses.
    pub instrument: Instrument,
    /// Operator and site of the measurement.
    pub record: Record,
}

/// A pose that was measured several times, identified by its first row.
#[derive(Clone, Debug, Serialize)]
pub struct ListedPose {
    /// Name of the file.
    pub file: String,
    /// Line of the first measurement.
    pub line: usize,
    /// Accuracy AP and repeatability RP of the pose.
    #[serde(flatten)]
    pub found: RepeatedPose,
}

/// The part `certificate` of a JSON document.
#[derive(Clone, Debug, Serialize)]
pub struct Certificate {
    /// Errors, uncertainties and the verdict; absent when there are too few poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conformity: Option<Conformity>,
    /// Accuracy and repeatability of poses that were measured several times (ISO 9283).
    pub repeated_poses: Vec<ListedPose>,
    /// Instrument that measured the poses.
    pub instrument: Instrument,
    /// Operator and site of the measurement.
    pub record: Record,
    /// Statements that are missing.
    pub missing: Vec<&'static str>,
    /// SHA-256 of the program; present with a tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program_sha256: Option<String>,
}

/// Poses that a model was not trained on.
#[derive(Clone, Debug)]
pub struct Judged<'a> {
    /// Errors of the model at these poses.
    pub poses: Vec<HeldOutPose>,
    /// Rows of the poses.
    pub rows: Vec<Row>,
    /// Kinds of the joints.
    pub kinds: &'a [JointKind],
    /// Standard deviation of one component that the model found at its training poses, in mm and mrad, if it is known.
    pub fitted_noise: [Option<f64>; 2],
}

impl ReportData {
    /// Returns the rows with the errors of the report's model, without those whose poses were trained on: `trained` says so of
    /// each row of the test sets.
    pub fn judged(&self, trained: &[bool]) -> Judged<'_> {
        let is_new = |i: &usize| trained.get(*i) != Some(&true);
        let new = || (0..self.rows.len()).filter(is_new);
        Judged {
            poses: new().map(|i| self.calibrated().poses[i]).collect(),
            rows: new().map(|i| self.rows[i].clone()).collect(),
            kinds: &self.kinds,
            fitted_noise: [None; 2],
        }
    }
}

impl Certificate {
    /// Creates the certificate for poses that were judged. `drift` is the drift of the instrument, and whether it was
    /// removed.
    pub fn new(
        judged: Judged<'_>,
        statement: &Statement,
        drift: Option<(DriftReport, bool)>,
        serial_number: &str,
    ) -> Self {
        let with_noise = |pose: &HeldOutPose| HeldOutPose {
            noise: pose.noise.or(statement.noise),
            ..*pose
        };
        let poses: Vec<HeldOutPose> = judged.poses.iter().map(with_noise).collect();
        let repeats = repeats(&judged);
        let half = |u: Option<f64>| u.map(|u| u / CERTIFICATE_FACTOR);
        let Statement {
            tolerances,
            instrument,
            record,
            ..
        } = statement;
        let knowledge = Knowledge {
            repeats: &repeats,
            drift: drift
                .as_ref()
                .map(|(report, is_removed)| (report, *is_removed)),
            instrument: [
                half(instrument.expanded_uncertainty_mm),
                half(instrument.expanded_uncertainty_mrad),
            ],
            fitted_noise: judged.fitted_noise,
        };
        let listed = |found: RepeatedPose| {
            let Row { file, line, .. } = &judged.rows[found.first];
            ListedPose {
                file: file.clone(),
                line: *line,
                found,
            }
        };
        Self {
            conformity: Conformity::new(&poses, &knowledge, tolerances),
            repeated_poses: repeated_poses(&poses, &repeats)
                .into_iter()
                .map(listed)
                .collect(),
            instrument: instrument.clone(),
            record: record.clone(),
            missing: missing(statement, serial_number),
            program_sha256: tolerances.is_stated().then(program_sha256).flatten(),
        }
    }

    /// Creates the certificate of a calibration by touches.
    pub fn of_touches(found: &TouchSummary, statement: &Statement, serial_number: &str) -> Self {
        let tolerances = &statement.tolerances;
        let by_class = |tolerance_mm| found.left_to_class(tolerance_mm);
        Self {
            conformity: Some(Conformity::of_touches(
                &found.exceeded,
                tolerances,
                by_class,
            )),
            repeated_poses: Vec::new(),
            instrument: statement.instrument.clone(),
            record: statement.record.clone(),
            missing: missing(statement, serial_number),
            program_sha256: tolerances.is_stated().then(program_sha256).flatten(),
        }
    }
}

fn missing(statement: &Statement, serial_number: &str) -> Vec<&'static str> {
    let Statement {
        instrument, record, ..
    } = statement;
    let missing = [
        ("the instrument", instrument.name.is_none()),
        (
            "the instrument's certificate",
            instrument.certificate.is_none(),
        ),
        (
            "the instrument's uncertainty",
            instrument.expanded_uncertainty_mm.is_none(),
        ),
        ("the operator", record.operator.is_none()),
        ("the site", record.site.is_none()),
        ("the temperature", record.temperature_c.is_none()),
        ("the robot's serial number", serial_number.is_empty()),
    ];
    let missing = missing.iter().filter(|(_, is_missing)| *is_missing);
    missing.map(|(what, _)| *what).collect()
}

/// Returns for each row the number of the pose that it measures: rows with equal joints, payload and tool measure one pose,
/// in whichever file they are.
fn repeats(judged: &Judged<'_>) -> Vec<usize> {
    let joints: Vec<&[f64]> = judged.rows.iter().map(|r| r.joints.as_slice()).collect();
    let configurations = same_configurations(&joints, judged.kinds);
    let mut known = BTreeMap::new();
    let mut out = Vec::with_capacity(judged.rows.len());
    for (row, configuration) in judged.rows.iter().zip(configurations) {
        let payload = row.payload_kg.map(f64::to_bits);
        let next = known.len();
        let pose = (&row.tool, payload, configuration);
        out.push(*known.entry(pose).or_insert(next));
    }
    out
}

/// SHA-256 of the executable file of this process; `None` where it cannot be read.
fn program_sha256() -> Option<String> {
    let bytes = std::fs::read(std::env::current_exe().ok()?).ok()?;
    Some(FileSummary::of_bytes("", "", &bytes).sha256)
}
