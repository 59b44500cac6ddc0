//! The motion of the instrument from what its reference points seem to do.

use nalgebra::{Matrix6, Vector3, Vector6};
use poegp_runtime::math::se3::{Pose, Twist};

/// Standard deviations of the Gaussian window that are tried, in poses; infinite is no motion at all.
const WINDOWS: [f64; 9] = [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, f64::INFINITY];
/// Where the window ends, in its standard deviations.
const REACH: f64 = 4.0;
/// A rotation is allowed when the mean square of the points' disagreement falls below this share. What is noise falls by none:
/// equations and unknowns are counted. On a real tracker session (700 poses, three points) it falls to 0.24, and held-out
/// errors of the arm from 0.0500 to 0.0496 mm: that is not clear, and a rotation is extrapolated beyond the points.
const CLEARLY: f64 = 0.1;
/// Rounds of the mean positions and motions that are found together.
const ROUNDS: usize = 50;

/// Mean positions r_i of p_ik = r_i + t_k, with the motions t_k of mean zero.
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

/// What the points did, ready to be smoothed.
pub struct Track<'a> {
    /// Centre of the points: rotations are about it.
    pub centre: Vector3<f64>,
    /// Points from the centre.
    arms: Vec<Vector3<f64>>,
    /// `[point][pose]`: p − r.
    shifts: Vec<Vec<Option<Vector3<f64>>>>,
    sessions: &'a [usize],
}

/// The motion that was chosen.
pub struct Motion {
    /// Whether it rotates.
    pub rigid: bool,
    /// Window of each axis.
    pub windows: [f64; 3],
    /// Translation of the centre at each pose.
    pub translations: Vec<Vector3<f64>>,
    /// Rotation vector at each pose.
    pub rotations: Vec<Vector3<f64>>,
    /// RMS per axis of what was left out, metres: without correction and with it (with a rotation: what a pose's points
    /// disagree about).
    pub left_out: [f64; 2],
}

impl Motion {
    /// For each pose: takes a point from where it is to where it was seen.
    pub fn poses(&self, centre: &Vector3<f64>) -> Vec<Pose<f64>> {
        let pose = |(t, r): (&Vector3<f64>, &Vector3<f64>)| {
            let twist = Twist {
                linear: Vector3::zeros(),
                angular: *r,
            };
            let rotation = Pose::exp(&twist).rotation;
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
    /// From the points' places and where they were seen, outliers taken out.
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

    /// The motion that predicts best what was left out.
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

    /// Mean square for each axis of what was left out of the estimate with this window: each point in turn, or each pose
    /// when there is one point.
    fn left_out(&self, window: f64) -> [f64; 3] {
        let (mut sum, mut count) = (Vector3::zeros(), 0);
        for (i, shifts) in self.shifts.iter().enumerate() {
            let one = self.shifts.len() == 1;
            let used: Vec<usize> = (0..self.shifts.len()).filter(|j| one || *j != i).collect();
            // A point has to be predicted up to its position, which the others do not determine.
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

    /// Mean square per degree of freedom of what the points of one pose disagree about after its own motion; `None` when
    /// no pose has points enough.
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

    /// Motion at pose `k` by the points `used`: (translation of the centre, rotation). Where no point (for a
    /// rotation: no three points) was seen within the window it is widened until there is; `None` when the session has none.
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
        // Two points leave the rotation about the line through them open: it is taken as none.
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
