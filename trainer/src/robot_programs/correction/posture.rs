//! Posture of a six-axis arm: which way its wrist, its elbow and its shoulder are turned.
//!
//! Where a configuration names each side by a letter, the letter's side depends on the robot, so that the poses of a program
//! show it. The bits of RAPID's `cfx` and of KRL's `S` have one meaning for every arm with an elbow and a wrist ([`Posture`]).

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::math::scalar::Scalar;

use crate::robot_programs::correction::program::{Convention, Posture, SLACK};

/// Number of joints of the arms whose sides are known.
const JOINTS: usize = 6;
/// Angle in rad by which a joint is turned to find its axis.
const TURNED: f64 = 0.5;

/// Largest distance in m between axes that meet, and largest deviation in rad of axes that are parallel or perpendicular.
const MEETS: f64 = 1e-3;

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
    let wrist = crossing(&four, &five);
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

/// What is known of the shape of an arm, to read a [`Posture`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Arm {
    /// Whether it has an elbow and a wrist whose axes meet.
    has_elbow: bool,
    /// Whether joint 2 turns the wrist. Rods beside the lower arm keep it upright, and then `cfx` is not used.
    is_serial: bool,
    /// Sides with all joints at zero. ABB and KUKA have zero where the wrist is in front of axis 1, and ABB has it in front of
    /// the lower arm.
    zero: Sides,
}

impl Arm {
    /// Examines the nominal model.
    pub fn of(commander: &Commander) -> Self {
        let is_turning = |kind: &JointKind| *kind == JointKind::Revolute;
        if commander.kinds().len() != JOINTS || !commander.kinds().iter().all(is_turning) {
            return Self::default();
        }
        // Bent, so that axes 4 and 6 differ.
        let mut bent = [0.0; MAX_JOINTS];
        bent[4] = TURNED;
        let [one, three, four, five, six] =
            [0, 2, 3, 4, 5].map(|joint| axis(commander, &bent, joint));
        let mut raised = bent;
        raised[1] += TURNED;
        let raised = [2, 3].map(|joint| axis(commander, &raised, joint).1);
        let normal = four.1.cross(&five.1);
        let wrist = crossing(&four, &five);
        let is_through = |line: &Line| line.1.cross(&(wrist - line.0)).norm() < MEETS;
        let has_elbow = one.1.dot(&three.1).abs() < MEETS
            && raised[0].cross(&three.1).norm() < MEETS
            && normal.norm() > 0.5
            && [four, five, six].iter().all(is_through);
        Self {
            has_elbow,
            is_serial: raised[1].cross(&four.1).norm() > 0.5 * TURNED,
            zero: sides(commander, &[0.0; MAX_JOINTS]),
        }
    }

    /// Returns the sides that a posture states.
    pub fn stated(&self, posture: &Posture) -> Sides {
        let bit = |bit: u32| posture.bits >> bit & 1 == 1;
        let from_zero = |side: usize, is_other: bool| self.zero[side].map(|zero| zero != is_other);
        match posture.convention {
            _ if !self.has_elbow => [None; 3],
            Convention::Cfx if !self.is_serial => [None; 3],
            Convention::Cfx => [Some(bit(0)), from_zero(1, bit(1)), from_zero(2, bit(2))],
            // A positive sine of the elbow is an axis 3 beyond the stretched arm.
            Convention::Status => [Some(bit(2)), Some(!bit(1)), from_zero(2, bit(0))],
        }
    }
}

/// A point of an axis and its direction, in the base.
type Line = (Vector3<f64>, Vector3<f64>);

/// Returns the point of axis 5 that is nearest to axis 4, which is the centre of the wrist.
fn crossing(four: &Line, five: &Line) -> Vector3<f64> {
    let normal = five.1.cross(&four.1);
    let along = (four.0 - five.0).cross(&four.1).dot(&normal) / normal.norm_squared();
    five.0 + five.1 * along
}

/// Returns a point of a joint's axis and its direction, in the base.
fn axis(commander: &Commander, joints: &Joints, joint: usize) -> Line {
    let mut turned = *joints;
    turned[joint] += TURNED;
    let back = commander.nominal_flange(joints).inverse();
    let twist = (commander.nominal_flange(&turned) * back).log();
    let size = twist.angular.norm();
    let point = twist.angular.cross(&twist.linear) / (size * size);
    (point, twist.angular / size)
}
