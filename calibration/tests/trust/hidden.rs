//! Decides from a file's own numbers which mistakes cannot be seen in it.

use poegp_calibration::identification::base_tools::{BaseAndTools, fit_base_and_tools};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::numeric::statistics::percentile;
use poegp_calibration::robot::Robot;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::mistakes::{HiddenBy, Mistake};
use crate::sets::{Good, read};
use crate::table::Table;

/// Length in mm that converts an angle in radians.
const LEVER_MM: f64 = 333.0;
/// Base and tool absorb a mistake if the residuals are less than this many times those of the right file.
const ABSORBED: f64 = 2.0;
/// The same ratio for a narrow grid, where the geometry fits the remainder to the noise.
const ABSORBED_NARROW: f64 = 20.0;
/// The sag of wrong payloads is visible if it is at least this many scatters of one component.
const VISIBLE_SAG: f64 = 4.0;
/// A knock of a joint is visible if it is at least this many scatters of one component.
const VISIBLE: f64 = 3.0;
/// Sag of a simulated arm in mm, per kilogram and per squared metre of its lever.
const SAG: f64 = 0.137;
/// Lever of an arm in the middle of its range, as a share of its length.
const LEVER: f64 = 0.45;

/// The samples of a file, with base and tools fitted to the nominal arm. `new` returns `None` if the reader refuses the file.
struct Fitted {
    samples: Vec<InstrumentSample>,
    chain: Poe<f64>,
    ends: BaseAndTools,
}

impl Fitted {
    fn new(robot: &Robot, text: &str) -> Option<Self> {
        let set = read(robot, text).ok()?;
        let samples = samples(&set, robot, &mut Vec::new()).ok()?;
        let chain = robot.chain().ok()?;
        let ends = fit_base_and_tools(&chain, &samples);
        Some(Self {
            samples,
            chain,
            ends,
        })
    }

    /// Returns the target of the nominal arm in the instrument's frame.
    fn pose(&self, sample: &InstrumentSample) -> Pose<f64> {
        let flange = self.chain.forward(&sample.serial_joints);
        self.ends.instrument_from_base * flange * self.ends.flange_from_targets[sample.tool]
    }

    /// Returns the median distance in mm between `samples` and the nominal arm at these joints.
    fn apart_mm(&self, samples: impl Iterator<Item = InstrumentSample>) -> f64 {
        let error = |(s, other): (&InstrumentSample, InstrumentSample)| {
            let error = other.observation.error(&self.pose(s));
            error.position_mm + 1e-3 * LEVER_MM * error.orientation_mrad.unwrap_or(0.0)
        };
        let mut errors: Vec<f64> = self.samples.iter().zip(samples).map(error).collect();
        errors.sort_by(f64::total_cmp);
        percentile(&errors, 0.5)
    }

    /// Returns the samples with the poses of the nominal arm.
    fn nominal(&self) -> impl Iterator<Item = InstrumentSample> {
        self.samples.iter().map(|s| {
            let pose = self.pose(s);
            let observation = match s.observation {
                Observation::Pose(_) => Observation::Pose(pose),
                Observation::Position(_) => Observation::Position(pose.translation),
            };
            InstrumentSample {
                observation,
                ..s.clone()
            }
        })
    }
}

/// Returns the median residual in mm after base and tool are fitted to a file.
pub fn left_mm(robot: &Robot, text: &str) -> Option<f64> {
    let fitted = Fitted::new(robot, text)?;
    Some(fitted.apart_mm(fitted.samples.iter().cloned()))
}

/// Returns by how much the wrong joints of the last quarter of the rows move the target of the nominal arm, mm.
fn moved_mm(good: &Good, wrong: &Table) -> Option<f64> {
    let mut fitted = Fitted::new(&good.robot, &good.text(&good.table))?;
    let last = good.table.len() * 3 / 4;
    let rows: Vec<InstrumentSample> = fitted.nominal().skip(last).collect();
    fitted.samples.drain(..last);
    for (row, sample) in (last..).zip(&mut fitted.samples) {
        sample.serial_joints = good.robot.serial_joints(&wrong.joints_rad(row));
    }
    Some(fitted.apart_mm(rows.into_iter()))
}

/// Returns why a mistake is not counted, or `None` if it is.
pub fn reason(
    good: &Good,
    good_left_mm: f64,
    mistake: &Mistake,
    wrong: &Table,
) -> Option<&'static str> {
    if mistake.unseen.is_some() {
        return mistake.unseen;
    }
    match mistake.hidden_by? {
        HiddenBy::BaseAndTool => {
            let robot = mistake.robot.as_ref().unwrap_or(&good.robot);
            let left = left_mm(robot, &good.text(wrong))?;
            if good.is_narrow() {
                let is_absorbed = left < ABSORBED_NARROW * good_left_mm;
                return is_absorbed.then_some("base, tool and a narrow grid absorb it");
            }
            (left < ABSORBED * good_left_mm).then_some("base and tool absorb it")
        }
        HiddenBy::Lever => {
            let moved = moved_mm(good, wrong)?;
            (moved < VISIBLE * good.scatter_mm)
                .then_some("the joint moves the target by too little")
        }
        HiddenBy::Scatter => {
            let is_small = payload_change_mm(good, wrong) < VISIBLE_SAG * good.scatter_mm;
            (good.is_simulated() && is_small).then_some("the arm sags by less than the scatter")
        }
    }
}

/// Returns the RMS change of the target of a simulated arm due to the changed payloads, mm.
fn payload_change_mm(good: &Good, wrong: &Table) -> f64 {
    let column = good.table.column("payload_kg").expect("payloads");
    let (old, new) = (good.table.numbers(column), wrong.numbers(column));
    let change: f64 = old.iter().zip(&new).map(|(a, b)| (a - b).powi(2)).sum();
    let lever = LEVER * good.reach();
    SAG * lever * lever * (change / old.len() as f64).sqrt()
}
