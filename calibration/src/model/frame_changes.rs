//! The changes that a calibration made to the frames of the nominal model.

use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::identification::identifiability::wording;
use crate::model::calibration::Calibration;

/// The change of one frame from the nominal model, as a twist that multiplies from the left: in the axes of the preceding
/// frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameChange {
    /// Name of the base, link or tool, as in [`FrameDeviation`](crate::identification::identifiability::FrameDeviation).
    pub frame: String,
    /// Translation along the axes, in mm.
    pub mm: [f64; 3],
    /// Rotation about the axes, in mrad.
    pub mrad: [f64; 3],
}

impl FrameChange {
    fn new(frame: String, nominal: &Pose<f64>, calibrated: &Pose<f64>) -> Self {
        let twist = (*calibrated * nominal.inverse()).log();
        Self {
            frame,
            mm: (1e3 * twist.linear).into(),
            mrad: (1e3 * twist.angular).into(),
        }
    }

    /// Returns whether the frame is unchanged.
    pub fn is_zero(&self) -> bool {
        self.mm.iter().chain(&self.mrad).all(|x| x.abs() < 1e-9)
    }
}

/// Returns the change of every frame of a calibration, compared with the nominal model with base and tools fitted: base,
/// links, tools.
pub fn changes(calibration: &Calibration) -> Vec<FrameChange> {
    let n = calibration.nominal.kinds().len();
    let tools = calibration.tools.len();
    let (nominal, calibrated) = (
        calibration.nominal.frames(),
        calibration.calibrated.frames(),
    );
    let targets = &calibration.base_and_tools.flange_from_targets;
    let frame = |position: usize, role| {
        // After the last joint every tool has its own frame; the chain ends at the first tool.
        let (nominal, calibrated) = if position < n {
            (nominal[position], calibrated[position])
        } else {
            let tool = position - n;
            (
                nominal[n] * targets[0].inverse() * targets[tool],
                calibrated[n] * calibration.tools[tool],
            )
        };
        FrameChange::new(wording::role(role), &nominal, &calibrated)
    };
    crate::identification::identifiability::frames(n, tools, false)
        .into_iter()
        .map(|f| frame(f.position, f.role))
        .collect()
}
