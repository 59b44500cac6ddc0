//! The elastic model: the chain, gravity terms, own-joint curves, gear ripple and joint processes, solved together.

use crate::identification::parametric::state::ROWS;
use crate::learning::elastic::device_variance::device_variance;
use crate::learning::elastic::fit::{DENSE_POSES, fit_robust, solve_units};
use crate::learning::elastic::options::{ElasticOptions, NominalArm, WarmUpPolicy};
use crate::learning::elastic::predictive_variance::Uncertainty;
use crate::learning::elastic::reduced_model::ElasticModel;
use crate::learning::elastic::solution::FitError;
use crate::learning::elastic::variance_inflation::RefitSpec;
use crate::learning::elastic::warm_up::WarmUp;
use crate::learning::task_space::fit::HyperparameterSharing;
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::sample::BaseSample;
use crate::model::correction::Correction;
use crate::model::error::CalibrationError;
use crate::model::methods::problem::{
    CalibrationMethod, FOR_A_POSE, Fit, FrameEstimate, Problem, seen_from_first,
};
use crate::progress::FitContext;

/// Method that fits the elastic model, or its parameters alone, as the options say.
pub struct Elastic;

/// Number of matrices of the dense solution that a fit holds at the same time: 663 MB were measured at 800 poses.
const MATRICES: u64 = 4;

impl CalibrationMethod for Elastic {
    fn memory(&self, poses: usize, _: HyperparameterSharing) -> u64 {
        let rows = (ROWS * poses.min(DENSE_POSES)) as u64;
        8 * MATRICES * rows * rows + FOR_A_POSE * poses as u64
    }

    fn fit(&self, problem: &Problem, context: &FitContext) -> Result<Fit, CalibrationError> {
        fit_elastic(problem, &problem.elastic, context)
    }
}

/// Fits the elastic model with the given options.
pub(super) fn fit_elastic(
    problem: &Problem,
    options: &ElasticOptions,
    context: &FitContext,
) -> Result<Fit, CalibrationError> {
    let (coupling, samples) = (problem.coupling, &problem.samples);
    let arm = NominalArm {
        chain: problem.nominal,
        tools: problem.tools.clone(),
        coupling: coupling.cloned(),
        gear_lines: problem.gear_lines.clone(),
    };
    let mut robust = fit_robust(&arm, samples, options, context)?;
    let dense = some(samples, &robust.dense);
    let rows = |pose: &usize| some(&problem.measurements, problem.repeats.rows(*pose));
    let measurements: Vec<Vec<BaseSample>> = robust.dense.iter().map(rows).collect();
    let mut warm_up = WarmUp::estimate(&robust.fit, &dense, &measurements);
    let mut without = None;
    if let Some(found) = &mut warm_up
        && options.warm_up == WarmUpPolicy::Remove
    {
        found.report.removed = true;
        let corrected = found.removed_from(&problem.measurements);
        let corrected = problem.repeats.means(&corrected);
        robust = fit_robust(&arm, &corrected, options, context)?;
        without = Some(corrected);
    }
    let samples = without.as_ref().unwrap_or(samples);
    let (dense, kept) = (some(samples, &robust.dense), some(samples, &robust.kept));
    let model = context.phase(solve_units(dense.len()), || {
        ElasticModel::new(&mut robust.fit, &dense, &kept, coupling, options)
    })?;
    let mut model = model.ok_or(FitError::Unsolvable)?;
    let (chain, tools) = (
        robust.fit.state.chain(0),
        seen_from_first(&robust.fit.state.tools),
    );
    let parameters = robust.fit.effective_parameters;
    let refit = RefitSpec {
        arm,
        options: *options,
    };
    let of_rows = |pose: &usize| InstrumentNoise::rms_over(&rows(pose));
    let of_rows: Vec<InstrumentNoise> = robust.dense.iter().map(of_rows).collect();
    let uncertainty = Uncertainty::new(robust.fit, &dense, robust.inflation);
    let uncertainty = uncertainty.map(|u| u.with_noise_of_rows(&of_rows).with_refit(refit));
    let uncertainty = uncertainty.map(Box::new);
    if let Some(uncertainty) = &uncertainty {
        model
            .report
            .add_to_noise(uncertainty.posterior().excess_of_rows());
    }
    if options.device_variance
        && options.processes
        && let Some(uncertainty) = &uncertainty
    {
        model.sigma = device_variance(
            uncertainty.posterior(),
            &robust.left_out,
            uncertainty.inflation()[0],
            model.coupling.as_ref(),
        );
    }
    Ok(Fit {
        chain,
        tools,
        correction: Correction::Elastic(Box::new(model)),
        estimate: FrameEstimate::Parametric {
            uncertainty,
            parameters,
        },
        outliers: robust.outliers,
        warm_up,
    })
}

fn some(samples: &[BaseSample], part: &[usize]) -> Vec<BaseSample> {
    part.iter().map(|i| samples[*i].clone()).collect()
}
