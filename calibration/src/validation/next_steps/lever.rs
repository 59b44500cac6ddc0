//! A target further out, where only positions are measured.
//!
//! A reflector near the axis of the last joint hardly sees that joint, nor how the wrist tilts, and its own position is predicted
//! well all the same. A tool that reaches further is not. What is asked for is the error of a tip that stands [`REACH`] beyond the
//! target, away from the axis of the last joint, where the tool itself is known: a constant position of the tip in the flange
//! counts as no error. The target out there is a mounting of its own, whose position in the flange nobody knows beforehand.

use nalgebra::{Matrix3, Vector3};

use crate::identification::parametric::state::PriorGroup;
use crate::identification::prediction_covariance::PredictionCovariance;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::validation::next_steps::step::{Kind, Step};
use crate::validation::next_steps::task::Task;
use crate::validation::work_volume::POSES;

/// How far beyond the target, m.
const REACH: f64 = 0.2;
/// A target that is nearer to the axis stands on it, m.
const ON_AXIS: f64 = 1e-3;
/// A target that is nearer hardly moves with the last joint, m.
const NEAR: f64 = 0.05;

/// The step; `None` where orientations are measured, or the equations cannot be solved.
pub fn step(task: &Task, covariance: &PredictionCovariance) -> Option<Step> {
    if task.samples.iter().any(|s| s.observation.has_orientation()) {
        return None;
    }
    let knowledge = task.knowledge;
    let [measured, ..] = knowledge.pool.even();
    let poses: Vec<usize> = (0..POSES)
        .chain(measured.iter().map(|k| POSES + k))
        .collect();
    let samples = knowledge.volume.poses.iter().chain(&knowledge.pool.poses);
    let samples: Vec<&InstrumentSample> = samples.collect();
    let chain = &task.calibration.calibrated;
    let joint_from_target = chain.frames().last()?;
    let offset = joint_from_target.translation;
    let across = Vector3::new(offset[0], offset[1], 0.0);
    let lever = across.norm();
    let outward = if lever > ON_AXIS {
        across / lever
    } else {
        Vector3::x()
    };
    // Rotation of the last joint's frame at each pose, and the moves of the tip that its six rows make.
    let turned: Vec<Matrix3<f64>> = poses
        .iter()
        .map(|pose| {
            let target = chain.forward(&samples[*pose].serial_joints);
            target.rotation * joint_from_target.rotation.transpose()
        })
        .collect();
    let mut tip = Mat::zeros(3 * poses.len(), covariance.noise.len());
    for (k, (pose, turned)) in poses.iter().zip(&turned).enumerate() {
        let arm = (turned * outward * REACH).cross_matrix();
        let first = covariance.first[*pose];
        for axis in 0..3 {
            tip[(3 * k + axis, first + axis)] = 1.0;
            for about in 0..3 {
                tip[(3 * k + axis, first + 3 + about)] = -arm[(axis, about)];
            }
        }
    }
    let all = product(&product(&tip, &covariance.covariance), Transposed(&tip));
    let wanted = 3 * POSES;
    let mounted = PriorGroup::BaseAndTools.prior_sd().powi(2);
    let own = Mat::from_fn(all.nrows() - wanted, all.nrows() - wanted, |i, j| {
        let (i, j) = (wanted + i, wanted + j);
        let unknown = (turned[i / 3] * turned[j / 3].transpose())[(i % 3, j % 3)];
        let noise = if i == j {
            covariance.noise[covariance.first[poses[i / 3]] + i % 3]
        } else {
            0.0
        };
        all[(i, j)] + mounted * unknown + noise
    });
    let cross = Mat::from_fn(own.nrows(), wanted, |i, j| all[(wanted + i, j)]);
    let explained = Factor::new(own, 1).ok()?.half_solve(&cross);
    let now = Mat::from_fn(wanted, wanted, |i, j| all[(i, j)]);
    let then = &now - product(Transposed(&explained), &explained);
    let expected = |left: &Mat<f64>| -> Option<f64> {
        let left = with_known_tool(left, &turned)?;
        let of = |pose: usize| {
            std::array::from_fn(|axis| {
                let noise = covariance.noise[covariance.first[pose] + axis];
                (left[(3 * pose + axis, 3 * pose + axis)].max(0.0) + noise).sqrt()
            })
        };
        let deviations: Vec<[f64; 3]> = (0..POSES).map(of).collect();
        Some(knowledge.volume.expected(&deviations).mean_mm)
    };
    let (joints, count) = (task.robot.joints.len(), knowledge.pool.count);
    let why = match lever < NEAR {
        true => format!(", so that the tool and joint {joints} can hardly be distinguished"),
        false => String::new(),
    };
    Some(Step {
        kind: Kind::Target,
        text: format!(
            "Mount the target {REACH} m further out and measure {count} more poses as a session of their own (it is {:.0} mm from \
             the axis of joint {joints}{why}), for tools that reach as far",
            1e3 * lever
        ),
        poses: Some(count),
        range: None,
        before_mm: Some(expected(&now)?),
        after_mm: Some(expected(&then)?),
    })
}

/// The covariance of positions when a constant position of the tip in the flange is taken out: three numbers, by least squares.
fn with_known_tool(covariance: &Mat<f64>, turned: &[Matrix3<f64>]) -> Option<Mat<f64>> {
    let n = covariance.nrows();
    // Rotations stacked: their columns are orthogonal, of this length.
    let length = ((n / 3) as f64).sqrt();
    let constant = Mat::from_fn(n, 3, |i, j| turned[i / 3][(i % 3, j)] / length);
    let without = |m: &Mat<f64>| m - product(&constant, &product(Transposed(&constant), m));
    let half = without(covariance);
    (n > 0).then(|| without(&half.transpose()))
}
