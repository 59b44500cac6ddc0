//! The error to be expected all over the measured ranges of the joints: what a calibration does not know, in millimetres.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use crate::measurement::observation::Observation;
use crate::measurement::sample::{InstrumentSample, Sample};
use crate::model::Calibration;
use crate::numeric::statistics::{Summary, extremes};
use crate::robot::Robot;
use crate::validation::model_selection::Choice;

/// Configurations that are drawn from the measured ranges, and errors drawn for each.
const POSES: usize = 64;
const DRAWS: usize = 50;

/// Position error to be expected of a new measurement anywhere in the measured ranges of the joints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExpectedError {
    /// Mean over the configurations, mm.
    pub mean_mm: f64,
    /// 95 % of the errors are expected to be smaller, mm.
    pub p95_mm: f64,
}

impl ExpectedError {
    /// Of `calibration`, which was made from `samples`: by its own standard deviation at random configurations. A model
    /// whose standard deviation is the same everywhere has the held-out errors of the choice; `None` without either.
    pub fn new(
        calibration: &Calibration,
        robot: &Robot,
        samples: &[InstrumentSample],
        choice: Option<&Choice>,
    ) -> Option<Self> {
        if !calibration.has_local_deviation() {
            let chosen = choice?.table.iter().find(|row| row.chosen)?;
            return Some(Self {
                mean_mm: chosen.position_mm.mean,
                p95_mm: chosen.position_mm.p95,
            });
        }
        let range = |joint: usize| extremes(samples.iter().map(|s| s.joints[joint]));
        let ranges: Vec<(f64, f64)> = (0..robot.joints.len()).map(range).collect();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut errors = Vec::with_capacity(POSES * DRAWS);
        for _ in 0..POSES {
            let of = |(least, most): &(f64, f64)| least + (most - least) * random.random::<f64>();
            let joints: Vec<f64> = ranges.iter().map(of).collect();
            let row = &samples[random.random_range(0..samples.len())];
            let serial_joints = robot.serial_joints(&joints);
            let observation = Observation::Pose(Pose::identity());
            let pose = Sample {
                payload_kg: row.payload_kg,
                tool: row.tool,
                declared_noise: row.declared_noise,
                ..Sample::new(joints, serial_joints, observation, row.frame)
            };
            let sigma = calibration.standard_deviation(&pose)?;
            for _ in 0..DRAWS {
                let error = Vector3::from_fn(|axis, _| {
                    let drawn: f64 = StandardNormal.sample(&mut random);
                    1e3 * sigma[axis] * drawn
                });
                errors.push(error.norm());
            }
        }
        let summary = Summary::new(&errors);
        Some(Self {
            mean_mm: summary.mean,
            p95_mm: summary.p95,
        })
    }
}
