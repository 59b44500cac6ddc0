//! `trainer check`: tests with a few fresh measurements whether the calibration still holds.

mod advice;
mod document;
mod page;
mod programs;
mod touch_page;
pub mod touches;
mod unexplained;
pub mod wording;

use std::path::{Path, PathBuf};

use crate::cli::args::{FrameArgs, NoiseArgs, heading};
use crate::cli::calibrate::gauge;
use crate::cli::check::document::{CheckJson, Statistic, provenance};
use crate::cli::examination::{AcceptArgs, settled};
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::{self, FRAMES_HELP, file_name, fitted_frames, frame_failure};
use crate::cli::instrument_drift;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, document_text, write_texts};
use crate::cli::terminal::print::{Printer, error_row, warning};
use crate::cli::terminal::warnings::{self, WARNING};
use crate::cli::tolerance::{self, ToleranceArgs, ToleranceTable};
use crate::report::certificate::{Certificate, Judged, Statement};
use crate::report::{FileSummary, data, sections};
use clap::Args;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::trust::{self, Cause, Finding, Findings, Tier};
use poegp_calibration::verification as check;
use poegp_calibration::verification::CheckError;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::{Change, Moved};
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

impl Check {
    fn max_drift_mm(&self) -> f64 {
        self.max_drift_mm.unwrap_or(DRIFT_SHARE * self.max_mm)
    }
}

pub fn run(a: &Check) -> Result<(), Failure> {
    let outputs = [
        (a.json.as_deref(), Kind::Json),
        (a.report.as_deref(), Kind::Report),
    ];
    let mut files: Vec<&Path> = vec![&a.blob, &a.measurements];
    files.extend(a.previous.as_deref());
    let programs = programs::files(&a.programs);
    files.extend(programs.iter().map(PathBuf::as_path));
    let outputs = check_outputs(&outputs, &files)?;
    let options = options(a)?;
    let loaded = BlobModel::read(&a.blob)?;
    let (document, set) = checked(a, &loaded, &Input::file(&a.measurements), &options)?;
    let json = document_text(&document)?;
    let (day, kinds) = (loaded.host().provenance.date, loaded.kinds());
    let page = (a.report.as_ref()).map(|_| page::page(&document, &set, &kinds, day));
    write_texts(&[
        (a.report.as_deref(), page.as_deref()),
        (a.json.as_deref(), Some(&json)),
    ])?;
    print(Printer::for_outputs(&outputs), a, &document, day);
    let findings = &document.findings;
    if document.holds {
        return tolerance::outcome(Some(&document.certificate), &statement(a));
    }
    let (name, by) = (a.statistic.name(), findings.effect_mm.mean);
    let error = a.statistic.of(&findings.errors.position_mm);
    let error =
        (!document.tolerance_met).then(|| format!("its {name} position error is {error:.4} mm"));
    let drift = (document.drift_matters)
        .then(|| format!("a drift moves the target by {by:.4} mm on average"));
    let reasons = [(error, a.max_mm), (drift, document.max_drift_mm)];
    Err(advice::does_not_hold(reasons, &document.advice))
}

/// Checks `loaded`, which takes the place of the blob in `a`, by measured poses, without writing any output; returns the JSON
/// document.
///
/// # Errors
/// [`Failure`] about the inputs. A calibration that does not hold is no error.
pub fn document(a: &Check, loaded: &BlobModel, input: &Input<'_>) -> Result<String, Failure> {
    document_text(&checked(a, loaded, input, &options(a)?)?.0)
}

fn statement(a: &Check) -> Statement {
    Statement {
        tolerances: a.tolerance.completed(&ToleranceTable::default()).0,
        ..Statement::default()
    }
}

/// Checks a model by measured poses; returns the findings, and the measurements.
fn checked<'a>(
    a: &Check,
    loaded: &'a BlobModel,
    input: &Input<'_>,
    options: &check::Options,
) -> Result<(CheckJson<'a>, MeasurementSet), Failure> {
    let correction = instrument_drift::correction(a.frames.correct_drift);
    let data = inputs::read(loaded, input, correction)?;
    let sha256 = data.set.sha256;
    inputs::fresh(loaded, &a.measurements, sha256, "fresh measurements")?;
    data.examined(
        &a.measurements,
        a.json.as_deref(),
        &a.accepted.accept,
        &inputs::robot_of(loaded),
    )?;
    let tools = data.frames(loaded, &a.measurements, options.frames)?;
    let lines: Vec<usize> = data.set.measurements.iter().map(|m| m.line).collect();
    let noise = overstated_noise(loaded, &data.samples, &tools, &lines, options);
    let findings = check::check(loaded, &data.samples, tools, &lines, options)
        .map_err(|error| refused(a, &data.names, error))?;
    let error = a.statistic.of(&findings.errors.position_mm);
    let tolerance_met = error <= a.max_mm;
    let payloads = untrained_payload(loaded, &data.samples, &lines, &findings, tolerance_met);
    let (accept, json) = (&a.accepted.accept, a.json.as_deref());
    let found = [
        payloads.as_ref().map(|p| p.finding.clone()),
        noise,
        findings.during.as_ref().map(moved_during),
        trust::computed_by_model(&findings.errors),
    ];
    let found = Findings(found.into_iter().flatten().collect());
    settled(&a.measurements, found, accept, json)?;
    if let Some(text) = unexplained::warning(&findings) {
        warning(format_args!("{}: {text}.", a.measurements.display()));
    }
    let wanted = data.samples.iter();
    let wanted = wanted.map(|s| (s.joints.clone(), s.payload_kg));
    let commands_move = gauge::commands_moved(a.previous.as_deref(), loaded, wanted)?;
    let max_drift_mm = a.max_drift_mm();
    let has_moved = !findings.changes.is_empty() || findings.during.is_some();
    let drift_matters = has_moved && findings.effect_mm.mean > max_drift_mm;
    let blob = loaded.blob();
    let kinds = loaded.kinds();
    let is_compared = |line: usize| findings.rows.iter().any(|row| row.line == line);
    let mut rows = data::rows(&data.set);
    rows.retain(|row| is_compared(row.line));
    let judged = Judged {
        poses: findings.poses.clone(),
        rows,
        kinds: &kinds,
        // These rows may come from another instrument than the training rows.
        fitted_noise: [None; 2],
    };
    let drift = instrument_drift::known(data.drift.as_ref(), &data.set);
    let document = CheckJson {
        certificate: Certificate::new(judged, &statement(a), drift, blob.robot.serial_number),
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        training_poses: loaded.host().provenance.training_poses,
        name: file_name(&a.measurements),
        holds: tolerance_met && !drift_matters,
        statistic: a.statistic,
        max_mm: a.max_mm,
        tolerance_met,
        max_drift_mm,
        is_default_drift: a.max_drift_mm.is_none(),
        drift_matters,
        commands_move,
        programs: programs::compared(&a.programs, loaded, &a.blob)?,
        orientation_judged: a.tolerance.tolerance_mrad.is_some(),
        fitted: fitted_frames(
            loaded,
            findings.base_fitted,
            findings.tool_fitted,
            data.samples.len() - findings.errors.poses,
        ),
        advice: advice::advice(
            &advice::Outcome {
                changes: &findings.changes,
                without_mm: a.statistic.of(&findings.without_mm),
                rest: unexplained::Rest::of(&findings),
                outlier_lines: &findings.outlier_lines,
                during: findings.during.as_ref(),
                payloads: payloads.as_ref().map(|p| p.advice.as_str()),
                is_searched: findings.is_searched,
                more: &advice::new_calibration(&findings),
            },
            tolerance_met,
            drift_matters,
            a.max_mm,
        ),
        provenance: provenance(
            loaded,
            &a.blob,
            vec![FileSummary::of_set("fresh measurements", &data.set)],
        ),
        findings,
    };
    warnings::add_lines(&last_lines(&document));
    if document.holds {
        warnings::add_lines(document.orientation().as_slice());
    }
    Ok((document, data.set))
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
    // Where a model that does not know its own error takes most of the scatter, the noise cannot be separated from it.
    let (scatter, model) = (found.scatter_mm, found.model_mm);
    let noise = (scatter * scatter - model * model).max(0.0).sqrt();
    let is_separate = found.noise_mm.is_some() || 2.0 * noise >= model;
    let shown = if is_separate { noise } else { scatter };
    trust::overstated_noise(stated, 1e-3 * shown)
}

/// Payloads that the model was not trained with, or that it does not know.
struct Payloads {
    finding: Finding,
    advice: String,
}

/// Returns what is to be said of rows with payloads that the model was not trained with. A model that does not depend on the
/// payload does not know which these are: then it is said where another payload may look like what was found.
fn untrained_payload(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    lines: &[usize],
    found: &check::result::Report,
    tolerance_met: bool,
) -> Option<Payloads> {
    let trained = loaded.blob().ranges.payload_kg;
    let is_joint = |c: &Change| matches!(c.part, Part::Joint(_));
    let may_be = found.changes.iter().any(is_joint) || found.changes.is_empty() && !tolerance_met;
    let outside = match trained {
        Some(_) => found.untrained_payload.clone(),
        None if may_be && found.during.is_none() => lines.to_vec(),
        None => Vec::new(),
    };
    let rows = samples.iter().zip(lines);
    let of_rows = rows.filter(|(_, line)| outside.contains(line));
    let carried: Vec<f64> = of_rows.filter_map(|(s, _)| s.payload_kg).collect();
    let least = carried.iter().copied().reduce(f64::min)?;
    let most = carried.iter().copied().fold(least, f64::max);
    let carried = wording::payloads((least, most));
    let (count, all) = (outside.len(), found.rows.len());
    let (text, advice) = match trained {
        Some((light, heavy)) => {
            let trained = wording::payloads((light.into(), heavy.into()));
            let text = wording::untrained_payload(count, all, &carried, &trained);
            (text, advice::trained_payload(&trained, &carried))
        }
        None if most > 0.0 => (
            wording::unknown_payload(&carried),
            advice::unknown_payload(&carried),
        ),
        None => return None,
    };
    let share = count as f64 / all as f64;
    let finding = Finding::new(Cause::Payload, Tier::Warning, text, share, 0.0).of_rows(outside);
    Some(Payloads { finding, advice })
}

/// Returns the finding that something moved while the rows were measured.
fn moved_during(moved: &Moved) -> Finding {
    let cause = match moved.from_line {
        Some(_) => Cause::Step,
        None => Cause::Drift,
    };
    let (drop, needed) = moved.drop;
    let text = wording::during(moved);
    Finding::new(cause, Tier::Warning, text, drop, needed).of_rows(moved.lines.clone())
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
            format!(
                "{} ({equations} equations)",
                counted(poses, "distinct pose")
            ),
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
        CheckError::Unsolvable | CheckError::UnknownTool(_) | CheckError::NoPosition => {
            InputError::new(path, error.to_string(), "new measurements of this robot").into()
        }
    }
}

fn print(report: Printer, a: &Check, d: &CheckJson<'_>, date: &str) {
    let f = &d.findings;
    report.line(format_args!(
        "Model `{}` of {date} on {} new poses: position in mm, orientation in mrad.\n",
        d.method, f.errors.poses
    ));
    let row = |name: &str, s: &Summary, orientation: String| {
        let mut row = error_row(name, s);
        row.push(orientation);
        row
    };
    let mut rows = vec![row(
        "error now",
        &f.errors.position_mm,
        f.errors.orientation_text(),
    )];
    if !f.changes.is_empty() || f.during.is_some() {
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
    for line in last_lines(d) {
        report.line(line);
    }
    if d.holds {
        report.line(format_args!(
            "The calibration holds: its {} position error is {:.4} mm, within the {} mm allowed{}.",
            a.statistic.name(),
            a.statistic.of(&f.errors.position_mm),
            a.max_mm,
            match f.unexplained.filter(|rest| rest.is_excess) {
                Some(rest) => format!(", but {:.1} times what the model expects", rest.factor),
                None => String::new(),
            }
        ));
        if let Some(text) = d.orientation() {
            report.line(text);
        }
        for advice in &d.advice {
            report.line(format_args!("  {advice}"));
        }
    }
}

/// Lines with what was found and what may be hidden, some of them warnings.
fn last_lines(d: &CheckJson<'_>) -> Vec<String> {
    let f = &d.findings;
    let hidden = wording::hidden(&f.sensitivity, d.max_drift_mm, d.is_default_drift);
    let mut lines = wording::findings(f, d.method, d.training_poses);
    lines.extend(wording::sensitivity(&f.sensitivity, "These poses"));
    lines.extend(hidden.map(|text| format!("{WARNING}{text}")));
    lines
}
