//! Gear lines: ripple frequencies that a robot's description states.

use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::ErrorSummary;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::calibrated;
use crate::own_joint_curve::{Curves, anywhere, measured, robot};

/// Number of draws, and poses for training and for testing.
const DRAWS: u64 = 4;
const COUNTS: (usize, usize) = (40, 150);
/// The simulated ripple of every joint: cycles per turn, and amplitude in rad.
const CYCLES: usize = 200;
const AMPLITUDE: f64 = 5e-5;

/// Returns the mean held-out error in mm when the description states these lines for every joint, and the ripple
/// frequencies that the last draw fitted.
fn found(stated: &[f64]) -> (f64, Vec<f64>) {
    let mut robot = robot();
    for joint in &mut robot.joints {
        joint.gear_lines = stated.to_vec();
    }
    let mut orders = vec![vec![[0.0; 2]; CYCLES]; 6];
    for (c, joint) in orders.iter_mut().enumerate() {
        let phase = c as f64;
        joint[CYCLES - 1] = [AMPLITUDE * libm::cos(phase), AMPLITUDE * libm::sin(phase)];
    }
    let (curves, mut mean, mut ripple) = (Curves { orders }, 0.0, Vec::new());
    for seed in 0..DRAWS {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let train = measured(&curves, COUNTS.0, &mut random, anywhere);
        let test = measured(&curves, COUNTS.1, &mut random, anywhere);
        let found = calibrated(&robot, &train, &Config::new(Method::Elastic));
        let errors = ErrorSummary::new(&found.blob.errors(&test));
        mean += errors.position_mm.mean / DRAWS as f64;
        let report = &found.calibration.correction.elastic().unwrap().report;
        ripple = report.ripple.iter().map(|line| line.1).collect();
    }
    (mean, ripple)
}

/// A search hardly finds a ripple of 50 µrad in forty poses. Stated frequencies are fitted without a search. Wrong ones
/// increase the error by less than 15 %.
#[test]
fn what_is_stated_needs_no_search() {
    let (without, _) = found(&[]);
    let (with, ripple) = found(&[CYCLES as f64]);
    let (wrong, _) = found(&[CYCLES as f64 - 37.0]);
    println!(
        "{without:.4} mm without a statement, {with:.4} with the gears', {wrong:.4} with another"
    );
    assert_eq!(ripple, [CYCLES as f64; 6]);
    assert!(with < 0.9 * without, "{with} {without}");
    assert!(wrong < 1.15 * without, "{wrong} {without}");
}
