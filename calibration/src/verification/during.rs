//! Finds what moved while the rows of a check were measured: a step from one row on, or a creep from the first row to the last.
//!
//! Such a change is no change since the calibration: a moved base that is fitted to all rows would be the average of two. It is
//! therefore searched for first, beside changes of all parts that concern every row, and is then free in the test for those.
//!
//! A step enlarges the noise that is found from the residuals, and so hides itself. The noise is therefore found again with
//! the best step taken out. In these units χ² must drop by more than `trust` asks for in the rows of a calibration. The best of
//! some hundred changes of noise alone stays below half of this, so the rate of false alarms of the check is unchanged.

use crate::blob::fitted_frames::Registered;
use crate::identification::parametric::state::ROWS;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::matrix::Mat;
use crate::numeric::vectors::dot;
use crate::trust::{AS_GOOD, BLIND, SPLITS, drop_among};
use crate::verification::arm::BlobArm;
use crate::verification::columns::{Columns, basis, columns, without};
use crate::verification::hypotheses::{Masked, Part};
use crate::verification::result::{CheckError, Moved};
use crate::verification::whitened::Whitened;

/// Fewest rows before and after a step.
const LEAST: usize = 4;
/// Fewest degrees of freedom beside all changes: with fewer, the noise is too uncertain.
const FEWEST_FREEDOM: usize = 24;
/// Largest number of times that the noise is found again.
const ROUNDS: usize = 3;

/// A change that was found.
#[derive(Clone, Debug)]
pub(super) struct Change {
    pub(super) change: Masked,
    pub(super) part: Part,
    /// Indices of the rows concerned, in chronological order.
    pub(super) rows: Vec<usize>,
    /// Other parts that would explain the rows as well.
    pub(super) or_else: Vec<Part>,
    /// Drop of χ² that the change causes.
    pub(super) drop: f64,
    /// χ² beside all changes that concern every row.
    all: f64,
}

impl Change {
    pub(super) fn is_step(&self) -> bool {
        self.change.from.is_some()
    }

    /// Returns the root mean square displacement of the target by the whole change, in mm; `effect` is that on the rows, and
    /// `unit` the length of a unit of each sample's row in mm.
    pub(super) fn moves_mm(&self, effect: &Mat<f64>, unit: impl Fn(usize) -> f64) -> f64 {
        let square = |k: &usize| {
            let whole = |i: usize| unit(*k) * effect[(ROWS * k + i, 0)] / self.change.shares[*k];
            (0..3).map(|i| whole(i).powi(2)).sum::<f64>()
        };
        let concerned: Vec<usize> = (0..self.change.shares.len())
            .filter(|k| self.change.shares[*k] > 0.0)
            .collect();
        (concerned.iter().map(square).sum::<f64>() / concerned.len().max(1) as f64).sqrt()
    }

    /// Returns what a report says of the change; `lines` are those of all rows, `effect` and `unit` as for
    /// [`moves_mm`](Self::moves_mm).
    pub(super) fn moved(
        self,
        effect: &Mat<f64>,
        lines: &[usize],
        unit: impl Fn(usize) -> f64,
    ) -> Moved {
        let count = lines.len();
        Moved {
            part: self.part,
            from_line: self.is_step().then(|| lines[self.rows[0]]),
            moves_mm: self.moves_mm(effect, unit),
            lines: self.rows.iter().map(|k| lines[*k]).collect(),
            drop: (self.drop / count as f64, drop_among(count) / count as f64),
            or_else: self.or_else,
        }
    }
}

/// Finds what moved while the rows were measured; the residuals are then weighed by the noise that this leaves.
///
/// # Errors
/// [`CheckError::Unsolvable`].
pub(super) fn examine<'a>(
    placed: &'a Registered<'_>,
    arm: &BlobArm,
    weighed: Whitened<'a>,
) -> Result<(Whitened<'a>, Option<Change>), CheckError> {
    let Some(order) = chronological(placed.samples) else {
        return Ok((weighed, None));
    };
    let needed = drop_among(order.len());
    let Some(mut found) = best(&weighed, &order) else {
        return Ok((weighed, None));
    };
    if found.drop <= needed && found.drop <= BLIND * found.all {
        return Ok((weighed, None));
    }
    for _ in 0..ROUNDS {
        let beside = Whitened::new(placed, arm, Some(&found.change))?;
        let Some(next) = best(&beside, &order) else {
            return Ok((weighed, None));
        };
        let has_settled = next.change == found.change;
        found = next;
        if has_settled {
            return Ok(match found.drop > needed {
                true => (beside, Some(found)),
                false => (weighed, None),
            });
        }
    }
    Ok((weighed, None))
}

/// Returns the indices of the rows in the order in which they were measured; `None` if the file does not show it.
fn chronological(samples: &[InstrumentSample]) -> Option<Vec<usize>> {
    let times: Option<Vec<f64>> = (samples.iter())
        .map(|s| s.elapsed.as_ref().map(|elapsed| elapsed.value))
        .collect();
    let times = times?;
    let mut order: Vec<usize> = (0..samples.len()).collect();
    // Each session counts its own time.
    if samples.iter().all(|s| s.tool == samples[0].tool) {
        order.sort_by(|a, b| times[*a].total_cmp(&times[*b]));
    }
    Some(order)
}

/// Returns the change along the rows that explains most beside changes of all parts that concern every row.
fn best(weighed: &Whitened<'_>, order: &[usize]) -> Option<Change> {
    let count = order.len();
    let whole: Columns = (weighed.all.iter())
        .flat_map(|h| columns(&weighed.whiten(&h.effect)))
        .collect();
    let known = basis(&whole, &[]);
    let y = without(&columns(&weighed.whiten(&weighed.y))[0], &known);
    let freedom = (y.len() - weighed.absent).saturating_sub(known.len() + ROWS);
    if count < 2 * LEAST || freedom < FEWEST_FREEDOM {
        return None;
    }
    let rows = (y.len() - weighed.absent) as f64;
    let shares = |from: Option<usize>| {
        let mut out = vec![0.0; count];
        for (i, k) in order.iter().enumerate() {
            out[*k] = match from {
                Some(from) => f64::from(u8::from(i >= from)),
                None => i as f64 / (count - 1) as f64,
            };
        }
        out
    };
    // Everything that may have moved by these shares: the drop of χ², less the price of its components, and the change.
    let changes = |from: Option<usize>| -> Vec<(f64, f64, Masked)> {
        let parts = (0..weighed.all.len()).filter(|h| weighed.all[*h].part != Part::Payload);
        let shares = shares(from);
        let of = |hypothesis: usize| {
            let change = Masked {
                hypothesis,
                from,
                shares: shares.clone(),
            };
            let effect = columns(&weighed.whiten(&change.effect(&weighed.all)));
            let q = basis(&effect, &known);
            let drop: f64 = q.iter().map(|q| dot(q, &y).powi(2)).sum();
            (drop - q.len() as f64 * libm::log(rows), drop, change)
        };
        parts.map(of).collect()
    };
    let better = |a: &Vec<(f64, f64, Masked)>, b: &Vec<(f64, f64, Masked)>| {
        let most = |all: &[(f64, f64, Masked)]| all.iter().map(|c| c.0).fold(f64::MIN, f64::max);
        most(a).total_cmp(&most(b))
    };
    let split = |from: &usize| (LEAST..=count - LEAST).contains(from);
    let mut coarse: Vec<usize> = (1..=SPLITS).map(|i| i * count / (SPLITS + 1)).collect();
    coarse.retain(split);
    coarse.dedup();
    let first = coarse.into_iter().map(Some).map(changes).max_by(better)?;
    let middle = first.first()?.2.from?;
    let near = count.div_ceil(SPLITS + 1);
    let fine = (middle.saturating_sub(near)..=middle + near).filter(split);
    let all = fine.map(Some).chain([None]).map(changes).max_by(better)?;
    let best = (all.iter().rev()).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let part = weighed.all[best.2.hypothesis].part;
    let mut or_else: Vec<Part> = Vec::new();
    for (_, drop, other) in &all {
        let other = weighed.all[other.hypothesis].part;
        if other != part && *drop > AS_GOOD * best.1 && !or_else.contains(&other) {
            or_else.push(other);
        }
    }
    Some(Change {
        rows: order[best.2.from.unwrap_or(0)..].to_vec(),
        change: best.2.clone(),
        part,
        or_else,
        drop: best.1,
        all: dot(&y, &y),
    })
}
