//! Correction and output of one row of joint targets.

use std::fmt::Write;

use poegp_protocol::link::Query;
use poegp_runtime::correct::Corrected;
use poegp_runtime::math::se3::Pose;

use poegp_calibration::blob::commander::pose_distance;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::measurement::JointColumn;
use poegp_calibration::measurement::joint_targets::{NewFields, Target};
use poegp_calibration::numeric::decimal::push_decimal;

/// A command with its corrected answer.
pub struct Row {
    pub line: usize,
    pub query: Query,
    pub answer: Corrected<f32>,
    /// Distance in m and rotation in rad between the uncorrected arm and the target.
    pub shift: [f32; 2],
    pub trust: f32,
}

impl Row {
    /// Whether the correction changes the command of a joint.
    pub fn is_changed(&self, joint: usize) -> bool {
        self.answer.joints[joint].to_bits() != self.query.joints[joint].to_bits()
    }
}

/// The new fields of a row. A joint that the correction does not change keeps its text.
pub struct Fields<'a>(pub Row, pub &'a [JointColumn]);

impl NewFields for Fields<'_> {
    fn joint(&self, joint: usize, out: &mut String) -> bool {
        let Self(row, columns) = self;
        let is_changed = row.is_changed(joint);
        if is_changed {
            let value = columns[joint]
                .unit
                .from_si(f64::from(row.answer.joints[joint]));
            push_decimal(out, value, 10);
        }
        is_changed
    }

    fn added(&self, out: &mut String) {
        let Self(row, _) = self;
        let answer = &row.answer;
        push_decimal(out, f64::from(1e6 * answer.position_error), 3);
        out.push(',');
        push_decimal(out, f64::from(1e6 * answer.rotation_error), 3);
        out.push(',');
        push_decimal(out, f64::from(answer.applied), 4);
        out.push(',');
        // Cannot fail: the output is a string.
        let _ = write!(out, "{}", answer.status);
        out.push(',');
        push_decimal(out, f64::from(row.trust), 6);
    }
}

/// Corrects one command with the runtime, as the device does. `payload_kg` is the payload if the row has none.
pub fn correct(loaded: &BlobModel, target: &Target<'_>, payload_kg: f64) -> Row {
    let query = Query {
        // The robot of the blob has at most as many joints as the protocol.
        joints: target.joints.iter().map(|q| *q as f32).collect(),
        payload_kg: target.payload_kg.unwrap_or(payload_kg) as f32,
    };
    let model = loaded.model();
    let answer = model.correct(&query.joints, query.payload_kg);
    let now = model.evaluate(&query.joints, query.payload_kg);
    let apart = |target: Pose<f32>| {
        let (distance, angle) = pose_distance(&target.cast(), &now.pose.cast());
        [distance as f32, angle as f32]
    };
    Row {
        line: target.line,
        answer,
        shift: model.nominal(&query.joints).map_or([0.0; 2], apart),
        trust: now.trust,
        query,
    }
}
