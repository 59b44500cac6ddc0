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
//! unexplained; if something is left, the best two hypotheses take its place, then the best three. One that is not
//! significant beside the others is dropped: the best alone may follow two others and explain nothing beside them.
//!
//! Two parts that look almost alike, as the base and the vertical joint of a SCARA do, could explain anything by large
//! changes that cancel. What other parts that were taken before produce almost whole is therefore left out of a part's
//! effects.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};

use crate::numeric::matrix::Mat;
use crate::numeric::statistics::quantile;
use crate::numeric::vectors::dot;
use crate::verification::columns::{Columns, DRAWS, Draw, Own, basis, without};
use crate::verification::unchanged::Unchanged;

const SEED: u64 = 20_261_120;
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
    draws: Vec<Draw>,
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
        Self::with_unchanged((y, None), nuisance, effects, parts, absent)
            .expect("nothing to be factored")
    }

    /// Same as [`DriftTest::new`]; the residuals of an arm that has not changed have one of the covariances in `unchanged`.
    /// Returns `None` if one of these cannot be factored.
    pub fn with_unchanged(
        (y, unchanged): (&Mat<f64>, Option<&Unchanged>),
        nuisance: &Columns,
        effects: &[Columns],
        parts: Vec<usize>,
        absent: usize,
    ) -> Option<Self> {
        let nuisance = basis(nuisance, &[]);
        let clean = |column: &Vec<f64>| without(column, &nuisance);
        let y = clean(&(0..y.nrows()).map(|i| y[(i, 0)]).collect());
        let effects: Vec<Columns> = effects
            .iter()
            .map(|columns| columns.iter().map(clean).collect())
            .collect();
        let all = basis(&effects.concat(), &[]);
        let inside = |column: &Vec<f64>| all.iter().map(|q| dot(q, column)).collect();
        let seen: Vec<f64> = inside(&y);
        let rest = (dot(&y, &y) - dot(&seen, &seen)).max(0.0);
        let rows = y.len() - nuisance.len() - absent;
        let freedom = rows.saturating_sub(all.len());
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        let draws = match unchanged {
            Some(unchanged) => unchanged.draws((&nuisance, &all), rows, &mut random)?,
            None => {
                let chi_squared = ChiSquared::new(freedom.max(1) as f64).ok()?;
                let draw = |_| {
                    let seen = all.iter().map(|_| StandardNormal.sample(&mut random));
                    (seen.collect(), chi_squared.sample(&mut random))
                };
                (0..DRAWS).map(draw).collect()
            }
        };
        Some(Self {
            draws,
            effects: effects
                .iter()
                .map(|columns| columns.iter().map(inside).collect())
                .collect(),
            seen,
            rest,
            freedom,
            rows,
            parts,
        })
    }

    /// Returns the variance of the residuals outside the space of all hypotheses; 1 when the covariance is true.
    pub fn variance(&self) -> f64 {
        self.rest / self.freedom.max(1) as f64
    }

    /// Returns the significant ones among the hypotheses that `is_allowed`, at most `MOST`: the fewest that leave nothing which
    /// one of the others would explain, and of as many the best.
    pub fn choose(&self, false_alarms: f64, is_allowed: impl Fn(usize) -> bool) -> Vec<Choice> {
        let allowed: Vec<usize> = (0..self.effects.len()).filter(|h| is_allowed(*h)).collect();
        let Some(first) = self.next(&[], false_alarms, &allowed) else {
            return Vec::new();
        };
        let mut taken = vec![first.hypothesis];
        while taken.len() < MOST
            && let Some(next) = self.next(&taken, false_alarms, &allowed)
        {
            taken.push(next.hypothesis);
            // What is best alone may explain nothing beside two others.
            taken = self.best_of(taken.len(), &allowed).unwrap_or(taken);
        }
        let chosen = self.pruned(&taken, false_alarms, &allowed);
        match chosen.len() {
            0 | 1 => vec![first],
            _ => chosen,
        }
    }

    /// Returns these hypotheses, each with its p-value beside the others; those that are not significant there are dropped one
    /// after the other.
    fn pruned(&self, taken: &[usize], false_alarms: f64, allowed: &[usize]) -> Vec<Choice> {
        let beside_others = |h: &usize| Choice {
            hypothesis: *h,
            p_value: self.p_value_beside(*h, taken, false_alarms, allowed),
        };
        let chosen: Vec<Choice> = match taken.len() {
            0 | 1 => return Vec::new(),
            _ => taken.iter().map(beside_others).collect(),
        };
        let weakest = (chosen.iter()).max_by(|a, b| a.p_value.total_cmp(&b.p_value));
        match weakest.filter(|c| c.p_value > false_alarms) {
            None => chosen,
            Some(weakest) => {
                let stays = |h: &&usize| **h != weakest.hypothesis;
                let rest: Vec<usize> = taken.iter().filter(stays).copied().collect();
                self.pruned(&rest, false_alarms, allowed)
            }
        }
    }

    /// Returns the share of draws with an alarm beside the other hypotheses of `taken` that is as loud as this one's.
    fn p_value_beside(
        &self,
        hypothesis: usize,
        taken: &[usize],
        false_alarms: f64,
        allowed: &[usize],
    ) -> f64 {
        let others: Vec<usize> = taken
            .iter()
            .filter(|t| **t != hypothesis)
            .copied()
            .collect();
        let beside = Candidates::new(self, &others, false_alarms, allowed);
        // A shift and a shift with a turn are of one part.
        let own = |h: usize| self.parts[h] == self.parts[hypothesis];
        let found = beside.loudest(&self.seen, self.variance(), own);
        self.p_value(&beside, found)
    }

    /// Returns the share of draws with an alarm as loud as `found`, counting at least one draw.
    fn p_value(&self, candidates: &Candidates, found: f64) -> f64 {
        let freedom = self.freedom.max(1) as f64;
        let is_louder =
            |(seen, rest): &&Draw| candidates.loudest(seen, rest / freedom, |_| true) >= found;
        let louder = self.draws.iter().filter(is_louder).count();
        (louder + 1) as f64 / (DRAWS + 1) as f64
    }

    /// Returns the best allowed hypothesis beside those that were taken, if it is significant.
    fn next(&self, taken: &[usize], false_alarms: f64, allowed: &[usize]) -> Option<Choice> {
        let candidates = Candidates::new(self, taken, false_alarms, allowed);
        let found = candidates.loudest(&self.seen, self.variance(), |_| true);
        let p_value = self.p_value(&candidates, found);
        if p_value > false_alarms {
            return None;
        }
        // Among hypotheses that explain as much, the first is taken: it has the fewest components.
        let best = (candidates.all.iter().rev())
            .max_by(|a, b| self.score(&a.beside).total_cmp(&self.score(&b.beside)))?;
        Some(Choice {
            hypothesis: best.hypothesis,
            p_value,
        })
    }

    /// Returns the drop of χ² less its price (Schwarz) of an orthonormal basis.
    fn score(&self, q: &Columns) -> f64 {
        projected(q, &self.seen) / self.variance() - q.len() as f64 * libm::log(self.rows as f64)
    }

    /// Returns the allowed hypotheses of so many parts that explain most together, less the price of their components.
    fn best_of(&self, parts: usize, allowed: &[usize]) -> Option<Vec<usize>> {
        let mut best = None;
        self.extend(parts, allowed, (&[], &Vec::new(), 0.0), &mut best);
        best.map(|(_, taken)| taken)
    }

    /// Extends `taken`, whose effects have an orthonormal basis and a score, by hypotheses of so many further parts.
    fn extend(
        &self,
        parts: usize,
        allowed: &[usize],
        (taken, basis, score): (&[usize], &Columns, f64),
        best: &mut Option<(f64, Vec<usize>)>,
    ) {
        if parts == 0 {
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                *best = Some((score, taken.to_vec()));
            }
            return;
        }
        for (i, h) in allowed.iter().enumerate() {
            let own = self.own(*h, basis);
            if own.is_empty() || taken.iter().any(|t| self.parts[*t] == self.parts[*h]) {
                continue;
            }
            let score = score + self.score(&own);
            let basis = [basis.clone(), own].concat();
            let taken = [taken, &[*h]].concat();
            self.extend(parts - 1, &allowed[i + 1..], (&taken, &basis, score), best);
        }
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
            (dot(column, column), dot(&left, &left))
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
                let mut along: Vec<f64> = q.iter().map(|q| dot(q, seen)).collect();
                if let Some(first) = along.first_mut() {
                    *first += shift;
                }
                dot(&along, &along) / (rest / freedom) > critical
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
            dot(&columns[i], &columns[j])
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

    /// Same as [`DriftTest::beside`], without what `known` produces almost whole.
    fn own(&self, hypothesis: usize, known: &Columns) -> Columns {
        Own::new(&self.effects[hypothesis], known).basis
    }
}

/// Hypotheses that may be chosen beside others.
struct Candidates {
    all: Vec<Candidate>,
}

struct Candidate {
    hypothesis: usize,
    /// Orthonormal basis of its effects beside those of the others.
    beside: Columns,
    /// 1 − α quantile of its T.
    quantile: f64,
}

impl Candidates {
    /// Collects the allowed hypotheses of parts that have not been taken and that explain something which these do not.
    fn new(test: &DriftTest, taken: &[usize], false_alarms: f64, allowed: &[usize]) -> Self {
        let known = test.columns(taken);
        let is_free = |h: &&usize| taken.iter().all(|t| test.parts[*t] != test.parts[**h]);
        let of = |h: &usize| {
            let beside = test.own(*h, &known);
            (!beside.is_empty()).then(|| Candidate {
                hypothesis: *h,
                quantile: test.quantile(&beside, false_alarms),
                beside,
            })
        };
        Self {
            all: allowed.iter().filter(is_free).filter_map(of).collect(),
        }
    }

    /// Returns the largest ratio of T to its quantile among some of the hypotheses.
    fn loudest(&self, seen: &[f64], variance: f64, is_counted: impl Fn(usize) -> bool) -> f64 {
        let counted = self.all.iter().filter(|c| is_counted(c.hypothesis));
        counted
            .map(|c| projected(&c.beside, seen) / variance / c.quantile)
            .fold(0.0, f64::max)
    }
}

/// Returns |Qᵀ y|².
fn projected(q: &Columns, seen: &[f64]) -> f64 {
    q.iter().map(|column| dot(column, seen).powi(2)).sum()
}
