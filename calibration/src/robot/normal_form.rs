//! Converts joints with arbitrary axes to the normal form; also the elementary frames that this needs.
//!
//! Every description reader pushes its joints and fixed frames in order; `Chain::finish` returns the robot.

use nalgebra::{Matrix3, Vector3};
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::math::se3::Pose;

use crate::numeric::rotation::rotated;
use crate::robot::description::{Joint, Robot};

/// A chain under construction. Fixed frames are multiplied together until a moving joint follows.
pub(super) struct Chain {
    joints: Vec<Joint>,
    parent_from_joint: Vec<Pose<f64>>,
    /// Transform from the z-axis frame of the last joint (or the base) to the current end of the chain.
    pending: Pose<f64>,
}

/// Why a chain is not a supported robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ChainError {
    /// The chain has no moving joint.
    NoJoints,
    /// The chain has more than [`MAX_JOINTS`] moving joints; this is their number.
    TooManyJoints(usize),
}

impl ChainError {
    /// Returns (found, expected) for an error message.
    pub(super) fn describe(self) -> (String, String) {
        let found = match self {
            Self::NoJoints => "no moving joint".to_owned(),
            Self::TooManyJoints(count) => format!("{count} moving joints"),
        };
        (
            found,
            format!("1 to {MAX_JOINTS} revolute or prismatic joints"),
        )
    }
}

impl Chain {
    /// Creates an empty chain that starts at the base frame.
    pub(super) fn new() -> Self {
        Self {
            joints: Vec::new(),
            parent_from_joint: Vec::new(),
            pending: Pose::identity(),
        }
    }

    /// Appends a fixed frame.
    pub(super) fn push_fixed(&mut self, parent_from_child: Pose<f64>) {
        self.pending = self.pending * parent_from_child;
    }

    /// Appends a joint whose axis, in the current end frame, is `axis`: a finite vector of any length except zero.
    pub(super) fn push_joint(&mut self, joint: Joint, axis: &Vector3<f64>) {
        let joint_from_normal = rotation_to_axis(axis);
        self.parent_from_joint
            .push(self.pending * joint_from_normal);
        self.joints.push(joint);
        self.pending = joint_from_normal.inverse();
    }

    /// Returns the robot whose flange is the current end frame. Passive joints stay at 0.
    pub(super) fn finish(
        mut self,
        name: String,
        coupling: Option<Vec<Vec<f64>>>,
    ) -> Result<Robot, ChainError> {
        match self.joints.len() {
            0 => Err(ChainError::NoJoints),
            count if count > MAX_JOINTS => Err(ChainError::TooManyJoints(count)),
            _ => {
                self.parent_from_joint.push(self.pending);
                let (joints, parent_from_joint) = (self.joints, self.parent_from_joint);
                let mut robot = Robot {
                    name,
                    joints,
                    parent_from_joint,
                    coupling,
                    link_radius: None,
                    prior: None,
                };
                for joint in 0..robot.joints.len() {
                    if robot.is_passive(joint) {
                        robot.joints[joint].limits = Some((0.0, 0.0));
                    }
                }
                Ok(robot)
            }
        }
    }
}

/// Returns a rotation that takes z to `axis`: by the smallest angle if the axis points up, otherwise that to the mirrored axis
/// and half a turn about x.
pub fn rotation_to_axis(axis: &Vector3<f64>) -> Pose<f64> {
    let a = axis / norm(axis);
    if a[2] < 0.0 {
        // The formula below divides by 1 + a_z, so z is taken to the mirrored axis first and then turned by half a turn
        // about x.
        let half_turn = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
        let smallest = rotation_to_axis(&(half_turn * a)).rotation;
        return rotated(half_turn * smallest);
    }
    let (x, y, z) = (a[0], a[1], a[2]);
    let k = 1.0 / (1.0 + z);
    rotated(Matrix3::new(
        1.0 - k * x * x,
        -k * x * y,
        x,
        -k * x * y,
        1.0 - k * y * y,
        y,
        -x,
        -y,
        z,
    ))
}

/// Returns the length of a vector, without overflow for any values a file can contain.
pub(super) fn norm(v: &Vector3<f64>) -> f64 {
    libm::hypot(libm::hypot(v[0], v[1]), v[2])
}

/// Returns the rotation by `angle` (rad) about the coordinate axis 0, 1 or 2.
pub fn rotation_about(axis: usize, angle: f64) -> Pose<f64> {
    let (s, c) = libm::sincos(angle);
    rotated(match axis {
        0 => Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c),
        1 => Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c),
        _ => Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0),
    })
}

/// Returns a pure translation, in m.
pub fn translation(x: f64, y: f64, z: f64) -> Pose<f64> {
    Pose {
        rotation: Matrix3::identity(),
        translation: Vector3::new(x, y, z),
    }
}

/// Returns a URDF origin: translation in metres, then roll, pitch and yaw in radians about the fixed x, y and z axes, R =
/// R_z(yaw) R_y(pitch) R_x(roll).
pub fn origin(xyz: [f64; 3], rpy: [f64; 3]) -> Pose<f64> {
    translation(xyz[0], xyz[1], xyz[2])
        * rotation_about(2, rpy[2])
        * rotation_about(1, rpy[1])
        * rotation_about(0, rpy[0])
}

/// Returns roll, pitch and yaw of a rotation in rad, with pitch within ±π/2: the inverse of [`origin`].
///
/// In gimbal lock (pitch ±π/2) roll and yaw cannot be distinguished. Yaw is computed first, and pitch and roll from what
/// remains after removing it. The three therefore reproduce the rotation to the last digits, whatever yaw was found.
pub fn roll_pitch_yaw(rotation: &Matrix3<f64>) -> [f64; 3] {
    let r = rotation;
    let yaw = libm::atan2(r[(1, 0)], r[(0, 0)]);
    let (s, c) = libm::sincos(yaw);
    let across = |column: usize| c * r[(1, column)] - s * r[(0, column)];
    let along = c * r[(0, 0)] + s * r[(1, 0)];
    let pitch = libm::atan2(-r[(2, 0)], along);
    let roll = libm::atan2(-across(2), across(1));
    [roll, pitch, yaw]
}

/// Returns whether every joint of the controller moves the arm in its own way, except passive ones, whose columns are zero:
/// with 1 for the diagonal elements of these columns, the square matrix (rows) is invertible, so that every pivot of Gaussian
/// elimination exceeds 1e-9 of its largest element.
pub(super) fn moves_each_joint(matrix: &[Vec<f64>]) -> bool {
    let mut m = matrix.to_vec();
    let n = m.len();
    for column in 0..n {
        if m.iter().all(|row| row[column] == 0.0) {
            m[column][column] = 1.0;
        }
    }
    let largest = m.iter().flatten().fold(0.0_f64, |max, x| max.max(x.abs()));
    for column in 0..n {
        let Some(pivot) =
            (column..n).max_by(|i, j| m[*i][column].abs().total_cmp(&m[*j][column].abs()))
        else {
            return false;
        };
        m.swap(column, pivot);
        let head = m[column].clone();
        if head[column].abs() <= 1e-9 * largest {
            return false;
        }
        for row in &mut m[column + 1..] {
            let factor = row[column] / head[column];
            for (x, h) in row.iter_mut().zip(&head) {
                *x -= factor * h;
            }
        }
    }
    true
}
