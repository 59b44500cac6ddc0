//! The printed output of `trainer calibrate`.

use crate::cli::calibrate::document::CalibrateJson;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::made::Made;
use crate::cli::instrument_drift;
use crate::cli::terminal::print::{Printer, note};
use crate::cli::tolerance;
use crate::report::never_held_out;
use poegp_calibration::blob::precision_loss::SinglePrecisionLoss;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::CalibratedBlob;
use poegp_calibration::learning::task_space::fit::MAX_SIGNAL_VARIANCE;
use poegp_calibration::model::Calibration;
use poegp_calibration::model::correction::Correction;
use poegp_calibration::validation::device_budget::BudgetTrial;
use poegp_protocol::blob::Correction as BlobCorrection;

/// Prints all results, after the outputs are written.
pub fn all(report: Printer, a: &Job, made: &Made) {
    let Made {
        found, document, ..
    } = made;
    let CalibratedBlob {
        calibration,
        blob,
        precision_loss,
    } = found;
    if let Some(reason) = &document.chosen {
        report.line(format_args!("Model: {reason}."));
    }
    if let Some(rows) = &document.budget {
        print_budget(report, rows);
    }
    if let Some(drift) = &document.drift {
        report.line(drift.lines().join("\n"));
        report.line(instrument_drift::NO_LEAK);
    }
    print(report, a, calibration, precision_loss, document);
    if let Some(gauge) = &document.gauge {
        gauge.print(report, made.previous.as_deref());
    }
    print_files(report, a, blob, document);
}

fn print_budget(report: Printer, rows: &[BudgetTrial]) {
    report.line("Sized to the budget; held-out errors of the training data, in mm.\n");
    let row = |r: &BudgetTrial| {
        vec![
            r.name.to_owned(),
            r.inducing_points.to_string(),
            (if r.predictive_std { "yes" } else { "no" }).to_owned(),
            r.instructions.to_string(),
            r.bytes.to_string(),
            format!("{:.4}", r.position_mm.mean),
            format!(
                "{:+.1} %",
                100.0 * (r.position_mm.mean / rows[0].position_mm.mean - 1.0)
            ),
        ]
    };
    report.table(
        &[
            "model",
            "points",
            "std",
            "instructions",
            "bytes",
            "mean",
            "loss",
        ],
        &rows.iter().map(row).collect::<Vec<_>>(),
    );
    report.line("");
}

fn print(
    report: Printer,
    a: &Job,
    calibration: &Calibration,
    precision_loss: &SinglePrecisionLoss,
    document: &CalibrateJson,
) {
    let training = &document.training;
    let p = &training.position_mm;
    report.line(format_args!(
        "Calibrated {} with `{}` on {} poses.",
        a.robot,
        calibration.config.method.name(),
        training.poses
    ));
    if let Some(fit) = calibration.frame_fit() {
        report.line(format_args!(
            "  step 1: {} of {} parameters are identifiable",
            fit.rank, fit.parameters
        ));
    }
    report.line(format_args!(
        "  training error: {:.4} mm mean, {:.4} mm maximum",
        p.mean, p.max
    ));
    match &document.held_out {
        None => {
            report.line("  (for the held-out error use --report, --test or `trainer evaluate`)")
        }
        Some(held_out) => {
            let (before, after) = (&held_out.nominal.errors, &held_out.calibrated.errors);
            report.line(format_args!(
                "  held-out error on {} poses ({}): {:.4} mm mean, 95 % within {:.4} mm; nominal robot {:.4} and {:.4} mm",
                after.poses,
                held_out.how,
                after.position_mm.mean,
                after.position_mm.p95,
                before.position_mm.mean,
                before.position_mm.p95
            ));
            if let Some(text) = never_held_out(held_out.never_held_out) {
                report.line(format_args!("  {text}"));
            }
        }
    }
    if let Some(certificate) = &document.certificate {
        tolerance::print(report, certificate, &a.statement);
    }
    if let Some(expected) = &document.expected_error {
        report.line(format_args!(
            "  expected error of new poses within the measured joint ranges: {:.3} mm mean, 95 % within {:.3} mm",
            expected.mean_mm, expected.p95_mm
        ));
    }
    if let Some(found) = &document.next_steps {
        for line in found.summary() {
            report.line(format_args!("  next: {line}"));
        }
    }
    if let Some(summary) = &document.elastic {
        summary.print(report);
    }
    for o in &document.outliers {
        report.line(format_args!(
            "  outlier in line {}: {}, {}; {}",
            o.line,
            o.distance(),
            o.reason,
            match o.rejected {
                true => "left out",
                false => "kept; without --outliers keep it is left out",
            }
        ));
    }
    if !matches!(calibration.correction, Correction::None) {
        let (m, rad) = calibration.correction_limit;
        report.line(format_args!(
            "  correction limit: {:.3} mm and {:.3} mrad",
            1e3 * m,
            1e3 * rad
        ));
    }
    report.line(format_args!(
        "  single-precision loss: {:.3} µm mean, {:.3} µm maximum",
        1e6 * precision_loss.mean_m,
        1e6 * precision_loss.max_m
    ));
    if let Some(task_space) = calibration.correction.task_space()
        && task_space.max_signal_variance < MAX_SIGNAL_VARIANCE
    {
        report.line(format_args!(
            "  note: the signal variance was limited to {} because of single precision",
            task_space.max_signal_variance
        ));
    }
    match &document.identifiability {
        Some(identifiability) => report.line(identifiability.lines().join("\n")),
        None => report.line("  identifiability: could not be computed for these poses"),
    }
}

/// Prints which files were written.
fn print_files(report: Printer, a: &Job, blob: &BlobModel, document: &CalibrateJson) {
    let inducing_points = blob.model().inducing_points();
    report.line(format_args!(
        "Wrote {} ({} bytes, {inducing_points} inducing points).",
        a.out.display(),
        blob.bytes().len()
    ));
    if let BlobCorrection::TaskSpace(process) = &blob.blob().correction
        && process.landmarks == 0
        && a.config.device_variance
    {
        report.line(format_args!(
            "  note: the blob has no standard deviation: a device has no room for it, or no form that is short enough is near eq. 7"
        ));
    }
    print_outputs(report, a, document.repeats);
}

/// Prints whether the project was repeated, and which files were written beside the blob.
pub fn print_outputs(report: Printer, a: &Job, repeats: Option<bool>) {
    match repeats {
        Some(true) => {
            report.line("The blob is byte for byte the one that the project file states.");
        }
        Some(false) => note(format_args!(
            "{} differs from the blob that the project file states (output.blob_sha256): another version of the trainer or \
             another kind of processor; `trainer evaluate` on held-out poses shows whether it matters",
            a.out.display()
        )),
        None => {}
    }
    if let Some(path) = &a.write_project {
        report.line(format_args!(
            "Wrote {}: `trainer calibrate {}` does the same again.",
            path.display(),
            path.display()
        ));
    }
    if let Some(path) = &a.report {
        report.line(format_args!(
            "Wrote {}: open it in a browser.",
            path.display()
        ));
    }
}
