//! The elastic model, fitted: parameters first, then gear ripple, then everything together with the processes.

use faer::Mat;
use poegp_runtime::elastic::ripple::RippleTerm;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::identification::parametric::fit::parametric_fit;
use crate::identification::parametric::ripple::{Peak, SIGNIFICANT, peaks};
use crate::identification::parametric::state::{Linearised, ParametricModel, ROWS};
use crate::learning::elastic::hyperparameters::HyperLayout;
use crate::learning::elastic::likelihood::{
    HyperparameterObjective, Inputs, MarginalLikelihood, Posterior,
};
use crate::learning::elastic::options::{ElasticOptions, OutlierPolicy, mean_payload};
use crate::learning::elastic::outliers::{LeaveOneOut, Outlier, leave_one_out};
use crate::learning::elastic::solution::{ElasticFit, FitError};
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::{BaseSample, Sample};
use crate::numeric::lbfgs::{StopCriteria, minimize};
use crate::progress::{Cancelled, FitContext};
use poegp_protocol::limits::MAX_RIPPLE;

/// When that search ends.
const STOP: StopCriteria = StopCriteria::after(40, 1e-10);

/// Evaluations that it takes, about.
const SEARCH_UNITS: u64 = 44;

/// What solving for all poses takes, twice, what leaving each out takes, and what fewer support points take, about, in
/// evaluations of that search: 700 poses took 2.7 s of 4.8, 300 took 0.5 of 2.6.
pub fn solve_units(poses: usize) -> u64 {
    1 + poses.saturating_mul(poses) as u64 / 36_000
}

/// The parameters alone and their gear ripple.
pub fn setup_units(poses: usize) -> u64 {
    1 + poses as u64 / 50
}

/// A fit with the measurements that do not belong.
pub struct RobustFit {
    /// The fit to the samples that were kept.
    pub fit: ElasticFit,
    /// What all others do not predict, by index.
    pub outliers: Vec<Outlier>,
    /// The samples that were kept, by index.
    pub kept: Vec<usize>,
    /// What predicted standard deviations of position and rotation must be multiplied with.
    pub inflation: [f64; 2],
    /// Position variance of every kept sample as the others predict it, m², not inflated; `None` for outliers.
    pub left_out: Vec<Option<f64>>,
}

/// [`fit`], with what all others do not predict reported, and not trained on when `options` says so.
///
/// # Errors
/// [`FitError`].
pub fn fit_robust(
    chain: &Poe<f64>,
    tools: &[Pose<f64>],
    coupling: Option<&Vec<Vec<f64>>>,
    samples: &[BaseSample],
    options: &ElasticOptions,
    context: &FitContext,
) -> Result<RobustFit, FitError> {
    let setup = setup_units(samples.len());
    let units_of_a_fit = SEARCH_UNITS + setup + 3 * solve_units(samples.len());
    context.expect(units_of_a_fit + solve_units(samples.len()));
    let reject = options.outliers == OutlierPolicy::Reject;
    let run = |kept: &[usize]| -> Result<(ElasticFit, LeaveOneOut), FitError> {
        let part: Vec<BaseSample> = kept.iter().map(|i| samples[*i].clone()).collect();
        let found = fit(
            chain,
            tools.to_vec(),
            coupling.cloned(),
            &part,
            options,
            context,
        )?;
        let others = context.phase(solve_units(part.len()), || leave_one_out(&found, &part))?;
        Ok((found, others))
    };
    let mut kept: Vec<usize> = (0..samples.len()).collect();
    let (mut found, mut others) = run(&kept)?;
    let outliers = std::mem::take(&mut others.outliers);
    if reject && !outliers.is_empty() {
        // One pass only: testing again with the quieter noise would never end.
        kept.retain(|i| !outliers.iter().any(|o| o.sample == *i));
        context.expect(units_of_a_fit);
        (found, others) = run(&kept)?;
    }
    Ok(RobustFit {
        fit: found,
        outliers,
        kept,
        inflation: others.inflation,
        left_out: others.position_variance,
    })
}

/// Fits to samples whose poses are seen from the base; `chain` is the nominal one to the first target, `tools` are
/// `joint_n_from_target` of every tool.
///
/// # Errors
/// [`FitError`].
pub fn fit(
    chain: &Poe<f64>,
    tools: Vec<Pose<f64>>,
    coupling: Option<Vec<Vec<f64>>>,
    samples: &[BaseSample],
    options: &ElasticOptions,
    context: &FitContext,
) -> Result<ElasticFit, FitError> {
    let units = solve_units(samples.len());
    let (layout, h) = options.layouts(chain.kinds().len(), tools.len(), samples);
    let mut state = ParametricModel::new(chain, tools, coupling, layout, options.gravity);
    let unit = mean_payload(samples);
    let (hyper, bounds) = h.start_and_bounds(unit);
    let scales = context.phase(setup_units(samples.len()), || {
        let scales = parametric_fit(&mut state, samples, &hyper);
        if options.ripple {
            add_ripple(&mut state, samples, &hyper, scales)
        } else {
            scales
        }
    })?;
    let inputs = inputs_of(&state, samples);
    let hyper = context.phase(SEARCH_UNITS, || {
        let start = (hyper, bounds);
        learn(&state, samples, scales, h, start, options, context)
    })??;
    if !options.processes {
        // The priors that the evidence prefers, and the parameters under them.
        let scales = parametric_fit(&mut state, samples, &hyper);
        return Ok(ElasticFit {
            origin: state.clone(),
            state,
            hyperparameters: hyper,
            layout: h,
            scales,
            inputs,
            solved: None,
        });
    }
    let similarities = inputs.similarities();
    let solve = |state: &mut ParametricModel| -> Option<(Posterior, Linearised)> {
        let linear = state.linearise(samples, scales);
        let groups = state.layout.groups();
        let evidence = MarginalLikelihood {
            linear: &linear,
            groups: &groups,
            inputs: &inputs,
            similarities: &similarities,
            layout: h,
            processes: true,
        };
        let solution = evidence.solve(&hyper)?;
        state.update(&solution.parameters);
        Some((solution, linear))
    };
    let (first, linear) = context
        .phase(units, || solve(&mut state))?
        .ok_or(FitError::Unsolvable)?;
    if options.ripple {
        // What the processes leave is quieter than what the parameters leave: weaker ripple shows.
        let (residuals, jacobian) = left_over(&first, &hyper, &linear);
        let found = significant(&state, samples, &residuals, &jacobian);
        state.add_ripple(&found);
    }
    let origin = state.clone();
    let (solved, _) = context
        .phase(units, || solve(&mut state))?
        .ok_or(FitError::Unsolvable)?;
    Ok(ElasticFit {
        origin,
        state,
        hyperparameters: hyper,
        layout: h,
        scales,
        inputs,
        solved: Some(solved),
    })
}

/// The residual after everything, in units of its noise, σ S⁻¹y, and the Jacobian with the rows' own noise as scale.
fn left_over(
    solved: &Posterior,
    hyper: &[f64],
    linear: &Linearised,
) -> (Vec<[f64; ROWS]>, Mat<f64>) {
    let h = |row: usize| hyper[usize::from(row % ROWS >= 3)];
    let relative = |row: usize| linear.relative_noise(row, h(row));
    let residual = |row: usize| (0.5 * h(row)).exp() * relative(row) * solved.alpha[(row, 0)];
    let residuals = (0..solved.alpha.nrows() / ROWS)
        .map(|k| std::array::from_fn(|i| residual(ROWS * k + i)))
        .collect();
    let jacobian = &linear.jacobian;
    let scaled = Mat::from_fn(jacobian.nrows(), jacobian.ncols(), |row, c| {
        jacobian[(row, c)] / relative(row)
    });
    (residuals, scaled)
}

/// New ripple terms that are significant in `residuals`, which are in units of their noise.
fn significant(
    state: &ParametricModel,
    samples: &[BaseSample],
    residuals: &[[f64; ROWS]],
    jacobian: &Mat<f64>,
) -> Vec<(usize, f64)> {
    let room = MAX_RIPPLE - state.ripple.len();
    // What is left beside a term that is there is its own shadow, not another gear.
    let is_new = |p: &Peak| {
        let same = |r: &RippleTerm<f64>| r.joint == p.joint && (r.cycles - p.cycles).abs() < 1.0;
        !state.ripple.iter().any(same)
    };
    peaks(samples, residuals, jacobian)
        .into_iter()
        .filter(|p| p.drop > SIGNIFICANT && is_new(p))
        .map(|p| (p.joint, p.cycles))
        .take(room)
        .collect()
}

/// The inputs of the processes.
pub fn inputs_of<F>(state: &ParametricModel, samples: &[Sample<F>]) -> Inputs {
    Inputs {
        features: samples.iter().map(|s| state.features(s)).collect(),
        payloads: samples
            .iter()
            .map(|s| s.payload_kg.unwrap_or(0.0))
            .collect(),
        kinds: state.kinds().to_vec(),
    }
}

/// Finds gear ripple until nothing significant is left.
fn add_ripple(
    state: &mut ParametricModel,
    samples: &[BaseSample],
    hyper: &[f64],
    mut scales: NoiseScales,
) -> NoiseScales {
    for _ in 0..4 {
        let linear = state.linearise(samples, scales);
        let residuals = state.residuals(samples, scales);
        let found = significant(state, samples, &residuals, &linear.jacobian);
        if found.is_empty() {
            break;
        }
        state.add_ripple(&found);
        scales = parametric_fit(state, samples, hyper);
    }
    scales
}

/// Hyperparameters of the greatest marginal likelihood, from a part of the poses.
fn learn(
    state: &ParametricModel,
    samples: &[BaseSample],
    scales: NoiseScales,
    layout: HyperLayout,
    (start, mut bounds): (Vec<f64>, Vec<(f64, f64)>),
    options: &ElasticOptions,
    context: &FitContext,
) -> Result<Vec<f64>, Cancelled> {
    let mut order: Vec<usize> = (0..samples.len()).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
    order.truncate(options.hyperparameter_poses);
    let part: Vec<BaseSample> = order.iter().map(|i| samples[*i].clone()).collect();
    let linear = state.linearise(&part, scales);
    let inputs = inputs_of(state, &part);
    let similarities = inputs.similarities();
    let groups = state.layout.groups();
    // Processes explain anything when they are let: the noise is bounded below by what is stated of the instrument, or
    // by half of what the parameters leave. (Five folds of a FARO set: 0.0567 mm without the bound, 0.0547 with it.)
    let floor = 0.25;
    for (i, (bound, scale)) in bounds
        .iter_mut()
        .zip([scales.position, scales.orientation])
        .take(2)
        .enumerate()
    {
        let stated = [scales.quietest.position, scales.quietest.orientation][i];
        let sheet = stated.map(|sigma| (sigma / scale).powi(2));
        bound.0 = sheet.unwrap_or(floor).clamp(1e-4, 1.0).ln();
    }
    let evidence = MarginalLikelihood {
        linear: &linear,
        groups: &groups,
        inputs: &inputs,
        similarities: &similarities,
        layout,
        processes: options.processes,
    };
    Ok(minimize(
        &HyperparameterObjective::new(&evidence),
        &start,
        &bounds,
        &STOP,
        context,
    )?
    .x)
}
