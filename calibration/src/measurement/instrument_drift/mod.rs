//! Instrument drift: the motion of the instrument, shown by fixed points that are measured again at every pose.
//!
//! A tracker's tripod warms up and creeps, and every pose of the arm is measured from where it stands at that moment. Points
//! that do not move (`ref1_x_mm` …) therefore seem to move: M_k takes them from their true positions to where they are seen
//! at pose k, and M_k⁻¹ takes the measured pose back. The correction uses only the reference points, never a measured pose,
//! so that correcting a whole file before it is split into folds leaks nothing from one fold to another.
//!
//! - Real files have misses, and points that were mistaken for others: `outliers` finds them.
//! - The mean positions of the points and the motion are estimated together (p_ik = r_i + t_k), so that a point that is
//!   missed while the instrument creeps does not bias them.
//! - The amount of smoothing over neighbouring poses (rows are in the order of measurement; sessions are not mixed) is
//!   chosen for each axis by leaving points out: the motion that the other points show must predict the one that was left
//!   out, as it must predict the target. With a single point, the neighbouring poses predict the pose that was left out.
//! - A study found translation as good as rigid motion. With three or more points, a rotation is allowed if it removes nine
//!   tenths of the variance by which the points of one pose disagree, degrees of freedom counted.

mod motion;
mod outliers;
#[cfg(test)]
mod tests;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::input_error::InputError;
use crate::measurement::instrument_drift::motion::Track;
use crate::measurement::sample::{InstrumentSample, Sample};
use crate::measurement::set::MeasurementSet;

/// Largest distance in m of a reference point from its position in another file of the same set-up.
const SAME_POSITION: f64 = 5e-3;
/// Distance in m within which no instrument repeats nine tenths of a point's measurements, and the least number of them that
/// show it.
const REPEATS: f64 = 1e-6;
const SEEN: usize = 10;
/// Largest ratio of the errors on left-out reference points with correction to those without, for which the correction is
/// worth it.
const WORTH_IT: f64 = 0.9;
/// Largest number of lines that a report lists.
const LISTED: usize = 5;

/// Motion of the instrument in the course of a file.
#[derive(Clone, Debug)]
pub struct Drift {
    /// Mean position of each reference point, in m.
    pub points: Vec<Vector3<f64>>,
    /// For each row, the transform that takes a point from its true position to where it was seen.
    pub seen_from_true: Vec<Pose<f64>>,
    /// Summary of the estimate.
    pub report: DriftReport,
}

/// Summary of a drift estimate, for a reader.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DriftReport {
    /// Number of reference points.
    pub points: usize,
    /// Number of single measurements in which a reference point was missed.
    pub misses: usize,
    /// Lines of the first of these misses.
    pub missed_lines: Vec<usize>,
    /// Number of single measurements rejected as outliers.
    pub outliers: usize,
    /// Lines of the first of these outliers.
    pub outlier_lines: Vec<usize>,
    /// Number of poses without a good reference point; their motion is taken from their neighbours.
    pub poses_without: usize,
    /// Kind of the motion: `translation` or `rigid`.
    pub motion: &'static str,
    /// Standard deviation, in poses, of the Gaussian window for each axis: 0 means no smoothing, absent means no motion at
    /// all.
    pub window_poses: [Option<f64>; 3],
    /// Standard deviation of the motion along each axis of the instrument, in µm.
    pub std_um: [f64; 3],
    /// Largest distance from where the instrument stood at the first row, in mm.
    pub moved_mm: f64,
    /// Largest distance from the mean place along each axis, in µm.
    pub max_um: [f64; 3],
    /// Largest rotation, in µrad.
    pub max_urad: f64,
    /// RMS per axis of a point that was left out, before and after removing the motion of the others, in µm. For a rigid
    /// motion the second value is the disagreement among the points of one pose.
    pub left_out_um: [f64; 2],
}

impl Drift {
    /// Estimates the drift through `set`.
    ///
    /// # Errors
    /// Returns an [`InputError`] if there are no reference points, or if one of them was never seen.
    pub fn estimate(set: &MeasurementSet) -> Result<Self, InputError> {
        Self::relative_to(set, None)
    }

    /// Estimates the drift through another file of the same set-up, relative to where `training` saw the points.
    ///
    /// # Errors
    /// Those of [`Drift::estimate`], and an error if the points are not those of `training`.
    pub fn estimate_as(set: &MeasurementSet, training: &Self) -> Result<Self, InputError> {
        Self::relative_to(set, Some(&training.points))
    }

    fn relative_to(
        set: &MeasurementSet,
        points: Option<&[Vector3<f64>]>,
    ) -> Result<Self, InputError> {
        let count = set.measurements.first().map_or(0, |m| m.references.len());
        if count == 0 {
            return Err(InputError::new(
                &set.path,
                "no reference points",
                "columns ref1_x_mm, ref1_y_mm, ref1_z_mm: fixed points measured again at every pose",
            )
            .with_help("omit --correct-drift if there are none"));
        }
        let mut seen: Vec<Vec<Option<Vector3<f64>>>> = (0..count)
            .map(|i| set.measurements.iter().map(|m| m.references[i]).collect())
            .collect();
        let lines = |wrong: &dyn Fn(usize, usize) -> bool| -> Vec<usize> {
            let poses = 0..set.measurements.len();
            poses
                .flat_map(|k| (0..count).filter(move |i| wrong(*i, k)).map(move |_| k))
                .map(|k| set.measurements[k].line)
                .collect()
        };
        let missed = lines(&|i, k| seen[i][k].is_none());
        let sessions = set.session_of_rows();
        let wrong = outliers::outliers(&seen, &sessions);
        let outliers = lines(&|i, k| wrong[i][k]);
        for (point, wrong) in seen.iter_mut().zip(&wrong) {
            for (seen, _) in point.iter_mut().zip(wrong).filter(|(_, wrong)| **wrong) {
                *seen = None;
            }
        }
        if let Some(never) = seen.iter().position(|p| p.iter().all(Option::is_none)) {
            return Err(InputError::new(
                &set.path,
                format!("reference point {} that was never measured", never + 1),
                "a fixed point that the instrument measures repeatedly",
            )
            .with_help("remove its columns from the file"));
        }
        plausible(set, &seen)?;
        let points = match points {
            None => motion::mean_positions(&seen),
            Some(points) => {
                same_position(set, &seen, points)?;
                points.to_vec()
            }
        };
        let track = Track::new(&points, &seen, &sessions);
        let found = track.motion();
        let std_and_max = |axis: usize| -> (f64, f64) {
            let values = found.translations.iter().map(|t| 1e6 * t[axis]);
            let k = found.translations.len() as f64;
            let mean = values.clone().sum::<f64>() / k;
            let variance = values.clone().map(|x| (x - mean).powi(2)).sum::<f64>() / k;
            (variance.sqrt(), values.fold(0.0, |m, x| m.max(x.abs())))
        };
        let axes = [0, 1, 2].map(std_and_max);
        let start = found.translations[0];
        let moved = found.translations.iter().map(|t| (t - start).norm());
        let first = |lines: &[usize]| lines.iter().copied().take(LISTED).collect();
        let without = |k: &usize| seen.iter().all(|point| point[*k].is_none());
        let report = DriftReport {
            points: count,
            misses: missed.len(),
            missed_lines: first(&missed),
            outliers: outliers.len(),
            outlier_lines: first(&outliers),
            poses_without: (0..set.measurements.len()).filter(without).count(),
            motion: if found.rigid { "rigid" } else { "translation" },
            window_poses: found.windows.map(|w| w.is_finite().then_some(w)),
            std_um: axes.map(|a| a.0),
            moved_mm: 1e3 * moved.fold(0.0, f64::max),
            max_um: axes.map(|a| a.1),
            max_urad: found
                .rotations
                .iter()
                .fold(0.0, |m, r| m.max(1e6 * r.norm())),
            left_out_um: found.left_out.map(|e| 1e6 * e),
        };
        Ok(Self {
            seen_from_true: found.poses(&track.centre),
            points,
            report,
        })
    }

    /// Returns the samples of the same file, in order, as an instrument that does not move would have seen them.
    pub fn correct(&self, samples: &[InstrumentSample]) -> Vec<InstrumentSample> {
        let rows = samples.iter().zip(&self.seen_from_true);
        rows.map(|(sample, seen_from_true)| Sample {
            observation: sample.observation.transformed(&seen_from_true.inverse()),
            ..sample.clone()
        })
        .collect()
    }
}

impl DriftReport {
    /// Returns whether the reference points show enough motion for the correction to be worth it.
    pub fn is_clear(&self) -> bool {
        let [before, after] = self.left_out_um;
        after <= WORTH_IT * before
    }

    /// Returns a few lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let listed = |count: usize, lines: &[usize]| match count {
            0 => String::new(),
            _ => {
                let list: Vec<String> = lines.iter().map(ToString::to_string).collect();
                let more = if count > lines.len() { ", …" } else { "" };
                format!(" (lines {}{more})", list.join(", "))
            }
        };
        let axes = |values: [f64; 3]| values.map(|x| format!("{x:.0}")).join(", ");
        let windows: Vec<String> = self
            .window_poses
            .iter()
            .map(|w| w.map_or("no motion".to_owned(), |w| format!("{w}")))
            .collect();
        let mut out = vec![
            format!(
                "Drift from {} reference points; left out: {} missed{}, {} outliers{}.",
                self.points,
                self.misses,
                listed(self.misses, &self.missed_lines),
                self.outliers,
                listed(self.outliers, &self.outlier_lines)
            ),
            format!(
                "  {} by up to {:.3} mm from where the instrument stood at the first row; {} µm (x, y, z; one sigma), {} µm at most \
                 from the mean; smoothed over ±{} poses",
                self.motion,
                self.moved_mm,
                axes(self.std_um),
                axes(self.max_um),
                windows.join(", ")
            ),
            format!(
                "  a reference point left out: {:.1} µm rms per axis, {:.1} µm after the correction",
                self.left_out_um[0], self.left_out_um[1]
            ),
        ];
        if self.motion == "rigid" {
            out.push(format!("  rotation of {:.1} µrad at most", self.max_urad));
        }
        if self.poses_without > 0 {
            out.push(format!(
                "  {} poses have no usable reference point: the motion of their neighbours is used",
                self.poses_without
            ));
        }
        out
    }
}

/// Refuses reference points that repeat better than any instrument does, as those in metres under `_mm`.
fn plausible(set: &MeasurementSet, seen: &[Vec<Option<Vector3<f64>>>]) -> Result<(), InputError> {
    for (i, seen) in seen.iter().enumerate() {
        let seen: Vec<_> = seen.iter().flatten().copied().collect();
        let middle = outliers::median(&seen);
        let mut off: Vec<f64> = seen.iter().map(|p| (p - middle).norm()).collect();
        off.sort_by(f64::total_cmp);
        // Rounded coordinates of a point that stays are equal.
        let most = off[off.len() * 9 / 10];
        if seen.len() >= SEEN && most > 0.0 && most < REPEATS {
            return Err(InputError::new(
                &set.path,
                format!(
                    "reference point {} that repeats within {:.4} µm",
                    i + 1,
                    1e6 * most
                ),
                "values that an instrument measured, in the unit of the column",
            )
            .with_help("columns in metres are named ref1_x_m, in millimetres ref1_x_mm"));
        }
    }
    Ok(())
}

fn same_position(
    set: &MeasurementSet,
    seen: &[Vec<Option<Vector3<f64>>>],
    points: &[Vector3<f64>],
) -> Result<(), InputError> {
    if seen.len() != points.len() {
        return Err(InputError::new(
            &set.path,
            format!("{} reference points", seen.len()),
            format!("the {} of the training file", points.len()),
        ));
    }
    for (i, (seen, point)) in seen.iter().zip(points).enumerate() {
        let seen: Vec<_> = seen.iter().flatten().copied().collect();
        let distance = (outliers::median(&seen) - point).norm();
        if distance > SAME_POSITION {
            return Err(InputError::new(
                &set.path,
                format!(
                    "reference point {} {:.1} mm from where the training file has it",
                    i + 1,
                    1e3 * distance
                ),
                "the same set-up: the same points within 5 mm",
            ));
        }
    }
    Ok(())
}
