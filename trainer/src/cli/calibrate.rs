//! `trainer calibrate`.

use std::path::Path;

use serde::Serialize;

use super::arguments::Calibrate;
use super::{
    Arm, Failure, check_outputs, device_failure, drift, enough_poses, json_text, origin, progress,
    report::Report, write_outputs,
};
use crate::calibration::frames::FrameFit;
use crate::calibration::{Calibration, Method, Options};
use crate::drift::DriftReport;
use crate::export::{DeviceCalibration, Fidelity, calibrate_for_device};
use crate::gp::fit::MAX_SIGNAL_VARIANCE;
use crate::identify::{self, IdentifyReport};
use crate::loaded::LoadedBlob;
use crate::statistics::ErrorSummary;

/// What `--json` writes.
#[derive(Serialize)]
struct Document {
    version: &'static str,
    model: &'static str,
    robot: String,
    training_poses: usize,
    training: ErrorSummary,
    step1: Option<Step1>,
    hyperparameters: Vec<Hyperparameters>,
    bound_mm: f64,
    bound_mrad: f64,
    f32_error_um: F32Error,
    #[serde(skip_serializing_if = "Option::is_none")]
    drift: Option<DriftReport>,
    identifiability: Option<IdentifyReport>,
    blob: BlobFacts,
}

#[derive(Serialize)]
struct Step1 {
    parameters: usize,
    identifiable: usize,
    iterations: usize,
    rms: f64,
}

#[derive(Serialize)]
struct Hyperparameters {
    theta: [f64; 4],
    noise_variance: f64,
}

#[derive(Serialize)]
struct F32Error {
    mean: f64,
    max: f64,
}

#[derive(Serialize)]
struct BlobFacts {
    file: String,
    bytes: usize,
    support: usize,
}

pub fn run(a: &Calibrate) -> Result<(), Failure> {
    let outputs = [Some(a.out.as_path()), a.json.as_deref()];
    check_outputs(&outputs, &[&a.train, Path::new(&a.robot.robot)])?;
    let mut options = Options {
        max_correction_m: positive("--max-correction-mm", a.max_correction_mm, 1000.0)?
            .map(|x| 1e-3 * x),
        max_correction_rad: positive("--max-correction-mrad", a.max_correction_mrad, 500.0)?
            .map(|x| 1e-3 * x),
        ..a.fit.options(Method::from(a.model))
    };
    options.method = a.model.into();
    let arm = Arm::load(&a.robot)?;
    let (set, samples, drift) = drift::read(&arm, &a.train, a.correct_drift)?;
    enough_poses(
        &a.train,
        samples.len(),
        options.method,
        arm.robot.joints.len(),
    )?;
    let spinner = progress::spinner("calibrating");
    let origin = origin(set.sha256, &a.serial_number);
    let found = calibrate_for_device(&arm.nominal, &arm.robot, &samples, &options, &origin);
    spinner.finish_and_clear();
    let DeviceCalibration {
        calibration,
        blob,
        fidelity,
    } = found.map_err(|e| device_failure(&a.train, e))?;
    let training = ErrorSummary::new(&blob.errors(&samples));
    let mut document = document(a, &calibration, &blob, &fidelity, training.clone());
    document.drift = drift.map(|d| d.report);
    document.identifiability = identify::of_calibration(&calibration, &arm.robot, &samples);
    let json = json_text(&document)?;
    let mut files = vec![(a.out.as_path(), blob.bytes())];
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    let report = Report::beside(&outputs);
    if let Some(drift) = &document.drift {
        report.line(drift.lines().join("\n"));
        report.line(drift::NO_LEAK);
    }
    let told = document.identifiability.as_ref();
    print(report, a, &calibration, told, &blob, &fidelity, &training);
    Ok(())
}

fn positive(name: &str, value: Option<f64>, limit: f64) -> Result<Option<f64>, Failure> {
    match value {
        Some(x) if !(x > 0.0 && x <= limit) => Err(Failure::Usage(format!(
            "{name} {x}: expected a number above 0 and at most {limit}"
        ))),
        _ => Ok(value),
    }
}

fn print(
    report: Report,
    a: &Calibrate,
    calibration: &Calibration,
    told: Option<&IdentifyReport>,
    blob: &LoadedBlob,
    fidelity: &Fidelity,
    training: &ErrorSummary,
) {
    let p = &training.position_mm;
    report.line(format_args!(
        "Calibrated {} with `{}` on {} poses.",
        a.robot.robot,
        calibration.options.method.name(),
        training.poses
    ));
    if let Some(fit) = &calibration.step1 {
        report.line(format_args!(
            "  step 1: {} of {} parameters can be identified",
            fit.rank, fit.parameters
        ));
    }
    report.line(format_args!(
        "  error on the training poses themselves: {:.4} mm mean, {:.4} mm largest",
        p.mean, p.max
    ));
    report.line(
        "  (they were trained on: for honest figures use `trainer compare` or `trainer evaluate`)",
    );
    if calibration.gp.is_some() {
        let (m, rad) = calibration.bound;
        report.line(format_args!(
            "  corrections are bounded to {:.3} mm and {:.3} mrad",
            1e3 * m,
            1e3 * rad
        ));
    }
    report.line(format_args!(
        "  single precision costs {:.3} µm in the mean, {:.3} µm at most",
        1e6 * fidelity.mean_m,
        1e6 * fidelity.max_m
    ));
    if calibration.options.max_signal_variance < MAX_SIGNAL_VARIANCE {
        report.line(format_args!(
            "  note: the signal variance was held below {} for the sake of single precision",
            calibration.options.max_signal_variance
        ));
    }
    match told {
        Some(told) => report.line(told.lines().join("\n")),
        None => report.line("  what these poses tell about the geometry could not be computed"),
    }
    let support = blob.model().support();
    report.line(format_args!(
        "Wrote {} ({} bytes, {support} support points).",
        a.out.display(),
        blob.bytes().len()
    ));
}

fn document(
    a: &Calibrate,
    calibration: &Calibration,
    blob: &LoadedBlob,
    fidelity: &Fidelity,
    training: ErrorSummary,
) -> Document {
    let step1 = |fit: &FrameFit| Step1 {
        parameters: fit.parameters,
        identifiable: fit.rank,
        iterations: fit.iterations,
        rms: fit.rms,
    };
    let hyperparameters = calibration
        .gp
        .iter()
        .flat_map(|gp| &gp.hyperparameters)
        .map(|h| {
            let [a, b, c, d, noise_variance] = h.to_array();
            Hyperparameters {
                theta: [a, b, c, d],
                noise_variance,
            }
        });
    Document {
        version: env!("CARGO_PKG_VERSION"),
        model: calibration.options.method.name(),
        robot: blob.blob().robot.name.to_owned(),
        training_poses: training.poses,
        training,
        step1: calibration.step1.as_ref().map(step1),
        hyperparameters: hyperparameters.collect(),
        bound_mm: 1e3 * calibration.bound.0,
        bound_mrad: 1e3 * calibration.bound.1,
        f32_error_um: F32Error {
            mean: 1e6 * fidelity.mean_m,
            max: 1e6 * fidelity.max_m,
        },
        drift: None,
        identifiability: None,
        blob: BlobFacts {
            file: a.out.display().to_string(),
            bytes: blob.bytes().len(),
            support: blob.model().support(),
        },
    }
}
