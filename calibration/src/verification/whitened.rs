//! The residuals of a verification with their covariance.

use crate::blob::fitted_frames::{FittedFrames, Registered};
use crate::identification::parametric::state::ROWS;
use crate::measurement::noise::{InstrumentNoise, NoiseScales, QUIETEST};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::verification::arm::BlobArm;
use crate::verification::drift_test::{self, Columns, columns};
use crate::verification::hypotheses::{Hypothesis, base_effect, hypotheses, tool_effect};
use crate::verification::noise::{Factors, Parts};
use crate::verification::payload::payload_effect;
use crate::verification::result::CheckError;

/// Initial noise where none is stated: a tracker's, m and rad.
const FIRST_GUESS: (f64, f64) = (30e-6, 50e-6);
/// Number of rounds that estimate the noise and, with that noise, what the calibration leaves unknown.
const ROUNDS: usize = 3;

/// The residuals with their covariance and the hypotheses.
pub(super) struct Whitened<'a> {
    pub(super) samples: &'a [InstrumentSample],
    /// Units of the rows.
    pub(super) scales: NoiseScales,
    /// Residuals.
    pub(super) y: Mat<f64>,
    /// Hypotheses, with their effects on the rows.
    pub(super) all: Vec<Hypothesis>,
    pub(super) base: Mat<f64>,
    pub(super) tool: Mat<f64>,
    /// Variances of the noise in units of the scales' squares.
    pub(super) factors: Factors,
    /// Root mean square of the calibration's expected error in one position component, mm.
    pub(super) model_mm: f64,
    /// Number of absent rows: orientations of samples that have only a position.
    pub(super) absent: usize,
    pub(super) factor: Factor,
}

impl<'a> Whitened<'a> {
    pub(super) fn new(placed: &'a Registered<'_>, arm: &BlobArm) -> Result<Self, CheckError> {
        let samples = placed.samples;
        let quietest = InstrumentNoise::min_over(samples);
        let mut scales = NoiseScales {
            quietest,
            ..NoiseScales::uniform(
                quietest.position.unwrap_or(FIRST_GUESS.0),
                quietest.orientation.unwrap_or(FIRST_GUESS.1),
            )
        };
        let kind = kinds(samples);
        let mut round = 0;
        loop {
            let at = arm.linearise(samples, scales);
            let y = placed.residuals(scales);
            let payload = payload_effect(placed, scales);
            let all = hypotheses(arm, &at, samples, payload);
            let fixed = arm
                .error_covariance(samples, &at, scales)
                .ok_or(CheckError::Unsolvable)?;
            let smooth = (!arm.knows_its_error).then(|| arm.smooth_covariance(samples, &at));
            let stated: Vec<f64> = at.common_share.iter().map(|share| 1.0 - share).collect();
            let parts = Parts {
                fixed: &fixed,
                stated: &stated,
                kind: &kind,
                smooth: smooth.as_ref(),
            };
            let least = [
                (quietest.position.unwrap_or(QUIETEST.0) / scales.position).powi(2),
                (quietest.orientation.unwrap_or(QUIETEST.1) / scales.orientation).powi(2),
                0.0,
            ];
            let effects: Columns = all.iter().flat_map(|h| columns(&h.effect)).collect();
            let free = drift_test::basis(&effects, &[]);
            let x = Mat::from_fn(y.nrows(), free.len(), |i, j| free[j][i]);
            let factors = parts.fitted(&y, &x, &least).ok_or(CheckError::Unsolvable)?;
            round += 1;
            if round < ROUNDS {
                scales.position *= factors[0].sqrt();
                scales.orientation *= factors[1].sqrt();
                continue;
            }
            let covariance = parts.covariance(&factors);
            let known =
                |i: usize| fixed[(i, i)] + smooth.as_ref().map_or(0.0, |s| factors[2] * s[(i, i)]);
            let positions: Vec<usize> = (0..kind.len()).filter(|i| kind[*i] == Some(0)).collect();
            let variance =
                positions.iter().map(|i| known(*i)).sum::<f64>() / positions.len() as f64;
            return Ok(Self {
                samples,
                scales,
                y,
                base: base_effect(&at),
                tool: tool_effect(arm, &at, samples),
                all,
                factors,
                model_mm: 1e3 * scales.position * variance.max(0.0).sqrt(),
                absent: kind.iter().filter(|k| k.is_none()).count(),
                factor: Factor::new(covariance, 1).map_err(|_| CheckError::Unsolvable)?,
            });
        }
    }

    /// Returns L⁻¹ x.
    pub(super) fn whiten(&self, x: &Mat<f64>) -> Mat<f64> {
        self.factor.half_solve(x)
    }

    /// Returns the effects of what is free in any case: base and tools that were set up again.
    pub(super) fn nuisance(&self, frames: &FittedFrames) -> Mat<f64> {
        let mut free: Columns = Vec::new();
        if frames.is_base_fitted {
            free.extend(columns(&self.base));
        }
        // Each tool was mounted by itself.
        for (tool, is_fitted) in frames.is_tool_fitted.iter().enumerate() {
            if *is_fitted {
                free.extend(columns(&self.tool).into_iter().map(|mut column| {
                    for (k, s) in self.samples.iter().enumerate() {
                        if s.tool != tool {
                            column[ROWS * k..ROWS * (k + 1)].fill(0.0);
                        }
                    }
                    column
                }));
            }
        }
        Mat::from_fn(self.y.nrows(), free.len(), |i, j| free[j][i])
    }
}

/// Returns which noise every row has: 0 for position, 1 for rotation; `None` for a rotation that was not measured.
fn kinds(samples: &[InstrumentSample]) -> Vec<Option<usize>> {
    let of = |s: &InstrumentSample| {
        let rotation = s.observation.has_orientation().then_some(1);
        [Some(0), Some(0), Some(0), rotation, rotation, rotation]
    };
    samples.iter().flat_map(of).collect()
}
