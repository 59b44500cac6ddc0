//! The paper's correction: a twist from a Gaussian process, bounded and applied to the chain's pose (eq. 9).

use poegp_protocol::blob::TaskSpace;
use poegp_protocol::limits::{MAX_INPUTS, MAX_TASK_SPACE_LANDMARKS, OUTPUTS};

use crate::gp::loops::KernelLoops;
use crate::gp::quadratic_posterior::{
    FOLDED_RADIUS, MAX_FOLDED_WEIGHT, MAX_SCALED_INPUT, MeanHeader, row_words,
};
use crate::gp::quadratic_variance::{QuadraticVariance, landmark_words, mean_rate, variance_words};
use crate::guard::limit::Limit;
use crate::math::scalar::Scalar;
use crate::math::se3::Pose;
use crate::model::MAX_PAYLOAD_KG;
use crate::model::cost::{CorrectionSize, TaskSpaceForm};
use crate::model::load_error::LoadError;
use crate::model::validate::{MAX_COEFFICIENT, checked_limit, checked_rows, is_within};

/// The task-space correction and its bound.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TaskSpaceCorrection<T> {
    header: MeanHeader<T>,
    pub(crate) limit: Limit<T>,
    /// Number of words of the inducing points in the rows; the landmarks of the variance follow them.
    words: usize,
    variance: Option<QuadraticVariance<T>>,
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
            // A folded mean needs unrolled loops for its number of inputs.
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
            words: task.rows.len() / 4,
            variance: variance(task),
        })
    }
}

impl<T: KernelLoops> TaskSpaceCorrection<T> {
    /// Computes the posterior mean at `x` from the rows of the model.
    #[inline(always)]
    pub(crate) fn mean(&self, rows: &[T], x: &[T; MAX_INPUTS]) -> [T; OUTPUTS] {
        let rows = rows.get(..self.words).unwrap_or(&[]);
        self.header.mean(rows, x)
    }

    /// Computes the standard deviation, in m, of one position component of a new measurement of a target at `target`, if the
    /// model has a variance.
    #[inline(always)]
    pub(super) fn position_sigma(
        &self,
        rows: &[T],
        x: &[T; MAX_INPUTS],
        target: &Pose<T>,
    ) -> Option<T> {
        let variance = self.variance.as_ref()?;
        let landmarks = rows.get(self.words..).unwrap_or(&[]);
        let MeanHeader {
            inputs,
            input_scale,
            ..
        } = &self.header;
        let (scale, x) = (input_scale.get(..*inputs)?, x.get(..*inputs)?);
        let unexplained = variance.unexplained(landmarks, scale, x);
        Some(variance.standard_deviation(&target.translation, unexplained))
    }
}

impl<T: Scalar> TaskSpaceCorrection<T> {
    /// Returns the number of inducing points.
    pub(super) fn points(&self) -> usize {
        self.words / row_words(self.header.inputs)
    }

    /// Returns the sizes of the correction, which determine its cost.
    pub(super) fn size(&self) -> CorrectionSize {
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
            points: self.points(),
            form,
            landmarks: self.variance.as_ref().map_or(0, |v| v.landmarks),
        }
    }
}

/// Returns the bytes of the rows of inducing points after checking every word.
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

/// Reads the predictive variance, whose numbers [`checked_landmarks`] checks.
fn variance<T: Scalar>(task: &TaskSpace<'_>) -> Option<QuadraticVariance<T>> {
    let first = task
        .hyperparameters
        .first()
        .filter(|_| task.landmarks > 0)?;
    let mut out = QuadraticVariance {
        root_rate: T::ONE,
        signal: [T::ZERO; OUTPUTS],
        noise: [T::ZERO; OUTPUTS],
        landmarks: usize::from(task.landmarks),
    };
    let outputs = out
        .signal
        .iter_mut()
        .zip(&mut out.noise)
        .zip(&task.output_scale);
    for (c, ((signal, noise), scale)) in outputs.enumerate() {
        let [variance, _, _, _, noise_variance] = task.hyperparameters.get(c).unwrap_or(first);
        let square = T::from_f32(*scale) * T::from_f32(*scale);
        *signal = square * T::from_f32(*variance);
        *noise = square * T::from_f32(*noise_variance);
    }
    if let Some(rates) = &task.rates {
        out.root_rate = mean_rate(&out.signal, &rates.map(T::from_f32)).sqrt();
    }
    Some(out)
}

/// Largest number in the predictive variance: with it, sums of all products stay finite.
const MAX_FACTOR: f32 = 1e6;
/// Largest relative difference between a landmark's stored square and the sum of its squared inputs; both are rounded.
const ROUNDED: f32 = 2e-6;

/// Returns the bytes of the landmarks after checking every number of the variance.
pub(super) fn checked_landmarks<'a>(
    task: &TaskSpace<'a>,
    capacity: usize,
) -> Result<&'a [u8], LoadError> {
    let (landmarks, inputs) = (usize::from(task.landmarks), task.input_scale.len());
    let words = variance_words(inputs, landmarks);
    let rows = task.landmark_rows;
    if landmarks > MAX_TASK_SPACE_LANDMARKS || rows.len() != 4 * words {
        return Err(LoadError::Variance);
    }
    if landmarks > 0 {
        let header = task.hyperparameters.iter().flatten();
        let mut header = header.chain(&task.output_scale);
        let is_sound = header.all(|value| is_within(*value, 0.0, MAX_FACTOR));
        let kernels = if task.rates.is_some() { OUTPUTS } else { 1 };
        if !is_sound || task.hyperparameters.len() != kernels {
            return Err(LoadError::Variance);
        }
    }
    let row_words = landmark_words(inputs);
    let (features, coefficients) = rows
        .split_at_checked(4 * landmarks * row_words)
        .ok_or(LoadError::Variance)?;
    for row in features.chunks_exact(4 * row_words) {
        let mut square = 0.0;
        for (index, word) in row.as_chunks::<4>().0.iter().enumerate() {
            let value = f32::from_le_bytes(*word);
            // A wrong square could put an exponent far above 0.
            let is_good = match index {
                _ if index < inputs => is_within(value.abs(), 0.0, MAX_SCALED_INPUT as f32),
                _ if index == inputs => is_within((value + square).abs(), 0.0, ROUNDED * square),
                _ => value == 0.0,
            };
            if !is_good {
                return Err(LoadError::Variance);
            }
            square += value * value;
        }
    }
    for word in coefficients.as_chunks::<4>().0 {
        if !is_within(f32::from_le_bytes(*word), -MAX_FACTOR, MAX_FACTOR) {
            return Err(LoadError::Variance);
        }
    }
    if words > capacity {
        return Err(LoadError::InducingPointsTooLarge {
            needed: words as u32,
            capacity: capacity as u32,
        });
    }
    Ok(rows)
}
