//! The residuals of a verification with their covariance.

use crate::blob::fitted_frames::{FittedFrames, Registered};
use crate::identification::parametric::state::{Linearised, ROWS};
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
use crate::verification::unknown_frames::UnknownFrames;

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
        let quietest = InstrumentNoise::min_over(placed.samples);
        let mut scales = NoiseScales {
            quietest,
            ..NoiseScales::uniform(
                quietest.position.unwrap_or(FIRST_GUESS.0),
                quietest.orientation.unwrap_or(FIRST_GUESS.1),
            )
        };
        let guess = (scales.position, scales.orientation);
        let mut sizes = vec![arm.expected_size(); arm.state.layout.joints];
        for _ in 1..ROUNDS {
            let round = Round::new(placed, arm, scales, &sizes)?;
            let factors = round.factors(arm.expected_size(), guess, during, sizes)?;
            scales.position *= factors.noise[0].sqrt();
            scales.orientation *= factors.noise[1].sqrt();
            sizes = factors.components;
        }
        let last = Round::new(placed, arm, scales, &sizes)?;
        let factors = last.factors(arm.expected_size(), guess, during, sizes)?;
        last.weighed(placed.samples, arm, &factors)
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

/// The rows in the units of one round, with what their covariance is made of.
struct Round {
    /// Units of the rows.
    scales: NoiseScales,
    at: Linearised,
    /// Residuals.
    y: Mat<f64>,
    /// Hypotheses, with their effects on the rows.
    all: Vec<Hypothesis>,
    /// What a model without processes does not know of its frames, with the mean covariance of the parameters.
    unknown: Option<(UnknownFrames, Mat<f64>)>,
    /// Covariance of what the calibration leaves unknown.
    fixed: Mat<f64>,
    /// Roots of `components`.
    roots: Vec<Mat<f64>>,
    /// Covariances of unit size: of the scatter of each joint, or of smooth deflections.
    components: Vec<Mat<f64>>,
    /// Share of each row's variance that is fixed.
    stated: Vec<f64>,
    /// Noise of each row.
    kind: Vec<Option<usize>>,
}

impl Round {
    /// Computes the rows in units of `scales`; `sizes` are those of the components so far.
    fn new(
        placed: &Registered<'_>,
        arm: &BlobArm,
        scales: NoiseScales,
        sizes: &[f64],
    ) -> Result<Self, CheckError> {
        let samples = placed.samples;
        let at = arm.linearise(samples, scales);
        let payload = payload_effect(placed.blob, samples, &placed.frames.tools, scales);
        let unknown = match arm.unknown_frames(samples, scales) {
            Some(frames) => {
                let posterior = frames.mean(sizes).ok_or(CheckError::Unsolvable)?;
                Some((frames, posterior))
            }
            None => None,
        };
        let fixed = match &unknown {
            Some((_, posterior)) => Some(seen(&at.a, posterior)),
            None => arm.error_covariance(samples, &at, scales, sizes),
        };
        let fixed = fixed.ok_or(CheckError::Unsolvable)?;
        let roots = match unknown {
            Some(_) => arm
                .smooth_of_joints(samples, &at)
                .ok_or(CheckError::Unsolvable)?,
            None => arm.scatter_of_joints(&at),
        };
        let square = |root: &Mat<f64>| match unknown {
            Some(_) => product(root, Transposed(root)),
            None => square_of_poses(root),
        };
        Ok(Self {
            components: roots.iter().map(square).collect(),
            scales,
            y: placed.residuals(scales),
            all: hypotheses(arm, &at, samples, payload),
            unknown,
            fixed,
            roots,
            stated: at.common_share.iter().map(|share| 1.0 - share).collect(),
            kind: kinds(samples),
            at,
        })
    }

    fn parts<'a>(&'a self, expected: Option<&'a Factors>) -> Parts<'a> {
        Parts {
            fixed: &self.fixed,
            stated: &self.stated,
            kind: &self.kind,
            components: &self.components,
            expected,
        }
    }

    /// Finds the factors of noise and components beside all hypotheses and beside what moved `during` the check. Expected are
    /// the noise `guess`, m and rad, and components of `expected_size`; the search begins with the components `sizes`.
    fn factors(
        &self,
        expected_size: f64,
        guess: (f64, f64),
        during: Option<&Masked>,
        sizes: Vec<f64>,
    ) -> Result<Factors, CheckError> {
        let (scales, quietest) = (self.scales, self.scales.quietest);
        let expected = Factors {
            noise: [
                (guess.0 / scales.position).powi(2),
                (guess.1 / scales.orientation).powi(2),
            ],
            components: vec![expected_size; self.components.len()],
        };
        let least = [
            (quietest.position.unwrap_or(QUIETEST.0) / scales.position).powi(2),
            (quietest.orientation.unwrap_or(QUIETEST.1) / scales.orientation).powi(2),
        ];
        let mut effects: Columns = self.all.iter().flat_map(|h| columns(&h.effect)).collect();
        effects.extend(during.iter().flat_map(|d| columns(&d.effect(&self.all))));
        let free = basis(&effects, &[]);
        let x = Mat::from_fn(self.y.nrows(), free.len(), |i, j| free[j][i]);
        let first = Factors {
            noise: [1.0; 2],
            components: sizes,
        };
        let parts = self.parts(Some(&expected));
        (parts.fitted(&self.y, &x, first, least)).ok_or(CheckError::Unsolvable)
    }

    /// Weighs the rows by the covariance with these factors.
    fn weighed<'a>(
        mut self,
        samples: &'a [InstrumentSample],
        arm: &BlobArm,
        factors: &Factors,
    ) -> Result<Whitened<'a>, CheckError> {
        let covariance = self.parts(None).covariance(factors);
        let (kind, fixed, scales) = (&self.kind, &self.fixed, self.scales);
        let of_components = |i: usize| -> f64 {
            let each = self.components.iter().zip(&factors.components);
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
        let (noise_mm, noise_mrad, model_mm) = (
            1e3 * scales.position * noise(0).sqrt(),
            1e3 * scales.orientation * noise(1).sqrt(),
            1e3 * scales.position * mean(&model, 0).max(0.0).sqrt(),
        );
        let factor = Factor::new(covariance, 1).map_err(|_| CheckError::Unsolvable)?;
        let absent = kind.iter().filter(|k| k.is_none()).count();
        Ok(Whitened {
            samples,
            scales,
            base: base_effect(&self.at),
            tool: tool_effect(arm, &self.at, samples),
            noise_mm,
            noise_mrad,
            model_mm,
            absent,
            unchanged: self.unchanged(&factor, factors),
            y: self.y,
            all: self.all,
            factor,
        })
    }

    /// Returns the covariances that an arm which has not changed may have, in units of `factor`.
    fn unchanged(&mut self, factor: &Factor, factors: &Factors) -> Unchanged {
        let of_noise = (0..2).filter(|wanted| self.kind.contains(&Some(*wanted)));
        let (sizes, noise_roots): (Vec<f64>, Vec<Mat<f64>>) = of_noise
            .map(|wanted| {
                let root = noise_root(&self.kind, &self.stated, wanted);
                (factors.noise[wanted], root)
            })
            .unzip();
        Unchanged {
            frames: match &self.unknown {
                Some(_) => factor.half_solve(&self.at.a),
                None => Mat::zeros(self.y.nrows(), 0),
            },
            roots: (noise_roots.iter().chain(&self.roots))
                .map(|root| factor.half_solve(root))
                .collect(),
            sizes: [sizes, factors.components.clone()].concat(),
            unknown: self.unknown.take(),
        }
    }
}

/// Returns B Bᵀ where each pose has a column of its own in B.
fn square_of_poses(root: &Mat<f64>) -> Mat<f64> {
    let mut out = Mat::zeros(root.nrows(), root.nrows());
    for pose in 0..root.ncols() {
        let own = root.view((ROWS * pose, pose), (ROWS, 1));
        let square = own * own.transpose();
        out.view_mut((ROWS * pose, ROWS * pose), (ROWS, ROWS))
            .copy_from(&square);
    }
    out
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
