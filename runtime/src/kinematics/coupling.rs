//! Joint coupling: the serial joints q_serial = C q of the controller's joints q.

use poegp_protocol::limits::MAX_JOINTS;

use crate::math::scalar::Scalar;

/// One value for each joint.
pub type PerJoint<T> = [T; MAX_JOINTS];

/// n×n in the upper left corner, the rest zero.
pub type CouplingMatrix<T> = [[T; MAX_JOINTS]; MAX_JOINTS];

/// One row of C q. A function of its own, in slices of which the compiler does not know the length: unrolled for all rows it
/// is 800 bytes.
#[inline(never)]
fn row_product<T: Scalar>(row: &[T], joints: &[T]) -> T {
    crate::math::vector::inner_product(core::hint::black_box(row), joints)
}

/// q_serial = C q; the identity without a matrix.
#[inline(always)]
pub fn coupled<T: Scalar>(
    coupling: Option<&CouplingMatrix<T>>,
    joints: &PerJoint<T>,
) -> PerJoint<T> {
    match coupling {
        None => *joints,
        Some(coupling) => {
            let mut out = [T::ZERO; MAX_JOINTS];
            for (slot, row) in out.iter_mut().zip(coupling) {
                *slot = row_product(row, joints);
            }
            out
        }
    }
}
