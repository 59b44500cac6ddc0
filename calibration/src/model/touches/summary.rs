//! What a calibration by touches found, in the units of its readers.

use nalgebra::Vector3;
use serde::Serialize;

use crate::identification::touch::distances::Measured;
use crate::identification::touch::fit::{Noise, Scales, TouchFit, TouchProblem};
use crate::identification::touch::jet::RowJet;
use crate::identification::touch::judge::Verdict;
use crate::identification::touch::scene::Figure;
use crate::identification::touch::unseen::Unseen;
use crate::identification::touch::volume::{Exceeded, Expected, Knowledge};
use crate::measurement::touch::KnownDistance;

/// What was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchSummary {
    /// Rows of the file.
    pub rows: usize,
    /// Scalar equations of them.
    pub equations: usize,
    /// States of the arm.
    pub states: usize,
    /// Position error to be expected over the work volume as drawn, by what the touches say of the drawing.
    pub before: Expected,
    /// The same as calibrated.
    pub after: Expected,
    /// What 95 of 100 poses of the work volume do not exceed, for a verdict.
    #[serde(skip)]
    pub exceeded: Exceeded,
    /// How probable it is that the mean error over the work volume is larger as calibrated than as drawn.
    pub worse_probability: f64,
    /// Mean error of a touch left out: calibrated over drawn.
    pub left_out_ratio: f64,
    /// Mean modulus of one component of a touch left out, of the kind with most equations, as drawn and calibrated.
    pub left_out: [f64; 2],
    /// The unit of `left_out`.
    pub left_out_unit: &'static str,
    /// By what factor the arm is farther from its drawing than its class, where the touches say.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beyond_class: Option<f64>,
    /// The priors of the class and those that the evidence prefers: length mm, tilt mrad, joint zero mrad.
    pub class: [[f64; 3]; 2],
    /// What was touched.
    pub features: Vec<FeatureSummary>,
    /// Rows of a tracker: their positions, and their rotations.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tracker: Vec<FeatureSummary>,
    /// Known distances.
    pub distances: Vec<DistanceSummary>,
    /// Where the tips are at the flange, mm.
    pub tips_mm: Vec<[f64; 3]>,
    /// Noise by kind.
    pub noise: Vec<NoiseSummary>,
    /// Rows that do not belong.
    pub outliers: Vec<TouchOutlier>,
    /// What the touches cannot tell.
    pub unseen: Vec<Unseen>,
    /// The largest τ of a length in mm, where it asks whether joints play or the tool slips.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub play_mm: Option<f64>,
}

/// One feature.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FeatureSummary {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: &'static str,
    /// Number of its rows.
    pub rows: usize,
    /// Number of its rows that do not belong.
    pub rejected: usize,
    /// RMS of one component of its residuals as drawn and as calibrated, without those that do not belong.
    pub rms: [f64; 2],
    /// The unit of `rms`: mm, mrad or px.
    pub unit: &'static str,
    /// Scalar equations of them.
    #[serde(skip)]
    pub equations: usize,
    /// Share of the sum of squares, in units of the noise.
    pub share: f64,
    /// Where it is in the base frame as fitted, mm; nothing of a level or a tracker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
}

/// A known distance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DistanceSummary {
    /// Names of both features.
    pub between: [String; 2],
    /// As it is said, mm.
    pub said_mm: f64,
    /// Its standard deviation, mm.
    pub sigma_mm: f64,
    /// As drawn and as calibrated less what is said, mm.
    pub error_mm: [f64; 2],
    /// What everything else says of it, and the standard deviation of that, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_mm: Option<[f64; 2]>,
}

/// The noise of one kind of reading.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NoiseSummary {
    /// The kind.
    pub kind: &'static str,
    /// The unit.
    pub unit: &'static str,
    /// Stated: the mean of squares, rooted.
    pub stated: f64,
    /// What is found beyond it, τ.
    pub beyond: f64,
}

/// A row that does not belong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchOutlier {
    /// Its line in the file.
    pub line: usize,
    /// Its feature; `None` of a tracker's row.
    pub feature: Option<String>,
    /// By how much it misses.
    pub error: f64,
    /// The unit of `error`.
    pub unit: &'static str,
}

/// The unit that a kind of noise is stated in, and how many of it one SI unit is.
pub fn unit(kind: Noise) -> (&'static str, f64) {
    match kind {
        Noise::Board => ("px", 1.0),
        Noise::Level | Noise::Rotation => ("mrad", 1e3),
        _ => ("mm", 1e3),
    }
}

fn name(kind: Noise) -> &'static str {
    match kind {
        Noise::Point => "point",
        Noise::Plane => "plane",
        Noise::Sphere => "sphere",
        Noise::Anchor => "anchor",
        Noise::Level => "level",
        Noise::Board => "board",
        Noise::Position => "tracker position",
        Noise::Rotation => "tracker rotation",
    }
}

fn mm(v: &Vector3<f64>) -> [f64; 3] {
    [1e3 * v[0], 1e3 * v[1], 1e3 * v[2]]
}

impl TouchSummary {
    /// Summarises the fit on the drawing and the fit of the arm.
    pub fn new(
        problem: &TouchProblem,
        (drawing, fit): (&TouchFit, &TouchFit),
        known: &Knowledge,
        verdict: &Verdict,
        unseen: Vec<Unseen>,
    ) -> Self {
        let set = problem.set;
        let residuals = [drawing.residuals(problem), fit.residuals(problem)];
        let class = Scales::new(&problem.class);
        let scales = |s: &Scales| [1e3 * s.length, 1e3 * s.tilt, 1e3 * s.zero];
        let (left_out_unit, factor) = unit(verdict.kind);
        Self {
            rows: set.rows.len(),
            equations: problem.equations(),
            states: problem.states.len(),
            before: known.before,
            after: known.after,
            exceeded: known.exceeded,
            worse_probability: verdict.worse,
            left_out_ratio: verdict.left_out,
            left_out: [factor * verdict.errors.0, factor * verdict.errors.1],
            left_out_unit,
            beyond_class: known.beyond_class,
            class: [scales(&class), scales(&fit.scales)],
            features: features(problem, fit, &residuals),
            tracker: tracker(problem, fit, &residuals),
            distances: distances(problem, drawing, fit),
            tips_mm: tips_mm(problem, fit),
            noise: noise(problem, fit),
            outliers: outliers(problem, fit, &residuals[1]),
            unseen,
            play_mm: verdict.play.map(|tau| 1e3 * tau),
        }
    }
}

/// The length of a residual; of a tracker's row that of its position.
pub fn length(jet: &RowJet) -> f64 {
    let squares = jet.residual[..jet.count.min(3)].iter().map(|x| x * x);
    squares.sum::<f64>().sqrt()
}

/// Where the tips are at the flange, mm.
pub fn tips_mm(problem: &TouchProblem, fit: &TouchFit) -> Vec<[f64; 3]> {
    let flange = problem.nominal.frames()[problem.nominal.kinds().len()];
    let tools = fit.arm.model.tools.iter().take(problem.set.tips.len());
    tools
        .map(|tool| mm(&(flange.inverse() * *tool).translation))
        .collect()
}

/// The rows that do not belong, with their residuals among `residuals`.
pub fn outliers(problem: &TouchProblem, fit: &TouchFit, residuals: &[RowJet]) -> Vec<TouchOutlier> {
    let set = problem.set;
    let all = set.rows.iter().zip(&fit.weights).zip(residuals);
    let rejected = all.filter(|((_, weight), _)| **weight == 0.0);
    rejected
        .map(|((row, _), jet)| {
            let (unit, factor) = unit(Noise::of(&row.reading, 0));
            TouchOutlier {
                line: row.line,
                feature: row.reading.feature().map(|f| set.features[f].name.clone()),
                error: factor * length(jet),
                unit,
            }
        })
        .collect()
}

/// What rows of one kind miss by.
struct Spread<'a> {
    problem: &'a TouchProblem<'a>,
    fit: &'a TouchFit,
    /// As drawn and as calibrated.
    residuals: &'a [Vec<RowJet>; 2],
    /// The sum of squares of all rows in units of the noise.
    all: f64,
}

impl<'a> Spread<'a> {
    fn new(
        problem: &'a TouchProblem,
        fit: &'a TouchFit,
        residuals: &'a [Vec<RowJet>; 2],
    ) -> Spread<'a> {
        let mut out = Spread {
            problem,
            fit,
            residuals,
            all: 0.0,
        };
        out.all = (0..problem.set.rows.len())
            .map(|row| out.chi(row, |_| true))
            .sum();
        out
    }

    /// The squares of the components of a row that `keep` names, in units of the noise.
    fn chi(&self, row: usize, keep: impl Fn(usize) -> bool) -> f64 {
        let jet = &self.residuals[1][row];
        let of = |i: usize| jet.residual[i].powi(2) / self.fit.variance(self.problem, row, i);
        let components = (0..jet.count).filter(|i| keep(*i));
        self.fit.weights[row] * components.map(of).sum::<f64>()
    }

    /// Summarises the components of kind `noise` in the rows `own`.
    fn of(&self, name: &str, kind: &'static str, own: &[usize], noise: Noise) -> FeatureSummary {
        let rows = &self.problem.set.rows;
        let is_of_kind = |row: usize, i: usize| Noise::of(&rows[row].reading, i) == noise;
        let belongs = |row: &usize| self.fit.weights[*row] > 0.0;
        let (unit, factor) = unit(noise);
        let rms = |jets: &[RowJet]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for row in own.iter().copied().filter(belongs) {
                for i in (0..jets[row].count).filter(|i| is_of_kind(row, *i)) {
                    sum += jets[row].residual[i].powi(2);
                    count += 1.0;
                }
            }
            factor * (sum / f64::max(count, 1.0)).sqrt()
        };
        let share = own
            .iter()
            .map(|row| self.chi(*row, |i| is_of_kind(*row, i)));
        let of_row = |row: &usize| {
            let all = 0..self.residuals[1][*row].count;
            all.filter(|i| is_of_kind(*row, *i)).count()
        };
        FeatureSummary {
            name: name.to_owned(),
            kind,
            rows: own.len(),
            rejected: own.iter().filter(|row| !belongs(row)).count(),
            rms: [rms(&self.residuals[0]), rms(&self.residuals[1])],
            unit,
            equations: own.iter().map(of_row).sum(),
            share: share.sum::<f64>() / self.all.max(1e-300),
            position_mm: None,
        }
    }
}

/// What was touched. `residuals` are those as drawn and those of `fit`.
pub fn features(
    problem: &TouchProblem,
    fit: &TouchFit,
    residuals: &[Vec<RowJet>; 2],
) -> Vec<FeatureSummary> {
    let set = problem.set;
    let spread = Spread::new(problem, fit, residuals);
    let of = |(index, feature): (usize, &crate::measurement::touch::Feature)| {
        let rows = set.rows.iter().enumerate();
        let own = rows.filter(|(_, row)| row.reading.feature() == Some(index));
        let own: Vec<usize> = own.map(|(k, _)| k).collect();
        let noise = own
            .first()
            .map_or(Noise::Point, |k| Noise::of(&set.rows[*k].reading, 0));
        FeatureSummary {
            position_mm: match &fit.scene.figures[index] {
                Figure::Point { centre, .. } | Figure::Sphere { centre, .. } => Some(mm(centre)),
                Figure::Anchor { position, .. } => Some(mm(position)),
                Figure::Plane { origin, .. } => Some(mm(origin)),
                Figure::Board { pose, .. } => Some(mm(&pose.translation)),
                Figure::Level { .. } => None,
            },
            ..spread.of(&feature.name, feature.kind.name(), &own, noise)
        }
    };
    set.features.iter().enumerate().map(of).collect()
}

/// The rows of a tracker: positions, and rotations where there are some.
pub fn tracker(
    problem: &TouchProblem,
    fit: &TouchFit,
    residuals: &[Vec<RowJet>; 2],
) -> Vec<FeatureSummary> {
    let spread = Spread::new(problem, fit, residuals);
    let of = |noise: Noise| {
        let rows = problem.set.rows.iter().enumerate();
        let own = rows.filter(|(_, row)| {
            (0..row.reading.equations()).any(|i| Noise::of(&row.reading, i) == noise)
        });
        let own: Vec<usize> = own.map(|(k, _)| k).collect();
        (!own.is_empty()).then(|| spread.of("tracker", name(noise), &own, noise))
    };
    let both = [Noise::Position, Noise::Rotation];
    both.into_iter().filter_map(of).collect()
}

fn distances(problem: &TouchProblem, drawing: &TouchFit, fit: &TouchFit) -> Vec<DistanceSummary> {
    let set = problem.set;
    let of = |(known, measured): (&KnownDistance, Option<Measured>)| {
        let error = |fit: &TouchFit| {
            let missed = fit.distance(known.between, known.distance);
            1e3 * missed.map_or(0.0, |(missed, _)| missed)
        };
        DistanceSummary {
            between: known.between.map(|f| set.features[f].name.clone()),
            said_mm: 1e3 * known.distance,
            sigma_mm: 1e3 * known.sigma,
            error_mm: [error(drawing), error(fit)],
            measured_mm: measured.map(|m| [1e3 * m.distance, 1e3 * m.sigma]),
        }
    };
    let measured = fit.measured_distances(problem);
    set.distances.iter().zip(measured).map(of).collect()
}

/// The noise of every kind of reading that there is.
pub fn noise(problem: &TouchProblem, fit: &TouchFit) -> Vec<NoiseSummary> {
    let set = problem.set;
    let of = |kind: Noise| {
        let (mut sum, mut count) = (0.0, 0.0);
        for (k, row) in set.rows.iter().enumerate() {
            for i in 0..row.reading.equations() {
                if Noise::of(&row.reading, i) == kind {
                    let tau = fit.tau[kind as usize];
                    sum += fit.variance(problem, k, i) - tau * tau;
                    count += 1.0;
                }
            }
        }
        let (unit, factor) = unit(kind);
        (count > 0.0).then(|| NoiseSummary {
            kind: name(kind),
            unit,
            stated: factor * f64::max(sum / count, 0.0).sqrt(),
            beyond: factor * fit.tau[kind as usize],
        })
    };
    Noise::ALL.into_iter().filter_map(of).collect()
}
