//! Fits the geometry with priors around the nominal model, gravity and two harmonics of each joint. The residuals of good
//! data are then noise, so that the residuals of wrong data show the cause.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::identification::alignment::Alignment;
use crate::identification::base_tools::with_base_and_tool;
use crate::identification::parametric::gear_line::GearLine;
use crate::identification::parametric::state::{
    Layout, Linearised, ParametricModel, ROWS, prior_variance,
};
use crate::measurement::folds::first_of_poses;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::{BaseSample, in_base_frame};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::median;
use crate::trust::readings::Data;

/// Largest number of determined parameters per position equation: with more, the residuals no longer show the noise.
const FREE: f64 = 0.6;
/// Factor by which residuals may be larger if gravity or gear errors are not modelled.
const LENIENT: f64 = 2.0;
/// Cosine above which axes count as parallel.
const PARALLEL: f64 = 0.999_999;
/// Largest number of iterations of the fit.
const ROUNDS: usize = 25;
/// Largest step, in units of the priors' standard deviations, at which the fit has converged.
const SETTLED: f64 = 0.02;
/// Residual of a row, in standard deviations, above which its weight decreases.
const BEND: f64 = 3.0;
/// Lower bound on the scale of one residual component, in m and rad, so that exact data do not cause a division by zero.
const LEAST_SCALE: f64 = 2e-7;

/// How far the frames may be from the nominal model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Priors {
    /// Deviations of manufactured arms: 2 mm and 2 mrad.
    Made,
    /// Deviations by mastering errors and variants of an arm: 30 mm and 30 mrad.
    Wide,
}

/// A fitted geometry.
#[derive(Clone)]
pub struct Geometry {
    /// The fitted model.
    pub state: ParametricModel,
    /// Samples in the base frame, in chronological order.
    pub samples: Vec<BaseSample>,
    /// Indices of the first sample of every pose. Only these give the scales: many repeats of few poses have small residuals,
    /// beside which good rows of other poses would be outliers.
    first_of_poses: Vec<usize>,
    /// Robust standard deviations of one component.
    pub scales: NoiseScales,
    /// The model linearised at its optimum, with rows in units of their scales.
    pub linear: Linearised,
    /// Residuals in units of their scales.
    pub residuals: Vec<[f64; ROWS]>,
    /// Weights of the rows, 0 to 1.
    pub weights: Vec<f64>,
    /// Standard deviations of the parameters' priors.
    pub sd: Vec<f64>,
    /// Covariance of the parameters: the inverse of AᵀWA + Λ⁻¹, with the prior covariance Λ.
    pub covariance: Mat<f64>,
    /// The next Gauss–Newton step. Progress along a curved valley is slow, so hypotheses are compared with the point at
    /// which the step ends.
    pub next_step: Mat<f64>,
    /// Number of parameters that the data determine: the trace of the hat matrix.
    pub determined: f64,
    /// Median position residual, in m.
    pub position: f64,
    /// Median rotation residual, in rad.
    pub rotation: f64,
    /// Distance of each frame of the arm from the nominal model, in m and rad.
    pub frames_off: Vec<(f64, f64)>,
}

impl Geometry {
    /// Fits the samples of `data`, starting from `alignment`. Gravity and harmonics are included if there are enough rows,
    /// so that the residuals show the noise. `None` if the equations cannot be solved.
    pub fn fit(
        data: &Data<'_>,
        alignment: &Alignment,
        priors: Priors,
        gravity: Vector3<f64>,
    ) -> Option<Self> {
        let mut fits = Self::fits(data, alignment, priors, gravity);
        fits.find(|fit| fit.as_ref().is_none_or(|fit| !fit.is_too_free()))?
    }

    /// Returns fits with fewer and fewer terms: gravity and harmonics, gravity alone, neither.
    pub fn fits(
        data: &Data<'_>,
        alignment: &Alignment,
        priors: Priors,
        gravity: Vector3<f64>,
    ) -> impl Iterator<Item = Option<Self>> {
        [(true, true), (true, false), (false, false)]
            .into_iter()
            .map(move |terms| Self::fit_terms(data, alignment, priors, gravity, terms))
    }

    /// Returns whether the parameters follow the noise, so that the residuals no longer show it.
    pub fn is_too_free(&self) -> bool {
        self.determined > FREE * (3 * self.samples.len()) as f64
    }

    /// Returns the same geometry with the scales and weights of other residuals, which are given in units of its scales:
    /// those that a change would leave. `None` if the equations cannot be solved.
    pub fn rescaled(&self, left: &[[f64; ROWS]]) -> Option<Self> {
        let of = |scales: NoiseScales, i: usize| match i {
            0..3 => scales.position,
            _ => scales.orientation,
        };
        let plain: Vec<[f64; ROWS]> = left
            .iter()
            .map(|r| std::array::from_fn(|i| of(self.scales, i) * r[i]))
            .collect();
        let scales = scales_of(&plain, &self.samples, &self.first_of_poses);
        let factor = |i: usize| of(self.scales, i) / of(scales, i);
        let in_units = |rows: &[[f64; ROWS]]| -> Vec<[f64; ROWS]> {
            let row = |r: &[f64; ROWS]| std::array::from_fn(|i| factor(i) * r[i]);
            rows.iter().map(row).collect()
        };
        let mut out = self.clone();
        out.scales = scales;
        out.residuals = in_units(&self.residuals);
        out.weights = row_weights(&in_units(left), &self.samples);
        for matrix in [
            &mut out.linear.a,
            &mut out.linear.y,
            &mut out.linear.jacobian,
        ] {
            for (row, mut values) in matrix.row_iter_mut().enumerate() {
                values *= factor(row % ROWS);
            }
        }
        out.solve()?;
        Some(out)
    }

    /// Computes the covariance, the next step and the number of determined parameters.
    pub fn solve(&mut self) -> Option<()> {
        let (sd, linear) = (&self.sd, &self.linear);
        let factor = Factor::new(normal(linear, &self.weights, sd), 1).ok()?;
        let identity = Mat::from_fn(sd.len(), sd.len(), |i, j| {
            f64::from(u8::from(i == j)) * sd[i]
        });
        let half = factor.solve(&identity);
        let covariance = Mat::from_fn(sd.len(), sd.len(), |i, j| sd[i] * half[(i, j)]);
        let gradient = Mat::from_fn(sd.len(), 1, |i, _| {
            let rows = (0..linear.a.nrows()).map(|r| {
                self.weights[r / ROWS] * linear.a[(r, i)] * self.residuals[r / ROWS][r % ROWS]
            });
            // Terms that were added after the fit start from 0.
            let deviation = self.state.deviation.get(i).unwrap_or(&0.0);
            rows.sum::<f64>() - deviation / (sd[i] * sd[i])
        });
        let determined = (0..sd.len()).map(|i| 1.0 - covariance[(i, i)] / (sd[i] * sd[i]));
        self.determined = determined.sum();
        self.next_step = &covariance * gradient;
        self.covariance = covariance;
        Some(())
    }

    /// Same as [`fit`](Self::fit), with the given selection of gravity and harmonics.
    fn fit_terms(
        data: &Data<'_>,
        alignment: &Alignment,
        priors: Priors,
        gravity: Vector3<f64>,
        (with_gravity, with_harmonics): (bool, bool),
    ) -> Option<Self> {
        let instrument: Vec<_> = data.samples.iter().map(|s| (*s).clone()).collect();
        let samples = in_base_frame(&instrument, &alignment.base);
        let payloads: Vec<f64> = samples.iter().filter_map(|s| s.payload_kg).collect();
        let first_of_poses = first_of_poses(&samples, &data.robot.kinds());
        let joints = data.robot.joints.len();
        let layout = Layout {
            joints,
            tools: alignment.tools.len(),
            gravity: with_gravity,
            payload: payloads.iter().any(|m| (m - payloads[0]).abs() > 0.05),
            ripple: (0..joints)
                .filter(|_| with_harmonics)
                .flat_map(|j| [GearLine::found(j, 1.0), GearLine::found(j, 2.0)])
                .collect(),
        };
        let mut state = nominal_state(data, alignment, layout, gravity)?;
        let nominal = state.frames.clone();
        let sd = prior_deviations(&state, priors);
        for _ in 0..ROUNDS {
            if improve(&mut state, &samples, &first_of_poses, &sd)? < SETTLED {
                break;
            }
        }
        let scales = robust_scales(&state, &samples, &first_of_poses);
        let linear = state.linearise(&samples, scales);
        let residuals = state.residuals(&samples, scales);
        let weights = row_weights(&residuals, &samples);
        let plain = state.residuals(&samples, NoiseScales::ONE);
        let norm = |r: &[f64]| r.iter().map(|x| x * x).sum::<f64>().sqrt();
        let whole = plain
            .iter()
            .zip(&samples)
            .filter(|(_, s)| s.observation.has_orientation());
        let mut out = Self {
            position: median(plain.iter().map(|r| norm(&r[..3])).collect()),
            rotation: median(whole.map(|(r, _)| norm(&r[3..])).collect()),
            frames_off: frames_off(&state.frames, &nominal),
            determined: 0.0,
            state,
            samples,
            first_of_poses,
            scales,
            linear,
            residuals,
            weights,
            covariance: Mat::zeros(0, 0),
            next_step: Mat::zeros(0, 0),
            sd,
        };
        out.solve()?;
        Some(out)
    }

    /// Returns the residual of a row per equation, in standard deviations.
    pub fn size(&self, row: usize) -> f64 {
        size(
            &self.residuals[row],
            self.samples[row].observation.equations(),
        )
    }

    /// Returns the factor by which residuals may exceed the noise: without gravity and harmonics they contain the arm's own
    /// errors.
    pub fn leniency(&self) -> f64 {
        if self.is_whole() { 1.0 } else { LENIENT }
    }

    /// Returns whether there were enough rows for gravity and harmonics.
    pub fn is_whole(&self) -> bool {
        self.terms() == (true, true)
    }

    /// Returns whether gravity and harmonics are included.
    pub fn terms(&self) -> (bool, bool) {
        let layout = &self.state.layout;
        (layout.gravity, !layout.ripple.is_empty())
    }

    /// Returns the rows at which the tool changes, with the first row and the end; `None` if it never changes, or more than
    /// `most` times: then it is one of several targets.
    pub fn mountings(&self, most: usize) -> Option<Vec<usize>> {
        let count = self.samples.len();
        let is_other = |k: &usize| self.samples[*k].tool != self.samples[k - 1].tool;
        let changes: Vec<usize> = (1..count).filter(is_other).collect();
        let is_some = (1..=most).contains(&changes.len());
        is_some.then(|| [vec![0], changes, vec![count]].concat())
    }

    /// Returns the number of equations of all rows.
    pub fn equations(&self) -> usize {
        self.samples.iter().map(|s| s.observation.equations()).sum()
    }

    /// Returns χ² of some rows.
    pub fn chi_squared(&self, rows: impl Iterator<Item = usize>) -> f64 {
        let square = |k: usize| self.residuals[k].iter().map(|r| r * r).sum::<f64>();
        rows.map(|k| self.weights[k] * square(k)).sum()
    }

    /// Returns the factor from the residuals of the fit to the noise, which is larger.
    pub fn noise_factor(&self) -> f64 {
        let equations = self.equations() as f64;
        (equations / (equations - self.determined).max(1.0)).sqrt()
    }
}

/// Returns the nominal arm at the base and the tools of `alignment`.
fn nominal_state(
    data: &Data<'_>,
    alignment: &Alignment,
    layout: Layout,
    gravity: Vector3<f64>,
) -> Option<ParametricModel> {
    let last = *data.chain.frames().last()?;
    let chain = with_base_and_tool(&data.chain, &Pose::identity(), &alignment.tools[0]);
    let tools: Vec<Pose<f64>> = alignment.tools.iter().map(|t| last * *t).collect();
    let coupling = data.robot.coupling.clone();
    Some(ParametricModel::new(
        &chain, tools, coupling, layout, gravity,
    ))
}

/// Returns the standard deviations of the priors of all parameters.
fn prior_deviations(state: &ParametricModel, priors: Priors) -> Vec<f64> {
    let wide = match priors {
        Priors::Made => 0.0,
        Priors::Wide => libm::log(15.0_f64.powi(2)),
    };
    let hyper = [0.0, 0.0, wide, 0.0, 0.0];
    let groups = state.layout.groups();
    groups
        .iter()
        .map(|g| prior_variance(*g, &hyper).sqrt())
        .collect()
}

/// Takes one step of the fit, shortened until it lowers the objective. Returns its largest part in units of the priors'
/// standard deviations, 0 if no length lowers it; `None` if the equations cannot be solved.
fn improve(
    state: &mut ParametricModel,
    samples: &[BaseSample],
    first_of_poses: &[usize],
    sd: &[f64],
) -> Option<f64> {
    let scales = robust_scales(state, samples, first_of_poses);
    let linear = state.linearise(samples, scales);
    let weights = row_weights(&state.residuals(samples, scales), samples);
    let factor = Factor::new(normal(&linear, &weights, sd), 1).ok()?;
    let right = right_side(&linear, &weights, sd);
    let z = factor.solve(&right);
    let x: Vec<f64> = (0..sd.len()).map(|i| sd[i] * z[(i, 0)]).collect();
    let before = objective(state, samples, scales, sd);
    for halvings in 0..8 {
        let share = 0.5_f64.powi(halvings);
        let mixed = x
            .iter()
            .zip(&state.deviation)
            .map(|(new, old)| old + share * (new - old));
        let mixed: Vec<f64> = mixed.collect();
        let mut candidate = state.clone();
        candidate.update(&mixed);
        if objective(&candidate, samples, scales, sd) <= before {
            let steps = mixed.iter().zip(&state.deviation).zip(sd);
            let moved = steps
                .map(|((new, old), sd)| ((new - old) / sd).abs())
                .fold(0.0, f64::max);
            *state = candidate;
            return Some(moved);
        }
    }
    Some(0.0)
}

/// Returns the distance of each fitted frame from the nominal one, in m and rad.
fn frames_off(fitted: &[Pose<f64>], nominal: &[Pose<f64>]) -> Vec<(f64, f64)> {
    let mut off: Vec<(f64, f64)> = (fitted.iter().zip(nominal))
        .map(|(fitted, nominal)| {
            let turned = nominal.inverse() * *fitted;
            (
                (fitted.translation - nominal.translation).norm(),
                turned.log().angular.norm(),
            )
        })
        .collect();
    for (frame, shift) in shifts_along_axes(fitted, nominal) {
        off[frame].0 = off[frame].0.max(shift);
    }
    off
}

/// Returns shifts along joints with parallel axes, in m, each with the frame that has the largest part of it. The data
/// determine only the sum of these frames' shifts and that of the frame after them, and the fit spreads it over all of them.
fn shifts_along_axes(fitted: &[Pose<f64>], nominal: &[Pose<f64>]) -> Vec<(usize, f64)> {
    let count = nominal.len();
    let turns = |k: usize| nominal[k].rotation[(2, 2)];
    let mut out = Vec::new();
    let mut first = 1;
    while first + 1 < count {
        let mut last = first;
        while last + 1 < count && turns(last + 1).abs() > PARALLEL {
            last += 1;
        }
        if last + 1 < count {
            let mut way = 1.0;
            let mut parts = Vec::new();
            for k in first..=last {
                if k > first {
                    way *= turns(k).signum();
                }
                parts.push((k, way * (nominal[k].inverse() * fitted[k]).translation[2]));
            }
            let behind = fitted[last + 1].translation - nominal[last + 1].translation;
            parts.push((last + 1, way * behind[2]));
            let sum: f64 = parts.iter().map(|part| part.1).sum();
            let most = parts.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            out.extend(most.map(|part| (part.0, sum.abs())));
        }
        first = last + 1;
    }
    out
}

fn size(residual: &[f64; ROWS], equations: usize) -> f64 {
    (residual.iter().map(|x| x * x).sum::<f64>() / equations as f64).sqrt()
}

fn robust_scales(
    state: &ParametricModel,
    samples: &[BaseSample],
    first_of_poses: &[usize],
) -> NoiseScales {
    let residuals = state.residuals(samples, NoiseScales::ONE);
    scales_of(&residuals, samples, first_of_poses)
}

/// Returns the robust scales of the residuals of the first row of every pose, in m and rad.
fn scales_of(
    residuals: &[[f64; ROWS]],
    samples: &[BaseSample],
    first_of_poses: &[usize],
) -> NoiseScales {
    let residuals: Vec<[f64; ROWS]> = first_of_poses.iter().map(|k| residuals[*k]).collect();
    // The stated uncertainties are themselves under examination, so they do not affect the weights here.
    let plain = |k: &usize| BaseSample {
        declared_noise: Default::default(),
        ..samples[*k].clone()
    };
    let samples: Vec<BaseSample> = first_of_poses.iter().map(plain).collect();
    NoiseScales::robust(&residuals, &samples).at_least(LEAST_SCALE)
}

/// Weights limit the pull of a row that does not belong, however far off it is; rows that are off together still show where
/// they are.
fn row_weights(residuals: &[[f64; ROWS]], samples: &[BaseSample]) -> Vec<f64> {
    let of = |(r, s): (&[f64; ROWS], &BaseSample)| {
        let u = size(r, s.observation.equations());
        if u < BEND { 1.0 } else { (BEND / u).powi(2) }
    };
    residuals.iter().zip(samples).map(of).collect()
}

/// Returns robust χ² plus the prior term.
fn objective(
    state: &ParametricModel,
    samples: &[BaseSample],
    scales: NoiseScales,
    sd: &[f64],
) -> f64 {
    let rows = state.residuals(samples, scales);
    let data = rows.iter().map(|r| {
        let square: f64 = r.iter().map(|x| x * x).sum();
        // The loss that corresponds to the weights of `row_weights`.
        let bend = BEND * BEND * 6.0;
        if square < bend {
            square
        } else {
            bend * (1.0 + libm::log(square / bend))
        }
    });
    let prior = state
        .deviation
        .iter()
        .zip(sd)
        .map(|(x, sd)| (x / sd).powi(2));
    data.sum::<f64>() + prior.sum::<f64>()
}

/// Returns Λ^½ (AᵀWA) Λ^½ + 1, with the prior covariance Λ.
fn normal(linear: &Linearised, weights: &[f64], sd: &[f64]) -> Mat<f64> {
    let weighted = Mat::from_fn(linear.a.nrows(), sd.len(), |r, j| {
        weights[r / ROWS].sqrt() * linear.a[(r, j)] * sd[j]
    });
    let mut normal = product(Transposed(&weighted), &weighted);
    for i in 0..sd.len() {
        normal[(i, i)] += 1.0;
    }
    normal
}

fn right_side(linear: &Linearised, weights: &[f64], sd: &[f64]) -> Mat<f64> {
    let y = Mat::from_fn(linear.y.nrows(), 1, |r, _| {
        weights[r / ROWS] * linear.y[(r, 0)]
    });
    let right = product(Transposed(&linear.a), &y);
    Mat::from_fn(sd.len(), 1, |i, _| sd[i] * right[(i, 0)])
}
