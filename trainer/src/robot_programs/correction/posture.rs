//! Posture of a six-axis arm: which way its wrist, its elbow and its shoulder are turned.
//!
//! A configuration names each side by a letter. Which letter is which side depends on the robot, so that the poses of a program
//! show it.

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_runtime::math::scalar::Scalar;

use crate::robot_programs::correction::program::SLACK;

/// Number of joints of the arms whose sides are known.
const JOINTS: usize = 6;
/// Angle in rad by which a joint is turned to find its axis.
const TURNED: f64 = 0.5;

/// Sides of the wrist, the elbow and the shoulder; `None` beside the singularity between two sides, and for other arms.
pub type Sides = [Option<bool>; 3];

/// Returns the sides on which an arm is.
pub fn sides(commander: &Commander, joints: &Joints) -> Sides {
    if commander.kinds().len() != JOINTS {
        return [None; 3];
    }
    let turned = |joint: usize, by: f64| {
        let mut turned = *joints;
        turned[joint] += by;
        turned
    };
    let [one, three, four, five] = [0, 2, 3, 4].map(|joint| axis(commander, joints, joint));
    // The centre of the wrist is where axes 4 and 5 meet.
    let normal = five.1.cross(&four.1);
    let along = (four.0 - five.0).cross(&four.1).dot(&normal) / normal.norm_squared();
    let wrist = five.0 + five.1 * along;
    // Joint 2 turns axis 3 about axis 2, also where a coupling keeps the lower arm from turning with the upper one.
    let moved = [TURNED, -TURNED].map(|by| axis(commander, &turned(1, by), 2).0 - three.0);
    let upper = (moved[0] + moved[1]) / (2.0 * (Scalar::sin_cos(TURNED).1 - 1.0));
    let across = |v: Vector3<f64>, axis: &Vector3<f64>| v - axis * axis.dot(&v);
    let lower = across(wrist - three.0, &three.1);
    let out = across(wrist - one.0, &one.1);
    let forward = three.1.cross(&one.1);
    let side = |sine: f64| (sine.abs() > SLACK).then_some(sine < 0.0);
    [
        side(Scalar::sin_cos(joints[4]).0),
        side(upper.cross(&lower).dot(&three.1) / (upper.norm() * lower.norm())),
        side(out.dot(&forward) / (upper.norm() + lower.norm())),
    ]
}

/// Returns a point of a joint's axis and its direction, in the base.
fn axis(commander: &Commander, joints: &Joints, joint: usize) -> (Vector3<f64>, Vector3<f64>) {
    let mut turned = *joints;
    turned[joint] += TURNED;
    let back = commander.nominal_flange(joints).inverse();
    let twist = (commander.nominal_flange(&turned) * back).log();
    let size = twist.angular.norm();
    let point = twist.angular.cross(&twist.linear) / (size * size);
    (point, twist.angular / size)
}
