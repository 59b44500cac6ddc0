//! The nominal arm in normal form: fixed frames, and joints that act on their own z axis.
//!
//! Three kinds of description lead to the same [`Robot`]: a URDF, a TOML file in one of three conventions, and the built-in
//! arms, which are TOML files themselves. Whatever the axes in the description, every joint here turns about or moves along
//! the z axis of its own frame: with each axis expressed by a fixed rotation K (K z = axis), the frames become K_{i−1}⁻¹ ·
//! origin_i · K_i. The chain is then
//!
//! ```text
//! base_from_flange(q) = P_0 · Z_1(q_1) · P_1 · Z_2(q_2) · … · Z_n(q_n) · P_n,      q = C · (controller's joints)
//! ```
//!
//! with P_i = `parent_from_joint[i]`, Z_i a rotation about z by q_i (rad) or a translation along z by q_i (m), and C
//! the [`Robot::coupling`].
//!
//! Anything that is not one serial chain of 1 to 8 revolute or prismatic joints is refused, and the error names it.

mod builtin;
mod description;
pub mod normal_form;
pub mod settle;
#[cfg(test)]
mod tests;
mod toml_coupling;
mod toml_description;
pub mod toml_source;
pub mod urdf;
pub mod urdf_document;

use std::path::Path;

#[cfg(test)]
use poegp_protocol::JointKind;
#[cfg(test)]
use poegp_runtime::math::se3::Pose;

pub use crate::robot::builtin::BUILT_IN;
pub use crate::robot::description::{
    ClassPrior, Joint, LoadOptions, Robot, coupled, in_file_units, own_motion, still_span,
};

use crate::input_error::InputError;

impl Robot {
    /// Loads the arm that `spec` names: one of [`BUILT_IN`], else the path of a URDF (`.urdf`, `.xml`) or of a TOML
    /// description (`.toml`). Write `./NAME` for a file that has the name of a built-in arm.
    ///
    /// # Errors
    ///
    /// Returns an [`InputError`] that names the file and, if known, the line. The module [`crate::robot`] describes what is
    /// refused.
    pub fn load(spec: &str, options: &LoadOptions) -> Result<Robot, InputError> {
        if let Some(text) = builtin::text(spec) {
            let file = format!("<built-in {spec}>");
            no_link_names(Path::new(&file), options)?;
            return toml_description::parse(Path::new(&file), text);
        }
        let path = Path::new(spec);
        let bytes = std::fs::read(path).map_err(|error| {
            let wanted =
                "a URDF (.urdf), a robot description (.toml) or the name of a built-in robot";
            InputError::unreadable(path, &error, wanted)
                .with_help(format!("the built-in robots are {}", BUILT_IN.join(", ")))
        })?;
        Self::parse(path, &bytes, options)
    }

    /// Parses the bytes of a URDF or a TOML description; the extension of `path` selects the format.
    ///
    /// # Errors
    ///
    /// Those of [`Robot::load`].
    pub fn parse(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Robot, InputError> {
        let Ok(text) = std::str::from_utf8(bytes) else {
            return Err(InputError::new(
                path,
                "bytes that are not UTF-8 text",
                "a URDF or a TOML file",
            ));
        };
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let extension = path
            .extension()
            .and_then(|e| e.to_str())
            .unwrap_or("")
            .to_ascii_lowercase();
        let robot = match extension.as_str() {
            "urdf" | "xml" => urdf::parse(path, text, options)?,
            "toml" => {
                no_link_names(path, options)?;
                toml_description::parse(path, text)?
            }
            "xacro" => {
                return Err(
                    InputError::new(path, "a xacro file", "a URDF file").with_help(
                        "expand it first, for example `xacro robot.urdf.xacro > robot.urdf`",
                    ),
                );
            }
            _ => {
                return Err(InputError::new(
                    path,
                    format!("the file name extension \"{extension}\""),
                    "\".urdf\", \".xml\" or \".toml\"",
                ));
            }
        };
        no_long_links(path, &robot)?;
        Ok(robot)
    }

    /// Returns base_from_flange at the controller's joint values `q` (rad or m): a test oracle, written without the
    /// runtime's product of exponentials.
    #[cfg(test)]
    pub fn forward(&self, q: &[f64]) -> Pose<f64> {
        let serial: Vec<f64> = match &self.coupling {
            Some(rows) => rows
                .iter()
                .map(|row| row.iter().zip(q).map(|(c, q)| c * q).sum())
                .collect(),
            None => q.to_vec(),
        };
        let mut pose = self.parent_from_joint[0];
        for (i, joint) in self.joints.iter().enumerate() {
            let moved = match joint.kind {
                JointKind::Revolute => normal_form::rotation_about(2, serial[i]),
                JointKind::Prismatic => normal_form::translation(0.0, 0.0, serial[i]),
            };
            pose = pose * moved * self.parent_from_joint[i + 1];
        }
        pose
    }
}

/// Longest link of an arm, in m.
const LONGEST_LINK: f64 = 100.0;

/// Refuses lengths in millimetres that were read as metres. The base may be anywhere.
fn no_long_links(file: &Path, robot: &Robot) -> Result<(), InputError> {
    let links = robot.parent_from_joint[1..].iter().zip(&robot.joints);
    let mut lengths = links.map(|(link, joint)| (normal_form::norm(&link.translation), joint));
    match lengths.find(|(length, _)| *length > LONGEST_LINK) {
        None => Ok(()),
        Some((length, joint)) => Err(InputError::new(
            file,
            format!("a link of {length:.0} m after joint \"{}\"", joint.name),
            format!("links of at most {LONGEST_LINK} m"),
        )
        .with_help(
            "are these millimetres? A URDF is in metres, and a key of a TOML description ends in the unit",
        )),
    }
}

/// Refuses base and tip, which are names of URDF links: any other description would ignore them.
fn no_link_names(file: &Path, options: &LoadOptions) -> Result<(), InputError> {
    for (option, value) in [("base", &options.base), ("tip", &options.tip)] {
        if let Some(link) = value {
            return Err(InputError::new(
                file,
                format!("the {option} link \"{link}\""),
                format!("no {option} link: only a URDF has links to choose from"),
            ));
        }
    }
    Ok(())
}
