//! Does a calibration still hold, by a few touches?
//!
//! The same test as of measured poses ([`crate::verification`]), of other rows: what each touch misses by, with the arm as the
//! blob says. What nobody knows of features, tips and instrument is free in the test or widens its covariance:
//!
//! ```text
//! y = −e = P J x + F u,   cov y = P M Pᵀ + F Λ² Fᵀ + v D
//! ```
//!
//! J are the effects of what is looked for on the poses, M what the calibration left unknown of them, P what a row sees of
//! a pose and F of its surroundings. Unknowns u that were stated with a standard deviation have it in Λ; the others are free. v is
//! the noise in units of the stated one, found from the residuals and never below it. Nobody can tell a moved base from moved
//! features, nor the tool from the tip that is fitted: both are no hypotheses here.

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::identification::parametric::state::{Linearised, ROWS};
use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::identification::touch::problem::LeftOut;
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{BaseSample, Instrument, InstrumentSample, Sample};
use crate::measurement::touch::TouchSet;
use crate::model::touches::USUAL_CLASS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::Summary;
use crate::validation::touches::{flange_from_target, flanges, gravity};
use crate::verification::arm::BlobArm;
use crate::verification::drift_test::{self, Columns, DriftTest, columns};
use crate::verification::estimate::{Fit, alternatives, change, lengths, sensitivity};
use crate::verification::hypotheses::{Hypothesis, Part, hypotheses};
use crate::verification::noise::{Factors, Parts};
use crate::verification::payload::payload_step;
use crate::verification::result::{Change, CheckError, Sensitivity};
use crate::verification::touch_rows::Rows;
use crate::verification::{FEWEST_FREEDOM, number};

/// Standard deviations of a change that a test of 1 % finds nine times in ten.
const SURELY: f64 = 3.86;
/// No arm is farther from its size than this, ppm.
const LARGEST_PPM: f64 = 5000.0;

/// What touches say of a calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchReport {
    /// Rows of the file, and how many scalar equations are left beside what is fitted to them.
    pub rows: usize,
    /// The second of those.
    pub freedom: usize,
    /// What each touch of a length misses by, as all others predict it, mm.
    pub miss_mm: Summary,
    /// Every row's, in the order of the file.
    pub misses: Vec<TouchMiss>,
    /// Rate of false alarms of the whole test.
    pub false_alarm_rate: f64,
    /// What has moved; empty when nothing has.
    pub changes: Vec<Change>,
    /// By how much these changes move the tip at the touches, mm.
    pub effect_mm: Summary,
    /// What the touches miss by once these changes are taken out, mm.
    pub without_mm: Summary,
    /// Standard deviation of the noise over the stated one, as the residuals have it.
    pub noise_factor: f64,
    /// Root mean square of what the calibration is expected not to know of one component of a length, mm.
    pub model_mm: f64,
    /// Whether the model knows how wrong it is.
    pub model_knows_its_error: bool,
    /// What this check can find.
    pub sensitivity: Vec<Sensitivity>,
    /// By how much the arm would have to be larger or smaller than its model for these touches to show it, nine times in ten, ppm;
    /// `None` where they do not show its size.
    pub size_ppm: Option<f64>,
    /// Lines of rows that do not belong, and were left out.
    pub odd_lines: Vec<usize>,
}

/// What one touch misses by, as all others predict it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchMiss {
    /// Line of the file.
    pub line: usize,
    /// Its feature; `None` of a tracker's row.
    pub feature: Option<String>,
    /// mm; `None` of angles and images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mm: Option<f64>,
}

/// Checks `loaded` by the touches of `set`. `nominal` leads from base to flange.
///
/// # Errors
/// [`CheckError`].
pub fn check_touches(
    loaded: &BlobModel,
    set: &TouchSet,
    nominal: &Poe<f64>,
    coupling: Option<&Vec<Vec<f64>>>,
    false_alarms: f64,
) -> Result<TouchReport, CheckError> {
    let coupling = coupling.cloned();
    let problem = TouchProblem::new(set, nominal, coupling, gravity(loaded), USUAL_CLASS);
    let poses: Vec<Pose<f64>> = flanges(loaded, &problem.states)
        .into_iter()
        .map(|(pose, _)| pose)
        .collect();
    let fit = TouchFit::on_known(&problem, &poses);
    let left_out = fit.left_out(&problem).ok_or(CheckError::Unsolvable)?;
    let rows = Rows::new(&problem, &fit);
    let arm = ArmAtTouches::new(loaded, &problem, &fit);
    let weighed = Weighed::new(&rows, &arm)?;
    let effects: Vec<Columns> = weighed
        .all
        .iter()
        .map(|h| columns(&weighed.factor.half_solve(&h.effect)))
        .collect();
    let numbers = weighed.all.iter().map(|h| number(h.part)).collect();
    let white = weighed.factor.half_solve(&rows.y);
    let free = columns(&weighed.factor.half_solve(&rows.free));
    let test = DriftTest::new(&white, &free, &effects, numbers, 0);
    if test.freedom < FEWEST_FREEDOM {
        let missing = FEWEST_FREEDOM - test.freedom;
        let each = rows.y.nrows().div_ceil(set.rows.len().max(1));
        return Err(CheckError::TooFew {
            poses: problem.states.len(),
            equations: rows.y.nrows(),
            needed: problem.states.len() + missing.div_ceil(each.max(1)),
        });
    }
    let choices = test.choose(false_alarms);
    let taken: Vec<usize> = choices.iter().map(|c| c.hypothesis).collect();
    let chosen: Vec<&Hypothesis> = taken.iter().map(|h| &weighed.all[*h]).collect();
    let found =
        Fit::new((&rows.y, &weighed.factor), &rows.free, &chosen).ok_or(CheckError::Unsolvable)?;
    let sensitivity = sensitivity(&test, &weighed.all, false_alarms);
    if sensitivity.iter().all(|s| s.smallest.is_none()) {
        return Err(CheckError::NothingShown);
    }
    let reach = test.reach() * test.variance().sqrt();
    let changes = choices.iter().enumerate().map(|(i, choice)| Change {
        or_else: alternatives(&test, &weighed.all, &taken, i, false_alarms),
        ..change(
            &weighed.all[choice.hypothesis],
            found.of(i),
            reach,
            choice.p_value,
        )
    });
    let mut moved = Mat::zeros(ROWS * arm.samples.len(), 1);
    for (i, hypothesis) in taken.iter().enumerate() {
        for (j, value) in found.of(i).0.iter().enumerate() {
            moved += arm.all[*hypothesis].effect.column(j) * *value;
        }
    }
    let misses = misses(&problem, &left_out);
    if misses.iter().all(Option::is_none) {
        return Err(CheckError::NothingShown);
    }
    let miss_mm = summary(&misses, &fit.weights);
    let without_mm = match taken.is_empty() {
        true => miss_mm,
        false => {
            let parts = choices.iter().enumerate();
            let parts = parts.map(|(i, c)| (weighed.all[c.hypothesis].part, found.of(i).0[0]));
            let states = moved_states(&problem, &parts.collect::<Vec<_>>());
            let poses: Vec<Pose<f64>> = flanges(loaded, &states).into_iter().map(|f| f.0).collect();
            let fit = TouchFit::on_known(&problem, &poses);
            let left_out = fit.left_out(&problem).ok_or(CheckError::Unsolvable)?;
            summary(&self::misses(&problem, &left_out), &fit.weights)
        }
    };
    let belongs = |row: &usize| fit.weights[*row] > 0.0;
    Ok(TouchReport {
        rows: set.rows.len(),
        freedom: test.freedom,
        miss_mm,
        misses: set
            .rows
            .iter()
            .zip(misses)
            .map(|(row, mm)| TouchMiss {
                line: row.line,
                feature: row.reading.feature().map(|f| set.features[f].name.clone()),
                mm,
            })
            .collect(),
        false_alarm_rate: false_alarms,
        changes: changes.collect(),
        effect_mm: lengths(&moved, &arm.samples, arm.scales),
        without_mm,
        noise_factor: weighed.factors[0].sqrt(),
        model_mm: weighed.model_mm,
        model_knows_its_error: arm.arm.knows_its_error,
        sensitivity,
        size_ppm: size_ppm(&rows, &arm, &weighed),
        odd_lines: (0..set.rows.len())
            .filter(|row| !belongs(row))
            .map(|row| set.rows[row].line)
            .collect(),
    })
}

/// What every row misses by, mm; `None` of angles and images.
fn misses(problem: &TouchProblem, left_out: &[LeftOut]) -> Vec<Option<f64>> {
    let rows = &problem.set.rows;
    let mut out: Vec<Option<f64>> = vec![None; rows.len()];
    for left in left_out {
        for (row, errors) in left.rows.iter().zip(&left.errors) {
            let is_length = Noise::of(&rows[*row].reading, 0).is_length();
            let square: f64 = errors.iter().take(3).map(|e| e * e).sum();
            out[*row] = is_length.then(|| 1e3 * square.sqrt());
        }
    }
    out
}

/// Of the rows that belong.
fn summary(misses: &[Option<f64>], weights: &[f64]) -> Summary {
    let pairs = misses.iter().zip(weights);
    let belonging = pairs.filter(|(_, weight)| **weight > 0.0);
    let all: Vec<f64> = belonging.filter_map(|(miss, _)| *miss).collect();
    Summary::new(&all)
}

/// The states as the arm truly has them once these parts have moved.
fn moved_states(problem: &TouchProblem, parts: &[(Part, f64)]) -> Vec<BaseSample> {
    let mut states = problem.states.clone();
    for state in &mut states {
        for (part, value) in parts {
            match part {
                Part::Joint(joint) => state.joints[joint - 1] += value,
                Part::Payload => state.payload_kg = state.payload_kg.map(|kg| kg + value),
                Part::Base | Part::Tool => {}
            }
        }
    }
    states
}

/// The arm of the blob at the states of the touches, in rows of poses.
struct ArmAtTouches {
    arm: BlobArm,
    samples: Vec<InstrumentSample>,
    at: Linearised,
    /// Units of the rows of poses.
    scales: NoiseScales,
    /// What is looked for, in rows of poses.
    all: Vec<Hypothesis>,
    /// Displacements that twice the size makes, in rows of poses.
    size: Mat<f64>,
}

impl ArmAtTouches {
    fn new(loaded: &BlobModel, problem: &TouchProblem, fit: &TouchFit) -> Self {
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
        Self {
            arm,
            samples,
            at,
            scales,
            all,
            size,
        }
    }
}

/// Of angles, rad.
const LEVEL: f64 = 50e-6;

/// What a kilogram more does, in units of `scales`.
fn payload_effect(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    tools: &[Pose<f64>],
    scales: NoiseScales,
) -> Option<Mat<f64>> {
    let base_from_instrument = loaded.instrument_from_base().inverse();
    let mut out = Mat::zeros(ROWS * samples.len(), 1);
    for (k, sample) in samples.iter().enumerate() {
        let (less, more) = payload_step(loaded, sample.payload_kg)?;
        let pose = |kg: f64| {
            let found = loaded.predict(&sample.joints, Some(kg)).pose;
            base_from_instrument * found * tools[sample.tool]
        };
        let kind = ResidualFrame::ToolPoint(scales);
        let all = residual_components(kind, &Observation::Pose(pose(more)), &pose(less));
        for (row, value) in all.into_iter().enumerate() {
            out[(ROWS * k + row, 0)] = value / (more - less);
        }
    }
    Some(out)
}

/// The rows with their covariance.
struct Weighed {
    /// What is looked for, in rows of touches.
    all: Vec<Hypothesis>,
    factors: Factors,
    factor: Factor,
    model_mm: f64,
    /// From rows of poses in units of their scales to rows of touches.
    by_pose: Mat<f64>,
}

impl Weighed {
    fn new(rows: &Rows, arm: &ArmAtTouches) -> Result<Self, CheckError> {
        let unit = |column: usize| match column % ROWS {
            0..3 => arm.scales.position,
            _ => arm.scales.orientation,
        };
        let by_pose = Mat::from_fn(rows.seen.nrows(), rows.seen.ncols(), |i, j| {
            rows.seen[(i, j)] * unit(j)
        });
        let of_poses = |m: &Mat<f64>| product(&product(&by_pose, m), Transposed(&by_pose));
        let unknown = arm
            .arm
            .error_covariance(&arm.samples, &arm.at, arm.scales)
            .ok_or(CheckError::Unsolvable)?;
        let model = of_poses(&unknown);
        let smooth = (!arm.arm.knows_its_error)
            .then(|| of_poses(&arm.arm.smooth_covariance(&arm.samples, &arm.at)));
        let all: Vec<Hypothesis> = arm
            .all
            .iter()
            .map(|h| Hypothesis {
                effect: product(&by_pose, &h.effect),
                ..h.clone()
            })
            .collect();
        let parts = Parts {
            fixed: &(&model + product(&rows.stated, Transposed(&rows.stated))),
            stated: &rows.fixed,
            kind: &rows.kind,
            smooth: smooth.as_ref(),
        };
        let looked_for = all.iter().flat_map(|h| columns(&h.effect));
        let effects: Columns = columns(&rows.free).into_iter().chain(looked_for).collect();
        let free = drift_test::basis(&effects, &[]);
        let x = Mat::from_fn(rows.y.nrows(), free.len(), |i, j| free[j][i]);
        if free.len() >= rows.y.nrows() {
            return Err(CheckError::NothingShown);
        }
        // Noise is never below the stated one.
        let factors = parts
            .fitted(&rows.y, &x, &[1.0, 1.0, 0.0])
            .ok_or(CheckError::Unsolvable)?;
        let variance = |(i, sigma): (usize, &Option<f64>)| {
            let smooth = smooth.as_ref().map_or(0.0, |s| factors[2] * s[(i, i)]);
            sigma.map(|sigma| sigma * sigma * (model[(i, i)] + smooth))
        };
        let known: Vec<f64> = rows.sigma.iter().enumerate().filter_map(variance).collect();
        let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
        Ok(Self {
            factor: Factor::new(parts.covariance(&factors), 1)
                .map_err(|_| CheckError::Unsolvable)?,
            all,
            factors,
            model_mm: 1e3 * mean.max(0.0).sqrt(),
            by_pose,
        })
    }
}

/// The change of size, ppm, that these touches find nine times in ten; `None` where it is larger than any arm's.
fn size_ppm(rows: &Rows, arm: &ArmAtTouches, weighed: &Weighed) -> Option<f64> {
    let effect = product(&weighed.by_pose, &arm.size);
    let column = columns(&weighed.factor.half_solve(&effect));
    let free = columns(&weighed.factor.half_solve(&rows.free));
    let free = drift_test::basis(&free, &[]);
    let left = drift_test::without(column.first()?, &free);
    let ppm = 1e6 * SURELY / drift_test::inner(&left, &left).sqrt();
    (ppm <= LARGEST_PPM).then_some(ppm)
}
