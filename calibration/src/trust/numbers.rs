//! Examines only the numbers, before anything is solved: too few rows, repeated rows, placeholders for missing values,
//! cut-off values.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::measurement::MeasurementSet;
use crate::measurement::elapsed::LEAST_SORTED;
use crate::measurement::folds::different_poses;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::extremes;
use crate::robot::Robot;
use crate::trust::alignment::median;
use crate::trust::finding::{Finding, Tier};
use crate::trust::wording::{lines, three_digits};

/// Equations per unknown below which nothing is fitted, and below which the user is warned.
const FEW: (f64, f64) = (1.25, 2.9);
/// Range of a joint below which it counts as not moving, in rad and m.
const STILL: (f64, f64) = (8.73e-3, 1e-3);
/// Differences in joints (rad), position (m) and orientation (rad) within which rows are copies: a repeated measurement
/// differs by more.
const COPY: (f64, f64, f64) = (1.75e-4, 1e-5, 1e-5);
/// Number of copies, and share of all rows, from which a warning is given.
const COPIES: (usize, f64) = (3, 0.03);
/// Motion of the flange between two rows, in m and rad, beyond which they cannot have the same pose.
const MOVED: (f64, f64) = (2e-3, 5e-3);
/// Number of rows, and share of all rows, at the extreme value of a column from which it counts as cut off.
const CUT: (usize, f64) = (3, 0.02);
/// Share of distinct values among the others in a column above which a value that several rows share stands out.
const DIFFERENT: f64 = 0.75;
/// Distance from the median beyond which a value may stand for a missing one, in units of the median distance.
const FAR: f64 = 12.0;
/// Largest payload of an arm of 1 m, in kg; it grows with the cube of the reach.
const HEAVIEST: f64 = 40.0;

/// Returns the findings from the numbers alone.
pub fn examine(
    robot: &Robot,
    chain: &Poe<f64>,
    set: &MeasurementSet,
    samples: &[InstrumentSample],
    reach: f64,
) -> Vec<Finding> {
    let flanges: Vec<Pose<f64>> = samples
        .iter()
        .map(|s| chain.forward(&s.serial_joints))
        .collect();
    let scene = Scene {
        robot,
        set,
        samples,
        flanges,
    };
    let mut out = Vec::new();
    let copies = scene.copies();
    out.extend(scene.stuck());
    out.extend(scene.placeholders());
    let still = scene.still();
    out.extend(scene.cut_off(&copies, &still));
    out.extend(scene.sorted());
    out.extend(scene.few(still.len()));
    out.extend(scene.payload(reach));
    if copies.len() >= COPIES.0 && copies.len() as f64 >= COPIES.1 * samples.len() as f64 {
        let rows: Vec<usize> = copies.iter().map(|k| scene.line(*k)).collect();
        let share = copies.len() as f64 / samples.len() as f64;
        let text = format!(
            "{} of {} rows repeat an earlier row ({}): they add nothing, and errors on them are not held out",
            copies.len(),
            samples.len(),
            lines(&rows)
        );
        out.push(Finding {
            cause: Cause::Copies,
            tier: Tier::Warning,
            text,
            rows,
            value: share,
            threshold: COPIES.1,
        });
    }
    if !still.is_empty() {
        let names: Vec<String> = still.iter().map(|(j, _)| (j + 1).to_string()).collect();
        let widest = still.iter().map(|(_, range)| *range).fold(0.0, f64::max);
        let (noun, verb) = if still.len() == 1 {
            ("joint", "does")
        } else {
            ("joints", "do")
        };
        let text = format!(
            "{noun} {} {verb} not move (within {}°): errors of these joints stay unknown",
            names.join(", "),
            three_digits(widest.to_degrees())
        );
        out.push(Finding {
            cause: Cause::Still,
            tier: Tier::Warning,
            text,
            rows: Vec::new(),
            value: widest,
            threshold: STILL.0,
        });
    }
    out
}

struct Scene<'a> {
    robot: &'a Robot,
    set: &'a MeasurementSet,
    samples: &'a [InstrumentSample],
    flanges: Vec<Pose<f64>>,
}

impl Scene<'_> {
    fn line(&self, row: usize) -> usize {
        self.set.measurements[row].line
    }

    /// Finds a column by which the rows are sorted, so that their order is not chronological.
    fn sorted(&self) -> Option<Finding> {
        let name = self.set.sorted_by()?;
        Some(Finding {
            cause: Cause::Time,
            tier: Tier::Note,
            text: format!(
                "the rows are sorted by {name}, so that steps and drifts of the instrument cannot be seen: give the time of \
                 each row in a column time_s"
            ),
            rows: Vec::new(),
            value: self.samples.len() as f64,
            threshold: LEAST_SORTED as f64,
        })
    }

    /// Returns the joints that do not move, with their ranges in rad or m.
    fn still(&self) -> Vec<(usize, f64)> {
        let range = |j: usize| {
            let (low, high) = extremes(self.samples.iter().map(|s| s.joints[j]));
            high - low
        };
        let joints = self.robot.joints.iter().enumerate();
        let still = joints.filter_map(|(j, joint)| {
            let least = match joint.kind {
                JointKind::Revolute => STILL.0,
                JointKind::Prismatic => STILL.1,
            };
            Some((j, range(j))).filter(|(_, range)| *range < least)
        });
        still.collect()
    }

    /// Returns the rows that repeat an earlier one.
    fn copies(&self) -> Vec<usize> {
        let same = |a: &InstrumentSample, b: &InstrumentSample| {
            let near = |(x, y): (&f64, &f64)| (x - y).abs() <= COPY.0;
            let apart = a.observation.position() - b.observation.position();
            let is_turned = || match (a.observation.pose(), b.observation.pose()) {
                (Some(a), Some(b)) => (a.inverse() * b).log().angular.norm() > COPY.2,
                _ => false,
            };
            // Compares x first, because nearly all pairs of rows differ in it.
            apart.x.abs() <= COPY.1
                && apart.norm() <= COPY.1
                && a.joints.iter().zip(&b.joints).all(near)
                && !is_turned()
        };
        let earlier = |k: &usize| {
            self.samples[..*k]
                .iter()
                .any(|s| same(s, &self.samples[*k]))
        };
        (0..self.samples.len()).filter(earlier).collect()
    }

    /// Finds rows that have the pose of an earlier row to the last digit although the joints differ.
    fn stuck(&self) -> Option<Finding> {
        let mut rows: Vec<usize> = Vec::new();
        for (k, own) in self.set.measurements.iter().enumerate() {
            let held = self.set.measurements[..k]
                .iter()
                .enumerate()
                .any(|(i, other)| {
                    own.position == other.position
                        && own.orientation == other.orientation
                        && self.has_moved(i, k)
                });
            if held {
                rows.push(self.line(k));
            }
        }
        (rows.len() >= 2).then(|| {
            let text = format!(
                "{} rows have the pose of an earlier row to the last digit, though the robot had moved ({}): the \
                 instrument stood still, or its last value was written again",
                rows.len(),
                lines(&rows)
            );
            refused(Cause::Stuck, text, rows, 2.0)
        })
    }

    fn has_moved(&self, i: usize, k: usize) -> bool {
        let between = self.flanges[i].inverse() * self.flanges[k];
        // A rotation about the target alone does not change the position.
        between.translation.norm() > MOVED.0 && self.samples[i].observation.position().norm() > 0.0
            || between.log().angular.norm() > MOVED.1
                && self.samples[i].observation.has_orientation()
    }

    /// Finds placeholders for missing values: equal numbers far from all others, or equal orientations at other joints.
    fn placeholders(&self) -> Option<Finding> {
        let mut rows: Vec<usize> = Vec::new();
        let mut named = String::new();
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let values: Vec<f64> = self
                .set
                .measurements
                .iter()
                .map(|m| m.position[axis])
                .collect();
            let middle = median(values.clone());
            let apart = median(values.iter().map(|v| (v - middle).abs()).collect());
            let far: Vec<usize> = (0..values.len())
                .filter(|k| (values[*k] - middle).abs() > FAR * apart.max(1e-3))
                .collect();
            let missing: Vec<usize> = far
                .iter()
                .copied()
                .filter(|k| {
                    let shared = far.iter().filter(|i| values[**i] == values[*k]).count() >= 2;
                    shared || stands_for_missing(values[*k])
                })
                .collect();
            if let (Some(first), true) = (missing.first(), named.is_empty()) {
                named = format!("{name} is {} mm", three_digits(1e3 * values[*first]));
            }
            rows.extend(missing);
        }
        if rows.is_empty() {
            rows = self.held_orientations();
            named = "the orientation is that of other rows to the last digit".to_owned();
        }
        rows.sort_unstable();
        rows.dedup();
        (!rows.is_empty()).then(|| {
            let rows: Vec<usize> = rows.iter().map(|k| self.line(*k)).collect();
            let text = format!(
                "in {} rows ({}) {named}, though the robot had moved: a number that stands for a missing one",
                rows.len(),
                lines(&rows)
            );
            refused(Cause::Placeholder, text, rows, 1.0)
        })
    }

    /// Returns rows with the orientation of another row at another position, although the flange had rotated.
    fn held_orientations(&self) -> Vec<usize> {
        let all = &self.set.measurements;
        let held = |k: &usize| {
            let turned = |i: usize| {
                let between = self.flanges[i].inverse() * self.flanges[*k];
                between.log().angular.norm()
            };
            // The rotation is compared last, because hardly any pair of rows meets the other conditions.
            (0..all.len()).any(|i| {
                i != *k
                    && all[i].orientation.is_some()
                    && all[i].orientation == all[*k].orientation
                    && all[i].position != all[*k].position
                    && turned(i) > 10.0 * MOVED.1
            })
        };
        let rows: Vec<usize> = (0..all.len()).filter(held).collect();
        if rows.len() >= 2 { rows } else { Vec::new() }
    }

    /// Finds a column whose extreme value several rows share that are not copies of each other.
    fn cut_off(&self, copies: &[usize], still: &[(usize, f64)]) -> Option<Finding> {
        let own: Vec<usize> = (0..self.samples.len())
            .filter(|k| copies.binary_search(k).is_err())
            .collect();
        let all: Vec<_> = own.iter().map(|k| &self.set.measurements[*k]).collect();
        let is_moving = |j: &usize| still.iter().all(|(other, _)| other != j);
        let joints = (0..self.robot.joints.len()).filter(is_moving).map(|j| {
            let column = &self.set.joint_columns[j];
            let values: Vec<f64> = all
                .iter()
                .map(|m| column.unit.from_si(m.joints[j]))
                .collect();
            (column.name.clone(), values)
        });
        let positions = ["x", "y", "z"].into_iter().enumerate().map(|(axis, name)| {
            (
                format!("{name} (mm)"),
                all.iter().map(|m| 1e3 * m.position[axis]).collect(),
            )
        });
        for (name, values) in joints.chain(positions) {
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let count = sorted.len();
            let mut distinct = sorted.clone();
            distinct.dedup();
            for extreme in [sorted[0], sorted[count - 1]] {
                let at = (0..count)
                    .filter(|k| values[*k] == extreme)
                    .collect::<Vec<_>>();
                let others = count - at.len();
                let is_cut = at.len() >= CUT.0
                    && at.len() as f64 >= CUT.1 * count as f64
                    && others >= at.len()
                    && (distinct.len() - 1) as f64 > DIFFERENT * others as f64;
                if is_cut {
                    let rows: Vec<usize> = at.iter().map(|k| self.line(own[*k])).collect();
                    let text = format!(
                        "{name} ends at {} in {} rows ({}) while all other values differ: it looks cut off",
                        three_digits(extreme),
                        rows.len(),
                        lines(&rows)
                    );
                    return Some(refused(Cause::Clip, text, rows, CUT.0 as f64));
                }
            }
        }
        None
    }

    /// Checks whether there are enough equations.
    fn few(&self, still: usize) -> Option<Finding> {
        let poses = different_poses(self.samples, &self.robot.kinds());
        let whole = poses.iter().any(|s| s.observation.has_orientation());
        let equations: usize = poses.iter().map(|s| s.observation.equations()).sum();
        let moving = self.robot.joints.len() - still;
        let unknowns = 4 * moving + if whole { 6 } else { 3 };
        let ratio = equations as f64 / unknowns as f64;
        let tier = match ratio {
            r if r < FEW.0 => Tier::Refused,
            r if r < FEW.1 => Tier::Warning,
            _ => return None,
        };
        let text = format!(
            "{} poses give {equations} equations for {unknowns} unknowns: measure {} poses at least",
            poses.len(),
            (FEW.1 * unknowns as f64 / (equations as f64 / poses.len() as f64)).ceil()
        );
        let threshold = if tier == Tier::Refused { FEW.0 } else { FEW.1 };
        Some(Finding {
            cause: Cause::Few,
            tier,
            text,
            rows: Vec::new(),
            value: ratio,
            threshold,
        })
    }

    /// Finds payloads that no arm of this reach carries.
    fn payload(&self, reach: f64) -> Option<Finding> {
        let heaviest = HEAVIEST * reach.powi(3);
        let rows: Vec<usize> = (0..self.samples.len())
            .filter(|k| self.samples[*k].payload_kg.is_some_and(|m| m > heaviest))
            .map(|k| self.line(k))
            .collect();
        let most = self
            .samples
            .iter()
            .filter_map(|s| s.payload_kg)
            .fold(0.0, f64::max);
        (!rows.is_empty()).then(|| Finding {
            cause: Cause::Payload,
            tier: Tier::Warning,
            text: format!(
                "payload_kg is {} in {}: an arm of {} m carries {heaviest:.0} kg at most; is it in grams?",
                three_digits(most),
                lines(&rows),
                three_digits(reach)
            ),
            rows,
            value: most,
            threshold: heaviest,
        })
    }
}

/// Returns whether a number, in mm or in m, is one that programs write for a missing value.
fn stands_for_missing(metres: f64) -> bool {
    [1.0, 1e3].iter().any(|unit| {
        let digits = (metres * unit).abs();
        let nines = [99.0, 999.0, 9999.0, 99999.0, 999999.0].contains(&digits.round());
        let power = digits >= 1e3 && libm::log10(digits).fract() == 0.0;
        (digits.round() - digits).abs() < 1e-9 * digits && (nines || power)
            || (9.9e5..1.1e6).contains(&digits)
    })
}

fn refused(cause: Cause, text: String, rows: Vec<usize>, threshold: f64) -> Finding {
    Finding {
        cause,
        tier: Tier::Refused,
        text,
        value: rows.len() as f64,
        rows,
        threshold,
    }
}

/// Returns the step of the digits of values: the largest power of ten that divides all of them; 0 if they have more digits
/// than matter, or are all equal.
pub fn step(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let first = values.clone().next();
    if values.clone().all(|v| Some(v) == first) {
        return 0.0;
    }
    for exponent in (-6..=3).rev() {
        let step = 10.0_f64.powi(exponent);
        let divides = |v: f64| {
            let count = v / step;
            (count - count.round()).abs() < 1e-6
        };
        if values.clone().all(divides) {
            return step;
        }
    }
    0.0
}

/// Returns the position coordinates of all rows, in mm.
pub fn positions_mm(set: &MeasurementSet) -> impl Iterator<Item = f64> + Clone + '_ {
    set.measurements.iter().flat_map(|m| {
        let p: Vector3<f64> = m.position * 1e3;
        [p[0], p[1], p[2]]
    })
}
