//! Calibration: base and tools on the nominal robot, then one of the [`methods`].
//!
//! All measurements are moved into the base frame of the base-tool fit first, and every later step works there: the
//! device then has small numbers (f32 resolves 0.24 µm at 3 m), and "base" and "flange" keep a meaning for the
//! controller. A [`Calibration`] is the model in `f64`; [`crate::blob::write`] turns it into a blob.

mod calibration;
pub mod config;
pub mod correction;
mod error;
pub mod frame_changes;
pub mod identified;
pub mod methods;

use poegp_runtime::math::se3::Pose;

pub use crate::model::calibration::Calibration;
pub use crate::model::error::CalibrationError;
pub use crate::model::methods::Method;

use crate::identification::base_tool::with_base_and_tool;
use crate::identification::base_tools::fit_base_and_tools;
use crate::learning::task_space::fit::SignalVarianceLimit;
use crate::measurement::sample::{InstrumentSample, in_base_frame};
use crate::model::config::Config;
use crate::model::methods::problem::{Problem, has_single_tool_full_poses};
use crate::progress::FitContext;
use crate::robot::Robot;

/// Calibrates `robot` with samples whose poses are `instrument_from_target`.
///
/// # Errors
/// [`CalibrationError`].
pub fn calibrate(
    robot: &Robot,
    samples: &[InstrumentSample],
    config: &Config,
    context: &FitContext,
) -> Result<Calibration, CalibrationError> {
    calibrate_within(
        robot,
        samples,
        config,
        &SignalVarianceLimit::HIGHEST,
        context,
    )
}

/// [`calibrate`] with a limit on the signal variance of the task-space process.
pub(crate) fn calibrate_within(
    robot: &Robot,
    samples: &[InstrumentSample],
    config: &Config,
    signal_variance: &SignalVarianceLimit,
    context: &FitContext,
) -> Result<Calibration, CalibrationError> {
    check(robot, samples, config.method)?;
    let nominal = robot.chain()?;
    let base_and_tools = fit_base_and_tools(&nominal, samples);
    let flange = *nominal.frames().last().unwrap_or(&Pose::identity());
    let targets = &base_and_tools.flange_from_targets;
    let problem = Problem {
        nominal: with_base_and_tool(&nominal, &Pose::identity(), &targets[0]),
        tools: targets.iter().map(|t| flange * *t).collect(),
        coupling: robot.coupling.as_ref(),
        samples: in_base_frame(samples, &base_and_tools.instrument_from_base)
            .into_iter()
            .map(|s| s.with_noise(config.instrument_noise()))
            .collect(),
        weighting: config.weighting,
        hyperparameters: config.hyperparameters,
        signal_variance,
        elastic: config.elastic(),
    };
    let fit = config.method.implementation().fit(&problem, context)?;
    let mut out = Calibration {
        config: *config,
        base_and_tools,
        tools: fit.tools,
        nominal: problem.nominal,
        calibrated: fit.chain,
        correction: fit.correction,
        estimate: fit.estimate,
        residual_rms: (0.0, 0.0),
        correction_limit: (0.0, 0.0),
    };
    out.correction_limit = out.limit(&problem.samples);
    out.residual_rms = out.rms(&problem.samples);
    Ok(out)
}

/// Rejects data that the method cannot use.
fn check(
    robot: &Robot,
    samples: &[InstrumentSample],
    method: Method,
) -> Result<(), CalibrationError> {
    let joints = robot.joints.len();
    let needed = method.min_poses(joints);
    if samples.len() < needed {
        return Err(CalibrationError::TooFewPoses {
            found: samples.len(),
            needed,
            parameters: method.parameters(joints),
            method: method.name(),
        });
    }
    let requires = method.requires();
    if requires.single_tool_full_poses && !has_single_tool_full_poses(samples) {
        return Err(CalibrationError::OneToolOnly {
            method: method.name(),
        });
    }
    if requires.payload && samples.iter().any(|s| s.payload_kg.is_none()) {
        return Err(CalibrationError::NoPayload);
    }
    Ok(())
}
