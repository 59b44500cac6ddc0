//! The minimal form of a chain has the same poses and axes, and applying it again changes nothing.

use poegp_runtime::kinematics::minimal_chain::{JointFrames, MinimalChain, MinimalForm};
use poegp_runtime::kinematics::poe::{Poe, zero_joint_trig};
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::Pose;
use proptest::prelude::*;

use crate::seeded::{chains, config, distance, poe};

fn walk<T: Scalar>(poe: &Poe<T>, q: &[T]) -> (JointFrames<T>, Pose<T>) {
    let chain = MinimalChain::new(&MinimalForm::new(poe));
    let mut motions = zero_joint_trig();
    chain.joint_trig_into(q, &mut motions);
    let mut frames = JointFrames::new();
    let target = chain.moved_frames_at(&motions, &mut frames);
    // Both ways to compute f(q) give the same bits.
    assert_eq!(chain.forward_at(&motions), target);
    (frames, target)
}

fn is_the_same_chain(poe: &Poe<f64>, q: &[f64], tolerance: f64) -> Result<(), TestCaseError> {
    let (moved, target) = walk(poe, q);
    let (frames, expected) = poe.joint_frames(q);
    let error = distance(&target.to_rows(), &expected.to_rows());
    prop_assert!(error <= tolerance, "{error:e}");
    prop_assert_eq!(moved.len(), q.len());
    for (after, before) in moved.iter().zip(&frames) {
        // The axes are the same lines with the same directions.
        let (z, old) = (after.rotation.column(2), before.rotation.column(2));
        prop_assert!((z - old).norm() <= tolerance);
        let across = (after.translation - before.translation).cross(&z);
        prop_assert!(across.norm() <= tolerance, "{:e}", across.norm());
    }
    Ok(())
}

proptest! {
    #![proptest_config(config(91, 400))]

    #[test]
    fn minimal_form_is_the_same_chain((kinds, frames, q) in chains()) {
        is_the_same_chain(&poe(&kinds, &frames), &q, 1e-12)?;
    }

    /// Parallel axes, and axes that are nearly parallel.
    #[test]
    fn parallel_axes_are_nothing_special(
        (kinds, mut frames, q) in chains(),
        tilt in prop_oneof![Just(0.0), 1e-12..1e-3_f64],
    ) {
        let inner = frames.len() - 1;
        for frame in &mut frames[1..inner] {
            (frame[3], frame[4], frame[5]) = (tilt, -0.5 * tilt, 0.0);
        }
        is_the_same_chain(&poe(&kinds, &frames), &q, 1e-12)?;
    }

    /// A stored minimal form is the one that the device computes with.
    #[test]
    fn minimal_form_stays_as_it_is((kinds, frames, _) in chains()) {
        let stored = MinimalForm::new(&poe::<f64>(&kinds, &frames)).poe.cast::<f32>();
        let again = MinimalForm::new(&stored);
        for (one, other) in stored.frames().iter().zip(again.poe.frames()) {
            prop_assert_eq!(one, other);
        }
        for joint in 0..kinds.len() {
            prop_assert_eq!(again.turn_of(joint), [0.0, 1.0]);
        }
    }
}
