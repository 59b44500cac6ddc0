//! Checks that find mistakes in touches before any fit: too few touches, touches that are all alike, or touches of something
//! other than stated.
//!
//! The nominal arm is accurate enough to reveal two sockets under one name, a distance in inches, or touches that are all
//! from one side. Its tip is fitted to the touches first, without any prior, because they are the best source for it.

use std::cmp::Ordering;
use std::collections::HashSet;

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::column_names::FEATURE;
use crate::measurement::table::quoted;
use crate::measurement::touch::features::on_a_line;
use crate::measurement::touch::set::{FeatureKind, KnownDistance, Reading, TouchRow, TouchSet};
use crate::numeric::rotation::centroid;

/// Smallest number of touches of a point: with fewer, its three coordinates leave no information about the arm.
const LEAST_OF_POINT: usize = 3;
/// Smallest number of readings of a plane, or of a sphere or an anchor with an unknown position: fewer leave nothing to
/// compare.
const LEAST_OF_SURFACE: usize = 4;
/// Smallest number of corners of a board that must have been seen.
const LEAST_CORNERS: usize = 4;
/// Difference of orientation in rad below which the tip cannot be distinguished from the arm.
const LEAST_TURN: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Distance in m above which two groups of touches count as two sockets …
const TWO_SOCKETS: f64 = 20e-3;
/// … if it is also this many times the spread of the touches within the groups.
const TWO_SOCKETS_SPREADS: f64 = 4.0;
/// Number of standard deviations by which touches contradict a stated length.
const CONTRADICTION: f64 = 5.0;
/// Standard deviation in m of a distance between two points according to the nominal arm; the spread of a few touches does
/// not show it.
const NOMINAL: f64 = 2e-3;
/// Shortest reading of a wire or ballbar that calibrates an arm, in m: smaller readings are metres in a column of
/// millimetres.
const SHORTEST_READING: f64 = 10e-3;
/// Range of the distances from an anchor to the nominal tip, in m, beyond which equal readings in all rows are refused.
const STUCK_OVER: f64 = 0.05;
/// Ratio between a reading of an anchor and the nominal arm's value beyond which, or below the inverse of which, the reading
/// is in another unit.
const OTHER_UNIT: f64 = 3.0;

impl TouchSet {
    /// Refuses touches that contradict their description.
    pub(super) fn check_touches(&self, chain: &Poe<f64>) -> Result<(), InputError> {
        let flanges: Vec<Pose<f64>> = self
            .rows
            .iter()
            .map(|row| chain.forward(&row.serial_joints))
            .collect();
        for (index, feature) in self.features.iter().enumerate() {
            let rows = self.rows_of(index);
            self.check_count(index, &rows)?;
            match &feature.kind {
                FeatureKind::Point { .. } => self.check_turns(index, &rows, &flanges)?,
                FeatureKind::Board(board) => {
                    let seen: HashSet<usize> = rows
                        .iter()
                        .filter_map(|i| match self.rows[*i].reading {
                            Reading::Board { corner, .. } => Some(corner),
                            _ => None,
                        })
                        .collect();
                    let corners: Vec<_> = seen.iter().map(|n| board.corners[*n]).collect();
                    if seen.len() < LEAST_CORNERS || on_a_line(&corners) {
                        let found = match seen.len() {
                            count if count < LEAST_CORNERS => format!("{count} corners seen"),
                            _ => "corners seen that are all on one line".to_owned(),
                        };
                        let expected = "four corners or more that are not on one line";
                        return Err(self.about(index, &rows, found, expected));
                    }
                }
                FeatureKind::Anchor { .. } => self.check_readings(index, &rows, &flanges)?,
                _ => {}
            }
        }
        let tips = self.fitted_tips(&flanges);
        let centres = self.check_sockets(&flanges, &tips)?;
        self.check_distances(&centres)
    }

    /// Creates an error about the rows of a feature, located at the first of them.
    fn about(
        &self,
        feature: usize,
        rows: &[usize],
        found: impl AsRef<str>,
        expected: &str,
    ) -> InputError {
        let feature = &self.features[feature];
        let name = quoted(&feature.name);
        let found = format!("{} of {name}", found.as_ref());
        match rows.first() {
            Some(first) => InputError::new(&self.path, found, expected)
                .at_line(self.rows[*first].line)
                .at_column(self.feature_column, FEATURE),
            None => InputError::new(&self.features_path, found, expected)
                .at_line(feature.line)
                .at_column(1, "feature"),
        }
    }

    /// Returns the indices of the rows of a feature.
    fn rows_of(&self, feature: usize) -> Vec<usize> {
        let is_own = |i: &usize| self.rows[*i].reading.feature() == Some(feature);
        (0..self.rows.len()).filter(is_own).collect()
    }

    /// Returns the number of different joint states among `rows`; a row that repeats another counts once.
    fn states_of(&self, rows: &[usize]) -> usize {
        let states: HashSet<Vec<u64>> = rows.iter().map(|i| key(&self.rows[*i])).collect();
        states.len()
    }

    /// Returns the number of rows at other joints that a feature lacks to be fitted.
    pub fn lacking(&self, feature: usize) -> usize {
        let states = self.states_of(&self.rows_of(feature));
        least_states(&self.features[feature].kind).saturating_sub(states)
    }

    /// Checks that there are as many different joint states as the kind needs.
    fn check_count(&self, feature: usize, rows: &[usize]) -> Result<(), InputError> {
        let needed = least_states(&self.features[feature].kind);
        let states = self.states_of(rows);
        if states >= needed {
            return Ok(());
        }
        let kind = self.features[feature].kind.name();
        let expected = format!("at least {needed} of a {kind}, each at other joints");
        let found = match (rows.len(), states) {
            (0, _) => "no rows".to_owned(),
            (1, _) => "1 row".to_owned(),
            (count, 1) => format!("{count} rows at one joint state"),
            (count, states) if count > states => {
                format!("{count} rows at {states} different joint states")
            }
            (count, _) => format!("{count} rows"),
        };
        let error = self.about(feature, rows, found, &expected);
        Err(match rows.len() {
            0 => error.with_help(format!(
                "{} has no row with this feature: measure it, or remove the table",
                self.path.display()
            )),
            _ => error,
        })
    }

    /// Checks that the orientations differ: if they are all alike, tip and arm cannot be distinguished.
    fn check_turns(
        &self,
        feature: usize,
        rows: &[usize],
        flanges: &[Pose<f64>],
    ) -> Result<(), InputError> {
        let mut widest = 0.0_f64;
        for (n, a) in rows.iter().enumerate() {
            for b in &rows[n + 1..] {
                widest = widest.max(angle_between(&flanges[*a], &flanges[*b]));
                if widest >= LEAST_TURN {
                    return Ok(());
                }
            }
        }
        let found = format!(
            "touches within {:.1} deg of one orientation",
            widest.to_degrees()
        );
        let expected = "orientations of a point that differ by 10 deg or more";
        let error = self.about(feature, rows, found, expected);
        Err(error.with_help(
            "one orientation cannot distinguish errors of tip and arm: touch it in other orientations, too",
        ))
    }

    /// Checks the readings of an anchor against the nominal tip.
    fn check_readings(
        &self,
        feature: usize,
        rows: &[usize],
        flanges: &[Pose<f64>],
    ) -> Result<(), InputError> {
        let reading = |i: &usize| match self.rows[*i].reading {
            Reading::Anchor { value, .. } => value,
            _ => 0.0,
        };
        let longest = rows.iter().map(reading).fold(0.0, f64::max);
        let unit = "does the unit match the column's name, value_mm or value_m?";
        if longest < SHORTEST_READING {
            let found = format!("no reading above {} mm", round(longest * 1e3));
            let expected = "distances from the anchor to the tip";
            return Err(self.about(feature, rows, found, expected).with_help(unit));
        }
        let FeatureKind::Anchor {
            position: Some(at), ..
        } = self.features[feature].kind
        else {
            return Ok(());
        };
        let nominal = |i: &usize| {
            let tip = &self.tips[self.rows[*i].tip];
            (flanges[*i].transform_point(&tip.position) - at).norm()
        };
        let (near, far) = (rows.iter().map(nominal))
            .fold((f64::MAX, 0.0), |(near, far), nominal| {
                (f64::min(near, nominal), f64::max(far, nominal))
            });
        if rows.iter().all(|i| reading(i) == longest) && far - near > STUCK_OVER {
            let found = format!("{} mm in every row", round(longest * 1e3));
            let expected = format!(
                "readings that follow the tip, which is {} to {} mm from position_mm",
                round(near * 1e3),
                round(far * 1e3)
            );
            return Err(self.about(feature, rows, found, &expected));
        }
        let mut ratios: Vec<f64> = rows.iter().map(|i| nominal(i) / reading(i)).collect();
        ratios.sort_by(f64::total_cmp);
        let middle = ratios[ratios.len() / 2];
        // The comparison also refuses a ratio that is not a number.
        if (1.0 / OTHER_UNIT..=OTHER_UNIT).contains(&middle) {
            return Ok(());
        }
        let found = format!(
            "readings that are {} times the distances of the nominal arm",
            round(1.0 / middle)
        );
        let expected = "distances from position_mm to the tip";
        Err(self.about(feature, rows, found, expected).with_help(unit))
    }

    /// Groups the touches of points by point and tip: (feature, tip, rows).
    fn touches_of_points(&self) -> Vec<(usize, usize, Vec<usize>)> {
        let mut out: Vec<(usize, usize, Vec<usize>)> = Vec::new();
        for (i, row) in self.rows.iter().enumerate() {
            let Reading::Point { feature } = row.reading else {
                continue;
            };
            match out
                .iter_mut()
                .find(|(f, t, _)| (*f, *t) == (feature, row.tip))
            {
                Some((_, _, rows)) => rows.push(i),
                None => out.push((feature, row.tip, vec![i])),
            }
        }
        out
    }

    /// Estimates the position of each tip from touches of points alone, in m in the flange frame; the nominal position if
    /// they do not determine it.
    ///
    /// The tip t and the point c solve R t + p = c for all touches. Subtracting the mean over the touches of each point on
    /// both sides eliminates c.
    fn fitted_tips(&self, flanges: &[Pose<f64>]) -> Vec<Vector3<f64>> {
        let mut normal = vec![(Matrix3::<f64>::zeros(), Vector3::<f64>::zeros()); self.tips.len()];
        for (_, tip, rows) in self.touches_of_points() {
            let count = rows.len() as f64;
            let rotation = rows.iter().fold(Matrix3::zeros(), |sum: Matrix3<f64>, i| {
                sum + flanges[*i].rotation
            }) / count;
            let position = rows.iter().fold(Vector3::zeros(), |sum: Vector3<f64>, i| {
                sum + flanges[*i].translation
            }) / count;
            for i in rows {
                let turned = flanges[i].rotation - rotation;
                let (matrix, right) = &mut normal[tip];
                *matrix += turned.transpose() * turned;
                *right -= turned.transpose() * (flanges[i].translation - position);
            }
        }
        let fitted = |((matrix, right), tip): ((Matrix3<f64>, Vector3<f64>), &_)| {
            let tip: &crate::measurement::touch::set::Tip = tip;
            // Rows that rotate about a single axis do not determine the tip along it; a small weight on the nominal model
            // does.
            let ridge = Matrix3::identity() * 1e-4;
            let matrix = matrix + ridge;
            let right = right + ridge * tip.position;
            let inverse = matrix.try_inverse();
            inverse.map_or(tip.position, |inverse| inverse * right)
        };
        normal.into_iter().zip(&self.tips).map(fitted).collect()
    }

    /// Refuses two sockets under one name. Returns the centre of each touched point and the spread of its touches per
    /// component.
    fn check_sockets(
        &self,
        flanges: &[Pose<f64>],
        tips: &[Vector3<f64>],
    ) -> Result<Vec<Option<Centre>>, InputError> {
        let mut centres: Vec<Option<Centre>> = vec![None; self.features.len()];
        for (feature, tip, rows) in self.touches_of_points() {
            let touched: Vec<Vector3<f64>> = rows
                .iter()
                .map(|i| flanges[*i].transform_point(&tips[tip]))
                .collect();
            if let Some((apart, second)) = two_groups(&touched) {
                let row = rows[second];
                let found = format!(
                    "a touch {:.0} mm from others of {} by the same tip",
                    apart * 1e3,
                    quoted(&self.features[feature].name)
                );
                let expected = "one point under one name";
                return Err(InputError::new(&self.path, found, expected)
                    .at_line(self.rows[row].line)
                    .at_column(self.feature_column, FEATURE)
                    .with_help(
                        "if it is another point, give it a name and a [[feature]] of its own; if not, this row's joints \
                         are wrong, or the zero of a joint is off by a degree or more: master it first",
                    ));
            }
            let (mean, spread) = mean_and_spread(&touched);
            // The first tip is enough, because the others are at the same point.
            centres[feature].get_or_insert((mean, spread));
        }
        Ok(centres)
    }

    /// Refuses a known distance that the touches contradict, even by the nominal arm.
    fn check_distances(&self, centres: &[Option<Centre>]) -> Result<(), InputError> {
        let measured = self.distances.iter().map(|known| {
            let [a, b] = known.between.map(|feature| centres[feature]);
            let ((a, of_a), (b, of_b)) = (a?, b?);
            let sigma = (of_a * of_a + of_b * of_b + NOMINAL * NOMINAL).sqrt();
            Some(((a - b).norm(), sigma))
        });
        let measured: Vec<_> = measured.collect();
        self.contradiction(&measured).map_or(Ok(()), Err)
    }

    /// Returns the refusal of the known distance that touches contradict most, if by more than five standard deviations of
    /// both. `measured` has, for each known distance, the one by the touches and its standard deviation, in m.
    pub fn contradiction(&self, measured: &[Option<(f64, f64)>]) -> Option<InputError> {
        let each = self.distances.iter().zip(measured);
        let off = each.filter_map(|(known, measured)| {
            let (distance, sigma) = (*measured)?;
            let missed = (distance - known.distance).abs();
            let both = libm::sqrt(known.sigma * known.sigma + sigma * sigma);
            Some((missed / both, known, distance, sigma))
        });
        let (missed, known, distance, sigma) = off.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (missed > CONTRADICTION).then(|| {
            let [a, b] = known
                .between
                .map(|feature| quoted(&self.features[feature].name));
            let found = format!("{} mm between {a} and {b}", round(known.distance * 1e3));
            let expected = format!(
                "a length that the touches do not contradict: they give {:.1} mm",
                distance * 1e3
            );
            InputError::new(&self.features_path, found, expected)
                .at_line(known.line)
                .at_column(1, "distance")
                .with_help(remedy(known, distance, sigma))
        })
    }
}

/// Units in which a length may have been measured, and the number of millimetres in each.
const UNITS: [(&str, f64); 4] = [
    ("metres", 1e3),
    ("centimetres", 10.0),
    ("inches", 25.4),
    ("micrometres", 1e-3),
];

/// Returns what may be wrong with a known distance that the touches contradict: its unit, if one makes both agree.
fn remedy(known: &KnownDistance, distance: f64, sigma: f64) -> String {
    let agrees = |(_, factor): &&(&str, f64)| {
        let (said, own) = (factor * known.distance, factor * known.sigma);
        (distance - said).abs() <= CONTRADICTION * (own * own + sigma * sigma).sqrt()
    };
    let (found, said) = (distance * 1e3, known.distance * 1e3);
    match UNITS.iter().find(agrees) {
        Some((unit, _)) => format!(
            "the touches give {found:.1} mm, which agrees with {} {unit}: state the distance in millimetres",
            round(said)
        ),
        None => format!(
            "the touches give {found:.1} mm, the file {said:.1}, and no other unit makes them agree: check that the \
             distance is between these two features, and that this is the robot that was touched"
        ),
    }
}

/// Position of a point according to its touches and the nominal arm, in m, and the spread of the touches per component.
type Centre = (Vector3<f64>, f64);

/// Returns the smallest number of different joint states with which a feature of a kind says something about the arm.
fn least_states(kind: &FeatureKind) -> usize {
    match kind {
        FeatureKind::Point { .. } => LEAST_OF_POINT,
        FeatureKind::Plane { .. } | FeatureKind::Sphere { .. } => LEAST_OF_SURFACE,
        FeatureKind::Anchor { position: None, .. } => LEAST_OF_SURFACE,
        FeatureKind::Anchor { .. } | FeatureKind::Level { .. } | FeatureKind::Board(_) => 2,
    }
}

/// Returns a key that is equal for equal joint states: joints and payload. 0.0 and −0.0 are the same.
fn key(row: &TouchRow) -> Vec<u64> {
    let values = row.joints.iter().chain(&row.payload_kg);
    values.map(|value| (value + 0.0).to_bits()).collect()
}

/// Returns the rotation angle between two orientations, in rad.
fn angle_between(a: &Pose<f64>, b: &Pose<f64>) -> f64 {
    let (w, v) = (a.inverse() * *b).quaternion();
    2.0 * libm::atan2(v.norm(), w.abs())
}

/// Returns the mean, and the root mean square of one component about it.
fn mean_and_spread(points: &[Vector3<f64>]) -> (Vector3<f64>, f64) {
    let count = points.len() as f64;
    let mean = centroid(points);
    let square: f64 = points.iter().map(|p| (p - mean).norm_squared()).sum();
    (mean, (square / (3.0 * count)).sqrt())
}

/// Returns whether points form two groups far apart: their distance, and the index of the first point of the smaller
/// group; of groups of one size, of that which comes later.
fn two_groups(points: &[Vector3<f64>]) -> Option<(f64, usize)> {
    let (mean, _) = mean_and_spread(points);
    let farthest_from = |at: &Vector3<f64>| {
        points
            .iter()
            .copied()
            .max_by(|a, b| (a - at).norm().total_cmp(&(b - at).norm()))
    };
    let one = farthest_from(&mean)?;
    let mut centres = [one, farthest_from(&one)?];
    let mut nearer = Vec::new();
    for _ in 0..10 {
        nearer = points
            .iter()
            .map(|p| usize::from((p - centres[1]).norm() < (p - centres[0]).norm()))
            .collect::<Vec<_>>();
        for (group, centre) in centres.iter_mut().enumerate() {
            let own = || points.iter().zip(&nearer).filter(|(_, g)| **g == group);
            let count = own().count();
            if count > 0 {
                *centre = own().map(|(p, _)| p).sum::<Vector3<f64>>() / count as f64;
            }
        }
    }
    let within: f64 = points
        .iter()
        .zip(&nearer)
        .map(|(p, group)| (p - centres[*group]).norm_squared())
        .sum();
    let spread = (within / points.len() as f64).sqrt();
    let apart = (centres[0] - centres[1]).norm();
    let of_second = nearer.iter().sum::<usize>();
    let smaller = match (2 * of_second).cmp(&points.len()) {
        Ordering::Less => 1,
        Ordering::Greater => 0,
        Ordering::Equal => 1 - nearer[0],
    };
    let second = nearer.iter().position(|group| *group == smaller)?;
    (apart > TWO_SOCKETS && apart > TWO_SOCKETS_SPREADS * spread).then_some((apart, second))
}

/// Rounds to four decimals, for a message.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
