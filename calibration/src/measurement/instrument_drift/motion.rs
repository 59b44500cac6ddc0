//! Estimates the motion of the instrument from the apparent motion of its reference points.

use crate::numeric::rotation::turn;
use nalgebra::{Matrix6, Vector3, Vector6};
use poegp_runtime::math::se3::Pose;

/// Candidate standard deviations of the Gaussian window, in poses; infinite means no motion at all.
const WINDOWS: [f64; 9] = [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, f64::INFINITY];
/// Half-width of the window, in its standard deviations.
const REACH: f64 = 4.0;
/// Share of the mean-square disagreement among the points below which a rotation is allowed. Pure noise does not reduce the
/// disagreement, because equations and unknowns are counted. On a real tracker session (700 poses, three points) it falls to
/// a share of 0.24, and the held-out errors of the arm fall from 0.0500 to 0.0496 mm: not a clear gain, and a rotation is
/// extrapolated beyond the points.
const CLEARLY: f64 = 0.1;
/// Number of alternating updates of the mean positions and the motions.
const ROUNDS: usize = 50;

/// Returns the mean positions r_i in p_ik = r_i + t_k, where the motions t_k have mean zero.
pub fn mean_positions(seen: &[Vec<Option<Vector3<f64>>>]) -> Vec<Vector3<f64>> {
    let poses = seen.first().map_or(0, Vec::len);
    let mut points: Vec<Vector3<f64>> = seen
        .iter()
        .map(|p| mean(p.iter().flatten().copied()).unwrap_or_default())
        .collect();
    for _ in 0..ROUNDS {
        let motions: Vec<Option<Vector3<f64>>> = (0..poses)
            .map(|k| mean((0..seen.len()).filter_map(|i| seen[i][k].map(|p| p - points[i]))))
            .collect();
        let offset = mean(motions.iter().flatten().copied()).unwrap_or_default();
        for (point, seen) in points.iter_mut().zip(seen) {
            let at_rest = seen
                .iter()
                .zip(&motions)
                .filter_map(|(p, t)| Some((*p)? - ((*t)? - offset)));
            *point = mean(at_rest).unwrap_or(*point);
        }
    }
    points
}

fn mean(values: impl Iterator<Item = Vector3<f64>>) -> Option<Vector3<f64>> {
    let (sum, count) = values.fold((Vector3::zeros(), 0), |(s, n), v| (s + v, n + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The apparent motion of the points, ready to be smoothed.
pub struct Track<'a> {
    /// Centre of the points, about which rotations are taken.
    pub centre: Vector3<f64>,
    /// Position of each point relative to the centre.
    arms: Vec<Vector3<f64>>,
    /// Shift p − r of each point at each pose: `[point][pose]`.
    shifts: Vec<Vec<Option<Vector3<f64>>>>,
    sessions: &'a [usize],
}

/// The selected motion.
pub struct Motion {
    /// Whether the motion includes a rotation.
    pub rigid: bool,
    /// Standard deviation of the Gaussian window for each axis, in poses.
    pub windows: [f64; 3],
    /// Translation of the centre at each pose.
    pub translations: Vec<Vector3<f64>>,
    /// Rotation vector at each pose.
    pub rotations: Vec<Vector3<f64>>,
    /// RMS per axis of what was left out, in m: without correction and with it. With a rotation, the second value is the
    /// disagreement among the points of one pose.
    pub left_out: [f64; 2],
}

impl Motion {
    /// Returns for each pose the transform that takes a point from its true position to where it was seen.
    pub fn poses(&self, centre: &Vector3<f64>) -> Vec<Pose<f64>> {
        let pose = |(t, r): (&Vector3<f64>, &Vector3<f64>)| {
            let rotation = turn(*r).rotation;
            Pose {
                rotation,
                translation: centre + t - rotation * centre,
            }
        };
        self.translations
            .iter()
            .zip(&self.rotations)
            .map(pose)
            .collect()
    }
}

impl<'a> Track<'a> {
    /// Creates a track from the positions of the points and from where they were seen, without outliers.
    pub fn new(
        points: &[Vector3<f64>],
        seen: &[Vec<Option<Vector3<f64>>>],
        sessions: &'a [usize],
    ) -> Self {
        let centre = mean(points.iter().copied()).unwrap_or_default();
        let shift = |(seen, point): (&Vec<Option<Vector3<f64>>>, &Vector3<f64>)| {
            seen.iter().map(|p| p.map(|p| p - point)).collect()
        };
        Self {
            centre,
            arms: points.iter().map(|p| p - centre).collect(),
            shifts: seen.iter().zip(points).map(shift).collect(),
            sessions,
        }
    }

    /// Selects the motion that best predicts what was left out.
    pub fn motion(&self) -> Motion {
        let translation: Vec<(f64, [f64; 3])> = WINDOWS
            .iter()
            .map(|w| (*w, self.left_out(*w)))
            .filter(|(_, error)| error.iter().all(|e| e.is_finite()))
            .collect();
        let still = self.left_out(f64::INFINITY);
        let best = [0, 1, 2].map(|axis| {
            translation
                .iter()
                .map(|(w, error)| (*w, error[axis]))
                .reduce(|a, b| if b.1 < a.1 { b } else { a })
                .unwrap_or((f64::INFINITY, still[axis]))
        });
        let total = |errors: [f64; 3]| errors.iter().sum::<f64>() / 3.0;
        let mut error = total(best.map(|b| b.1));
        let mut windows = best.map(|b| b.0);
        let translated = self.disagreement(false);
        let turned = self.disagreement(true).filter(|_| self.shifts.len() > 2);
        let rigid = matches!((translated, turned), (Some(t), Some(r)) if r < CLEARLY * t);
        if rigid {
            windows = [windows.iter().fold(f64::INFINITY, |a, b| a.min(*b)); 3];
            error = turned.unwrap_or(error);
        }
        let all: Vec<usize> = (0..self.shifts.len()).collect();
        let mut translations = Vec::new();
        let mut rotations = Vec::new();
        for k in 0..self.sessions.len() {
            let by_axis = windows.map(|w| self.at(k, w, &all, rigid, false));
            translations.push(Vector3::from_fn(|axis, _| {
                by_axis[axis].map_or(0.0, |m| m.0[axis])
            }));
            rotations.push(
                by_axis[0]
                    .filter(|_| rigid)
                    .map_or(Vector3::zeros(), |m| m.1),
            );
        }
        Motion {
            rigid,
            windows,
            translations,
            rotations,
            left_out: [total(still), error].map(f64::sqrt),
        }
    }

    /// Returns for each axis the mean-square error of predicting, with this window, what was left out: each point in turn,
    /// or each pose if there is only one point.
    fn left_out(&self, window: f64) -> [f64; 3] {
        let (mut sum, mut count) = (Vector3::zeros(), 0);
        for (i, shifts) in self.shifts.iter().enumerate() {
            let one = self.shifts.len() == 1;
            let used: Vec<usize> = (0..self.shifts.len()).filter(|j| one || *j != i).collect();
            // The other points do not determine the position of the point that is left out, so a constant offset is removed.
            let errors: Vec<Vector3<f64>> = shifts
                .iter()
                .enumerate()
                .filter_map(|(k, shift)| Some((*shift)? - self.at(k, window, &used, false, one)?.0))
                .collect();
            let offset = mean(errors.iter().copied()).unwrap_or_default();
            for error in errors {
                sum += (error - offset).map(|x| x * x);
                count += 1;
            }
        }
        let mean = sum / f64::from(count);
        [mean[0], mean[1], mean[2]]
    }

    /// Returns the mean square per degree of freedom of the disagreement among the points of one pose after removing the
    /// motion of that pose; `None` if no pose has enough points.
    fn disagreement(&self, rigid: bool) -> Option<f64> {
        let unknowns = if rigid { 6 } else { 3 };
        let (mut sum, mut freedom) = (0.0, 0);
        for k in 0..self.sessions.len() {
            let there: Vec<usize> = (0..self.shifts.len())
                .filter(|i| self.shifts[*i][k].is_some())
                .collect();
            if 3 * there.len() <= unknowns {
                continue;
            }
            let (t, r) = self.at(k, 0.0, &there, rigid, false)?;
            freedom += 3 * there.len() - unknowns;
            for i in there {
                let rest = self.shifts[i][k]? - t - r.cross(&self.arms[i]);
                sum += rest.norm_squared();
            }
        }
        (freedom > 0).then(|| sum / freedom as f64)
    }

    /// Returns the motion at pose `k` from the points `used`: (translation of the centre, rotation). If no point (for a
    /// rotation: fewer than three points) was seen within the window, the window is widened until there are enough; `None`
    /// if the session has none.
    fn at(
        &self,
        k: usize,
        window: f64,
        used: &[usize],
        rigid: bool,
        without_itself: bool,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        if window.is_infinite() {
            return Some((Vector3::zeros(), Vector3::zeros()));
        }
        if without_itself && window == 0.0 {
            return None;
        }
        let mut window = window;
        loop {
            let reach = (REACH * window).floor() as usize;
            let near = k.saturating_sub(reach)..(k + reach + 1).min(self.sessions.len());
            let weighted: Vec<(f64, usize, Vector3<f64>)> = near
                .filter(|j| self.sessions[*j] == self.sessions[k] && !(without_itself && *j == k))
                .flat_map(|j| used.iter().map(move |i| (j, *i)))
                .filter_map(|(j, i)| {
                    let away = k.abs_diff(j) as f64;
                    let weight = if j == k {
                        1.0
                    } else {
                        libm::exp(-0.5 * (away / window).powi(2))
                    };
                    self.shifts[i][j].map(|shift| (weight, i, shift))
                })
                .collect();
            // A rotation needs three points.
            let enough = if rigid { used.len().min(3) } else { 1 };
            let distinct = used.iter().filter(|i| weighted.iter().any(|w| w.1 == **i));
            if distinct.count() >= enough {
                return Some(self.mean_motion(&weighted, rigid));
            }
            if reach > self.sessions.len() {
                return None;
            }
            window = (2.0 * window).max(0.5);
        }
    }

    fn mean_motion(
        &self,
        weighted: &[(f64, usize, Vector3<f64>)],
        rigid: bool,
    ) -> (Vector3<f64>, Vector3<f64>) {
        if !rigid {
            let total: f64 = weighted.iter().map(|(w, ..)| w).sum();
            let sum = weighted
                .iter()
                .fold(Vector3::zeros(), |s, (w, _, shift)| s + *w * shift);
            return (sum / total, Vector3::zeros());
        }
        let (mut normal, mut right) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
        for (weight, i, shift) in weighted {
            // shift = t + r × arm.
            let against = self.arms[*i].cross_matrix();
            let mut b = nalgebra::Matrix3x6::zeros();
            b.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            b.fixed_view_mut::<3, 3>(0, 3).copy_from(&-against);
            normal += b.transpose() * b * *weight;
            right += b.transpose() * shift * *weight;
        }
        // With two points, the rotation about the line through them is undetermined; this term makes it zero.
        for axis in 0..6 {
            normal[(axis, axis)] += 1e-9 * (1.0 + normal[(axis, axis)]);
        }
        let x = normal.lu().solve(&right).unwrap_or_else(Vector6::zeros);
        (
            Vector3::new(x[0], x[1], x[2]),
            Vector3::new(x[3], x[4], x[5]),
        )
    }
}
