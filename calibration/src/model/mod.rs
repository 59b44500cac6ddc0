//! Calibration: fits base and tools on the nominal robot, then applies one of the [`methods`].
//!
//! The base-tool fit comes first. All measurements are then transformed into its base frame, and every later step works in
//! that frame: the device then has small numbers (f32 resolves 0.24 µm at 3 m), and "base" and "flange" keep their meaning
//! for the controller. The finished model may be stated in another [`gauge`]. A [`Calibration`] is the model in `f64`;
//! [`crate::blob::write`] turns it into a blob.

mod calibration;
pub mod config;
pub mod correction;
mod error;
pub mod frame_changes;
pub mod gauge;
mod gauge_fit;
pub mod identified;
pub mod methods;
pub mod touches;

use poegp_protocol::blob::FrameSource;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

pub use crate::model::calibration::Calibration;
pub use crate::model::error::CalibrationError;
pub use crate::model::methods::Method;

use crate::identification::base_tools::{
    BaseAndTools, fit_base_and_tools, tool_count, with_base_and_tool,
};
use crate::identification::parametric::gear_line::GearLine;
use crate::learning::elastic::fit::setup_units;
use crate::learning::elastic::options::OutlierPolicy;
use crate::learning::elastic::outliers::Outlier;
use crate::learning::task_space::fit::SignalVarianceLimit;
use crate::measurement::repeats::Repeats;
use crate::measurement::sample::{InstrumentSample, different_poses, in_base_frame};
use crate::memory;
use crate::model::config::Config;
use crate::model::gauge::{Gauge, GaugeFrame, GaugeGrid};
use crate::model::methods::problem::{Problem, has_whole_poses};
use crate::progress::FitContext;
use crate::robot::Robot;

/// Calibrates `robot` with samples whose poses are `instrument_from_target`.
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

/// Calibrates as [`calibrate`] does, with a limit on the signal variance of the task-space process.
pub(crate) fn calibrate_within(
    robot: &Robot,
    samples: &[InstrumentSample],
    config: &Config,
    signal_variance: &SignalVarianceLimit,
    context: &FitContext,
) -> Result<Calibration, CalibrationError> {
    let tools = tool_count(samples);
    check(robot, samples, tools, config.method)?;
    check_memory(samples.len(), config, memory::available())?;
    let nominal = robot.chain()?;
    let (mut base_and_tools, mut problem) =
        posed(robot, &nominal, samples, config, signal_variance);
    let units = setup_units(samples.len());
    context.expect(units);
    let found = context.phase(units, || problem.gross_outliers())?;
    let mut outliers = problem.of_measurements(&found);
    let mut kept: Vec<usize> = (0..samples.len()).collect();
    if config.outliers == OutlierPolicy::Reject && !outliers.is_empty() {
        kept.retain(|i| !outliers.iter().any(|o| o.sample == *i));
        let samples: Vec<InstrumentSample> = kept.iter().map(|i| samples[*i].clone()).collect();
        check(robot, &samples, tools, config.method)?;
        (base_and_tools, problem) = posed(robot, &nominal, &samples, config, signal_variance);
    }
    let fit = config.method.implementation().fit(&problem, context)?;
    for outlier in problem.of_measurements(&fit.outliers) {
        let sample = kept[outlier.sample];
        if !outliers.iter().any(|o| o.sample == sample) {
            outliers.push(Outlier { sample, ..outlier });
        }
    }
    outliers.sort_by_key(|o| o.sample);
    let frame = |pose, source| GaugeFrame { pose, source };
    let has_orientations = samples.iter().any(|s| s.observation.has_orientation());
    let of_tool = match has_orientations {
        true => FrameSource::Poses,
        false => FrameSource::Positions,
    };
    let mut out = Calibration {
        config: *config,
        gauge: Gauge {
            grid: GaugeGrid::new(robot, samples),
            base: frame(base_and_tools.instrument_from_base, FrameSource::Poses),
            tool: frame(base_and_tools.flange_from_targets[0], of_tool),
        },
        base_and_tools,
        tools: fit.tools,
        nominal: problem.nominal,
        calibrated: fit.chain,
        correction: fit.correction,
        estimate: fit.estimate,
        outliers,
        warm_up: fit.warm_up,
        constant_deviation: (0.0, 0.0),
        correction_limit: (0.0, 0.0),
    };
    let samples = match out.removed_warm_up() {
        Some(warm_up) => problem
            .repeats
            .means(&warm_up.removed_from(&problem.measurements)),
        None => problem.samples,
    };
    out.correction_limit = out.limit(&samples);
    out.constant_deviation = out.constant_deviation_of(&samples);
    Ok(out)
}

/// Returns the indices of the gross outliers of `samples`, which no geometry explains, if `config` rejects outliers.
pub(crate) fn rejected_gross_outliers(
    robot: &Robot,
    samples: &[InstrumentSample],
    config: &Config,
) -> Vec<usize> {
    let (OutlierPolicy::Reject, Ok(nominal)) = (config.outliers, robot.chain()) else {
        return Vec::new();
    };
    let limit = SignalVarianceLimit::HIGHEST;
    let (_, problem) = posed(robot, &nominal, samples, config, &limit);
    let found = problem.of_measurements(&problem.gross_outliers());
    found.iter().map(|o| o.sample).collect()
}

/// Fits base and tools on the nominal arm and returns them with the remaining fit problem: `samples` seen from that base.
fn posed<'a>(
    robot: &'a Robot,
    nominal: &Poe<f64>,
    samples: &[InstrumentSample],
    config: &Config,
    signal_variance: &'a SignalVarianceLimit,
) -> (BaseAndTools, Problem<'a>) {
    let mut base_and_tools = fit_base_and_tools(nominal, samples);
    let predicted = base_and_tools.predict(nominal, samples);
    let repeats = Repeats::of(samples, &predicted, nominal.kinds());
    let known = |s: &InstrumentSample| s.clone().with_noise(config.instrument_noise());
    let samples: Vec<InstrumentSample> = samples.iter().map(known).collect();
    let samples = repeats.with_scatter(&samples);
    let means = repeats.means(&samples);
    if means.len() < samples.len() {
        base_and_tools = fit_base_and_tools(nominal, &means);
    }
    let base = &base_and_tools.instrument_from_base;
    let (means, measurements) = (in_base_frame(&means, base), in_base_frame(&samples, base));
    let flange = *nominal.frames().last().unwrap_or(&Pose::identity());
    let targets = &base_and_tools.flange_from_targets;
    let problem = Problem {
        nominal: with_base_and_tool(nominal, &Pose::identity(), &targets[0]),
        tools: targets.iter().map(|t| flange * *t).collect(),
        coupling: robot.coupling.as_ref(),
        gear_lines: gear_lines(robot),
        samples: means,
        measurements,
        repeats,
        weighting: config.weighting,
        hyperparameters: config.hyperparameters,
        signal_variance,
        elastic: config.elastic(),
    };
    (base_and_tools, problem)
}

/// Returns the gear lines that the description of `robot` states.
fn gear_lines(robot: &Robot) -> Vec<GearLine> {
    let mut out = Vec::new();
    for (joint, of) in robot.joints.iter().enumerate() {
        out.extend(
            of.gear_lines
                .iter()
                .map(|cycles| GearLine::stated(joint, *cycles)),
        );
    }
    out
}

/// Rejects a fit that needs more memory than is available, before it starts; accepts every fit if `available` is `None`.
fn check_memory(
    found: usize,
    config: &Config,
    available: Option<u64>,
) -> Result<(), CalibrationError> {
    const MB: u64 = 1_000_000;
    let needed = config.method.memory(found, config.hyperparameters);
    match available {
        Some(available) if needed > available => Err(CalibrationError::TooLittleMemory {
            found,
            needed_mb: needed.div_ceil(MB),
            available_mb: available / MB,
            method: config.method.name(),
        }),
        _ => Ok(()),
    }
}

/// Rejects data that the method cannot use.
fn check(
    robot: &Robot,
    samples: &[InstrumentSample],
    tools: usize,
    method: Method,
) -> Result<(), CalibrationError> {
    let is_measured = |tool: &usize| samples.iter().any(|s| s.tool == *tool);
    if let Some(tool) = (0..tools).find(|tool| !is_measured(tool)) {
        return Err(CalibrationError::NoPoseOfTool { tool: tool + 1 });
    }
    let joints = robot.joints.len();
    let (found, needed) = (different_poses(samples), method.min_poses(joints));
    if found < needed {
        return Err(CalibrationError::TooFewPoses {
            found,
            needed,
            parameters: method.parameters(joints),
            method: method.name(),
        });
    }
    if let Some(most) = method.max_poses().filter(|most| samples.len() > *most) {
        return Err(CalibrationError::TooManyPoses {
            found: samples.len(),
            most,
            method: method.name(),
        });
    }
    let requires = method.requires();
    if requires.whole_poses && !has_whole_poses(samples) {
        return Err(CalibrationError::PositionsAlone {
            method: method.name(),
        });
    }
    if requires.payload && samples.iter().any(|s| s.payload_kg.is_none()) {
        return Err(CalibrationError::NoPayload);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_that_does_not_fit_into_memory_is_refused_with_the_numbers() {
        let config = Config::new(Method::PoeGp);
        let text = |available| match check_memory(4000, &config, available) {
            Ok(()) => "ok".to_owned(),
            Err(error) => error.to_string(),
        };
        assert_eq!(text(None), "ok");
        assert_eq!(text(Some(2_000_000_000)), "ok");
        assert_eq!(
            text(Some(500_000_000)),
            "4000 poses: `poe-gp` needs about 1064 MB of memory for them, and 500 MB are free"
        );
        // The dense solution of the elastic model does not grow with the poses.
        let elastic = |poses| Method::Elastic.memory(poses, config.hyperparameters);
        assert!(elastic(12_000) < elastic(800) + 200_000_000);
    }
}
