//! `trainer evaluate`.

mod document;
mod judge;

use clap::Args;
use std::path::PathBuf;

use crate::cli::args::{FrameArgs, heading};
use crate::cli::evaluate::document::{EvaluateJson, SetErrors, TrustSummary};
use crate::cli::evaluate::judge::{FLAGS, Judge, Judged};
use crate::cli::examination::{AcceptArgs, settled};
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::{self, FRAMES_HELP, file_name, fitted_frames, frame_failure};
use crate::cli::instrument_drift;
use crate::cli::output::kind::Kind;
use crate::cli::output::long::LongOutput;
use crate::cli::output::{check_outputs, document_text, write_outputs, write_with_long};
use crate::cli::terminal::print::{Printer, warning};
use crate::cli::terminal::warnings;
use poegp_calibration::blob::fitted_frames::FittedFrames;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::counted;
use poegp_calibration::measurement::Measurement;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::numeric::statistics::{ErrorSummary, MEAN_LENGTH};
use poegp_calibration::trust::{self, Cause, Finding, Findings, Tier};
use poegp_calibration::verification::is_same_frame;

/// `trainer evaluate`.
#[derive(Debug, Args)]
#[command(
    after_help = "With touches, the command keeps the arm of the blob and fits features and tips to it. It prints by \
    how much the touches miss each feature, with this arm and with the nominal arm.\n\n\
    Examples:\n  trainer evaluate arm.blob test.csv --predictions predicted.csv --json -\n  \
    trainer evaluate arm.blob touches.csv --features touches.toml"
)]
pub struct Evaluate {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Measurements, or touches, that the model was not trained on.
    pub test: PathBuf,
    /// Write the predicted instrument_from_target of each measurement, in order:
    /// x_mm,y_mm,z_mm,qw,qx,qy,qz,status. The orientation is empty if the tool's frame is fitted to positions
    /// alone.
    #[arg(long, value_name = "FILE")]
    pub predictions: Option<PathBuf>,
    /// Add two columns to the predictions: trust,sigma_mm, the extrapolation score and the predictive standard deviation
    /// (empty if the blob has none).
    #[arg(long, requires = "predictions")]
    pub trust: bool,
    /// Write the result as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Description of the touched features (TOML; default: NAME.toml beside NAME.csv).
    #[arg(long, value_name = "FILE", help_heading = heading::MEASUREMENTS)]
    pub features: Option<PathBuf>,
    #[command(flatten, next_help_heading = heading::MEASUREMENTS)]
    pub accepted: AcceptArgs,
    #[command(flatten, next_help_heading = heading::FRAMES)]
    pub frames: FrameArgs,
}

pub fn run(a: &Evaluate) -> Result<(), Failure> {
    let outputs = [
        (a.predictions.as_deref(), Kind::Predictions),
        (a.json.as_deref(), Kind::Json),
    ];
    let outputs = check_outputs(&outputs, &[&a.blob, &a.test])?;
    let loaded = BlobModel::read(&a.blob)?;
    let found = evaluated(a, &loaded, &Input::file(&a.test))?;
    let document = &found.document;
    let json = document_text(document)?;
    let json = a.json.as_deref().map(|path| (path, json.as_bytes()));
    match found.predictions {
        Some(out) => write_with_long(out, json.as_slice())?,
        None => write_outputs(json.as_slice())?,
    }
    let report = Printer::for_outputs(&outputs);
    let [result] = &document.sets;
    print(report, result, document.method, &found.flags, found.poses);
    found.last.iter().for_each(warning);
    if let Some(line) = fitted_frames(
        &loaded,
        document.base_fitted,
        document.tool_fitted,
        found.left_out,
    ) {
        report.line(line);
    }
    Ok(())
}

/// Evaluates `loaded`, which takes the place of the blob in `a`, on measured poses, and returns the JSON document. Nothing is
/// written but what `a` names as predictions.
///
/// # Errors
/// [`Failure`] about the inputs.
pub fn document(a: &Evaluate, loaded: &BlobModel, input: &Input<'_>) -> Result<String, Failure> {
    document_text(&evaluated(a, loaded, input)?.document)
}

/// States that measurements are in other frames than those of the calibration, if they are.
fn in_other_frames(a: &Evaluate, result: &SetErrors) -> Option<String> {
    let text = || {
        format!(
            "{}: these measurements are not in the frames of the calibration, or not of this robot: {FRAMES_HELP}",
            a.test.display()
        )
    };
    (!is_same_frame(&result.errors)).then(text)
}

/// A judged model, before anything is written.
struct Evaluated<'a> {
    document: EvaluateJson<'a>,
    /// Number of predictions with each of [`FLAGS`].
    flags: [usize; FLAGS.len()],
    /// Number of predictions.
    poses: usize,
    /// Warnings that are printed after the results.
    last: Vec<String>,
    /// Number of rows that were only used to fit frames.
    left_out: usize,
    /// Predictions, if they are asked for.
    predictions: Option<LongOutput>,
}

fn evaluated<'a>(
    a: &Evaluate,
    loaded: &'a BlobModel,
    input: &Input<'_>,
) -> Result<Evaluated<'a>, Failure> {
    let correction = instrument_drift::correction(a.frames.correct_drift);
    let data = inputs::read_long(loaded, input, correction)?;
    let (set, samples, which) = (&data.set, &data.samples, a.frames.frames());
    let robot = inputs::robot_of(loaded);
    let (accept, json) = (&a.accepted.accept, a.json.as_deref());
    data.examined(&a.test, json, accept, &robot)?;
    let tools = data.frames(loaded, &a.test, which)?;
    let frames = FittedFrames::new(loaded, samples, tools, which)
        .map_err(|error| frame_failure(&a.test, &data.names, error))?;
    let judge = Judge {
        writes: a.predictions.is_some(),
        with_trust: a.trust,
        ..Judge::new(loaded, &set.measurements, &frames)
    };
    let mut out = a.predictions.as_deref().map(LongOutput::new).transpose()?;
    if let Some(out) = &mut out {
        let more = if a.trust { ",trust,sigma_mm" } else { "" };
        out.write(format!("x_mm,y_mm,z_mm,qw,qx,qy,qz,status{more}\n").as_bytes())?;
    }
    let mut all = Judged::default();
    data.each_chunk(
        &robot,
        |rows, samples| judge.rows(rows, samples),
        |judged: Judged| {
            if let Some(out) = &mut out {
                out.write(judged.text.as_bytes())?;
            }
            all.extend(judged);
            Ok(())
        },
    )?;
    let poses = all.poses;
    let result = SetErrors {
        name: file_name(&a.test),
        predictive_std: all.predictive_std(),
        errors: all.measured.summary(),
        against_truth: set.has_truth().then(|| all.truth.summary()),
        flagged: all.flagged,
        trust: TrustSummary {
            mean: (all.trust_sum / poses as f64) as f32,
            least: all.least_trust.unwrap_or(1.0),
        },
    };
    let training_data = inputs::is_training_data(loaded, set.sha256);
    let found = match training_data {
        true => Vec::new(),
        false => [
            trust::computed_by_model(&result.errors),
            unexpected(&result, [all.flags[0], all.flags[1]]),
        ]
        .into_iter()
        .flatten()
        .collect(),
    };
    settled(&a.test, Findings(found), accept, json)?;
    let of_training =
        training_data.then(|| inputs::training_data_warning(&a.test, a.blob.display()));
    let last: Vec<String> = (of_training.into_iter())
        .chain(in_other_frames(a, &result))
        .collect();
    last.iter().for_each(warnings::add);
    let document = EvaluateJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        training_data,
        base_fitted: frames.is_base_fitted,
        tool_fitted: frames.is_tool_fitted.contains(&true),
        sets: [result],
    };
    Ok(Evaluated {
        last,
        document,
        flags: all.flags,
        poses,
        left_out: frames.left_out.len(),
        predictions: out,
    })
}

/// Fewest poses whose errors are compared with what the model expects, and the ratio from which they are unexpected.
const UNEXPECTED: (usize, f64) = (10, 2.0);

/// Returns the warning that the errors are larger than the model expects; `outside` are the numbers of rows with joints and
/// with payloads outside the trained ranges.
fn unexpected(result: &SetErrors, outside: [usize; 2]) -> Option<Finding> {
    let expected = MEAN_LENGTH * result.predictive_std.as_ref()?.mean_mm;
    let mean = result.errors.position_mm.mean;
    let (poses, ratio) = (result.errors.poses, mean / expected);
    let (few, most) = UNEXPECTED;
    (poses >= few && ratio > most && is_same_frame(&result.errors)).then(|| {
        let most_of = |count: usize| 2 * count > poses;
        let rows = |count| counted(count, "row");
        let why = match outside {
            [_, payloads] if most_of(payloads) => {
                format!("the payload of {} is outside the trained range", rows(payloads))
            }
            [joints, _] if most_of(joints) => {
                format!("the joints of {} are outside the trained ranges", rows(joints))
            }
            _ => "the robot, its payload, the target or the instrument changed since the calibration, or rows are wrong; \
                  `trainer check` names a change"
                .to_owned(),
        };
        let text = format!(
            "the position errors are {ratio:.1} times what the model expects, {mean:.3} mm on average instead of \
             {expected:.3} mm: {why}"
        );
        Finding::new(Cause::Model, Tier::Warning, text, ratio, most)
    })
}

/// Residual of a measured row: the difference between measurement and prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Line of the row in its file, from 1.
    pub line: usize,
    /// Measured position minus predicted position, m, along the instrument's axes.
    pub position: [f64; 3],
    /// Rotation vector from the predicted to the measured orientation, rad, along the instrument's axes; `None` without a
    /// measured orientation.
    pub rotation: Option<[f64; 3]>,
}

/// Computes the residuals of measurements, leaving out rows that served only to fit the frames of tools.
pub fn residuals(
    a: &Evaluate,
    loaded: &BlobModel,
    table: Option<&[u8]>,
) -> Result<Vec<Residual>, Failure> {
    let input = Input {
        path: &a.test,
        bytes: table,
    };
    let correction = instrument_drift::correction(a.frames.correct_drift);
    let data = inputs::read(loaded, &input, correction)?;
    let robot = inputs::robot_of(loaded);
    data.examined(&a.test, None, &a.accepted.accept, &robot)?;
    let which = a.frames.frames();
    let tools = data.frames(loaded, &a.test, which)?;
    let frames = FittedFrames::new(loaded, &data.samples, tools, which)
        .map_err(|error| frame_failure(&a.test, &data.names, error))?;
    let judge = Judge::new(loaded, &data.set.measurements, &frames);
    let rows = data.set.measurements.iter().zip(&data.samples);
    let compared = rows.filter(|(row, _)| !judge.left_out.contains(&row.line));
    let residual = |(row, sample): (&Measurement, &InstrumentSample)| {
        let predicted = judge.predicted(sample).pose;
        let apart = sample.observation.position() - predicted.translation;
        let rotation = match &sample.observation {
            Observation::Pose(measured) => {
                let turned = (predicted.inverse() * *measured).log().angular;
                Some((predicted.rotation * turned).into())
            }
            _ => None,
        };
        Residual {
            line: row.line,
            position: apart.into(),
            rotation,
        }
    };
    Ok(compared.map(residual).collect())
}

fn print(
    report: Printer,
    set: &SetErrors,
    model: &str,
    flags: &[usize; FLAGS.len()],
    poses: usize,
) {
    report.line(format_args!(
        "Model `{model}` on {} poses: position in mm, orientation in mrad.\n",
        set.errors.poses
    ));
    let row = |name: &str, e: &ErrorSummary| {
        let mut row = vec![name.to_owned()];
        let p = &e.position_mm;
        row.extend([p.mean, p.median, p.rms, p.p95, p.max].map(|x| format!("{x:.4}")));
        row.push(e.orientation_text());
        row
    };
    let mut rows = vec![row("measurements", &set.errors)];
    rows.extend(
        set.against_truth
            .as_ref()
            .map(|e| row("noiseless truth", e)),
    );
    report.table(
        &[
            "against",
            "mean",
            "median",
            "rms",
            "p95",
            "max",
            "orientation",
        ],
        &rows,
    );
    if let Some(sigma) = &set.predictive_std {
        report.line(format_args!(
            "Predictive standard deviation: {:.4} mm on average; of the position errors along the axes {:.0} % lie within 1σ, {:.0} % within 1.96σ.",
            sigma.mean_mm,
            100.0 * sigma.shares.one_sigma,
            100.0 * sigma.shares.two_sigma
        ));
    }
    if set.trust.least < 1.0 {
        report.line(format_args!(
            "Extrapolation score (trust): {:.3} on average, {:.3} minimum.",
            set.trust.mean, set.trust.least
        ));
    }
    for (status, count) in FLAGS.iter().zip(flags) {
        if *count > 0 {
            report.line(format_args!(
                "{count} of {poses} predictions are flagged `{status}`."
            ));
        }
    }
}
