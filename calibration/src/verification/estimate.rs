//! Estimates how much has moved, how certain that is, and which other parts might have moved instead.

use crate::identification::parametric::state::ROWS;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::Summary;
use crate::verification::columns::{Columns, OWN_SHARE, Own, basis, columns, length_of, without};
use crate::verification::drift_test::{Choice, DriftTest};
use crate::verification::hypotheses::{Hypothesis, Part};
use crate::verification::result::{Change, Estimate, Sensitivity};

/// Estimates of one hypothesis: its values and their covariance.
pub type ChangeEstimate = (Vec<f64>, Mat<f64>);

/// Generalised least-squares fit of everything that has moved together with what is free.
pub struct Fit {
    x: Mat<f64>,
    values: Vec<f64>,
    covariance: Mat<f64>,
    /// What is left of each hypothesis beside those before it.
    projectors: Vec<Option<Mat<f64>>>,
    /// Index of the first column of each hypothesis; the columns before the first are those of what is free.
    starts: Vec<usize>,
}

impl Fit {
    /// Fits `y` with the factored covariance `factor`; returns `None` if the equations cannot be solved. An
    /// effect that two hypotheses share almost whole counts as the first one's.
    pub fn new(
        (y, factor): (&Mat<f64>, &Factor),
        nuisance: &Mat<f64>,
        chosen: &[&Hypothesis],
    ) -> Option<Self> {
        let mut starts = vec![nuisance.ncols()];
        let mut free: Columns = columns(nuisance);
        let whitened = |x: &Mat<f64>| columns(&factor.half_solve(x));
        let absorbed = basis(&whitened(nuisance), &[]);
        let (mut known, mut projectors) = (Columns::new(), Vec::new());
        for hypothesis in chosen {
            let effects = whitened(&hypothesis.effect);
            let own = Own::new(
                &effects.iter().map(|x| without(x, &absorbed)).collect(),
                &known,
            );
            free.extend(match &own.projector {
                None => columns(&hypothesis.effect),
                Some(projector) => columns(&product(&hypothesis.effect, projector)),
            });
            projectors.push(own.projector);
            known.extend(own.basis);
            starts.push(free.len());
        }
        let x = Mat::from_fn(y.nrows(), free.len(), |i, j| free[j][i]);
        if free.is_empty() {
            return Some(Self {
                covariance: Mat::zeros(0, 0),
                values: Vec::new(),
                projectors,
                starts,
                x,
            });
        }
        let (white, y) = (factor.half_solve(&x), factor.half_solve(y));
        let mut normal = product(Transposed(&white), &white);
        for i in 0..normal.nrows() {
            // The ridge determines directions of the tool that positions alone do not identify.
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-12) + 1e-6;
        }
        let factor = Factor::new(normal, 1).ok()?;
        let values = factor.solve(&product(Transposed(&white), &y));
        Some(Self {
            covariance: factor.inverse(),
            values: (0..free.len()).map(|i| values[(i, 0)]).collect(),
            projectors,
            starts,
            x,
        })
    }

    /// Returns the estimate of the hypothesis at this index among the chosen ones.
    pub fn of(&self, index: usize) -> ChangeEstimate {
        let (from, to) = (self.starts[index], self.starts[index + 1]);
        let covariance = self.covariance.view((from, from), (to - from, to - from));
        let values = Mat::from_column_slice(to - from, 1, &self.values[from..to]);
        let (values, covariance) = match &self.projectors[index] {
            None => (values, covariance.into_owned()),
            Some(p) => (
                product(p, &values),
                product(&product(p, &covariance.into_owned()), Transposed(p)),
            ),
        };
        (values.column(0).iter().copied().collect(), covariance)
    }

    /// Returns the number of fitted values.
    pub fn count(&self) -> usize {
        self.values.len()
    }

    /// Returns the fitted effect of what has moved, in rows of the check.
    pub fn effect(&self) -> Mat<f64> {
        self.rows(self.starts[0], self.values.len())
    }

    /// Returns the fitted effect of what is free, in rows of the check.
    pub fn free(&self) -> Mat<f64> {
        self.rows(0, self.starts[0])
    }

    /// Returns the fitted effect of the last `count` columns of what is free, in rows of the check.
    pub fn last_free(&self, count: usize) -> Mat<f64> {
        self.rows(self.starts[0] - count, self.starts[0])
    }

    fn rows(&self, from: usize, to: usize) -> Mat<f64> {
        Mat::from_fn(self.x.nrows(), 1, |i, _| {
            (from..to).map(|j| self.x[(i, j)] * self.values[j]).sum()
        })
    }
}

/// Largest change for which the equations of a check are linear, m and rad.
pub const LINEAR: f64 = 0.1;
/// Largest relative difference of an arm's size from its model's that a check is asked to find.
const LARGEST_SIZE: f64 = 5e-3;
/// Heaviest payload, kg.
const HEAVIEST_KG: f64 = 1000.0;

/// Returns an estimated change in display units; `reach` is half the width of a 95 % interval in standard deviations.
fn change(
    hypothesis: &Hypothesis,
    (values, covariance): ChangeEstimate,
    reach: f64,
    p_value: f64,
) -> Change {
    let one = |i: usize, unit: f64, range: f64| {
        let plus_minus = reach * covariance[(i, i)].max(0.0).sqrt();
        Estimate::within(unit * range, unit * values[i], unit * plus_minus)
    };
    // Length of three components; its standard deviation is the one along their direction.
    let length = |from: usize| {
        let part = &values[from..from + 3];
        let norm = part.iter().map(|x| x * x).sum::<f64>().sqrt();
        let along = |i: usize| part[i] / norm.max(f64::MIN_POSITIVE);
        let pairs = (0..3).flat_map(|i| (0..3).map(move |j| (i, j)));
        let variance: f64 = pairs
            .map(|(i, j)| along(i) * covariance[(from + i, from + j)] * along(j))
            .sum();
        let is_determined = (from..from + 3).all(|i| one(i, 1e3, LINEAR).is_some());
        Estimate::within(
            1e3 * LINEAR,
            1e3 * norm,
            1e3 * reach * variance.max(0.0).sqrt(),
        )
        .filter(|_| is_determined)
    };
    let mut out = Change::of(hypothesis.part, p_value);
    match hypothesis.part {
        Part::Base | Part::Tool => {
            out.shift_mm = length(0);
            out.shift_xyz_mm = (0..3).map(|i| one(i, 1e3, LINEAR)).collect();
            if hypothesis.turns {
                out.turn_mrad = length(3);
                out.turn_xyz_mrad = (3..6).map(|i| one(i, 1e3, LINEAR)).collect();
            }
        }
        Part::Joint(_) if hypothesis.turns => {
            out.offset_deg = one(0, 1_f64.to_degrees(), LINEAR);
        }
        Part::Joint(_) => out.offset_mm = one(0, 1e3, LINEAR),
        Part::Payload => out.mass_kg = one(0, 1.0, HEAVIEST_KG),
        Part::Size => out.size_ppm = one(0, 1e6, LINEAR),
    }
    out
}

/// Returns the parts that would explain the measurements as well in place of the chosen hypothesis at `index`.
fn alternatives(
    test: &DriftTest,
    all: &[Hypothesis],
    taken: &[usize],
    index: usize,
    false_alarms: f64,
) -> Vec<Part> {
    let mut out: Vec<Part> = Vec::new();
    let own = all[taken[index]].part;
    for (other, hypothesis) in all.iter().enumerate() {
        let part = hypothesis.part;
        if taken.iter().any(|t| all[*t].part == part) || out.contains(&part) {
            continue;
        }
        let mut instead = taken.to_vec();
        instead[index] = other;
        let nothing_left = |h: usize| test.explain(&instead, h, false_alarms);
        if (0..all.len())
            .filter(|h| all[*h].part == own)
            .all(nothing_left)
        {
            out.push(part);
        }
    }
    out
}

/// Returns, for each part, the smallest change that the check can find and which other part looks the same.
pub fn sensitivity(test: &DriftTest, all: &[Hypothesis], false_alarms: f64) -> Vec<Sensitivity> {
    let critical = test.critical(false_alarms);
    let whole: Vec<usize> = (0..all.len())
        .filter(|h| matches!(all[*h].part, Part::Base | Part::Tool) && all[*h].turns)
        .collect();
    let mut out: Vec<Sensitivity> = Vec::new();
    for (h, hypothesis) in all.iter().enumerate() {
        if out.iter().any(|s| s.part == hypothesis.part) {
            continue;
        }
        let (factor, unit, range) = match hypothesis.part {
            Part::Joint(_) if hypothesis.turns => (1_f64.to_degrees(), "deg", LINEAR),
            Part::Payload => (1.0, "kg", HEAVIEST_KG),
            Part::Size => (1e6, "ppm", LARGEST_SIZE),
            _ => (1e3, "mm", LINEAR),
        };
        let smallest = test.smallest(h, false_alarms, critical);
        let hidden = |other: &&usize| {
            let (effect, own) = test.visible(h, **other);
            all[**other].part != hypothesis.part && own < OWN_SHARE * effect
        };
        out.push(Sensitivity {
            part: hypothesis.part,
            smallest: smallest.filter(|x| *x <= range).map(|x| factor * x),
            unit,
            moves_mm: None,
            looks_like: whole.iter().find(hidden).map(|other| all[*other].part),
        });
    }
    out
}

/// Returns whether a check may report a change of `hypothesis`. It may not where it shows no change of a joint, the payload or
/// the arm's size, however large: what little these rows see of it would be multiplied by any number. Base and tool may be
/// seen in some of their directions.
pub fn can_be_found(hypothesis: &Hypothesis, sensitivity: &[Sensitivity]) -> bool {
    let is_shown = |s: &Sensitivity| s.part == hypothesis.part && s.smallest.is_some();
    match hypothesis.part {
        Part::Joint(_) | Part::Payload | Part::Size => sensitivity.iter().any(is_shown),
        Part::Base | Part::Tool => true,
    }
}

/// Describes the changes that a check has found: the hypotheses that `test` chose, as `fit` estimates them.
pub fn changes(
    test: &DriftTest,
    all: &[Hypothesis],
    choices: &[Choice],
    fit: &Fit,
    false_alarms: f64,
) -> Vec<Change> {
    let taken: Vec<usize> = choices.iter().map(|c| c.hypothesis).collect();
    let reach = test.reach() * test.variance().sqrt();
    let of = |(i, choice): (usize, &Choice)| Change {
        or_else: alternatives(test, all, &taken, i, false_alarms),
        ..change(&all[choice.hypothesis], fit.of(i), reach, choice.p_value)
    };
    choices.iter().enumerate().map(of).collect()
}

/// Summarises the lengths of the target's displacements, mm.
pub fn lengths(rows: &Mat<f64>, samples: &[InstrumentSample], scales: NoiseScales) -> Summary {
    let of = |(k, sample): (usize, &InstrumentSample)| {
        length_of(rows, ROWS * k, 1e3 * scales.of(sample).position)
    };
    Summary::new(&samples.iter().enumerate().map(of).collect::<Vec<_>>())
}

/// Summarises the angles of the target's rotations, mrad; `None` if no rotation was measured.
pub fn angles(
    rows: &Mat<f64>,
    samples: &[InstrumentSample],
    scales: NoiseScales,
) -> Option<Summary> {
    let measured = samples.iter().enumerate();
    let measured = measured.filter(|(_, s)| s.observation.has_orientation());
    let all: Vec<f64> = measured
        .map(|(k, s)| length_of(rows, ROWS * k + 3, 1e3 * scales.of(s).orientation))
        .collect();
    (!all.is_empty()).then(|| Summary::new(&all))
}
