//! Finds changes of the set-up along the rows: a step of the base, the target or the zero of a joint, or a base that drifts.
//!
//! The columns of a change are those of the geometry, masked by the rows concerned.

use poegp_protocol::cause::Cause;

use crate::trust::added_terms::AddedTerms;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::readings::Data;
use crate::trust::wording::{length, lines, three_digits};

/// Number of splits that are tried first.
const SPLITS: usize = 25;
/// Drop of χ² per row that a change must cause, and an additive term for few rows.
const DROP: (f64, f64) = (0.9, 50.0);
/// Smallest drop of χ² that a change must cause.
const LEAST_DROP: f64 = 45.0;
/// Share of the best hypothesis's drop above which another hypothesis fits as well.
const AS_GOOD: f64 = 0.93;
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
}

impl Part {
    fn name(self) -> String {
        match self {
            Self::Base => "the instrument (base) moved".to_owned(),
            Self::Tool => "the target slipped or was mounted again".to_owned(),
            Self::Joint(j) => format!("the zero of joint {} changed", j + 1),
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
    let joints = geometry.state.layout.joints;
    AddedTerms::over(geometry, FRAMES + joints, samples, |k, row, column| {
        let effect = match column {
            0..6 => geometry.linear.a[(row, column)],
            6..12 => {
                let first = 6 * joints + 6 * geometry.samples[k].tool;
                geometry.linear.a[(row, first + column - 6)]
            }
            _ => geometry.linear.jacobian[(row, column - FRAMES)],
        };
        share(k) * effect
    })
}

/// Returns the change of `part` in so many rows.
fn change(geometry: &Geometry, sums: &AddedTerms, part: Part, rows: f64) -> Option<Change> {
    let columns: Vec<usize> = match part {
        Part::Base => (0..6).collect(),
        Part::Tool => (6..12).collect(),
        Part::Joint(j) => vec![FRAMES + j],
    };
    let sums = sums.of(&columns);
    let optimum = sums.optimum(geometry)?;
    // Residuals of a fit to few rows are smaller than the noise.
    let shrunk = geometry.degrees_of_freedom().powi(2);
    let square = sums.square(&optimum.coefficients) / rows.max(1.0);
    Some(Change {
        part,
        drop: optimum.drops.iter().sum::<f64>() / shrunk,
        displacement: square.sqrt() * geometry.scales.position,
    })
}

/// Returns the drop of χ² that a change must cause.
pub fn needed(geometry: &Geometry) -> f64 {
    let count = geometry.samples.len() as f64;
    geometry.leniency().powi(2) * (DROP.0 * count + DROP.1).max(LEAST_DROP)
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

/// Finds consecutive rows that share a change of base or target: something was moved and later moved back.
pub fn episode(data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
    let count = geometry.samples.len();
    let parts = SPLITS.min(count / 4);
    let bounds: Vec<usize> = (0..=parts).map(|i| i * count / parts.max(1)).collect();
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
            "about {} the measurements are shifted by {} against the others: {}",
            lines(&rows),
            length(change.displacement),
            change.part.name()
        );
        let tier = if change.displacement > REFUSED {
            Tier::Refused
        } else {
            Tier::Warning
        };
        Finding {
            cause: Cause::Step,
            tier,
            text,
            rows,
            value: change.drop / count as f64,
            threshold: needed / count as f64,
        }
    })
}

/// Finds a step of the set-up or a drift, if there is one.
pub fn examine(data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
    let count = geometry.samples.len();
    if count < 12 {
        return None;
    }
    let needed = needed(geometry);
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
    let drift = drift(geometry);
    let step = &changes[0];
    if let Some(drift) = drift
        && drift.drop > step.drop
        && drift.drop > needed
    {
        // A ramp from −½ to ½ has a root mean square of 1/√12.
        let travel = drift.displacement * 12.0_f64.sqrt();
        let text = format!(
            "the measurements drift by {} from the first row to the last: the instrument or its stand moves, or the arm \
             warms up; reference points beside the robot and --correct-drift remove it",
            length(travel)
        );
        return Some(Finding {
            cause: Cause::Drift,
            tier: Tier::Warning,
            text,
            rows: Vec::new(),
            value: drift.drop / count as f64,
            threshold: needed / count as f64,
        });
    }
    if step.drop <= needed {
        return None;
    }
    let as_good: Vec<String> = changes[1..]
        .iter()
        .filter(|c| c.drop > AS_GOOD * step.drop)
        .map(|c| c.part.name())
        .collect();
    let mut text = format!(
        "from line {} on the measurements are shifted by {}: {}",
        data.line(split),
        length(step.displacement),
        step.part.name()
    );
    if !as_good.is_empty() {
        text += &format!(" (as well: {})", as_good.join("; "));
    }
    let tier = if step.displacement > REFUSED {
        Tier::Refused
    } else {
        Tier::Warning
    };
    if tier == Tier::Warning {
        text += &format!(
            " (χ² drops by {} per row)",
            three_digits(step.drop / count as f64)
        );
    }
    Some(Finding {
        cause: Cause::Step,
        tier,
        text,
        rows: (split..count).map(|k| data.line(k)).collect(),
        value: step.drop / count as f64,
        threshold: needed / count as f64,
    })
}

/// Returns the change of a base that moves linearly through the rows.
fn drift(geometry: &Geometry) -> Option<Change> {
    let count = geometry.samples.len();
    let ramp = |k: usize| k as f64 / (count - 1) as f64 - 0.5;
    let sums = sums(geometry, 0..count, ramp);
    change(geometry, &sums, Part::Base, count as f64)
}
