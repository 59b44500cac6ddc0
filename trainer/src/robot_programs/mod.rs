//! A plan as a program of the robot's controller.
//!
//! Every program does the same: it moves to each pose by an exact stop, lets the arm settle, calls a marker where the
//! measurement is triggered, and stops for the operator before the first pose and wherever the payload changes. Joints are
//! as the controller counts them, with the three decimals that the CSV file has (URScript: radians, nine decimals), so
//! that what is driven is what is written down.
//!
//! No program was ever run on a controller: the formats are those of the makers' manuals and of programs that controllers
//! wrote. Every one begins by saying that it is to be tried slowly.

pub(crate) mod abb_rapid;
pub(crate) mod fanuc_tp;
pub(crate) mod kuka_krl;
#[cfg(test)]
mod tests;
pub(crate) mod urscript;

use poegp_protocol::JointKind;

use poegp_calibration::planning::Plan;
use poegp_calibration::planning::candidates::in_file_units;
use poegp_calibration::robot::Robot;

/// Axes of the arm that a controller moves as one group.
const ARM_AXES: usize = 6;

/// A controller's language.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// ABB.
    Rapid,
    /// KUKA.
    Krl,
    /// Universal Robots.
    UrScript,
    /// Fanuc TP, as a listing.
    Fanuc,
}

impl Language {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Rapid, Self::Krl, Self::UrScript, Self::Fanuc];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rapid => "ABB RAPID",
            Self::Krl => "KUKA KRL",
            Self::UrScript => "URScript",
            Self::Fanuc => "Fanuc TP",
        }
    }

    /// Most characters of a program's name.
    fn longest_name(self) -> usize {
        match self {
            // "Identifiers … a maximum of 32 characters" (RAPID reference, lexical elements).
            Self::Rapid => 32,
            // Module names of KSS 8.
            Self::Krl => 24,
            Self::UrScript => 64,
            // R-30iB; older controllers have 8.
            Self::Fanuc => 36,
        }
    }
}

/// A robot that a language has no program for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{language} moves {expected}, and {robot} has {found}")]
pub struct NoProgram {
    language: &'static str,
    expected: &'static str,
    robot: String,
    found: String,
}

/// What a language needs of a plan.
struct Script<'a> {
    /// Name of the program, letters that every controller takes.
    name: String,
    robot: &'a Robot,
    plan: &'a Plan,
}

/// A pose for a program.
struct Stop {
    /// From 1, as in the CSV file.
    number: usize,
    /// Revolute joints in degrees, base first.
    arm: Vec<f64>,
    /// Slides in mm, base first.
    slides: Vec<f64>,
    /// Joints in rad.
    radians: Vec<f64>,
    /// The payload to mount before it, where it is another one.
    mount_kg: Option<f64>,
}

impl Script<'_> {
    fn stops(&self) -> Vec<Stop> {
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
    fn header(&self) -> [String; 4] {
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

/// The program of a plan; `name` is what it should be called, changed where the controller would not take it.
///
/// # Errors
/// [`NoProgram`] for an arm that the language's controllers do not move.
pub fn program(
    language: Language,
    name: &str,
    robot: &Robot,
    plan: &Plan,
) -> Result<String, NoProgram> {
    let revolute = robot
        .joints
        .iter()
        .filter(|j| j.kind == JointKind::Revolute);
    let (revolute, joints) = (revolute.count(), robot.joints.len());
    let (fits, expected) = match language {
        Language::UrScript => (
            joints == ARM_AXES && revolute == joints,
            "six revolute joints",
        ),
        _ => (
            revolute <= ARM_AXES,
            "at most six revolute joints, and slides as external axes",
        ),
    };
    if !fits {
        return Err(NoProgram {
            language: language.name(),
            expected,
            robot: robot.name.clone(),
            found: format!(
                "{revolute} revolute joints and {} slides",
                joints - revolute
            ),
        });
    }
    let script = Script {
        name: program_name(name, language.longest_name()),
        robot,
        plan,
    };
    Ok(match language {
        Language::Rapid => abb_rapid::write(&script),
        // Controllers that run on Windows, or write such files, end lines as it does.
        Language::Krl => kuka_krl::write(&script).replace('\n', "\r\n"),
        Language::UrScript => urscript::write(&script),
        Language::Fanuc => fanuc_tp::write(&script).replace('\n', "\r\n"),
    })
}

/// Letters, digits and underscores, a letter first.
fn program_name(wanted: &str, longest: usize) -> String {
    let mut name: String = wanted
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.insert_str(0, "plan_");
    }
    name.truncate(longest);
    name
}

/// Names of users in a file that has to be ASCII, without what could end a comment or a string.
fn ascii(text: &str) -> String {
    text.chars()
        .map(|c| match c {
            '"' | ';' => '_',
            _ if c.is_ascii_graphic() || c == ' ' => c,
            _ => '_',
        })
        .collect()
}

/// Numbers with three decimals.
fn decimals(values: &[f64]) -> Vec<String> {
    values
        .iter()
        .map(|v| poegp_calibration::planning::candidates::decimals(*v))
        .collect()
}
