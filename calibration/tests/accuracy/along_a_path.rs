//! What a model without processes states of its trained ranges when it has seen them along one path only.

use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::{ErrorSummary, extremes};
use poegp_calibration::planning::forecast::sample;
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_calibration::validation::model_selection::candidates;
use poegp_calibration::validation::work_volume::ExpectedError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::next_steps::{calibrated_by, drawn};
use crate::{arm, say, seeds};

/// Number of corners of a path, and of poses along it.
const CORNERS: usize = 7;
const POSES: usize = 60;
/// Poses for the true errors.
const FRESH: usize = 300;
/// Accepted ratio of the stated to the true mean error over the ranges, over all arms together; along the path, the error is
/// 0.8 of that.
const WITHIN: std::ops::RangeInclusive<f64> = 0.9..=1.4;
/// Least share of the components of all errors within 1.96 standard deviations.
const COVERED: f64 = 0.85;

#[test]
fn a_path_leaves_the_ranges_uncertain_and_the_model_says_so() {
    let (mut stated, mut found, mut along) = (0.0, 0.0, 0.0);
    let (mut inside, mut all) = (0, 0);
    for (name, seed) in ["abb-irb120", "ur10"]
        .into_iter()
        .flat_map(|name| (1..=seeds(3)).map(move |seed| (name, seed)))
    {
        let (robot, _) = arm(name);
        let mut simulator = Simulator::new(&robot, Scenario::Paper, &[], seed);
        let ranges = simulator.ranges().to_vec();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let corners: Vec<Vec<f64>> = (0..CORNERS).map(|_| drawn(&ranges, &mut random)).collect();
        let mut measure = |joints: &[f64]| sample(&robot, &simulator.measure_at(joints, 0.0), None);
        let mut on_path = |at: f64| {
            let (first, share) = (at as usize, at.fract());
            let both = corners[first].iter().zip(&corners[first + 1]);
            let joints: Vec<f64> = both.map(|(a, b)| a + share * (b - a)).collect();
            measure(&joints)
        };
        let legs = (CORNERS - 1) as f64;
        let train: Vec<InstrumentSample> = (0..POSES)
            .map(|k| on_path(legs * k as f64 / POSES as f64))
            .collect();
        let between: Vec<InstrumentSample> = (0..FRESH)
            .map(|_| on_path(legs * random.random::<f64>()))
            .collect();
        let spanned: Vec<(f64, f64)> = (0..ranges.len())
            .map(|joint| extremes(train.iter().map(|s| s.joints[joint])))
            .collect();
        let fresh: Vec<InstrumentSample> = (0..FRESH)
            .map(|_| measure(&drawn(&spanned, &mut random)))
            .collect();
        // A chain alone would not know where a path shows nothing.
        let chosen_from = candidates(&train, &robot, &Config::new(Method::Elastic));
        assert!(chosen_from.iter().all(|c| c.config.method != Method::Poe));
        let model = calibrated_by(Method::Parametric, &robot, &train);
        let expected = ExpectedError::new(&model.calibration, &robot, &train, None).unwrap();
        let mean = |samples: &[InstrumentSample]| {
            let errors = ErrorSummary::new(&model.blob.errors(samples));
            errors.position_mm.mean
        };
        let base = &model.calibration.base_and_tools.instrument_from_base;
        let instrument = base.rotation.transpose();
        for sample in &fresh {
            let predicted = *base * model.calibration.predict(sample);
            let error = sample.observation.position() - predicted.translation;
            let sigma = model.calibration.standard_deviation(sample).unwrap();
            let error = instrument * error;
            inside += (0..3)
                .filter(|i| error[*i].abs() < 1.96 * sigma[*i])
                .count();
            all += 3;
        }
        let (truth, path) = (mean(&fresh), mean(&between));
        say(format_args!(
            "{name}, arm {seed}, {POSES} poses along a path: {:.4} mm stated of the ranges, {truth:.4} true, {path:.4} along the \
             path",
            expected.mean_mm
        ));
        stated += expected.mean_mm;
        found += truth;
        along += path;
    }
    let covered = f64::from(inside as u32) / f64::from(all);
    say(format_args!(
        "stated of the ranges {:.2} of the true error (0.9 to 1.4); along the path it is {:.2} of that; {:.1} % of the components \
         within 1.96 standard deviations (at least 85)",
        stated / found,
        along / found,
        100.0 * covered
    ));
    assert!(WITHIN.contains(&(stated / found)));
    assert!(covered >= COVERED);
}
