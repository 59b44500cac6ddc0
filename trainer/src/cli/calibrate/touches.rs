//! `trainer calibrate` of touches: sockets, planes, spheres, wires, levels and boards in place of a tracker.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cli::calibrate::gauge::Known;
use crate::cli::calibrate::job::Job;
use crate::cli::examination::settled;
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::inputs::{Arm, origin};
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use poegp_calibration::blob::write::{CalibratedBlob, Provenance};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, features_beside, is_touch_file};
use poegp_calibration::model::Method;
use poegp_calibration::model::touches::record::ArmRecord;
use poegp_calibration::model::touches::summary::TouchSummary;
use poegp_calibration::model::touches::{TouchCalibration, calibrate_beside_sisters};
use poegp_calibration::trust::Finding;

/// What `--json` writes.
#[derive(Serialize)]
pub struct TouchJson {
    pub version: &'static str,
    pub robot: String,
    pub touches: TouchSummary,
    /// What --prior reads for a sister arm.
    pub arm: ArmRecord,
    /// What somebody must look at.
    pub warnings: Vec<Finding>,
    pub blob: TouchBlob,
}

#[derive(Serialize)]
pub struct TouchBlob {
    pub file: String,
    pub bytes: usize,
}

/// Whether a job is one of touches.
pub fn are_touches(a: &Job) -> bool {
    a.table.is_none() && (a.features.is_some() || is_touch_file(&a.train))
}

/// Calibrates by touches and writes what was asked for.
///
/// # Errors
/// [`Failure`], of what is read as of what is found.
pub fn run(a: &Job) -> Result<(), Failure> {
    refuse_options(a)?;
    let outputs = [Some(a.out.as_path()), a.json.as_deref()];
    let beside = features_beside(&a.train);
    let features = a.features.as_deref().unwrap_or(&beside);
    let mut inputs = vec![a.train.as_path(), features, Path::new(&a.robot)];
    inputs.extend(a.gauge.inputs());
    inputs.extend(a.prior.iter().map(PathBuf::as_path));
    check_outputs(&outputs, &inputs)?;
    let arm = Arm::load(&a.robot, &a.chain)?;
    let set = TouchSet::read(&a.train, a.features.as_deref(), &arm.robot)?;
    for text in &set.notes {
        note(format_args!("{}: {text}", a.train.display()));
    }
    let known = Known::read(&a.gauge, &arm.robot.name)?;
    let TouchCalibration {
        calibration,
        samples,
        record,
        summary,
        findings,
        ..
    } = calibrate_beside_sisters(&arm.robot, &set, &a.config, &known.choice, &sisters(a)?)
        .map_err(|error| calibration_failure(&a.train, &error))?
        .map_err(|(index, error)| {
            not_a_sister(&a.prior[index], &arm.robot.name, error.to_string())
        })?;
    contradictions(&set, &summary)?;
    let warnings = settled(&a.train, findings, &a.accept, a.json.as_deref())?;
    let origin = provenance(a, &set, &warnings);
    let found = progress::calibrating(|context| {
        calibration.into_blob(&arm.robot, &samples, &origin, context)
    })?;
    let CalibratedBlob { blob, .. } = found.map_err(|e| device_failure(&a.train, e))?;
    let document = TouchJson {
        version: env!("CARGO_PKG_VERSION"),
        robot: a.robot.clone(),
        touches: summary,
        arm: record,
        warnings,
        blob: TouchBlob {
            file: a.out.display().to_string(),
            bytes: blob.bytes().len(),
        },
    };
    let json = json_text(&document)?;
    let mut files = vec![(a.out.as_path(), blob.bytes())];
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(Printer::for_outputs(&outputs), &document);
    Ok(())
}

/// What `--json` wrote of sister arms.
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

/// What `--prior` expects.
const SISTER: &str = "what `trainer calibrate --json` writes of touches";

fn not_a_sister(path: &Path, robot: &str, found: String) -> Failure {
    let expected =
        format!("a calibration by touches of the same drawing as \"{robot}\", without --prior");
    InputError::new(path, found, expected).into()
}

/// Options that touches leave no sense.
fn refuse_options(a: &Job) -> Result<(), Failure> {
    let given = [
        (!a.tests.is_empty(), "--test"),
        (a.report.is_some(), "--report"),
        (a.write_project.is_some(), "--write-project"),
        (a.correct_drift, "--correct-drift"),
        (
            !a.budget.is_unlimited(),
            "--max-instructions and --max-blob-bytes",
        ),
        (
            !a.auto && a.config.method != Method::Elastic,
            "--method other than elastic",
        ),
    ];
    match given.iter().find(|(is_given, _)| *is_given) {
        Some((_, option)) => Err(Failure::Usage(format!(
            "found {option} with touches ({}), expected measurements of a tracker for it",
            a.train.display()
        ))),
        None => Ok(()),
    }
}

/// Refuses distances that the calibrated touches contradict.
fn contradictions(set: &TouchSet, summary: &TouchSummary) -> Result<(), Failure> {
    for (index, distance) in summary.distances.iter().enumerate() {
        let measured = distance.measured_mm.map(|mm| mm.map(|x| 1e-3 * x));
        let error = measured.and_then(|[found, sigma]| set.contradiction(index, found, sigma));
        if let Some(error) = error {
            return Err(error.into());
        }
    }
    Ok(())
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

fn print(report: Printer, document: &TouchJson) {
    let found = &document.touches;
    report.line(format_args!(
        "Calibrated {} with {} touches ({} equations, {} states of the arm).",
        document.robot, found.rows, found.equations, found.states
    ));
    report.line(format_args!(
        "  expected error over the work volume: {:.3} mm mean before, {:.3} mm after (95 % within {:.3} and {:.3} mm)",
        found.before.mean_mm, found.after.mean_mm, found.before.p95_mm, found.after.p95_mm
    ));
    let [drawn, calibrated] = found.left_out;
    let unit = found.left_out_unit;
    report.line(format_args!(
        "  touches left out miss by {calibrated:.3} {unit}, with the drawing by {drawn:.3} {unit}\n"
    ));
    let row = |f: &poegp_calibration::model::touches::summary::FeatureSummary| {
        vec![
            f.name.clone(),
            f.kind.to_owned(),
            f.rows.to_string(),
            f.rejected.to_string(),
            format!("{:.3}", f.rms[0]),
            format!("{:.3}", f.rms[1]),
            f.unit.to_owned(),
        ]
    };
    report.table(
        &[
            "feature",
            "kind",
            "rows",
            "left out",
            "drawn",
            "calibrated",
            "",
        ],
        &found.features.iter().map(row).collect::<Vec<_>>(),
    );
    for distance in &found.distances {
        let [a, b] = &distance.between;
        report.line(format_args!(
            "  {a} to {b}: {:.3} mm ± {:.3}, as drawn {:+.3}, as calibrated {:+.3}",
            distance.said_mm, distance.sigma_mm, distance.error_mm[0], distance.error_mm[1]
        ));
    }
    for noise in &found.noise {
        report.line(format_args!(
            "  noise of {}: {:.3} {} stated, {:.3} beyond",
            noise.kind, noise.stated, noise.unit, noise.beyond
        ));
    }
    for unseen in &found.unseen {
        report.line(format_args!("  unseen: {}", unseen.text));
    }
    report.line(format_args!(
        "Wrote {} ({} bytes).",
        document.blob.file, document.blob.bytes
    ));
}
