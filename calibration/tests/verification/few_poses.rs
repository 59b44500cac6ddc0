//! What a check says of models without processes that few poses have trained: what these leave unknown of the frames is no
//! drift, and a drift is still found.
//!
//! The study behind `docs/evidence/verification-evidence.md`:
//!
//! ```sh
//! cargo test --release -p poegp-calibration --test verification -- few_poses --ignored --nocapture
//! ```

use nalgebra::Vector3;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::simulation::Disturbance;
use poegp_calibration::verification::Options;

use crate::study::{ARMS, Cell};

/// Poses of a check.
const CHECK: usize = 20;

/// Alarms of checks of an arm that has not changed, of one whose base is shifted by 0.3 mm, and of one whose zero of a joint is
/// off by 1 mrad.
#[derive(Clone, Copy, Debug, Default)]
struct Alarms {
    checks: usize,
    nothing: usize,
    base: usize,
    joint: usize,
}

/// Checks arms that were trained on so many poses, each so often.
fn alarms(arm: usize, trained: usize, weighting: Weighting, seeds: u64, each: usize) -> Alarms {
    let poe = Config {
        weighting,
        ..Config::new(Method::Poe)
    };
    let (name, scenario) = ARMS[arm];
    let mut out = Alarms::default();
    for seed in 1..=seeds {
        let mut arm = Cell::trained(trained, name, scenario, 100 + seed, &poe);
        for k in 0..each {
            let angle = 0.6 * seed as f64 + 2.3 * k as f64;
            let shift = 0.3e-3 * Vector3::new(libm::cos(angle), libm::sin(angle), 0.0);
            // The last joint is seen by rotations alone.
            let joint = (seed as usize + k) % (arm.robot.joints.len() - 1);
            let mut is_alarmed = |disturbance: Option<Disturbance>| {
                let report = arm.trial(disturbance, CHECK, false, &Options::default());
                usize::from(!report.changes.is_empty())
            };
            out.checks += 1;
            out.nothing += is_alarmed(None);
            out.base += is_alarmed(Some(Disturbance::Base(shift)));
            let offset = 1e-3;
            out.joint += is_alarmed(Some(Disturbance::Joint { joint, offset }));
        }
    }
    out
}

/// At the rate of 1 %, more than two alarms in 32 checks occur once in 300; before frames had the covariance of what the joints
/// do not explain, there were nine.
#[test]
fn a_model_of_few_poses_raises_alarms_at_their_rate() {
    let found = alarms(0, 8, Weighting::Noise, 16, 2);
    println!("{found:?}");
    assert!(found.nothing <= 2, "{found:?}");
}

/// So do checks of six poses, with and without Gaussian processes: of 80, more than four raise one once in 3 000. While the
/// variances that the check itself estimates counted as known, every seventh did.
#[test]
fn a_check_of_few_poses_raises_alarms_at_its_rate() {
    let mut alarms = Vec::new();
    for (arm, method) in [(0, Method::Elastic), (3, Method::Poe)] {
        let (name, scenario) = ARMS[arm];
        for seed in 1..=4 {
            let mut arm = Cell::trained(60, name, scenario, 200 + seed, &Config::new(method));
            let trials = (0..10).map(|_| arm.trial(None, 6, false, &Options::default()));
            alarms.push(trials.filter(|report| !report.changes.is_empty()).count());
        }
    }
    println!("alarms of 10 checks each: {alarms:?}");
    assert!(alarms.iter().sum::<usize>() <= 4, "{alarms:?}");
}

/// Prints the alarms for arms, weights and numbers of training poses.
#[test]
#[ignore = "a study of 2 160 checks"]
fn table() {
    for (weighting, name) in [(Weighting::Noise, "noise"), (Weighting::None, "none")] {
        for arm in [0, 2, 3] {
            for trained in [8, 12, 20] {
                let found = alarms(arm, trained, weighting, 40, 1);
                println!(
                    "{} {:?}, {name}, {trained} poses: {found:?}",
                    ARMS[arm].0, ARMS[arm].1
                );
            }
        }
    }
}
