//! From a measurement file to what a fit needs: joints through the coupling, and the tool of every row.

use nalgebra::Matrix3;
use poegp_protocol::limits::MAX_TOOLS;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::MeasurementSet;
use crate::measurement::noise::InstrumentNoise;
use crate::robot::Robot;

/// One measured pose with everything a fit needs to know about it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The controller's joints, rad or m: the inputs of the correction.
    pub joints: Vec<f64>,
    /// The joints of the serial chain, C q.
    pub serial: Vec<f64>,
    /// Payload in kg, where it is known.
    pub payload_kg: Option<f64>,
    /// The measured pose of the target, in the instrument's frame or in the base frame as the fit requires.
    pub measured: Pose<f64>,
    /// Which tool it was measured with, from 0: one for each session and target.
    pub tool: usize,
    /// Whether only the position was measured; the rotation of `measured` then means nothing.
    pub position_only: bool,
    /// What the file states of this row's noise.
    pub stated: InstrumentNoise,
}

/// A tool by what a measurement file calls it: the session in which it was mounted and the name of its target.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ToolName {
    /// Empty when the file has no sessions.
    pub session: String,
    /// Empty when the file names no targets.
    pub target: String,
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

/// The rows of `set` as samples of `robot`, in order; poses are `instrument_from_target`. Tools that are not in `tools`
/// yet are added to it.
///
/// # Errors
/// [`InputError`] when there are more tools than a blob holds.
pub fn samples(
    set: &MeasurementSet,
    robot: &Robot,
    tools: &mut Vec<ToolName>,
) -> Result<Vec<Sample>, InputError> {
    let serial = |joints: &[f64]| match &robot.coupling {
        None => joints.to_vec(),
        Some(rows) => rows
            .iter()
            .map(|row| poegp_runtime::math::vector::inner_product(row, joints))
            .collect(),
    };
    let mut out = Vec::with_capacity(set.measurements.len());
    for m in &set.measurements {
        let name = ToolName {
            session: m.session.clone().unwrap_or_default(),
            target: m.target.clone().unwrap_or_default(),
        };
        let tool = tools.iter().position(|t| *t == name).unwrap_or_else(|| {
            tools.push(name);
            tools.len() - 1
        });
        if tools.len() > MAX_TOOLS {
            return Err(InputError::new(
                &set.path,
                format!("more than {MAX_TOOLS} sessions and targets"),
                format!("at most {MAX_TOOLS} tools in one calibration"),
            ));
        }
        let position = Pose {
            rotation: Matrix3::identity(),
            translation: m.position,
        };
        out.push(Sample {
            serial: serial(&m.joints),
            joints: m.joints.clone(),
            payload_kg: m.payload_kg,
            measured: m.instrument_from_target().unwrap_or(position),
            tool,
            position_only: m.orientation.is_none(),
            stated: InstrumentNoise {
                position: m.sigma_position,
                orientation: m.sigma_orientation,
            },
        });
    }
    Ok(out)
}

/// The samples with their poses seen from the base.
pub fn in_base_frame(samples: &[Sample], instrument_from_base: &Pose<f64>) -> Vec<Sample> {
    let base_from_instrument = instrument_from_base.inverse();
    let moved = |s: &Sample| Sample {
        measured: base_from_instrument * s.measured,
        ..s.clone()
    };
    samples.iter().map(moved).collect()
}
