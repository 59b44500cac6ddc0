//! `trainer check` with touches: tests whether the model still describes the arm, by features at unknown positions.

use std::path::{Path, PathBuf};

use crate::cli::calibrate::gauge;
use crate::cli::check::document::{CheckTouchesJson, provenance};
use crate::cli::check::unexplained::Rest;
use crate::cli::check::{Check, advice, options, programs, touch_page, wording};
use crate::cli::failure::Failure;
use crate::cli::inputs::{file_name, fresh};
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, document_text, write_texts};
use crate::cli::terminal::print::{Printer, error_row};
use crate::cli::terminal::warnings::{self, WARNING};
use crate::cli::touches::{nominal_robot, read, refuse_options, with_payload};
use crate::report::FileSummary;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, features_beside};
use poegp_calibration::verification::CheckError;
use poegp_calibration::verification::touches::check_touches;

/// Checks by touches, writes the outputs and prints the findings.
///
/// # Errors
/// [`Failure`]; [`Failure::Quality`] if the calibration does not hold.
pub fn run(a: &Check) -> Result<(), Failure> {
    refuse_others(a)?;
    options(a)?;
    let features = a.features.as_deref();
    let beside = features_beside(&a.measurements);
    let mut files: Vec<&Path> = vec![&a.blob, &a.measurements, features.unwrap_or(&beside)];
    files.extend(a.previous.as_deref());
    let programs = programs::files(&a.programs);
    files.extend(programs.iter().map(PathBuf::as_path));
    let outputs = [
        (a.json.as_deref(), Kind::Json),
        (a.report.as_deref(), Kind::Report),
    ];
    let outputs = check_outputs(&outputs, &files)?;
    let loaded = BlobModel::read(&a.blob)?;
    let (document, set) = checked(a, &loaded)?;
    let day = loaded.host().provenance.date;
    let json = document_text(&document)?;
    let kinds = loaded.kinds();
    let page = a
        .report
        .as_ref()
        .map(|_| touch_page::page(&document, &set, &kinds, day));
    write_texts(&[(outputs[1], page.as_deref()), (outputs[0], Some(&json))])?;
    print(Printer::for_outputs(&outputs), a, &document, day);
    if document.holds {
        return Ok(());
    }
    let found = &document.touches;
    let (name, by) = (a.statistic.name(), found.effect_mm.mean);
    let error = a.statistic.of(&found.miss_mm);
    let error =
        (!document.tolerance_met).then(|| format!("touches miss by {error:.4} mm ({name})"));
    let drift =
        (document.drift_matters).then(|| format!("a drift moves the tip by {by:.4} mm on average"));
    let reasons = [(error, a.max_mm), (drift, document.max_drift_mm)];
    Err(advice::does_not_hold(reasons, &document.advice))
}

/// Refuses options that have no meaning for touches.
fn refuse_others(a: &Check) -> Result<(), Failure> {
    let noise = a.noise.instrument_noise();
    let given = [
        (a.frames.fit_base, "--fit-base"),
        (a.frames.fit_tool.is_some(), "--fit-tool"),
        (a.frames.correct_drift, "--correct-drift"),
        (noise.position.is_some(), "--position-sigma-mm"),
        (noise.orientation.is_some(), "--orientation-sigma-mrad"),
        (!a.accepted.accept.is_empty(), "--accept"),
        (
            a.tolerance.is_given(),
            "--tolerance-mm, --tolerance-mrad or --coverage",
        ),
    ];
    refuse_options(&a.measurements, &given)
}

/// Checks `loaded`, which takes the place of the blob in `a`, by touches in a file, without writing any output; returns the JSON
/// document.
///
/// # Errors
/// [`Failure`] about the inputs. A calibration that does not hold is no error.
pub fn document(a: &Check, loaded: &BlobModel) -> Result<String, Failure> {
    document_text(&checked(a, loaded)?.0)
}

/// Checks a model by touches; returns the findings, and the touches.
fn checked<'a>(
    a: &Check,
    loaded: &'a BlobModel,
) -> Result<(CheckTouchesJson<'a>, TouchSet), Failure> {
    refuse_others(a)?;
    let (options, max_drift_mm) = (options(a)?, a.max_drift_mm());
    let features = a.features.as_deref();
    let robot = nominal_robot(loaded);
    let set = read(&a.measurements, features, &robot)?;
    with_payload(loaded, &set)?;
    with_trained_payload(loaded, &set)?;
    fresh(loaded, &a.measurements, set.sha256[0], "fresh touches")?;
    let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
    let found = check_touches(loaded, &set, &robot, &nominal, options.false_alarms)
        .map_err(|error| refused(&a.measurements, error))?;
    let error = a.statistic.of(&found.miss_mm);
    let tolerance_met = error <= a.max_mm;
    let drift_matters = !found.changes.is_empty() && found.effect_mm.mean > max_drift_mm;
    let advised = advice::Outcome {
        changes: &found.changes,
        without_mm: a.statistic.of(&found.without_mm),
        rest: Rest::of_touches(found.noise_factor),
        outlier_lines: &found.outlier_lines,
        during: None,
        payloads: None,
        is_searched: true,
        more: "touch 40 times or more and calibrate again",
    };
    let wanted = set.rows.iter();
    let wanted = wanted.map(|row| (row.joints.clone(), row.payload_kg));
    let document = CheckTouchesJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        name: file_name(&a.measurements),
        holds: tolerance_met && !drift_matters,
        statistic: a.statistic,
        max_mm: a.max_mm,
        tolerance_met,
        max_drift_mm,
        drift_matters,
        commands_move: gauge::commands_moved(a.previous.as_deref(), loaded, wanted)?,
        programs: programs::compared(&a.programs, loaded, &a.blob)?,
        advice: advice::advice(&advised, tolerance_met, drift_matters, a.max_mm),
        provenance: provenance(loaded, &a.blob, FileSummary::of_touches(&set).into()),
        touches: found,
    };
    warnings::add_lines(&last_lines(&document));
    Ok((document, set))
}

/// Refuses touches with a payload that the model was not trained with: the arm sags differently, which looks like a change.
fn with_trained_payload(loaded: &BlobModel, set: &TouchSet) -> Result<(), InputError> {
    let Some((light, heavy)) = loaded.blob().ranges.payload_kg else {
        return Ok(());
    };
    // As the device reads it.
    let is_outside = |kg: &f64| !(light..=heavy).contains(&(*kg as f32));
    let mut outside = set.rows.iter().filter_map(|row| {
        let kg = row.payload_kg.filter(is_outside)?;
        Some((row.line, kg))
    });
    let Some((line, kg)) = outside.next() else {
        return Ok(());
    };
    let trained = wording::payloads((light.into(), heavy.into()));
    let expected = format!(
        "{trained}, with which the model was trained: it does not describe how the arm sags under another payload"
    );
    Err(InputError::new(&set.path, format!("a payload of {kg} kg"), expected).at_line(line))
}

fn refused(path: &Path, error: CheckError) -> Failure {
    match error {
        CheckError::TooFew {
            poses,
            equations,
            needed,
        } => InputError::new(
            path,
            format!("{poses} states of the arm ({equations} equations)"),
            format!(
                "at least {needed}: features, tips, joints and noise are all estimated from them"
            ),
        )
        .with_help("touch ten to twenty times, in orientations that differ"),
        CheckError::NothingShown => InputError::new(
            path,
            "touches that show no change of a joint or the payload",
            "more touches than features and tips have unknowns, in other orientations",
        )
        .with_help("touch ten to twenty times, in orientations that differ"),
        CheckError::NoPosition => InputError::new(
            path,
            "rows of a level alone, whose errors are angles",
            "rows of another kind as well: --max-mm limits errors in mm",
        )
        .with_help(
            "touch a socket, a plate, a ball or a wire, or look at a board, ten to twenty times",
        ),
        other => InputError::new(path, other.to_string(), "new touches of this robot"),
    }
    .into()
}

fn print(report: Printer, a: &Check, d: &CheckTouchesJson<'_>, date: &str) {
    let f = &d.touches;
    report.line(format_args!(
        "Model `{}` of {date} on {} new touches: the miss of each, predicted from all others, in mm.\n",
        d.method, f.rows
    ));
    let mut rows = vec![error_row("miss now", &f.miss_mm)];
    if !f.changes.is_empty() {
        rows.push(error_row("the tip moved by drift", &f.effect_mm));
        rows.push(error_row("miss without drift", &f.without_mm));
    }
    report.table(&["", "mean", "p95", "max"], &rows);
    report.line("");
    if let Some((change, previous)) = d.commands_move.as_ref().zip(a.previous.as_deref()) {
        report.line(gauge::commands_move(change, previous).trim_start());
    }
    for line in d.programs.iter().map(programs::CorrectedProgram::text) {
        report.line(line);
    }
    report.line(format_args!(
        "Noise of these touches: {:.2} times the stated one; model error estimated from these rows: {:.4} mm per axis.",
        f.noise_factor, f.model_mm
    ));
    last_lines(d).into_iter().for_each(|line| report.line(line));
    let hidden = wording::hidden_joint(&f.sensitivity, d.max_drift_mm);
    if d.holds {
        let so_far = hidden.map_or("", |_| " as far as these touches show");
        report.line(format_args!(
            "The calibration holds{so_far}: touches miss by {:.4} mm ({}), within the {} mm allowed.",
            a.statistic.of(&f.miss_mm),
            a.statistic.name(),
            a.max_mm
        ));
        for advice in &d.advice {
            report.line(format_args!("  {advice}"));
        }
    }
}

/// Lines with what was found and what may be hidden, some of them warnings.
fn last_lines(d: &CheckTouchesJson<'_>) -> Vec<String> {
    let f = &d.touches;
    let mut lines = Vec::new();
    if let Some(text) = wording::unknown_error_by_touches(f) {
        lines.push(format!("{WARNING}{text}"));
    }
    lines.extend(wording::drift(
        &f.changes,
        "joint, payload or size",
        f.false_alarm_rate,
    ));
    if !f.outlier_lines.is_empty() {
        let rows: Vec<String> = f.outlier_lines.iter().map(usize::to_string).collect();
        let (which, again) = match f.outlier_lines.len() {
            1 => (
                format!(
                    "one of {} rows is an outlier and was left out: line",
                    f.rows
                ),
                "it",
            ),
            count => (
                format!(
                    "{count} of {} rows are outliers and were left out: lines",
                    f.rows
                ),
                "them",
            ),
        };
        lines.push(format!(
            "{WARNING}{which} {}. Touch {again} again.",
            rows.join(", ")
        ));
    }
    lines.extend(wording::sensitivity(&f.sensitivity, "These touches"));
    lines.push(match f.size_ppm {
        Some(ppm) => format!("They show a change of the arm's size of {ppm:.0} ppm or more."),
        None => {
            "They show no change of the arm's size: state one known distance of 200 mm or more."
                .to_owned()
        }
    });
    lines.push(wording::TOUCHES_DO_NOT_SHOW.to_owned());
    let hidden = wording::hidden_joint(&f.sensitivity, d.max_drift_mm);
    lines.extend(hidden.map(|text| format!("{WARNING}{text}")));
    lines
}
