//! What an answer states of itself is true. The tests recompute it with an evaluation at the corrected joints, which does not
//! use the search.

use poegp_protocol::JointKind;
use poegp_protocol::blob::CorrectionLimit;
use poegp_runtime::correct::{CORRECTED_WITHIN, MAX_JOINT_CHANGE};
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_runtime::model::Model;

use crate::arm::{Arm, WORDS};

/// Number of poses for each arm.
const POSES: u32 = 600;

/// Returns an arm whose frames are off by at most `size` metres and radians, with a task-space or an elastic correction.
fn arm(joints: usize, elastic: bool, size: f32) -> Arm {
    let mut arm = match elastic {
        false => Arm::sound(joints, 20),
        true => Arm::elastic(joints, 20, false),
    };
    for (i, frame) in arm.calibrated.iter_mut().enumerate() {
        let off = core::array::from_fn(|c| size * libm::sinf((i * 6 + c) as f32 * 0.7));
        let moved = Pose::exp(&Twist::from_array(&off)) * Pose::from_rows(frame);
        *frame = moved.to_rows();
    }
    arm
}

/// Returns joints within the trained ranges.
fn poses(joints: usize) -> impl Iterator<Item = Vec<f64>> {
    let joint = |index: u32, i: u32| 2.0 * libm::sin(f64::from(index * 17 + i * 5) * 1.3);
    (0..POSES).map(move |index| (0..joints as u32).map(|i| joint(index, i)).collect())
}

/// Returns the distance (m) and angle (rad) between the model's pose at `command` and the nominal pose at `joints`.
fn apart(model: &Model<f64, WORDS>, joints: &[f64], command: &[f64]) -> (f64, f64) {
    let (wanted, found) = (
        model.nominal(joints).unwrap(),
        model.evaluate(command, 2.0).pose,
    );
    let turned = (wanted.inverse() * found).log().angular;
    (
        (wanted.translation - found.translation).norm(),
        turned.norm(),
    )
}

/// Without `PARTLY_CORRECTED`, both position and rotation are reached. Near singularities some poses reach only the position.
#[test]
fn corrected_means_position_and_rotation() {
    let mut rotation_alone_left = 0;
    for joints in 6..=8 {
        for elastic in [false, true] {
            let model = arm(joints, elastic, 1e-3).model::<f64>();
            for q in poses(joints) {
                let found = model.correct(&q, 2.0);
                let (distance, angle) = apart(&model, &q, &found.joints[..joints]);
                if found.status.contains(Status::PARTLY_CORRECTED) {
                    let position_is_there = distance < 0.5 * CORRECTED_WITHIN;
                    rotation_alone_left += u32::from(position_is_there);
                } else {
                    let off = distance.max(angle);
                    assert!(
                        off <= 2.0 * CORRECTED_WITHIN,
                        "{q:?}: {distance:e} m, {angle:e} rad"
                    );
                }
            }
        }
    }
    assert!(rotation_alone_left > 200, "{rotation_alone_left}");
}

/// `applied` equals 1 − |remaining error| / |error before|, where a metre counts as much as a radian, and is not below zero:
/// a position that is corrected may cost a rotation that counts as much.
#[test]
fn what_is_applied_is_what_has_gone() {
    let mut in_part = 0;
    for joints in 6..=8 {
        for elastic in [false, true] {
            let model = arm(joints, elastic, 1e-3).model::<f64>();
            for q in poses(joints) {
                let found = model.correct(&q, 2.0);
                let length = |(distance, angle): (f64, f64)| libm::hypot(distance, angle);
                let before = length(apart(&model, &q, &q));
                let left = length(apart(&model, &q, &found.joints[..joints]));
                let gone = 1.0 - left / before;
                assert!(
                    (found.applied - gone.max(0.0)).abs() <= 0.03,
                    "{q:?}: {} applied, {gone} gone",
                    found.applied
                );
                in_part += u32::from(gone < 0.9);
            }
        }
    }
    assert!(in_part > 500, "{in_part}");
}

/// Moves the axis of a joint `length` metres away from the target and makes the joint revolute. The limited step reaches the
/// limit of a joint only if that joint displaces the target much farther than the others, and only if the arm need not keep a
/// rotation.
fn with_lever(mut arm: Arm, joint: usize, length: f64) -> Arm {
    let shift = |x: f64| Pose::exp(&Twist::from_array(&[x, 0.0, 0.0, 0.0, 0.0, 0.0]));
    arm.joints[joint].kind = JointKind::Revolute;
    let [there, back] = [shift(length), shift(-length)];
    for frames in [&mut arm.nominal, &mut arm.calibrated] {
        for (index, moved) in [(joint, &there), (joint + 1, &back)] {
            let frame = Pose::from_rows(&frames[index].map(f64::from));
            let frame = if index == joint {
                frame * *moved
            } else {
                *moved * frame
            };
            frames[index] = frame.to_rows().map(|x| x as f32);
        }
    }
    arm
}

/// No joint changes by more than the limit, whichever joint would. The arms are off by decimetres.
#[test]
fn no_joint_is_changed_by_more_than_the_limit() {
    for elastic in [false, true] {
        let mut at_the_limit = [0; 8];
        for joints in 5..=8 {
            for size in [0.1, 0.3, 1.0, 2.0] {
                let plain = arm(joints, elastic, size);
                let levers = (0..joints).map(|joint| with_lever(plain.clone(), joint, 10.0));
                for mut arm in levers.chain([plain.clone()]) {
                    let model = arm.model::<f64>();
                    for q in poses(joints) {
                        let found = model.correct(&q, 2.0);
                        let changes = found.joints.iter().zip(&q).map(|(a, b)| (a - b).abs());
                        for (count, change) in at_the_limit.iter_mut().zip(changes) {
                            assert!(change <= MAX_JOINT_CHANGE * (1.0 + 1e-9), "{q:?}: {change}");
                            *count += u32::from(change > 0.999 * MAX_JOINT_CHANGE);
                        }
                    }
                }
            }
        }
        let reached = at_the_limit.iter().filter(|count| **count > 0).count();
        assert!(reached >= 5, "elastic {elastic}: {at_the_limit:?}");
    }
}

/// The limit also holds for a serial joint that two controller joints move.
#[test]
fn no_coupled_joint_is_changed_by_more_than_the_limit() {
    const JOINTS: usize = 5;
    let mut at_the_limit = 0;
    for elastic in [false, true] {
        let mut arm = with_lever(arm(JOINTS, elastic, 1.0), 1, 2.0);
        arm.coupling = vec![0.0; JOINTS * JOINTS];
        for joint in 0..JOINTS {
            arm.coupling[JOINTS * joint + joint] = 1.0;
        }
        // The second serial joint turns with the first controller joint as well.
        arm.coupling[JOINTS] = 1.0;
        let model = arm.model::<f64>();
        for q in poses(JOINTS) {
            let found = model.correct(&q, 2.0);
            let change = (0..2).map(|i| found.joints[i] - q[i]).sum::<f64>().abs();
            assert!(change <= MAX_JOINT_CHANGE * (1.0 + 1e-9), "{q:?}: {change}");
            at_the_limit += u32::from(change > 0.999 * MAX_JOINT_CHANGE);
        }
    }
    assert!(at_the_limit > 20, "{at_the_limit}");
}

/// Where the correction limit acts, the answer is right for the limited model. The evaluation limits the twist of the target,
/// whereas the search limits what the joints do to the target.
#[test]
fn a_bounded_model_is_corrected_as_far_as_its_bound() {
    for joints in 6..=8 {
        for elastic in [false, true] {
            let mut arm = arm(joints, elastic, 1e-3);
            let limit = CorrectionLimit {
                position_m: 1e-4,
                angle_rad: 1e-4,
            };
            match elastic {
                true => arm.joint_space().limit = limit,
                false => arm.task().limit = limit,
            }
            let model = arm.model::<f64>();
            let mut limited = 0;
            for q in poses(joints) {
                let found = model.correct(&q, 2.0);
                if found.status.contains(Status::CORRECTION_LIMITED) {
                    limited += 1;
                    let (distance, angle) = apart(&model, &q, &found.joints[..joints]);
                    let off = (distance - found.position_error).abs();
                    let turned = (angle - found.rotation_error).abs();
                    let within = if found.applied == 1.0 { 1.0 } else { 4.0 };
                    assert!(
                        off.max(turned) <= within * CORRECTED_WITHIN,
                        "{q:?}: {off:e} m, {turned:e} rad"
                    );
                }
            }
            assert!(
                limited >= 10,
                "{joints} joints, elastic {elastic}: {limited}"
            );
        }
    }
}
