//! Whether the errors that no drift explains are those that the model expects of itself.
//!
//! A check finds its noise from the rows, whatever has moved. So links that grew with temperature, a bent link or another
//! instrument's scale are noise to it. But a blob states the standard deviation s_k of a new measurement at every pose. What
//! is left of the positions, r_k, once the drift that was found is removed, is compared with that:
//!
//! ```text
//! χ² = Σ_k |r_k|² / s_k²,   factor = √(χ²/ν),   ν = 3 N − (what was fitted to positions)
//! ```
//!
//! The errors of a model at neighbouring poses are alike: they count as fewer, and those of the training poses, from which the
//! model knows s_k, do too. If either is the only source of errors, its freedom is an `ALIKE`th.

use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::identification::parametric::state::ROWS;
use crate::identification::touch::left_out::as_normal;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::{InstrumentSample, different_poses};
use crate::numeric::matrix::Mat;
use crate::verification::columns::length_of;

/// How many components of a model's own error count as one.
const ALIKE: f64 = 6.0;
/// Factor up to which errors are as expected, however certain a larger one is: what a blob states is true within a third.
pub const AS_EXPECTED: f64 = 1.5;
/// Normal number that is as improbable as the least significant excess: one check in a thousand.
const SIGNIFICANT: f64 = 3.09;

/// Position errors that no drift explains, beside those that the model expects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Unexplained {
    /// Root mean square error of one position component once the drift is removed, mm; each row in units of its own expected
    /// error.
    pub position_mm: f64,
    /// Root mean square of what the model, or the stated noise if it is larger, expects of one position component, mm.
    pub expected_mm: f64,
    /// Part of `expected_mm` that is noise, mm; absent if the model does not separate it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_mm: Option<f64>,
    /// Quotient of both.
    pub factor: f64,
    /// Whether the errors are significantly larger, and more than 1.5 times, than what the model expects.
    pub is_excess: bool,
}

impl Unexplained {
    /// Returns whether the drift that was removed explains the errors down to what the model expects.
    #[must_use]
    pub fn is_as_expected(&self) -> bool {
        self.factor <= AS_EXPECTED
    }

    /// Compares `left`, the rows of `samples` once `fitted` numbers are taken out, with what `blob` expects. Returns `None` if
    /// the blob does not state what it expects.
    pub(super) fn new(
        blob: &BlobModel,
        samples: &[InstrumentSample],
        (left, scales): (&Mat<f64>, NoiseScales),
        fitted: usize,
    ) -> Option<Self> {
        let trained_noise = f64::from(blob.blob().variance.as_ref()?.noise_m2);
        let (mut chi_squared, mut expected, mut of_noise) = (0.0, 0.0, 0.0);
        let mut equations = 0;
        for (k, sample) in samples.iter().enumerate() {
            let predicted = blob.predict(&sample.joints, sample.payload_kg);
            let variance = f64::from(predicted.position_sigma?).powi(2);
            // An arm repeats no better in a check than in training, so a smaller stated noise expects no smaller errors.
            let stated = sample.declared_noise.position.unwrap_or(0.0).powi(2);
            let noise = stated.max(trained_noise);
            let variance = match trained_noise > 0.0 {
                true => (variance - trained_noise).max(0.0) + noise,
                // Noise and error of the model are not separated.
                false => variance.max(stated),
            };
            if variance.is_nan() || variance <= 0.0 {
                return None;
            }
            let own = length_of(left, ROWS * k, scales.of(sample).position);
            chi_squared += own.powi(2) / variance;
            expected += variance / samples.len() as f64;
            of_noise += noise / samples.len() as f64;
            equations += sample.observation.equations();
        }
        let rows = (3 * samples.len()) as f64;
        // Rotations determine their share of what was fitted.
        let taken = fitted as f64 * rows / equations.max(1) as f64;
        let mean = chi_squared / (rows - taken).max(1.0);
        let of_model = (1.0 - of_noise / expected).clamp(0.0, 1.0);
        let poses = different_poses(samples) as f64;
        let freedom =
            |components: f64| (components.max(1.0) / (1.0 - of_model + ALIKE * of_model)).max(1.0);
        let trained = f64::from(blob.host().provenance.training_poses);
        let (own, of_training) = (freedom(3.0 * poses - taken), freedom(3.0 * trained));
        let both = own * of_training / (own + of_training);
        let factor = mean.sqrt();
        let expected_mm = 1e3 * expected.sqrt();
        Some(Self {
            position_mm: factor * expected_mm,
            expected_mm,
            noise_mm: (trained_noise > 0.0).then(|| 1e3 * of_noise.sqrt()),
            factor,
            is_excess: factor > AS_EXPECTED && as_normal(mean, both) > SIGNIFICANT,
        })
    }
}
