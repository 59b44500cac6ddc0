//! Writes a plan as a program of the robot's controller.
//!
//! Every program does the same: it moves to each pose with an exact stop, lets the arm settle, calls a marker at which the
//! measurement is triggered, and stops for the operator before the first pose and wherever the payload changes. Joints are
//! as the controller counts them, with the three decimals of the CSV file (URScript: radians, nine decimals), so that the
//! arm moves to exactly the written poses.
//!
//! No program was ever run on a controller: the formats are those of the makers' manuals and of programs that controllers
//! wrote. Every program begins with the advice to try it slowly.

pub(crate) mod abb_rapid;
pub mod correction;
pub mod dialect;
pub(crate) mod fanuc_tp;
pub(crate) mod kuka_krl;
mod script;
#[cfg(test)]
mod tests;
pub(crate) mod urscript;

use poegp_protocol::JointKind;

use crate::robot_programs::script::{ARM_AXES, Script};
use poegp_calibration::input_error::counted;
use poegp_calibration::planning::Plan;
use poegp_calibration::robot::Robot;

/// Programming language of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// ABB RAPID.
    Rapid,
    /// KUKA KRL.
    Krl,
    /// URScript of Universal Robots.
    UrScript,
    /// Fanuc TP, as a listing.
    Fanuc,
}

impl Language {
    /// All languages.
    pub const ALL: [Self; 4] = [Self::Rapid, Self::Krl, Self::UrScript, Self::Fanuc];

    /// Returns the name of the language.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rapid => "ABB RAPID",
            Self::Krl => "KUKA KRL",
            Self::UrScript => "URScript",
            Self::Fanuc => "Fanuc TP",
        }
    }

    /// Returns the largest number of characters of a program's name.
    fn longest_name(self) -> usize {
        match self {
            // "Identifiers … a maximum of 32 characters" (RAPID reference, lexical elements).
            Self::Rapid => 32,
            // Names of modules in KSS 8.
            Self::Krl => 24,
            Self::UrScript => 64,
            // Limit of the R-30iB; older controllers allow 8.
            Self::Fanuc => 36,
        }
    }
}

/// Error for a robot for which a language has no program.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoProgram {
    /// The arm has other joints.
    #[error("{language} moves {expected}, and {robot} has {found}")]
    Axes {
        /// Name of the language.
        language: &'static str,
        /// Arms that it moves.
        expected: &'static str,
        /// Name of the robot.
        robot: String,
        /// Joints of the robot.
        found: String,
    },
    /// A slide is behind a revolute joint. As an external axis it would leave its place to the next joint: axes are exchanged.
    #[error(
        "joint {number} (\"{joint}\") of {robot} slides after a revolute joint, where {language} has no slide"
    )]
    Slide {
        /// Name of the language.
        language: &'static str,
        /// Name of the robot.
        robot: String,
        /// Number of the slide, from 1.
        number: usize,
        /// Name of the slide.
        joint: String,
    },
    /// A joint has no axis of the controller. The joints after it are axes of other numbers, which differ between controllers.
    #[error(
        "joint {number} (\"{joint}\") of {robot} is passive, and controllers number the axes of such arms differently"
    )]
    Passive {
        /// Name of the robot.
        robot: String,
        /// Number of the passive joint, from 1.
        number: usize,
        /// Name of the passive joint.
        joint: String,
    },
}

/// Returns the index of the first slide behind a revolute joint. A slide in front of all revolute joints is a rail or a gantry.
fn slide_in_arm(kinds: &[JointKind]) -> Option<usize> {
    let arm = kinds.iter().position(|kind| *kind == JointKind::Revolute)?;
    let is_slide = |kind: &JointKind| *kind == JointKind::Prismatic;
    kinds[arm..].iter().position(is_slide).map(|at| arm + at)
}

/// Returns the program of a plan. `name` is its wanted name, which is changed where the controller would not accept it.
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
    if let Some(slide) = slide_in_arm(&robot.kinds()) {
        return Err(NoProgram::Slide {
            language: language.name(),
            robot: robot.name.clone(),
            number: slide + 1,
            joint: robot.joints[slide].name.clone(),
        });
    }
    if let Some(passive) = (0..joints).find(|joint| robot.is_passive(*joint)) {
        return Err(NoProgram::Passive {
            robot: robot.name.clone(),
            number: passive + 1,
            joint: robot.joints[passive].name.clone(),
        });
    }
    if !fits {
        return Err(NoProgram::Axes {
            language: language.name(),
            expected,
            robot: robot.name.clone(),
            found: format!(
                "{} and {}",
                counted(revolute, "revolute joint"),
                counted(joints - revolute, "slide")
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
        // Controllers that run on Windows, or write such files, use its line ends.
        Language::Krl => kuka_krl::write(&script).replace('\n', "\r\n"),
        Language::UrScript => urscript::write(&script),
        Language::Fanuc => fanuc_tp::write(&script).replace('\n', "\r\n"),
    })
}

/// Returns a name of letters, digits and underscores that begins with a letter.
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
