//! Finds the joint range of the constraints file that costs a plan the most configurations.

use poegp_runtime::kinematics::poe::Poe;

use crate::planning::candidates::draw_within;
use crate::planning::constraints::Constraints;
use crate::robot::Robot;

/// Number of configurations drawn again with the usual range of a joint.
const REDRAWN: usize = 20_000;

/// A joint whose usual range allows more configurations than its range in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WiderRange {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Number of configurations allowed with the joint's usual range.
    pub allowed: usize,
    /// Number of configurations drawn with the joint's usual range.
    pub drawn: usize,
}

/// Returns the joint for which the usual range instead of the file's allows the largest share of configurations, if that is
/// clearly more than `share`.
pub(super) fn wider_range(
    robot: &Robot,
    chain: &Poe<f64>,
    constraints: &Constraints,
    share: f64,
    seed: u64,
) -> Option<WiderRange> {
    let narrowed = constraints.ranges.iter().zip(&constraints.usual_ranges);
    narrowed
        .enumerate()
        .filter_map(|(joint, (given, usual))| {
            let usual = usual.filter(|usual| usual != given)?;
            let mut ranges = constraints.ranges.clone();
            ranges[joint] = usual;
            let found = draw_within(robot, chain, constraints, &ranges, (REDRAWN, REDRAWN), seed);
            Some(WiderRange {
                joint,
                allowed: found.joints.len(),
                drawn: found.drawn,
            })
        })
        // The margin excludes chance.
        .filter(|wider| wider.allowed as f64 > 10.0 + 2.0 * share * wider.drawn as f64)
        .max_by_key(|wider| wider.allowed)
}
