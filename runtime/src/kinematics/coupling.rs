//! Joint coupling: the serial joints q_serial = C q of the controller's joints q.
//!
//! A parallelogram moves one serial joint with another joint's motor: C is the identity but for one element. So C is kept as
//! what it has beside the identity, and each such element costs a multiplication where a full matrix costs sixty-four.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::kinematics::poe::{JointTrig, joint_trig};
use crate::math::scalar::Scalar;

/// One value for each joint.
pub type PerJoint<T> = [T; MAX_JOINTS];

/// An element of C − I that is not zero: so much of a controller's joint is added to a serial joint.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Term<T> {
    serial: u8,
    joint: u8,
    weight: T,
}

/// C as C − I, without its zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Coupling<T> {
    terms: Vec<Term<T>, { MAX_JOINTS * MAX_JOINTS }>,
}

impl<T: Scalar> Coupling<T> {
    /// From the elements of C, row by row, each of `joints` elements; those beyond [`MAX_JOINTS`] are left out.
    pub fn new(joints: usize, elements: impl Iterator<Item = T>) -> Self {
        let mut terms = Vec::new();
        let places = (0..joints).flat_map(|serial| (0..joints).map(move |joint| (serial, joint)));
        for ((serial, joint), element) in places.zip(elements) {
            let weight = if serial == joint {
                element - T::ONE
            } else {
                element
            };
            if weight != T::ZERO && serial < MAX_JOINTS && joint < MAX_JOINTS {
                let (serial, joint) = (serial as u8, joint as u8);
                // There are never more than fit.
                let _ = terms.push(Term {
                    serial,
                    joint,
                    weight,
                });
            }
        }
        Self { terms }
    }

    /// The elements of C − I that are not zero, row by row: serial joint, controller's joint, element.
    #[inline(always)]
    pub fn terms(&self) -> impl Iterator<Item = (usize, usize, T)> {
        let place = |term: &Term<T>| (term.serial.into(), term.joint.into(), term.weight);
        self.terms.iter().map(place)
    }

    /// Sines and cosines of the controller's joints, written to `motions`, which holds those of the serial joints.
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

/// q_serial = C q; the identity without a coupling.
#[inline(always)]
pub fn coupled<T: Scalar>(coupling: Option<&Coupling<T>>, joints: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *joints;
    if let Some(coupling) = coupling {
        add_terms(coupling, joints, &mut out);
    }
    out
}

/// (C − I) q, added to `out`.
#[inline(never)]
fn add_terms<T: Scalar>(coupling: &Coupling<T>, joints: &PerJoint<T>, out: &mut PerJoint<T>) {
    for (serial, joint, weight) in coupling.terms() {
        if let (Some(slot), Some(value)) = (out.get_mut(serial), joints.get(joint)) {
            *slot += weight * *value;
        }
    }
}
