//! Pose accuracy AP and pose repeatability RP of ISO 9283:1998, sections 7.2.1 and 7.2.2, for poses that were measured
//! several times.
//!
//! The command of a cycle is taken to be the pose that the model predicts for its joints, so that AP is the accuracy of the
//! corrected arm. Rotations are rotation vectors about the axes of the base. At the milliradians in question, these are the
//! a, b, c of the standard.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::validation::held_out::HeldOutPose;

/// Cycles that the standard asks for.
pub const STANDARD_CYCLES: usize = 30;

/// One pose that was measured several times. Lengths are in mm, angles in mrad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RepeatedPose {
    /// Index of the pose's first measurement.
    #[serde(skip)]
    pub first: usize,
    /// Number of measurements of the pose.
    pub cycles: usize,
    /// AP_P: distance of the barycentre of the measurements from the commanded position.
    pub position_accuracy_mm: f64,
    /// AP_x, AP_y, AP_z: displacement of the barycentre from the commanded position along the axes of the base.
    pub position_accuracy_axes_mm: [f64; 3],
    /// RP_l: mean distance of the measurements from the barycentre plus three standard deviations of that distance.
    pub position_repeatability_mm: f64,
    /// AP_a, AP_b, AP_c: mean rotations about the axes of the base; absent if only positions were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_accuracy_mrad: Option<[f64; 3]>,
    /// RP_a, RP_b, RP_c: three standard deviations of these rotations; absent if only positions were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_repeatability_mrad: Option<[f64; 3]>,
}

/// Computes accuracy and repeatability of the poses that were measured at least twice, in the order of their first
/// measurement. `repeats` has, for each of `poses`, the number of its distinct pose.
pub fn repeated_poses(poses: &[HeldOutPose], repeats: &[usize]) -> Vec<RepeatedPose> {
    let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, group) in repeats.iter().enumerate() {
        groups.entry(*group).or_default().push(i);
    }
    let mut out: Vec<RepeatedPose> = groups
        .values()
        .filter(|members| members.len() > 1)
        .map(|members| {
            let cycles: Vec<&HeldOutPose> = members.iter().map(|i| &poses[*i]).collect();
            RepeatedPose::new(members[0], &cycles)
        })
        .collect();
    out.sort_by_key(|pose| pose.first);
    out
}

impl RepeatedPose {
    fn new(first: usize, cycles: &[&HeldOutPose]) -> Self {
        let of = |from: usize| -> Vec<[f64; 3]> {
            let of = |pose: &&HeldOutPose| core::array::from_fn(|i| 1e3 * pose.residual[from + i]);
            cycles.iter().map(of).collect()
        };
        let positions = of(0);
        let barycentre = mean(&positions);
        let distances: Vec<f64> = positions
            .iter()
            .map(|p| norm(core::array::from_fn(|i| p[i] - barycentre[i])))
            .collect();
        let (mean_distance, deviation) = mean_and_deviation(&distances);
        let turned = cycles.iter().all(|p| p.error.orientation_mrad.is_some());
        let rotations = turned.then(|| of(3));
        let about = |r: &Vec<[f64; 3]>, i: usize| {
            let angles: Vec<f64> = r.iter().map(|r| r[i]).collect();
            3.0 * mean_and_deviation(&angles).1
        };
        Self {
            first,
            cycles: cycles.len(),
            position_accuracy_mm: norm(barycentre),
            position_accuracy_axes_mm: barycentre,
            position_repeatability_mm: mean_distance + 3.0 * deviation,
            orientation_accuracy_mrad: rotations.as_ref().map(|r| mean(r)),
            orientation_repeatability_mrad: rotations
                .as_ref()
                .map(|r| core::array::from_fn(|i| about(r, i))),
        }
    }
}

fn mean(rows: &[[f64; 3]]) -> [f64; 3] {
    let count = rows.len() as f64;
    core::array::from_fn(|i| rows.iter().map(|r| r[i]).sum::<f64>() / count)
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns the mean and the standard deviation (with n − 1) of at least two values.
fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::noise::InstrumentNoise;
    use crate::numeric::statistics::PoseError;

    /// The formulas of the standard written out, on columns and with sums of squares.
    #[test]
    fn accuracy_and_repeatability_are_those_of_the_standard() {
        let value = |k: usize, i: usize| {
            libm::sin((k * 7 + i * 13) as f64 * 0.731) * 1e-4 + 2e-5 * i as f64
        };
        let poses: Vec<HeldOutPose> = (0..30)
            .map(|k| HeldOutPose {
                error: PoseError {
                    position_mm: 0.0,
                    orientation_mrad: Some(0.0),
                },
                position: [0.0; 3],
                residual: core::array::from_fn(|i| value(k, i)),
                sigma: None,
                noise: InstrumentNoise::UNKNOWN,
            })
            .collect();
        // Every third measurement is of a pose of its own.
        let repeats: Vec<usize> = (0..30)
            .map(|k| if k % 3 == 0 { 100 + k } else { k % 3 })
            .collect();
        let found = repeated_poses(&poses, &repeats);
        assert_eq!(
            found
                .iter()
                .map(|p| (p.first, p.cycles))
                .collect::<Vec<_>>(),
            [(1, 10), (2, 10)]
        );
        for pose in &found {
            let cycles: Vec<usize> = (0..30).filter(|k| repeats[*k] == pose.first).collect();
            let n = cycles.len() as f64;
            let column =
                |i: usize| -> Vec<f64> { cycles.iter().map(|k| 1e3 * value(*k, i)).collect() };
            let bar = |i: usize| column(i).iter().sum::<f64>() / n;
            let (x, y, z) = (bar(0), bar(1), bar(2));
            let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
            near(pose.position_accuracy_mm, (x * x + y * y + z * z).sqrt());
            near(pose.position_accuracy_axes_mm[1], y);
            let l: Vec<f64> = (0..cycles.len())
                .map(|j| {
                    let d = [column(0)[j] - x, column(1)[j] - y, column(2)[j] - z];
                    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
                })
                .collect();
            let (sum, squares) = l.iter().fold((0.0, 0.0), |(s, q), l| (s + l, q + l * l));
            let s_l = ((squares - sum * sum / n) / (n - 1.0)).sqrt();
            near(pose.position_repeatability_mm, sum / n + 3.0 * s_l);
            for i in 3..6 {
                let angles = column(i);
                let (sum, squares) = angles
                    .iter()
                    .fold((0.0, 0.0), |(s, q), a| (s + a, q + a * a));
                near(pose.orientation_accuracy_mrad.unwrap()[i - 3], sum / n);
                let s = ((squares - sum * sum / n) / (n - 1.0)).sqrt();
                near(pose.orientation_repeatability_mrad.unwrap()[i - 3], 3.0 * s);
            }
        }
    }
}
