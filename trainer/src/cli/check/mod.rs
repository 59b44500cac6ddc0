//! `trainer check`: tests with a few fresh measurements whether the calibration still holds.

mod document;
mod page;
mod programs;
mod touch_page;
mod touches;
mod wording;

use std::path::{Path, PathBuf};

use crate::cli::args::{FrameArgs, NoiseArgs, heading};
use crate::cli::calibrate::gauge;
use crate::cli::check::document::{CheckJson, Statistic, provenance};
use crate::cli::examination::{AcceptArgs, settled};
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::{self, FRAMES_HELP, file_name, fitted_frames, frame_failure};
use crate::cli::instrument_drift;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::Printer;
use crate::cli::tolerance::{self, ToleranceArgs, ToleranceTable};
use crate::cli::touches::{are_touches, refuse_options};
use crate::report::certificate::{Certificate, Judged, Statement};
use crate::report::{FileSummary, data, sections};
use clap::Args;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::trust::{self, Finding, Findings};
use poegp_calibration::validation::command_change::CommandChange;
use poegp_calibration::verification as check;
use poegp_calibration::verification::CheckError;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;

/// Default limit of the displacement by a drift, as a share of `--max-mm`.
const DRIFT_SHARE: f64 = 0.5;
/// Smallest and largest rate of false alarms that the number of random draws can resolve.
const RATES: (f64, f64) = (0.001, 0.2);

/// `trainer check`.
#[derive(Debug, Args)]
#[command(
    after_help = "Ten to twenty poses, spread over the joints as in training. The calibration does not hold (exit code 1) if \
    --max-mm is not met, or if a detected drift moves the target by more than --max-drift-mm on average.\n\n\
    Examples:\n  trainer check arm.blob monday.csv --max-mm 0.15\n  \
    trainer check arm.blob touches.csv --features touches.toml --max-mm 0.3\n  \
    trainer check arm.blob monday.csv --max-mm 0.15 --report monday.html\n  \
    trainer check arm.blob monday.csv --max-mm 0.15 --programs corrected\n  \
    trainer check arm.blob monday.csv --max-mm 0.15 --fit-base   (the tracker was moved)"
)]
pub struct Check {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// New measurements of the robot, or touches.
    pub measurements: PathBuf,
    /// Tolerance of the position error, including measurement noise; for touches, of each touch's miss as
    /// predicted by all others.
    #[arg(long, value_name = "MM")]
    pub max_mm: f64,
    /// Statistic of the position errors to compare with the tolerance.
    #[arg(long, value_enum, default_value_t = Statistic::Mean)]
    pub statistic: Statistic,
    /// Tolerance of the mean displacement of the target by a detected drift (default: half of --max-mm).
    #[arg(long, value_name = "MM")]
    pub max_drift_mm: Option<f64>,
    /// Share of unchanged robots for which the check reports a drift.
    #[arg(long, value_name = "RATE", default_value_t = 0.01)]
    pub false_alarms: f64,
    /// Print how far the commands differ from those of an earlier blob of this robot.
    #[arg(long, value_name = "BLOB")]
    pub previous: Option<PathBuf>,
    /// Corrected program, or a folder of them; may be repeated. Print which of them another model corrected,
    /// and how far their targets would move with this one.
    #[arg(long, value_name = "PATH")]
    pub programs: Vec<PathBuf>,
    /// Write an HTML report: pass/fail, errors against the tolerance, detected changes.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write the findings as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Description of the touched features (TOML; default: NAME.toml beside NAME.csv).
    #[arg(long, value_name = "FILE", help_heading = heading::MEASUREMENTS)]
    pub features: Option<PathBuf>,
    #[command(flatten, next_help_heading = heading::MEASUREMENTS)]
    pub noise: NoiseArgs,
    #[command(flatten, next_help_heading = heading::MEASUREMENTS)]
    pub accepted: AcceptArgs,
    #[command(flatten, next_help_heading = heading::FRAMES)]
    pub frames: FrameArgs,
    #[command(flatten, next_help_heading = heading::TOLERANCE)]
    pub tolerance: ToleranceArgs,
}

pub fn run(a: &Check) -> Result<(), Failure> {
    if are_touches(&a.measurements, a.features.as_deref()) {
        return of_touches(a);
    }
    let outputs = [a.json.as_deref(), a.report.as_deref()];
    let mut files: Vec<&Path> = vec![&a.blob, &a.measurements];
    files.extend(a.previous.as_deref());
    check_outputs(&outputs, &files)?;
    let options = options(a)?;
    let loaded = BlobModel::read(&a.blob)?;
    let correction = instrument_drift::correction(a.frames.correct_drift);
    let data = inputs::read(&loaded, &Input::file(&a.measurements), correction)?;
    let sha256 = data.set.sha256;
    inputs::fresh(&loaded, &a.measurements, sha256, "fresh measurements")?;
    let mut warnings = data.examined(
        &a.measurements,
        a.json.as_deref(),
        &a.accepted.accept,
        &inputs::robot_of(loaded.blob()),
    )?;
    let tools = data.frames(&loaded, &a.measurements, options.frames)?;
    let lines: Vec<usize> = data.set.measurements.iter().map(|m| m.line).collect();
    let noise = overstated_noise(&loaded, &data.samples, &tools, &lines, &options);
    let (accept, json) = (&a.accepted.accept, a.json.as_deref());
    let noise = Findings(noise.into_iter().collect());
    warnings.extend(settled(&a.measurements, noise, accept, json)?);
    let findings = check::check(&loaded, &data.samples, tools, &lines, &options)
        .map_err(|error| refused(a, &data.names, error))?;
    let commands_move = a
        .previous
        .as_deref()
        .map(|path| -> Result<CommandChange, Failure> {
            let before = gauge::of_robot(path, loaded.blob().robot.name)?;
            let wanted = data.samples.iter();
            let wanted = wanted.map(|s| (s.joints.clone(), s.payload_kg));
            CommandChange::new(&before, &loaded, wanted)
                .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))
        })
        .transpose()?;
    let error = a.statistic.of(&findings.errors.position_mm);
    let max_drift_mm = a.max_drift_mm.unwrap_or(DRIFT_SHARE * a.max_mm);
    let tolerance_met = error <= a.max_mm;
    let drift_matters = !findings.changes.is_empty() && findings.effect_mm.mean > max_drift_mm;
    let blob = loaded.blob();
    let statement = Statement {
        tolerances: a.tolerance.completed(&ToleranceTable::default()).0,
        ..Statement::default()
    };
    let kinds: Vec<JointKind> = blob.robot.joints.iter().map(|j| j.kind).collect();
    let is_compared = |line: usize| findings.rows.iter().any(|row| row.line == line);
    let mut rows = data::rows(&data.set);
    rows.retain(|row| is_compared(row.line));
    let judged = Judged {
        poses: &findings.poses,
        rows: &rows,
        kinds: &kinds,
    };
    let drift = instrument_drift::known(data.drift.as_ref(), &data.set);
    let document = CheckJson {
        certificate: Certificate::new(judged, &statement, drift, blob.robot.serial_number),
        version: env!("CARGO_PKG_VERSION"),
        warnings,
        method: loaded.host().provenance.method,
        name: file_name(&a.measurements),
        holds: tolerance_met && !drift_matters,
        statistic: a.statistic,
        max_mm: a.max_mm,
        tolerance_met,
        max_drift_mm,
        drift_matters,
        commands_move,
        programs: programs::compared(&a.programs, &loaded, &a.blob)?,
        fitted: fitted_frames(
            &loaded,
            findings.base_fitted,
            findings.tool_fitted,
            data.samples.len() - findings.errors.poses,
        ),
        findings: &findings,
        advice: wording::advice(
            &wording::Outcome {
                changes: &findings.changes,
                without_mm: findings.without_mm.mean,
                odd_lines: &findings.odd_lines,
                more: "measure 100 poses or more",
            },
            tolerance_met,
            drift_matters,
            a.max_mm,
        ),
        provenance: provenance(
            &loaded,
            &a.blob,
            data.set.sha256,
            vec![FileSummary::of_set("fresh measurements", &data.set)],
        ),
    };
    let json = json_text(&document)?;
    let kinds: Vec<JointKind> = blob.robot.joints.iter().map(|j| j.kind).collect();
    let day = loaded.host().provenance.date;
    let page = a
        .report
        .as_deref()
        .map(|path| (path, page::page(&document, &data.set, &kinds, day)));
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(page.iter().map(|(path, html)| (*path, html.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(
        Printer::for_outputs(&outputs),
        a,
        &document,
        loaded.host().provenance.date,
    );
    if document.holds {
        return tolerance::outcome(Some(&document.certificate), &statement);
    }
    let mut reasons = Vec::new();
    if !tolerance_met {
        reasons.push(format!(
            "its {} position error is {error:.4} mm, above {} mm",
            a.statistic.name(),
            a.max_mm
        ));
    }
    if drift_matters {
        reasons.push(format!(
            "a drift moves the target by {:.4} mm on average, above {max_drift_mm} mm",
            findings.effect_mm.mean
        ));
    }
    Err(Failure::Quality(format!(
        "the calibration does not hold: {}\nhelp: {}",
        reasons.join(", and "),
        document.advice.join("; ")
    )))
}

/// Returns the finding that the stated noise is larger than the one that the residuals show, under which drift hides.
fn overstated_noise(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    tools: &[Pose<f64>],
    lines: &[usize],
    options: &check::Options,
) -> Option<Finding> {
    let with_noise = |s: &InstrumentSample| s.clone().with_noise(options.instrument);
    let stated: Vec<InstrumentSample> = samples.iter().map(with_noise).collect();
    let stated = InstrumentNoise::rms_over(&stated).position?;
    let without = |s: &InstrumentSample| InstrumentSample {
        declared_noise: InstrumentNoise::UNKNOWN,
        ..s.clone()
    };
    let samples: Vec<InstrumentSample> = samples.iter().map(without).collect();
    let options = check::Options {
        instrument: InstrumentNoise::UNKNOWN,
        ..*options
    };
    let found = check::check(loaded, &samples, tools.to_vec(), lines, &options).ok()?;
    trust::overstated_noise(stated, 1e-3 * found.noise_mm)
}

fn of_touches(a: &Check) -> Result<(), Failure> {
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
    refuse_options(&a.measurements, &given)?;
    touches::run(&touches::Asked {
        blob: &a.blob,
        measurements: &a.measurements,
        features: a.features.as_deref(),
        statistic: a.statistic,
        max_mm: a.max_mm,
        max_drift_mm: a.max_drift_mm.unwrap_or(DRIFT_SHARE * a.max_mm),
        false_alarms: options(a)?.false_alarms,
        previous: a.previous.as_deref(),
        programs: &a.programs,
        report: a.report.as_deref(),
        json: a.json.as_deref(),
    })
}

fn options(a: &Check) -> Result<check::Options, Failure> {
    let positive = |name: &str, value: Option<f64>| match value {
        Some(x) if !(x > 0.0 && x.is_finite()) => Err(Failure::Usage(format!(
            "{name} {x}: expected a number above 0"
        ))),
        _ => Ok(()),
    };
    positive("--max-mm", Some(a.max_mm))?;
    positive("--max-drift-mm", a.max_drift_mm)?;
    if !(RATES.0..=RATES.1).contains(&a.false_alarms) {
        return Err(Failure::Usage(format!(
            "--false-alarms {}: expected a rate from {} to {}, as 0.01 for one check in a hundred",
            a.false_alarms, RATES.0, RATES.1
        )));
    }
    Ok(check::Options {
        false_alarms: a.false_alarms,
        frames: a.frames.frames(),
        instrument: a.noise.instrument_noise(),
    })
}

fn refused(a: &Check, names: &[ToolName], error: CheckError) -> Failure {
    let path = &a.measurements;
    match error {
        CheckError::Frames(error) => frame_failure(path, names, error),
        CheckError::TooFew {
            poses,
            equations,
            needed,
        } => InputError::new(
            path,
            format!("{poses} different poses ({equations} equations)"),
            format!("at least {needed}: base, tool, joints and noise are all estimated from them"),
        )
        .with_help("measure ten to twenty poses, spread over the joint ranges")
        .into(),
        CheckError::OtherFrame { .. } => {
            let expected =
                "measurements in the frames of the calibration, within 10 mm and 100 mrad";
            let error = InputError::new(path, error.to_string(), expected);
            match (a.frames.fit_base, a.frames.fit_tool.is_some()) {
                (false, _) => error.with_help(FRAMES_HELP),
                (true, false) => {
                    error.with_help("if the target was remounted, too, also give --fit-tool")
                }
                (true, true) => error.with_help("check the robot and the order of the joints"),
            }
            .into()
        }
        CheckError::NothingShown => InputError::new(
            path,
            error.to_string(),
            "poses that show a change of a joint or the payload beside the frames that are fitted",
        )
        .with_help("measure ten to twenty poses, spread over the joint ranges")
        .into(),
        CheckError::Unsolvable | CheckError::UnknownTool(_) => {
            InputError::new(path, error.to_string(), "new measurements of this robot").into()
        }
    }
}

fn print(report: Printer, a: &Check, d: &CheckJson<'_>, date: &str) {
    let f = d.findings;
    report.line(format_args!(
        "Model `{}` of {date} on {} new poses: position in mm, orientation in mrad.\n",
        d.method, f.errors.poses
    ));
    let row = |name: &str, s: &Summary, orientation: String| {
        let mut row = vec![name.to_owned()];
        row.extend([s.mean, s.p95, s.max].map(|x| format!("{x:.4}")));
        row.push(orientation);
        row
    };
    let mut rows = vec![row(
        "error now",
        &f.errors.position_mm,
        f.errors.orientation_text(),
    )];
    if !f.changes.is_empty() {
        rows.push(row("of it drift", &f.effect_mm, String::new()));
        rows.push(row("without drift", &f.without_mm, String::new()));
    }
    report.table(&["", "mean", "p95", "max", "orientation"], &rows);
    report.line("");
    let conformity = d.certificate.conformity.as_ref();
    if let Some(line) = conformity.and_then(sections::verdict_line) {
        report.line(format_args!("Verdict on the tolerance: {line}."));
    }
    if let Some(line) = &d.fitted {
        report.line(line);
    }
    if let Some((change, previous)) = d.commands_move.as_ref().zip(a.previous.as_deref()) {
        report.line(gauge::commands_move(change, previous).trim_start());
    }
    for line in d.programs.iter().map(programs::CorrectedProgram::text) {
        report.line(line);
    }
    for line in wording::findings(f) {
        report.line(line);
    }
    for line in wording::sensitivity(&f.sensitivity) {
        report.line(line);
    }
    if let Some(text) = wording::hidden(&f.sensitivity, d.max_drift_mm) {
        report.line(format_args!("warning: {text}"));
    }
    if d.holds {
        report.line(format_args!(
            "The calibration holds: its {} position error is {:.4} mm, {} mm are allowed.",
            a.statistic.name(),
            a.statistic.of(&f.errors.position_mm),
            a.max_mm
        ));
        for advice in &d.advice {
            report.line(format_args!("  {advice}"));
        }
    }
}
