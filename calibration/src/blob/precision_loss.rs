//! The loss of single precision: the poses of a blob compared with those of the f64 model.

use poegp_runtime::guard::status::Status;

use crate::blob::predict::BlobModel;
use crate::measurement::sample::InstrumentSample;
use crate::model::Calibration;

/// Limit on the largest position error of the `f32` blob against the f64 model, in metres.
pub const MAX_F32_ERROR_M: f64 = 2e-6;
/// Limit on the mean of this error, in metres.
pub const MEAN_F32_ERROR_M: f64 = 0.5e-6;

/// Distance of the blob's poses from the f64 model's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SinglePrecisionLoss {
    /// Mean distance, in metres.
    pub mean_m: f64,
    /// Largest distance, in metres.
    pub max_m: f64,
}

impl SinglePrecisionLoss {
    /// Returns the larger of the two errors, each as a share of its limit.
    pub fn worst_share(&self) -> f64 {
        (self.max_m / MAX_F32_ERROR_M).max(self.mean_m / MEAN_F32_ERROR_M)
    }
}

/// Computes the distance of the blob's poses from the f64 model's over the samples whose correction is not limited.
pub fn precision_loss(
    calibration: &Calibration,
    loaded: &BlobModel,
    samples: &[InstrumentSample],
) -> SinglePrecisionLoss {
    let instrument_from_base = calibration.base_and_tools.instrument_from_base;
    let mut count = 0;
    let mut out = SinglePrecisionLoss {
        mean_m: 0.0,
        max_m: 0.0,
    };
    for sample in samples {
        let exact = instrument_from_base * calibration.predict(sample);
        let stored = loaded.predict_tool(&sample.joints, sample.payload_kg, sample.tool);
        if stored.status.contains(Status::CORRECTION_LIMITED) {
            continue;
        }
        let distance = (exact.translation - stored.pose.translation).norm();
        out.mean_m += distance;
        count += 1;
        out.max_m = out.max_m.max(distance);
    }
    out.mean_m /= f64::from(count.max(1));
    out
}
