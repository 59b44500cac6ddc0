//! Examines only the numbers, before anything is solved: too few rows, repeated rows, placeholders for missing values,
//! cut-off values.

use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::input_error::counted;
use crate::measurement::MeasurementSet;
use crate::measurement::elapsed::LEAST_SORTED;
use crate::measurement::folds::different_poses;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::{extremes, median};
use crate::robot::{Robot, still_span};
use crate::trust::copies::Copies;
use crate::trust::finding::{Finding, Tier};
use crate::trust::wording::{lines, three_digits};

/// Equations per unknown below which nothing is fitted, and below which the user is warned.
const FEW: (f64, f64) = (1.25, 2.9);
/// Motion of the flange between two rows, in m and rad, beyond which they cannot have the same pose.
const MOVED: (f64, f64) = (2e-3, 5e-3);
/// Number of rows, and share of all rows, at the extreme value of a column from which it counts as cut off.
const CUT: (usize, f64) = (3, 0.02);
/// Largest number of payloads with one pose each; more are weighed masses that differ from row to row.
const MOST_LONE: usize = 8;
/// Number of poses of another payload from which one pose is too little beside it.
const MANY: usize = 10;
/// Share of distinct values among the others in a column above which a value that several rows share stands out.
const DIFFERENT: f64 = 0.75;
/// Distance from the median beyond which a value may stand for a missing one, in units of the median distance.
const FAR: f64 = 12.0;

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
    let copies = Copies::new(set, samples, None);
    out.extend(scene.stuck());
    out.extend(scene.placeholders());
    let still = scene.still();
    out.extend(scene.cut_off(copies.rows(), &still));
    out.extend(scene.sorted());
    out.extend(scene.few(still.len()));
    out.extend(scene.payload(reach));
    out.extend(scene.lone_payloads());
    out.extend(copies.finding());
    out.extend(standing(robot, &still));
    out
}

/// Warns of the joints that do not move; `still` has their ranges in rad or m.
fn standing(robot: &Robot, still: &[(usize, f64)]) -> Option<Finding> {
    let kind = |j: &usize| robot.joints[*j].kind;
    let widest = |wanted: JointKind| {
        let of = still.iter().filter(|(j, _)| kind(j) == wanted);
        of.map(|(_, range)| *range).reduce(f64::max)
    };
    let turned = widest(JointKind::Revolute);
    let moved = widest(JointKind::Prismatic);
    let within: Vec<String> = [
        turned.map(|range| format!("{}°", three_digits(range.to_degrees()))),
        moved.map(|range| format!("{} mm", three_digits(1e3 * range))),
    ]
    .into_iter()
    .flatten()
    .collect();
    let names: Vec<String> = still.iter().map(|(j, _)| (j + 1).to_string()).collect();
    let (noun, verb) = match names.len() {
        0 => return None,
        1 => ("joint", "does"),
        _ => ("joints", "do"),
    };
    let text = format!(
        "{noun} {} {verb} not move (within {}): errors of these joints stay unknown",
        names.join(", "),
        within.join(" and ")
    );
    let (value, threshold) = match turned {
        Some(range) => (range, still_span(JointKind::Revolute)),
        None => (moved?, still_span(JointKind::Prismatic)),
    };
    let (cause, tier) = (Cause::Still, Tier::Warning);
    Some(Finding::new(cause, tier, text, value, threshold))
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
        let text = format!(
            "the rows are sorted by {name}, so that steps and drifts of the instrument cannot be seen: give the time of \
             each row in a column time_s"
        );
        let (rows, least) = (self.samples.len() as f64, LEAST_SORTED as f64);
        Some(Finding::new(Cause::Time, Tier::Note, text, rows, least))
    }

    /// Returns the joints that do not move, except passive ones, with their ranges in rad or m.
    fn still(&self) -> Vec<(usize, f64)> {
        let range = |j: usize| {
            let (low, high) = extremes(self.samples.iter().map(|s| s.joints[j]));
            high - low
        };
        let joints = self.robot.joints.iter().enumerate();
        let still = joints.filter_map(|(j, joint)| {
            let least = still_span(joint.kind);
            Some((j, range(j))).filter(|(_, range)| *range < least && !self.robot.is_passive(j))
        });
        still.collect()
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

    /// Returns whether the joints of two rows bring the flange to different poses.
    fn is_elsewhere(&self, i: usize, k: usize) -> bool {
        let between = self.flanges[i].inverse() * self.flanges[k];
        between.translation.norm() > MOVED.0 || between.log().angular.norm() > MOVED.1
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
            // An arm that stands still is at the same place each time it is measured.
            let is_shared = |k: usize| {
                let mut others = far.iter().filter(|i| values[**i] == values[k]);
                others.any(|i| self.is_elsewhere(*i, k))
            };
            let is_missing = |k: &usize| is_shared(*k) || stands_for_missing(values[*k]);
            let missing: Vec<usize> = far.iter().copied().filter(is_missing).collect();
            if let (Some(first), true) = (missing.first(), named.is_empty()) {
                named = format!("{name} is {} mm", three_digits(1e3 * values[*first]));
                if is_shared(*first) {
                    named += ", though the robot had moved";
                }
            }
            rows.extend(missing);
        }
        if rows.is_empty() {
            rows = self.held_orientations();
            named = "the orientation is that of other rows to the last digit, though the robot had moved".to_owned();
        }
        rows.sort_unstable();
        rows.dedup();
        (!rows.is_empty()).then(|| {
            let rows: Vec<usize> = rows.iter().map(|k| self.line(*k)).collect();
            let text = format!(
                "in {} ({}) {named}: a placeholder for a missing value",
                counted(rows.len(), "row"),
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
                        "{name} ends at {} in {} rows ({}) while all other values differ: the values look clipped",
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
            "{} poses give {equations} equations for {unknowns} unknowns: measure at least {} poses",
            poses.len(),
            (FEW.1 * unknowns as f64 / (equations as f64 / poses.len() as f64)).ceil()
        );
        let threshold = if tier == Tier::Refused { FEW.0 } else { FEW.1 };
        Some(Finding::new(Cause::Few, tier, text, ratio, threshold))
    }

    /// Finds payloads that were measured at one pose only, beside others with more: nothing checks what is stated of them.
    fn lone_payloads(&self) -> Option<Finding> {
        let poses = different_poses(self.samples, &self.robot.kinds());
        let count = |m: &f64| poses.iter().filter(|s| s.payload_kg == Some(*m)).count();
        let payloads: Vec<f64> = poses.iter().filter_map(|s| s.payload_kg).collect();
        let mut lone: Vec<f64> = payloads.iter().copied().filter(|m| count(m) == 1).collect();
        lone.sort_by(f64::total_cmp);
        let is_beside_many = payloads.iter().any(|m| count(m) >= MANY);
        if lone.is_empty() || lone.len() > MOST_LONE || !is_beside_many {
            return None;
        }
        let rows = (0..self.samples.len())
            .filter(|k| (self.samples[*k].payload_kg).is_some_and(|m| lone.contains(&m)))
            .map(|k| self.line(k));
        let rows: Vec<usize> = rows.collect();
        let names: Vec<String> = lone.iter().map(f64::to_string).collect();
        let each = if lone.len() == 1 { "" } else { " each" };
        let text = format!(
            "{} kg of payload have one pose{each} ({}): the model's error there may be larger than it states; measure two \
             poses or more with every payload",
            names.join(", "),
            lines(&rows)
        );
        Some(Finding::new(Cause::Payload, Tier::Warning, text, 1.0, 2.0).of_rows(rows))
    }

    /// Finds payloads that no arm of this reach carries.
    fn payload(&self, reach: f64) -> Option<Finding> {
        let heaviest = self.robot.most_payload_kg();
        let rows: Vec<usize> = (0..self.samples.len())
            .filter(|k| self.samples[*k].payload_kg.is_some_and(|m| m > heaviest))
            .map(|k| self.line(k))
            .collect();
        let most = self
            .samples
            .iter()
            .filter_map(|s| s.payload_kg)
            .fold(0.0, f64::max);
        (!rows.is_empty()).then(|| {
            let text = format!(
                "payload_kg is {} in {}: an arm of {} m carries {heaviest:.0} kg at most; is it in grams?",
                three_digits(most),
                lines(&rows),
                three_digits(reach)
            );
            Finding::new(Cause::Payload, Tier::Warning, text, most, heaviest).of_rows(rows)
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
    Finding::new(cause, Tier::Refused, text, rows.len() as f64, threshold).of_rows(rows)
}

/// Share of the rows in question, and of the others, that must have and may have the value of a frozen joint.
const FROZEN: (f64, f64) = (0.8, 0.1);

/// Describes a joint whose reading seems frozen: it has one value in most of the rows in question and in few others.
pub fn frozen(robot: &Robot, rows: &[&InstrumentSample], others: &[&InstrumentSample]) -> String {
    let with = |of: &[&InstrumentSample], joint: usize, value: f64| {
        of.iter().filter(|s| s.joints[joint] == value).count()
    };
    let is_of = |count: usize, of: usize, share: f64| count as f64 >= share * of as f64;
    let found = robot.joints.iter().enumerate().find_map(|(j, joint)| {
        let mut values: Vec<f64> = rows.iter().map(|s| s.joints[j]).collect();
        values.sort_by(f64::total_cmp);
        // More than half of the rows have it, if any value is frequent enough.
        let value = *values.get(values.len() / 2)?;
        let count = with(rows, j, value);
        let is_frozen = !robot.is_passive(j)
            && is_of(count, rows.len(), FROZEN.0)
            && (others.is_empty() || !is_of(with(others, j, value), others.len(), FROZEN.1));
        is_frozen.then_some((j, joint.kind, value, count))
    });
    let Some((j, kind, value, count)) = found else {
        return String::new();
    };
    let value = match kind {
        JointKind::Revolute => format!("{}°", three_digits(value.to_degrees())),
        JointKind::Prismatic => format!("{} mm", three_digits(1e3 * value)),
    };
    let which = match (count == rows.len(), others.is_empty()) {
        (true, true) => "all rows".to_owned(),
        (true, false) => "all of these rows".to_owned(),
        _ => format!("{count} of these rows"),
    };
    format!(
        "; joint {} is at exactly {value} in {which}: was its reading frozen?",
        j + 1
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::LoadOptions;

    /// A slide that stands still does so within millimetres.
    #[test]
    fn a_joint_stands_still_in_its_own_unit() {
        let mut robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
        robot.joints[2].kind = JointKind::Prismatic;
        let text = |still: &[(usize, f64)]| standing(&robot, still).map(|found| found.text);
        let slide = text(&[(2, 2.5e-4)]).unwrap();
        assert!(
            slide.starts_with("joint 3 does not move (within 0.25 mm):"),
            "{slide}"
        );
        let turn = text(&[(0, 0.5_f64.to_radians())]).unwrap();
        assert!(
            turn.starts_with("joint 1 does not move (within 0.50°):"),
            "{turn}"
        );
        let both = text(&[(0, 0.5_f64.to_radians()), (2, 2.5e-4)]).unwrap();
        assert!(
            both.starts_with("joints 1, 3 do not move (within 0.50° and 0.25 mm):"),
            "{both}"
        );
        assert_eq!(text(&[]), None);
    }
}
