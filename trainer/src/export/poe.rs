//! The chain as a table of frames, in the `poe` convention of a robot description.

use crate::export::calibrated_chain::at_zero;
use crate::export::tables::{Row, Table};
use crate::export::{CalibratedChain, gauge};

/// Returns the table of a calibrated chain: for each joint its frame in the one before, and the axis z. The frames are as
/// near to those of the nominal chain as the calibrated axes allow.
pub fn table(chain: &CalibratedChain) -> Table {
    let nominal = at_zero(&chain.nominal_to_flange());
    let calibrated = at_zero(&chain.to_flange());
    let n = chain.joints.len();
    let mut before = None;
    let mut rows = Vec::new();
    for i in 0..n {
        let frame = gauge::nearest_on_axis(&calibrated[i], &nominal[i]);
        rows.push(Row::Frame(
            before.map_or(frame, |b: poegp_runtime::math::se3::Pose<f64>| {
                b.inverse() * frame
            }),
        ));
        before = Some(frame);
    }
    let flange = before.map_or(calibrated[n], |b| b.inverse() * calibrated[n]);
    Table {
        convention: "poe",
        base: None,
        rows,
        flange,
    }
}
