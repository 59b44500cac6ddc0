//! `trainer calibrate`.

use serde::Serialize;

use super::arguments::Calibrate;
use super::{
    Arm, Failure, calibration_failure, check_outputs, enough_poses, origin, progress, write_json,
};
use crate::calibration::frames::FrameFit;
use crate::calibration::{Calibration, Method, Options, calibrate};
use crate::export::{Fidelity, export};
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
    check_outputs([&Some(a.out.clone()), &a.json])?;
    let mut options = Options {
        max_correction_m: positive("--max-correction-mm", a.max_correction_mm, 1000.0)?.map(|x| 1e-3 * x),
        max_correction_rad: positive("--max-correction-mrad", a.max_correction_mrad, 500.0)?.map(|x| 1e-3 * x),
        ..a.fit.options(Method::from(a.model))
    };
    options.method = a.model.into();
    let arm = Arm::load(&a.robot)?;
    let (set, samples) = arm.read(&a.train)?;
    enough_poses(&a.train, samples.len(), options.method, arm.robot.joints.len())?;
    let spinner = progress::spinner("calibrating");
    let calibration =
        calibrate(&arm.nominal, &samples, &options).map_err(|e| calibration_failure(&a.train, &e))?;
    let (blob, fidelity) = export(&calibration, &arm.robot, &origin(set.sha256, &a.serial_number), &samples)?;
    spinner.finish_and_clear();
    crate::output::write(&a.out, blob.bytes())?;
    let training = ErrorSummary::new(&blob.errors(&samples));
    print(a, &calibration, &blob, &fidelity, &training);
    if let Some(path) = &a.json {
        write_json(path, &document(a, &calibration, &blob, &fidelity, training))?;
    }
    Ok(())
}

fn positive(name: &str, value: Option<f64>, limit: f64) -> Result<Option<f64>, Failure> {
    match value {
        Some(x) if !(x > 0.0 && x <= limit) => {
            Err(Failure::Usage(format!("{name} {x}: expected a number above 0 and at most {limit}")))
        }
        _ => Ok(value),
    }
}

fn print(a: &Calibrate, calibration: &Calibration, blob: &LoadedBlob, fidelity: &Fidelity, training: &ErrorSummary) {
    let p = &training.position_mm;
    println!("Calibrated {} with `{}` on {} poses.", a.robot.robot, calibration.options.method.name(), training.poses);
    if let Some(fit) = &calibration.step1 {
        println!("  step 1: {} of {} parameters can be identified", fit.rank, fit.parameters);
    }
    println!("  error on the training poses themselves: {:.4} mm mean, {:.4} mm largest", p.mean, p.max);
    println!("  (they were trained on: for honest figures use `trainer compare` or `trainer evaluate`)");
    if calibration.gp.is_some() {
        let (m, rad) = calibration.bound;
        println!("  corrections are bounded to {:.3} mm and {:.3} mrad", 1e3 * m, 1e3 * rad);
    }
    println!(
        "  single precision costs {:.3} µm in the mean, {:.3} µm at most",
        1e6 * fidelity.mean_m,
        1e6 * fidelity.max_m
    );
    let support = blob.model().support();
    println!("Wrote {} ({} bytes, {support} support points).", a.out.display(), blob.bytes().len());
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
    let hyperparameters = calibration.gp.iter().flat_map(|gp| &gp.hyperparameters).map(|h| {
        let [a, b, c, d, noise_variance] = h.to_array();
        Hyperparameters { theta: [a, b, c, d], noise_variance }
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
        f32_error_um: F32Error { mean: 1e6 * fidelity.mean_m, max: 1e6 * fidelity.max_m },
        blob: BlobFacts {
            file: a.out.display().to_string(),
            bytes: blob.bytes().len(),
            support: blob.model().support(),
        },
    }
}
