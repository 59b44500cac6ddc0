//! Every calibration measures what single precision loses, and refuses to write a blob that loses too much.

use nalgebra::Vector3;
use poegp_calibration::blob::write::{DeviceError, ExportError};
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{Calibration, Method, calibrate};
use poegp_calibration::progress::FitContext;
use poegp_runtime::math::se3::Pose;

use crate::{origin, sets};

/// Returns the same arm with the origin of its base `distance` metres away. The poses are the same in `f64`; in `f32` they
/// have the rounding errors of larger numbers.
fn far(calibration: Calibration, distance: f64) -> Calibration {
    let shift = |x: f64| Pose {
        translation: Vector3::new(x, 0.0, 0.0),
        ..Pose::identity()
    };
    let mut out = calibration;
    for chain in [&mut out.nominal, &mut out.calibrated] {
        chain.frames_mut()[0] = shift(distance) * chain.frames()[0];
    }
    let base = &mut out.base_and_tools.instrument_from_base;
    *base = *base * shift(-distance);
    out
}

#[test]
fn a_base_too_far_for_single_precision_is_refused() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(40);
    let origin = origin(vec![ToolName::default()]);
    let context = FitContext::default();
    let stored = |distance: f64| {
        let found = calibrate(&robot, &samples, &Config::new(Method::Poe), &context).unwrap();
        far(found, distance).into_blob(&robot, &samples, &origin, &context)
    };
    let near = stored(0.0).unwrap();
    let moved = stored(1.0).unwrap();
    for (a, b) in near
        .blob
        .errors(&samples)
        .iter()
        .zip(moved.blob.errors(&samples))
    {
        assert!((a.position_mm - b.position_mm).abs() < 4e-3, "{a:?} {b:?}");
    }
    // Half a unit in the last place of 90 m is 3.8 µm.
    match stored(90.0) {
        Err(DeviceError::Export(ExportError::SinglePrecisionLossTooLarge(loss))) => {
            assert!(loss.max_m > 2e-6 || loss.mean_m > 0.5e-6, "{loss:?}");
            assert!(loss.max_m < 50e-6, "{loss:?}");
        }
        other => panic!("{:?}", other.map(|found| found.precision_loss)),
    }
}
