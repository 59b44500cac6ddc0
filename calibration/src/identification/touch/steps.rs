//! Finds a step along the rows of a touch file: a feature that was moved, a tip that slipped, a joint with another zero.
//!
//! A step that the fit does not have inflates τ and hides itself, so χ² is counted in the scales that the step leaves.

use poegp_protocol::JointKind;

use crate::identification::touch::added::{Added, Part};
use crate::identification::touch::added_equation::{AddedScales, SHARED};
use crate::identification::touch::fit::{TouchFit, TouchProblem};

use crate::identification::touch::left_out::as_normal;
use crate::identification::touch::whitened::{FromRow, NOTHING, Whitened};
use crate::measurement::touch::FeatureKind;

/// A step along the rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// What changed.
    pub part: Part,
    /// Indices of the first rows after the change: one, or one for each feature that was touched in turn.
    pub first: Vec<usize>,
    /// Displacement, m, and rotation, rad.
    pub moved: (f64, f64),
    /// Displacement of the tip relative to what it touches, m.
    pub displacement: f64,
    /// Drop of χ², and the drop that is needed.
    pub drop: (f64, f64),
    /// Ratio by which the scatter of the rows that it concerns falls once the step is taken out.
    pub fall: f64,
    /// By how much −2 log of the evidence falls with the step.
    pub gain: f64,
    /// Other parts whose change explains the rows as well.
    pub others: Vec<Part>,
}

/// Most rounds until the scales have settled, and the change at which they have.
const ROUNDS: usize = 12;
const SETTLED: f64 = 0.01;
/// Fewest rows among which a step is searched for.
const LEAST_ROWS: usize = 10;
/// Drop of χ² per equation that a step concerns that it must cause, and an additive term for few equations.
const DROP: (f64, f64) = (0.7, 25.0);
/// Ratio below which the scatter must fall once the step is taken out.
const FALL: f64 = 0.75;
/// By how much −2 log of the evidence rises with each term: twice the logarithm of how much closer the rows determine a
/// displacement than it is known before, 0.1 m.
const TERM: f64 = 17.0;
/// Displacement from which on it is no step but another mistake, m.
const FARTHEST: f64 = 0.1;
/// Least weight of a row while a step is searched for.
const LEAST_WEIGHT: f64 = 0.1;
/// Share of the best part's drop above which the change of another part explains the rows as well.
const AS_GOOD: f64 = 0.93;
/// Share above which a feature alone is named before all of them together.
const ALONE: f64 = 0.98;
/// Distance at which a rotation of a sensor counts as a displacement, m.
const LEVER: f64 = 0.5;
/// Largest number of rows of which each by itself is compared with the others, and most of them that are left out.
const FEW: usize = 60;
const MOST_ALONE: usize = 2;
/// Rows that are compared in each round.
const TRIED: usize = 3;
/// Standard deviations of a normal number that are as improbable as the error of a row that contradicts the others.
const CONTRADICTS: f64 = 5.0;

/// Returns the scales of the fit without a step.
fn settled(added: &Added, start: AddedScales) -> Option<AddedScales> {
    let mut scales = start;
    for _ in 0..ROUNDS {
        let next = Whitened::new(added, &scales)?.scales_without(None, &scales);
        let change = (next.scatter - scales.scatter).abs();
        scales = next;
        if change < SETTLED {
            break;
        }
    }
    Some(scales)
}

/// Returns the scales of a fit; `floor` is the least weight of a row.
fn scales_of(fit: &TouchFit, added: &Added, floor: f64) -> AddedScales {
    let mut tau = [fit.joint_scatter; SHARED + 1];
    tau[..SHARED].copy_from_slice(&fit.tau);
    let weights = fit.weights.iter().map(|w| w.max(floor));
    AddedScales {
        tau,
        weights: weights.chain((0..added.images).map(|_| 1.0)).collect(),
        scatter: f64::INFINITY,
    }
}

/// The steps that the rows may show.
struct Searched {
    added: Added,
    /// The steps, best first, in the scales that the best leaves.
    found: Vec<FromRow>,
    /// Ratio by which the scatter of the rows that it concerns falls once the best is taken out.
    fall: f64,
    /// By how much −2 log of the evidence falls with the best.
    gain: f64,
}

impl Searched {
    /// Returns the drop of χ² that the best step must cause: the more rows it concerns, the more.
    fn needed(&self) -> f64 {
        let best = self.found.first();
        let concerned = best.map_or(0, |best| self.added.concerned(best.part).count());
        DROP.0 * concerned as f64 + DROP.1
    }
}

/// Searches for steps from any row on, or from the row `from` on. `start` are the scales of the fit.
fn searched(added: Added, start: AddedScales, from: Option<usize>) -> Option<Searched> {
    let without = settled(&added, start)?;
    let mut scales = without.clone();
    let mut found: Vec<FromRow> = Vec::new();
    for _ in 0..ROUNDS {
        let whitened = Whitened::new(&added, &scales)?;
        found = whitened.best_of_parts(from);
        let next = whitened.scales_without(found.first(), &scales);
        let change = (next.scatter - scales.scatter).abs();
        scales = next;
        if change < SETTLED {
            break;
        }
    }
    let fall = found.first().map_or(1.0, |best| {
        let change = added.scatter(best.part, &scales) - added.scatter(best.part, &without);
        libm::exp(change)
    });
    // What is left over all rows, less what so many terms and the choice of their first row explain of any rows.
    let shown = added.equations.iter().filter(|e| e.shows_arm()).count() as f64;
    let terms = found.first().map_or(0, |best| best.terms.len()) as f64;
    let chosen = TERM * terms + 2.0 * libm::log(f64::max(shown, 1.0));
    let gain = 2.0 * shown * (without.scatter - scales.scatter) - chosen;
    Some(Searched {
        added,
        found,
        fall,
        gain,
    })
}

/// Finds the step that the rows show and `fit` does not have.
pub fn step(problem: &TouchProblem, fit: &TouchFit) -> Option<Step> {
    if problem.set.rows.len() < LEAST_ROWS {
        return None;
    }
    let added = Added::new(problem, fit);
    let is_clear = |searched: &Searched| {
        let best = searched.found.first();
        best.is_some_and(|best| best.drop > searched.needed()) && searched.fall < FALL
    };
    // Rows that the fit leaves out are often those on one side of the step.
    let mut start = scales_of(fit, &added, LEAST_WEIGHT);
    let found = searched(added, start.clone(), None).filter(is_clear)?;
    // One wrong row by itself is no step.
    let found = match worst(&found.added, &start) {
        None => found,
        Some(row) => {
            start.weights[row] = NOTHING;
            searched(found.added, start, None).filter(is_clear)?
        }
    };
    let step = named(problem, &found, found.needed());
    (step.displacement < FARTHEST).then_some(step)
}

/// Returns the step from `row` on that explains the rows best.
pub fn since(problem: &TouchProblem, fit: &TouchFit, row: usize) -> Option<Step> {
    let added = Added::new(problem, fit);
    let start = scales_of(fit, &added, LEAST_WEIGHT);
    let searched = searched(added, start, Some(row))?;
    (!searched.found.is_empty()).then(|| named(problem, &searched, 0.0))
}

/// Describes the best step, of which there is at least one.
fn named(problem: &TouchProblem, searched: &Searched, needed: f64) -> Step {
    let (added, found) = (&searched.added, &searched.found);
    let best = &found[0];
    let alone = found
        .iter()
        .find(|f| matches!(f.part, Part::Feature(_)) && f.drop > ALONE * best.drop);
    let best = match best.part {
        Part::Together => alone.unwrap_or(best),
        _ => best,
    };
    let others = found.iter().filter(|f| f.part != best.part);
    let others = others.filter(|f| f.drop > AS_GOOD * best.drop);
    let order = &added.orders[best.order];
    let mut first: Vec<(Option<usize>, usize)> = Vec::new();
    for (row, of_row) in problem.set.rows.iter().enumerate() {
        // In the order of the file the rows have one beginning, otherwise each feature has its own.
        let feature = of_row.reading.feature().filter(|_| best.order > 0);
        if order[row] >= best.first && first.iter().all(|(known, _)| *known != feature) {
            first.push((feature, row));
        }
    }
    let moved = moved(problem, best);
    let displacement = match best.part {
        Part::Joint(joint) => added.levers[joint] * (moved.0 + moved.1),
        _ => moved.0.max(LEVER * moved.1),
    };
    Step {
        part: best.part,
        first: first.into_iter().map(|(_, row)| row).collect(),
        moved,
        displacement,
        drop: (best.drop, needed),
        fall: searched.fall,
        gain: searched.gain,
        others: others.map(|f| f.part).collect(),
    }
}

/// Returns displacement and rotation of a part.
fn moved(problem: &TouchProblem, step: &FromRow) -> (f64, f64) {
    let norm = |terms: &[f64]| terms.iter().map(|x| x * x).sum::<f64>().sqrt();
    let terms = &step.terms;
    match step.part {
        Part::Feature(feature) => match problem.set.features[feature].kind {
            FeatureKind::Plane { .. } => (terms[2].abs(), norm(&terms[..2])),
            FeatureKind::Level { .. } => (0.0, norm(terms)),
            _ => (norm(&terms[..3]), norm(&terms[3..])),
        },
        Part::Joint(joint) => match problem.nominal.kinds()[joint] {
            JointKind::Revolute => (0.0, norm(terms)),
            JointKind::Prismatic => (norm(terms), 0.0),
        },
        _ => (norm(&terms[..3]), norm(&terms[3..])),
    }
}

/// Returns single rows that contradict all others, among so few that the fit to all of them follows a wrong one.
pub fn contradicting(problem: &TouchProblem, fit: &TouchFit) -> Vec<usize> {
    let rows = problem.set.rows.len();
    let mut out = Vec::new();
    if !(LEAST_ROWS..=FEW).contains(&rows) {
        return out;
    }
    let added = Added::new(problem, fit);
    let mut scales = scales_of(fit, &added, NOTHING);
    while out.len() < MOST_ALONE {
        // An image as a whole is no single row.
        let Some(row) = worst(&added, &scales).filter(|row| *row < rows) else {
            break;
        };
        scales.weights[row] = NOTHING;
        out.push(row);
    }
    out
}

/// Returns the standard deviations of a normal number that are as improbable as the error of a row.
fn error(whitened: &Whitened, row: usize, scales: &AddedScales) -> Option<f64> {
    let (chi, components) = whitened.predicted(row, scales)?;
    Some(as_normal(chi / components, components))
}

/// Returns the row that contradicts the others most, in the scales that they have without it.
fn worst(added: &Added, scales: &AddedScales) -> Option<usize> {
    let scales = settled(added, scales.clone())?;
    let whitened = Whitened::new(added, &scales)?;
    let counted = (0..scales.weights.len()).filter(|row| scales.weights[*row] > NOTHING);
    let mut all: Vec<(f64, usize)> = counted
        .filter_map(|row| Some((error(&whitened, row, &scales)?, row)))
        .collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let without = |row: usize| {
        let mut others = scales.clone();
        others.weights[row] = NOTHING;
        let others = settled(added, others)?;
        Some((error(&Whitened::new(added, &others)?, row, &others)?, row))
    };
    let tried = all.iter().take(TRIED).filter_map(|(_, row)| without(*row));
    let worst = tried.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (worst.0 > CONTRADICTS).then_some(worst.1)
}
