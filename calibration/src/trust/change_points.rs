//! Finds changes of the set-up along the rows: a step of the base, the target or the zero of a joint, or a base that drifts.
//!
//! The columns of a change are those of the geometry, masked by the rows concerned.

use poegp_protocol::cause::Cause;

use crate::identification::alignment::LEVER;
use crate::identification::parametric::state::ROWS;
use crate::trust::added_terms::AddedTerms;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::readings::Data;
use crate::trust::wording::{ONE_SET_UP, fits_equally, length, lines, three_digits};

/// Number of splits that are tried first.
pub const SPLITS: usize = 25;
/// Drop of χ² per row that a change must cause, and an additive term for few rows.
const DROP: (f64, f64) = (0.9, 50.0);
/// Share of the best hypothesis's drop above which another hypothesis fits as well.
pub const AS_GOOD: f64 = 0.93;
/// Time constants with which a warm-up settles, as shares of the whole measurement.
const SETTLES: [f64; 5] = [0.08, 0.16, 0.32, 0.64, 1.28];
/// Smallest number of rows among which a change is searched for, and in the scales that it leaves.
const LEAST_ROWS: (usize, usize) = (12, 16);
/// Share of χ² above which a change that is just found explains so much that its scatter may hide others like it.
pub const BLIND: f64 = 0.25;
/// Largest number of times that χ² is counted again, and the relative change of the scales at which they have settled.
const ROUNDS: usize = 10;
const SETTLED: f64 = 0.02;
/// Ratio below which the scatter must fall once such a change is taken out.
const FALL: f64 = 0.5;
/// Displacement in m from which other joint zeros are no warm-up.
const WARMEST: f64 = 3e-3;
/// Displacement above which a change is refused, in m.
pub const REFUSED: f64 = 3e-3;

/// The part of the set-up that changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The base relative to the instrument.
    Base,
    /// The target relative to the flange.
    Tool,
    /// The zero of a joint; its index is from 0.
    Joint(usize),
    /// The zeros of all joints, while the arm warms up.
    Joints,
}

impl Part {
    fn name(self) -> String {
        match self {
            Self::Base => "the instrument (base) moved".to_owned(),
            Self::Tool => "the target slipped or was remounted".to_owned(),
            Self::Joint(j) => format!("the zero of joint {} changed", j + 1),
            Self::Joints => "the arm warmed up".to_owned(),
        }
    }
}

/// A change that applies to some rows.
#[derive(Clone, Debug)]
pub struct Change {
    /// The part that changed.
    pub part: Part,
    /// Drop of χ² that the change causes.
    pub drop: f64,
    /// Root mean square displacement of the target, in m.
    pub displacement: f64,
    /// Coefficient of each column of the part.
    coefficients: Vec<f64>,
}

impl Change {
    /// Returns the tier of a finding of the change.
    pub fn tier(&self) -> Tier {
        Tier::refused_if(self.displacement > REFUSED)
    }

    /// Creates the finding that the change has lowered χ² of `count` rows by more than needed.
    pub fn finding(
        &self,
        (cause, tier): (Cause, Tier),
        text: String,
        needed: f64,
        count: usize,
    ) -> Finding {
        let count = count as f64;
        Finding::new(cause, tier, text, self.drop / count, needed / count)
    }
}

/// Number of columns of base and tool among those of all changes; the joints follow.
const FRAMES: usize = 12;

/// Returns the sums for all possible changes over some samples: base, tool and joints. Each change is multiplied by
/// `share` of the sample.
fn sums(
    geometry: &Geometry,
    samples: impl Iterator<Item = usize>,
    share: impl Fn(usize) -> f64,
) -> AddedTerms {
    let terms = FRAMES + geometry.state.layout.joints;
    AddedTerms::over(geometry, terms, samples, |k, row, column| {
        share(k) * effect(geometry, k, row, column)
    })
}

/// Returns the effect of a column of [`sums`] on a residual component of a sample that it concerns wholly.
fn effect(geometry: &Geometry, k: usize, row: usize, column: usize) -> f64 {
    let joints = geometry.state.layout.joints;
    match column {
        0..6 => geometry.linear.a[(row, column)],
        6..12 => {
            let first = 6 * joints + 6 * geometry.samples[k].tool;
            geometry.linear.a[(row, first + column - 6)]
        }
        _ => geometry.linear.jacobian[(row, column - FRAMES)],
    }
}

/// Returns the columns of a change of `part`.
fn columns(geometry: &Geometry, part: Part) -> Vec<usize> {
    match part {
        Part::Base => (0..6).collect(),
        Part::Tool => (6..12).collect(),
        Part::Joint(j) => vec![FRAMES + j],
        Part::Joints => (FRAMES..FRAMES + geometry.state.layout.joints).collect(),
    }
}

/// Returns the change of `part` in so many rows.
fn change(geometry: &Geometry, sums: &AddedTerms, part: Part, rows: f64) -> Option<Change> {
    let sums = sums.of(&columns(geometry, part));
    let optimum = sums.optimum(geometry)?;
    // Residuals of a fit to few rows are smaller than the noise.
    let shrunk = geometry.noise_factor().powi(2);
    let square = sums.square(&optimum.coefficients) / rows.max(1.0);
    Some(Change {
        part,
        drop: optimum.drops.iter().sum::<f64>() / shrunk,
        displacement: square.sqrt() * geometry.scales.position,
        coefficients: optimum.coefficients,
    })
}

/// Returns the root mean square displacement in m and rotation in rad of the target of `rows` by a change.
fn motion(geometry: &Geometry, change: &Change, rows: std::ops::Range<usize>) -> (f64, f64) {
    let columns = columns(geometry, change.part);
    let count = rows.len() as f64;
    let (mut position, mut rotation) = (0.0, 0.0);
    for k in rows {
        let scales = geometry.scales.of(&geometry.samples[k]);
        for i in 0..ROWS {
            let parts = columns.iter().zip(&change.coefficients);
            let moved: f64 = parts
                .map(|(column, x)| x * effect(geometry, k, ROWS * k + i, *column))
                .sum();
            match i {
                0..3 => position += (moved * scales.position).powi(2),
                _ => rotation += (moved * scales.orientation).powi(2),
            }
        }
    }
    ((position / count).sqrt(), (rotation / count).sqrt())
}

/// Returns the drop of χ² that a change must cause among so many rows.
pub fn drop_among(rows: usize) -> f64 {
    DROP.0 * rows as f64 + DROP.1
}

/// Returns the drop of χ² that a change of a geometry must cause.
pub fn needed(geometry: &Geometry) -> f64 {
    geometry.leniency().powi(2) * drop_among(geometry.samples.len())
}

/// Returns the changes that `rows` alone may have, best first.
pub fn changes(geometry: &Geometry, rows: &[usize]) -> Vec<Change> {
    let sums = sums(geometry, rows.iter().copied(), |_| 1.0);
    best_first(geometry, &sums, rows.len() as f64)
}

fn best_first(geometry: &Geometry, sums: &AddedTerms, rows: f64) -> Vec<Change> {
    let joints = (0..geometry.state.layout.joints).map(Part::Joint);
    let parts = [Part::Base, Part::Tool].into_iter().chain(joints);
    let mut out: Vec<Change> = parts
        .filter_map(|part| change(geometry, sums, part, rows))
        .collect();
    out.sort_by(|a, b| b.drop.total_cmp(&a.drop));
    out
}

/// For each of `splits`, returns the changes from that row on, best first.
fn steps(geometry: &Geometry, splits: &[usize]) -> Vec<(usize, Vec<Change>)> {
    let count = geometry.samples.len();
    let mut after = AddedTerms::zero(geometry, FRAMES + geometry.state.layout.joints);
    let mut out = Vec::new();
    let mut end = count;
    for split in splits.iter().rev() {
        after.add(&sums(geometry, *split..end, |_| 1.0));
        end = *split;
        out.push((*split, best_first(geometry, &after, (count - split) as f64)));
    }
    out
}

/// Finds consecutive rows that share a change of base or target: something was moved and later moved back. If the geometry
/// explains most, these can only be all rows of a mounting: the instrument was set up with the target.
pub fn episode(data: &Data<'_>, geometry: &Geometry, is_poor: bool) -> Option<Finding> {
    let count = geometry.samples.len();
    let parts = SPLITS.min(count / 4);
    let bounds: Vec<usize> = match is_poor {
        true => (0..=parts).map(|i| i * count / parts.max(1)).collect(),
        false => geometry.mountings(parts)?,
    };
    let parts = bounds.len() - 1;
    let parts_of_all: Vec<AddedTerms> = bounds
        .windows(2)
        .map(|w| sums(geometry, w[0]..w[1], |_| 1.0))
        .collect();
    let mut best: Option<(usize, usize, Change)> = None;
    for first in 0..parts {
        let mut window = AddedTerms::zero(geometry, FRAMES + geometry.state.layout.joints);
        for last in first..parts {
            window.add(&parts_of_all[last]);
            let rows = (bounds[last + 1] - bounds[first]) as f64;
            for part in [Part::Base, Part::Tool] {
                if let Some(change) = change(geometry, &window, part, rows)
                    && best.as_ref().is_none_or(|(_, _, b)| change.drop > b.drop)
                {
                    best = Some((bounds[first], bounds[last + 1], change));
                }
            }
        }
    }
    let (first, end, change) = best?;
    let needed = needed(geometry);
    (change.drop > needed).then(|| {
        let rows: Vec<usize> = (first..end).map(|k| data.line(k)).collect();
        let text = format!(
            "around {} the measurements are shifted by {} relative to the others: {}",
            lines(&rows),
            length(change.displacement),
            change.part.name()
        );
        let step = (Cause::Step, change.tier());
        change.finding(step, text, needed, count).of_rows(rows)
    })
}

/// How the set-up may have changed along the rows.
struct Hypotheses {
    /// First row of the best step.
    split: usize,
    /// The changes from that row on, best first.
    changes: Vec<Change>,
    /// The best change that takes as long as the measurement.
    gradual: Option<Gradual>,
}

/// Compares the hypotheses in the units of a geometry's scales.
fn hypotheses(geometry: &Geometry) -> Option<Hypotheses> {
    let count = geometry.samples.len();
    if count < LEAST_ROWS.0 {
        return None;
    }
    let least = 4;
    let coarse: Vec<usize> = (1..=SPLITS)
        .map(|i| i * count / (SPLITS + 1))
        .filter(|k| (least..=count - least).contains(k))
        .collect();
    let best = |steps: Vec<(usize, Vec<Change>)>| {
        steps
            .into_iter()
            .filter(|(_, changes)| !changes.is_empty())
            .max_by(|a, b| a.1[0].drop.total_cmp(&b.1[0].drop))
    };
    let (middle, _) = best(steps(geometry, &coarse))?;
    let near = count.div_ceil(SPLITS + 1);
    let fine: Vec<usize> =
        (middle.saturating_sub(near).max(least)..=(middle + near).min(count - least)).collect();
    let (split, changes) = best(steps(geometry, &fine))?;
    Some(Hypotheses {
        split,
        changes,
        gradual: gradual(geometry),
    })
}

/// Finds a step of the set-up or a drift, if there is one. `fewer` returns geometries with fewer and fewer terms.
///
/// A change that the geometry does not have enlarges the scales in which χ² is counted: with few rows, or a change in many of
/// them, its own scatter hides it. So χ² is counted again in the scales that the best change leaves.
pub fn examine<Fewer: Iterator<Item = Geometry>>(
    data: &Data<'_>,
    geometry: &Geometry,
    fewer: impl FnOnce() -> Fewer,
) -> Option<Finding> {
    let first = hypotheses(geometry)?;
    if let Some(finding) = first.finding(data, geometry) {
        return Some(finding);
    }
    if geometry.samples.len() < LEAST_ROWS.1 || !is_blind(geometry) {
        return None;
    }
    let mut answer = in_its_own_scales(data, geometry.clone());
    if answer.is_none() {
        answer = fewer().find_map(|geometry| in_its_own_scales(data, geometry));
    }
    answer?
}

/// Finds a change in the scales that it leaves; `None` if the terms of the geometry follow the noise then, so that one with
/// fewer terms must answer.
fn in_its_own_scales(data: &Data<'_>, geometry: Geometry) -> Option<Option<Finding>> {
    let scatter = |g: &Geometry| g.scales.position * g.noise_factor();
    let before = scatter(&geometry);
    let mut geometry = geometry;
    for round in 0..=ROUNDS {
        let Some(found) = hypotheses(&geometry) else {
            return Some(None);
        };
        let Some(next) = found.taken_out(&geometry) else {
            return Some(None);
        };
        if next.is_too_free() {
            return None;
        }
        let settled = (scatter(&next) / scatter(&geometry) - 1.0).abs() < SETTLED;
        if settled || round == ROUNDS {
            let is_clear = scatter(&geometry) < FALL * before;
            return Some(found.finding(data, &geometry).filter(|_| is_clear));
        }
        geometry = next;
    }
    Some(None)
}

/// Returns whether a change would have to explain a large share of χ² to be found.
fn is_blind(geometry: &Geometry) -> bool {
    let all = geometry.chi_squared(0..geometry.samples.len());
    needed(geometry) > BLIND * all / geometry.noise_factor().powi(2)
}

impl Hypotheses {
    /// Returns the geometry in the scales that the best change leaves.
    fn taken_out(&self, geometry: &Geometry) -> Option<Geometry> {
        let step = &self.changes[0];
        match &self.gradual {
            Some(gradual) if gradual.change.drop > step.drop => {
                without(geometry, gradual.change.part, |k| gradual.shares[k])
            }
            _ => without(geometry, step.part, |k| {
                f64::from(u8::from(k >= self.split))
            }),
        }
    }

    /// Returns the finding of the best hypothesis if it explains enough.
    fn finding(&self, data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
        let count = geometry.samples.len();
        let needed = needed(geometry);
        let (split, changes) = (self.split, &self.changes);
        let step = &changes[0];
        let gradual = self.gradual.as_ref().map(|g| &g.change);
        let gradual = gradual.filter(|g| g.part != Part::Joints || g.displacement < WARMEST);
        let as_good = |other: &Change, best: &Change| other.drop > AS_GOOD * best.drop;
        if let Some(drift) = gradual
            && drift.drop > step.drop
            && drift.drop > needed
        {
            let tier = match drift.part {
                Part::Joints => Tier::Warning,
                _ => drift.tier(),
            };
            // A ramp from −½ to ½ has a root mean square of 1/√12.
            let whole = || length(drift.displacement * 12.0_f64.sqrt());
            let mut text = match (drift.part, tier) {
                (Part::Joints, _) => format!(
                    "the measurements drift by {} and settle: the arm warmed up while it was measured; run it until it \
                     is warm, then measure",
                    length(drift.displacement)
                ),
                (_, Tier::Refused) => format!(
                    "the measurements drift by {} from the first row to the last: the instrument or the robot's base moved; \
                     {ONE_SET_UP}",
                    whole()
                ),
                _ => format!(
                    "the measurements drift by {} from the first row to the last: the instrument or its stand moves, or the arm \
                     warms up; reference points beside the robot and --correct-drift remove it",
                    whole()
                ),
            };
            if as_good(step, drift) {
                text += &format!(
                    " (fits equally: from line {} on, {})",
                    data.line(split),
                    step.part.name()
                );
            }
            return Some(drift.finding((Cause::Drift, tier), text, needed, count));
        }
        if step.drop <= needed {
            return None;
        }
        // An arm that warms up in a pause has other zeros of all joints from one row on, which no single part explains.
        let after = sums(geometry, split..count, |_| 1.0);
        let zeros = change(geometry, &after, Part::Joints, (count - split) as f64)
            .filter(|joints| !as_good(step, joints));
        let rows = || (split..count).map(|k| data.line(k)).collect();
        if let Some(zeros) = zeros.as_ref().filter(|z| z.displacement > WARMEST) {
            let text = format!(
                "from line {} on the zeros of several joints differ, by {} at the target: did you merge two robots, or data from \
                 before and after mastering? Calibrate each part from its own rows",
                data.line(split),
                length(zeros.displacement)
            );
            let step = (Cause::Step, Tier::Refused);
            return Some(zeros.finding(step, text, needed, count).of_rows(rows()));
        }
        let is_gradual = gradual.is_some_and(|c| c.part == Part::Joints && as_good(c, step));
        let others = changes[1..].iter().filter(|c| as_good(c, step));
        let mut as_good: Vec<String> = others.map(|c| c.part.name()).collect();
        if zeros.is_some() || is_gradual {
            as_good.push(Part::Joints.name());
        }
        let (shift, turn) = motion(geometry, step, split..count);
        let moved = match turn > shift / LEVER {
            true => format!("turned by {} mrad", three_digits(1e3 * turn)),
            false => format!("shifted by {}", length(shift)),
        };
        let tier = Tier::refused_if(shift.max(LEVER * turn) > REFUSED);
        let mut text = format!(
            "from line {} on the measurements are {moved}: {}",
            data.line(split),
            step.part.name()
        );
        text += &fits_equally(&as_good);
        if tier == Tier::Warning {
            text += &format!(
                " (χ² drops by {} per row)",
                three_digits(step.drop / count as f64)
            );
        }
        let finding = step.finding((Cause::Step, tier), text, needed, count);
        Some(finding.of_rows(rows()))
    }
}

/// Returns the geometry in the scales that a change of `part` leaves, multiplied by `share` of each sample.
fn without(geometry: &Geometry, part: Part, share: impl Fn(usize) -> f64) -> Option<Geometry> {
    let columns = columns(geometry, part);
    let sums = sums(geometry, 0..geometry.samples.len(), &share).of(&columns);
    let optimum = sums.optimum(geometry)?;
    let left = sums.left(geometry, &optimum.coefficients, |k, row, term| {
        share(k) * effect(geometry, k, row, columns[term])
    });
    geometry.rescaled(&left)
}

/// A change that takes as long as the measurement, and its share in each row.
struct Gradual {
    change: Change,
    shares: Vec<f64>,
}

/// Returns the best of the changes that take as long as the measurement: a base that moves linearly through the rows, or
/// joint zeros that settle while the arm warms up.
fn gradual(geometry: &Geometry) -> Option<Gradual> {
    let count = geometry.samples.len();
    let of = |part: Part, shares: Vec<f64>, rows: f64| {
        let sums = sums(geometry, 0..count, |k| shares[k]);
        let change = change(geometry, &sums, part, rows)?;
        Some(Gradual { change, shares })
    };
    let ramp = |k: usize| k as f64 / (count - 1) as f64 - 0.5;
    let base = of(Part::Base, (0..count).map(ramp).collect(), count as f64);
    let times: Option<Vec<f64>> = (geometry.samples.iter())
        .map(|s| Some(s.elapsed?.value))
        .collect();
    let times = times.unwrap_or_else(|| (0..count).map(|k| k as f64).collect());
    let end = times.iter().fold(0.0, |end: f64, time| end.max(*time));
    let warm = SETTLES.iter().filter_map(|part| {
        let settles: Vec<f64> = times.iter().map(|t| libm::exp(-t / (part * end))).collect();
        let squares: f64 = settles.iter().map(|share| share * share).sum();
        // With this number of rows, the displacement is that from the beginning to the end.
        of(
            Part::Joints,
            settles,
            squares / libm::expm1(-1.0 / part).powi(2),
        )
    });
    base.into_iter()
        .chain(warm)
        .max_by(|a, b| a.change.drop.total_cmp(&b.change.drop))
}
