//! The step of mounting the target further out, if only positions are measured.
//!
//! A reflector near the axis of the last joint hardly sees that joint or the tilt of the wrist, although its own position is
//! predicted well. The position of a tool that reaches further is not. The error in question is that of a tip that stands
//! [`REACH`] beyond the target, away from the axis of the last joint, and whose tool is known: a constant position of the
//! tip in the flange frame counts as no error. The target further out is a mounting of its own, whose position in the flange
//! frame nobody knows beforehand.

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

/// Distance of the tip beyond the target, m.
const REACH: f64 = 0.2;
/// Distance from the axis below which a target counts as standing on the axis, m.
const ON_AXIS: f64 = 1e-3;
/// Distance from the axis below which a target hardly moves with the last joint, m.
const NEAR: f64 = 0.05;

/// Returns the step; `None` if orientations are measured or the equations cannot be solved.
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
    // Rotation of the last joint's frame at each pose, and the moves of the tip that the six rows of each pose give.
    let turned: Vec<Matrix3<f64>> = poses
        .iter()
        .map(|pose| {
            let target = chain.forward(&samples[*pose].serial_joints);
            target.rotation * joint_from_target.rotation.transpose()
        })
        .collect();
    let tools: Vec<usize> = poses.iter().map(|pose| samples[*pose].tool).collect();
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
        let left = with_known_tools(left, &turned, &tools)?;
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

/// Removes a constant position of each tool's tip in the flange frame (three numbers, by least squares) from the covariance
/// of positions. Positions alone do not show how a target is turned, and each of several is turned in its own way.
fn with_known_tools(
    covariance: &Mat<f64>,
    turned: &[Matrix3<f64>],
    tools: &[usize],
) -> Option<Mat<f64>> {
    let n = covariance.nrows();
    let own = &tools[..n / 3];
    let count = own.iter().max()? + 1;
    // Stacked rotations: the columns of a tool are orthogonal and have this length.
    let length = |tool: usize| (own.iter().filter(|of| **of == tool).count() as f64).sqrt();
    let constant = Mat::from_fn(n, 3 * count, |i, j| match own[i / 3] == j / 3 {
        true => turned[i / 3][(i % 3, j % 3)] / length(j / 3),
        false => 0.0,
    });
    let without = |m: &Mat<f64>| m - product(&constant, &product(Transposed(&constant), m));
    let half = without(covariance);
    Some(without(&half.transpose()))
}
