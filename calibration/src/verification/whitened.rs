//! The residuals of a verification with their covariance.

use crate::blob::fitted_frames::{FittedFrames, Registered};
use crate::identification::parametric::state::ROWS;
use crate::measurement::noise::{InstrumentNoise, NoiseScales, QUIETEST};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::verification::arm::BlobArm;
use crate::verification::columns::{Columns, basis, columns};
use crate::verification::hypotheses::{Hypothesis, Masked, base_effect, hypotheses, tool_effect};
use crate::verification::noise::{Factors, Parts};
use crate::verification::payload::payload_effect;
use crate::verification::result::CheckError;
use crate::verification::unchanged::Unchanged;

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
    /// Covariances that an arm which has not changed may have, in units of `factor`, of a model without processes.
    pub(super) unchanged: Option<Unchanged>,
}

impl<'a> Whitened<'a> {
    /// Weighs the residuals; the noise is found beside all hypotheses and beside what moved `during` the check.
    pub(super) fn new(
        placed: &'a Registered<'_>,
        arm: &BlobArm,
        during: Option<&Masked>,
    ) -> Result<Self, CheckError> {
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
        let mut sizes = vec![1.0; arm.state.layout.joints];
        let mut round = 0;
        loop {
            let at = arm.linearise(samples, scales);
            let y = placed.residuals(scales);
            let payload = payload_effect(placed.blob, samples, &placed.frames.tools, scales);
            let all = hypotheses(arm, &at, samples, payload);
            let unknown = arm.unknown_frames(samples, scales);
            let mean = match &unknown {
                Some(frames) => Some(frames.mean(&sizes).ok_or(CheckError::Unsolvable)?),
                None => None,
            };
            let fixed = match &mean {
                Some(mean) => Some(seen(&at.a, mean)),
                None => arm.error_covariance(samples, &at, scales),
            };
            let fixed = fixed.ok_or(CheckError::Unsolvable)?;
            let smooth = match unknown {
                Some(_) => arm.smooth_of_joints(samples, &at),
                None => Vec::new(),
            };
            let stated: Vec<f64> = at.common_share.iter().map(|share| 1.0 - share).collect();
            let parts = Parts {
                fixed: &fixed,
                stated: &stated,
                kind: &kind,
                smooth: &smooth,
            };
            let least = [
                (quietest.position.unwrap_or(QUIETEST.0) / scales.position).powi(2),
                (quietest.orientation.unwrap_or(QUIETEST.1) / scales.orientation).powi(2),
            ];
            let mut effects: Columns = all.iter().flat_map(|h| columns(&h.effect)).collect();
            effects.extend(during.iter().flat_map(|d| columns(&d.effect(&all))));
            let free = basis(&effects, &[]);
            let x = Mat::from_fn(y.nrows(), free.len(), |i, j| free[j][i]);
            let factors = parts.fitted(&y, &x, least).ok_or(CheckError::Unsolvable)?;
            round += 1;
            if round < ROUNDS {
                scales.position *= factors.noise[0].sqrt();
                scales.orientation *= factors.noise[1].sqrt();
                sizes = factors.smooth;
                continue;
            }
            let covariance = parts.covariance(&factors);
            let known = |i: usize| {
                let smooth = smooth.iter().zip(&factors.smooth);
                smooth.fold(fixed[(i, i)], |sum, (s, factor)| sum + factor * s[(i, i)])
            };
            let positions: Vec<usize> = (0..kind.len()).filter(|i| kind[*i] == Some(0)).collect();
            let variance =
                positions.iter().map(|i| known(*i)).sum::<f64>() / positions.len() as f64;
            let factor = Factor::new(covariance, 1).map_err(|_| CheckError::Unsolvable)?;
            let unchanged = match unknown.zip(mean) {
                None => None,
                Some((frames, mean)) => {
                    let sets = frames.drawn(&factors.smooth, &mean, samples.len());
                    let whiten =
                        |k: &Mat<f64>| factor.half_solve(&factor.half_solve(k).transpose());
                    Some(Unchanged {
                        frames: factor.half_solve(&at.a),
                        smooth: smooth.iter().map(whiten).collect(),
                        sets: sets.ok_or(CheckError::Unsolvable)?,
                    })
                }
            };
            return Ok(Self {
                samples,
                scales,
                y,
                base: base_effect(&at),
                tool: tool_effect(arm, &at, samples),
                all,
                factors,
                model_mm: 1e3 * scales.position * variance.max(0.0).sqrt(),
                unchanged,
                absent: kind.iter().filter(|k| k.is_none()).count(),
                factor,
            });
        }
    }

    /// Returns L⁻¹ x.
    pub(super) fn whiten(&self, x: &Mat<f64>) -> Mat<f64> {
        self.factor.half_solve(x)
    }

    /// Returns the effects of what is free in any case: base and tools that were set up again, and what moved `during` the
    /// check, whose columns are the last.
    pub(super) fn nuisance(&self, frames: &FittedFrames, during: Option<&Masked>) -> Mat<f64> {
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
        free.extend(during.iter().flat_map(|d| columns(&d.effect(&self.all))));
        Mat::from_fn(self.y.nrows(), free.len(), |i, j| free[j][i])
    }
}

/// Returns A C Aᵀ.
fn seen(a: &Mat<f64>, c: &Mat<f64>) -> Mat<f64> {
    let out = product(&product(a, c), Transposed(a));
    Mat::from_fn(out.nrows(), out.ncols(), |i, j| {
        0.5 * (out[(i, j)] + out[(j, i)])
    })
}

/// Returns which noise every row has: 0 for position, 1 for rotation; `None` for a rotation that was not measured.
fn kinds(samples: &[InstrumentSample]) -> Vec<Option<usize>> {
    let of = |s: &InstrumentSample| {
        let rotation = s.observation.has_orientation().then_some(1);
        [Some(0), Some(0), Some(0), rotation, rotation, rotation]
    };
    samples.iter().flat_map(of).collect()
}
