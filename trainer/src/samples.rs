//! From a measurement file to what a fit needs: joints through the coupling, and one complete pose a row.

use crate::calibration::frames::Sample;
use crate::error::InputError;
use crate::measurements::MeasurementSet;
use crate::robot::Robot;

/// The rows of `set` as samples of `robot`, in order; poses are `instrument_from_target`.
///
/// # Errors
/// [`InputError`] when the file does not fit the robot, or has sessions or no orientation, which the methods of the
/// paper do not cover.
pub fn samples(set: &MeasurementSet, robot: &Robot) -> Result<Vec<Sample>, InputError> {
    if set.has_sessions() {
        let mut sessions: Vec<_> = set
            .measurements
            .iter()
            .map(|m| m.session.as_deref())
            .collect();
        sessions.sort_unstable();
        sessions.dedup();
        if sessions.len() > 1 {
            return Err(InputError::new(
                &set.path,
                format!("{} sessions, each with a target mounted anew", sessions.len()),
                "measurements of one session: base and tool are each one unknown frame",
            )
            .with_help("calibrate one session at a time: keep the rows of one value of the `session` column"));
        }
    }
    let serial = |joints: &[f64]| match &robot.coupling {
        None => joints.to_vec(),
        Some(rows) => rows
            .iter()
            .map(|row| poegp_runtime::kernel::inner_product(row, joints))
            .collect(),
    };
    set.measurements
        .iter()
        .map(|m| {
            let measured = m.instrument_from_target().ok_or_else(|| {
                InputError::new(&set.path, "positions without orientations", "the columns qw, qx, qy, qz")
                    .with_help("the methods of the paper compare whole poses; measure three targets or a 6-D probe")
            })?;
            Ok(Sample {
                serial: serial(&m.joints),
                joints: m.joints.clone(),
                payload_kg: m.payload_kg,
                measured,
                tool: 0,
                position_only: false,
            })
        })
        .collect()
}
