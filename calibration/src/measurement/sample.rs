//! Converts a measurement file to what a fit needs: the joints of the serial chain, and the tool of every row.

use std::collections::HashSet;
use std::path::Path;

use poegp_protocol::limits::MAX_TOOLS;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::elapsed::Elapsed;
use crate::measurement::observation::{InstrumentNoise, Observation};
use crate::measurement::set::{Measurement, MeasurementSet};
use crate::robot::Robot;

/// Frame of an observation from the instrument: `instrument_from_target`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instrument;

/// Frame of an observation from the base of the robot: `base_from_target`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Base;

/// One measurement with everything that a fit needs; `F` is the frame of its observation.
#[derive(Clone, Debug)]
pub struct Sample<F> {
    /// The controller's joints, in rad or m: the inputs of the correction.
    pub joints: Vec<f64>,
    /// The joints of the serial chain, C q.
    pub serial_joints: Vec<f64>,
    /// Payload in kg, where it is known.
    pub payload_kg: Option<f64>,
    /// Observation of the target.
    pub observation: Observation,
    /// Frame of `observation`.
    pub frame: F,
    /// Index of the tool, from 0; each session and target has its own tool.
    pub tool: usize,
    /// Noise that the file declares for this row.
    pub declared_noise: InstrumentNoise,
    /// Time of the measurement since the start of its session, if known.
    pub elapsed: Option<Elapsed>,
}

/// A sample in the instrument's frame, as the file has it.
pub type InstrumentSample = Sample<Instrument>;
/// A sample in the base frame, as used by the fits that follow the base-tool calibration.
pub type BaseSample = Sample<Base>;

/// Returns the number of samples that differ in joints, payload or tool from all earlier ones: measuring a pose again shows
/// its noise but nothing about the robot.
pub fn different_poses<F>(samples: &[Sample<F>]) -> usize {
    let key = |s: &Sample<F>| -> (Vec<u64>, Option<u64>, usize) {
        // 0.0 and −0.0 are the same joint value.
        let bits = |value: f64| (value + 0.0).to_bits();
        let joints = s.joints.iter().map(|value| bits(*value)).collect();
        (joints, s.payload_kg.map(bits), s.tool)
    };
    samples.iter().map(key).collect::<HashSet<_>>().len()
}

impl<F> Sample<F> {
    /// Creates a sample of the first tool, without payload, declared noise or time.
    pub fn new(
        joints: Vec<f64>,
        serial_joints: Vec<f64>,
        observation: Observation,
        frame: F,
    ) -> Self {
        Self {
            joints,
            serial_joints,
            payload_kg: None,
            observation,
            frame,
            tool: 0,
            declared_noise: InstrumentNoise::UNKNOWN,
            elapsed: None,
        }
    }

    /// Replaces the noise that the row declares by `known`, component by component where it is known.
    #[must_use]
    pub fn with_noise(self, known: InstrumentNoise) -> Self {
        Self {
            declared_noise: known.or(self.declared_noise),
            ..self
        }
    }
}

/// Identity of a tool in a measurement file: the session in which it was mounted and the name of its target.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ToolName {
    /// Name of the session; empty if the file has no sessions.
    pub session: String,
    /// Name of the target; empty if the file names no targets.
    pub target: String,
}

impl ToolName {
    /// Returns whether a row was measured with this tool.
    fn is_of(&self, m: &Measurement) -> bool {
        m.session.as_deref().unwrap_or_default() == self.session
            && m.target.as_deref().unwrap_or_default() == self.target
    }
}

impl std::fmt::Display for ToolName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.session.as_str(), self.target.as_str()) {
            ("", "") => f.write_str("the tool"),
            (session, "") => write!(f, "session \"{session}\""),
            ("", target) => write!(f, "target \"{target}\""),
            (session, target) => write!(f, "target \"{target}\" of session \"{session}\""),
        }
    }
}

/// Converts the rows of `set` to samples of `robot`, in order. Tools that are not yet in `tools` are added to it.
///
/// # Errors
/// Returns an [`InputError`] if there are more tools than a blob holds.
pub fn samples(
    set: &MeasurementSet,
    robot: &Robot,
    tools: &mut Vec<ToolName>,
) -> Result<Vec<InstrumentSample>, InputError> {
    let mut out = Vec::with_capacity(set.measurements.len());
    for (m, elapsed) in set.measurements.iter().zip(set.elapsed()) {
        let tool = tool_of(&set.path, m, tools)?;
        out.push(Sample {
            elapsed,
            ..sample(m, robot, tool)
        });
    }
    Ok(out)
}

/// Returns the index of the tool of a row; a tool that is not yet in `tools` is added.
pub(super) fn tool_of(
    path: &Path,
    m: &Measurement,
    tools: &mut Vec<ToolName>,
) -> Result<usize, InputError> {
    let tool = tools
        .iter()
        .position(|tool| tool.is_of(m))
        .unwrap_or_else(|| {
            tools.push(ToolName {
                session: m.session.clone().unwrap_or_default(),
                target: m.target.clone().unwrap_or_default(),
            });
            tools.len() - 1
        });
    if tools.len() > MAX_TOOLS {
        return Err(InputError::new(
            path,
            format!("more than {MAX_TOOLS} sessions and targets"),
            format!("at most {MAX_TOOLS} tools in one calibration"),
        ));
    }
    Ok(tool)
}

/// Converts one row to a sample of `robot`, without its time.
pub(super) fn sample(m: &Measurement, robot: &Robot, tool: usize) -> InstrumentSample {
    let pose = m.instrument_from_target().map(Observation::Pose);
    Sample {
        serial_joints: robot.serial_joints(&m.joints),
        joints: m.joints.clone(),
        payload_kg: m.payload_kg,
        observation: pose.unwrap_or(Observation::Position(m.position)),
        frame: Instrument,
        tool,
        declared_noise: InstrumentNoise {
            position: m.sigma_position,
            orientation: m.sigma_orientation,
        },
        elapsed: None,
    }
}

/// Transforms the samples to the base frame of the robot.
pub fn in_base_frame(
    samples: &[InstrumentSample],
    instrument_from_base: &Pose<f64>,
) -> Vec<BaseSample> {
    let base_from_instrument = instrument_from_base.inverse();
    let moved = |s: &InstrumentSample| Sample {
        joints: s.joints.clone(),
        serial_joints: s.serial_joints.clone(),
        payload_kg: s.payload_kg,
        observation: s.observation.transformed(&base_from_instrument),
        frame: Base,
        tool: s.tool,
        declared_noise: s.declared_noise,
        elapsed: s.elapsed,
    };
    samples.iter().map(moved).collect()
}
