//! Finds rows that are copies of an earlier row, not another measurement of its pose.
//!
//! A repeated measurement has noise of its own. Two readings with the noise σ of each component are within a small distance r
//! of each other with the chance (4π/3) r³ / (2 √π σ)³, and equal in every digit with d³ / (2 √π σ)³, if the digits have
//! steps of d. A row is a copy only where that chance, times the number of earlier readings of its pose, is small: neither
//! where the instrument is so quiet that its repeats are as near, nor where its digits are too few to show noise, nor where
//! there are so many repeats that some have to be near each other.
//!
//! What repeats show of σ counts more than what is stated or assumed. A pasted row is a second reading of a pose; third ones,
//! or second ones of half of all poses, were measured.

use std::collections::HashMap;

use poegp_protocol::cause::Cause;

use crate::measurement::MeasurementSet;
use crate::measurement::noise::{NoiseScales, QUIETEST};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::rotation::angle_between;
use crate::numeric::statistics::{extremes, median};
use crate::trust::digits::{positions_mm, step};
use crate::trust::finding::{Finding, Tier};
use crate::trust::wording::lines;

/// Difference of a joint's values, in rad or m, within which two rows are at one pose.
const SAME_JOINTS: f64 = 1.75e-4;
/// Largest chance by which a measurement may be as near an earlier one of its pose as a copy.
const CHANCE: f64 = 1e-3;
/// Noise of one component that is assumed where none is stated and the residuals show more, in m and rad: they contain
/// errors of the arm, too, which repeats share.
const ASSUMED: (f64, f64) = (1e-5, 1e-5);
/// Median distance of two measurements of a pose, in units of the noise of one component: √2 times the median of χ with
/// three components.
const APART: f64 = 2.175;
/// Share of the poses with a second reading from which second readings are no pasted rows.
const PLANNED: f64 = 0.5;
/// Number of copies, and share of all rows, from which a warning is given.
const WARNED: (usize, f64) = (3, 0.03);
/// Share of copies above which a fit follows them and not the other rows.
const MOSTLY: f64 = 0.5;

/// What shows whether a row is a copy.
struct Search<'a> {
    samples: &'a [InstrumentSample],
    /// Steps of the digits of positions (m) and of quaternions (rad).
    steps: (f64, f64),
    /// Noise of one component of rows that state none.
    noise: (f64, f64),
    /// Noise of one component that repeats show; infinite where there are none.
    repeats: (f64, f64),
    /// Joint whose values differ most.
    joint: usize,
    /// Rows in the order of that joint, and where each row is in it.
    order: Vec<usize>,
    location: Vec<usize>,
    /// Whether a row has another reading than all earlier rows of its pose.
    is_new: Vec<bool>,
}

impl<'a> Search<'a> {
    fn new(
        set: &MeasurementSet,
        samples: &'a [InstrumentSample],
        residuals: Option<NoiseScales>,
    ) -> Self {
        let range = |j: &usize| {
            let (low, high) = extremes(samples.iter().map(|s| s.joints[*j]));
            high - low
        };
        let joints = 0..samples.first().map_or(0, |s| s.joints.len());
        let widest = joints.max_by(|a, b| range(a).total_cmp(&range(b)));
        let joint = widest.unwrap_or(0);
        let mut order: Vec<usize> = (0..samples.len()).collect();
        order.sort_by(|a, b| samples[*a].joints[joint].total_cmp(&samples[*b].joints[joint]));
        let mut location = vec![0; samples.len()];
        for (at, row) in order.iter().enumerate() {
            location[*row] = at;
        }
        let of_rotations = set
            .measurements
            .iter()
            .filter_map(|m| m.orientation)
            .flat_map(|(w, v)| [w, v.x, v.y, v.z]);
        let of_rotations: Vec<f64> = of_rotations.collect();
        let least = |assumed: f64, found: Option<f64>| found.map_or(assumed, |f| f.min(assumed));
        Self {
            steps: (
                1e-3 * step(positions_mm(set)),
                2.0 * step(of_rotations.iter().copied()),
            ),
            noise: (
                least(ASSUMED.0, residuals.map(|r| r.position)),
                least(ASSUMED.1, residuals.map(|r| r.orientation)),
            ),
            repeats: (f64::INFINITY, f64::INFINITY),
            joint,
            order,
            location,
            is_new: are_new(samples),
            samples,
        }
        .with_repeats()
    }

    /// Returns the earlier rows of the pose of row `k`, without those that are equal to one of them in every digit.
    fn earlier(&self, k: usize) -> impl Iterator<Item = usize> + '_ {
        let own = &self.samples[k].joints;
        let is_near = move |i: &usize| {
            let other = self.samples[*i].joints[self.joint];
            (other - own[self.joint]).abs() <= SAME_JOINTS
        };
        let (before, from) = self.order.split_at(self.location[k]);
        let below = before.iter().rev().copied().take_while(is_near);
        let above = from.iter().skip(1).copied().take_while(is_near);
        let is_earlier = move |i: &usize| {
            *i < k && self.is_new[*i] && is_one_pose(&self.samples[*i].joints, own)
        };
        below.chain(above).filter(is_earlier)
    }

    /// Estimates the noise from the distances between a reading and the one before it at the same pose.
    fn with_repeats(mut self) -> Self {
        let mut poses = 0;
        // Distances in m and rad, of second readings and of later ones.
        let mut apart = [(Vec::new(), Vec::new()), (Vec::new(), Vec::new())];
        for k in (0..self.samples.len()).filter(|k| self.is_new[*k]) {
            let own = &self.samples[k];
            let is_same = |i: &usize| {
                let other = &self.samples[*i];
                (other.payload_kg, other.tool) == (own.payload_kg, own.tool)
            };
            let (mut count, mut last) = (0, None);
            for i in self.earlier(k).filter(is_same) {
                count += 1;
                last = last.max(Some(i));
            }
            let Some(last) = last.map(|i: usize| &self.samples[i]) else {
                poses += 1;
                continue;
            };
            let (positions, rotations) = &mut apart[usize::from(count > 1)];
            positions.push((last.observation.position() - own.observation.position()).norm());
            if let (Some(a), Some(b)) = (last.observation.pose(), own.observation.pose()) {
                rotations.push(angle_between(&a, &b));
            }
        }
        let [second, mut apart] = apart;
        if second.0.len() as f64 >= PLANNED * f64::from(poses) {
            apart.0.extend(second.0);
            apart.1.extend(second.1);
        }
        let noise = |distances: Vec<f64>, quietest: f64| match distances.is_empty() {
            true => f64::INFINITY,
            false => (median(distances) / APART).max(quietest),
        };
        self.repeats = (noise(apart.0, QUIETEST.0), noise(apart.1, QUIETEST.1));
        self
    }

    /// Returns the indices of the rows that copy an earlier one.
    fn rows(&self) -> Vec<usize> {
        let is_copy = |k: &usize| {
            let (mut readings, mut least) = (0, 1.0_f64);
            for i in self.earlier(*k) {
                readings += 1;
                least = least.min(self.chance(i, *k));
            }
            f64::from(readings) * least < CHANCE && readings > 0
        };
        (0..self.samples.len()).filter(is_copy).collect()
    }

    /// Returns the chance that two measurements of a pose are as near each other as these rows.
    fn chance(&self, i: usize, k: usize) -> f64 {
        let (a, b) = (&self.samples[i], &self.samples[k]);
        // The noisier of two rows decides how far apart they can be.
        let stated = |own: fn(&InstrumentSample) -> Option<f64>, assumed: f64, repeats: f64| {
            let noise = own(a).unwrap_or(assumed).max(own(b).unwrap_or(assumed));
            noise.min(repeats)
        };
        let apart = (a.observation.position() - b.observation.position()).norm();
        let noise = stated(|s| s.declared_noise.position, self.noise.0, self.repeats.0);
        let of_position = chance(apart, noise, self.steps.0);
        match (a.observation.pose(), b.observation.pose()) {
            (Some(a), Some(b)) if of_position * of_position < CHANCE => {
                let turned = angle_between(&a, &b);
                let noise = stated(
                    |s| s.declared_noise.orientation,
                    self.noise.1,
                    self.repeats.1,
                );
                // Both have to be near, each for itself.
                let larger = of_position.max(chance(turned, noise, self.steps.1));
                larger * larger
            }
            (Some(_), Some(_)) => of_position * of_position,
            _ => of_position,
        }
    }
}

/// Returns whether joints are those of one pose.
fn is_one_pose(a: &[f64], b: &[f64]) -> bool {
    let is_near = |(x, y): (&f64, &f64)| (x - y).abs() <= SAME_JOINTS;
    a.iter().zip(b).all(is_near)
}

/// Returns for each row whether its reading differs from those of all earlier rows of its pose.
fn are_new(samples: &[InstrumentSample]) -> Vec<bool> {
    let mut seen: HashMap<Vec<u64>, Vec<usize>> = HashMap::new();
    let of = |(k, sample): (usize, &InstrumentSample)| {
        let position = sample.observation.position();
        let pose = sample.observation.pose();
        let rotation = pose.iter().flat_map(|p| p.rotation.iter().copied());
        let digits = position.iter().copied().chain(rotation).map(f64::to_bits);
        let rows = seen.entry(digits.collect()).or_default();
        let is_new = !rows
            .iter()
            .any(|i| is_one_pose(&samples[*i].joints, &sample.joints));
        if is_new {
            rows.push(k);
        }
        is_new
    };
    samples.iter().enumerate().map(of).collect()
}

/// The rows of a file that copy an earlier one.
pub struct Copies<'a> {
    set: &'a MeasurementSet,
    rows: Vec<usize>,
}

impl<'a> Copies<'a> {
    /// Finds the copies; `residuals` are the scales of a geometry's residuals, if one was fitted.
    pub fn new(
        set: &'a MeasurementSet,
        samples: &[InstrumentSample],
        residuals: Option<NoiseScales>,
    ) -> Self {
        let rows = Search::new(set, samples, residuals).rows();
        Self { set, rows }
    }

    /// Returns the indices of the rows that copy an earlier one.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// Returns the finding that there are copies.
    pub fn finding(&self) -> Option<Finding> {
        let (copies, count) = (&self.rows, self.set.measurements.len());
        let share = copies.len() as f64 / count as f64;
        (copies.len() >= WARNED.0 && share >= WARNED.1).then(|| {
            let rows: Vec<usize> = (copies.iter())
                .map(|k| self.set.measurements[*k].line)
                .collect();
            let (tier, threshold, effect) = match share > MOSTLY {
                true => {
                    let effect = "a model would fit them instead of the other rows; remove them";
                    (Tier::Refused, MOSTLY, effect)
                }
                false => {
                    let effect = "they add nothing, and errors on them are not held out";
                    (Tier::Warning, WARNED.1, effect)
                }
            };
            let text = format!(
                "{} of {count} rows repeat an earlier row ({}): {effect}",
                copies.len(),
                lines(&rows)
            );
            Finding::new(Cause::Copies, tier, text, share, threshold).of_rows(rows)
        })
    }
}

/// Returns the chance that two measurements with the noise `sigma` of one component are within `apart` of each other, if
/// their components have the given step: the volume of that sphere times the largest density of their difference.
fn chance(apart: f64, sigma: f64, step: f64) -> f64 {
    let pi = std::f64::consts::PI;
    let volume = (4.0 * pi / 3.0 * apart.powi(3)).max(step.powi(3));
    (volume / (2.0 * pi.sqrt() * sigma).powi(3)).min(1.0)
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;
    use std::path::Path;

    use nalgebra::Vector3;
    use poegp_runtime::math::se3::{Pose, Twist};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::measurement::parse;
    use crate::measurement::sample::samples;
    use crate::robot::{LoadOptions, Robot};

    /// How rows are written.
    #[derive(Clone, Copy, Debug)]
    struct Written {
        whole: bool,
        stated: bool,
        decimals: usize,
    }

    /// Readings at some poses of an instrument.
    struct File {
        random: ChaCha8Rng,
        sigma: f64,
        rows: Vec<(Vec<f64>, Pose<f64>)>,
    }

    impl File {
        fn new(poses: usize, readings: usize, sigma: f64) -> Self {
            let mut out = Self {
                random: ChaCha8Rng::seed_from_u64(readings as u64),
                sigma,
                rows: Vec::new(),
            };
            for _ in 0..poses {
                let joints = (0..6).map(|_| out.random.random_range(-60.0..60.0));
                let joints: Vec<f64> = joints.collect();
                let truth = out.noisy(&Pose::identity(), 0.5);
                for _ in 0..readings {
                    let seen = out.noisy(&truth, sigma);
                    out.rows.push((joints.clone(), seen));
                }
            }
            out
        }

        /// Returns a pose with normal noise, in m and rad.
        fn noisy(&mut self, pose: &Pose<f64>, sigma: f64) -> Pose<f64> {
            let mut one = || -> f64 { StandardNormal.sample(&mut self.random) };
            let mut normal = || Vector3::new(one(), one(), one()) * sigma;
            let (linear, angular) = (Vector3::zeros(), normal());
            Pose {
                rotation: Pose::exp(&Twist { linear, angular }).rotation * pose.rotation,
                translation: pose.translation + normal(),
            }
        }

        /// Adds copies of every fifth row, with noise about it of this size.
        fn paste(&mut self, jitter: f64) {
            let copied: Vec<_> = self.rows.iter().step_by(5).cloned().collect();
            for (joints, seen) in copied {
                let seen = self.noisy(&seen, jitter);
                self.rows.push((joints, seen));
            }
        }

        /// Returns the number of rows that count as copies if that is said of the file, otherwise 0.
        fn copies(&self, how: Written) -> usize {
            let Written {
                whole,
                stated,
                decimals,
            } = how;
            let mut csv = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm".to_owned();
            csv += if whole { ",qw,qx,qy,qz" } else { "" };
            csv += if stated {
                ",sigma_mm,sigma_mrad\n"
            } else {
                "\n"
            };
            for (joints, seen) in &self.rows {
                let joints: Vec<String> = joints.iter().map(|q| format!("{q:.6}")).collect();
                csv += &joints.join(",");
                for x in seen.translation.iter() {
                    let _ = write!(csv, ",{:.decimals$}", 1e3 * x);
                }
                if whole {
                    let (w, v) = seen.quaternion();
                    let _ = write!(csv, ",{w:.12},{:.12},{:.12},{:.12}", v.x, v.y, v.z);
                }
                if stated {
                    let milli = 1e3 * self.sigma;
                    let _ = write!(csv, ",{milli},{milli}");
                }
                csv += "\n";
            }
            let set = parse(Path::new("repeats.csv"), csv.as_bytes()).unwrap();
            let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
            let samples = samples(&set, &robot, &mut Vec::new()).unwrap();
            let copies = Copies::new(&set, &samples, None);
            copies.finding().map_or(0, |finding| finding.rows.len())
        }
    }

    fn all_ways(decimals: &[usize]) -> Vec<Written> {
        let ways = [(false, false), (false, true), (true, false), (true, true)];
        let of = |(whole, stated)| {
            let written = move |decimals: &usize| Written {
                whole,
                stated,
                decimals: *decimals,
            };
            decimals.iter().map(written).collect::<Vec<_>>()
        };
        ways.into_iter().flat_map(of).collect()
    }

    /// However often every pose is measured, and however quiet the instrument is, no row is a copy.
    #[test]
    fn repeats_are_no_copies_however_many() {
        for (poses, readings) in [(40, 2), (40, 3), (20, 10), (6, 60), (2, 300)] {
            for sigma in [1e-6_f64, 3e-6, 10e-6, 30e-6] {
                let file = File::new(poses, readings, sigma);
                for how in all_ways(&[6, 3, 2]) {
                    assert_eq!(file.copies(how), 0, "{readings} {sigma} {how:?}");
                }
            }
        }
    }

    /// Pasted rows are found beside however many repeats, also with a little noise of their own.
    #[test]
    fn pasted_rows_are_found_beside_repeats() {
        for readings in [1, 2, 3, 10, 20] {
            for sigma in [1e-6_f64, 3e-6, 10e-6, 30e-6] {
                for (jitter, expected) in [(0.0, 1.0), (sigma.min(1e-5) / 40.0, 0.5)] {
                    let mut file = File::new(20, readings, sigma);
                    let before = file.rows.len();
                    file.paste(jitter);
                    let pasted = (file.rows.len() - before) as f64;
                    for how in all_ways(&[6]) {
                        let found = file.copies(how) as f64;
                        let text = format!("{readings} {sigma} {jitter} {how:?}: {found}");
                        assert!(found >= expected * pasted, "{text}");
                        assert!(found < 1.05 * pasted + 3.0, "{text}");
                    }
                }
            }
        }
    }
}
