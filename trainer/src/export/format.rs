//! Formats numbers with digits enough for a nanometre, and no more than necessary.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use poegp_calibration::robot::normal_form::roll_pitch_yaw;

/// Formats a number in metres or radians with up to fifteen decimals, without trailing zeros. The last digit is a
/// femtometre, far below what eight joints can add up to a nanometre.
pub fn decimals(x: f64) -> String {
    let text = format!("{x:.15}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "-0" | "" => "0".to_owned(),
        text => text.to_owned(),
    }
}

/// Rounds a number to the digits of [`decimals`].
pub fn rounded(x: f64) -> f64 {
    decimals(x).parse().unwrap_or(x)
}

/// Formats three numbers, separated by `between`.
pub fn three(v: [f64; 3], between: &str) -> String {
    v.map(decimals).join(between)
}

/// Returns x, y, z in metres.
pub fn xyz(pose: &Pose<f64>) -> [f64; 3] {
    let t: &Vector3<f64> = &pose.translation;
    [t[0], t[1], t[2]]
}

/// Returns roll, pitch, yaw in radians, as in a URDF.
pub fn rpy(pose: &Pose<f64>) -> [f64; 3] {
    roll_pitch_yaw(&pose.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use poegp_calibration::robot::normal_form::origin;

    #[test]
    fn numbers_are_short_and_never_minus_zero() {
        assert_eq!(decimals(0.1), "0.1");
        assert_eq!(decimals(-1e-17), "0");
        assert_eq!(decimals(-0.0), "0");
        assert_eq!(decimals(-425.0), "-425");
    }

    /// Around gimbal lock too: the three numbers as they are written give the rotation back.
    #[test]
    fn rotations_come_back_from_roll_pitch_yaw() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let mut worst = 0.0_f64;
        for pitch in [
            0.0,
            0.3,
            quarter,
            quarter - 1e-4,
            quarter - 1e-8,
            quarter - 1e-12,
            2.0,
        ] {
            for sign in [1.0, -1.0] {
                for roll in [0.0, 0.7, -3.1, std::f64::consts::PI] {
                    for yaw in [0.0, -1.2, 3.0] {
                        let pose = origin([0.0; 3], [roll, sign * pitch, yaw]);
                        let again = origin([0.0; 3], rpy(&pose).map(rounded));
                        worst = worst.max((pose.rotation - again.rotation).amax());
                    }
                }
            }
        }
        assert!(worst < 5e-15, "{worst:e}");
    }
}
