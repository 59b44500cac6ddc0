//! What can be seen to be wrong with touches before any fit: too few, all alike, or of something else than is said.
//!
//! The arm as drawn is good enough to tell two sockets under one name, a distance in inches and touches that are all from
//! one side. Its tip is fitted to the touches first, without any prior, for nobody knows it better than they do.

use std::collections::HashSet;

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::columns::FEATURE;
use crate::measurement::table::quoted;
use crate::measurement::touch::features::on_a_line;
use crate::measurement::touch::set::{FeatureKind, KnownDistance, Reading, TouchRow, TouchSet};

/// Touches of a point without which its three coordinates say nothing about the arm.
const LEAST_OF_POINT: usize = 3;
/// Readings of a plane, and of a sphere or an anchor that nobody measured, without which there is nothing to compare.
const LEAST_OF_SURFACE: usize = 4;
/// Corners that must have been seen of a board.
const LEAST_CORNERS: usize = 4;
/// Orientations that are nearer to each other than this do not tell the tip from the arm, rad.
const LEAST_TURN: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Two groups of touches farther apart than this are two sockets, m …
const TWO_SOCKETS: f64 = 20e-3;
/// … if that is so many times how far the touches of each are spread.
const TWO_SOCKETS_SPREADS: f64 = 4.0;
/// Standard deviations by which touches contradict a length.
const CONTRADICTION: f64 = 5.0;
/// Standard deviation of a distance between two points by an arm as drawn, m: few touches of each do not show it.
const DRAWN: f64 = 2e-3;
/// No wire or ballbar that calibrates an arm reads less, m: such readings are metres in a column of millimetres.
const SHORTEST_READING: f64 = 10e-3;
/// A reading of an anchor is of another unit if it is so many times what the drawn arm says, or less than its inverse.
const OTHER_UNIT: f64 = 3.0;

impl TouchSet {
    /// Refuses touches that cannot be what is said of them.
    pub(super) fn check_touches(&self, chain: &Poe<f64>) -> Result<(), InputError> {
        let flanges: Vec<Pose<f64>> = self
            .rows
            .iter()
            .map(|row| chain.forward(&row.serial_joints))
            .collect();
        for (index, feature) in self.features.iter().enumerate() {
            let rows: Vec<usize> = (0..self.rows.len())
                .filter(|i| self.rows[*i].reading.feature() == Some(index))
                .collect();
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

    /// The error about the rows of a feature, at the first of them.
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

    /// At least so many different joint states as the kind needs; a row that repeats another counts once.
    fn check_count(&self, feature: usize, rows: &[usize]) -> Result<(), InputError> {
        let needed = match self.features[feature].kind {
            FeatureKind::Point { .. } => LEAST_OF_POINT,
            FeatureKind::Plane { .. } | FeatureKind::Sphere { .. } => LEAST_OF_SURFACE,
            FeatureKind::Anchor { position: None, .. } => LEAST_OF_SURFACE,
            FeatureKind::Anchor { .. } | FeatureKind::Level { .. } | FeatureKind::Board(_) => 2,
        };
        let states: HashSet<Vec<u64>> = rows.iter().map(|i| key(&self.rows[*i])).collect();
        if states.len() >= needed {
            return Ok(());
        }
        let kind = self.features[feature].kind.name();
        let expected = format!("at least {needed} of a {kind}, each at other joints");
        let found = match (rows.len(), states.len()) {
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
                "{} has no row with this feature: measure it, or take the table out",
                self.path.display()
            )),
            _ => error,
        })
    }

    /// From orientations that are all alike, tip and arm cannot be distinguished.
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
            "from one orientation tip and arm cannot be distinguished: touch it from other sides, too",
        ))
    }

    /// Readings of an anchor against the tip as drawn.
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
        let unit = "is the unit the column's? Its name carries it: value_mm or value_m";
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
        let mut ratios: Vec<f64> = rows
            .iter()
            .map(|i| {
                let tip = &self.tips[self.rows[*i].tip];
                (flanges[*i].transform_point(&tip.position) - at).norm() / reading(i)
            })
            .collect();
        ratios.sort_by(f64::total_cmp);
        let middle = ratios[ratios.len() / 2];
        // Written so that a ratio that is not a number is refused, too.
        if (1.0 / OTHER_UNIT..=OTHER_UNIT).contains(&middle) {
            return Ok(());
        }
        let found = format!(
            "readings that are {} times what the drawn arm says",
            round(1.0 / middle)
        );
        let expected = "distances from position_mm to the tip";
        Err(self.about(feature, rows, found, expected).with_help(unit))
    }

    /// The touches of each point by one tip, rows of each.
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

    /// Where each tip is by its touches of points alone, m in the flange frame; as drawn where they do not say.
    ///
    /// The tip t and the point c solve R t + p = c for all touches; with the mean over the touches of each point taken off
    /// on both sides, c is gone.
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
            // Rows about a single axis do not say where on it the tip is: a little trust in the drawing does.
            let ridge = Matrix3::identity() * 1e-4;
            let matrix = matrix + ridge;
            let right = right + ridge * tip.position;
            let inverse = matrix.try_inverse();
            inverse.map_or(tip.position, |inverse| inverse * right)
        };
        normal.into_iter().zip(&self.tips).map(fitted).collect()
    }

    /// Refuses two sockets under one name; the others come back, with how far their touches are spread per component.
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
                    .with_help("give the other point a name and a [[feature]] of its own"));
            }
            let (mean, spread) = mean_and_spread(&touched);
            // The first tip is enough: others are at the same point.
            centres[feature].get_or_insert((mean, spread));
        }
        Ok(centres)
    }

    /// Refuses a distance that the touches contradict, even by the arm as drawn.
    fn check_distances(&self, centres: &[Option<Centre>]) -> Result<(), InputError> {
        for (index, known) in self.distances.iter().enumerate() {
            let [a, b] = known.between.map(|feature| centres[feature]);
            let (Some((a, of_a)), Some((b, of_b))) = (a, b) else {
                continue;
            };
            let sigma = (of_a * of_a + of_b * of_b + DRAWN * DRAWN).sqrt();
            if let Some(error) = self.contradiction(index, (a - b).norm(), sigma) {
                return Err(error);
            }
        }
        Ok(())
    }

    /// The refusal of a known distance, by its index, that touches contradict by more than five standard deviations of both:
    /// they say `distance` with standard deviation `sigma`, m.
    pub fn contradiction(&self, index: usize, distance: f64, sigma: f64) -> Option<InputError> {
        let known = &self.distances[index];
        let both = (known.sigma * known.sigma + sigma * sigma).sqrt();
        ((distance - known.distance).abs() > CONTRADICTION * both).then(|| {
            let [a, b] = known
                .between
                .map(|feature| quoted(&self.features[feature].name));
            let found = format!("{} mm between {a} and {b}", round(known.distance * 1e3));
            let expected = format!(
                "a length that the touches do not contradict: they say {:.1} mm",
                distance * 1e3
            );
            InputError::new(&self.features_path, found, expected)
                .at_line(known.line)
                .at_column(1, "distance")
                .with_help(remedy(known, distance, sigma))
        })
    }
}

/// Units that a length may have been measured in, and how many millimetres each is.
const UNITS: [(&str, f64); 4] = [
    ("metres", 1e3),
    ("centimetres", 10.0),
    ("inches", 25.4),
    ("micrometres", 1e-3),
];

/// What may be wrong with a known distance where the touches say another one: its unit, if one makes both agree.
fn remedy(known: &KnownDistance, distance: f64, sigma: f64) -> String {
    let agrees = |(_, factor): &&(&str, f64)| {
        let (said, own) = (factor * known.distance, factor * known.sigma);
        (distance - said).abs() <= CONTRADICTION * (own * own + sigma * sigma).sqrt()
    };
    let (found, said) = (distance * 1e3, known.distance * 1e3);
    match UNITS.iter().find(agrees) {
        Some((unit, _)) => format!(
            "touches say {found:.1} mm, and {} {unit} agree with that: give the distance in millimetres",
            round(said)
        ),
        None => format!(
            "touches say {found:.1} mm, the file {said:.1}, and no other unit makes them agree: is it the distance of these two, \
             and is the robot the one that was touched?"
        ),
    }
}

/// Where a point is by its touches and the arm as drawn, m, and how far they are spread per component.
type Centre = (Vector3<f64>, f64);

/// What makes a joint state another one: its joints and its payload. 0.0 and −0.0 are the same.
fn key(row: &TouchRow) -> Vec<u64> {
    let values = row.joints.iter().chain(&row.payload_kg);
    values.map(|value| (value + 0.0).to_bits()).collect()
}

/// By how much one orientation is turned against another, rad.
fn angle_between(a: &Pose<f64>, b: &Pose<f64>) -> f64 {
    let (w, v) = (a.inverse() * *b).quaternion();
    2.0 * libm::atan2(v.norm(), w.abs())
}

/// Mean, and root mean square of one component about it.
fn mean_and_spread(points: &[Vector3<f64>]) -> (Vector3<f64>, f64) {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    let square: f64 = points.iter().map(|p| (p - mean).norm_squared()).sum();
    (mean, (square / (3.0 * count)).sqrt())
}

/// Whether points are two groups far apart: how far, and the first point that is not of the first point's group.
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
    let second = nearer.iter().position(|group| *group != nearer[0])?;
    (apart > TWO_SOCKETS && apart > TWO_SOCKETS_SPREADS * spread).then_some((apart, second))
}

/// Four decimals at most, for a message.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
