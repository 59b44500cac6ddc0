//! Finds which of the hypotheses the residuals support, at a stated rate of false alarms.
//!
//! In units of their covariance (y and X multiplied by L⁻¹, V = L Lᵀ), the residuals of an arm that has not changed are
//! independent standard normal numbers. With Q an orthonormal basis of all hypotheses' effects and ν = m − rank, the test is
//!
//! ```text
//! T_h = |Q_hᵀ y|² / (|y − Q Qᵀ y|² / ν)      s_h = T_h / (its own 1 − α quantile)      alarm: max_h s_h > c
//! ```
//!
//! c is the 1 − α quantile of the largest s of all hypotheses together. Both quantiles come from the same random draws, in
//! which nothing has moved. So the test needs no tabulated distribution, which several overlapping tests do not have, and
//! has one rate for all of them. The reported hypothesis is the one with the largest T_h − r_h ln m (Schwarz): six
//! components explain what one does, and a little noise besides. The test is then repeated on what this hypothesis leaves
//! unexplained.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};

use crate::numeric::matrix::Mat;

/// Number of draws of an arm that has not changed: at a rate of 1 %, the critical value is known to 1 % of itself.
const DRAWS: usize = 20_000;
const SEED: u64 = 20_261_120;
/// Share of a column's length that must remain beside other columns for it to count as independent.
const INDEPENDENT: f64 = 1e-6;
/// Effects below this many standard deviations for a whole metre, radian or kilogram are treated as rounding.
const VISIBLE: f64 = 1e-3;
/// Most parts that may have moved at once.
const MOST: usize = 3;

/// Residuals and effects in units of their covariance, within the space of all hypotheses.
pub struct DriftTest {
    /// Qᵀ y: residuals within the space of all hypotheses.
    seen: Vec<f64>,
    /// |y − Q Qᵀ y|²: square of the residuals outside that space.
    rest: f64,
    /// ν: degrees of freedom of `rest`.
    pub freedom: usize,
    /// m: number of rows, without those that are free or absent.
    rows: usize,
    /// Qᵀ X_h of every hypothesis, each column a vector.
    effects: Vec<Columns>,
    /// Number of each hypothesis's part; a part can move only once.
    parts: Vec<usize>,
    draws: Vec<(Vec<f64>, f64)>,
}

/// Columns of a matrix, each a vector.
pub type Columns = Vec<Vec<f64>>;

/// Returns the columns of a matrix.
pub fn columns(x: &Mat<f64>) -> Columns {
    (0..x.ncols())
        .map(|j| (0..x.nrows()).map(|i| x[(i, j)]).collect())
        .collect()
}

/// A hypothesis that the test has chosen.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Index of the hypothesis.
    pub hypothesis: usize,
    /// Share of draws with an alarm as loud as this one, counting at least one draw.
    pub p_value: f64,
}

impl DriftTest {
    /// Creates the test from whitened residuals and effects. `nuisance` is free in any case, and `parts` has the number of
    /// each hypothesis's part.
    ///
    /// `absent` is the number of rows of `y` that are zeros and stand for nothing.
    pub fn new(
        y: &Mat<f64>,
        nuisance: &Columns,
        effects: &[Columns],
        parts: Vec<usize>,
        absent: usize,
    ) -> Self {
        let nuisance = basis(nuisance, &[]);
        let clean = |column: &Vec<f64>| without(column, &nuisance);
        let y = clean(&(0..y.nrows()).map(|i| y[(i, 0)]).collect());
        let effects: Vec<Columns> = effects
            .iter()
            .map(|columns| columns.iter().map(clean).collect())
            .collect();
        let all = basis(&effects.concat(), &[]);
        let inside = |column: &Vec<f64>| all.iter().map(|q| inner(q, column)).collect();
        let seen: Vec<f64> = inside(&y);
        let rest = (inner(&y, &y) - inner(&seen, &seen)).max(0.0);
        let rows = y.len() - nuisance.len() - absent;
        let freedom = rows.saturating_sub(all.len());
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        let chi_squared = ChiSquared::new(freedom.max(1) as f64).expect("a positive number");
        let draws = (0..DRAWS).map(|_| {
            let seen = all.iter().map(|_| StandardNormal.sample(&mut random));
            (seen.collect(), chi_squared.sample(&mut random))
        });
        Self {
            draws: draws.collect(),
            effects: effects
                .iter()
                .map(|columns| columns.iter().map(inside).collect())
                .collect(),
            seen,
            rest,
            freedom,
            rows,
            parts,
        }
    }

    /// Returns the variance of the residuals outside the space of all hypotheses; 1 when the covariance is true.
    pub fn variance(&self) -> f64 {
        self.rest / self.freedom.max(1) as f64
    }

    /// Returns the significant ones among the hypotheses that `is_allowed`, at most `MOST`, in the order in which they were
    /// found.
    pub fn choose(&self, false_alarms: f64, is_allowed: impl Fn(usize) -> bool) -> Vec<Choice> {
        let mut chosen: Vec<Choice> = Vec::new();
        while chosen.len() < MOST {
            let taken: Vec<usize> = chosen.iter().map(|c| c.hypothesis).collect();
            let Some(next) = self.next(&taken, false_alarms, &is_allowed) else {
                break;
            };
            chosen.push(next);
        }
        chosen
    }

    /// Returns the best allowed hypothesis beside those that were taken, if it is significant.
    fn next(
        &self,
        taken: &[usize],
        false_alarms: f64,
        is_allowed: &impl Fn(usize) -> bool,
    ) -> Option<Choice> {
        let known = self.columns(taken);
        let candidates: Vec<(usize, Columns)> = (0..self.effects.len())
            .filter(|h| is_allowed(*h))
            .filter(|h| taken.iter().all(|t| self.parts[*t] != self.parts[*h]))
            .map(|h| (h, self.beside(h, &known)))
            .filter(|(_, q)| !q.is_empty())
            .collect();
        let own: Vec<f64> = candidates
            .iter()
            .map(|(_, q)| self.quantile(q, false_alarms))
            .collect();
        let loudest = |seen: &[f64], variance: f64| {
            let of = |((_, q), own): (&(usize, Columns), &f64)| projected(q, seen) / variance / own;
            candidates.iter().zip(&own).map(of).fold(0.0, f64::max)
        };
        let found = loudest(&self.seen, self.variance());
        let freedom = self.freedom.max(1) as f64;
        let louder = self
            .draws
            .iter()
            .filter(|(seen, rest)| loudest(seen, rest / freedom) >= found)
            .count();
        let p_value = (louder + 1) as f64 / (DRAWS + 1) as f64;
        if p_value > false_alarms {
            return None;
        }
        let score = |q: &Columns| {
            projected(q, &self.seen) / self.variance()
                - q.len() as f64 * libm::log(self.rows as f64)
        };
        // Among hypotheses that explain as much, the first is taken: it has the fewest components.
        let best = candidates
            .iter()
            .rev()
            .max_by(|a, b| score(&a.1).total_cmp(&score(&b.1)))?;
        Some(Choice {
            hypothesis: best.0,
            p_value,
        })
    }

    /// Returns whether the hypotheses `taken` leave nothing that `other` would explain, at its own rate of false alarms.
    pub fn explain(&self, taken: &[usize], other: usize, false_alarms: f64) -> bool {
        let q = self.beside(other, &self.columns(taken));
        q.is_empty()
            || projected(&q, &self.seen) / self.variance() <= self.quantile(&q, false_alarms)
    }

    /// Returns the effect of a hypothesis, one unit of each component, in units of noise; and the part of this effect that
    /// `hidden_by` cannot produce.
    pub fn visible(&self, hypothesis: usize, hidden_by: usize) -> (f64, f64) {
        let other = basis(&self.effects[hidden_by], &[]);
        let norms = self.effects[hypothesis].iter().map(|column| {
            let left = without(column, &other);
            (inner(column, column), inner(&left, &left))
        });
        let (effect, own) = norms.fold((0.0, 0.0), |sum, n| (sum.0 + n.0, sum.1 + n.1));
        (effect.sqrt(), own.sqrt())
    }

    /// Returns the smallest change in the hypothesis's worst direction that the test finds nine times in ten, in units of
    /// its components (metres, radians or kilograms). `critical` is the value of [`DriftTest::critical`]. `None` if a
    /// direction has no effect beside what is free in any case.
    pub fn smallest(&self, hypothesis: usize, false_alarms: f64, critical: f64) -> Option<f64> {
        let q = self.beside(hypothesis, &Vec::new());
        if q.len() < self.effects[hypothesis].len() {
            return None;
        }
        let critical = critical * self.quantile(&q, false_alarms);
        let freedom = self.freedom.max(1) as f64;
        let found = |shift: f64| {
            let alarms = self.draws.iter().take(DRAWS / 10).filter(|(seen, rest)| {
                let mut along: Vec<f64> = q.iter().map(|q| inner(q, seen)).collect();
                if let Some(first) = along.first_mut() {
                    *first += shift;
                }
                inner(&along, &along) / (rest / freedom) > critical
            });
            alarms.count() as f64 / (DRAWS / 10) as f64
        };
        let (mut low, mut high) = (0.0, 100.0);
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            if found(middle) < 0.9 {
                low = middle;
            } else {
                high = middle;
            }
        }
        let columns = &self.effects[hypothesis];
        let gram = Mat::from_fn(columns.len(), columns.len(), |i, j| {
            inner(&columns[i], &columns[j])
        });
        let weakest = gram.symmetric_eigenvalues().min();
        Some(high / weakest.max(0.0).sqrt())
    }

    /// Returns the critical value c before any hypothesis is taken.
    pub fn critical(&self, false_alarms: f64) -> f64 {
        let spaces: Vec<Columns> = (0..self.effects.len())
            .map(|h| self.beside(h, &Vec::new()))
            .collect();
        let own: Vec<f64> = spaces
            .iter()
            .map(|q| self.quantile(q, false_alarms))
            .collect();
        let freedom = self.freedom.max(1) as f64;
        let loudest = self.draws.iter().map(|(seen, rest)| {
            let of = |(q, own): (&Columns, &f64)| projected(q, seen) / (rest / freedom) / own;
            spaces.iter().zip(&own).map(of).fold(0.0, f64::max)
        });
        quantile(loudest.collect(), 1.0 - false_alarms)
    }

    /// Returns the 1 − α quantile of T for one hypothesis alone.
    fn quantile(&self, q: &Columns, false_alarms: f64) -> f64 {
        let freedom = self.freedom.max(1) as f64;
        let of = |(seen, rest): &(Vec<f64>, f64)| projected(q, seen) / (rest / freedom);
        quantile(self.draws.iter().map(of).collect(), 1.0 - false_alarms)
    }

    /// Returns half the width of a 95 % interval of one estimated number, in its standard deviations.
    pub fn reach(&self) -> f64 {
        let freedom = self.freedom.max(1) as f64;
        let of = |(seen, rest): &(Vec<f64>, f64)| {
            seen.first()
                .map_or(0.0, |z| z.abs() / (rest / freedom).sqrt())
        };
        quantile(self.draws.iter().map(of).collect(), 0.95)
    }

    fn columns(&self, taken: &[usize]) -> Columns {
        let known: Vec<Columns> = taken.iter().map(|h| self.effects[*h].clone()).collect();
        basis(&known.concat(), &[])
    }

    /// Returns an orthonormal basis of the effects of a hypothesis beside `known`.
    fn beside(&self, hypothesis: usize, known: &Columns) -> Columns {
        basis(&self.effects[hypothesis], known)
    }
}

/// Returns the inner product.
pub fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Returns |Qᵀ y|².
fn projected(q: &Columns, seen: &[f64]) -> f64 {
    q.iter().map(|column| inner(column, seen).powi(2)).sum()
}

/// Returns a column without its components along an orthonormal basis.
pub fn without(column: &[f64], basis: &[Vec<f64>]) -> Vec<f64> {
    let mut out = column.to_vec();
    // Two passes of orthogonalisation are enough (Kahan).
    for _ in 0..2 {
        for q in basis {
            let along = inner(q, &out);
            for (value, part) in out.iter_mut().zip(q) {
                *value -= along * part;
            }
        }
    }
    out
}

/// Returns an orthonormal basis of the columns beside an orthonormal `known`.
pub fn basis(columns: &[Vec<f64>], known: &[Vec<f64>]) -> Columns {
    let mut all = known.to_vec();
    for column in columns {
        let mut left = without(column, &all);
        let length = inner(&left, &left).sqrt();
        let norm = inner(column, column).sqrt();
        if norm > VISIBLE && length > INDEPENDENT * norm {
            left.iter_mut().for_each(|x| *x /= length);
            all.push(left);
        }
    }
    all.split_off(known.len())
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    let at = ((values.len() as f64 * share) as usize).min(values.len() - 1);
    let (_, value, _) = values.select_nth_unstable_by(at, f64::total_cmp);
    *value
}
