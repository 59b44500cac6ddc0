//! `trainer evaluate`.

use std::fmt::Write as _;
use std::path::Path;

use poegp_protocol::blob::Blob;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::cli::arguments::Evaluate;
use crate::cli::report::Report;
use crate::cli::{
    Failure, check_outputs, drift, file_name, json_text, read_samples, write_outputs,
};
use poegp_calibration::blob::predict::{BlobModel, Prediction};
use poegp_calibration::blob::tool_fit::{evenly_spaced, fit_tool_frame};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError};
use poegp_calibration::robot::{Joint, Robot};
use poegp_calibration::validation::held_out::SigmaShares;

/// What `--json` writes.
#[derive(Serialize)]
struct Document<'a> {
    version: &'static str,
    model: &'a str,
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
    trust: TrustFacts,
    /// What the device says of its own error, of a blob that knows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    position_sigma: Option<SigmaFacts>,
}

/// The device's trust in its inputs, 1 within what was trained.
#[derive(Serialize)]
struct TrustFacts {
    mean: f32,
    least: f32,
}

/// The device's standard deviation of position, and the shares of single components of the errors within it.
#[derive(Serialize)]
struct SigmaFacts {
    mean_mm: f64,
    #[serde(flatten)]
    shares: SigmaShares,
}

impl SigmaFacts {
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

pub fn run(a: &Evaluate) -> Result<(), Failure> {
    let outputs = [a.predictions.as_deref(), a.json.as_deref()];
    check_outputs(&outputs, &[&a.blob, &a.test])?;
    let loaded = BlobModel::read(&a.blob)?;
    let TestData {
        set,
        samples,
        names,
    } = read(&loaded, &a.test, drift::correction(a.correct_drift))?;
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
        trust: TrustFacts {
            mean: predictions.iter().map(|p| p.trust).sum::<f32>() / predictions.len() as f32,
            least: predictions.iter().map(|p| p.trust).fold(1.0, f32::min),
        },
        position_sigma: SigmaFacts::new(
            &samples,
            &predictions,
            &(0..samples.len()).filter(scored).collect::<Vec<_>>(),
        ),
    };
    let document = Document {
        version: env!("CARGO_PKG_VERSION"),
        model: loaded.host().provenance.method,
        sets: [&result],
    };
    let (csv, json) = (to_csv(&predictions, a.trust), json_text(&document)?);
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(a.predictions.as_deref().map(|path| (path, csv.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(
        Report::beside(&outputs),
        &result,
        loaded.host().provenance.method,
        &predictions,
    );
    Ok(())
}

/// A measurement file as the arm of a blob sees it.
pub(super) struct TestData {
    pub set: MeasurementSet,
    pub samples: Vec<InstrumentSample>,
    /// First the tools of the blob, then those that only the file has.
    pub names: Vec<ToolName>,
}

/// Reads and checks a measurement file for the arm of a blob; notes go to standard error.
pub(super) fn read(
    loaded: &BlobModel,
    path: &Path,
    correction: DriftCorrection,
) -> Result<TestData, Failure> {
    let blob = loaded.blob();
    let robot = robot_of(blob);
    let mut names: Vec<ToolName> = loaded
        .tools()
        .iter()
        .map(|(name, _)| name.clone())
        .collect();
    let SampleFile { set, samples, .. } = read_samples(path, &robot, &mut names, correction)?;
    if blob.ranges.payload_kg.is_some() && !set.has_payload() {
        return Err(InputError::new(
            path,
            "no payload_kg column",
            "one: the model depends on the payload",
        )
        .into());
    }
    Ok(TestData {
        set,
        samples,
        names,
    })
}

/// The arm of a blob as far as a measurement file is checked against it.
pub(super) fn robot_of(blob: &Blob<'_>) -> Robot {
    let joint = |(i, joint): (usize, &poegp_protocol::blob::Joint)| Joint {
        name: format!("q{}", i + 1),
        kind: joint.kind,
        limits: joint
            .limits
            .map(|(lower, upper)| (f64::from(lower), f64::from(upper))),
    };
    Robot {
        name: blob.robot.name.to_owned(),
        joints: blob.robot.joints.iter().enumerate().map(joint).collect(),
        parent_from_joint: blob
            .geometry
            .nominal
            .iter()
            .map(|f| Pose::<f32>::from_rows(f).cast())
            .collect(),
        coupling: (!blob.robot.coupling.is_empty()).then(|| {
            let rows = blob.robot.coupling.chunks(blob.robot.joints.len());
            rows.map(|row| row.iter().map(|c| f64::from(*c)).collect())
                .collect()
        }),
    }
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

fn print(report: Report, set: &SetErrors, model: &str, predictions: &[Prediction]) {
    report.line(format_args!(
        "Model `{model}` on {} poses: position in mm, orientation in mrad.\n",
        set.errors.poses
    ));
    let row = |name: &str, e: &ErrorSummary| {
        let mut row = vec![name.to_owned()];
        let p = &e.position_mm;
        row.extend([p.mean, p.median, p.rms, p.p95, p.max].map(|x| format!("{x:.4}")));
        row.push(e.orientation_cell());
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
    if let Some(sigma) = &set.position_sigma {
        report.line(format_args!(
            "The device's standard deviation is {:.4} mm in the mean; {:.0} % of the components lie within one, {:.0} % within 1.96.",
            sigma.mean_mm,
            100.0 * sigma.shares.one_sigma,
            100.0 * sigma.shares.two_sigma
        ));
    }
    if set.trust.least < 1.0 {
        report.line(format_args!(
            "The device's trust in its inputs is {:.3} in the mean, {:.3} at least.",
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
