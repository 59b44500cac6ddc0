//! Whether predicted standard deviations are true: how many errors lie within one and within 1.96 of them.

use serde::Serialize;

use crate::blob::predict::LoadedBlob;
use crate::measurement::sample::InstrumentSample;
use crate::model::Calibration;
use crate::validation::held_out::{HeldOutPose, held_out};

/// Shares of the errors along or about one axis of the base frame that are within their intervals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AxisCoverage {
    /// Within one standard deviation; 0.68 when it is true.
    pub one_sigma: f64,
    /// Within 1.96 standard deviations; 0.95 when it is true.
    pub two_sigma: f64,
}

/// Shares of single components (three of position, three of rotation) within their intervals.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Within one standard deviation; 0.68 when it is true.
    pub one_sigma: f64,
    /// Within 1.96 standard deviations; 0.95 when it is true.
    pub two_sigma: f64,
    /// Mean predicted standard deviation of a position component in mm.
    pub mean_sigma_mm: f64,
    /// Along x, y, z, and about them where orientations were measured.
    pub axes: Vec<AxisCoverage>,
}

/// Counts, so that folds can be pooled.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counter {
    /// By component.
    one: [usize; 6],
    two: [usize; 6],
    all: [usize; 6],
    sigma_sum: f64,
    sigmas: usize,
}

impl Counter {
    /// Adds the errors of `samples` (poses in the instrument's frame) as the blob predicts them, against the standard
    /// deviations of the calibration it was made from.
    pub fn add(
        &mut self,
        calibration: &Calibration,
        blob: &LoadedBlob,
        samples: &[InstrumentSample],
    ) {
        let base = &calibration.ends.instrument_from_base;
        for pose in held_out(blob, base, samples, Some(calibration)) {
            self.add_pose(&pose);
        }
    }

    /// Adds one pose; without a predicted standard deviation it does not count.
    pub fn add_pose(&mut self, pose: &HeldOutPose) {
        let Some(sigma) = &pose.sigma else {
            return;
        };
        let components = pose.residual.iter().zip(sigma).take(pose.components());
        for (i, (e, s)) in components.enumerate() {
            self.one[i] += usize::from(e.abs() <= *s);
            self.two[i] += usize::from(e.abs() <= 1.96 * s);
            self.all[i] += 1;
        }
        self.sigma_sum += sigma[..3].iter().sum::<f64>();
        self.sigmas += 3;
    }

    /// The shares; `None` when nothing was counted.
    pub fn coverage(&self) -> Option<Coverage> {
        let share = |n: usize, all: usize| n as f64 / all as f64;
        let total = |counts: &[usize; 6]| counts.iter().sum::<usize>();
        let all = total(&self.all);
        let axis = |i: usize| AxisCoverage {
            one_sigma: share(self.one[i], self.all[i]),
            two_sigma: share(self.two[i], self.all[i]),
        };
        (all > 0).then(|| Coverage {
            one_sigma: share(total(&self.one), all),
            two_sigma: share(total(&self.two), all),
            mean_sigma_mm: 1e3 * self.sigma_sum / self.sigmas as f64,
            axes: (0..6).filter(|i| self.all[*i] > 0).map(axis).collect(),
        })
    }
}
