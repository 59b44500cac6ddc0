//! Finds rows of two arms, or of two masterings of one arm, in any order.
//!
//! Each row belongs to one of two kinds, whose frames differ. The frames' difference and the kinds are estimated in turn: with
//! given kinds the difference is linear, and with a given difference each row belongs to the kind that it is nearer to.

use poegp_protocol::cause::Cause;

use crate::identification::parametric::state::ROWS;
use crate::trust::added_terms::AddedTerms;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::mixture::{BLOCK, not_straight};
use crate::trust::readings::Data;
use crate::trust::wording::{length, lines};

/// Smallest number of rows, and the smallest share of them that is an arm of its own: fewer rows are outliers.
const LEAST: (usize, f64) = (40, 0.2);
/// Most rows by which the kinds are searched for.
const MOST: usize = 120;
/// Share of χ² that two arms must explain beyond what they explain of noise: on measured arms at most 0.3.
const EXPLAINED: f64 = 0.7;
/// Equations that the choice of a row's kind takes of noise.
const OF_A_KIND: f64 = 0.6;
/// Share of a difference that other joint zeros must explain to be an arm that warmed up.
const OF_ZEROS: f64 = 0.85;
/// Most rounds of the search from one start.
const ROUNDS: usize = 12;

/// A difference between two kinds of rows.
struct Difference {
    /// Whether each row of the search is of the second kind.
    kinds: Vec<bool>,
    /// Whether each row of the file is.
    of_all: Vec<bool>,
    /// Drop of χ².
    drop: f64,
    /// Root mean square difference of the target between both arms, in m.
    displacement: f64,
}

/// Returns a refusal if the rows are of two arms. Of arms with coupled joints nothing is said: links of a parallelogram sag
/// in ways that the geometry does not describe, and which look like a second arm.
pub fn examine(data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
    let count = geometry.samples.len();
    if count < LEAST.0 || !geometry.is_whole() || data.robot.coupling.is_some() {
        return None;
    }
    // An odd step, for rows of two arms may alternate.
    let every = count.div_ceil(MOST) | 1;
    let rows: Vec<usize> = (0..count).step_by(every).collect();
    let joints = geometry.state.layout.joints;
    let found = starts(geometry, &rows)
        .into_iter()
        .filter_map(|kinds| search(geometry, &rows, kinds));
    let best = found.max_by(|a, b| a.drop.total_cmp(&b.drop))?;
    let all = geometry.chi_squared(rows.iter().copied());
    // Of noise, the difference takes an equation for each of its terms, and the choice of a kind more than half of one.
    let free = 6.0 * joints as f64 + OF_A_KIND * rows.len() as f64;
    let equations = geometry.equations() as f64 / every as f64;
    let chance = (free / equations).min(1.0);
    let needed = chance + EXPLAINED * (1.0 - chance);
    if best.drop < needed * all {
        return None;
    }
    // An arm that warmed up in a pause has other zeros from one row on.
    let turns = best.kinds.windows(2).filter(|w| w[0] != w[1]).count();
    if turns <= BLOCK {
        let zeros = terms_of_kinds(geometry, &rows, &best.kinds, joints, |row, j| {
            geometry.linear.jacobian[(row, j)]
        });
        let drop: f64 = zeros.optimum(geometry)?.drops.iter().sum();
        if drop > OF_ZEROS * best.drop {
            return None;
        }
    }
    let of_second = best.of_all.iter().filter(|kind| **kind).count();
    let is_fewer = 2 * of_second < count;
    if (of_second.min(count - of_second) as f64) < LEAST.1 * count as f64 {
        return None;
    }
    let in_rows = 1.0 / (geometry.noise_factor().powi(2) * rows.len() as f64);
    let (drop, needed) = (in_rows * best.drop, in_rows * needed * all);
    if let Some(text) = not_straight(data, &best.of_all, best.displacement) {
        return Some(Finding::new(
            Cause::Mixed,
            Tier::Warning,
            text,
            drop,
            needed,
        ));
    }
    let fewer = (0..count).filter(|k| best.of_all[*k] == is_fewer);
    let fewer: Vec<usize> = fewer.map(|k| data.line(k)).collect();
    let text = format!(
        "the rows are of two arms that differ by {} ({} against the others): did you merge two robots, or data from before \
         and after mastering? Calibrate each arm from its own rows",
        length(best.displacement),
        lines(&fewer)
    );
    Some(Finding::new(Cause::Mixed, Tier::Refused, text, drop, needed).of_rows(fewer))
}

/// Returns the kinds that are tried first: halves of the file, every second row, and the signs of the residuals along each
/// joint.
fn starts(geometry: &Geometry, rows: &[usize]) -> Vec<Vec<bool>> {
    let mut out: Vec<Vec<bool>> = vec![
        (0..rows.len()).map(|i| 2 * i >= rows.len()).collect(),
        (0..rows.len()).map(|i| i % 2 == 1).collect(),
    ];
    out.extend((0..geometry.state.layout.joints).map(|j| {
        let of = |k: &usize| along(geometry, *k, |row| geometry.linear.jacobian[(row, j)]) > 0.0;
        rows.iter().map(of).collect()
    }));
    out
}

/// Returns the sum over the components of a sample's residual times an effect.
fn along(geometry: &Geometry, k: usize, effect: impl Fn(usize) -> f64) -> f64 {
    (0..ROWS)
        .map(|i| effect(ROWS * k + i) * geometry.residuals[k][i])
        .sum()
}

/// Returns the sign of each sample: a half of a difference up or down, by its kind; 0 for samples that are not in `rows`.
fn signs(geometry: &Geometry, rows: &[usize], kinds: &[bool]) -> Vec<f64> {
    let mut signs = vec![0.0; geometry.samples.len()];
    for (k, kind) in rows.iter().zip(kinds) {
        signs[*k] = if *kind { 0.5 } else { -0.5 };
    }
    signs
}

/// Returns sums for terms that differ between the kinds; `effect` is that of a term on a residual component.
fn terms_of_kinds(
    geometry: &Geometry,
    rows: &[usize],
    kinds: &[bool],
    terms: usize,
    effect: impl Fn(usize, usize) -> f64,
) -> AddedTerms {
    let signs = signs(geometry, rows, kinds);
    AddedTerms::over(geometry, terms, rows.iter().copied(), |k, row, term| {
        signs[k] * effect(row, term)
    })
}

/// Improves the kinds of `rows` until they no longer change.
fn search(geometry: &Geometry, rows: &[usize], mut kinds: Vec<bool>) -> Option<Difference> {
    let terms = 6 * geometry.state.layout.joints;
    let frame = |row: usize, term: usize| geometry.linear.a[(row, term)];
    let mut best: Option<Difference> = None;
    for _ in 0..ROUNDS {
        let sign = signs(geometry, rows, &kinds);
        let sums = terms_of_kinds(geometry, rows, &kinds, terms, frame);
        let optimum = sums.optimum(geometry)?;
        let drop = optimum.drops.iter().sum();
        if best.as_ref().is_some_and(|best| drop <= best.drop) {
            break;
        }
        let left = sums.left(geometry, &optimum.coefficients, |k, row, term| {
            sign[k] * frame(row, term)
        });
        let nearer = |k: usize| {
            let of = |row: usize| -> f64 {
                let parts = optimum.coefficients.iter().enumerate();
                parts
                    .map(|(term, x)| x * geometry.linear.a[(row, term)])
                    .sum()
            };
            // With its own share added again, the residual is from the middle between both arms.
            let parts = (0..ROWS).map(|i| {
                let whole = of(ROWS * k + i);
                whole * (left[k][i] + sign[k] * whole)
            });
            parts.sum::<f64>() > 0.0
        };
        let square = 4.0 * sums.square(&optimum.coefficients) / rows.len() as f64;
        let next = rows.iter().map(|k| nearer(*k)).collect();
        best = Some(Difference {
            kinds: std::mem::replace(&mut kinds, next),
            of_all: (0..geometry.samples.len()).map(nearer).collect(),
            drop,
            displacement: square.sqrt() * geometry.scales.position,
        });
    }
    best
}
