//! What the steps are made of: a calibration, and what it knows over the measured ranges of its joints.

use crate::identification::identifiability::IdentifyReport;
use crate::identification::prediction_covariance::PredictionCovariance;
use crate::measurement::sample::{InstrumentSample, different_poses};
use crate::model::Calibration;
use crate::model::identified::prediction_covariance;
use crate::robot::Robot;
use crate::trust::Finding;
use crate::validation::next_steps::pool::Pool;
use crate::validation::work_volume::{ExpectedError, POSES, WorkVolume};

/// What a calibration knows over the measured ranges of its joints.
#[derive(Debug)]
pub struct Knowledge {
    pub(super) volume: WorkVolume,
    pub(super) pool: Pool,
    pub(super) covariance: Option<PredictionCovariance>,
}

impl Knowledge {
    /// Collects what `calibration`, which was made from `samples`, knows.
    pub fn new(calibration: &Calibration, robot: &Robot, samples: &[InstrumentSample]) -> Self {
        let volume = WorkVolume::new(robot, samples);
        let pool = Pool::new(
            &volume.ranges,
            robot,
            samples,
            added(different_poses(samples)),
        );
        let all: Vec<InstrumentSample> = volume.poses.iter().chain(&pool.poses).cloned().collect();
        Self {
            covariance: prediction_covariance(calibration, robot, samples, &all),
            volume,
            pool,
        }
    }

    /// Whole poses all over the measured ranges, and what the model knows of them first of all; `None` of a model that does not say
    /// how its predictions are correlated.
    pub fn predictions(&self) -> Option<(&PredictionCovariance, &[InstrumentSample])> {
        Some((self.covariance.as_ref()?, &self.volume.poses))
    }

    /// What a model expects that says how its predictions are correlated.
    pub fn expected_error(&self) -> Option<ExpectedError> {
        self.covariance
            .as_ref()
            .map(|covariance| self.expected(covariance))
    }

    /// The error that the model expects by itself.
    pub(super) fn expected(&self, covariance: &PredictionCovariance) -> ExpectedError {
        self.volume.expected(&covariance.deviations(0..POSES))
    }

    /// The same after the poses of the pool are measured.
    pub(super) fn after(
        &self,
        covariance: &PredictionCovariance,
        measured: &[usize],
    ) -> Option<f64> {
        let rows: Vec<usize> = measured
            .iter()
            .flat_map(|k| covariance.rows(POSES + k).take(self.pool.equations[*k]))
            .collect();
        let left = covariance.deviations_after(0..POSES, &rows)?;
        Some(self.volume.expected(&left).mean_mm)
    }
}

/// Poses that are proposed to someone who measured `poses`: a third as many, in tens; more than fifty are a day of their own.
fn added(poses: usize) -> usize {
    (poses.div_ceil(30) * 10).clamp(10, 50)
}

/// What the steps are made of.
#[derive(Debug)]
pub struct Task<'a> {
    /// The calibration.
    pub calibration: &'a Calibration,
    /// The nominal robot.
    pub robot: &'a Robot,
    /// The rows that it was made from.
    pub samples: &'a [InstrumentSample],
    /// What it knows over the measured ranges.
    pub knowledge: &'a Knowledge,
    /// The error that it is stated to have there.
    pub expected: Option<ExpectedError>,
    /// What these poses identify.
    pub identifiability: Option<&'a IdentifyReport>,
    /// What somebody must look at.
    pub warnings: &'a [Finding],
}
