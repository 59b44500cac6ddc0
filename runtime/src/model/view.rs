//! A model without its capacity, and the functions of the cycle compiled for it here, once for each number type.
//!
//! A generic function is compiled where it is used, for every capacity anew and as that crate is compiled; a firmware
//! that is compiled for size would get slow kernels. These two are compiled in this crate, and always for speed.

use super::correct::Corrected;
use super::{Arm, Evaluation, Stages};

/// A model without its capacity.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, T> {
    pub(super) arm: Option<&'a Arm<T>>,
    pub(super) rows: &'a [T],
}

/// What is compiled here. Sealed together with [`crate::scalar::Scalar`].
pub trait Compiled: Sized {
    /// [`super::Model::evaluate_in_stages`].
    fn evaluate(
        view: View<'_, Self>,
        joints: &[Self],
        payload_kg: Self,
        stages: &mut Stages<Self>,
    ) -> Evaluation<Self>;
    /// [`super::Model::correct`].
    fn correct(view: View<'_, Self>, joints: &[Self], payload_kg: Self) -> Corrected<Self>;
}

macro_rules! compiled {
    ($number:ty) => {
        impl Compiled for $number {
            // Code generation, and with it the time of a cycle, must not depend on the caller.
            #[inline(never)]
            fn evaluate(
                view: View<'_, Self>,
                joints: &[Self],
                payload_kg: Self,
                stages: &mut Stages<Self>,
            ) -> Evaluation<Self> {
                view.evaluate_observed(joints, payload_kg, stages)
            }
            #[inline(never)]
            fn correct(view: View<'_, Self>, joints: &[Self], payload_kg: Self) -> Corrected<Self> {
                view.correct(joints, payload_kg)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);
