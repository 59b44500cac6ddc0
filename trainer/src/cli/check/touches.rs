//! `trainer check` with touches: tests whether the model still describes the arm, by features at unknown positions.

use std::path::{Path, PathBuf};

use crate::cli::calibrate::gauge;
use crate::cli::check::document::{CheckTouchesJson, Statistic, provenance};
use crate::cli::check::{programs, touch_page, wording};
use crate::cli::failure::Failure;
use crate::cli::inputs::{file_name, fresh};
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::Printer;
use crate::cli::touches::{drawn_robot, read, with_payload};
use crate::report::FileSummary;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, features_beside};
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::validation::command_change::CommandChange;
use poegp_calibration::verification::CheckError;
use poegp_calibration::verification::touches::check_touches;
use poegp_protocol::JointKind;

/// The options of a check by touches.
pub(super) struct Asked<'a> {
    pub blob: &'a Path,
    pub measurements: &'a Path,
    pub features: Option<&'a Path>,
    pub statistic: Statistic,
    pub max_mm: f64,
    pub max_drift_mm: f64,
    pub false_alarms: f64,
    pub previous: Option<&'a Path>,
    pub programs: &'a [PathBuf],
    pub report: Option<&'a Path>,
    pub json: Option<&'a Path>,
}

/// Checks by touches, writes the outputs and prints the findings.
///
/// # Errors
/// [`Failure`]; [`Failure::Quality`] if the calibration does not hold.
pub(super) fn run(a: &Asked<'_>) -> Result<(), Failure> {
    let beside = features_beside(a.measurements);
    let features = a.features.unwrap_or(&beside);
    let mut files: Vec<&Path> = vec![a.blob, a.measurements, features];
    files.extend(a.previous);
    let outputs = [a.json, a.report];
    check_outputs(&outputs, &files)?;
    let loaded = BlobModel::read(a.blob)?;
    let robot = drawn_robot(&loaded);
    let set = read(a.measurements, a.features, &robot)?;
    with_payload(&loaded, &set)?;
    fresh(&loaded, a.measurements, set.sha256[0], "fresh touches")?;
    let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
    let coupling = robot.coupling.as_ref();
    let found = check_touches(&loaded, &set, &nominal, coupling, a.false_alarms)
        .map_err(|error| refused(a.measurements, error))?;
    let error = a.statistic.of(&found.miss_mm);
    let tolerance_met = error <= a.max_mm;
    let drift_matters = !found.changes.is_empty() && found.effect_mm.mean > a.max_drift_mm;
    let advised = wording::Outcome {
        changes: &found.changes,
        without_mm: found.without_mm.mean,
        odd_lines: &found.odd_lines,
        more: "touch 40 times or more",
    };
    let document = CheckTouchesJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        name: file_name(a.measurements),
        holds: tolerance_met && !drift_matters,
        statistic: a.statistic,
        max_mm: a.max_mm,
        tolerance_met,
        max_drift_mm: a.max_drift_mm,
        drift_matters,
        commands_move: commands_move(a.previous, &loaded, &set)?,
        programs: programs::compared(a.programs, &loaded, a.blob)?,
        touches: &found,
        advice: wording::advice(&advised, tolerance_met, drift_matters, a.max_mm),
        provenance: provenance(
            &loaded,
            a.blob,
            set.sha256[0],
            FileSummary::of_touches(&set).into(),
        ),
    };
    let day = loaded.host().provenance.date;
    let json = json_text(&document)?;
    let kinds: Vec<JointKind> = loaded.blob().robot.joints.iter().map(|j| j.kind).collect();
    let page = a
        .report
        .map(|path| (path, touch_page::page(&document, &set, &kinds, day)));
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(page.iter().map(|(path, html)| (*path, html.as_bytes())));
    files.extend(a.json.map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(Printer::for_outputs(&outputs), a, &document, day);
    if document.holds {
        return Ok(());
    }
    let mut reasons = Vec::new();
    if !tolerance_met {
        reasons.push(format!(
            "touches miss by {error:.4} mm ({}), above {} mm",
            a.statistic.name(),
            a.max_mm
        ));
    }
    if drift_matters {
        reasons.push(format!(
            "a drift moves the tip by {:.4} mm on average, above {} mm",
            found.effect_mm.mean, a.max_drift_mm
        ));
    }
    Err(Failure::Quality(format!(
        "the calibration does not hold: {}\nhelp: {}",
        reasons.join(", and "),
        document.advice.join("; ")
    )))
}

fn commands_move(
    previous: Option<&Path>,
    loaded: &BlobModel,
    set: &TouchSet,
) -> Result<Option<CommandChange>, Failure> {
    let Some(path) = previous else {
        return Ok(None);
    };
    let before = gauge::of_robot(path, loaded.blob().robot.name)?;
    let wanted = set.rows.iter();
    let wanted = wanted.map(|row| (row.joints.clone(), row.payload_kg));
    CommandChange::new(&before, loaded, wanted)
        .map(Some)
        .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))
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
        other => InputError::new(path, other.to_string(), "new touches of this robot"),
    }
    .into()
}

fn print(report: Printer, a: &Asked<'_>, d: &CheckTouchesJson<'_>, date: &str) {
    let f = d.touches;
    report.line(format_args!(
        "Model `{}` of {date} on {} new touches: what each misses by, as all others predict it, in mm.\n",
        d.method, f.rows
    ));
    let row = |name: &str, s: &Summary| {
        let mut row = vec![name.to_owned()];
        row.extend([s.mean, s.p95, s.max].map(|x| format!("{x:.4}")));
        row
    };
    let mut rows = vec![row("miss now", &f.miss_mm)];
    if !f.changes.is_empty() {
        rows.push(row("the tip moved by drift", &f.effect_mm));
        rows.push(row("miss without drift", &f.without_mm));
    }
    report.table(&["", "mean", "p95", "max"], &rows);
    report.line("");
    if let Some((change, previous)) = d.commands_move.as_ref().zip(a.previous) {
        report.line(gauge::commands_move(change, previous).trim_start());
    }
    for line in d.programs.iter().map(programs::CorrectedProgram::text) {
        report.line(line);
    }
    report.line(format_args!(
        "Noise of these touches: {:.2} times the stated one; the model is expected to be off by {:.4} mm per axis.",
        f.noise_factor, f.model_mm
    ));
    if !f.model_knows_its_error {
        report.line(
            "warning: this model does not know its own error: false alarms are more frequent than stated (up to 1 in 10 at 1 % on \
             simulated arms).",
        );
    }
    for line in wording::drift(&f.changes, "joint, payload or size", f.false_alarm_rate) {
        report.line(line);
    }
    if !f.odd_lines.is_empty() {
        let lines: Vec<String> = f.odd_lines.iter().map(usize::to_string).collect();
        report.line(format_args!(
            "warning: {} of {} rows do not belong and were left out: lines {}. Touch them again.",
            f.odd_lines.len(),
            f.rows,
            lines.join(", ")
        ));
    }
    for line in wording::sensitivity(&f.sensitivity) {
        report.line(line);
    }
    report.line(match f.size_ppm {
        Some(ppm) => format!("They show a change of the arm's size from {ppm:.0} ppm."),
        None => "They show no change of the arm's size: give one known distance of 200 mm or more."
            .to_owned(),
    });
    report.line(
        "Touches show neither a moved base nor a remounted tool: features and tips were fitted to them.",
    );
    if d.holds {
        report.line(format_args!(
            "The calibration holds: touches miss by {:.4} mm ({}), {} mm are allowed.",
            a.statistic.of(&f.miss_mm),
            a.statistic.name(),
            a.max_mm
        ));
        for advice in &d.advice {
            report.line(format_args!("  {advice}"));
        }
    }
}
