//! The summary of a calibration by touches, in the units of its readers.

use nalgebra::Vector3;
use serde::Serialize;

use crate::identification::touch::distances::Measured;
use crate::identification::touch::fit::{Noise, Scales, TouchFit, TouchProblem};
use crate::identification::touch::jet::RowJet;
use crate::identification::touch::judge::Verdict;
use crate::identification::touch::scene::Figure;
use crate::identification::touch::unseen::Unseen;
use crate::identification::touch::volume::{Exceeded, Expected, Knowledge};
use crate::measurement::touch::{FeatureKind, KnownDistance, TouchSet};

/// The summary of a calibration by touches.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchSummary {
    /// Number of rows of the file.
    pub rows: usize,
    /// Number of scalar equations of these rows.
    pub equations: usize,
    /// Number of different states of the arm.
    pub states: usize,
    /// Expected position error of the nominal arm over the work volume, given what the touches show of it.
    pub before: Expected,
    /// Expected position error over the work volume as calibrated.
    pub after: Expected,
    /// The errors that 95 of 100 poses of the work volume do not exceed, for a verdict.
    #[serde(skip)]
    pub exceeded: Exceeded,
    /// Probability that the mean error over the work volume is larger as calibrated than nominal.
    pub worse_probability: f64,
    /// Mean error of touches left out of the fit: ratio of the calibrated arm's to the nominal model's.
    pub left_out_ratio: f64,
    /// Mean absolute error of one component of touches left out, for the kind with most equations, nominal and as
    /// calibrated.
    pub left_out: [f64; 2],
    /// The unit of `left_out`.
    pub left_out_unit: &'static str,
    /// Factor by which the arm is farther from its nominal model than its class states, if the touches show it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beyond_class: Option<f64>,
    /// The priors of the class, then those that the evidence prefers: length in mm, tilt in mrad, joint zero in mrad.
    pub class: [[f64; 3]; 2],
    /// The features that were touched.
    pub features: Vec<FeatureSummary>,
    /// Rows of a tracker: one entry for their positions and one for their rotations.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tracker: Vec<FeatureSummary>,
    /// The known distances.
    pub distances: Vec<DistanceSummary>,
    /// Positions of the tips in the flange frame, in mm.
    pub tips_mm: Vec<[f64; 3]>,
    /// Noise of each kind of reading.
    pub noise: Vec<NoiseSummary>,
    /// The outliers among the rows.
    pub outliers: Vec<TouchOutlier>,
    /// What the touches cannot determine.
    pub unseen: Vec<Unseen>,
    /// Standard deviation of the joints' errors that the corners of an image share, in mrad; with images only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint_scatter_mrad: Option<f64>,
    /// The largest τ of a length, in mm, if it is more than what is stated and what gears usually add.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub play_mm: Option<f64>,
}

/// The summary of one feature.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FeatureSummary {
    /// Name of the feature.
    pub name: String,
    /// Kind of the feature.
    pub kind: &'static str,
    /// Number of rows of the feature.
    pub rows: usize,
    /// Number of these rows that are outliers.
    pub rejected: usize,
    /// RMS of one component of the residuals, nominal and calibrated, without outliers.
    pub rms: [f64; 2],
    /// The unit of `rms`: mm, mrad or px.
    pub unit: &'static str,
    /// Number of scalar equations of these rows.
    #[serde(skip)]
    pub equations: usize,
    /// Share of the feature in the sum of squared residuals of all rows, each in units of its noise.
    pub share: f64,
    /// Fitted position in the base frame, in mm; `None` for a level or a tracker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
}

/// The summary of one known distance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DistanceSummary {
    /// Names of the two features.
    pub between: [String; 2],
    /// The stated distance, in mm.
    pub stated_mm: f64,
    /// Standard deviation of the stated distance, in mm.
    pub sigma_mm: f64,
    /// Distance minus the stated one, in mm: nominal, by the touches without any known distance, and as calibrated.
    pub error_mm: [f64; 2],
    /// The distance that all other data give, and its standard deviation, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_mm: Option<[f64; 2]>,
}

impl DistanceSummary {
    /// Summarises a known distance with its errors for two fits.
    pub fn new(
        set: &TouchSet,
        known: &KnownDistance,
        fits: [&TouchFit; 2],
        measured: Option<Measured>,
    ) -> Self {
        let error = |fit: &TouchFit| {
            let missed = fit.distance(known.between, known.distance);
            1e3 * missed.map_or(0.0, |(missed, _)| missed)
        };
        Self {
            between: known.between.map(|f| set.features[f].name.clone()),
            stated_mm: 1e3 * known.distance,
            sigma_mm: 1e3 * known.sigma,
            error_mm: fits.map(error),
            measured_mm: measured.map(|m| [1e3 * m.distance, 1e3 * m.sigma]),
        }
    }
}

/// The noise of one kind of reading.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NoiseSummary {
    /// The kind of reading.
    pub kind: &'static str,
    /// The unit of `stated` and `beyond`.
    pub unit: &'static str,
    /// RMS of the stated noise.
    pub stated: f64,
    /// τ: noise that was found beyond the stated noise.
    pub beyond: f64,
    /// Whether `beyond` is more than what is stated and what gears usually add.
    #[serde(skip)]
    pub is_loud: bool,
}

/// A row that is an outlier.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchOutlier {
    /// Line of the row in the file.
    pub line: usize,
    /// Feature of the row; `None` for a tracker's row.
    pub feature: Option<String>,
    /// Length of the row's residual.
    pub error: f64,
    /// The unit of `error`.
    pub unit: &'static str,
}

/// Returns the unit that a kind of noise is stated in, and how many of that unit make one SI unit.
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

/// Share of a tolerance from which on an error that the touches do not show withholds the verdict "conforms".
const LEFT_TO_CLASS: f64 = 0.1;
/// Factor from which on the class does not describe the arm, so that nothing may be left to it.
const OUTSIDE_CLASS: f64 = 2.0;
/// Errors of a level that no arm causes, rad.
const NO_LEVEL: f64 = 5e-3;

impl TouchSummary {
    /// Returns what the touches leave to the class of the arm, if that matters for a tolerance in mm: no verdict may rest on it.
    pub fn left_to_class(&self, tolerance_mm: f64) -> Option<String> {
        let matters = |unseen: &&Unseen| unseen.mm > LEFT_TO_CLASS * tolerance_mm;
        if let Some(unseen) = self.unseen.iter().find(matters) {
            return Some(unseen.text.clone());
        }
        self.beyond_class.filter(|f| *f > OUTSIDE_CLASS).map(|factor| {
            format!(
                "The arm deviates from its nominal model {factor:.1} times as much as stated for its class. Measure a known \
                 length with another instrument; if the arm is right, state its class under [prior]."
            )
        })
    }

    /// Creates the summary from the fit on the nominal model and the fit of the arm.
    pub fn new(
        problem: &TouchProblem,
        (nominal_arm, fit): (&TouchFit, &TouchFit),
        known: &Knowledge,
        verdict: &Verdict,
        unseen: Vec<Unseen>,
    ) -> Self {
        let set = problem.set;
        let residuals = [nominal_arm.residuals(problem), fit.residuals(problem)];
        let class = Scales::new(&problem.class);
        let scales = |s: &Scales| [1e3 * s.length, 1e3 * s.tilt, 1e3 * s.zero];
        let (left_out_unit, factor) = unit(verdict.kind);
        let noise = noise(problem, fit);
        let has_images = set
            .features
            .iter()
            .any(|f| matches!(f.kind, FeatureKind::Board(_)));
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
            distances: distances(problem, fit),
            tips_mm: tips_mm(problem, fit),
            outliers: outliers(problem, fit, &residuals[1]),
            unseen,
            joint_scatter_mrad: has_images.then_some(1e3 * fit.joint_scatter),
            play_mm: loud_mm(&noise),
            noise,
        }
    }
}

/// Returns the largest noise of a length that is loud, in mm.
fn loud_mm(noise: &[NoiseSummary]) -> Option<f64> {
    let loud = noise
        .iter()
        .filter(|noise| noise.is_loud && noise.unit == "mm");
    loud.map(|noise| noise.beyond).max_by(f64::total_cmp)
}

/// Returns the length of a residual; for a tracker's row that of its position.
pub fn length(jet: &RowJet) -> f64 {
    let squares = jet.residual[..jet.count.min(3)].iter().map(|x| x * x);
    squares.sum::<f64>().sqrt()
}

/// Returns the positions of the tips in the flange frame, in mm.
pub fn tips_mm(problem: &TouchProblem, fit: &TouchFit) -> Vec<[f64; 3]> {
    let flange = problem.nominal.frames()[problem.nominal.kinds().len()];
    let tools = fit.arm.model.tools.iter().take(problem.set.tips.len());
    tools
        .map(|tool| mm(&(flange.inverse() * *tool).translation))
        .collect()
}

/// Returns the rows that are outliers; `residuals` are the residuals of all rows.
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

/// Computes residual statistics of selected rows.
struct Spread<'a> {
    problem: &'a TouchProblem<'a>,
    fit: &'a TouchFit,
    /// Residuals of all rows, nominal and calibrated.
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

    /// Returns the weighted sum of squares of those components of a row that `keep` selects, in units of the noise.
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

/// Summarises every feature that was touched. `residuals` are those of the nominal arm and of `fit`.
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

/// Summarises the rows of a tracker: positions, and rotations if there are any.
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

fn distances(problem: &TouchProblem, fit: &TouchFit) -> Vec<DistanceSummary> {
    let set = problem.set;
    if set.distances.is_empty() {
        return Vec::new();
    }
    let alone = TouchSet {
        distances: Vec::new(),
        ..set.clone()
    };
    let without = TouchProblem {
        set: &alone,
        ..problem.clone()
    };
    let nominal_arm = TouchFit::on_nominal_without(&without, &fit.weights);
    let measured = fit.measured_distances(problem);
    let all = set.distances.iter().zip(measured);
    all.map(|(known, measured)| DistanceSummary::new(set, known, [&nominal_arm, fit], measured))
        .collect()
}

/// Returns whether a level reads something else than directions: gears, play and bending turn the flange by far less.
fn is_no_level(kind: Noise, fit: &TouchFit) -> bool {
    kind == Noise::Level && fit.tau[kind as usize] > NO_LEVEL
}

/// Summarises the noise of every kind of reading that occurs.
pub fn noise(problem: &TouchProblem, fit: &TouchFit) -> Vec<NoiseSummary> {
    let of = |kind: Noise| {
        let (unit, factor) = unit(kind);
        problem.stated_noise(kind).map(|stated| NoiseSummary {
            kind: name(kind),
            unit,
            stated: factor * stated,
            beyond: factor * fit.tau[kind as usize],
            is_loud: fit.is_loud(problem, kind) || is_no_level(kind, fit),
        })
    };
    Noise::ALL.into_iter().filter_map(of).collect()
}
