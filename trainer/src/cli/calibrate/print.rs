//! The printed output of `trainer calibrate`.

use crate::cli::calibrate::document::CalibrateJson;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::made::Made;
use crate::cli::instrument_drift;
use crate::cli::terminal::print::{Printer, note, warning};
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

/// Ratio of two expected errors from which on the larger one is explained.
const MUCH_LARGER: f64 = 1.5;

/// Prints the error of new poses: of poses like the measured ones, as the folds found it, and, of a model that knows how sure
/// it is where, of joints in any combination.
fn print_expected(report: Printer, calibration: &Calibration, document: &CalibrateJson) {
    let alike = document.held_out_by_folds();
    if let Some(alike) = alike {
        report.line(format_args!(
            "  expected error of new poses like the measured ones: {:.3} mm mean, 95 % within {:.3} mm (held out by folds)",
            alike.mean, alike.p95
        ));
    }
    let anywhere = document.expected_error.as_ref();
    let Some(anywhere) = anywhere.filter(|_| calibration.has_local_deviation()) else {
        return;
    };
    report.line(format_args!(
        "  expected error with joints anywhere in their measured ranges: {:.3} mm mean, 95 % within {:.3} mm",
        anywhere.mean_mm, anywhere.p95_mm
    ));
    if document.leaves_ranges_out {
        report.line(
            "    this is a guess far from the measured poses, which lie on paths, on a grid or in groups",
        );
    } else if alike.is_some_and(|alike| anywhere.mean_mm > MUCH_LARGER * alike.mean) {
        report.line(
            "    it is larger because the measured poses combine the joints in few ways: they lie near each other, or the tool \
             has nearly the same orientation in all of them",
        );
    }
    if let Some(worse) = document.worse_anywhere() {
        warning(format_args!("{} [{}]", worse.text, worse.cause));
    }
    let conformity = (document.certificate.as_ref()).and_then(|c| c.conformity.as_ref());
    let allowed = conformity.and_then(|found| found.position.tolerance);
    if let Some(allowed) = allowed.filter(|allowed| anywhere.p95_mm > *allowed) {
        report.line(format_args!(
            "    beyond the {allowed:.3} mm allowed: the verdict holds for poses like the measured ones"
        ));
    }
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
        // The folds of the choice have found it.
        None if document.held_out_by_folds().is_some() => {}
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
            if let Some(text) = document.unlike_training(!a.tests.is_empty()) {
                warning(text);
            }
            if let Some(text) = never_held_out(held_out.never_held_out) {
                report.line(format_args!("  {text}"));
            }
        }
    }
    if let Some(certificate) = &document.certificate {
        tolerance::print(report, certificate, &a.statement);
    }
    print_expected(report, calibration, document);
    let live = document.controller.as_ref().and_then(|c| c.live_line());
    if let Some(line) = live {
        report.line(format_args!("  {line}"));
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
                false => "kept by --outliers keep",
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
    if let Some(text) = limited_variance(calibration) {
        report.line(format_args!("  note: {text}"));
    }
    match &document.identifiability {
        Some(identifiability) => report.line(identifiability.lines().join("\n")),
        None => report.line("  identifiability: could not be computed for these poses"),
    }
}

/// Returns a note about a signal variance that single precision has limited.
fn limited_variance(calibration: &Calibration) -> Option<String> {
    let found = calibration.correction.task_space()?.max_signal_variance;
    (found < MAX_SIGNAL_VARIANCE)
        .then(|| format!("the signal variance was limited to {found} because of single precision"))
}

/// Returns a note about a standard deviation that the blob lacks.
fn no_deviation(a: &Job, blob: &BlobModel) -> Option<&'static str> {
    let BlobCorrection::TaskSpace(process) = &blob.blob().correction else {
        return None;
    };
    (process.landmarks == 0 && a.config.device_variance).then_some(
        "the blob has no standard deviation: a device has no room for it, or no short enough form is close to eq. 7 of the \
         paper",
    )
}

/// Notes what [`all`] prints in other ways, for a caller that reads notes alone.
pub fn note_all(a: &Job, made: &Made) {
    let document = &made.document;
    let CalibratedBlob {
        calibration, blob, ..
    } = &made.found;
    let elastic = document.elastic.as_ref();
    if let Some(found) = elastic.and_then(|elastic| elastic.warm_up.as_ref()) {
        note(found.line());
    }
    let rest = [
        limited_variance(calibration),
        no_deviation(a, blob).map(str::to_owned),
    ];
    rest.iter().flatten().for_each(note);
    if let Some(certificate) = &document.certificate {
        tolerance::note_missing(certificate, &a.statement);
    }
    note_repeated(a, document.repeats);
}

/// Notes that a blob is not the one that the project file states.
pub fn note_repeated(a: &Job, repeats: Option<bool>) {
    if repeats == Some(false) {
        note(format_args!(
            "{} differs from the blob that the project file states (output.blob_sha256): the file was changed, or another \
             version of the trainer wrote it; `trainer evaluate` on held-out poses shows whether it matters",
            a.out.display()
        ));
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
    if let Some(text) = no_deviation(a, blob) {
        report.line(format_args!("  note: {text}"));
    }
    print_outputs(report, a, document.repeats);
}

/// Prints whether the project was repeated, and which files were written beside the blob.
pub fn print_outputs(report: Printer, a: &Job, repeats: Option<bool>) {
    if repeats == Some(true) {
        report.line("The blob is byte for byte the one that the project file states.");
    }
    note_repeated(a, repeats);
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
