//! Random configurations that a robot cell allows.

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::planning::constraints::Constraints;
use crate::planning::refusals::Refusals;
use crate::robot::{Robot, in_file_units};

/// Most configurations that are drawn: a robot cell that allows one in ten thousand still gets a plan of some poses.
const MOST_DRAWN: usize = 300_000;
/// Steps of a planned joint in a degree or a millimetre. Every program writes at least three decimals, so that all programs
/// and the CSV file have exactly the planned joints.
const STEPS: f64 = 1e3;

/// Allowed configurations, with the counts of the others.
#[derive(Clone, Debug)]
pub struct Candidates {
    /// The controller's joints, rad or m.
    pub joints: Vec<Vec<f64>>,
    /// Number of configurations that were drawn.
    pub drawn: usize,
    /// Why the other configurations are forbidden.
    pub refusals: Refusals,
}

/// Formats a value of a plan with its three decimals.
pub fn decimals(value: f64) -> String {
    let text = format!("{value:.3}");
    // A rounded −0.0004 is 0.
    if text == "-0.000" {
        "0.000".to_owned()
    } else {
        text
    }
}

/// Returns the nearest joint within a range that three decimals can state, rad or m.
pub(super) fn on_grid(kind: JointKind, joint: f64, (lower, upper): (f64, f64)) -> f64 {
    let [least, steps, most] = [lower, joint, upper].map(|x| STEPS * in_file_units(kind, x));
    // A range narrower than a step has no grid point, so any value in it is as good.
    let value = steps
        .round()
        .clamp(least.ceil().min(most.floor()), most.floor())
        / STEPS;
    match kind {
        JointKind::Revolute => value.to_radians(),
        JointKind::Prismatic => value / 1e3,
    }
}

/// Draws configurations until `wanted` are allowed or the limit of draws is reached; `chain` leads to the target.
pub fn draw(
    robot: &Robot,
    chain: &Poe<f64>,
    constraints: &Constraints,
    wanted: usize,
    seed: u64,
) -> Candidates {
    let count = (wanted, MOST_DRAWN);
    draw_within(robot, chain, constraints, &constraints.ranges, count, seed)
}

/// Draws configurations from other joint ranges, rad or m, until `wanted` are allowed or `most_drawn` are drawn.
pub(super) fn draw_within(
    robot: &Robot,
    chain: &Poe<f64>,
    constraints: &Constraints,
    ranges: &[(f64, f64)],
    (wanted, most_drawn): (usize, usize),
    seed: u64,
) -> Candidates {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Candidates {
        joints: Vec::new(),
        drawn: 0,
        refusals: Refusals::default(),
    };
    while out.joints.len() < wanted && out.drawn < most_drawn {
        out.drawn += 1;
        let joints: Vec<f64> = robot
            .joints
            .iter()
            .zip(ranges)
            .map(|(joint, range)| {
                let q = range.0 + (range.1 - range.0) * random.random::<f64>();
                on_grid(joint.kind, q, *range)
            })
            .collect();
        let rules = constraints.forbidden_by(chain, &robot.serial_joints(&joints));
        if rules.is_empty() {
            out.joints.push(joints);
        } else {
            out.refusals.count(rules);
        }
    }
    out
}
