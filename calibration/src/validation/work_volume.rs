//! The error to be expected all over the measured ranges of the joints, in millimetres.

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use crate::measurement::observation::Observation;
use crate::measurement::sample::{Instrument, InstrumentSample, Sample};
use crate::model::identified::prediction_covariance;
use crate::model::{Calibration, Method};
use crate::numeric::statistics::{Summary, extremes};
use crate::robot::Robot;
use crate::trust::{Finding, Tier};
use crate::validation::model_selection::{Choice, Row};

/// Number of configurations drawn from the measured ranges ([`POSES`]), and of errors drawn for each (`DRAWS`).
pub const POSES: usize = 64;
const DRAWS: usize = 50;

/// Expected position error of a new measurement anywhere in the measured ranges of the joints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExpectedError {
    /// Mean of the expected errors over all configurations and draws, mm.
    pub mean_mm: f64,
    /// Expected error that 95 % of the errors do not exceed, mm.
    pub p95_mm: f64,
}

/// Random configurations in the measured ranges of the joints, with random errors of each in units of its standard
/// deviation.
#[derive(Clone, Debug)]
pub struct WorkVolume {
    /// Measured ranges of the controller's joints, rad or m.
    pub ranges: Vec<(f64, f64)>,
    /// Whole poses at random configurations, each with the payload and the tool of a random measured row.
    pub poses: Vec<InstrumentSample>,
    draws: Vec<Vec<Vector3<f64>>>,
}

impl WorkVolume {
    /// Draws configurations and errors for the ranges that the measured rows span.
    pub fn new(robot: &Robot, samples: &[InstrumentSample]) -> Self {
        let range = |joint: usize| extremes(samples.iter().map(|s| s.joints[joint]));
        let ranges: Vec<(f64, f64)> = (0..robot.joints.len()).map(range).collect();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let (mut poses, mut draws) = (Vec::with_capacity(POSES), Vec::with_capacity(POSES));
        for _ in 0..POSES {
            let of = |(least, most): &(f64, f64)| least + (most - least) * random.random::<f64>();
            let joints: Vec<f64> = ranges.iter().map(of).collect();
            let row = &samples[random.random_range(0..samples.len())];
            poses.push(like(row, robot, joints));
            let mut normal = |_| Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
            draws.push((0..DRAWS).map(&mut normal).collect());
        }
        Self {
            ranges,
            poses,
            draws,
        }
    }

    /// Computes the expected error for these standard deviations of the positions, in m.
    pub fn expected(&self, deviations: &[[f64; 3]]) -> ExpectedError {
        let errors = self
            .draws
            .iter()
            .zip(deviations)
            .flat_map(|(draws, sigma)| {
                let error =
                    |draw: &Vector3<f64>| 1e3 * draw.component_mul(&Vector3::from(*sigma)).norm();
                draws.iter().map(error)
            });
        let summary = Summary::new(&errors.collect::<Vec<_>>());
        ExpectedError {
            mean_mm: summary.mean,
            p95_mm: summary.p95,
        }
    }
}

/// Creates a whole pose at these joints (rad or m) that is otherwise like a measured row.
pub fn like(row: &InstrumentSample, robot: &Robot, joints: Vec<f64>) -> InstrumentSample {
    let serial_joints = robot.serial_joints(&joints);
    let observation = Observation::Pose(Pose::identity());
    Sample {
        payload_kg: row.payload_kg,
        tool: row.tool,
        declared_noise: row.declared_noise,
        ..Sample::new(joints, serial_joints, observation, Instrument)
    }
}

impl ExpectedError {
    /// Estimates the error of `calibration`, which was made from `samples`, from its own standard deviation at random
    /// configurations; but no less than the held-out errors of `choice`, which are of configurations like those of the
    /// samples. A model whose standard deviation is the same everywhere has these alone. Returns `None` without either.
    pub fn new(
        calibration: &Calibration,
        robot: &Robot,
        samples: &[InstrumentSample],
        choice: Option<&Choice>,
    ) -> Option<Self> {
        if !calibration.has_local_deviation() {
            return Self::of_held_out(choice);
        }
        let volume = WorkVolume::new(robot, samples);
        let anywhere = match prediction_covariance(calibration, robot, samples, &volume.poses) {
            Some(known) => volume.expected(&known.deviations(0..POSES)),
            None => {
                let of = |pose: &InstrumentSample| {
                    let [x, y, z, ..] = calibration.standard_deviation(pose)?;
                    Some([x, y, z])
                };
                let deviations: Option<Vec<[f64; 3]>> = volume.poses.iter().map(of).collect();
                volume.expected(&deviations?)
            }
        };
        Some(anywhere.at_least(choice))
    }

    /// Warns if the model is worse than the nominal arm where the joints are combined in other ways than measured; `table` are
    /// the candidates of the choice.
    pub fn finding(&self, table: &[Row]) -> Option<Finding> {
        let chosen = table.iter().find(|row| row.chosen)?.position_mm.mean;
        let nominal = table
            .iter()
            .find(|row| row.candidate == Method::BaseTool.name())?;
        let before = nominal.position_mm.mean;
        let text = format!(
            "with the joints anywhere in their measured ranges, the model may be off by {:.3} mm on average, and the nominal \
             robot is off by {before:.3} mm on the measured poses: use the model near these poses alone, or measure poses that \
             combine the joints in other ways",
            self.mean_mm
        );
        (self.mean_mm > before.max(chosen))
            .then(|| Finding::new(Cause::Few, Tier::Warning, text, self.mean_mm, before))
    }

    /// Returns the held-out errors of the chosen method.
    fn of_held_out(choice: Option<&Choice>) -> Option<Self> {
        let chosen = choice?.table.iter().find(|row| row.chosen)?;
        Some(Self {
            mean_mm: chosen.position_mm.mean,
            p95_mm: chosen.position_mm.p95,
        })
    }

    /// Returns the error that is expected anywhere, with what the folds of `choice` found where that is more.
    #[must_use]
    pub fn at_least(self, choice: Option<&Choice>) -> Self {
        let alike = Self::of_held_out(choice).unwrap_or(self);
        Self {
            mean_mm: self.mean_mm.max(alike.mean_mm),
            p95_mm: self.p95_mm.max(alike.p95_mm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The model is worse than the nominal arm beside its poses alone, not if it is worse on them, too.
    #[test]
    fn a_model_that_is_worse_beside_its_poses_is_named() {
        let row = |candidate, mean_mm: f64, chosen| Row {
            candidate,
            position_mm: Summary::new(&[mean_mm]),
            behind_best_mm: 0.0,
            standard_error_mm: 0.0,
            chosen,
        };
        let named = |anywhere: f64, chosen: f64| {
            let table = [row("base-tool", 0.35, false), row("elastic", chosen, true)];
            let expected = ExpectedError {
                mean_mm: anywhere,
                p95_mm: 2.0 * anywhere,
            };
            expected.finding(&table).map(|f| f.text)
        };
        assert!(
            named(14.6, 0.05)
                .unwrap()
                .contains("off by 14.600 mm on average")
        );
        assert_eq!(named(0.3, 0.05), None);
        assert_eq!(named(0.5, 0.5), None);
    }
}
