//! Stub until the branch with the corrected command is merged.
#![allow(missing_docs)]
use super::*;
#[derive(Clone, Copy, Debug)]
pub struct Corrected<T> {
    pub joints: [T; MAX_JOINTS],
    pub position_error: T,
    pub status: Status,
}
impl<T: Scalar, const WORDS: usize> Model<T, WORDS> {
    #[inline(never)]
    pub fn correct(&self, joints: &[T], payload_kg: T) -> Corrected<T> {
        let status = self.evaluate(joints, payload_kg).status;
        let mut out = [T::ZERO; MAX_JOINTS];
        for (slot, value) in out.iter_mut().zip(joints) {
            *slot = *value;
        }
        Corrected {
            joints: out,
            position_error: T::ZERO,
            status,
        }
    }
}
