//! What every language needs of a plan.

use poegp_protocol::JointKind;

use poegp_calibration::planning::Plan;
use poegp_calibration::planning::candidates::in_file_units;
use poegp_calibration::robot::Robot;

/// Axes of the arm that a controller moves as one group.
pub const ARM_AXES: usize = 6;

/// What a language needs of a plan.
pub struct Script<'a> {
    /// Name of the program, letters that every controller takes.
    pub name: String,
    pub robot: &'a Robot,
    pub plan: &'a Plan,
}

/// A pose for a program.
pub struct Stop {
    /// From 1, as in the CSV file.
    pub number: usize,
    /// Revolute joints in degrees, base first.
    pub arm: Vec<f64>,
    /// Slides in mm, base first.
    pub slides: Vec<f64>,
    /// Joints in rad.
    pub radians: Vec<f64>,
    /// The payload to mount before it, where it is another one.
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

    /// What every program says of itself.
    pub fn header(&self) -> [String; 4] {
        [
            format!(
                "{} poses of {} planned for calibration.",
                self.plan.poses.len(),
                ascii(&self.robot.name)
            ),
            "Joints as the controller counts them, at rest before every measurement.".to_owned(),
            "Planned without the links of the arm, cables, and the ways between poses:".to_owned(),
            "run it first at reduced speed with a hand on the stop.".to_owned(),
        ]
    }
}

/// Names of users in a file that has to be ASCII, without what could end a comment or a string.
pub fn ascii(text: &str) -> String {
    text.chars()
        .map(|c| match c {
            '"' | ';' => '_',
            _ if c.is_ascii_graphic() || c == ' ' => c,
            _ => '_',
        })
        .collect()
}

/// Numbers with three decimals.
pub fn decimals(values: &[f64]) -> Vec<String> {
    values
        .iter()
        .map(|v| poegp_calibration::planning::candidates::decimals(*v))
        .collect()
}
