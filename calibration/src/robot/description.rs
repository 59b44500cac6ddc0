//! The nominal arm in normal form.

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::{Poe, WrongChain};
use poegp_runtime::math::se3::Pose;
use poegp_runtime::math::vector::inner_product;

/// A nominal serial arm of 1 to 8 joints in normal form.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Name of the arm.
    pub name: String,
    /// Moving joints, base first.
    pub joints: Vec<Joint>,
    /// The n + 1 fixed frames, in m: `base_from_joint_1`, `joint_1_from_joint_2`, …, `joint_n_from_flange`. Each joint acts
    /// after its frame, about or along its own z axis.
    pub parent_from_joint: Vec<Pose<f64>>,
    /// Joint coupling C in q_serial = C q, n rows of n: it converts the controller's joint values to the chain's. `None` is
    /// the identity. It is invertible but for the columns of passive joints, which are zero.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// Radius of the capsules that represent the links, in m, if the description states one.
    pub link_radius: Option<f64>,
    /// How far an arm of this class is from its nominal model, if the description states it.
    pub prior: Option<ClassPrior>,
}

/// How far an arm of a class is from its nominal model: standard deviations of one component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassPrior {
    /// Standard deviation of one component of a link's offset, in m.
    pub length: f64,
    /// Standard deviation of one component of the direction of an axis, in rad.
    pub tilt: f64,
    /// Standard deviation of the zero of a joint, in rad (for a prismatic joint, in m).
    pub joint_zero: f64,
}

/// Largest limit of a slide in m; longer rails are in no cell.
const LONGEST_SLIDE: f64 = 100.0;

/// What is expected of the limits of a slide in metres that are beyond [`LONGEST_SLIDE`].
pub(super) const WITHIN: &str = "limits of a slide within 100 m: are these millimetres?";

/// Returns whether limits of a slide in m are beyond any rail, as those that are written in millimetres.
pub(super) fn is_too_long((lower, upper): (f64, f64)) -> bool {
    lower.abs().max(upper.abs()) > LONGEST_SLIDE
}

/// Converts a joint to the unit of files and programs: degrees or millimetres.
pub fn in_file_units(kind: JointKind, joint: f64) -> f64 {
    match kind {
        JointKind::Revolute => joint.to_degrees(),
        JointKind::Prismatic => 1e3 * joint,
    }
}

/// Returns which component of a twist (v, ω) in a joint's frame is the joint's own motion.
pub fn own_motion(kind: JointKind) -> usize {
    match kind {
        JointKind::Revolute => 5,
        JointKind::Prismatic => 2,
    }
}

/// One moving joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name of the joint, unique in its robot.
    pub name: String,
    /// Whether the joint turns about z or moves along z.
    pub kind: JointKind,
    /// Lower and upper limit of the *controller's* joint value, in rad or m, finite and lower ≤ upper; `None` is unlimited.
    pub limits: Option<(f64, f64)>,
    /// Known gear errors, in cycles per turn of the *controller's* joint.
    pub gear_lines: Vec<f64>,
    /// Radius of the capsule that represents the link after this joint, in m, if it differs from the robot's.
    pub link_radius: Option<f64>,
}

/// Options of [`Robot::load`]: which part of a URDF is the arm.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// Name of the URDF link from which the chain starts. `None`: the root link.
    pub base: Option<String>,
    /// Name of the URDF link that is the flange. `None`: the only leaf below the base, else the leaf named `tool0`, `flange`
    /// or `ee_link`, in this order.
    pub tip: Option<String>,
}

impl Robot {
    /// Returns the chain from base to flange in the runtime's form.
    ///
    /// # Errors
    /// None for a robot that was loaded: it has 1 to 8 joints and one frame more.
    pub fn chain(&self) -> Result<Poe<f64>, WrongChain> {
        Poe::new(&self.kinds(), &self.parent_from_joint)
    }

    /// Returns the columns of the joints in files, as `q1_deg`.
    pub fn file_columns(&self) -> Vec<String> {
        let column = |(i, joint): (usize, &Joint)| match joint.kind {
            JointKind::Revolute => format!("q{i}_deg"),
            JointKind::Prismatic => format!("q{i}_mm"),
        };
        (1..).zip(&self.joints).map(column).collect()
    }

    /// Returns the kinds of the joints.
    pub fn kinds(&self) -> Vec<JointKind> {
        self.joints.iter().map(|j| j.kind).collect()
    }

    /// Returns C q: the joint values of the serial chain at the controller's joint values `q`, in rad or m.
    pub fn serial_joints(&self, q: &[f64]) -> Vec<f64> {
        coupled(self.coupling.as_deref(), q)
    }

    /// Returns whether the controller has no axis for this joint: nothing but the other joints moves it, by the coupling.
    pub fn is_passive(&self, joint: usize) -> bool {
        self.coupling
            .as_ref()
            .is_some_and(|rows| rows.iter().all(|row| row[joint] == 0.0))
    }

    /// Returns the largest payload of an arm of this reach, in kg: that of arms grows with the cube of the reach. The
    /// strongest has 2300 kg at 3.73 m (data sheet of the FANUC M-2000iA/2300), and lengths of links add up to more.
    pub fn most_payload_kg(&self) -> f64 {
        44.0 * self.reach().powi(3)
    }

    /// Returns the sum of the lengths of the links, with the travel of prismatic joints, in m.
    pub fn reach(&self) -> f64 {
        let links = self.parent_from_joint.iter().skip(1);
        let travel = self.joints.iter().map(|j| match j.kind {
            JointKind::Prismatic => j.limits.map_or(1.0, |(a, b)| b - a),
            JointKind::Revolute => 0.0,
        });
        links.map(|f| f.translation.norm()).sum::<f64>() + travel.sum::<f64>()
    }
}

/// Returns the span of values below which a joint stands still: half a degree in rad, or a millimetre in m.
pub fn still_span(kind: JointKind) -> f64 {
    match kind {
        JointKind::Revolute => 0.5 * std::f64::consts::PI / 180.0,
        JointKind::Prismatic => 1e-3,
    }
}

/// Returns C q for the rows of C, or q if there is no coupling.
pub fn coupled(coupling: Option<&[Vec<f64>]>, q: &[f64]) -> Vec<f64> {
    match coupling {
        None => q.to_vec(),
        Some(rows) => rows.iter().map(|row| inner_product(row, q)).collect(),
    }
}
