//! The device's predictive standard deviation, compared with the trainer's and with held-out errors.

use poegp_calibration::blob::write::{CalibratedBlob, calibrate_to_blob};
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_runtime::math::se3::Pose;

use crate::elastic::fitted;
use crate::{arm, origin, samples, say, simulated_path};

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Compares device, trainer and errors on the held-out poses of one simulated set.
fn held_out(scenario: &'static str, poses: usize) {
    let (robot, _) = arm("abb-irb4400-serial");
    let read = |name: &str| samples(&simulated_path(&format!("{scenario}_s0_{name}")), &robot);
    let shared = fitted(scenario, poses);
    let CalibratedBlob {
        calibration, blob, ..
    } = &shared.get().unwrap().model;
    let base_from_instrument: Pose<f64> = calibration.base_and_tools.instrument_from_base.inverse();
    let noise = f64::from(blob.blob().variance.as_ref().unwrap().noise_m2);
    let (mut ratios, mut beside_noise, mut far) = (Vec::new(), Vec::new(), Vec::new());
    let (mut one, mut two, mut device_sum, mut trainer_sum, mut components) = (0, 0, 0.0, 0.0, 0);
    let (mut t_one, mut t_two) = (0, 0);
    for sample in ["test1", "test2", "test3"].into_iter().flat_map(read) {
        let of_trainer = calibration.standard_deviation(&sample).unwrap();
        let squares: f64 = of_trainer[..3].iter().map(|s| s * s).sum();
        let reference = (squares / 3.0).sqrt();
        let answer = blob.predict(&sample.joints, sample.payload_kg);
        let sigma = f64::from(answer.position_sigma.unwrap());
        ratios.push(sigma / reference);
        beside_noise.push(((sigma * sigma - noise) / (reference * reference - noise)).sqrt());
        let error = base_from_instrument.rotation
            * (sample.observation.position() - answer.pose.translation);
        for (e, t) in error.iter().zip(&of_trainer) {
            one += usize::from(e.abs() <= sigma);
            two += usize::from(e.abs() <= 1.96 * sigma);
            t_one += usize::from(e.abs() <= *t);
            t_two += usize::from(e.abs() <= 1.96 * t);
            components += 1;
        }
        device_sum += sigma;
        trainer_sum += reference;
        // The same pose with joints 2 and 3 turned to where nothing was measured.
        let mut away = sample.clone();
        for joint in [1, 2] {
            away.joints[joint] += 1.5;
            away.serial_joints[joint] += 1.5;
        }
        if far.len() < 30 {
            let of_trainer = calibration.standard_deviation(&away).unwrap();
            let squares: f64 = of_trainer[..3].iter().map(|s| s * s).sum();
            let answer = blob.predict(&away.joints, away.payload_kg);
            far.push(f64::from(answer.position_sigma.unwrap()) / (squares / 3.0).sqrt());
        }
    }
    let share = |n: usize| n as f64 / components as f64;
    let mut sorted = ratios.clone();
    sorted.sort_by(f64::total_cmp);
    let n = ratios.len();
    say(format_args!(
        "{scenario:>5}, {poses} poses: device/trainer {:.3} ({:.3} to {:.3} for 90 %), without noise {:.3}, far away {:.3}; \
         mean {:.4} mm, trainer {:.4}; within one sigma {:.3}, 1.96 {:.3} (trainer {:.3}, {:.3}); {} bytes",
        median(ratios.clone()),
        sorted[n / 20],
        sorted[n - 1 - n / 20],
        median(beside_noise),
        median(far.clone()),
        1e3 * device_sum / n as f64,
        1e3 * trainer_sum / n as f64,
        share(one),
        share(two),
        share(t_one),
        share(t_two),
        blob.bytes().len()
    ));
    let ratio = median(ratios);
    assert!((0.8..1.25).contains(&ratio), "{scenario}: {ratio}");
    let ratio = median(far);
    assert!(
        (0.6..1.25).contains(&ratio),
        "{scenario}, far away: {ratio}"
    );
    // From few poses the hyperparameters are uncertain, and no standard deviation includes that uncertainty.
    let least = if poses < 300 {
        (0.55, 0.88)
    } else {
        (0.60, 0.90)
    };
    for (name, one, two) in [("device", one, two), ("trainer", t_one, t_two)] {
        assert!((least.0..0.76).contains(&share(one)), "{scenario}, {name}");
        assert!((least.1..0.98).contains(&share(two)), "{scenario}, {name}");
    }
}

#[test]
fn of_simulated_sets() {
    for scenario in ["paper", "rich", "wild", "full"] {
        held_out(scenario, 300);
    }
    held_out("wild", 100);
}

/// Returns the minimum, the 5 %, 50 % and 95 % quantiles, and the maximum.
fn spread(mut values: Vec<f64>) -> [f64; 5] {
    values.sort_by(f64::total_cmp);
    let last = values.len() - 1;
    [0, last / 20, last / 2, last - last / 20, last].map(|i| values[i])
}

/// Compares the device with eq. 7 of the paper on held-out poses, on poses far away, and close to training poses.
fn papers_process(scenario: &str, poses: usize, sharing: HyperparameterSharing) {
    let (robot, _) = arm("abb-irb4400-serial");
    let read = |name: &str| samples(&simulated_path(&format!("{scenario}_s0_{name}")), &robot);
    let train: Vec<InstrumentSample> = read("train").into_iter().take(poses).collect();
    let mut options = Config::new(Method::PoeGpLoad);
    options.hyperparameters = sharing;
    let CalibratedBlob {
        calibration, blob, ..
    } = calibrate_to_blob(&robot, &train, &options, &origin(1), &FitContext::default()).unwrap();
    let gp = &calibration.correction.task_space().unwrap().gp;
    let noise = gp.output(0).noise_variance;
    let shared = sharing == HyperparameterSharing::Shared;
    let tests: Vec<InstrumentSample> = ["test1", "test2", "test3"]
        .into_iter()
        .flat_map(read)
        .collect();
    let turned = |sample: &InstrumentSample, by: f64| {
        let mut turned = sample.clone();
        for joint in [1, 2] {
            turned.joints[joint] += by;
            turned.serial_joints[joint] += by;
        }
        turned
    };
    let far: Vec<InstrumentSample> = tests.iter().map(|s| turned(s, 1.5)).collect();
    let close: Vec<InstrumentSample> = train.iter().map(|s| turned(s, 0.05)).collect();
    let ratios = |samples: &[InstrumentSample]| -> (Vec<f64>, Vec<f64>) {
        let ratio = |sample: &InstrumentSample| {
            let of_trainer = calibration.standard_deviation(sample).unwrap();
            let squares: f64 = of_trainer[..3].iter().map(|s| s * s).sum();
            let answer = blob.predict(&sample.joints, sample.payload_kg);
            let ratio = f64::from(answer.position_sigma.unwrap()) / (squares / 3.0).sqrt();
            // Outputs that share hyperparameters share the latent variance, so that of the first is enough.
            let x = [sample.joints.clone(), vec![sample.payload_kg.unwrap()]].concat();
            let latent = gp.variance(&x)[0] / gp.output_scale[0].powi(2);
            let without = (ratio * ratio * (latent + noise) - noise).max(0.0) / latent;
            (ratio, without.sqrt())
        };
        samples.iter().map(ratio).unzip()
    };
    // With hyperparameters per output, one quadratic form on the device approximates six different variances.
    let limits = match shared {
        true => [(0.93, 1.07), (0.87, 1.07), (0.96, 1.16)],
        false => [(0.85, 1.15), (0.7, 1.45), (0.9, 1.25)],
    };
    let sets = [
        ("held out", &tests),
        ("far away", &far),
        ("close by", &close),
    ];
    for ((name, samples), (least, most)) in sets.into_iter().zip(limits) {
        let (with, without) = ratios(samples);
        let (with, without) = (spread(with), spread(without));
        let without = if shared {
            format!(", without noise {without:.3?}")
        } else {
            String::new()
        };
        say(format_args!(
            "{scenario:>5}, {poses} poses, {sharing:?}, {name}: device/eq. 7 {with:.3?}{without}; {} bytes",
            blob.bytes().len()
        ));
        let [_, low, middle, high, _] = with;
        let off = if shared { 0.05 } else { 0.07 };
        assert!((middle - 1.0).abs() < off, "{scenario}: {middle}");
        assert!(low > least && high < most, "{scenario}: {with:?}");
    }
}

#[test]
fn of_the_papers_process() {
    for scenario in ["paper", "rich", "wild", "full"] {
        papers_process(scenario, 100, HyperparameterSharing::Shared);
        papers_process(scenario, 300, HyperparameterSharing::Shared);
    }
    papers_process("wild", 100, HyperparameterSharing::PerOutput);
}

/// The other sets, with hyperparameters per output. `full` with 300 poses is left out: its prior is too large for its noise.
#[test]
#[ignore = "takes half a minute"]
fn of_the_papers_process_with_own_hyperparameters() {
    for (scenario, poses) in [
        ("paper", 100),
        ("paper", 300),
        ("rich", 100),
        ("rich", 300),
        ("wild", 300),
        ("full", 100),
    ] {
        papers_process(scenario, poses, HyperparameterSharing::PerOutput);
    }
}
