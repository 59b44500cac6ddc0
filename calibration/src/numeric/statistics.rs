//! Summaries of errors, and the errors of a set of poses.

use crate::numeric::rotation::angle_between;
use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

/// Mean length of a vector of three independent standard normal components, √(8/π).
pub const MEAN_LENGTH: f64 = 1.595_769_121_605_730_7;

/// Mean, median, RMS, 95th percentile and maximum of a list of errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Arithmetic mean.
    pub mean: f64,
    /// 50th percentile.
    pub median: f64,
    /// Root mean square.
    pub rms: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Maximum.
    pub max: f64,
}

impl Summary {
    /// Summarises `values`; all fields are zero if there are none. Percentiles are interpolated linearly between the order
    /// statistics.
    pub fn new(values: &[f64]) -> Self {
        Self::of(values.to_vec())
    }

    /// Summarises as [`Summary::new`] does, without a copy of the values.
    pub fn of(values: Vec<f64>) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        let mut sorted = values;
        sorted.sort_unstable_by(f64::total_cmp);
        let count = sorted.len() as f64;
        Self {
            mean: sorted.iter().sum::<f64>() / count,
            median: percentile(&sorted, 0.5),
            rms: (sorted.iter().map(|x| x * x).sum::<f64>() / count).sqrt(),
            p95: percentile(&sorted, 0.95),
            max: sorted[sorted.len() - 1],
        }
    }
}

/// Returns `count` of the items, evenly spread; all, if there are no more.
pub fn evenly_spaced<T: Clone>(items: &[T], count: usize) -> Vec<T> {
    let count = count.min(items.len());
    let of = |i: usize| items[i * items.len() / count].clone();
    (0..count).map(of).collect()
}

/// Returns the value below which a share (0…1) of `sorted` lies, interpolated linearly; `sorted` must be ascending and not
/// empty.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

/// Returns the smallest and the largest of `values`; (∞, −∞) if there are none.
pub fn extremes(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let ends = (f64::INFINITY, f64::NEG_INFINITY);
    let wider = |(low, high): (f64, f64), x: f64| (low.min(x), high.max(x));
    values.into_iter().fold(ends, wider)
}

/// Returns the different values, in ascending order.
pub fn distinct(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut out: Vec<f64> = values.into_iter().collect();
    out.sort_by(f64::total_cmp);
    out.dedup();
    out
}

/// Returns the value below which a share of the values lie, or 0 if there are none.
pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    let Some(last) = values.len().checked_sub(1) else {
        return 0.0;
    };
    let at = (share * values.len() as f64) as usize;
    *values
        .select_nth_unstable_by(at.min(last), f64::total_cmp)
        .1
}

/// Returns the median, or 0 if there are no values.
pub fn median(values: Vec<f64>) -> f64 {
    quantile(values, 0.5)
}

/// Absolute standardised errors of poses that were not fitted: of position, then of rotation.
pub type Standardised = [Vec<f64>; 2];

/// Returns the factors by which predicted standard deviations must be multiplied to match `standardised` errors: the mean of
/// the factors that the 68 % and the 95 % quantile require, or 1 if there are no errors.
pub fn calibration_factor(standardised: &mut Standardised) -> [f64; 2] {
    let mut out = [1.0; 2];
    for (factor, values) in out.iter_mut().zip(standardised) {
        values.sort_by(f64::total_cmp);
        let quantile = |share: f64| values.get((share * values.len() as f64) as usize).copied();
        if let (Some(one), Some(two)) = (quantile(0.6827), quantile(0.95)) {
            *factor = 0.5 * (one + two / 1.96);
        }
    }
    out
}

/// Distance between two poses, in mm and mrad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Distance between the origins, in mm.
    pub position_mm: f64,
    /// Angle of the rotation between the poses, in mrad; `None` if only the position was measured.
    pub orientation_mrad: Option<f64>,
}

impl PoseError {
    /// Computes the error between a measured and a predicted pose in the same frame.
    pub fn between(measured: &Pose<f64>, predicted: &Pose<f64>) -> Self {
        Self {
            orientation_mrad: Some(1e3 * angle_between(measured, predicted)),
            ..Self::of_position(&measured.translation, &predicted.translation)
        }
    }

    /// Computes the error between a measured and a predicted position, in metres and in the same frame.
    pub fn of_position(measured: &Vector3<f64>, predicted: &Vector3<f64>) -> Self {
        Self {
            position_mm: 1e3 * (measured - predicted).norm(),
            orientation_mrad: None,
        }
    }
}

/// Errors of single poses, stored with 16 bytes for each pose so that files of any length fit.
#[derive(Clone, Debug, Default)]
pub struct PoseErrors {
    positions_mm: Vec<f64>,
    orientations_mrad: Vec<f64>,
}

impl PoseErrors {
    /// Appends the error of one more pose.
    pub fn push(&mut self, error: &PoseError) {
        self.positions_mm.push(error.position_mm);
        self.orientations_mrad.extend(error.orientation_mrad);
    }

    /// Appends the errors of later poses.
    pub fn extend(&mut self, later: Self) {
        self.positions_mm.extend(later.positions_mm);
        self.orientations_mrad.extend(later.orientations_mrad);
    }

    /// Summarises the errors.
    pub fn summary(self) -> ErrorSummary {
        ErrorSummary {
            poses: self.positions_mm.len(),
            position_mm: Summary::of(self.positions_mm),
            orientation_mrad: (!self.orientations_mrad.is_empty())
                .then(|| Summary::of(self.orientations_mrad)),
        }
    }
}

/// Summary of the errors of one model on one set of poses, in the form that `--json` prints.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorSummary {
    /// Number of poses.
    pub poses: usize,
    /// Position errors in mm.
    pub position_mm: Summary,
    /// Orientation errors in mrad, of the poses with a measured orientation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_mrad: Option<Summary>,
}

impl ErrorSummary {
    /// Summarises the errors of single poses.
    pub fn new(errors: &[PoseError]) -> Self {
        let mut all = PoseErrors::default();
        errors.iter().for_each(|error| all.push(error));
        all.summary()
    }

    /// Returns the mean orientation error as text for a table.
    pub fn orientation_text(&self) -> String {
        self.orientation_mrad
            .as_ref()
            .map_or("–".to_owned(), |o| format!("{:.3}", o.mean))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_numpy() {
        let s = Summary::new(&[4.0, 1.0, 3.0, 2.0, 10.0]);
        assert_eq!((s.mean, s.median, s.max), (4.0, 3.0, 10.0));
        assert!((s.p95 - 8.8).abs() < 1e-12, "{s:?}");
        assert!((s.rms - 26.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(Summary::new(&[]), Summary::default());
    }
}
