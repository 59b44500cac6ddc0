//! The parts that may have moved since the calibration, and the effect of each on the poses.

use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Twist;
use serde::Serialize;

use crate::identification::parametric::state::{Linearised, ROWS};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::matrix::Mat;
use crate::verification::arm::BlobArm;

/// A part of the robot cell that may have changed since the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Part {
    /// Base frame in the instrument's frame.
    Base,
    /// Target frame in the flange frame.
    Tool,
    /// Zero of a joint of the controller, numbered from 1.
    Joint(usize),
    /// Mass of the payload, compared with what the file says.
    Payload,
    /// Size of the arm, compared with the lengths that the file states.
    Size,
}

/// One way in which a part may have moved.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// The part that may have moved.
    pub part: Part,
    /// Whether the hypothesis includes a rotation of the part; for a joint, whether it is revolute.
    pub turns: bool,
    /// Effect on the rows of the check per unit of each component (m, rad or kg); rows are in units of their scales.
    pub effect: Mat<f64>,
}

/// A change of a part while the rows were measured: each row has its share of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Masked {
    /// Index of the hypothesis.
    pub hypothesis: usize,
    /// First row of a step, in chronological order; `None` for a creep.
    pub from: Option<usize>,
    /// Share of each row.
    pub shares: Vec<f64>,
}

impl Masked {
    /// Returns the effect on the rows of the check per unit of each component.
    pub fn effect(&self, all: &[Hypothesis]) -> Mat<f64> {
        let whole = &all[self.hypothesis].effect;
        Mat::from_fn(whole.nrows(), whole.ncols(), |i, j| {
            self.shares[i / ROWS] * whole[(i, j)]
        })
    }
}

/// Returns all hypotheses that the check tests.
pub fn hypotheses(
    arm: &BlobArm,
    at: &Linearised,
    samples: &[InstrumentSample],
    payload_effect: Option<Mat<f64>>,
) -> Vec<Hypothesis> {
    let n = arm.state.layout.joints;
    let mut out = Vec::new();
    for (part, whole) in [
        (Part::Base, base_effect(at)),
        (Part::Tool, tool_effect(arm, at, samples)),
    ] {
        for turns in [false, true] {
            let columns = if turns { 6 } else { 3 };
            out.push(Hypothesis {
                part,
                turns,
                effect: whole.columns(0, columns).into_owned(),
            });
        }
    }
    for joint in 0..n {
        out.push(Hypothesis {
            part: Part::Joint(joint + 1),
            turns: arm.state.kinds()[joint] == JointKind::Revolute,
            effect: at.jacobian.columns(joint, 1).into_owned(),
        });
    }
    out.extend(payload_effect.map(|effect| Hypothesis {
        part: Part::Payload,
        turns: false,
        effect,
    }));
    out
}

/// Returns the effect of a twist of the base frame, in its own axes and at its own origin.
pub fn base_effect(at: &Linearised) -> Mat<f64> {
    at.a.columns(0, 6).into_owned()
}

/// Returns the effect of a motion of the tool against the flange: a displacement of the target and a rotation about it, in
/// the axes of the target. All targets move as one body, about the first target.
pub fn tool_effect(arm: &BlobArm, at: &Linearised, samples: &[InstrumentSample]) -> Mat<f64> {
    let state = &arm.state;
    let first = 6 * state.layout.joints;
    // Twists at the target, in its axes, expressed as twists of the last joint's frame.
    let joint_from_target = state.tools[0];
    let turned: Vec<[f64; 6]> = (0..6)
        .map(|i| {
            let unit = Twist::from_array(&std::array::from_fn(|j| f64::from(u8::from(i == j))));
            joint_from_target.transform_twist(&unit).to_array()
        })
        .collect();
    let mut out = Mat::zeros(at.a.nrows(), 6);
    for (k, sample) in samples.iter().enumerate() {
        let column = first + 6 * sample.tool;
        for row in ROWS * k..ROWS * (k + 1) {
            for (i, twist) in turned.iter().enumerate() {
                let parts = twist.iter().enumerate();
                out[(row, i)] = parts.map(|(j, x)| x * at.a[(row, column + j)]).sum();
            }
        }
    }
    out
}
