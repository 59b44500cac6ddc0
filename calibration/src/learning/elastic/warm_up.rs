//! Warm-up: a drift of base, tool and joint zeros that settles while an arm is measured.
//!
//! ```text
//! y = … + e(t) (A_base b + A_tool t + J z) + noise,   e(t) = (exp(−t/τ) − exp(−T/τ)) / (1 − exp(−T/τ))
//! ```
//!
//! e is 1 when a session begins and 0 at T, when the longest session ends: the model describes the arm at that time.
//! Base, tool and joints have one variance each. With S of a fitted model, W the columns times e, u = Wᵀ S⁻¹ y, M = Wᵀ
//! S⁻¹ W and the variances Λ, the log evidence rises by ½ uᵀ (Λ⁻¹ + M)⁻¹ u − ½ log |I + Λ M|; Λ and τ maximise this rise.
//! The model is fitted to the mean of the measurements of a pose. Their differences from this mean, which it does not
//! describe, have the noise alone: u and M are sums over both.
//!
//! A target that slipped has a similar trend. So a step, with e = 1 before a moment and 0 from it on, is tried as well, and
//! there is no warm-up if it raises the evidence more.

use poegp_runtime::math::se3::{Pose, Twist};
use serde::Serialize;

use crate::identification::parametric::state::{Linearised, ParametricModel, ROWS};
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::elapsed::TimeUnit;
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::BaseSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::rotation::turn;

/// Least rise of the log evidence for a warm-up: as for an own-joint curve, far above what three variances and a time
/// constant can gain from noise.
const RISE: f64 = 20.0;
/// Time constants that are tried, as fractions of the longest session; the last is equivalent to a straight line.
const TIME_CONSTANTS: [f64; 7] = [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 20.0];
/// Fraction of the longest session above which a time constant is equivalent to a straight line.
const STRAIGHT: f64 = 2.0;
/// Standard deviations that are tried for each group, in m and rad; zero means that the group does not change.
const DEVIATIONS: [f64; 12] = [
    0.0, 2e-6, 4e-6, 8e-6, 16e-6, 32e-6, 64e-6, 128e-6, 256e-6, 512e-6, 1e-3, 2e-3,
];
/// Most moments at which a step is tried instead.
const STEPS: usize = 40;
/// Most rounds over the groups.
const ROUNDS: usize = 4;
/// Number of groups: base, tool, joints.
const GROUPS: usize = 3;

/// The change during a session relative to its end.
#[derive(Clone, Debug)]
pub struct WarmUp {
    /// Parametric model around which the change was found.
    state: ParametricModel,
    /// Time constant τ, in the unit of the samples' time.
    time_constant: f64,
    /// End T of the longest session.
    end: f64,
    /// Changes b, t and z: six for the base, six for the tool, and one for each joint.
    change: Vec<f64>,
    /// Report for a reader.
    pub report: WarmUpReport,
}

/// Report of a warm-up that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WarmUpReport {
    /// Rise of the log evidence, in nats.
    pub evidence_rise_nats: f64,
    /// Time constant in `unit`; `None` where the change is equivalent to a straight line.
    pub time_constant: Option<f64>,
    /// Unit of time.
    pub unit: TimeUnit,
    /// Largest displacement of a measured target, in mm.
    pub largest_mm: f64,
    /// Change of each joint's zero from beginning to end, in µrad or µm.
    pub joint_zeros_urad: Vec<f64>,
    /// Whether the warm-up was removed from the measurements before the model was fitted.
    pub removed: bool,
}

impl WarmUpReport {
    /// Returns a sentence for a reader.
    pub fn line(&self) -> String {
        let unit = self.unit.name();
        let course = self.time_constant.map_or_else(
            || "steadily".to_owned(),
            |time| format!("with a time constant of {time:.0} {unit}"),
        );
        let zeros: Vec<String> = self
            .joint_zeros_urad
            .iter()
            // Adding zero avoids "-0".
            .map(|zero| format!("{:.0}", zero.round() + 0.0))
            .collect();
        let fate = match self.removed {
            true => "removed: the model describes the arm at the last row",
            false => "kept: the model describes an average over the rows",
        };
        format!(
            "warm-up: targets moved by up to {:.3} mm {course} while they were measured (joint zeros {} µrad; log evidence +{:.0} \
             nats); {fate}",
            self.largest_mm,
            zeros.join(", "),
            self.evidence_rise_nats
        )
    }
}

/// Returns e(t).
fn share(time: f64, time_constant: f64, end: f64) -> f64 {
    let at_end = libm::expm1(-end / time_constant);
    (at_end - libm::expm1(-time / time_constant)) / at_end
}

impl WarmUp {
    /// Estimates the warm-up that a fit to `samples` did not model; `measurements` are those of each sample. `None` where
    /// the evidence shows none, where a step explains more, or where the time of a measurement is unknown.
    pub fn estimate(
        fit: &ElasticFit,
        samples: &[BaseSample],
        measurements: &[Vec<BaseSample>],
    ) -> Option<Self> {
        let solved = fit.solved.as_ref()?;
        let of = |rows: &Vec<BaseSample>| rows.iter().map(|s| Some(s.elapsed?.value)).collect();
        let times: Option<Vec<Vec<f64>>> = measurements.iter().map(of).collect();
        let (times, unit) = (times?, samples.first()?.elapsed?.unit);
        let end = times.iter().flatten().fold(0.0, |end: f64, t| end.max(*t));
        if end <= 0.0 {
            return None;
        }
        let linear = fit.origin.linearise(samples, fit.scales);
        let columns = Columns::of(&fit.origin, samples, &linear);
        let repeated = measurements
            .iter()
            .zip(&times)
            .filter(|(rows, _)| rows.len() > 1);
        let differences: Vec<Differences> = repeated
            .map(|(rows, times)| Differences::of(fit, rows, times))
            .collect();
        let likely = |share: &dyn Fn(f64) -> f64| {
            let mean = |times: &[f64]| {
                times.iter().map(|time| share(*time)).sum::<f64>() / times.len() as f64
            };
            let w = columns.times(|k| mean(&times[k]));
            let mut evidence = Evidence {
                u: product(Transposed(&w), &solved.alpha),
                m: product(Transposed(&w), &solved.factor.solve(&w)),
            };
            for of in &differences {
                of.add_to(&mut evidence, share);
            }
            evidence.largest()
        };
        let best = TIME_CONSTANTS
            .into_iter()
            .map(|part| {
                let time_constant = part * end;
                let found = likely(&|time| share(time, time_constant, end));
                (time_constant, found)
            })
            .max_by(|(_, one), (_, other)| one.rise.total_cmp(&other.rise))?;
        let (time_constant, LikelyChange { rise, change }) = best;
        // What was moved between two rows did not warm up.
        let is_step = |moment: f64| likely(&|time| f64::from(u8::from(time < moment))).rise > rise;
        if rise <= RISE || moments(&times).into_iter().any(is_step) {
            return None;
        }
        let joints = change[2 * ROWS..].iter().map(|z| -1e6 * z).collect();
        let mut out = Self {
            state: fit.state.clone(),
            time_constant,
            end,
            change,
            report: WarmUpReport {
                evidence_rise_nats: rise,
                time_constant: (time_constant < STRAIGHT * end).then_some(time_constant),
                unit,
                largest_mm: 0.0,
                joint_zeros_urad: joints,
                removed: false,
            },
        };
        let displacements = out.displacements(samples).into_iter();
        out.report.largest_mm = displacements.fold(0.0, |most: f64, displacement| {
            most.max(1e3 * displacement.linear.norm())
        });
        Some(out)
    }

    /// Returns the displacement and rotation of each target relative to where it would be at the end, along and about the
    /// axes of the base; zero where the time is unknown.
    fn displacements(&self, samples: &[BaseSample]) -> Vec<Twist<f64>> {
        let linear = self.state.linearise(samples, NoiseScales::ONE);
        let columns = Columns::of(&self.state, samples, &linear);
        let of = |(k, sample): (usize, &BaseSample)| {
            let share = sample
                .elapsed
                .map_or(0.0, |time| share(time.value, self.time_constant, self.end));
            Twist::from_array(&columns.displacement(k, &self.change).map(|x| share * x))
        };
        samples.iter().enumerate().map(of).collect()
    }

    /// Returns the samples as they would have been measured at the end.
    pub fn removed_from(&self, samples: &[BaseSample]) -> Vec<BaseSample> {
        let displacements = self.displacements(samples).into_iter();
        let without = |(sample, moved): (&BaseSample, Twist<f64>)| BaseSample {
            observation: moved_back(&sample.observation, &moved),
            ..sample.clone()
        };
        samples.iter().zip(displacements).map(without).collect()
    }
}

/// Removes a displacement of its target from an observation.
fn moved_back(observation: &Observation, moved: &Twist<f64>) -> Observation {
    let position = observation.position() - moved.linear;
    match observation {
        Observation::Position(_) => Observation::Position(position),
        Observation::Pose(pose) => {
            let back = turn(-moved.angular);
            Observation::Pose(Pose {
                translation: position,
                ..back * *pose
            })
        }
    }
}

/// Returns moments at which a step is tried, evenly among the measurements.
fn moments(times: &[Vec<f64>]) -> Vec<f64> {
    let mut all: Vec<f64> = times.iter().flatten().copied().collect();
    all.sort_unstable_by(f64::total_cmp);
    let parts = STEPS.min(all.len());
    (1..parts).map(|i| all[i * all.len() / parts]).collect()
}

/// The differences of the measurements of one pose from their mean.
struct Differences {
    columns: Columns,
    /// Residuals, and the standard deviations of their noise.
    residuals: Vec<[f64; ROWS]>,
    noise: Vec<[f64; ROWS]>,
    times: Vec<f64>,
}

impl Differences {
    fn of(fit: &ElasticFit, rows: &[BaseSample], times: &[f64]) -> Self {
        let linear = fit.origin.linearise(rows, fit.scales);
        let noise = |row: usize| {
            std::array::from_fn(|i| {
                let h = fit.hyperparameters[usize::from(i >= 3)];
                libm::exp(0.5 * h) * linear.relative_noise(ROWS * row + i, h)
            })
        };
        Self {
            columns: Columns::of(&fit.origin, rows, &linear),
            residuals: fit.origin.residuals(rows, fit.scales),
            noise: (0..rows.len()).map(noise).collect(),
            times: times.to_vec(),
        }
    }

    /// Adds their part of u and M for a share that each time has of the change.
    fn add_to(&self, evidence: &mut Evidence, share: &dyn Fn(f64) -> f64) {
        let w = self.columns.times(|row| share(self.times[row]));
        let y = Mat::from_fn(w.nrows(), 1, |at, _| self.residuals[at / ROWS][at % ROWS]);
        let (w, y) = (self.centred(&w), self.centred(&y));
        evidence.u += product(Transposed(&w), &y);
        evidence.m += product(Transposed(&w), &w);
    }

    /// Returns what differs from the mean over the measurements, in units of the noise.
    fn centred(&self, all: &Mat<f64>) -> Mat<f64> {
        let count = self.times.len();
        let mean = Mat::from_fn(ROWS, all.ncols(), |i, column| {
            let of = |row: usize| all[(ROWS * row + i, column)];
            (0..count).map(of).sum::<f64>() / count as f64
        });
        Mat::from_fn(all.nrows(), all.ncols(), |at, column| {
            let (row, i) = (at / ROWS, at % ROWS);
            (all[(at, column)] - mean[(i, column)]) / self.noise[row][i]
        })
    }
}

/// Columns A_base, A_tool and J of every sample.
struct Columns {
    /// All columns, 6k × (12 + n).
    all: Mat<f64>,
}

impl Columns {
    fn of(state: &ParametricModel, samples: &[BaseSample], linear: &Linearised) -> Self {
        let joints = state.layout.joints;
        let from = |row: usize, column: usize| match column {
            0..ROWS => linear.a[(row, column)],
            _ if column < 2 * ROWS => {
                let tool = samples[row / ROWS].tool;
                linear.a[(row, ROWS * (joints + tool) + column - ROWS)]
            }
            _ => linear.jacobian[(row, column - 2 * ROWS)],
        };
        Self {
            all: Mat::from_fn(ROWS * samples.len(), 2 * ROWS + joints, from),
        }
    }

    /// Returns W: the rows of sample k times `share(k)`.
    fn times(&self, share: impl Fn(usize) -> f64) -> Mat<f64> {
        Mat::from_fn(self.all.nrows(), self.all.ncols(), |row, column| {
            share(row / ROWS) * self.all[(row, column)]
        })
    }

    /// Returns the displacement of the target of sample k by `change`.
    fn displacement(&self, k: usize, change: &[f64]) -> [f64; ROWS] {
        std::array::from_fn(|i| {
            let columns = change.iter().enumerate();
            columns
                .map(|(column, x)| self.all[(ROWS * k + i, column)] * x)
                .sum()
        })
    }
}

/// The statistics u and M of the evidence.
struct Evidence {
    u: Mat<f64>,
    m: Mat<f64>,
}

/// The most likely change, and its rise of the log evidence.
struct LikelyChange {
    rise: f64,
    change: Vec<f64>,
}

impl Evidence {
    /// Finds the standard deviations of base, tool and joints that raise the evidence most, and returns their change.
    fn largest(&self) -> LikelyChange {
        let mut deviations = [DEVIATIONS[4]; GROUPS];
        let mut best = self.with(&deviations);
        for _ in 0..ROUNDS {
            let before = deviations;
            for group in 0..GROUPS {
                let mut tried = deviations;
                for deviation in DEVIATIONS {
                    tried[group] = deviation;
                    let found = self.with(&tried);
                    if found.rise > best.rise {
                        (best, deviations) = (found, tried);
                    }
                }
            }
            if before == deviations {
                break;
            }
        }
        best
    }

    /// Returns the change for these standard deviations: R = Λ½, B = I + R M R, change = R B⁻¹ R u.
    fn with(&self, deviations: &[f64; GROUPS]) -> LikelyChange {
        let count = self.m.nrows();
        let r = |i: usize| deviations[(i / ROWS).min(GROUPS - 1)];
        let b = Mat::from_fn(count, count, |i, j| {
            f64::from(u8::from(i == j)) + r(i) * self.m[(i, j)] * r(j)
        });
        let none = LikelyChange {
            rise: f64::NEG_INFINITY,
            change: vec![0.0; count],
        };
        let Ok(factor) = Factor::new(b, 1) else {
            return none;
        };
        let scaled = Mat::from_fn(count, 1, |i, _| r(i) * self.u[(i, 0)]);
        let solved = factor.solve(&scaled);
        let lower = factor.lower();
        let rise = (0..count)
            .map(|i| 0.5 * scaled[(i, 0)] * solved[(i, 0)] - libm::log(lower[(i, i)]))
            .sum();
        let change = (0..count).map(|i| r(i) * solved[(i, 0)]).collect();
        LikelyChange { rise, change }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rise is that of log N(y; 0, S + W Λ Wᵀ) above log N(y; 0, S), and the change is Λ Wᵀ (S + W Λ Wᵀ)⁻¹ y.
    #[test]
    fn the_evidence_is_that_of_the_whole_covariance() {
        let (rows, columns) = (40, 2 * ROWS + 3);
        let wave = |i: usize, j: usize| libm::sin(1.3 * i as f64 + 0.7 * (j * j) as f64);
        let s = Mat::from_fn(rows, rows, |i, j| {
            libm::exp(-0.1 * (i as f64 - j as f64).powi(2)) + if i == j { 0.3 } else { 0.0 }
        });
        let w = Mat::from_fn(rows, columns, |i, j| 1e4 * wave(i, j));
        let y = Mat::from_fn(rows, 1, |i, _| 2.0 * wave(i, 3) + libm::cos(2.1 * i as f64));
        let deviations: [f64; GROUPS] = [64e-6, 0.0, 256e-6];
        let variance = |j: usize| deviations[(j / ROWS).min(2)].powi(2);
        let scaled = Mat::from_fn(rows, columns, |i, j| w[(i, j)] * variance(j));
        let whole = &s + product(&scaled, &w.transpose());
        let log_density = |covariance: &Mat<f64>| {
            let factor = Factor::new(covariance.clone(), 1).unwrap();
            let solved = factor.solve(&y);
            let lower = factor.lower();
            let of = |i: usize| -0.5 * y[(i, 0)] * solved[(i, 0)] - libm::log(lower[(i, i)]);
            ((0..rows).map(of).sum::<f64>(), solved)
        };
        let (with, solved) = log_density(&whole);
        let (without, alpha) = log_density(&s);
        let factor = Factor::new(s, 1).unwrap();
        let evidence = Evidence {
            u: product(Transposed(&w), &alpha),
            m: product(Transposed(&w), &factor.solve(&w)),
        };
        let found = evidence.with(&deviations);
        assert!(
            (found.rise - (with - without)).abs() < 1e-9,
            "{}",
            found.rise
        );
        for (j, change) in found.change.iter().enumerate() {
            let projected: f64 = (0..rows).map(|i| w[(i, j)] * solved[(i, 0)]).sum();
            let expected = variance(j) * projected;
            assert!(
                (change - expected).abs() < 1e-12,
                "{j}: {change}, {expected}"
            );
        }
        let best = evidence.largest();
        assert!(best.rise >= found.rise && best.rise >= 0.0);
    }

    /// From one to nothing, and a straight line where the time constant is long.
    #[test]
    fn the_share_falls_from_one_to_nothing() {
        for time_constant in [3.0, 30.0, 3e4] {
            assert_eq!(share(0.0, time_constant, 60.0), 1.0);
            assert_eq!(share(60.0, time_constant, 60.0), 0.0);
            let falls =
                |t: f64| share(t, time_constant, 60.0) > share(t + 1.0, time_constant, 60.0);
            assert!((0..60).map(f64::from).all(falls));
        }
        assert!((share(15.0, 3e6, 60.0) - 0.75).abs() < 1e-5);
    }
}
