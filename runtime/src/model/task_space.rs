//! The paper's correction: a twist from a Gaussian process, bounded, applied to the chain (eq. 9).

use poegp_protocol::blob::TaskSpace;
use poegp_protocol::limits::MAX_INPUTS;

use super::checked::{MAX_COEFFICIENT, checked_bound, is_within};
use crate::bound::Bound;
use crate::load_error::LoadError;
use crate::posterior::MeanHeader;
use crate::scalar::Scalar;

/// The task-space correction and its bound.
#[derive(Clone, Copy, Debug)]
pub(super) struct TaskSpaceCorrection<T> {
    pub(super) header: MeanHeader<T>,
    pub(super) bound: Bound<T>,
}

impl<T: Scalar> TaskSpaceCorrection<T> {
    pub(super) fn from_wire(task: &TaskSpace<'_>, inputs: usize) -> Result<Self, LoadError> {
        if task.input_scale.len() != inputs || inputs > MAX_INPUTS {
            return Err(LoadError::Inputs {
                found: task.input_scale.len() as u8,
                expected: inputs as u8,
            });
        }
        let mut header = MeanHeader::zero(inputs);
        for (slot, scale) in header.input_scale.iter_mut().zip(&task.input_scale) {
            if !is_within(*scale, 0.0, f32::MAX) {
                return Err(LoadError::Kernel);
            }
            *slot = T::from_f32(*scale);
        }
        if let Some(rates) = &task.rates {
            // Above 1 an exponent could leave the range of exp2.
            if rates.iter().any(|rate| !is_within(*rate, 0.0, 1.0)) {
                return Err(LoadError::Kernel);
            }
            header.rates = Some(rates.map(T::from_f32));
        }
        for (slots, values) in header.affine.iter_mut().zip(&task.affine) {
            if values.len() != inputs + 1
                || values
                    .iter()
                    .any(|value| !is_within(*value, -MAX_COEFFICIENT, MAX_COEFFICIENT))
            {
                return Err(LoadError::Kernel);
            }
            for (slot, value) in slots.iter_mut().zip(values) {
                *slot = T::from_f32(*value);
            }
        }
        Ok(Self {
            header,
            bound: checked_bound(&task.bound)?,
        })
    }
}
