//! What is stated of poses at other stations, and with a payload that few rows carry.

use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::planning::forecast::sample;
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_calibration::validation::model_selection::{candidates, select_model};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::never_worse::task;
use crate::next_steps::drawn;
use crate::{arm, origin, say, seeds};

/// Number of stations, of poses at each, and how far these are from it, in rad.
const STATIONS: usize = 20;
const AT_EACH: usize = 5;
const NEAR: f64 = 5e-3;
/// Number of poses at stations of their own that show the true error.
const FRESH: usize = 300;
/// Accepted ratio of the stated to the true mean error, over all arms together.
const WITHIN: std::ops::RangeInclusive<f64> = 0.7..=1.5;
/// Least share of the components of the errors within one standard deviation.
const COVERED: f64 = 0.5;

#[test]
fn the_error_at_other_stations_is_stated() {
    let (mut stated, mut truth) = (0.0, 0.0);
    let (mut inside, mut all) = (0, 0);
    for (name, seed) in ["kuka-iiwa7", "ur10"]
        .into_iter()
        .flat_map(|name| (1..=seeds(2)).map(move |seed| (name, seed)))
    {
        let (robot, _) = arm(name);
        let mut simulator = Simulator::new(&robot, Scenario::Nonlinear, &[1.0], seed);
        let ranges = simulator.ranges().to_vec();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut near = |station: &[f64]| {
            let moved = station.iter();
            let joints: Vec<f64> = moved
                .map(|q| q + NEAR * (2.0 * random.random::<f64>() - 1.0))
                .collect();
            sample(&robot, &simulator.measure_at(&joints, 1.0), None)
        };
        let mut places = ChaCha8Rng::seed_from_u64(100 + seed);
        let train: Vec<InstrumentSample> = (0..STATIONS)
            .map(|_| drawn(&ranges, &mut places))
            .flat_map(|station| [(); AT_EACH].map(|()| near(&station)))
            .collect();
        let fresh: Vec<InstrumentSample> = (0..FRESH)
            .map(|_| near(&drawn(&ranges, &mut places)))
            .collect();
        let origin = origin(1);
        let task = task(&robot, &train, &origin);
        let all_candidates = candidates(&train, &robot, &Config::default());
        let choice = select_model(&task, &all_candidates, &mut || ()).unwrap();
        assert_eq!(choice.poses, STATIONS);
        let chosen = choice.table.iter().find(|row| row.chosen).unwrap();
        let found = task.calibrated(&choice.config, &train).unwrap();
        let errors = ErrorSummary::new(&found.blob.errors(&fresh)).position_mm;
        let base = &found.calibration.base_and_tools.instrument_from_base;
        for sample in &fresh {
            let predicted = *base * found.calibration.predict(sample);
            let error =
                base.rotation.transpose() * (sample.observation.position() - predicted.translation);
            if let Some(sigma) = found.calibration.standard_deviation(sample) {
                inside += (0..3).filter(|i| error[*i].abs() < sigma[*i]).count();
                all += 3;
            }
        }
        say(format_args!(
            "{name}, arm {seed}, {STATIONS} stations of {AT_EACH} poses: {:.3} mm stated by `{}`, {:.3} true at other stations",
            chosen.position_mm.mean, chosen.candidate, errors.mean
        ));
        stated += chosen.position_mm.mean;
        truth += errors.mean;
    }
    let covered = f64::from(inside as u32) / f64::from(all);
    say(format_args!(
        "stated {:.2} of the true error (0.7 to 1.5); {:.1} % of the components within one standard deviation (at least 50)",
        stated / truth,
        100.0 * covered
    ));
    assert!(WITHIN.contains(&(stated / truth)), "{}", stated / truth);
    assert!(covered >= COVERED, "{covered}");
}

/// Five of sixty rows carry the largest payload: they are not rejected as outliers, and named where they are predicted worse.
#[test]
fn a_payload_of_few_rows_is_learnt_from_or_named() {
    for seed in 1..=seeds(3) {
        let (robot, _) = arm("abb-irb4400-serial");
        let mut simulator = Simulator::new(&robot, Scenario::Nonlinear, &[0.0, 50.0], seed);
        let ranges = simulator.ranges().to_vec();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut with = |payload: f64| {
            let joints = drawn(&ranges, &mut random);
            sample(
                &robot,
                &simulator.measure_at(&joints, payload),
                Some(payload),
            )
        };
        let train: Vec<InstrumentSample> = (0..60)
            .map(|row| with(if row % 12 == 5 { 50.0 } else { 0.0 }))
            .collect();
        let [empty, loaded] = [0.0, 50.0].map(|payload| {
            let rows = (0..FRESH / 2).map(|_| with(payload));
            rows.collect::<Vec<InstrumentSample>>()
        });
        let origin = origin(1);
        let task = task(&robot, &train, &origin);
        let all = candidates(&train, &robot, &Config::default());
        let choice = select_model(&task, &all, &mut || ()).unwrap();
        let found = task.calibrated(&choice.config, &train).unwrap();
        let mean = |rows: &[InstrumentSample]| {
            ErrorSummary::new(&found.blob.errors(rows)).position_mm.mean
        };
        let ratio = mean(&loaded) / mean(&empty);
        say(format_args!(
            "five of sixty rows with 50 kg, arm {seed}: {:.3} mm without, {:.3} mm with it, named: {}",
            mean(&empty),
            mean(&loaded),
            choice.worst_payload.is_some()
        ));
        // A single row may be one; several are what the payload does.
        assert!(choice.unexplained.len() <= 1, "{:?}", choice.unexplained);
        assert!(ratio < 4.0 || choice.worst_payload.is_some(), "{ratio}");
    }
}
