//! What `f32` loses: the blob's poses against the f64 model, on all simulated data.

use poegp_calibration::blob::precision_loss::{MAX_F32_ERROR_M, MEAN_F32_ERROR_M};
use poegp_calibration::blob::write::{DeviceError, ExportError, Provenance, calibrate_to_blob};
use poegp_calibration::identification::base_tools::fit_base_and_tools;
use poegp_calibration::identification::base_tools::with_base_and_tool;
use poegp_calibration::learning::elastic::fit::fit;
use poegp_calibration::learning::elastic::inputs::ClusteredInput;
use poegp_calibration::learning::elastic::options::{ElasticOptions, NominalArm};
use poegp_calibration::learning::elastic::reduced_solution::solve;
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{InstrumentSample, in_base_frame};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::{say, sets};

fn origin() -> Provenance {
    Provenance {
        date: "2026-11-20".to_owned(),
        ..Provenance::default()
    }
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
        // Independent of `export::fidelity`: this counts limited corrections and compares rotations as well.
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
            "{name}: no correction should exceed the default limit"
        );
        assert!(angle < 2e-6, "{name}");
    }
}

/// Returns measurements without noise of an arm whose second joint has a large smooth error that no geometry explains. The
/// correction is decimetres, and without noise the process fits every digit; `f32` has only seven.
fn absurd(nominal: &Poe<f64>, samples: &[InstrumentSample]) -> Vec<InstrumentSample> {
    let mut out = samples.to_vec();
    for sample in &mut out {
        let mut serial = sample.serial_joints.clone();
        serial[1] += 0.5 * libm::sin(sample.joints[0] + 0.5 * sample.joints[2]);
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

/// Kernels so smooth that their points are hardly distinguishable have weights that nearly cancel. The fit keeps the weights
/// so small that `f32` holds their sum, and states what that costs.
#[test]
fn weights_that_single_precision_cannot_hold_are_made_smaller() {
    let (robot, nominal) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(60);
    samples.iter_mut().for_each(|s| s.payload_kg = None);
    let found = fit_base_and_tools(&nominal, &samples);
    let samples = in_base_frame(&samples, &found.instrument_from_base);
    let chain = with_base_and_tool(&nominal, &Pose::identity(), &found.flange_from_targets[0]);
    let arm = NominalArm {
        tools: vec![chain.frames()[6]],
        chain,
        coupling: None,
        gear_lines: Vec::new(),
    };
    let options = ElasticOptions::default();
    let mut fit = fit(&arm, &samples, &options, &FitContext::default()).unwrap();
    // A prior of a hundredth of a radian, far above the noise.
    let kernel = |rate: f64| JointKernel::<f64>::from_natural(&[rate; 6], 0.0, 1e-4, 0.0);
    let functions: Vec<ClusteredInput> = (0..6)
        .flat_map(|c| (0..40).map(move |j| (c, j)))
        .map(|(c, j)| (c, (fit.inputs.features[j], 0.0)))
        .collect();
    let mut costs = Vec::new();
    for rate in [1e-3, 3e-3, 1e-2] {
        let kernels = vec![kernel(rate); 6];
        let solution = solve(&mut fit, &samples, &kernels, &functions).unwrap();
        let mut worst = 0.0_f64;
        for features in &fit.inputs.features {
            let mut double = [0.0_f64; 6];
            let mut single = [0.0_f32; 6];
            for ((c, (centre, _)), weight) in functions.iter().zip(&solution.weights) {
                let cosines =
                    |d: usize| features[d][0] * centre[d][0] + features[d][1] * centre[d][1];
                let cosines: [f64; 6] = std::array::from_fn(cosines);
                double[*c] += kernels[*c].joint_factor(&cosines) * 1e-4 * weight;
                let exponent: f32 = cosines
                    .iter()
                    .map(|s| kernels[*c].rates()[0] as f32 * *s as f32)
                    .sum();
                single[*c] += libm::exp2f(exponent) * (1e-4 * weight) as f32;
            }
            let falling = libm::exp2(-(0..6).map(|d| kernels[0].rates()[d]).sum::<f64>());
            for (double, single) in double.iter().zip(single) {
                worst = worst.max((double - f64::from(single) * falling).abs());
            }
        }
        say(format_args!(
            "rate {rate}: the largest loss of a joint in f32 is {:.2e} rad; smaller weights move predictions by {:?} µm",
            worst,
            solution.single_precision_cost.map(|m| 1e6 * m)
        ));
        // 0.8 µrad are 2 µm at a distance of 2.5 m.
        assert!(worst < 0.8e-6, "{worst}");
        costs.extend(solution.single_precision_cost);
    }
    assert!(!costs.is_empty(), "no weights were too large");
}
