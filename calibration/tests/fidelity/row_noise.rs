//! Rows are weighted by the noise that they declare.

use nalgebra::Vector3;
use poegp_calibration::blob::write::{CalibratedBlob, Provenance, calibrate_to_blob};
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::FitContext;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::say;
use crate::sets::{arm, simulated};

/// Noise of the simulated sets' instrument, one component, m and rad; below in mm and mrad.
const NOISE: (f64, f64) = (1e-3 * NOISE_MM_MRAD.0, 1e-3 * NOISE_MM_MRAD.1);
const NOISE_MM_MRAD: (f64, f64) = (0.03, 0.05);
const POSES: usize = 100;
/// One pose in this many is noisy.
const EVERY: usize = 3;

fn stated(factor: f64) -> InstrumentNoise {
    InstrumentNoise {
        position: Some(factor * NOISE.0),
        orientation: Some(factor * NOISE.1),
    }
}

/// Returns the training poses. Every third is made `factor` times as noisy and declares that noise.
fn uneven(factor: f64) -> Vec<InstrumentSample> {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut normal = |sigma: f64| -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            let drawn: f64 = StandardNormal.sample(&mut random);
            sigma * drawn
        })
    };
    let mut samples = simulated(&arm().0, "train");
    samples.truncate(POSES);
    // The existing noise counts as well.
    let added = (factor * factor - 1.0).sqrt();
    for (k, sample) in samples.iter_mut().enumerate() {
        sample.declared_noise = stated(1.0);
        if k % EVERY == 0 {
            sample.declared_noise = stated(factor);
            let turn = Twist {
                linear: Vector3::zeros(),
                angular: normal(added * NOISE.1),
            };
            let mut pose = sample.observation.pose().unwrap();
            pose.rotation = Pose::exp(&turn).rotation * pose.rotation;
            pose.translation += normal(added * NOISE.0);
            sample.observation = Observation::Pose(pose);
        }
    }
    samples
}

fn silent(samples: &[InstrumentSample]) -> Vec<InstrumentSample> {
    let quiet = |s: &InstrumentSample| InstrumentSample {
        declared_noise: InstrumentNoise::UNKNOWN,
        ..s.clone()
    };
    samples.iter().map(quiet).collect()
}

fn calibrated(samples: &[InstrumentSample], options: &Config) -> CalibratedBlob {
    let (robot, _) = arm();
    let origin = Provenance {
        date: "2026-11-20".to_owned(),
        tools: vec![ToolName::default()],
        ..Provenance::default()
    };
    calibrate_to_blob(&robot, samples, options, &origin, &FitContext::default()).unwrap()
}

/// Returns a configuration with weighting by noise and without outliers: noisy rows that do not declare their noise would
/// be left out as outliers.
fn weighted(method: Method) -> Config {
    Config {
        weighting: Weighting::Noise,
        outliers: OutlierPolicy::Keep,
        ..Config::new(method)
    }
}

#[test]
fn rows_of_their_own_noise_count_by_it() {
    let test = simulated(&arm().0, "test1");
    let mean = |samples: &[InstrumentSample], method| {
        let found = calibrated(samples, &weighted(method));
        // A row that is as noisy as it declares is no outlier.
        let states_noise = samples[0].declared_noise != InstrumentNoise::UNKNOWN;
        assert!(!states_noise || found.calibration.outliers.is_empty());
        ErrorSummary::new(&found.blob.errors(&test))
            .position_mm
            .mean
    };
    // The POE model alone is off by half a millimetre, which acts like noise: only a noise of millimetres matters beside it.
    for (method, factor, at_most) in [(Method::Elastic, 10.0, 0.85), (Method::Poe, 100.0, 0.9)] {
        let samples = uneven(factor);
        let own = mean(&samples, method);
        let alike = mean(&silent(&samples), method);
        let clean = mean(&uneven(1.0), method);
        say(format_args!(
            "every third of {POSES} rows {factor} times as noisy, {}: mean {own:.4} mm on fresh poses, {alike:.4} with all \
             rows alike, {clean:.4} without that noise",
            method.name()
        ));
        assert!(own <= at_most * alike, "{own} {alike}");
    }
}

#[test]
fn the_same_noise_in_all_rows_changes_no_byte() {
    let even = uneven(1.0);
    let bytes = |samples: &[InstrumentSample], options: &Config| {
        calibrated(samples, options).blob.bytes().to_vec()
    };
    let poe = weighted(Method::Poe);
    assert_eq!(bytes(&even, &poe), bytes(&silent(&even), &poe));
    // For the elastic model the declared noise is also the lower bound of the fitted noise, as noise stated for all rows is …
    let elastic = Config::new(Method::Elastic);
    let told = Config {
        position_sigma_mm: Some(NOISE_MM_MRAD.0),
        orientation_sigma_mrad: Some(NOISE_MM_MRAD.1),
        ..elastic
    };
    let by_rows = bytes(&even, &elastic);
    assert_eq!(by_rows, bytes(&silent(&even), &told));
    // … and noise stated for all rows takes precedence over the rows' own.
    let loud: Vec<InstrumentSample> = even
        .iter()
        .enumerate()
        .map(|(k, s)| InstrumentSample {
            declared_noise: stated(1.0 + k as f64),
            ..s.clone()
        })
        .collect();
    assert_eq!(by_rows, bytes(&loud, &told));
}
