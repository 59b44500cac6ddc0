//! `trainer evaluate`.

use clap::Args;
use std::fmt::Write as _;
use std::path::Path;
use std::path::PathBuf;

use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::cli::failure::Failure;
use crate::cli::inputs::{self, TestData, file_name};
use crate::cli::instrument_drift;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::Printer;
use poegp_calibration::blob::predict::{BlobModel, Prediction};
use poegp_calibration::blob::tool_fit::{evenly_spaced, fit_tool_frame};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError};
use poegp_calibration::validation::held_out::SigmaShares;

/// What `--json` writes.
#[derive(Serialize)]
struct EvaluateJson<'a> {
    version: &'static str,
    method: &'a str,
    sets: [&'a SetErrors; 1],
}

#[derive(Serialize)]
struct SetErrors {
    name: String,
    #[serde(flatten)]
    errors: ErrorSummary,
    /// Against the noiseless poses of a simulated set.
    #[serde(skip_serializing_if = "Option::is_none")]
    against_truth: Option<ErrorSummary>,
    /// Poses whose status was not `ok`.
    flagged: usize,
    trust: TrustSummary,
    /// What the device says of its own error, of a blob that knows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    predictive_std: Option<StdSummary>,
}

/// The device's trust in its inputs, 1 within what was trained.
#[derive(Serialize)]
struct TrustSummary {
    mean: f32,
    least: f32,
}

/// The device's standard deviation of position, and the shares of single components of the errors within it.
#[derive(Serialize)]
struct StdSummary {
    mean_mm: f64,
    #[serde(flatten)]
    shares: SigmaShares,
}

impl StdSummary {
    /// Of the scored samples; `None` when the blob does not know it.
    fn new(
        samples: &[InstrumentSample],
        predictions: &[Prediction],
        scored: &[usize],
    ) -> Option<Self> {
        let known = || {
            let sigma = |i: &usize| predictions[*i].position_sigma.map(f64::from);
            scored.iter().filter_map(move |i| Some((*i, sigma(i)?)))
        };
        let pairs = |(i, sigma): (usize, f64)| {
            let error = samples[i].observation.position() - predictions[i].pose.translation;
            [0, 1, 2].map(|axis| (error[axis], sigma))
        };
        Some(Self {
            shares: SigmaShares::new(known().flat_map(pairs))?,
            mean_mm: 1e3 * known().map(|(_, s)| s).sum::<f64>() / known().count() as f64,
        })
    }
}

/// `trainer evaluate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: trainer evaluate arm.blob test.csv --predictions predicted.csv --json -"
)]
pub struct Evaluate {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Measurements that the model was not trained on.
    pub test: PathBuf,
    /// Fit the frame of a tool that is not in the blob (a new session) to ROWS of its rows, evenly spread; these rows are not
    /// scored.
    #[arg(long, value_name = "ROWS", value_parser = clap::value_parser!(u32).range(1..))]
    pub fit_tool: Option<u32>,
    /// Write the predicted instrument_from_target of each measurement, in order: x_mm,y_mm,z_mm,qw,qx,qy,qz,status.
    #[arg(long, value_name = "FILE")]
    pub predictions: Option<PathBuf>,
    /// Add two columns to the predictions: trust,sigma_mm, the extrapolation score and the predictive standard deviation
    /// (empty if the blob has none).
    #[arg(long, requires = "predictions")]
    pub trust: bool,
    /// Remove the instrument's drift from every pose, estimated from reference points (columns ref1_x_mm …).
    #[arg(long)]
    pub correct_drift: bool,
    /// Write the errors as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Evaluate) -> Result<(), Failure> {
    let outputs = [a.predictions.as_deref(), a.json.as_deref()];
    check_outputs(&outputs, &[&a.blob, &a.test])?;
    let loaded = BlobModel::read(&a.blob)?;
    let TestData {
        set,
        samples,
        names,
    } = inputs::read(
        &loaded,
        &a.test,
        instrument_drift::correction(a.correct_drift),
    )?;
    let tools = tool_frames(a, &loaded, &names, &samples)?;
    let predictions: Vec<Prediction> = samples
        .iter()
        .map(|s| {
            let first = loaded.predict(&s.joints, s.payload_kg);
            Prediction {
                pose: first.pose * tools.frames[s.tool],
                ..first
            }
        })
        .collect();
    let scored = |i: &usize| !tools.fitted_on.contains(i);
    let measured: Vec<PoseError> = (0..samples.len())
        .filter(scored)
        .map(|i| samples[i].observation.error(&predictions[i].pose))
        .collect();
    let truth: Vec<PoseError> = (0..samples.len())
        .filter(scored)
        .filter_map(|i| {
            Some(PoseError::between(
                &set.measurements[i].truth?,
                &predictions[i].pose,
            ))
        })
        .collect();
    let result = SetErrors {
        name: file_name(&a.test),
        errors: ErrorSummary::new(&measured),
        against_truth: set.has_truth().then(|| ErrorSummary::new(&truth)),
        flagged: predictions.iter().filter(|p| !p.status.is_ok()).count(),
        trust: TrustSummary {
            mean: predictions.iter().map(|p| p.trust).sum::<f32>() / predictions.len() as f32,
            least: predictions.iter().map(|p| p.trust).fold(1.0, f32::min),
        },
        predictive_std: StdSummary::new(
            &samples,
            &predictions,
            &(0..samples.len()).filter(scored).collect::<Vec<_>>(),
        ),
    };
    let document = EvaluateJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        sets: [&result],
    };
    let (csv, json) = (to_csv(&predictions, a.trust), json_text(&document)?);
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(a.predictions.as_deref().map(|path| (path, csv.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(
        Printer::for_outputs(&outputs),
        &result,
        loaded.host().provenance.method,
        &predictions,
    );
    Ok(())
}

/// The frames of all tools of a set, `first_target_from_target`, and the rows that some were fitted on.
struct ToolFrames {
    frames: Vec<Pose<f64>>,
    fitted_on: Vec<usize>,
}

fn tool_frames(
    a: &Evaluate,
    loaded: &BlobModel,
    names: &[ToolName],
    samples: &[InstrumentSample],
) -> Result<ToolFrames, Failure> {
    let known = loaded.tools();
    let mut frames: Vec<Pose<f64>> = known.iter().map(|(_, pose)| *pose).collect();
    let mut fitted_on = Vec::new();
    for (tool, name) in names.iter().enumerate().skip(known.len()) {
        let rows: Vec<usize> = (0..samples.len())
            .filter(|i| samples[*i].tool == tool)
            .collect();
        match a.fit_tool {
            Some(count) => {
                let chosen = evenly_spaced(&rows, count as usize);
                if chosen.len() == rows.len() {
                    return Err(InputError::new(
                        &a.test,
                        format!("{} rows of {name}", rows.len()),
                        format!("more than the {count} that its frame is fitted to: something must be left to score"),
                    )
                    .into());
                }
                let samples: Vec<&InstrumentSample> = chosen.iter().map(|i| &samples[*i]).collect();
                frames.push(fit_tool_frame(loaded, &samples));
                fitted_on.extend(chosen);
            }
            // One tool on both sides: the same, unless the file says otherwise.
            None if known.is_empty() && names.len() == 1 => frames.push(Pose::identity()),
            None => {
                return Err(InputError::new(
                    &a.test,
                    format!("{name}, which was mounted after the calibration"),
                    "a tool that the blob knows",
                )
                .with_help("give --fit-tool ROWS to fit its frame to some of its own rows, which are then not scored")
                .into());
            }
        }
    }
    Ok(ToolFrames { frames, fitted_on })
}

fn print(report: Printer, set: &SetErrors, model: &str, predictions: &[Prediction]) {
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
            "Predictive standard deviation: {:.4} mm on average; {:.0} % of the error components lie within 1σ, {:.0} % within 1.96σ.",
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
    for status in [
        Status::OUTSIDE_JOINT_RANGE,
        Status::OUTSIDE_PAYLOAD_RANGE,
        Status::CORRECTION_LIMITED,
        Status::BAD_INPUT,
    ] {
        let count = predictions
            .iter()
            .filter(|p| p.status.contains(status))
            .count();
        if count > 0 {
            report.line(format_args!(
                "{count} of {} predictions are flagged `{status}`.",
                predictions.len()
            ));
        }
    }
}

fn to_csv(predictions: &[Prediction], with_trust: bool) -> String {
    let mut out = String::from("x_mm,y_mm,z_mm,qw,qx,qy,qz,status");
    out += if with_trust {
        ",trust,sigma_mm\n"
    } else {
        "\n"
    };
    for prediction in predictions {
        let Prediction { pose, status, .. } = prediction;
        let t = 1e3 * pose.translation;
        let (w, v) = pose.quaternion();
        let _ = write!(
            out,
            "{:.6},{:.6},{:.6},{w:.12},{:.12},{:.12},{:.12},{status}",
            t[0], t[1], t[2], v[0], v[1], v[2]
        );
        if with_trust {
            let _ = write!(out, ",{:.6},", prediction.trust);
            if let Some(sigma) = prediction.position_sigma {
                let _ = write!(out, "{:.6}", 1e3 * sigma);
            }
        }
        out.push('\n');
    }
    out
}
