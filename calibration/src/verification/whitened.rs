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
    /// Root mean square of the noise of one position component, mm, with the scatter of the joints.
    pub(super) noise_mm: f64,
    /// Same of one rotation component, mrad.
    pub(super) noise_mrad: f64,
    /// Root mean square of the calibration's expected error in one position component, mm.
    pub(super) model_mm: f64,
    /// Number of absent rows: orientations of samples that have only a position.
    pub(super) absent: usize,
    pub(super) factor: Factor,
    /// Covariances that an arm which has not changed may have, in units of `factor`.
    pub(super) unchanged: Unchanged,
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
        let guess = (scales.position, scales.orientation);
        let kind = kinds(samples);
        let mut sizes = vec![1.0; arm.state.layout.joints];
        let mut round = 0;
        loop {
            let at = arm.linearise(samples, scales);
            let y = placed.residuals(scales);
            let payload = payload_effect(placed.blob, samples, &placed.frames.tools, scales);
            let all = hypotheses(arm, &at, samples, payload);
            let unknown = arm.unknown_frames(samples, scales);
            let posterior = match &unknown {
                Some(frames) => Some(frames.mean(&sizes).ok_or(CheckError::Unsolvable)?),
                None => None,
            };
            let fixed = match &posterior {
                Some(posterior) => Some(seen(&at.a, posterior)),
                None => arm.error_covariance(samples, &at, scales, &sizes),
            };
            let fixed = fixed.ok_or(CheckError::Unsolvable)?;
            let roots = match unknown {
                Some(_) => arm
                    .smooth_of_joints(samples, &at)
                    .ok_or(CheckError::Unsolvable)?,
                None => arm.scatter_of_joints(&at),
            };
            let components: Vec<Mat<f64>> = (roots.iter())
                .map(|root| product(root, Transposed(root)))
                .collect();
            let stated: Vec<f64> = at.common_share.iter().map(|share| 1.0 - share).collect();
            let expected = Factors {
                noise: [
                    (guess.0 / scales.position).powi(2),
                    (guess.1 / scales.orientation).powi(2),
                ],
                components: vec![arm.expected_size(); components.len()],
            };
            let parts = Parts {
                fixed: &fixed,
                stated: &stated,
                kind: &kind,
                components: &components,
                expected: Some(&expected),
            };
            let least = [
                (quietest.position.unwrap_or(QUIETEST.0) / scales.position).powi(2),
                (quietest.orientation.unwrap_or(QUIETEST.1) / scales.orientation).powi(2),
            ];
            let mut effects: Columns = all.iter().flat_map(|h| columns(&h.effect)).collect();
            effects.extend(during.iter().flat_map(|d| columns(&d.effect(&all))));
            let free = basis(&effects, &[]);
            let x = Mat::from_fn(y.nrows(), free.len(), |i, j| free[j][i]);
            let first = Factors {
                noise: [1.0; 2],
                components: sizes.clone(),
            };
            let factors = (parts.fitted(&y, &x, first, least)).ok_or(CheckError::Unsolvable)?;
            round += 1;
            if round < ROUNDS {
                scales.position *= factors.noise[0].sqrt();
                scales.orientation *= factors.noise[1].sqrt();
                sizes = factors.components;
                continue;
            }
            let covariance = parts.covariance(&factors);
            let of_components = |i: usize| -> f64 {
                let each = components.iter().zip(&factors.components);
                each.map(|(component, factor)| factor * component[(i, i)])
                    .sum()
            };
            let mean = |of: &dyn Fn(usize) -> f64, wanted: usize| {
                let rows = || (0..kind.len()).filter(|i| kind[*i] == Some(wanted));
                rows().map(of).sum::<f64>() / rows().count().max(1) as f64
            };
            let model = |i: usize| match arm.has_error_covariance {
                true => fixed[(i, i)],
                false => fixed[(i, i)] + of_components(i),
            };
            let noise = |kind: usize| match arm.has_error_covariance {
                true => factors.noise[kind] + mean(&of_components, kind),
                false => factors.noise[kind],
            };
            let factor = Factor::new(covariance, 1).map_err(|_| CheckError::Unsolvable)?;
            let of_noise = (0..2).filter(|wanted| kind.contains(&Some(*wanted)));
            let (sizes, noise_roots): (Vec<f64>, Vec<Mat<f64>>) = of_noise
                .map(|wanted| (factors.noise[wanted], noise_root(&kind, &stated, wanted)))
                .unzip();
            let unchanged = Unchanged {
                frames: match unknown {
                    Some(_) => factor.half_solve(&at.a),
                    None => Mat::zeros(y.nrows(), 0),
                },
                roots: (noise_roots.iter().chain(&roots))
                    .map(|root| factor.half_solve(root))
                    .collect(),
                sizes: [sizes, factors.components.clone()].concat(),
                unknown: unknown.zip(posterior),
            };
            return Ok(Self {
                samples,
                scales,
                y,
                base: base_effect(&at),
                tool: tool_effect(arm, &at, samples),
                all,
                noise_mm: 1e3 * scales.position * noise(0).sqrt(),
                noise_mrad: 1e3 * scales.orientation * noise(1).sqrt(),
                model_mm: 1e3 * scales.position * mean(&model, 0).max(0.0).sqrt(),
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

/// Returns a root of the covariance of the noise of one kind, of unit size.
fn noise_root(kind: &[Option<usize>], stated: &[f64], wanted: usize) -> Mat<f64> {
    let own: Vec<usize> = (0..kind.len())
        .filter(|i| kind[*i] == Some(wanted))
        .collect();
    let mut out = Mat::zeros(kind.len(), own.len());
    for (j, i) in own.iter().enumerate() {
        out[(*i, j)] = (1.0 - stated[*i]).max(0.0).sqrt();
    }
    out
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
