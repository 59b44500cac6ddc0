//! The input of the next steps: a calibration, and what it knows over the measured ranges of its joints.

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
    /// Computes what `calibration`, which was made from `samples`, knows.
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

    /// Returns the covariance of predictions and whole poses all over the measured ranges, which come first in it. `None`
    /// for a model that does not say how its predictions are correlated.
    pub fn predictions(&self) -> Option<(&PredictionCovariance, &[InstrumentSample])> {
        Some((self.covariance.as_ref()?, &self.volume.poses))
    }

    /// Returns the error that the model expects; `None` for a model that does not say how its predictions are correlated.
    pub fn expected_error(&self) -> Option<ExpectedError> {
        self.covariance
            .as_ref()
            .map(|covariance| self.expected(covariance))
    }

    /// Returns the error that the model itself expects in the work volume.
    pub(super) fn expected(&self, covariance: &PredictionCovariance) -> ExpectedError {
        self.volume.expected(&covariance.deviations(0..POSES))
    }

    /// Returns the mean expected error in mm after the poses of the pool with the indices `measured` are measured.
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

/// Returns how many poses to propose to someone who measured `poses`: a third as many, rounded up to tens, from 10 to 50.
/// More than fifty take a day of their own.
fn added(poses: usize) -> usize {
    (poses.div_ceil(30) * 10).clamp(10, 50)
}

/// The input of the next steps.
#[derive(Debug)]
pub struct Task<'a> {
    /// The calibration.
    pub calibration: &'a Calibration,
    /// The nominal robot.
    pub robot: &'a Robot,
    /// Rows that the calibration was made from.
    pub samples: &'a [InstrumentSample],
    /// What the calibration knows over the measured ranges.
    pub knowledge: &'a Knowledge,
    /// Stated expected error over the measured ranges.
    pub expected: Option<ExpectedError>,
    /// Which parameters these poses identify.
    pub identifiability: Option<&'a IdentifyReport>,
    /// How far reference points show that the instrument moved, where that was not removed from `samples`, mm.
    pub instrument_moved_mm: Option<f64>,
    /// Findings that somebody must look at.
    pub warnings: &'a [Finding],
}
