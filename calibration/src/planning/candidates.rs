//! Configurations that a cell allows, drawn at random.

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::planning::constraints::Constraints;
use crate::robot::Robot;

/// Most configurations that are drawn: a cell that allows one in ten thousand still gets a plan of some poses.
const MOST_DRAWN: usize = 300_000;
/// Steps of a planned joint in a degree or a millimetre. Every program writes at least three decimals, so that all of
/// them and the CSV file have exactly the joints that were planned.
const STEPS: f64 = 1e3;

/// Allowed configurations, and what became of the others.
#[derive(Clone, Debug)]
pub struct Candidates {
    /// The controller's joints, rad or m.
    pub joints: Vec<Vec<f64>>,
    /// How many were drawn.
    pub drawn: usize,
    /// How many each rule took away: every configuration counts for the first that forbids it.
    pub removed: Vec<usize>,
}

/// A joint in the unit of files and programs: degrees or millimetres.
pub fn in_file_units(kind: JointKind, joint: f64) -> f64 {
    match kind {
        JointKind::Revolute => joint.to_degrees(),
        JointKind::Prismatic => 1e3 * joint,
    }
}

/// A value of a plan as text: the three decimals that it has.
pub fn decimals(value: f64) -> String {
    let text = format!("{value:.3}");
    // A rounded −0.0004 is 0.
    if text == "-0.000" {
        "0.000".to_owned()
    } else {
        text
    }
}

/// The nearest joint within a range that three decimals hold, rad or m.
fn on_grid(kind: JointKind, joint: f64, (lower, upper): (f64, f64)) -> f64 {
    let [least, steps, most] = [lower, joint, upper].map(|x| STEPS * in_file_units(kind, x));
    // A range narrower than a step has no grid point: its middle is as good.
    let value = steps
        .round()
        .clamp(least.ceil().min(most.floor()), most.floor())
        / STEPS;
    match kind {
        JointKind::Revolute => value.to_radians(),
        JointKind::Prismatic => value / 1e3,
    }
}

/// Draws until `wanted` configurations are allowed, or there is no hope; `chain` leads to the target.
pub fn draw(
    robot: &Robot,
    chain: &Poe<f64>,
    constraints: &Constraints,
    wanted: usize,
    seed: u64,
) -> Candidates {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Candidates {
        joints: Vec::with_capacity(wanted),
        drawn: 0,
        removed: vec![0; constraints.rules.len()],
    };
    while out.joints.len() < wanted && out.drawn < MOST_DRAWN {
        out.drawn += 1;
        let joints: Vec<f64> = robot
            .joints
            .iter()
            .zip(&constraints.ranges)
            .map(|(joint, range)| {
                let q = range.0 + (range.1 - range.0) * random.random::<f64>();
                on_grid(joint.kind, q, *range)
            })
            .collect();
        match constraints.forbidden_by(chain, &robot.serial_joints(&joints)) {
            None => out.joints.push(joints),
            Some(rule) => out.removed[rule] += 1,
        }
    }
    out
}
