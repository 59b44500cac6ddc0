//! Finds changes of the set-up along the rows: a step of the base, the target or the zero of a joint, or a base that drifts.
//!
//! The reduction of χ² by a change follows from a Schur complement: the columns of the change are those of the geometry,
//! masked by the rows concerned, and all other parameters may adapt.

use poegp_protocol::cause::Cause;

use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
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
const REFUSED: f64 = 3e-3;

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

/// The columns of the possible changes for one row: base, tool and joints.
struct Effects {
    columns: usize,
}

impl Effects {
    /// Number of columns of base and tool.
    const FRAMES: usize = 12;

    fn entry(geometry: &Geometry, row: usize, column: usize) -> f64 {
        let tool = geometry.samples[row / ROWS].tool;
        match column {
            0..6 => geometry.linear.a[(row, column)],
            6..12 => {
                let first = 6 * geometry.state.layout.joints + 6 * tool;
                geometry.linear.a[(row, first + column - 6)]
            }
            _ => geometry.linear.jacobian[(row, column - Self::FRAMES)],
        }
    }
}

/// Sums over rows from which every hypothesis is computed.
struct Sums {
    /// BᵀB.
    own: Mat<f64>,
    /// BᵀA.
    with_all: Mat<f64>,
    /// Bᵀr.
    right: Mat<f64>,
}

impl Sums {
    fn zero(effects: &Effects, parameters: usize) -> Self {
        Self {
            own: Mat::zeros(effects.columns, effects.columns),
            with_all: Mat::zeros(effects.columns, parameters),
            right: Mat::zeros(effects.columns, 1),
        }
    }

    /// Sums over `rows`, each with a coefficient: B is the row's effects times that coefficient.
    fn over(geometry: &Geometry, effects: &Effects, rows: &[(usize, f64)]) -> Self {
        let parameters = geometry.linear.a.ncols();
        let b = Mat::from_fn(ROWS * rows.len(), effects.columns, |r, c| {
            let (row, coefficient) = rows[r / ROWS];
            let weight = geometry.weights[row].sqrt();
            weight * coefficient * Effects::entry(geometry, ROWS * row + r % ROWS, c)
        });
        let a = Mat::from_fn(ROWS * rows.len(), parameters, |r, j| {
            let row = rows[r / ROWS].0;
            geometry.weights[row].sqrt() * geometry.linear.a[(ROWS * row + r % ROWS, j)]
        });
        let residual = Mat::from_fn(ROWS * rows.len(), 1, |r, _| {
            let row = rows[r / ROWS].0;
            geometry.weights[row].sqrt() * geometry.residuals[row][r % ROWS]
        });
        Self {
            own: product(Transposed(&b), &b),
            with_all: product(Transposed(&b), &a),
            right: product(Transposed(&b), &residual),
        }
    }

    fn add(&mut self, other: &Self) {
        self.own += &other.own;
        self.with_all += &other.with_all;
        self.right += &other.right;
    }

    /// Returns the change of `part` and the resulting drop of χ².
    fn change(&self, geometry: &Geometry, part: Part, rows: f64) -> Option<Change> {
        let columns: Vec<usize> = match part {
            Part::Base => (0..6).collect(),
            Part::Tool => (6..12).collect(),
            Part::Joint(j) => vec![Effects::FRAMES + j],
        };
        let size = columns.len();
        let largest = columns
            .iter()
            .map(|c| self.own[(*c, *c)])
            .fold(0.0, f64::max);
        let with_all = Mat::from_fn(size, self.with_all.ncols(), |i, j| {
            self.with_all[(columns[i], j)]
        });
        let explained = &with_all * &geometry.covariance * with_all.transpose();
        let schur = Mat::from_fn(size, size, |i, j| {
            let ridge = if i == j { 1e-6 * largest + 1e-12 } else { 0.0 };
            self.own[(columns[i], columns[j])] - explained[(i, j)] + ridge
        });
        let followed = &with_all * &geometry.next_step;
        let right = Mat::from_fn(size, 1, |i, _| {
            self.right[(columns[i], 0)] - followed[(i, 0)]
        });
        let x = Factor::new(schur, 1).ok()?.solve(&right);
        // Residuals of a fit to few rows are smaller than the noise.
        let shrunk = geometry.degrees_of_freedom().powi(2);
        let drop = (0..size).map(|i| x[(i, 0)] * right[(i, 0)]).sum::<f64>() / shrunk;
        // The root mean square of the change's effect on a row, computed from BᵀB.
        let mut square = 0.0;
        for i in 0..size {
            for j in 0..size {
                square += x[(i, 0)] * x[(j, 0)] * self.own[(columns[i], columns[j])];
            }
        }
        let displacement = (square.max(0.0) / rows.max(1.0)).sqrt() * geometry.scales.position;
        Some(Change {
            part,
            drop,
            displacement,
        })
    }
}

/// Returns the changes that `rows` alone may have, best first.
pub fn changes(geometry: &Geometry, rows: &[usize]) -> Vec<Change> {
    let effects = Effects {
        columns: Effects::FRAMES + geometry.state.layout.joints,
    };
    let rows: Vec<(usize, f64)> = rows.iter().map(|k| (*k, 1.0)).collect();
    let sums = Sums::over(geometry, &effects, &rows);
    best_first(geometry, &sums, rows.len() as f64)
}

fn best_first(geometry: &Geometry, sums: &Sums, rows: f64) -> Vec<Change> {
    let joints = (0..geometry.state.layout.joints).map(Part::Joint);
    let parts = [Part::Base, Part::Tool].into_iter().chain(joints);
    let mut out: Vec<Change> = parts
        .filter_map(|part| sums.change(geometry, part, rows))
        .collect();
    out.sort_by(|a, b| b.drop.total_cmp(&a.drop));
    out
}

/// For each of `splits`, returns the changes from that row on, best first.
fn steps(geometry: &Geometry, splits: &[usize]) -> Vec<(usize, Vec<Change>)> {
    let effects = Effects {
        columns: Effects::FRAMES + geometry.state.layout.joints,
    };
    let count = geometry.samples.len();
    let mut sums = Sums::zero(&effects, geometry.linear.a.ncols());
    let mut out = Vec::new();
    let mut end = count;
    for split in splits.iter().rev() {
        let rows: Vec<(usize, f64)> = (*split..end).map(|k| (k, 1.0)).collect();
        sums.add(&Sums::over(geometry, &effects, &rows));
        end = *split;
        out.push((*split, best_first(geometry, &sums, (count - split) as f64)));
    }
    out
}

/// Finds consecutive rows that share a change of base or target: something was moved and later moved back.
pub fn episode(data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
    let count = geometry.samples.len();
    let parts = SPLITS.min(count / 4);
    let effects = Effects {
        columns: Effects::FRAMES,
    };
    let bounds: Vec<usize> = (0..=parts).map(|i| i * count / parts.max(1)).collect();
    let sums: Vec<Sums> = bounds
        .windows(2)
        .map(|w| {
            let rows: Vec<(usize, f64)> = (w[0]..w[1]).map(|k| (k, 1.0)).collect();
            Sums::over(geometry, &effects, &rows)
        })
        .collect();
    let mut best: Option<(usize, usize, Change)> = None;
    for first in 0..parts {
        let mut window = Sums::zero(&effects, geometry.linear.a.ncols());
        for last in first..parts {
            window.add(&sums[last]);
            let rows = (bounds[last + 1] - bounds[first]) as f64;
            for part in [Part::Base, Part::Tool] {
                if let Some(change) = window.change(geometry, part, rows)
                    && best.as_ref().is_none_or(|(_, _, b)| change.drop > b.drop)
                {
                    best = Some((bounds[first], bounds[last + 1], change));
                }
            }
        }
    }
    let (first, end, change) = best?;
    let needed = geometry.leniency().powi(2) * (DROP.0 * count as f64 + DROP.1).max(LEAST_DROP);
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
    let needed = geometry.leniency().powi(2) * (DROP.0 * count as f64 + DROP.1).max(LEAST_DROP);
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
    let effects = Effects {
        columns: Effects::FRAMES,
    };
    let rows: Vec<(usize, f64)> = (0..count)
        .map(|k| (k, k as f64 / (count - 1) as f64 - 0.5))
        .collect();
    let sums = Sums::over(geometry, &effects, &rows);
    sums.change(geometry, Part::Base, count as f64)
}
