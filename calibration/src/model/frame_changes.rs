//! By how much a calibration moved the frames of the drawing.

use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::identification::identifiability::wording;
use crate::model::calibration::Calibration;

/// By how much one frame differs from the drawing, as a twist from the left: in the axes of the frame before it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameChange {
    /// The base, a link or a tool, as [`FrameDeviation`](crate::identification::identifiability::FrameDeviation) calls it.
    pub frame: String,
    /// Along the axes, mm.
    pub mm: [f64; 3],
    /// About the axes, mrad.
    pub mrad: [f64; 3],
}

impl FrameChange {
    fn new(frame: String, drawn: &Pose<f64>, calibrated: &Pose<f64>) -> Self {
        let twist = (*calibrated * drawn.inverse()).log();
        Self {
            frame,
            mm: (1e3 * twist.linear).into(),
            mrad: (1e3 * twist.angular).into(),
        }
    }

    /// Whether nothing was changed.
    pub fn is_zero(&self) -> bool {
        self.mm.iter().chain(&self.mrad).all(|x| x.abs() < 1e-9)
    }
}

/// Every frame of a calibration against the drawing with base and tools fitted: base, links, tools.
pub fn changes(calibration: &Calibration) -> Vec<FrameChange> {
    let n = calibration.nominal.kinds().len();
    let tools = calibration.tools.len();
    let (drawn, calibrated) = (
        calibration.nominal.frames(),
        calibration.calibrated.frames(),
    );
    let targets = &calibration.base_and_tools.flange_from_targets;
    let frame = |position: usize, part| {
        // Behind the last joint every tool has a frame of its own; the chain ends at the first.
        let (drawn, calibrated) = if position < n {
            (drawn[position], calibrated[position])
        } else {
            let tool = position - n;
            (
                drawn[n] * targets[0].inverse() * targets[tool],
                calibrated[n] * calibration.tools[tool],
            )
        };
        FrameChange::new(wording::part(part), &drawn, &calibrated)
    };
    crate::identification::identifiability::frames(n, tools, false)
        .into_iter()
        .map(|f| frame(f.position, f.part))
        .collect()
}
