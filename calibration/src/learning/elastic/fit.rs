//! Fit of the elastic model: parameters first, then gear ripple, then everything together with the processes.

use poegp_runtime::elastic::ripple::RippleTerm;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::identification::parametric::fit::{effective_parameters, parametric_fit};
use crate::identification::parametric::gear_line::{AmbiguousLine, GearLine};
use crate::identification::parametric::ripple::{
    Peak, RANGE, SIGNIFICANT, peaks, refined_frequency,
};
use crate::identification::parametric::state::{
    Linearised, MAX_LINEARISATION_ERROR, MAX_STEPS, ParametricModel, ROWS,
};
use crate::learning::elastic::hyperparameter_search::{HyperparameterSearch, Learned};
use crate::learning::elastic::hyperparameters::{DEFLECTION_UNIT, HyperLayout};
use crate::learning::elastic::inputs::Inputs;
use crate::learning::elastic::likelihood::{MarginalLikelihood, Posterior};
use crate::learning::elastic::options::{ElasticOptions, NominalArm, OutlierPolicy, mean_payload};
use crate::learning::elastic::outliers::{LeaveOneOut, Outlier, leave_one_out};
use crate::learning::elastic::own_joint_curve::{CurvePrior, Waves, orders};
use crate::learning::elastic::solution::{ElasticFit, FitError};
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::BaseSample;
use crate::numeric::matrix::Mat;
use crate::progress::FitContext;
use poegp_protocol::limits::MAX_RIPPLE;

/// Evaluations that the search for hyperparameters takes, approximately.
const SEARCH_UNITS: u64 = 44;

/// Largest number of poses of the dense solution, whose matrices have six rows and columns for each. From more poses,
/// this many are drawn for hyperparameters, ripple, outliers and standard deviations; all of them determine parameters,
/// curves and weights.
pub const DENSE_POSES: usize = 800;

/// Returns the approximate cost of solving for all poses (twice), of leaving each out, and of reducing to inducing
/// points, each in evaluations of the search for hyperparameters: 700 poses took 2.7 s of 4.8, 300 took 0.5 of 2.6.
pub fn solve_units(poses: usize) -> u64 {
    1 + poses.saturating_mul(poses) as u64 / 36_000
}

/// Returns the approximate cost of fitting the parameters alone and their gear ripple, in evaluations of that search.
pub fn setup_units(poses: usize) -> u64 {
    1 + poses as u64 / 50
}

/// A fit, together with the measurements that do not belong.
pub struct RobustFit {
    /// Fit to the samples that were kept.
    pub fit: ElasticFit,
    /// Outliers, which all other samples fail to predict; by index.
    pub outliers: Vec<Outlier>,
    /// Indices of the samples that were kept.
    pub kept: Vec<usize>,
    /// Indices of the kept samples that `fit` used: all of them, or [`DENSE_POSES`] of more.
    pub dense: Vec<usize>,
    /// Factors for the predicted standard deviations of position and rotation.
    pub inflation: [f64; 2],
    /// Position variance of every sample of `dense` as predicted by the others, in m², not inflated; `None` for outliers.
    pub left_out: Vec<Option<f64>>,
}

/// Runs [`fit`], reports the outliers, and excludes them from training when `options` says so.
pub fn fit_robust(
    arm: &NominalArm,
    samples: &[BaseSample],
    options: &ElasticOptions,
    context: &FitContext,
) -> Result<RobustFit, FitError> {
    let mut dense: Vec<usize> = (0..samples.len()).collect();
    if options.processes && samples.len() > DENSE_POSES {
        dense.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
        dense.truncate(DENSE_POSES);
        dense.sort_unstable();
    }
    let units_of_a_fit = SEARCH_UNITS + setup_units(dense.len()) + 3 * solve_units(dense.len());
    context.expect(units_of_a_fit + solve_units(dense.len()));
    let reject = options.outliers == OutlierPolicy::Reject;
    let run = |kept: &[usize]| -> Result<(ElasticFit, LeaveOneOut), FitError> {
        let part: Vec<BaseSample> = kept.iter().map(|i| samples[*i].clone()).collect();
        let found = fit(arm, &part, options, context)?;
        let others = context.phase(solve_units(part.len()), || leave_one_out(&found, &part))?;
        Ok((found, others))
    };
    let mut kept: Vec<usize> = (0..samples.len()).collect();
    let (mut found, mut others) = run(&dense)?;
    let mut outliers = std::mem::take(&mut others.outliers);
    for outlier in &mut outliers {
        outlier.sample = dense[outlier.sample];
    }
    if reject && !outliers.is_empty() {
        // One pass only: testing again with the quieter noise would never end.
        let of_all: Vec<usize> = outliers.iter().map(|o| o.sample).collect();
        kept.retain(|i| !of_all.contains(i));
        dense.retain(|i| !of_all.contains(i));
        context.expect(units_of_a_fit);
        (found, others) = run(&dense)?;
    }
    Ok(RobustFit {
        fit: found,
        outliers,
        kept,
        dense,
        inflation: others.inflation,
        left_out: others.position_variance,
    })
}

/// Fits the elastic model to samples whose poses are given in the base frame.
pub fn fit(
    arm: &NominalArm,
    samples: &[BaseSample],
    options: &ElasticOptions,
    context: &FitContext,
) -> Result<ElasticFit, FitError> {
    let units = solve_units(samples.len());
    let (layout, h) = options.layouts(arm.chain.kinds().len(), arm.tools.len(), samples);
    let mut state = arm.parametric(layout, options);
    if options.ripple {
        state.add_ripple(&arm.gear_lines);
    }
    let unit = mean_payload(samples);
    let (start, _) = h.start_and_bounds(unit);
    let (scales, mut ambiguous) = context.phase(setup_units(samples.len()), || {
        let scales = parametric_fit(&mut state, samples, &start);
        if options.ripple {
            add_ripple(&mut state, samples, &start, scales)
        } else {
            (scales, Vec::new())
        }
    })?;
    let search = HyperparameterSearch::new(samples, scales, options, context);
    let Learned {
        mut state,
        layout: h,
        hyperparameters: hyper,
        report: search,
    } = context.phase(SEARCH_UNITS, || search.learn(&state, h))??;
    if !options.processes {
        // Fit again under the priors that the evidence prefers.
        let scales = parametric_fit(&mut state, samples, &hyper);
        let effective_parameters = effective_parameters(&state, samples, scales, &hyper);
        return Ok(ElasticFit {
            origin: state.clone(),
            inputs: Inputs::new(&state, samples),
            state,
            hyperparameters: hyper,
            layout: h,
            scales,
            effective_parameters,
            solved: None,
            ambiguous,
            search,
        });
    }
    let inputs = Inputs::new(&state, samples);
    let equations = Equations {
        samples,
        scales,
        similarities: inputs.similarities(),
        waves: inputs.waves(h),
        inputs: &inputs,
        layout: h,
        hyper: &hyper,
        threads: context.threads(),
    };
    let (first, linear, _) = context.phase(units, || equations.step(&mut state))??;
    if options.ripple {
        let unclear = equations.renew_ripple(&mut state, &first, &linear);
        // Processes may have hidden a line that the first search saw: it stays as ambiguous as before.
        ambiguous.retain(|line| unclear.iter().all(|later| later.joint != line.joint));
        ambiguous.extend(unclear);
    }
    let mut origin = state.clone();
    let (mut solved, _, mut error) = context.phase(units, || equations.step(&mut state))??;
    for _ in 0..MAX_STEPS {
        if error < MAX_LINEARISATION_ERROR {
            break;
        }
        context.check()?;
        origin = state.clone();
        (solved, _, error) = equations.step(&mut state)?;
    }
    if let Some(prior) = h.curve_prior(&hyper) {
        state.curves = curve_coefficients(
            &prior,
            orders(libm::exp(hyper[h.curve_scale()])),
            &equations.waves,
            &solved,
        );
    }
    Ok(ElasticFit {
        origin,
        state,
        hyperparameters: hyper,
        layout: h,
        scales,
        inputs,
        effective_parameters: None,
        solved: Some(solved),
        ambiguous,
        search,
    })
}

/// The equations of parameters and processes together, for given hyperparameters.
struct Equations<'a> {
    samples: &'a [BaseSample],
    scales: NoiseScales,
    inputs: &'a Inputs,
    similarities: Vec<Mat<f64>>,
    waves: Vec<Option<Waves>>,
    layout: HyperLayout,
    hyper: &'a [f64],
    threads: usize,
}

impl Equations<'_> {
    /// Solves the equations at a state and moves it there. Also returns the equations and the linearisation error of the
    /// step.
    fn step(&self, state: &mut ParametricModel) -> Result<(Posterior, Linearised, f64), FitError> {
        let linear = state.linearise(self.samples, self.scales);
        let groups = state.layout.groups();
        let evidence = MarginalLikelihood {
            linear: &linear,
            groups: &groups,
            inputs: self.inputs,
            similarities: &self.similarities,
            waves: &self.waves,
            layout: self.layout,
            processes: true,
            threads: self.threads,
        };
        let solution = evidence.solve(self.hyper).ok_or(FitError::Unsolvable)?;
        let error = state.step(&solution.parameters, &linear, self.samples, self.scales);
        Ok((solution, linear, error))
    }

    /// Searches for ripple again in what a solution leaves, and returns the lines whose frequency is ambiguous. What
    /// processes or curve explain is no ripple. The residual after them is quieter than that of the parameters, so weaker
    /// ripple becomes visible.
    fn renew_ripple(
        &self,
        state: &mut ParametricModel,
        solved: &Posterior,
        linear: &Linearised,
    ) -> Vec<AmbiguousLine> {
        let kept = kept_ripple(state, solved, linear);
        let mut lines = kept.iter();
        state.retain_ripple(|_| lines.next() == Some(&true));
        let (residuals, jacobian) = left_over(solved, self.hyper, linear);
        let lowest = lowest_ripple(self.layout, self.hyper);
        let (found, unclear) = significant(state, self.samples, &residuals, &jacobian, lowest);
        state.add_ripple(&found);
        unclear
    }
}

/// Returns the most probable own-joint curves of all joints for a solution, in the form that the runtime evaluates.
fn curve_coefficients(
    prior: &CurvePrior,
    orders: usize,
    waves: &[Option<Waves>],
    solved: &Posterior,
) -> Vec<f64> {
    let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
    let of = |(c, waves): (usize, &Option<Waves>)| match waves {
        Some(waves) => {
            let mut all = prior.coefficients(waves, |k| unit * solved.weights[(k, c)]);
            all.truncate(2 * orders);
            all
        }
        None => vec![0.0; 2 * orders],
    };
    waves.iter().enumerate().flat_map(of).collect()
}

/// Returns which ripple terms of `state` are significant in a full solution, by χ² of both amplitudes under their
/// posterior.
fn kept_ripple(state: &ParametricModel, solved: &Posterior, linear: &Linearised) -> Vec<bool> {
    let first = linear.a.ncols() - 2 * state.ripple.len();
    let groups = state.layout.groups();
    let significant = |term: usize| {
        let at = first + 2 * term;
        let variance = groups[at].prior_sd().powi(2);
        let columns = linear.a.columns(at, 2).into_owned();
        let explained = columns.transpose() * solved.factor.solve(&columns);
        let posterior = |i: usize, j: usize| {
            let prior = if i == j { variance } else { 0.0 };
            prior - variance * variance * explained[(i, j)]
        };
        let (ss, sc, cc) = (posterior(0, 0), posterior(0, 1), posterior(1, 1));
        let (sin, cos) = (solved.parameters[at], solved.parameters[at + 1]);
        let chi_squared =
            (cc * sin * sin - 2.0 * sc * sin * cos + ss * cos * cos) / (ss * cc - sc * sc);
        chi_squared > SIGNIFICANT
    };
    (0..state.ripple.len()).map(significant).collect()
}

/// Returns the cycles per turn above which ripple is searched: lower ones belong to the own-joint curve, if there is one.
fn lowest_ripple(layout: HyperLayout, hyper: &[f64]) -> f64 {
    if layout.curve {
        RANGE
            .0
            .max(orders(libm::exp(hyper[layout.curve_scale()])) as f64)
    } else {
        RANGE.0
    }
}

/// Returns the residual of the full solution in units of its noise, σ S⁻¹y, and the Jacobian scaled by the rows' own
/// noise.
fn left_over(
    solved: &Posterior,
    hyper: &[f64],
    linear: &Linearised,
) -> (Vec<[f64; ROWS]>, Mat<f64>) {
    let h = |row: usize| hyper[usize::from(row % ROWS >= 3)];
    let relative = |row: usize| linear.relative_noise(row, h(row));
    let residual = |row: usize| libm::exp(0.5 * h(row)) * relative(row) * solved.alpha[(row, 0)];
    let residuals = (0..solved.alpha.nrows() / ROWS)
        .map(|k| std::array::from_fn(|i| residual(ROWS * k + i)))
        .collect();
    let jacobian = &linear.jacobian;
    let scaled = Mat::from_fn(jacobian.nrows(), jacobian.ncols(), |row, c| {
        jacobian[(row, c)] / relative(row)
    });
    (residuals, scaled)
}

/// Returns the new ripple terms that are significant in `residuals` (in units of their noise), and those that are
/// ambiguous.
fn significant(
    state: &ParametricModel,
    samples: &[BaseSample],
    residuals: &[[f64; ROWS]],
    jacobian: &Mat<f64>,
    lowest: f64,
) -> (Vec<GearLine>, Vec<AmbiguousLine>) {
    let room = MAX_RIPPLE - state.ripple.len();
    // What is left near an existing term is its own shadow, not another gear.
    let is_new = |p: &Peak| {
        let same = |r: &RippleTerm<f64>| r.joint == p.joint && (r.cycles - p.cycles).abs() < 1.0;
        !state.ripple.iter().any(same)
    };
    let (mut lines, mut ambiguous) = (Vec::new(), Vec::new());
    let new = peaks(samples, residuals, jacobian, lowest).into_iter();
    for peak in new.filter(|p| p.drop > SIGNIFICANT && is_new(p)) {
        let (joint, cycles) = (peak.joint, peak.cycles);
        match peak.alias {
            None => lines.push(GearLine::found(joint, cycles)),
            Some(alias) => ambiguous.push(AmbiguousLine {
                joint,
                cycles,
                alias,
            }),
        }
    }
    lines.truncate(room);
    (lines, ambiguous)
}

/// Most rounds of the search for ripple in the residual of the parameters.
const RIPPLE_ROUNDS: usize = 4;

/// Adds gear ripple until nothing significant is left. Returns the noise scales and the ambiguous lines.
fn add_ripple(
    state: &mut ParametricModel,
    samples: &[BaseSample],
    hyper: &[f64],
    mut scales: NoiseScales,
) -> (NoiseScales, Vec<AmbiguousLine>) {
    let mut ambiguous = Vec::new();
    for _ in 0..RIPPLE_ROUNDS {
        let linear = state.linearise(samples, scales);
        let residuals = state.residuals(samples, scales);
        for (i, term) in state.ripple.clone().iter().enumerate() {
            if state.layout.ripple[i].is_stated {
                continue;
            }
            let cycles = refined_frequency(term, samples, &residuals, &linear.jacobian);
            state.set_cycles(i, cycles);
        }
        let (found, unclear) = significant(state, samples, &residuals, &linear.jacobian, RANGE.0);
        ambiguous = unclear;
        if found.is_empty() {
            break;
        }
        state.add_ripple(&found);
        scales = parametric_fit(state, samples, hyper);
    }
    (scales, ambiguous)
}
