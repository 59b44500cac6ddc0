//! What `f32` costs: the blob's poses against the f64 model, on all simulated data.

use poegp_calibration::blob::precision_loss::{MAX_F32_ERROR_M, MEAN_F32_ERROR_M};
use poegp_calibration::blob::write::{DeviceError, ExportError, Provenance, calibrate_to_blob};
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, ProcessLayout};
use poegp_calibration::progress::FitContext;
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::poe::Poe;

use crate::{say, sets};

fn origin() -> Provenance {
    Provenance {
        serial_number: String::new(),
        date: "2026-11-20".to_owned(),
        data_sha256: [0; 32],
        tools: Vec::new(),
        ..Provenance::default()
    }
}

/// The elastic model with a support set for each joint.
fn support_sets() -> Config {
    let mut options = Config::new(Method::Elastic);
    options.layout = ProcessLayout::PerJointSets;
    options.inducing_points = Some(200);
    options
}

#[test]
fn the_blob_is_within_two_micrometres_of_the_model() {
    let (robot, _) = sets::arm();
    let sets = ["train", "test1", "test2", "test3"].map(|set| sets::simulated(&robot, set));
    let per_output = |method| Config {
        hyperparameters: HyperparameterSharing::PerOutput,
        ..Config::new(method)
    };
    for (name, options) in [
        ("base-tool", Config::new(Method::BaseTool)),
        ("poe", Config::new(Method::Poe)),
        ("poe-gp", Config::new(Method::PoeGp)),
        ("poe-gp-load", Config::new(Method::PoeGpLoad)),
        ("poe-gp, per output", per_output(Method::PoeGp)),
        ("poe-gp-load, per output", per_output(Method::PoeGpLoad)),
        ("elastic", Config::new(Method::Elastic)),
        ("elastic, support sets", support_sets()),
    ] {
        let found = calibrate_to_blob(
            &robot,
            &sets[0],
            &options,
            &origin(),
            &FitContext::default(),
        )
        .unwrap();
        let instrument_from_base = found.calibration.base_and_tools.instrument_from_base;
        // Written out, not by `export::fidelity`: the bounded poses are counted, and the rotation is looked at.
        let (mut distances, mut angle, mut bounded) = (Vec::new(), 0.0_f64, 0);
        for sample in sets.iter().flatten() {
            let stored = found.blob.predict(&sample.joints, sample.payload_kg);
            if stored.status.contains(Status::CORRECTION_LIMITED) {
                bounded += 1;
                continue;
            }
            let exact = instrument_from_base * found.calibration.predict(sample);
            distances.push((exact.translation - stored.pose.translation).norm());
            angle = angle.max((exact.inverse() * stored.pose).log().angular.norm());
        }
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        let largest = distances.iter().copied().fold(0.0, f64::max);
        say(format_args!(
            "f32 {name:24} {:.3} µm in the mean, {:.3} µm and {:.2} µrad at most, θ₀ ≤ {}, {bounded} of {} bounded",
            1e6 * mean,
            1e6 * largest,
            1e6 * angle,
            found
                .calibration
                .correction
                .task_space()
                .map_or(f64::NAN, |t| t.max_signal_variance),
            distances.len() + bounded
        ));
        assert!(
            largest < MAX_F32_ERROR_M && mean < MEAN_F32_ERROR_M,
            "{name}"
        );
        assert_eq!(
            bounded, 0,
            "{name}: twice the training's largest is enough here"
        );
        assert!(angle < 2e-6, "{name}");
    }
}

/// Measurements without noise of an arm whose second joint is off by a large smooth function that no geometry
/// explains: decimetres of correction and a process that believes every digit, of which `f32` has seven.
fn absurd(nominal: &Poe<f64>, samples: &[InstrumentSample]) -> Vec<InstrumentSample> {
    let mut out = samples.to_vec();
    for sample in &mut out {
        let mut serial = sample.serial_joints.clone();
        serial[1] += 0.5 * (sample.joints[0] + 0.5 * sample.joints[2]).sin();
        sample.observation = Observation::Pose(nominal.forward(&serial));
    }
    out
}

#[test]
fn a_blob_that_loses_more_is_not_made() {
    let (robot, nominal) = sets::arm();
    let samples = absurd(&nominal, &sets::simulated(&robot, "train"));
    let options = Config::new(Method::PoeGpLoad);
    let found = calibrate_to_blob(
        &robot,
        &samples,
        &options,
        &origin(),
        &FitContext::default(),
    );
    let found = found.map(|found| found.precision_loss);
    let Err(DeviceError::Export(ExportError::SinglePrecisionLossTooLarge(fidelity))) = found else {
        panic!("{found:?}");
    };
    say(ExportError::SinglePrecisionLossTooLarge(fidelity));
    assert!(fidelity.max_m > MAX_F32_ERROR_M || fidelity.mean_m > MEAN_F32_ERROR_M);
}
