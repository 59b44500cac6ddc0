//! The kinematics file of the Universal Robots ROS driver, `kinematics_parameters_file` of its description package.
//!
//! ```text
//! kinematics:
//!   shoulder: {x, y, z, roll, pitch, yaw}   base_link_inertia from shoulder_link, and so on along the arm:
//!   upper_arm, forearm, wrist_1, wrist_2, wrist_3
//!   hash: calib_…
//! ```
//!
//! The description package uses each of the six frames as the origin of a joint with axis z. Behind wrist_3 it has only
//! fixed rotations, so tool0 has the origin of wrist_3_link. base_link_inertia is turned by π about z from base_link, so it
//! coincides with the controller's base. The six frames can hold every calibrated axis, but no tilt or offset of the flange
//! from the last axis; that part has to go into the TCP, and is printed.

use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;
use sha2::{Digest, Sha256};

use crate::export::calibrated_chain::at_zero;
use crate::export::describe::{comments, describe};
use crate::export::format::{decimals, rpy, xyz};
use crate::export::{CalibratedChain, gauge};
use poegp_calibration::blob::commander::pose_distance;
use poegp_calibration::robot::normal_form::{origin, rotation_about};

/// Names of the six frames, base first.
pub const LINKS: [&str; 6] = [
    "shoulder",
    "upper_arm",
    "forearm",
    "wrist_1",
    "wrist_2",
    "wrist_3",
];
/// Largest deviation of a nominal arm from the layout, in metres and radians: descriptions round their numbers.
const LAYOUT: f64 = 1e-4;

/// The kinematics of an arm in the driver's convention.
#[derive(Clone, Debug)]
pub struct UrKinematics {
    /// `base_link_inertia_from_shoulder`, `shoulder_from_upper_arm`, …, `wrist_2_from_wrist_3`.
    pub frames: [Pose<f64>; 6],
    /// `tool0_from_target`: the TCP with which the driver's chain ends where the calibrated one does.
    pub tool0_from_target: Pose<f64>,
    /// `tool0_from_flange`: the part of the calibrated flange that the six frames could not hold.
    pub tool0_from_flange: Pose<f64>,
    /// Whether the blob's base is `base_link`, turned by π from the controller's base.
    pub base_is_base_link: bool,
}

/// Reason why an arm has no kinematics file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UrError {
    /// The joints are not six revolute ones.
    #[error("{0} joints, not all of them six revolute ones")]
    Joints(usize),
    /// The joints are coupled.
    #[error("coupled joints")]
    Coupled,
    /// The nominal frames are not those of the layout.
    #[error("nominal axes of another layout: {0}")]
    Layout(String),
}

/// Lengths of the layout in metres: d1, a2, a3, d4, d5, d6 as Universal Robots publishes them.
struct Lengths([f64; 6]);

impl Lengths {
    /// Returns `base_from_link` of the six links at joint values zero.
    fn links(&self) -> [Pose<f64>; 6] {
        let [d1, a2, a3, d4, d5, d6] = self.0;
        let (quarter, half) = (std::f64::consts::FRAC_PI_2, std::f64::consts::PI);
        let frames = [
            origin([0.0, 0.0, d1], [0.0; 3]),
            origin([0.0; 3], [quarter, 0.0, 0.0]),
            origin([a2, 0.0, 0.0], [0.0; 3]),
            origin([a3, 0.0, d4], [0.0; 3]),
            origin([0.0, -d5, 0.0], [quarter, 0.0, 0.0]),
            origin([0.0, d6, 0.0], [quarter, half, half]),
        ];
        let placed = at_zero(&frames);
        std::array::from_fn(|i| placed[i])
    }

    /// Returns the lengths of a nominal arm that has the layout, from the poses of its joints and tool at joint values zero.
    fn of(at_zero: &[Pose<f64>]) -> Result<Self, UrError> {
        let axis = |i: usize| -> Vector3<f64> {
            let r: &Matrix3<f64> = &at_zero[i].rotation;
            Vector3::new(r[(0, 2)], r[(1, 2)], r[(2, 2)])
        };
        let point = |i: usize| at_zero[i].translation;
        let (up, back) = (Vector3::new(0.0, 0.0, 1.0), Vector3::new(0.0, -1.0, 0.0));
        for (i, wanted) in [up, back, back, back, -up, back].iter().enumerate() {
            if (axis(i) - wanted).norm() > LAYOUT {
                let a = axis(i);
                return Err(UrError::Layout(format!(
                    "joint {} turns about {:.4} {:.4} {:.4} where all joints are 0, instead of {:.0} {:.0} {:.0}",
                    i + 1,
                    a[0],
                    a[1],
                    a[2],
                    wanted[0],
                    wanted[1],
                    wanted[2]
                )));
            }
        }
        let tool = point(6);
        let d1 = point(1)[2];
        let a2 = point(2)[0];
        let a3 = point(3)[0] - a2;
        let d4 = -point(4)[1];
        let d5 = d1 - point(5)[2];
        let lengths = Self([d1, a2, a3, d4, d5, -tool[1] - d4]);
        for (i, link) in lengths.links().iter().enumerate() {
            // A joint's frame may be anywhere on its axis; the tool has one position.
            let (placed, what) = if i == 5 {
                (at_zero[6], "tool0".to_owned())
            } else {
                (
                    gauge::nearest_on_axis(&at_zero[i], link),
                    format!("joint {}", i + 1),
                )
            };
            let (apart, turned) = pose_distance(&placed, link);
            if apart > LAYOUT || (i == 5 && turned > LAYOUT) {
                return Err(UrError::Layout(format!(
                    "{what} is {:.3} mm and {:.3} mrad off",
                    1e3 * apart,
                    1e3 * turned
                )));
            }
        }
        Ok(lengths)
    }
}

impl UrKinematics {
    /// Returns the kinematics of a calibrated arm.
    ///
    /// # Errors
    /// [`UrError`] when the nominal arm does not have the layout of a Universal Robots arm from `base` or `base_link` to
    /// `tool0`.
    pub fn of(chain: &CalibratedChain) -> Result<Self, UrError> {
        if chain.coupling.is_some() {
            return Err(UrError::Coupled);
        }
        let n = chain.joints.len();
        if n != 6 || chain.joints.iter().any(|j| j.kind != JointKind::Revolute) {
            return Err(UrError::Joints(n));
        }
        let half_turn = rotation_about(2, std::f64::consts::PI);
        let seen = |frames: &[Pose<f64>], turned: bool| {
            let mut poses = at_zero(frames);
            if turned {
                poses.iter_mut().for_each(|p| *p = half_turn * *p);
            }
            poses
        };
        let nominal = chain.nominal_to_flange();
        let (lengths, turned) = match Lengths::of(&seen(&nominal, false)) {
            Ok(lengths) => (lengths, false),
            Err(error) => match Lengths::of(&seen(&nominal, true)) {
                Ok(lengths) => (lengths, true),
                Err(_) => return Err(error),
            },
        };
        let calibrated = seen(&chain.to_flange(), turned);
        let mut links = lengths.links();
        // tool0 is where wrist_3 is, and as near to the flange as axis 6 allows.
        links[5] = calibrated[6];
        let placed: [Pose<f64>; 6] =
            std::array::from_fn(|i| gauge::nearest_on_axis(&calibrated[i], &links[i]));
        let frames = std::array::from_fn(|i| match i {
            0 => placed[0],
            _ => placed[i - 1].inverse() * placed[i],
        });
        let tool0_from_flange = placed[5].inverse() * calibrated[6];
        Ok(Self {
            frames,
            tool0_from_target: tool0_from_flange * chain.flange_from_target,
            tool0_from_flange,
            base_is_base_link: turned,
        })
    }

    /// Returns the lines before the numbers of a file.
    pub(super) fn comments(&self, chain: &CalibratedChain) -> Vec<String> {
        let mut out = comments(chain, &chain.not_carried);
        out.push(
            "metres and radians; each frame in the one before, the first in base_link_inertia (the controller's base)"
                .to_owned(),
        );
        out.push(format!(
            "the target in tool0, to be set as TCP: {}",
            describe(&self.tool0_from_target)
        ));
        out
    }

    /// Returns the file as YAML.
    pub fn to_yaml(&self, chain: &CalibratedChain) -> String {
        let mut body = String::new();
        for (name, frame) in LINKS.iter().zip(&self.frames) {
            let (t, r) = (xyz(frame), rpy(frame));
            let _ = writeln!(body, "  {name}:");
            for (key, value) in ["x", "y", "z", "roll", "pitch", "yaw"]
                .iter()
                .zip(t.iter().chain(&r))
            {
                let _ = writeln!(body, "    {key}: {}", decimals(*value));
            }
        }
        let digest = Sha256::digest(body.as_bytes());
        let hash = digest
            .iter()
            .take(8)
            .fold(0_u64, |h, b| (h << 8) | u64::from(*b));
        let mut out = String::new();
        for line in self.comments(chain) {
            let _ = writeln!(out, "# {line}");
        }
        out += "# the hash is of these numbers, not the controller's: the driver will say that they differ from the factory's\n";
        let _ = write!(out, "kinematics:\n{body}  hash: calib_{hash}\n");
        out
    }
}
