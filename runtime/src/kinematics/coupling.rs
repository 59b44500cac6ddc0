//! Joint coupling: the serial joints q_serial = C q from the controller's joints q.
//!
//! In a parallelogram arm, one joint's motor also moves another serial joint: C is the identity except for one element. So C
//! is stored as the nonzero elements of C − I, each of which costs a multiplication; a full matrix costs sixty-four.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::kinematics::poe::{JointTrig, joint_trig};
use crate::math::scalar::Scalar;

/// One value for each joint.
pub type PerJoint<T> = [T; MAX_JOINTS];

/// Largest number of elements of C − I.
const MAX_TERMS: usize = MAX_JOINTS * MAX_JOINTS;

/// The coupling C, stored as C − I without its zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Coupling<T> {
    /// Elements of C − I that are not zero: how much of a controller's joint is added to a serial joint.
    weights: Vec<T, MAX_TERMS>,
    /// Pair of joints of each weight, as one number: [`MAX_JOINTS`] times the serial joint plus the controller's joint.
    pairs: Vec<u8, MAX_TERMS>,
}

impl<T: Scalar> Coupling<T> {
    /// Creates the coupling from the elements of C, row by row, `joints` elements each; leaves out those beyond
    /// [`MAX_JOINTS`].
    pub fn new(joints: usize, elements: impl Iterator<Item = T>) -> Self {
        let (mut weights, mut indices) = (Vec::new(), Vec::new());
        let pairs = (0..joints).flat_map(|serial| (0..joints).map(move |joint| (serial, joint)));
        for ((serial, joint), element) in pairs.zip(elements) {
            let weight = if serial == joint {
                element - T::ONE
            } else {
                element
            };
            if weight != T::ZERO && serial < MAX_JOINTS && joint < MAX_JOINTS {
                // There are never more than fit.
                let _ = weights.push(weight);
                let _ = indices.push((MAX_JOINTS * serial + joint) as u8);
            }
        }
        Self {
            weights,
            pairs: indices,
        }
    }

    /// Returns the elements of C − I that are not zero, row by row: serial joint, controller's joint, element.
    #[inline(always)]
    pub fn terms(&self) -> impl Iterator<Item = (usize, usize, T)> {
        let joints = self.pairs.iter().map(|pair| usize::from(*pair));
        let weights = self.weights.iter();
        joints
            .zip(weights)
            .map(|(pair, weight)| (pair / MAX_JOINTS, pair % MAX_JOINTS, *weight))
    }

    /// Returns the number of serial joints that differ from the controller's joint of the same index.
    pub fn coupled_joints(&self) -> usize {
        let (mut count, mut last) = (0, MAX_JOINTS);
        for (serial, _, _) in self.terms() {
            count += usize::from(serial != last);
            last = serial;
        }
        count
    }

    /// Replaces the sines and cosines of the serial joints in `motions` with those of the controller's joints.
    #[inline(never)]
    pub fn uncouple(&self, kinds: &[JointKind], joints: &PerJoint<T>, motions: &mut JointTrig<T>) {
        let mut last = MAX_JOINTS;
        for (serial, _, _) in self.terms() {
            if serial != last
                && let (Some(slot), Some(kind), Some(value)) = (
                    motions.get_mut(serial),
                    kinds.get(serial),
                    joints.get(serial),
                )
            {
                *slot = joint_trig(*kind, *value);
            }
            last = serial;
        }
    }
}

/// Returns q_serial = C q, or q without a coupling.
#[inline(always)]
pub fn coupled<T: Scalar>(coupling: Option<&Coupling<T>>, joints: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *joints;
    if let Some(coupling) = coupling {
        add_terms(coupling, joints, &mut out);
    }
    out
}

/// Adds (C − I) q to `out`.
#[inline(never)]
fn add_terms<T: Scalar>(coupling: &Coupling<T>, joints: &PerJoint<T>, out: &mut PerJoint<T>) {
    for (serial, joint, weight) in coupling.terms() {
        if let (Some(slot), Some(value)) = (out.get_mut(serial), joints.get(joint)) {
            *slot += weight * *value;
        }
    }
}
