//! The simulated measurements of `tests/data/simulated`.

use std::path::Path;

use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_runtime::kinematics::poe::Poe;

/// Returns the simulated arm of the sets, with its nominal chain.
pub fn arm() -> (Robot, Poe<f64>) {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let nominal = robot.chain().unwrap();
    (robot, nominal)
}

/// Returns the set named `train`, `test1`, `test2` or `test3`.
pub fn simulated(robot: &Robot, set: &str) -> Vec<InstrumentSample> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!(
        "../tests/data/simulated/irb4400_paper_s0_{set}.csv"
    ));
    samples(&measurements::read(path).unwrap(), robot, &mut Vec::new()).unwrap()
}
