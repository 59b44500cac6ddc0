//! `trainer calibrate` of touches: sockets, planes, spheres, wires, levels and boards in place of a tracker.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::cli::calibrate::document::{TouchJson, loss, summarised};
use crate::cli::calibrate::gauge::Known;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::print::print_outputs;
use crate::cli::calibrate::project::Data;
use crate::cli::calibrate::provenance::provenance_of_touches;
use crate::cli::calibrate::report_page;
use crate::cli::calibrate::written_project::{self, Read};
use crate::cli::examination::settled;
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::inputs::{Arm, origin};
use crate::cli::output::{check_not_signed, check_outputs, document_text, write_with_blob};
use crate::cli::terminal::print::Printer;
use crate::cli::terminal::progress;
use crate::cli::tolerance;
use crate::cli::touches::{self, print_distances, print_noise, read, table};
use crate::report::FileSummary;
use crate::report::certificate::Certificate;
use crate::report::controller::ControllerSummary;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{CalibratedBlob, Provenance};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, features_beside, is_touch_file};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::touches::record::ArmRecord;
use poegp_calibration::model::touches::{TouchCalibration, calibrate_beside_sisters};
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::touches::evaluate_touches;

/// Whether a job calibrates by touches.
pub fn are_touches(a: &Job) -> bool {
    a.table.is_none() && (a.features.is_some() || is_touch_file(&a.train))
}

/// A calibration by touches with all its outputs, before anything is written.
pub struct Made {
    pub blob: BlobModel,
    pub document: TouchJson,
    /// The HTML report of `--report`, if it is asked for.
    pub report: Option<String>,
    /// The project file of `--write-project`, if it is asked for.
    project: Option<String>,
}

/// Calibrates by touches and writes the outputs that were asked for.
///
/// # Errors
/// [`Failure`] about the inputs or about the result.
pub fn run(a: &Job) -> Result<(), Failure> {
    let features = features(a);
    let mut inputs = vec![a.train.as_path(), &features, Path::new(&a.robot)];
    inputs.extend(a.project.as_deref());
    inputs.extend(a.gauge.inputs());
    inputs.extend(a.prior.iter().map(PathBuf::as_path));
    no_other_options(a)?;
    let outputs = check_outputs(&a.outputs(), &inputs)?;
    check_not_signed(&a.out)?;
    let made = make(a)?;
    let json = document_text(&made.document)?;
    let csv = made.document.controller.to_csv();
    write_with_blob(
        (&a.out, made.blob.bytes()),
        &[
            (a.report.as_deref(), made.report.as_deref()),
            (a.json.as_deref(), Some(&json)),
            (a.write_project.as_deref(), made.project.as_deref()),
            (a.controller_csv.as_deref(), Some(&csv)),
        ],
    )?;
    let report = Printer::for_outputs(&outputs);
    let certificate = made.document.certificate.as_ref();
    print(report, a, &made.document);
    print_outputs(report, a, made.document.repeats);
    tolerance::outcome(certificate, &a.statement)
}

/// Returns the path of the file that describes the features.
fn features(a: &Job) -> PathBuf {
    a.features
        .clone()
        .unwrap_or_else(|| features_beside(&a.train))
}

/// Calibrates by touches, without writing anything.
///
/// # Errors
/// [`Failure`] about the inputs or about the result.
pub fn make(a: &Job) -> Result<Made, Failure> {
    no_other_options(a)?;
    let arm = Arm::load(&a.robot, &a.chain)?;
    let set = read(&a.train, a.features.as_deref(), &arm.robot)?;
    let known = Known::read(&a.gauge, &arm.robot.name)?;
    let found = calibrate_beside_sisters(&arm.robot, &set, &a.config, &known.choice, &sisters(a)?)
        .map_err(|error| calibration_failure(&a.train, &error))?
        .map_err(|(index, error)| {
            not_a_sister(&a.prior[index], &arm.robot.name, error.to_string())
        })?;
    if let Some(error) = found.contradiction(&set) {
        return Err(error.into());
    }
    let TouchCalibration {
        calibration,
        samples,
        record,
        summary,
        findings,
        ..
    } = found;
    let warnings = settled(&a.train, findings, &a.accept, a.json.as_deref())?;
    let origin = provenance(a, &set, &warnings);
    let found = progress::calibrating(|context| {
        calibration.into_blob(&arm.robot, &samples, &origin, context)
    })?;
    let CalibratedBlob {
        calibration,
        blob,
        precision_loss,
    } = found.map_err(|e| device_failure(&a.train, e))?;
    let written = FileSummary::of_bytes("result", a.out.display().to_string(), blob.bytes());
    let mut provenance = provenance_of_touches(&a.robot, &arm, &origin, &set);
    let sum = written.sha256.clone();
    provenance.files.push(written);
    let is_judged = a.report.is_some() || a.statement.tolerances.is_stated();
    let certificate =
        is_judged.then(|| Certificate::of_touches(&summary, &a.statement, &a.serial_number));
    let document = TouchJson {
        version: env!("CARGO_PKG_VERSION"),
        robot: a.robot.clone(),
        touches: summary,
        arm: record,
        certificate,
        controller: ControllerSummary::new(&blob, &arm.robot, None, None),
        correction_limit_mm: 1e3 * calibration.correction_limit.0,
        correction_limit_mrad: 1e3 * calibration.correction_limit.1,
        single_precision_loss_um: loss(&precision_loss),
        blob: summarised(&a.out, &blob),
        repeats: a.repeats(&sum),
        provenance,
    };
    let report = a.report.is_some().then(|| {
        let found = evaluate_touches(&set, &arm.nominal, arm.robot.coupling.as_ref(), &[&blob]);
        let residuals = found.first().map_or(&[][..], |found| &found.residuals);
        report_page::of_touches(&document, residuals)
    });
    let project = a.write_project.as_deref().map(|path| {
        let date = &origin.date;
        project(a, path, &set, date, blob.bytes())
    });
    Ok(Made {
        blob,
        document,
        report,
        project,
    })
}

/// Reads the records of sister arms from the files of `--prior`, which `--json` wrote.
fn sisters(a: &Job) -> Result<Vec<ArmRecord>, Failure> {
    #[derive(Deserialize)]
    struct File {
        arm: ArmRecord,
    }
    let read = |path: &PathBuf| {
        let bytes = std::fs::read(path).map_err(|e| InputError::unreadable(path, &e, SISTER))?;
        let file: Result<File, _> = serde_json::from_slice(&bytes);
        file.map(|file| file.arm).map_err(|error| {
            InputError::new(path, error.to_string(), SISTER)
                .at_line(error.line())
                .with_help("calibrate the sister arm by touches with --json, and name that file")
                .into()
        })
    };
    a.prior.iter().map(read).collect()
}

/// Description of a `--prior` file in error messages.
const SISTER: &str = "the JSON of a calibration by touches, from `trainer calibrate --json`";

fn not_a_sister(path: &Path, robot: &str, found: String) -> Failure {
    let expected =
        format!("a calibration by touches of the same type of arm as \"{robot}\", without --prior");
    InputError::new(path, found, expected).into()
}

/// Returns the text of the project file that repeats this calibration.
fn project(a: &Job, path: &Path, set: &TouchSet, date: &str, blob: &[u8]) -> String {
    let features = features(a);
    let [rows, described] = FileSummary::of_touches(set).map(|file| file.sha256);
    let data = |path, sha256| Data { path, sha256 };
    let read = Read {
        train: data(&a.train, rows),
        features: Some(data(&features, described)),
        tests: Vec::new(),
        payloads_and_tools: (Vec::new(), Vec::new()),
    };
    let calibration = Config {
        method: Method::Parametric,
        ..a.config
    };
    written_project::text(a, path, read, calibration, date, blob)
}

/// Refuses options that make no sense with touches.
fn no_other_options(a: &Job) -> Result<(), Failure> {
    if !a.prior.is_empty() && a.write_project.is_some() {
        return Err(Failure::Usage(
            "found --prior and --write-project, expected one of them: a project file does not keep --prior".into(),
        ));
    }
    let given = [
        (!a.tests.is_empty(), "--test"),
        (a.correct_drift, "--correct-drift"),
        (
            !a.budget.is_unlimited(),
            "--max-instructions and --max-blob-bytes",
        ),
        (
            !a.auto && a.config.method != Method::Parametric,
            "--method other than parametric",
        ),
        (
            a.statement.tolerances.orientation_mrad.is_some(),
            "--tolerance-mrad",
        ),
    ];
    touches::refuse_options(&a.train, &given)
}

fn provenance(a: &Job, set: &TouchSet, warnings: &[Finding]) -> Provenance {
    let tools = set.tips.iter().map(|tip| tip.name.clone()).collect();
    let mut out = origin(set.sha256[0], &a.serial_number, tools);
    if let Some(date) = &a.date {
        out.date.clone_from(date);
    }
    out.warnings = warnings.iter().map(|f| f.cause).collect();
    out.accepted = a.accept.iter().copied().collect();
    out
}

fn print(report: Printer, a: &Job, document: &TouchJson) {
    let found = &document.touches;
    report.line(format_args!(
        "Calibrated {} with {} touches ({} equations, {} states of the arm).",
        document.robot, found.rows, found.equations, found.states
    ));
    report.line(format_args!(
        "  expected error over the work volume: {:.3} mm mean before, {:.3} mm after (95 % within {:.3} and {:.3} mm), \
         including what the touches do not determine",
        found.before.mean_mm, found.after.mean_mm, found.before.p95_mm, found.after.p95_mm
    ));
    if let Some(certificate) = &document.certificate {
        tolerance::print(report, certificate, &a.statement);
    }
    if let Some(line) = document.controller.live_line() {
        report.line(format_args!("  {line}"));
    }
    let [nominal, calibrated] = found.left_out;
    let unit = found.left_out_unit;
    report.line(format_args!(
        "  touches left out miss by {calibrated:.3} {unit}, with the nominal model by {nominal:.3} {unit}\n"
    ));
    let features = found.features.iter().chain(&found.tracker).collect();
    table(report, &[("calibrated", features)]);
    print_distances(report, &found.distances, "as calibrated");
    print_noise(report, &found.noise);
    for unseen in &found.unseen {
        report.line(format_args!("  unseen: {}", unseen.text));
    }
    report.line(format_args!(
        "Wrote {} ({} bytes).",
        document.blob.file, document.blob.bytes
    ));
}
