//! `trainer evaluate`.

use clap::Args;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::PathBuf;

use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::cli::args::{FrameArgs, heading};
use crate::cli::examination::AcceptArgs;
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::{self, FRAMES_HELP, file_name, fitted_frames, frame_failure};
use crate::cli::instrument_drift;
use crate::cli::output::long::LongOutput;
use crate::cli::output::{check_outputs, json_text, write_outputs, write_with_long};
use crate::cli::terminal::print::{Printer, warning};
use poegp_calibration::blob::fitted_frames::FittedFrames;
use poegp_calibration::blob::predict::{BlobModel, Prediction};
use poegp_calibration::measurement::Measurement;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::numeric::decimal::push_decimal;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError, PoseErrors};
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::held_out::{SigmaCounts, SigmaShares};
use poegp_calibration::verification::is_same_frame;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
struct EvaluateJson<'a> {
    version: &'static str,
    /// Warnings about the measurements that the user must look at.
    warnings: Vec<Finding>,
    method: &'a str,
    /// Whether the model was calibrated with these measurements.
    training_data: bool,
    base_fitted: bool,
    tool_fitted: bool,
    sets: [&'a SetErrors; 1],
}

#[derive(Serialize)]
struct SetErrors {
    name: String,
    #[serde(flatten)]
    errors: ErrorSummary,
    /// Errors against the noiseless poses of a simulated set.
    #[serde(skip_serializing_if = "Option::is_none")]
    against_truth: Option<ErrorSummary>,
    /// Number of poses whose status was not `ok`.
    flagged: usize,
    trust: TrustSummary,
    /// The device's own estimate of its error; present if the blob contains one.
    #[serde(skip_serializing_if = "Option::is_none")]
    predictive_std: Option<StdSummary>,
}

/// Trust of the device in the joints and payloads: 1 within the trained ranges.
#[derive(Serialize)]
struct TrustSummary {
    mean: f32,
    least: f32,
}

/// Predicted standard deviation of the position, with the shares of the single error components within it.
#[derive(Serialize)]
struct StdSummary {
    mean_mm: f64,
    #[serde(flatten)]
    shares: SigmaShares,
}

/// `trainer evaluate`.
#[derive(Debug, Args)]
#[command(
    after_help = "With touches, the command keeps the arm of the blob and fits features and tips to it. It prints by how much the touches \
    miss each feature, with this arm and with the arm as drawn.\n\n\
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
    /// Write the errors as JSON (`-`: standard output).
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
    let outputs = [a.predictions.as_deref(), a.json.as_deref()];
    check_outputs(&outputs, &[&a.blob, &a.test])?;
    let loaded = BlobModel::read(&a.blob)?;
    let correction = instrument_drift::correction(a.frames.correct_drift);
    let data = inputs::read_long(&loaded, &a.test, correction)?;
    let (set, samples, which) = (&data.set, &data.samples, a.frames.frames());
    let robot = inputs::robot_of(&loaded);
    let warnings = data.examined(&a.test, a.json.as_deref(), &a.accepted.accept, &robot)?;
    let tools = data.frames(&loaded, &a.test, which)?;
    let frames = FittedFrames::new(&loaded, samples, tools, which)
        .map_err(|error| frame_failure(&a.test, &data.names, error))?;
    let judge = Judge {
        writes: a.predictions.is_some(),
        with_trust: a.trust,
        ..Judge::new(&loaded, &set.measurements, &frames)
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
    let flags = all.flags;
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
    let document = EvaluateJson {
        version: env!("CARGO_PKG_VERSION"),
        warnings,
        method: loaded.host().provenance.method,
        training_data: inputs::is_training_data(&loaded, set.sha256),
        base_fitted: frames.is_base_fitted,
        tool_fitted: frames.is_tool_fitted.contains(&true),
        sets: [&result],
    };
    let json = json_text(&document)?;
    let json = a.json.as_deref().map(|path| (path, json.as_bytes()));
    match out {
        Some(out) => write_with_long(out, json.as_slice())?,
        None => write_outputs(json.as_slice())?,
    }
    let report = Printer::for_outputs(&outputs);
    print(report, &result, document.method, &flags, poses);
    if document.training_data {
        inputs::warn_of_training_data(&a.test, a.blob.display());
    }
    if !is_same_frame(&result.errors) {
        warning(format_args!(
            "{}: these measurements are not in the frames of the calibration, or not of this robot: {FRAMES_HELP}",
            a.test.display()
        ));
    }
    if let Some(line) = fitted_frames(
        &loaded,
        document.base_fitted,
        document.tool_fitted,
        frames.left_out.len(),
    ) {
        report.line(line);
    }
    Ok(())
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

/// Predicts measured rows and compares them with the measurements.
struct Judge<'a> {
    loaded: &'a BlobModel,
    frames: &'a FittedFrames,
    /// Transform from the instrument's frame during the calibration to its frame during these measurements.
    shift: Pose<f64>,
    /// Lines of rows that are predicted but not compared.
    left_out: BTreeSet<usize>,
    /// Whether predictions are written; `with_trust` adds their trust and standard deviation.
    writes: bool,
    with_trust: bool,
}

/// Running results of the compared rows; they keep at most 32 bytes of each row.
#[derive(Default)]
struct Judged {
    /// Predictions as rows of CSV.
    text: String,
    poses: usize,
    measured: PoseErrors,
    truth: PoseErrors,
    flagged: usize,
    /// Number of rows with each of [`FLAGS`].
    flags: [usize; FLAGS.len()],
    trust_sum: f64,
    least_trust: Option<f32>,
    sigmas: SigmaCounts,
    /// Sum of the predicted standard deviations, m, and their number.
    sigma_sum: (f64, usize),
}

/// Remarks that are counted.
const FLAGS: [Status; 4] = [
    Status::OUTSIDE_JOINT_RANGE,
    Status::OUTSIDE_PAYLOAD_RANGE,
    Status::CORRECTION_LIMITED,
    Status::BAD_INPUT,
];

impl<'a> Judge<'a> {
    /// Creates a judge of rows whose predictions are not written.
    fn new(loaded: &'a BlobModel, rows: &[Measurement], frames: &'a FittedFrames) -> Self {
        let left_out = frames.left_out.iter().map(|i| rows[*i].line);
        Self {
            shift: frames.instrument_from_base * loaded.instrument_from_base().inverse(),
            left_out: left_out.collect(),
            loaded,
            frames,
            writes: false,
            with_trust: false,
        }
    }

    fn predicted(&self, s: &InstrumentSample) -> Prediction {
        let first = self.loaded.predict(&s.joints, s.payload_kg);
        let pose = match self.frames.is_base_fitted {
            true => self.shift * first.pose,
            false => first.pose,
        };
        Prediction {
            pose: pose * self.frames.tools[s.tool],
            ..first
        }
    }

    fn rows(&self, rows: &[Measurement], samples: &[InstrumentSample]) -> Judged {
        let mut out = Judged::default();
        for (row, sample) in rows.iter().zip(samples) {
            let predicted = self.predicted(sample);
            let observed = &sample.observation;
            // The orientation of a tool that is fitted to positions alone is unknown.
            let is_turned = !self.frames.is_tool_fitted[sample.tool] || observed.has_orientation();
            out.add(&predicted);
            if self.writes {
                push_row(&mut out.text, &predicted, is_turned, self.with_trust);
            }
            if self.left_out.contains(&row.line) {
                continue;
            }
            out.measured.push(&observed.error(&predicted.pose));
            if let Some(truth) = &row.truth {
                let error = PoseError::between(truth, &predicted.pose);
                out.truth.push(&PoseError {
                    orientation_mrad: error.orientation_mrad.filter(|_| is_turned),
                    ..error
                });
            }
            if let Some(sigma) = predicted.position_sigma.map(f64::from) {
                let error = observed.position() - predicted.pose.translation;
                error.iter().for_each(|e| out.sigmas.push(*e, sigma));
                out.sigma_sum = (out.sigma_sum.0 + sigma, out.sigma_sum.1 + 1);
            }
        }
        out
    }
}

impl Judged {
    /// Adds the status and trust of a prediction, whether or not it is compared with a measurement.
    fn add(&mut self, predicted: &Prediction) {
        self.poses += 1;
        self.flagged += usize::from(!predicted.status.is_ok());
        for (count, flag) in self.flags.iter_mut().zip(FLAGS) {
            *count += usize::from(predicted.status.contains(flag));
        }
        self.trust_sum += f64::from(predicted.trust);
        let least = self
            .least_trust
            .map_or(predicted.trust, |t| t.min(predicted.trust));
        self.least_trust = Some(least);
    }

    /// Appends the results of later rows, except their text.
    fn extend(&mut self, later: Self) {
        self.poses += later.poses;
        self.measured.extend(later.measured);
        self.truth.extend(later.truth);
        self.flagged += later.flagged;
        for (count, more) in self.flags.iter_mut().zip(later.flags) {
            *count += more;
        }
        self.trust_sum += later.trust_sum;
        let least = [self.least_trust, later.least_trust];
        self.least_trust = least.into_iter().flatten().reduce(f32::min);
        self.sigmas.extend(later.sigmas);
        let (sum, count) = later.sigma_sum;
        self.sigma_sum = (self.sigma_sum.0 + sum, self.sigma_sum.1 + count);
    }

    /// Summarises the predicted standard deviations; `None` if the blob contains none.
    fn predictive_std(&self) -> Option<StdSummary> {
        let (sum, count) = self.sigma_sum;
        Some(StdSummary {
            shares: self.sigmas.shares()?,
            mean_mm: 1e3 * sum / count as f64,
        })
    }
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

/// Appends a row of the predictions; `is_turned` states whether the orientation is known.
fn push_row(out: &mut String, prediction: &Prediction, is_turned: bool, with_trust: bool) {
    let Prediction { pose, status, .. } = prediction;
    let t = 1e3 * pose.translation;
    for value in t.iter() {
        push_decimal(out, *value, 6);
        out.push(',');
    }
    match is_turned {
        true => {
            let (w, v) = pose.quaternion();
            for (index, value) in [w, v[0], v[1], v[2]].into_iter().enumerate() {
                if index > 0 {
                    out.push(',');
                }
                push_decimal(out, value, 12);
            }
        }
        false => *out += ",,,",
    }
    // Cannot fail: the output is a string.
    let _ = write!(out, ",{status}");
    if with_trust {
        out.push(',');
        push_decimal(out, f64::from(prediction.trust), 6);
        out.push(',');
        if let Some(sigma) = prediction.position_sigma {
            push_decimal(out, f64::from(1e3 * sigma), 6);
        }
    }
    out.push('\n');
}
