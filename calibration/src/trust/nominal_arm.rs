//! Examines the data with the nominal arm, with base and tool fitted: is this the robot, and if not, which mistake explains
//! the file?

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::identification::alignment::{Alignment, Row, align, align_with_outliers, rough};
use crate::measurement::observation::Observation;
use crate::numeric::statistics::evenly_spaced;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::joint_zero::{JointZero, joint_zero};
use crate::trust::nominal_fit::{AS_GOOD, BETTER, Fit, MOST, REFUSED_ROTATION, spread};
use crate::trust::numbers::frozen;
use crate::trust::readings::{Data, Reading};
use crate::trust::tried_readings::readings;
use crate::trust::unsettled;
use crate::trust::wording::{ONE_SET_UP, fits_equally, length, lengths, lines};

/// Ratio of the median position residual to the spread above which other readings are tried.
const SUSPICIOUS_SPREAD: f64 = 0.012;
/// Factor by which one joint zero must lower the residual before the geometry is tried with it.
const HALF: f64 = 0.5;
/// Factor of the best residual within which readings count as equally good.
const EQUAL: f64 = 1.05;
/// Number of rows by which readings are ranked.
const RANKED: usize = 90;
/// Number of readings that are refined.
const REFINED: usize = 8;
/// Smallest number of rows to which a base and a tool are fitted.
const LEAST_ROWS: usize = 6;
/// Number of readings of the observations that are paired with readings of the joints.
const MOST_SEEN: usize = 30;
/// Largest number of pairs of readings that are tried.
const MOST_PAIRS: usize = 3000;
/// Smallest share of rows that must agree on one base and tool in a file with two populations.
const AGREEING: f64 = 0.25;
/// Share of agreeing rows above which the others are outliers.
const NEARLY_ALL: f64 = 0.95;
/// Distance within which rows agree, relative to the reach.
const TIGHT: f64 = 0.0035;
/// Distance within which rows of an arm far from its nominal model agree, relative to the reach.
const LOOSE: f64 = 0.012;
/// Largest median residual of a geometry of its own, relative to the reach.
const EXPLAINED_REACH: f64 = 0.0035;
/// Residuals below which the poses are those of the nominal model, so that the controller computed them, in m and rad.
const COMPUTED: (f64, f64) = (20e-6, 0.1e-3);

/// Result of the examination with the nominal arm.
pub struct NominalArm {
    /// Base and tools for the file as given.
    pub alignment: Alignment,
    /// Findings; empty if this is the robot.
    pub findings: Vec<Finding>,
    /// The fit of base and tools.
    given: Fit,
}

impl NominalArm {
    /// Returns one joint zero that explains at least half of what the nominal arm leaves, with the finding that says so.
    pub fn zero(&self, data: &Data<'_>) -> Option<(JointZero, Finding)> {
        let zero = joint_zero(data, &self.given, data.robot.reach())?;
        let is_better = zero.fit.relative < HALF * self.given.relative;
        let has_orientation = data.samples.iter().any(|s| s.observation.has_orientation());
        let finding = zero_off(&zero, &self.given, has_orientation);
        is_better.then_some((zero, finding))
    }
}

/// Examines the data with the nominal arm.
pub fn examine(data: &Data<'_>, gravity: Vector3<f64>) -> NominalArm {
    let all: Vec<usize> = (0..data.samples.len()).collect();
    let rows = Reading::as_given().rows(data, &all);
    let reach = data.robot.reach();
    let mut given = Fit::of(&rows, reach);
    if given.alignment.position > SUSPICIOUS_SPREAD * spread(&rows) {
        let better = align_with_outliers(&rows, given.alignment);
        given = Fit::new(better, &rows, reach);
    }
    let scene = Scene {
        data,
        gravity,
        reach,
        has_orientation: rows.iter().any(|r| r.seen.has_orientation()),
        rows,
    };
    NominalArm {
        findings: scene.examine(&given).into_iter().collect(),
        alignment: given.alignment.clone(),
        given,
    }
}

/// The data and what every examination step needs.
struct Scene<'a> {
    data: &'a Data<'a>,
    rows: Vec<Row>,
    gravity: Vector3<f64>,
    reach: f64,
    has_orientation: bool,
}

impl Scene<'_> {
    fn examine(&self, given: &Fit) -> Option<Finding> {
        let a = &given.alignment;
        if self.distinct() < LEAST_ROWS {
            return None;
        }
        if given.badness <= 1.0 && given.share >= MOST {
            let is_computed = |a: &Alignment| a.position < COMPUTED.0 && a.rotation < COMPUTED.1;
            // A fit follows a repeated pose, even if an instrument measured it.
            if is_computed(a) && is_computed(&align(&self.once_each())) {
                let text = format!(
                    "the poses agree with the nominal robot to {}: the controller computed them, and no instrument \
                     measured them",
                    given.lengths(self.has_orientation)
                );
                return Some(refused(
                    Cause::Readout,
                    text,
                    1e6 * a.position,
                    1e6 * COMPUTED.0,
                ));
            }
            if a.position <= SUSPICIOUS_SPREAD * spread(&self.rows) {
                return None;
            }
            return self.other_reading(given);
        }
        self.other_reading(given)
            .or_else(|| self.one_zero(given))
            .or_else(|| self.populations(TIGHT))
            .or_else(|| self.wide_geometry(given))
            .or_else(|| self.orientation_alone(given))
            .or_else(|| self.pairs(given))
            .or_else(|| self.populations(LOOSE))
            .or_else(|| Some(self.unexplained(given)))
    }

    /// Returns the rows whose joints no earlier row has.
    fn first_rows(&self) -> impl Iterator<Item = usize> {
        let samples = &self.data.samples;
        let is_first = |k: &usize| samples[..*k].iter().all(|s| s.joints != samples[*k].joints);
        (0..samples.len()).filter(is_first)
    }

    /// Returns the number of rows with different joints, up to [`LEAST_ROWS`].
    fn distinct(&self) -> usize {
        self.first_rows().take(LEAST_ROWS).count()
    }

    /// Returns one row for all that have the same joints.
    fn once_each(&self) -> Vec<Row> {
        self.first_rows().map(|k| self.rows[k]).collect()
    }

    /// Returns the refusal of a file that another reading explains.
    fn other_reading(&self, given: &Fit) -> Option<Finding> {
        let all = readings(self.data, self.has_orientation);
        let single = (0..all.len()).map(|i| vec![i]).collect();
        self.best_of(given, &all, single, RANKED)
    }

    /// Returns the refusal of a file that the zero of one joint explains.
    fn one_zero(&self, given: &Fit) -> Option<Finding> {
        let zero = joint_zero(self.data, given, self.reach)?;
        let finding = zero_off(&zero, given, self.has_orientation);
        zero.fit.explains(given).then_some(finding)
    }

    /// Returns the refusal of a file that two simultaneous mistakes explain, at least one of them in the joints.
    fn pairs(&self, given: &Fit) -> Option<Finding> {
        let all: Vec<Reading> = readings(self.data, self.has_orientation)
            .into_iter()
            .filter(|r| r.complexity == 1)
            .collect();
        let of_joints: Vec<usize> = (0..all.len()).filter(|i| all[*i].is_of_joints()).collect();
        let of_seen = (0..all.len()).filter(|i| all[*i].is_of_seen() && !all[*i].is_of_units());
        let of_seen: Vec<usize> = of_seen.take(MOST_SEEN).collect();
        let mut pairs: Vec<Vec<usize>> = Vec::new();
        for i in &of_joints {
            pairs.extend(of_seen.iter().map(|j| vec![*i, *j]));
        }
        for (k, i) in of_joints.iter().enumerate() {
            pairs.extend(of_joints[k + 1..].iter().map(|j| vec![*i, *j]));
        }
        pairs.truncate(MOST_PAIRS);
        self.best_of(given, &all, pairs, RANKED / 3)
    }

    /// Returns the refusal that names the best of some combinations of readings, if it explains the file, by at most `most` rows.
    fn best_of(
        &self,
        given: &Fit,
        all: &[Reading],
        combinations: Vec<Vec<usize>>,
        most: usize,
    ) -> Option<Finding> {
        let every: Vec<usize> = (0..self.rows.len()).collect();
        let which = &evenly_spaced(&every, most);
        let changes = |c: &[usize]| -> Vec<&Reading> { c.iter().map(|i| &all[*i]).collect() };
        let mut ranked: Vec<(f64, Vec<usize>)> = combinations
            .into_iter()
            .filter_map(|c| {
                let rows = Reading::rows_of(&changes(&c), self.data, which);
                let enough = rows.len() >= LEAST_ROWS;
                enough.then(|| (Fit::new(rough(&rows), &rows, self.reach).relative, c))
            })
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut fits: Vec<(Fit, Vec<usize>)> = ranked
            .into_iter()
            .take(REFINED)
            .map(|(_, c)| {
                let rows = Reading::rows_of(&changes(&c), self.data, which);
                (Fit::of(&rows, self.reach), c)
            })
            .collect();
        fits.sort_by(|a, b| a.0.relative.total_cmp(&b.0.relative));
        let best = fits
            .first()
            .filter(|(fit, _)| fit.explains(given))?
            .0
            .relative;
        fits.retain(|(fit, _)| fit.relative <= AS_GOOD * best);
        let complexity = |c: &[usize]| c.iter().map(|i| all[*i].complexity).sum::<usize>();
        // Among equal fits, the simplest comes first; among equally simple ones, the one that is listed first.
        let key =
            |(fit, c): &(Fit, Vec<usize>)| (fit.relative > EQUAL * best, complexity(c), c.clone());
        fits.sort_by_key(key);
        let sentence = |c: &[usize]| -> String {
            let sentences: Vec<&str> = c.iter().map(|i| all[*i].sentence.as_str()).collect();
            sentences.join(", and ")
        };
        let (fit, first) = &fits[0];
        let mut text = format!(
            "the poses are {} from the nominal robot; {}: that would leave {}",
            given.lengths(self.has_orientation),
            sentence(first),
            fit.lengths(self.has_orientation)
        );
        // Delays of neighbouring sizes are one explanation.
        let is_lag = |c: &[usize]| c.iter().all(|i| all[*i].cause == Cause::Lag);
        let others = fits[1..]
            .iter()
            .filter(|(_, c)| !(is_lag(first) && is_lag(c)));
        let others: Vec<String> = others.take(3).map(|(_, c)| sentence(c)).collect();
        text += &fits_equally(&others);
        let value = fit.relative / given.relative;
        Some(refused(all[first[0]].cause, text, value, BETTER))
    }

    /// Returns the refusal of a file with two populations of rows.
    fn populations(&self, tolerance: f64) -> Option<Finding> {
        let count = self.rows.len();
        if count < 16 {
            return None;
        }
        let agreeing = |fit: &Alignment| -> Vec<usize> {
            let agrees = |k: &usize| {
                let (position, rotation) = fit.residual(&self.rows[*k]);
                position < tolerance * self.reach && rotation < 3.0 * tolerance
            };
            (0..count).filter(agrees).collect()
        };
        let subset =
            |which: &[usize]| -> Vec<Row> { which.iter().map(|k| self.rows[*k]).collect() };
        let mut best: Vec<usize> = Vec::new();
        for start in starts_of_populations(count) {
            let rows = agreeing(&rough(&subset(&start)));
            if rows.len() > best.len().max(7) {
                let rows = agreeing(&align(&subset(&rows)));
                if rows.len() > best.len() {
                    best = rows;
                }
            }
        }
        let share = best.len() as f64 / count as f64;
        if best.len() < 8 || !(AGREEING..=NEARLY_ALL).contains(&share) {
            return None;
        }
        let fit = Fit::of(&subset(&best), self.reach);
        if fit.badness > 1.0 {
            return None;
        }
        let others: Vec<usize> = (0..count)
            .filter(|k| best.binary_search(k).is_err())
            .collect();
        let of_others: Vec<usize> = others.iter().map(|k| self.data.line(*k)).collect();
        let mut text = format!(
            "only {} of {count} rows agree on one base and tool; {} do not",
            best.len(),
            lines(&of_others)
        );
        let samples =
            |which: &[usize]| -> Vec<_> { which.iter().map(|k| self.data.samples[*k]).collect() };
        let along_moves = self.along_moves(&fit.alignment, &others);
        let cause = match along_moves.is_some() {
            true => Cause::Lag,
            false => Cause::Mixed,
        };
        if let Some(what) = along_moves {
            text += &format!("; {what}");
        } else if others.len() >= LEAST_ROWS {
            text += &self.of_others(&fit, &others);
            text += &frozen(self.data.robot, &samples(&others), &samples(&best));
        }
        Some(refused(cause, text, share, NEARLY_ALL).of_rows(of_others))
    }

    /// Says that the rows `others`, which do not agree with `alignment`, were read before the robot stood still.
    fn along_moves(&self, alignment: &Alignment, others: &[usize]) -> Option<String> {
        let predicted = |tool: usize, joints: &[f64]| {
            (self.data.chain.forward(joints) * alignment.tools[tool]).translation
        };
        let is_fitted = |k: &usize| self.rows[*k].tool < alignment.tools.len();
        let others: Vec<usize> = others.iter().copied().filter(is_fitted).collect();
        let error = |k: usize| {
            let seen = self.rows[k].seen.position();
            let own = predicted(
                self.rows[k].tool,
                &self.data.robot.serial_joints(&self.data.samples[k].joints),
            );
            alignment.base.inverse().transform_point(&seen) - own
        };
        unsettled::describe(self.data, &others, predicted, error)
    }

    /// Describes what explains the rows that do not agree with the others.
    fn of_others(&self, fit: &Fit, others: &[usize]) -> String {
        let rows: Vec<Row> = others.iter().map(|k| self.rows[*k]).collect();
        let own = Fit::of(&rows, self.reach);
        if own.badness <= 1.0 {
            let base = fit.alignment.base.inverse() * own.alignment.base;
            let tool = fit.alignment.tools[0].inverse() * own.alignment.tools[0];
            return format!(
                "; on their own they do, with the base {} and the target {} away: if only the target was remounted, give \
                 these rows a session of their own; otherwise calibrate from the rows of one base",
                lengths(base.translation.norm(), base.log().angular.norm(), true),
                lengths(tool.translation.norm(), tool.log().angular.norm(), true)
            );
        }
        let data = Data {
            robot: self.data.robot,
            chain: self.data.chain,
            samples: others.iter().map(|k| self.data.samples[*k]).collect(),
            lines: others.iter().map(|k| self.data.line(*k)).collect(),
            units: self.data.units.clone(),
        };
        let scene = Scene {
            data: &data,
            rows,
            ..*self
        };
        let reading = scene.other_reading(&own);
        match reading {
            Some(finding) => format!("; of those rows, {}", finding.text),
            None => format!(
                "; if the target was mounted several times, give each mounting a session of its own; if the instrument or the \
                 robot's base moved, {ONE_SET_UP}"
            ),
        }
    }

    /// Returns the refusal of a file whose positions fit but whose orientations do not.
    fn orientation_alone(&self, given: &Fit) -> Option<Finding> {
        if !self.has_orientation || given.alignment.rotation < REFUSED_ROTATION {
            return None;
        }
        let positions: Vec<Row> = self
            .rows
            .iter()
            .map(|row| Row {
                seen: Observation::Position(row.seen.position()),
                ..*row
            })
            .collect();
        let fit = Fit::of(&positions, self.reach);
        (fit.badness <= 1.0).then(|| {
            let text = format!(
                "the positions fit the nominal robot to {}, but the orientations are off by {:.0} mrad: check the \
                 order, the signs and the convention of the orientation columns",
                fit.lengths(false),
                1e3 * given.alignment.rotation
            );
            refused(Cause::Orientation, text, given.alignment.rotation, REFUSED_ROTATION)
        })
    }

    /// Returns the refusal of a file from an arm with other dimensions or another mastering; it names the joint or link that
    /// deviates most.
    fn wide_geometry(&self, given: &Fit) -> Option<Finding> {
        let geometry = Geometry::fit(self.data, &given.alignment, Priors::Wide, self.gravity)?;
        // Positions near a single point would be near a point of any arm.
        let fits = geometry.position < EXPLAINED_REACH * self.reach
            && given.is_spread
            && geometry.rotation < REFUSED_ROTATION / 2.0
            && geometry.position < BETTER * given.alignment.position;
        if !fits {
            return None;
        }
        let off = geometry.frames_off.iter().enumerate().skip(1);
        let turned = off.clone().max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let shifted = off.max_by(|a, b| a.1.0.total_cmp(&b.1.0));
        let (joint, (_, turn)) = turned?;
        let (link, (shift, _)) = shifted?;
        let (cause, named) = if turn / 35e-3 > shift / 6.5e-3 {
            let what = match self.data.robot.joints.get(joint).map(|joint| joint.kind) {
                Some(JointKind::Prismatic) => "the axis",
                _ => "the zero or the axis",
            };
            let named = format!(
                "{what} of joint {} differs by {:.2}° from the nominal model",
                joint + 1,
                turn.to_degrees()
            );
            (Cause::Offset, named)
        } else {
            (
                Cause::Frames,
                format!(
                    "the link before joint {} differs by {} from the nominal model",
                    link + 1,
                    length(*shift)
                ),
            )
        };
        let text = format!(
            "the poses are {} from the nominal robot; a fitted geometry leaves {}, and {named}: is the arm mastered, \
             and is it this variant of the robot?",
            given.lengths(self.has_orientation),
            lengths(geometry.position, geometry.rotation, self.has_orientation)
        );
        Some(refused(
            cause,
            text,
            geometry.position / given.alignment.position,
            BETTER,
        ))
    }

    /// Returns the refusal of a file that nothing explains.
    fn unexplained(&self, given: &Fit) -> Finding {
        let text = format!(
            "the poses are {} from the nominal robot, and nothing that was tried explains it: check that this is the \
             robot, and that the joints and the pose of each row belong together{}",
            given.lengths(self.has_orientation),
            frozen(self.data.robot, &self.data.samples, &[])
        );
        refused(Cause::NoFit, text, given.badness, 1.0)
    }
}

/// Returns the refusal that names a joint's zero.
fn zero_off(zero: &JointZero, given: &Fit, has_orientation: bool) -> Finding {
    let text = format!(
        "the poses are {} from the nominal robot; {}: that would leave {}; master this joint, or correct its column or the \
         robot's description",
        given.lengths(has_orientation),
        zero.sentence(),
        zero.fit.lengths(has_orientation)
    );
    refused(
        Cause::Offset,
        text,
        zero.fit.relative / given.relative,
        BETTER,
    )
}

fn refused(cause: Cause, text: String, value: f64, threshold: f64) -> Finding {
    Finding::new(cause, Tier::Refused, text, value, threshold)
}

/// Returns sets of rows from which a population may start: windows of the file, and groups of five in a fixed sequence, so
/// that the same file always gets the same answer.
fn starts_of_populations(count: usize) -> Vec<Vec<usize>> {
    let mut out: Vec<Vec<usize>> = Vec::new();
    for parts in [2, 3, 6, 12] {
        let length = (count / parts).max(8).min(count);
        out.extend((0..parts).map(|i| {
            let first = (i * count / parts).min(count - length);
            (first..first + length).collect()
        }));
    }
    let mut random = ChaCha8Rng::seed_from_u64(1);
    out.extend((0..60).map(|_| (0..5).map(|_| random.random_range(0..count)).collect()));
    out
}
