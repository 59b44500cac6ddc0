//! Calibration by touches: estimates the most probable arm for all rows of a touch file, as an ordinary [`Calibration`].
//!
//! The model is a parametric one: the calibrated chain and the gravity terms of its links. The base frame
//! is that of the nominal model, because touches show no other; if the file has rows of a tracker, it is related to the
//! instrument as in any calibration. The tool is the first tip.

pub mod doubted;
pub mod findings;
pub mod mistaken;
pub mod record;
pub mod stepped;
pub mod summary;

use nalgebra::Vector3;
use poegp_protocol::blob::FrameSource;
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tools::{BaseAndTools, with_base_and_tool};
use crate::identification::touch::added::Part;
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::judge::Verdict;
use crate::identification::touch::lengths::{Doubted, StatedLength, doubt, without_distances};
use crate::identification::touch::lost_zero::lost_zero;
use crate::identification::touch::mistakes::explained;
use crate::identification::touch::steps::{Step, contradicting, step};
use crate::identification::touch::unseen::unseen;
use crate::identification::touch::volume::{Knowledge, WorkVolume};
use crate::input_error::InputError;
use crate::learning::elastic::reduced_model::ElasticModel;
use crate::learning::elastic::solution::FitError;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Instrument, InstrumentSample, Sample, in_base_frame};
use crate::measurement::touch::{ClassPrior, TouchSet};
use crate::model::calibration::Calibration;
use crate::model::config::Config;
use crate::model::correction::Correction;
use crate::model::error::CalibrationError;
use crate::model::gauge::{Gauge, GaugeChoice, GaugeFrame, GaugeGrid};
use crate::model::methods::Method;
use crate::model::methods::problem::{FrameEstimate, seen_from_first};
use crate::model::touches::doubted::doubted;
use crate::model::touches::findings::findings;
use crate::model::touches::mistaken::{lost, mistaken};
use crate::model::touches::record::{ArmRecord, NotASisterArm, by_sisters};
use crate::model::touches::stepped::stepped;
use crate::model::touches::summary::TouchSummary;
use crate::numeric::statistics::MEAN_LENGTH;
use crate::robot::Robot;
use crate::trust::{Finding, Findings, Tier};

/// Standard deviations of an arm from its nominal model if neither file nor robot description states them, in m, rad and rad.
pub const USUAL_CLASS: ClassPrior = ClassPrior {
    length: 0.3e-3,
    tilt: 0.5e-3,
    joint_zero: 1e-3,
};

/// Share of the noise, as a variance, above which a length that is not believed explains nothing of it, and share of what it
/// leaves below which a step must leave it to be believed instead.
const LEFT: f64 = 0.75;
const CLEARER: f64 = 0.25;

/// A calibration by touches.
#[derive(Debug)]
pub struct TouchCalibration {
    /// The calibrated model.
    pub calibration: Calibration,
    /// The states of the arm at which touches were made, with the poses that the model predicts for them; the blob's trained
    /// ranges come from them.
    pub samples: Vec<InstrumentSample>,
    /// The fit, for predictions at other poses.
    pub fit: TouchFit,
    /// The record for the calibration of sister arms.
    pub record: ArmRecord,
    /// The summary of the calibration.
    pub summary: TouchSummary,
    /// The findings against the calibration.
    pub findings: Findings,
    /// The stated length that a finding doubts.
    pub doubt: Option<Doubted>,
}

impl TouchCalibration {
    /// Returns the error about a stated distance of `set` that the touches contradict, unless a finding explains why: a step,
    /// another length that is wrong, or a file that has to be read differently.
    pub fn contradiction(&self, set: &TouchSet) -> Option<InputError> {
        // A small step, too, displaces a feature by more than its distance is uncertain.
        let is_explained = |f: &Finding| {
            f.cause == Cause::Step || (f.tier == Tier::Refused && f.cause.is_a_reading())
        };
        let of_length = self.doubt.filter(|d| d.doubt.length != StatedLength::All);
        if of_length.is_some() || self.findings.0.iter().any(is_explained) {
            return None;
        }
        let measured = self.summary.distances.iter().map(|d| {
            d.measured_mm
                .map(|[found, sigma]| (1e-3 * found, 1e-3 * sigma))
        });
        set.contradiction(&measured.collect::<Vec<_>>())
    }
}

/// Returns the standard deviations of an arm from its nominal model: those of the features file, otherwise those of the
/// robot's description, otherwise [`USUAL_CLASS`].
pub fn class_of(robot: &Robot, set: &TouchSet) -> ClassPrior {
    set.prior.or(robot.prior).unwrap_or(USUAL_CLASS)
}

/// Calibrates `robot` from the touches of `set`, with base and tool as `gauge` says.
pub fn calibrate_touches(
    robot: &Robot,
    set: &TouchSet,
    config: &Config,
    gauge: &GaugeChoice,
) -> Result<TouchCalibration, CalibrationError> {
    let found = calibrate_beside_sisters(robot, set, config, gauge, &[])?;
    Ok(found.expect("no sister is refused"))
}

/// Calibrates as [`calibrate_touches`] does, with the records of `sisters` as additional prior information.
///
/// # Errors
/// [`CalibrationError`]; the inner error is the index of a record that cannot be used for this arm, and why.
pub fn calibrate_beside_sisters(
    robot: &Robot,
    set: &TouchSet,
    config: &Config,
    gauge: &GaugeChoice,
    sisters: &[ArmRecord],
) -> Result<Result<TouchCalibration, (usize, NotASisterArm)>, CalibrationError> {
    let nominal = robot.chain()?;
    let gravity = Vector3::from(config.gravity_m_s2);
    let class = class_of(robot, set);
    let mut problem = TouchProblem::new(set, &nominal, robot.coupling.clone(), gravity, class);
    match by_sisters(&problem, sisters) {
        Ok(prior) => problem.sisters = prior,
        Err(refused) => return Ok(Err(refused)),
    }
    let nominal_arm = TouchFit::on_nominal(&problem, 0);
    let mut fit = TouchFit::new(&problem, &nominal_arm);
    if let Some((joint, without)) = lost_zero(&problem, &nominal_arm, &fit) {
        (problem.lost_zero, fit) = (Some(joint), without);
    }
    // A false length looks like a step, and a step like a false length: that with which the rows are more probable is believed.
    let doubt = doubt(&problem, &nominal_arm, &fit);
    let is_more = |step: &Step| {
        let by_length = doubt.map(|doubted| doubted.explained);
        let by_length = by_length.or_else(|| without_distances(&problem, &fit));
        by_length.is_none_or(|length| match step.part {
            Part::Feature(_) => step.gain > length.gain,
            // In a file that is sorted by feature, what else moves explains what a wrong distance does.
            _ => length.left > LEFT || step.fall.powi(2) < CLEARER * length.left,
        })
    };
    let step = step(&problem, &fit).filter(is_more);
    let doubt = doubt.filter(|_| step.is_none());
    // A distance that is wrong by itself is an error of the file: [`TouchCalibration::contradiction`].
    let is_alone =
        |d: &Doubted| d.or.is_none() && matches!(d.doubt.length, StatedLength::Distance(_));
    let doubt = doubt.filter(|doubted| !is_alone(doubted));
    if doubt.is_none() && step.is_none() {
        fit = without_single(&problem, fit);
    }
    let unsolvable = || CalibrationError::from(FitError::Unsolvable);
    let volume = WorkVolume::new(robot, &problem);
    let known = Knowledge::new(&problem, &fit, &volume).ok_or_else(unsolvable)?;
    let verdict = Verdict::new(&problem, &nominal_arm, &fit, &known).ok_or_else(unsolvable)?;
    let record = ArmRecord::new(&problem, &fit).ok_or_else(unsolvable)?;
    let unseen = unseen(&problem, &fit, &known);
    let summary = TouchSummary::new(&problem, (&nominal_arm, &fit), &known, &verdict, unseen);
    // One false length by itself explains a scatter better than a mistake of the joints.
    let is_length =
        (doubt.as_ref()).is_some_and(|doubted| doubted.doubt.length != StatedLength::All);
    let mistake = explained(robot, &problem, (&nominal_arm, &fit))
        .filter(|found| !is_length || !found.mistake.is_of_joints());
    let findings = match mistake {
        // What else is remarkable follows from the mistake.
        Some(mistake) => Findings(vec![mistaken(robot, &mistake)]),
        None => {
            let mut findings = findings(&summary);
            findings.0.extend(lost(robot, &problem, &fit));
            findings
                .0
                .extend(doubt.as_ref().map(|doubt| doubted(set, doubt)));
            let nominal_mm = summary.before.mean_mm;
            if let Some(step) = step.map(|step| stepped(set, &step, nominal_mm)) {
                if step.tier == Tier::Refused {
                    // What else is remarkable follows from the step.
                    findings.0.retain(|f| f.tier == Tier::Refused);
                }
                findings.0.insert(0, step);
            }
            findings.accept(&[]);
            findings
        }
    };
    let (calibration, samples) = stated(robot, &problem, &fit, (&known, &volume), config, gauge)?;
    Ok(Ok(TouchCalibration {
        calibration,
        samples,
        fit,
        record,
        summary,
        findings,
        doubt,
    }))
}

/// Refits without single rows that contradict all others.
fn without_single(problem: &TouchProblem, fit: TouchFit) -> TouchFit {
    let alone = contradicting(problem, &fit);
    if alone.iter().all(|row| fit.weights[*row] == 0.0) {
        return fit;
    }
    let mut weights = fit.weights.clone();
    for row in alone {
        weights[row] = 0.0;
    }
    fit.weighted(problem, &weights)
}

/// Converts a fit into a [`Calibration`] and its samples.
fn stated(
    robot: &Robot,
    problem: &TouchProblem,
    fit: &TouchFit,
    (known, volume): (&Knowledge, &WorkVolume),
    config: &Config,
    gauge: &GaugeChoice,
) -> Result<(Calibration, Vec<InstrumentSample>), CalibrationError> {
    let nominal = &problem.nominal;
    let flange = nominal.frames()[nominal.kinds().len()];
    let instrument = fit
        .scene
        .instrument
        .map_or(Pose::identity(), |(pose, _)| pose);
    // The last tool, after the tips, is the flange itself, which levels and cameras are mounted to.
    let tips = problem.set.tips.len();
    let tools = &fit.arm.model.tools[..tips.max(1)];
    let flange_from_targets: Vec<Pose<f64>> =
        tools.iter().map(|tool| flange.inverse() * *tool).collect();
    let calibrated = fit.arm.model.chain(0);
    let mut samples: Vec<InstrumentSample> = problem
        .states
        .iter()
        .map(|state| InstrumentSample {
            payload_kg: state.payload_kg,
            // Readings of the flange itself are stated for the first tip.
            tool: if state.tool < tips { state.tool } else { 0 },
            ..Sample::new(
                state.joints.clone(),
                state.serial_joints.clone(),
                Observation::Pose(Pose::identity()),
                Instrument,
            )
        })
        .collect();
    let model = ElasticModel::parametric(
        &fit.arm.model,
        &in_base_frame(&samples, &Pose::identity()),
        problem.coupling.as_ref(),
        known.tau,
    )
    .ok_or(FitError::Unsolvable)?;
    let frame = |pose| GaugeFrame {
        pose,
        source: FrameSource::Poses,
    };
    let mut out = Calibration {
        config: Config {
            method: Method::Parametric,
            ripple: false,
            curve: false,
            ..*config
        },
        gauge: Gauge {
            grid: GaugeGrid::new(robot, &samples),
            base: frame(instrument),
            tool: frame(flange_from_targets[0]),
        },
        nominal: with_base_and_tool(nominal, &Pose::identity(), &flange_from_targets[0]),
        tools: seen_from_first(tools),
        base_and_tools: BaseAndTools {
            instrument_from_base: instrument,
            flange_from_targets,
        },
        calibrated,
        correction: Correction::Elastic(Box::new(model)),
        estimate: FrameEstimate::Parametric {
            uncertainty: None,
            parameters: None,
        },
        outliers: Vec::new(),
        warm_up: None,
        constant_deviation: (1e-3 * known.after.mean_mm / MEAN_LENGTH, 0.0),
        correction_limit: (0.0, 0.0),
    };
    for sample in &mut samples {
        sample.observation = Observation::Pose(instrument * out.predict(sample));
    }
    // The corrections at the touches alone would be too small a limit for the rest of the work volume.
    let mut states = in_base_frame(&samples, &instrument);
    states.extend_from_slice(&volume.states);
    out.correction_limit = out.limit(&states);
    let over_grid = GaugeChoice {
        over_grid: true,
        ..gauge.clone()
    };
    out = out.in_gauge(robot, &over_grid)?;
    if fit.scene.instrument.is_none() {
        // No instrument measured another base, so the base is the nominal model's.
        let base = out.base_and_tools.instrument_from_base;
        let drawn = base.inverse();
        for sample in &mut samples {
            sample.observation = sample.observation.transformed(&drawn);
        }
        out.base_and_tools.instrument_from_base = Pose::identity();
        out.gauge.base.pose = Pose::identity();
    }
    Ok((out, samples))
}
