//! The paper's correction: a twist from a Gaussian process, limited, applied to the chain (eq. 9).

use poegp_protocol::blob::TaskSpace;
use poegp_protocol::limits::MAX_INPUTS;

use crate::gp::quadratic_posterior::{
    FOLDED_RADIUS, MAX_FOLDED_WEIGHT, MAX_SCALED_INPUT, MeanHeader, row_words,
};
use crate::guard::limit::Limit;
use crate::math::scalar::Scalar;
use crate::model::MAX_PAYLOAD_KG;
use crate::model::cost::{CorrectionSize, TaskSpaceForm};
use crate::model::load_error::LoadError;
use crate::model::validate::{MAX_COEFFICIENT, checked_limit, checked_rows, is_within};

/// The task-space correction and its bound.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TaskSpaceCorrection<T> {
    pub(crate) header: MeanHeader<T>,
    pub(crate) limit: Limit<T>,
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
        if !task.centre.is_empty() {
            // Only what there are loops for.
            if task.centre.len() != inputs
                || task.rates.is_some()
                || !MeanHeader::<T>::folds(inputs)
            {
                return Err(LoadError::Kernel);
            }
            let mut centre = [T::ZERO; MAX_INPUTS];
            for (slot, value) in centre.iter_mut().zip(&task.centre) {
                if !is_within(*value, -MAX_PAYLOAD_KG, MAX_PAYLOAD_KG) {
                    return Err(LoadError::Kernel);
                }
                *slot = T::from_f32(*value);
            }
            header.centre = Some(centre);
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
            limit: checked_limit(&task.limit)?,
        })
    }
}

impl<T: Scalar> TaskSpaceCorrection<T> {
    /// Its sizes with so many words of rows.
    pub(super) fn size(&self, words: usize) -> CorrectionSize {
        let inputs = self.header.inputs;
        let form = if self.header.centre.is_some() {
            TaskSpaceForm::Folded
        } else if self.header.rates.is_none() && MeanHeader::<T>::folds(inputs) {
            TaskSpaceForm::Differences
        } else {
            TaskSpaceForm::PerOutput
        };
        CorrectionSize::TaskSpace {
            inputs,
            points: words / row_words(inputs),
            form,
        }
    }
}

/// The bytes of the rows of inducing points, after every word was looked at.
pub(super) fn checked_inducing_points<'a>(
    task: &TaskSpace<'a>,
    capacity: usize,
) -> Result<&'a [u8], LoadError> {
    let inputs = task.input_scale.len();
    let folded = !task.centre.is_empty();
    let (feature, weight) = if folded {
        (FOLDED_RADIUS as f32, MAX_FOLDED_WEIGHT as f32)
    } else {
        (MAX_SCALED_INPUT as f32, MAX_COEFFICIENT)
    };
    let limit = |index: usize| if index < inputs { feature } else { weight };
    let rows = checked_rows(task.rows, row_words(inputs), limit, capacity)?;
    if folded {
        for row in rows.chunks_exact(4 * row_words(inputs)) {
            let mut squared = 0.0;
            for word in row.as_chunks::<4>().0.iter().take(inputs) {
                let value = f32::from_le_bytes(*word);
                squared += value * value;
            }
            if squared > (FOLDED_RADIUS * FOLDED_RADIUS) as f32 {
                return Err(LoadError::Row);
            }
        }
    }
    Ok(rows)
}
