//! The parts of a plan that every language needs.

use poegp_protocol::JointKind;

use poegp_calibration::planning::Plan;
use poegp_calibration::robot::Robot;
use poegp_calibration::robot::in_file_units;

/// Number of axes that a controller moves as one group.
pub const ARM_AXES: usize = 6;

/// A plan with a program name, as input for every language.
pub struct Script<'a> {
    /// Name of the program, in letters that every controller accepts.
    pub name: String,
    pub robot: &'a Robot,
    pub plan: &'a Plan,
}

/// A pose of a program.
pub struct Stop {
    /// Number from 1, as in the CSV file.
    pub number: usize,
    /// Revolute joints in degrees, base first.
    pub arm: Vec<f64>,
    /// Prismatic joints in mm, base first.
    pub slides: Vec<f64>,
    /// Joints in rad.
    pub radians: Vec<f64>,
    /// Payload to mount before the pose, in kg, where it changes.
    pub mount_kg: Option<f64>,
}

impl Script<'_> {
    pub fn stops(&self) -> Vec<Stop> {
        let mut mounted = None;
        let mut out = Vec::with_capacity(self.plan.poses.len());
        for (number, pose) in (1..).zip(&self.plan.poses) {
            let of = |kind: JointKind| -> Vec<f64> {
                let joints = self.robot.joints.iter().zip(&pose.joints);
                joints
                    .filter(|(joint, _)| joint.kind == kind)
                    .map(|(joint, q)| in_file_units(joint.kind, *q))
                    .collect()
            };
            let mount_kg = pose.payload_kg.filter(|kg| mounted != Some(*kg));
            mounted = pose.payload_kg.or(mounted);
            out.push(Stop {
                number,
                arm: of(JointKind::Revolute),
                slides: of(JointKind::Prismatic),
                radians: pose.joints.clone(),
                mount_kg,
            });
        }
        out
    }

    /// Returns the comments at the beginning of every program.
    pub fn header(&self) -> [String; 4] {
        let check = self.plan.poses.iter().filter(|pose| pose.check).count();
        let checks = match check {
            0 => String::new(),
            _ => format!(", and {check} for its test"),
        };
        [
            format!(
                "{} poses of {} planned for calibration{checks}.",
                self.plan.poses.len() - check,
                ascii(&self.robot.name)
            ),
            "Joints as the controller counts them, at rest before every measurement.".to_owned(),
            "The plan ignores cables and the motion between poses:".to_owned(),
            "run it first at reduced speed with a hand on the emergency stop.".to_owned(),
        ]
    }
}

/// Returns a user's name in ASCII, without characters that could end a comment or a string.
pub fn ascii(text: &str) -> String {
    text.chars()
        .map(|c| match c {
            '"' | ';' => '_',
            _ if c.is_ascii_graphic() || c == ' ' => c,
            _ => '_',
        })
        .collect()
}

/// Formats numbers with three decimals.
pub fn decimals(values: &[f64]) -> Vec<String> {
    values
        .iter()
        .map(|v| poegp_calibration::planning::candidates::decimals(*v))
        .collect()
}
