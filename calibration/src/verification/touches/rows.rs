//! Touches as equations, and the arm of a blob at the states of the touches.

use poegp_runtime::math::se3::Pose;

use crate::blob::predict::BlobModel;
use crate::identification::parametric::state::{Linearised, ROWS};
use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{BaseSample, Instrument, InstrumentSample, Sample};
use crate::numeric::matrix::Mat;
use crate::validation::touches::flange_from_target;
use crate::verification::arm::BlobArm;
use crate::verification::hypotheses::{Hypothesis, Part, hypotheses};
use crate::verification::payload::payload_effect;

/// Prior standard deviation from which an unknown counts as free, m or rad.
const UNKNOWN: f64 = 1.0;

/// The equations of touches, each in units of its stated noise.
pub(super) struct Rows {
    /// −e: negative residuals, with stated unknowns at their stated values.
    pub(super) y: Mat<f64>,
    /// e: residuals of the fitted features and tips; zero for angles and known distances.
    pub(super) missed: Mat<f64>,
    /// P: what each row sees of the poses of all states, as displacement and rotation of the tip in the axes of the base, m
    /// and rad.
    pub(super) seen: Mat<f64>,
    /// F of the free unknowns.
    pub(super) free: Mat<f64>,
    /// F Λ of the unknowns that have a stated standard deviation.
    pub(super) stated: Mat<f64>,
    /// Kind of each row's noise: 0 for lengths, 1 for angles and images.
    pub(super) kind: Vec<Option<usize>>,
    /// Share of a row's variance that no factor of the noise changes: 1 for a known distance.
    pub(super) fixed: Vec<f64>,
    /// σ of the row as a displacement of the tip, m; `None` for angles and known distances.
    pub(super) sigma: Vec<Option<f64>>,
}

/// Columns that are not zero, with their values.
type Sparse = Vec<(usize, f64)>;
/// One equation: e, its derivatives by the pose of its state, and its derivatives by its unknowns.
type Equation = (f64, Sparse, Sparse);

impl Rows {
    /// Returns the kind of noise that is stated of all rows: that of lengths, if there are any.
    pub(super) fn main_kind(&self) -> usize {
        let touched = self.kind.iter().zip(&self.fixed);
        let mut own = touched.filter(|(_, fixed)| **fixed == 0.0);
        usize::from(own.all(|(kind, _)| *kind == Some(1)))
    }

    pub(super) fn new(problem: &TouchProblem, fit: &TouchFit) -> Self {
        let set = problem.set;
        let jets = fit.arm.linearise(&problem.states);
        let priors = fit.priors(problem);
        let (unknowns, tips) = (fit.scene.prior.len(), priors.len());
        // The unknowns of the tips come first.
        let mut all: Vec<Equation> = Vec::new();
        let (mut kind, mut fixed, mut sigma) = (Vec::new(), Vec::new(), Vec::new());
        for (row, touch) in set.rows.iter().enumerate() {
            if fit.weights[row] == 0.0 {
                continue;
            }
            let state = problem.state_of[row];
            let jet = fit.scene.row(set, &touch.reading, &jets[state].pose);
            for i in 0..jet.count {
                let is_length = Noise::of(&touch.reading, i).is_length();
                let own = problem.stated_variance(row, i).sqrt();
                let pose = (0..ROWS).map(|a| (ROWS * state + a, jet.tip[i][a] / own));
                let by_tips = (0..tips).map(|j| {
                    let by_pose = (0..ROWS).map(|a| jet.tip[i][a] * jets[state].jacobian[(a, j)]);
                    (j, by_pose.sum::<f64>() / own)
                });
                let scene = jet.own.iter().map(|(at, x)| (tips + at, x[i] / own));
                all.push((
                    jet.residual[i] / own,
                    pose.collect(),
                    by_tips.chain(scene).collect(),
                ));
                kind.push(Some(usize::from(!is_length)));
                fixed.push(0.0);
                let per_metre = jet.per_metre(i);
                sigma.push((per_metre > 0.0).then(|| own / per_metre));
            }
        }
        for known in &set.distances {
            let Some((missed, direction)) = fit.distance(known.between, known.distance) else {
                continue;
            };
            let ends = known.between.iter().zip([1.0, -1.0]);
            let own = ends.flat_map(|(feature, sign)| {
                let first = tips + fit.scene.first[*feature];
                (0..3).map(move |i| (first + i, sign * direction[i] / known.sigma))
            });
            all.push((missed / known.sigma, Vec::new(), own.collect()));
            kind.push(Some(0));
            fixed.push(1.0);
            sigma.push(None);
        }
        let prior: Vec<f64> = priors.iter().chain(&fit.scene.prior).copied().collect();
        let value: Vec<f64> = fit
            .arm
            .theta
            .iter()
            .chain(&fit.scene.deviation)
            .copied()
            .collect();
        let is_free = |j: &usize| prior[*j] >= UNKNOWN;
        let is_stated = |j: &usize| prior[*j] > 0.0 && prior[*j] < UNKNOWN;
        let free: Vec<usize> = (0..tips + unknowns).filter(is_free).collect();
        let stated: Vec<usize> = (0..tips + unknowns).filter(is_stated).collect();
        let mut out = Self {
            missed: Mat::from_fn(all.len(), 1, |k, _| match sigma[k] {
                Some(_) => all[k].0,
                None => 0.0,
            }),
            y: Mat::zeros(all.len(), 1),
            seen: Mat::zeros(all.len(), ROWS * problem.states.len()),
            free: Mat::zeros(all.len(), free.len()),
            stated: Mat::zeros(all.len(), stated.len()),
            kind,
            fixed,
            sigma,
        };
        for (k, (residual, pose, own)) in all.into_iter().enumerate() {
            let mut y = -residual;
            for (column, x) in pose {
                out.seen[(k, column)] = x;
            }
            for (j, x) in own {
                if let Ok(at) = free.binary_search(&j) {
                    out.free[(k, at)] = x;
                } else if let Ok(at) = stated.binary_search(&j) {
                    out.stated[(k, at)] = x * prior[j];
                    // Moves the residual back to the stated value of the unknown.
                    y += x * value[j];
                }
            }
            out.y[(k, 0)] = y;
        }
        out
    }
}

/// The arm of the blob at the states of the touches, in rows of poses.
pub(super) struct ArmAtTouches {
    pub(super) arm: BlobArm,
    pub(super) samples: Vec<InstrumentSample>,
    pub(super) at: Linearised,
    /// Units of the rows of poses.
    pub(super) scales: NoiseScales,
    /// Hypotheses, with effects in rows of poses.
    pub(super) all: Vec<Hypothesis>,
}

impl ArmAtTouches {
    pub(super) fn new(loaded: &BlobModel, problem: &TouchProblem, fit: &TouchFit) -> Self {
        let last = problem.nominal.frames()[problem.nominal.kinds().len()];
        let target_from_joint = (last * flange_from_target(loaded)).inverse();
        let tools: Vec<Pose<f64>> = fit
            .arm
            .model
            .tools
            .iter()
            .map(|tool| target_from_joint * *tool)
            .collect();
        let arm = BlobArm::new(loaded, &tools);
        let poses = fit.arm.poses(&problem.states);
        let sample = |(state, pose): (&BaseSample, &Pose<f64>)| Sample {
            payload_kg: state.payload_kg,
            tool: state.tool,
            ..Sample::new(
                state.joints.clone(),
                state.serial_joints.clone(),
                Observation::Pose(*pose),
                Instrument,
            )
        };
        let samples: Vec<InstrumentSample> =
            problem.states.iter().zip(&poses).map(sample).collect();
        let stated: Vec<f64> = (0..problem.set.rows.len())
            .filter(|row| Noise::of(&problem.set.rows[*row].reading, 0).is_length())
            .map(|row| problem.stated_variance(row, 0))
            .collect();
        let mean = stated.iter().sum::<f64>() / stated.len().max(1) as f64;
        let unit = if mean > 0.0 { mean.sqrt() } else { LEVEL };
        let scales = NoiseScales::uniform(unit, LEVEL);
        let at = arm.linearise(&samples, scales);
        let payload = payload_effect(loaded, &samples, &tools, scales);
        let mut all = hypotheses(&arm, &at, &samples, payload);
        all.retain(|h| !matches!(h.part, Part::Base | Part::Tool));
        let mut size = Mat::zeros(ROWS * samples.len(), 1);
        for (k, pose) in poses.iter().enumerate() {
            for i in 0..3 {
                size[(ROWS * k + i, 0)] = pose.translation[i] / scales.position;
            }
        }
        // A wrong unit or a mistyped distance looks like an arm of another size.
        all.push(Hypothesis {
            part: Part::Size,
            turns: false,
            effect: size,
        });
        Self {
            arm,
            samples,
            at,
            scales,
            all,
        }
    }
}

/// Unit of angles in the rows of poses, rad.
const LEVEL: f64 = 50e-6;
