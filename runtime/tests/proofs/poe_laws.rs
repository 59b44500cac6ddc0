//! Chains of one to eight revolute and prismatic joints: the product formula, and Jacobians against finite differences.

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::{Poe, WrongChain};
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Pose, Twist, residual};
use proptest::prelude::*;

use crate::seeded::{chains, config, distance, poe, twist};

/// Returns Π e^p̂_i e^ŝ_i q_i · e^p̂_n+1 as the paper writes it (eq. 3), with general exponentials.
fn literal<T: Scalar>(kinds: &[JointKind], frames: &[[f64; 6]], q: &[T]) -> Pose<T> {
    let mut pose = Pose::identity();
    for (index, kind) in kinds.iter().enumerate() {
        let mut joint = Twist::zero();
        match kind {
            JointKind::Revolute => joint.angular[2] = q[index],
            JointKind::Prismatic => joint.linear[2] = q[index],
        }
        pose = pose * Pose::exp(&twist(&frames[index])) * Pose::exp(&joint);
    }
    pose * Pose::exp(&twist(&frames[kinds.len()]))
}

fn forward_is_the_formula<T: Scalar>(
    kinds: &[JointKind],
    frames: &[[f64; 6]],
    q: &[f64],
    tolerance: f64,
) -> Result<(), TestCaseError> {
    let q: Vec<T> = q.iter().map(|value| T::from_f64(*value)).collect();
    let chain = poe::<T>(kinds, frames);
    let pose = chain.forward(&q);
    let error = distance(&pose.to_rows(), &literal(kinds, frames, &q).to_rows());
    prop_assert!(error <= tolerance, "{:e}", error);
    // Every way to compute f(q) gives the same bits.
    prop_assert_eq!(chain.forward_with(&chain.motions(&q)), pose);
    prop_assert_eq!(chain.joint_frames(&q).1, pose);
    prop_assert_eq!(chain.space_jacobian(&q).1, pose);
    let other = chain.identification_jacobian(&q).1;
    prop_assert!(distance(&other.to_rows(), &pose.to_rows()) <= tolerance);
    Ok(())
}

proptest! {
    #![proptest_config(config(21, 1_000))]

    #[test]
    fn forward((kinds, frames, q) in chains()) {
        forward_is_the_formula::<f64>(&kinds, &frames, &q, 2e-13)?;
        forward_is_the_formula::<f32>(&kinds, &frames, &q, 1e-4)?;
    }

    #[test]
    fn f32_is_near_f64((kinds, frames, q) in chains()) {
        let single: Vec<f32> = q.iter().map(|value| *value as f32).collect();
        let double: Vec<f64> = single.iter().map(|value| f64::from(*value)).collect();
        let chain = poe::<f64>(&kinds, &frames).cast::<f32>();
        let reference = chain.cast::<f64>().forward(&double);
        let error = distance(&chain.forward(&single).cast::<f64>().to_rows(), &reference.to_rows());
        // Nine frames of up to 5 m: 50 m at 2⁻²⁴, accumulated.
        prop_assert!(error <= 5e-5, "{:e}", error);
    }

    #[test]
    fn space_jacobian_against_differences((kinds, frames, q) in chains()) {
        let (chain, step) = (poe::<f64>(&kinds, &frames), 1e-5);
        let (columns, target) = chain.space_jacobian(&q);
        for index in 0..q.len() {
            let at = |by: f64| {
                let mut moved = q.clone();
                moved[index] += by;
                residual(&chain.forward(&moved), &target).to_array()
            };
            let (ahead, behind) = (at(step), at(-step));
            let difference: [f64; 6] =
                core::array::from_fn(|row| (ahead[row] - behind[row]) / (2.0 * step));
            let error = distance(&difference, &columns[index].to_array());
            prop_assert!(error < 1e-7, "joint {}: {:e}", index, error);
        }
        prop_assert!(columns[q.len()..].iter().all(|column| *column == Twist::zero()));
    }

    #[test]
    fn identification_jacobian_against_differences((kinds, frames, q) in chains()) {
        let (chain, step) = (poe::<f64>(&kinds, &frames), 1e-5);
        let (blocks, target) = chain.identification_jacobian(&q);
        for (frame, block) in blocks.iter().enumerate().take(kinds.len() + 1) {
            for column in 0..6 {
                let at = |by: f64| {
                    let mut delta = [0.0; 6];
                    delta[column] = by;
                    let mut moved = chain;
                    let slot = &mut moved.frames_mut()[frame];
                    *slot = Pose::exp(&Twist::from_array(&delta)) * *slot;
                    residual(&moved.forward(&q), &target).to_array()
                };
                let (ahead, behind) = (at(step), at(-step));
                let difference: [f64; 6] =
                    core::array::from_fn(|row| (ahead[row] - behind[row]) / (2.0 * step));
                let expected = block.map(|row| row[column]);
                let error = distance(&difference, &expected);
                prop_assert!(error < 1e-7, "frame {} column {}: {:e}", frame, column, error);
            }
        }
    }
}

#[test]
fn chains_of_wrong_size_are_refused_with_their_numbers() {
    let (kinds, frames) = ([JointKind::Revolute; 9], [Pose::<f32>::identity(); 11]);
    for joints in 0..=9 {
        for count in 0..=11 {
            let chain = Poe::new(&kinds[..joints], &frames[..count]);
            if (1..=8).contains(&joints) && count == joints + 1 {
                let chain = chain.unwrap();
                assert_eq!(chain.kinds().len(), joints);
                assert_eq!(chain.frames().len(), count);
            } else {
                let wrong = WrongChain {
                    joints,
                    frames: count,
                };
                assert_eq!(chain.unwrap_err(), wrong);
            }
        }
    }
}
