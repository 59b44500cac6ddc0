//! Outliers: measurements that contradict all others. Leave-one-out χ² finds them; none is dropped silently.
//!
//! A gross outlier inflates the very noise that it should be judged by. Two stages prevent that. First, parameters alone
//! are fitted to the poses that a robust scale (the median residual) accepts, until that set settles. Then the whole
//! model predicts every remaining pose from all others, χ²_k = α_kᵀ ([S⁻¹]_kk)⁻¹ α_k, with S⁻¹ and α = S⁻¹y from the
//! factorisation that exists anyway.
//!
//! A measurement that was repeated is judged beside its repeats, which show best that it does not belong. How well new
//! poses are predicted is seen without them: all rows of one configuration are left out together.

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use std::ops::Range;

use crate::identification::parametric::fit::parametric_fit;
use crate::identification::parametric::state::{Layout, ParametricModel, ROWS};
use crate::learning::elastic::options::{ElasticOptions, mean_payload};
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::folds::held_out_together;
use crate::measurement::noise::{NoiseScales, QUIETEST};
use crate::measurement::sample::BaseSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::{Standardised, calibration_factor};

/// Leave-one-out χ² of a pose above which it is an outlier: six degrees of freedom, p < 10⁻⁶.
pub const LEFT_OUT: f64 = 40.0;
/// Squared robust distance from the parameters alone above which a pose is a gross outlier: ten standard deviations.
const GROSS: f64 = 100.0;
/// Most rounds until the set of accepted poses settles.
const ROUNDS: usize = 6;
/// Number of equations for each parameter below which the parameters follow an outlier instead of showing it.
const EQUATIONS_PER_PARAMETER: usize = 3;

/// Number of equations for each parameter below which a single wrong pose may hide in the fit.
const FOLLOWED: usize = 15;
/// Largest share of the residuals' scale that is left once the hidden poses are out, and fewest poses for each of them.
const UNHIDDEN: f64 = 0.5;
const POSES_PER_HIDDEN: usize = 10;

/// The test by which an outlier was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Far from what the parameters alone predict.
    Robust,
    /// Far from what all other poses predict.
    LeaveOneOut,
}

/// A measurement that contradicts all others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// Index of the sample.
    pub sample: usize,
    /// Test by which it was found.
    pub reason: Reason,
    /// χ² or squared robust distance of the sample.
    pub chi_squared: f64,
    /// Distances of position and rotation in standard deviations; zero for a rotation that was not measured.
    pub sigmas: [f64; 2],
}

/// Finds poses that contradict the parameters alone: gravity terms as `options` say, no ripple, no processes. `chain` is
/// the nominal chain to the first target, `tools` are `joint_n_from_target` of every tool. Returns none where there are
/// too few poses to distinguish an outlier from a parameter.
pub fn gross_outliers(
    chain: &Poe<f64>,
    tools: &[Pose<f64>],
    coupling: Option<&Vec<Vec<f64>>>,
    samples: &[BaseSample],
    options: &ElasticOptions,
) -> Vec<Outlier> {
    let (layout, hyper) = options.layouts(chain.kinds().len(), tools.len(), samples);
    let hyper = hyper.start_and_bounds(mean_payload(samples)).0;
    let equations: usize = samples.iter().map(|s| s.observation.equations()).sum();
    let geometric = 4 * layout.joints + 6 * tools.len();
    if equations < EQUATIONS_PER_PARAMETER * geometric {
        return Vec::new();
    }
    let fit = |kept: &[BaseSample], layout: &Layout| {
        let (tools, coupling) = (tools.to_vec(), coupling.cloned());
        let layout = layout.clone();
        let mut state = ParametricModel::new(chain, tools, coupling, layout, options.gravity);
        parametric_fit(&mut state, kept, &hyper);
        state
    };
    let rigid = Layout {
        gravity: false,
        payload: false,
        ..layout.clone()
    };
    let fit_rigid = |kept: &[BaseSample]| fit(kept, &rigid);
    let is_followed = equations < FOLLOWED * geometric;
    let fit_rigid: Option<FitParameters<'_>> = is_followed.then_some(&fit_rigid);
    robust_outliers(samples, &|kept| fit(kept, &layout), fit_rigid)
}

/// Fits a fresh state to some samples.
pub type FitParameters<'a> = &'a dyn Fn(&[BaseSample]) -> ParametricModel;

/// Finds poses that contradict the parameters alone. Of few poses, `fit_rigid` fits a state without gravity.
///
/// Of few poses, the parameters follow a wrong one, and all residuals grow. A rigid arm has fewer to follow it with. So the fit
/// also starts from the poses that are no gross outliers of a rigid arm. What it then finds counts if the scale of the residuals
/// falls by far.
pub fn robust_outliers(
    samples: &[BaseSample],
    fit_parameters: FitParameters<'_>,
    fit_rigid: Option<FitParameters<'_>>,
) -> Vec<Outlier> {
    let judge = |believed: &[bool]| Judged::of(samples, believed, fit_parameters);
    let Some(mut best) = settled(vec![true; samples.len()], &judge) else {
        return Vec::new();
    };
    if let Some(fit_rigid) = fit_rigid {
        let most = (samples.len() / POSES_PER_HIDDEN).max(1);
        let judge_rigid = |believed: &[bool]| Judged::of(samples, believed, fit_rigid);
        let rigid = settled(vec![true; samples.len()], &judge_rigid);
        let start = rigid.map(|rigid| rigid.believed());
        let start = start.filter(|start| *start != best.believed());
        let other = start.and_then(|start| settled(start, &judge));
        let is_better = |other: &Judged| {
            let outliers = other.believed().iter().filter(|is_in| !**is_in).count();
            outliers <= most && other.scale < UNHIDDEN * best.scale
        };
        if let Some(other) = other.filter(is_better) {
            best = other;
        }
    }
    let outlier = |(sample, d): (usize, &[f64; 2])| {
        (squared(d) > GROSS).then_some(Outlier {
            sample,
            reason: Reason::Robust,
            chi_squared: squared(d),
            sigmas: *d,
        })
    };
    best.distances
        .iter()
        .enumerate()
        .filter_map(outlier)
        .collect()
}

/// Poses as a fit to some of them judges all.
struct Judged {
    /// Robust distances of position and rotation of each pose.
    distances: Vec<[f64; 2]>,
    /// Robust standard deviation of a position component, in m.
    scale: f64,
}

impl Judged {
    fn of(samples: &[BaseSample], believed: &[bool], fit_parameters: FitParameters<'_>) -> Self {
        let kept = samples.iter().zip(believed).filter(|(_, b)| **b);
        let kept: Vec<BaseSample> = kept.map(|(s, _)| s.clone()).collect();
        let residuals = fit_parameters(&kept).residuals(samples, NoiseScales::ONE);
        let scales = NoiseScales::robust(&residuals, samples);
        let norm = |r: &[f64]| r.iter().map(|x| x * x).sum::<f64>().sqrt();
        let distance = |(r, sample): (&[f64; ROWS], &BaseSample)| {
            let own = scales.of(sample);
            let turn = norm(&r[3..]) / own.orientation.max(QUIETEST.1);
            [norm(&r[..3]) / own.position.max(QUIETEST.0), turn]
        };
        Self {
            distances: residuals.iter().zip(samples).map(distance).collect(),
            scale: scales.position.max(QUIETEST.0),
        }
    }

    /// Returns which poses are no gross outliers.
    fn believed(&self) -> Vec<bool> {
        self.distances.iter().map(|d| squared(d) <= GROSS).collect()
    }
}

fn squared(d: &[f64; 2]) -> f64 {
    d[0] * d[0] + d[1] * d[1]
}

/// Fits to the poses that the last fit accepts, beginning with `believed`, until these settle. Returns `None` if fewer than
/// half of them remain.
fn settled(mut believed: Vec<bool>, judge: &dyn Fn(&[bool]) -> Judged) -> Option<Judged> {
    let mut judged = None;
    for _ in 0..ROUNDS {
        let kept = believed.iter().filter(|is_in| **is_in).count();
        if kept < believed.len() / 2 {
            return None;
        }
        let found = judge(&believed);
        let now = found.believed();
        let is_settled = now == believed;
        believed = now;
        judged = Some(found);
        if is_settled {
            break;
        }
    }
    judged
}

/// Result of the leave-one-out prediction of every pose.
#[derive(Clone, Debug)]
pub struct LeaveOneOut {
    /// Outliers, by their index among the samples of the fit.
    pub outliers: Vec<Outlier>,
    /// Factors that make the predicted standard deviations of position and rotation true for the configurations left out:
    /// the mean of the factors that the 68 % and the 95 % quantile of their standardised errors ask for.
    pub inflation: [f64; 2],
    /// Variance of one position component of every pose as predicted by other configurations, in m²: the mean of three
    /// components, with noise, not inflated. `None` for outliers.
    pub position_variance: Vec<Option<f64>>,
}

/// Some rows as all others predict them.
struct LeftOut {
    error: Mat<f64>,
    covariance: Mat<f64>,
}

impl LeftOut {
    /// Leaves rows out; `block` is that of the rows in S⁻¹, and `alpha` has their elements of α.
    fn new(block: Mat<f64>, alpha: &Mat<f64>) -> Option<Self> {
        // The error of the rows is the block's inverse times α, and that inverse is its covariance.
        let factor = Factor::new(block, 1).ok()?;
        Some(Self {
            error: factor.solve(alpha),
            covariance: factor.inverse(),
        })
    }
}

/// Predicts every pose of a fit from all others.
pub fn leave_one_out(fit: &ElasticFit, samples: &[BaseSample]) -> LeaveOneOut {
    let mut out = LeaveOneOut {
        outliers: Vec::new(),
        inflation: [1.0; 2],
        position_variance: vec![None; samples.len()],
    };
    let Some(solved) = &fit.solved else {
        out.inflation = of_many_poses(fit, samples);
        return out;
    };
    let rows_of = |k: &usize| ROWS * k..ROWS * k + samples[*k].observation.equations();
    let alpha = |rows: &[usize]| Mat::from_fn(rows.len(), 1, |i, _| solved.alpha[(rows[i], 0)]);
    let mut alone = Vec::with_capacity(samples.len());
    for (k, block) in solved.factor.inverse_blocks(ROWS).into_iter().enumerate() {
        let rows: Vec<usize> = rows_of(&k).collect();
        let alpha = alpha(&rows);
        let block = block.view((0, 0), (rows.len(), rows.len())).into_owned();
        let mut found = LeftOut::new(block, &alpha);
        if let Some(LeftOut { error, covariance }) = &found {
            let chi_squared: f64 = (0..rows.len()).map(|i| alpha[(i, 0)] * error[(i, 0)]).sum();
            if chi_squared > LEFT_OUT {
                out.outliers.push(Outlier {
                    sample: k,
                    reason: Reason::LeaveOneOut,
                    chi_squared,
                    sigmas: [0, 1].map(|part| marginal(error, covariance, 3 * part..rows.len())),
                });
                found = None;
            }
        }
        alone.push(found);
    }
    let mut groups = held_out_together(samples, fit.state.kinds());
    let repeated: Vec<Vec<usize>> = groups.extract_if(.., |group| group.len() > 1).collect();
    let mut standardised: Standardised = [Vec::new(), Vec::new()];
    let mut add = |k: usize, first: usize, LeftOut { error, covariance }: &LeftOut| {
        let mean = (first..first + 3).map(|i| covariance[(i, i)]).sum::<f64>() / 3.0;
        out.position_variance[k] = Some(fit.scales.of(&samples[k]).position.powi(2) * mean);
        for (i, row) in (first..first + rows_of(&k).len()).enumerate() {
            standardised[usize::from(i >= 3)]
                .push((error[(row, 0)] / covariance[(row, row)].sqrt()).abs());
        }
    };
    for k in groups.into_iter().flatten() {
        if let Some(found) = &alone[k] {
            add(k, 0, found);
        }
    }
    let rows: Vec<usize> = repeated.iter().flatten().flat_map(rows_of).collect();
    let half = solved
        .factor
        .half_solve(&Mat::from_fn(solved.alpha.nrows(), rows.len(), |i, j| {
            f64::from(u8::from(i == rows[j]))
        }));
    let mut column = 0;
    for group in repeated {
        let rows: Vec<usize> = group.iter().flat_map(rows_of).collect();
        let own = half.columns(column, rows.len()).into_owned();
        column += rows.len();
        let Some(found) = LeftOut::new(product(Transposed(&own), &own), &alpha(&rows)) else {
            continue;
        };
        let mut first = 0;
        for k in group {
            if alone[k].is_some() {
                add(k, first, &found);
            }
            first += rows_of(&k).len();
        }
    }
    out.inflation = calibration_factor(&mut standardised);
    out
}

/// Returns the factors for a fit of parameters alone to many poses: with m equations and p parameters, poses that were left
/// out are off by √(m/(m − p)) times as much as the residuals.
fn of_many_poses(fit: &ElasticFit, samples: &[BaseSample]) -> [f64; 2] {
    let parameters = fit.effective_parameters.unwrap_or_default();
    let whole = samples.iter().filter(|s| s.observation.has_orientation());
    let equations = [samples.len(), whole.count()].map(|rows| (3 * rows) as f64);
    std::array::from_fn(|i| {
        let left = equations[i] - parameters[i];
        if left > 0.0 {
            (equations[i] / left).sqrt()
        } else {
            1.0
        }
    })
}

/// Returns the distance, in standard deviations, of at most three components of `error` from the beginning of `rows`.
fn marginal(error: &Mat<f64>, covariance: &Mat<f64>, rows: Range<usize>) -> f64 {
    let (start, count) = (rows.start, rows.len().min(3));
    let block = Mat::from_fn(count, count, |i, j| covariance[(start + i, start + j)]);
    let own = Mat::from_fn(count, 1, |i, _| error[(start + i, 0)]);
    let Ok(factor) = Factor::new(block, 1) else {
        return 0.0;
    };
    let solved = factor.solve(&own);
    let squared: f64 = (0..count).map(|i| own[(i, 0)] * solved[(i, 0)]).sum();
    squared.sqrt()
}
