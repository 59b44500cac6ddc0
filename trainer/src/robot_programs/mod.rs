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
use poegp_calibration::planning::Plan;
use poegp_calibration::robot::Robot;

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
