//! Reads a TOML file with the tools and bases that a program does not contain.
//!
//! ```toml
//! pulses_per_degree = [1435.6, 1422.2, 1244.4, 1031.1, 980.0, 568.9]   # of INFORM joints
//!
//! [tool."3"]
//! xyz_mm = [0, 80, 310]
//! quaternion = [0.98480775, -0.17364818, 0, 0]   # w, x, y, z
//! payload_kg = 2.5
//!
//! [base."2"]
//! xyz_mm = [1100, 250, 500]
//! quaternion = [1, 0, 0, 0]
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_calibration::robot::toml_source::{Numbers, TomlSource};
use poegp_runtime::math::se3::Pose;
use serde::Deserialize;

use crate::robot_programs::correction::source::Source;
use crate::robot_programs::dialect::Orientation;

/// One entry of the file.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    xyz_mm: Numbers<3>,
    quaternion: Numbers<4>,
    payload_kg: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entries {
    pulses_per_degree: Option<Vec<f64>>,
    #[serde(default)]
    tool: BTreeMap<String, Entry>,
    #[serde(default)]
    base: BTreeMap<String, Entry>,
}

/// A frame of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// `flange_from_tool` or `base_from_frame`.
    pub pose: Pose<f64>,
    /// Payload of a tool, in kg.
    pub payload_kg: Option<f64>,
}

/// Tools (true) and frames (false) by number, each with the name of its file.
pub type Numbered = BTreeMap<(bool, u32), (Given, String)>;

/// Tools and bases by name, in lower case.
#[derive(Clone, Debug, Default)]
pub struct FrameFile {
    path: Option<PathBuf>,
    pulses_per_degree: Option<Vec<f64>>,
    tools: BTreeMap<String, Given>,
    bases: BTreeMap<String, Given>,
}

impl FrameFile {
    /// Reads a file.
    ///
    /// # Errors
    /// [`InputError`] names the file and the entry.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| InputError::unreadable(path, &error, "a file of frames (.toml)"))?;
        Self::parse(path, &text)
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// See [`FrameFile::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let entries: Entries = toml::from_str(text).map_err(|error| {
            let whole = "[tool.\"NAME\"] and [base.\"NAME\"] with xyz_mm = [x, y, z] and quaternion = [w, x, y, z]";
            TomlSource { file: path, text }.refused(&error, whole)
        })?;
        let given = |kind: &str, entries: BTreeMap<String, Entry>| -> Result<_, InputError> {
            let mut out = BTreeMap::new();
            for (name, entry) in entries {
                let pose = entry.pose().ok_or_else(|| {
                    InputError::new(
                        path,
                        format!("an invalid frame [{kind}.\"{name}\"]"),
                        "xyz_mm in millimetres, a quaternion of norm 1 and a payload_kg of 0 or more",
                    )
                })?;
                let payload_kg = entry.payload_kg;
                out.insert(name.to_lowercase(), Given { pose, payload_kg });
            }
            Ok(out)
        };
        let pulses_per_degree = entries.pulses_per_degree;
        let is_scale = |n: &f64| n.is_finite() && *n != 0.0;
        if pulses_per_degree.iter().flatten().any(|n| !is_scale(n)) {
            let expected = "pulses_per_degree = [one number for each joint, not zero]";
            return Err(InputError::new(
                path,
                "pulses_per_degree with a zero",
                expected,
            ));
        }
        Ok(Self {
            path: Some(path.to_path_buf()),
            pulses_per_degree,
            tools: given("tool", entries.tool)?,
            bases: given("base", entries.base)?,
        })
    }

    /// Returns the number of encoder pulses in a degree, for each joint.
    pub fn pulses_per_degree(&self) -> Option<&[f64]> {
        self.pulses_per_degree.as_deref()
    }

    /// Returns a tool, or else a frame of targets, by its name.
    pub fn named(&self, name: &str, is_tool: bool) -> Option<Given> {
        let all = if is_tool { &self.tools } else { &self.bases };
        all.get(name).copied()
    }

    /// Returns all tools with their names.
    pub fn tools(&self) -> impl Iterator<Item = (&str, Given)> {
        (self.tools.iter()).map(|(name, given)| (name.as_str(), *given))
    }

    /// Returns all frames of targets with their names.
    pub fn bases(&self) -> impl Iterator<Item = (&str, Given)> {
        (self.bases.iter()).map(|(name, given)| (name.as_str(), *given))
    }

    /// Returns the path of the file, to show users where a frame comes from.
    pub fn origin(&self) -> String {
        self.path
            .as_ref()
            .map_or_else(String::new, |path| path.display().to_string())
    }

    /// Returns the error for a frame that is defined nowhere; `data` is the language's own name for such data.
    pub fn unknown(
        &self,
        source: &Source,
        at: usize,
        kind: &str,
        name: &str,
        data: &str,
    ) -> InputError {
        source
            .error(
                at,
                format!("the {kind} \"{name}\", which no file defines"),
                format!(
                    "{data} {name} in the program, or [{kind}.\"{name}\"] in a file of --frames"
                ),
            )
            .with_help(
                "give the files that define it with --with, or its numbers with --frames FILE.toml",
            )
    }
}

impl Entry {
    fn pose(&self) -> Option<Pose<f64>> {
        let is_sound = self.xyz_mm.iter().all(|x| x.abs() < 1e6)
            && self.payload_kg.is_none_or(|kg| (0.0..1e6).contains(&kg));
        let rotation = Orientation::Quaternion.rotation(&*self.quaternion)?;
        let [x, y, z] = self.xyz_mm.0.map(|x| 1e-3 * x);
        is_sound.then_some(Pose {
            rotation,
            translation: Vector3::new(x, y, z),
        })
    }
}
