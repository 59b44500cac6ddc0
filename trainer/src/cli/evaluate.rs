//! `trainer evaluate`.

use clap::Args;
use std::fmt::Write as _;
use std::path::Path;
use std::path::PathBuf;

use poegp_runtime::guard::status::Status;
use serde::Serialize;

use crate::cli::args::FrameArgs;
use crate::cli::examination::AcceptArgs;
use crate::cli::failure::Failure;
use crate::cli::inputs::{self, FRAMES_HELP, file_name, fitted_frames, frame_failure};
use crate::cli::instrument_drift;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, warning};
use poegp_calibration::blob::fitted_frames::FittedFrames;
use poegp_calibration::blob::predict::{BlobModel, Prediction};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError};
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::held_out::SigmaShares;
use poegp_calibration::verification::is_same_frame;

/// What `--json` writes.
#[derive(Serialize)]
struct EvaluateJson<'a> {
    version: &'static str,
    /// What somebody must look at in the measurements.
    warnings: Vec<Finding>,
    method: &'a str,
    base_fitted: bool,
    tool_fitted: bool,
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
    #[command(flatten)]
    pub frames: FrameArgs,
    /// Write the predicted instrument_from_target of each measurement, in order: x_mm,y_mm,z_mm,qw,qx,qy,qz,status. The
    /// orientation is empty where the tool's frame is fitted to positions alone, which do not show it.
    #[arg(long, value_name = "FILE")]
    pub predictions: Option<PathBuf>,
    /// Add two columns to the predictions: trust,sigma_mm, the extrapolation score and the predictive standard deviation
    /// (empty if the blob has none).
    #[arg(long, requires = "predictions")]
    pub trust: bool,
    #[command(flatten)]
    pub accepted: AcceptArgs,
    /// Write the errors as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Evaluate) -> Result<(), Failure> {
    let outputs = [a.predictions.as_deref(), a.json.as_deref()];
    check_outputs(&outputs, &[&a.blob, &a.test])?;
    let loaded = BlobModel::read(&a.blob)?;
    let correction = instrument_drift::correction(a.frames.correct_drift);
    let data = inputs::read(&loaded, &a.test, correction)?;
    let (set, samples, which) = (&data.set, &data.samples, a.frames.frames());
    let warnings = data.examined(
        &a.test,
        a.json.as_deref(),
        &a.accepted.accept,
        &inputs::robot_of(loaded.blob()),
    )?;
    let tools = data.frames(&loaded, &a.test, which)?;
    let frames = FittedFrames::new(&loaded, samples, tools, which)
        .map_err(|error| frame_failure(&a.test, &data.names, error))?;
    let shift = frames.instrument_from_base * loaded.instrument_from_base().inverse();
    let predicted = |s: &InstrumentSample| {
        let first = loaded.predict(&s.joints, s.payload_kg);
        let pose = match frames.is_base_fitted {
            true => shift * first.pose,
            false => first.pose,
        };
        Prediction {
            pose: pose * frames.tools[s.tool],
            ..first
        }
    };
    let predictions: Vec<Prediction> = samples.iter().map(predicted).collect();
    let shows_turn = |tool: usize| {
        let mut own = samples.iter().filter(|s| s.tool == tool);
        own.any(|s| s.observation.has_orientation())
    };
    let is_turned = |s: &InstrumentSample| !frames.is_tool_fitted[s.tool] || shows_turn(s.tool);
    let compared = |i: &usize| !frames.left_out.contains(i);
    let compared: Vec<usize> = (0..samples.len()).filter(compared).collect();
    let measured: Vec<PoseError> = compared
        .iter()
        .map(|i| samples[*i].observation.error(&predictions[*i].pose))
        .collect();
    let of_truth = |i: &usize| {
        let error = PoseError::between(&set.measurements[*i].truth?, &predictions[*i].pose);
        Some(PoseError {
            orientation_mrad: error.orientation_mrad.filter(|_| is_turned(&samples[*i])),
            ..error
        })
    };
    let truth: Vec<PoseError> = compared.iter().filter_map(of_truth).collect();
    let result = SetErrors {
        name: file_name(&a.test),
        errors: ErrorSummary::new(&measured),
        against_truth: set.has_truth().then(|| ErrorSummary::new(&truth)),
        flagged: predictions.iter().filter(|p| !p.status.is_ok()).count(),
        trust: TrustSummary {
            mean: predictions.iter().map(|p| p.trust).sum::<f32>() / predictions.len() as f32,
            least: predictions.iter().map(|p| p.trust).fold(1.0, f32::min),
        },
        predictive_std: StdSummary::new(samples, &predictions, &compared),
    };
    let document = EvaluateJson {
        version: env!("CARGO_PKG_VERSION"),
        warnings,
        method: loaded.host().provenance.method,
        base_fitted: frames.is_base_fitted,
        tool_fitted: frames.is_tool_fitted.contains(&true),
        sets: [&result],
    };
    let rows: Vec<(Prediction, bool)> = predictions
        .iter()
        .zip(samples)
        .map(|(prediction, sample)| (*prediction, is_turned(sample)))
        .collect();
    let (csv, json) = (to_csv(&rows, a.trust), json_text(&document)?);
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(a.predictions.as_deref().map(|path| (path, csv.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    let report = Printer::for_outputs(&outputs);
    print(
        report,
        &result,
        loaded.host().provenance.method,
        &predictions,
    );
    if !is_same_frame(&result.errors) {
        warning(format_args!(
            "{}: these measurements are not in the frames of the calibration, or not of this robot: {FRAMES_HELP}",
            a.test.display()
        ));
    }
    if let Some(line) = fitted_frames(
        document.base_fitted,
        document.tool_fitted,
        frames.left_out.len(),
    ) {
        report.line(line);
    }
    Ok(())
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

/// Each prediction, and whether its orientation is known.
fn to_csv(predictions: &[(Prediction, bool)], with_trust: bool) -> String {
    let mut out = String::from("x_mm,y_mm,z_mm,qw,qx,qy,qz,status");
    out += if with_trust {
        ",trust,sigma_mm\n"
    } else {
        "\n"
    };
    for (prediction, is_turned) in predictions {
        let Prediction { pose, status, .. } = prediction;
        let t = 1e3 * pose.translation;
        let (w, v) = pose.quaternion();
        let _ = write!(out, "{:.6},{:.6},{:.6},", t[0], t[1], t[2]);
        let _ = match is_turned {
            true => write!(out, "{w:.12},{:.12},{:.12},{:.12}", v[0], v[1], v[2]),
            false => write!(out, ",,,"),
        };
        let _ = write!(out, ",{status}");
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
