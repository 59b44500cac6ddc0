//! Does a calibration still hold? Ten to twenty fresh measurements against the blob's predictions.
//!
//! Two questions, answered apart:
//!
//! - **How large is the error now?** Mean, 95 % and largest, as `evaluate` has them.
//! - **Has something moved?** Base, tool, the zero of one joint, or the mass of the payload, fitted to the residuals. These
//!   are weighted by their covariance, which has three parts: the noise of the measurements, found from the residuals whatever
//!   has moved ([`noise`]), what the calibration did not know, from the blob itself ([`arm`]), and what a row states of
//!   itself. An alarm is raised at a stated rate of false ones ([`drift_test`]).
//!
//! Everything is linear: a drift is millimetres and milliradians. A base or a tool that was set up anew is fitted first and then
//! is free in the test.

pub mod arm;
pub mod drift_test;
mod estimate;
pub mod hypotheses;
pub mod noise;
mod residuals;
pub mod result;

use faer::{Mat, Side};
use poegp_runtime::math::se3::Pose;

use crate::blob::predict::LoadedBlob;
use crate::identification::base_tools::tool_count;
use crate::identification::parametric::state::ROWS;
use crate::learning::elastic::outliers::LEFT_OUT;
use crate::measurement::noise::{InstrumentNoise, Scales};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::ErrorSummary;
use crate::verification::arm::BlobArm;
use crate::verification::drift_test::{Columns, Test};
use crate::verification::estimate::{Fit, alternatives, change, lengths, sensitivity};
use crate::verification::hypotheses::{Hypothesis, Part, base_effect, hypotheses, tool_effect};
use crate::verification::noise::{Factors, Parts};
use crate::verification::residuals::Placed;
use crate::verification::result::{Change, Report, RowError};

/// Noise to begin with where nothing is stated: a tracker's, m and rad.
const FIRST_GUESS: (f64, f64) = (30e-6, 50e-6);
/// No instrument is quieter, m and rad.
const QUIETEST: (f64, f64) = (1e-6, 1e-6);
/// Rounds of noise, and of what the calibration leaves unknown under that noise.
const ROUNDS: usize = 3;
/// Fewest degrees of freedom to find the noise from.
const FEWEST_FREEDOM: usize = 6;

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Rate of false alarms.
    pub false_alarms: f64,
    /// Whether the instrument was set up anew.
    pub refit_base: bool,
    /// Whether the target was mounted anew.
    pub refit_tool: bool,
    /// What is known of all measurements; goes before what each row states.
    pub instrument: InstrumentNoise,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            false_alarms: 0.01,
            refit_base: false,
            refit_tool: false,
            instrument: InstrumentNoise::UNKNOWN,
        }
    }
}

/// Why nothing can be said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CheckError {
    /// Too few measurements.
    #[error("{poses} poses, {equations} equations")]
    TooFew {
        /// Rows.
        poses: usize,
        /// Equations that they give.
        equations: usize,
        /// Rows that are needed at least.
        needed: usize,
    },
    /// A matrix could not be factored.
    #[error("residuals that cannot be weighed: are these measurements of this robot?")]
    Unsolvable,
}

/// Checks `loaded` by `samples` (poses `instrument_from_target`); `tools` are the frames of the tools that they name,
/// `first_target_from_target`, and mean nothing when tools are fitted anew. `lines` are those of the samples in their file.
///
/// # Errors
/// [`CheckError`].
pub fn check(
    loaded: &LoadedBlob,
    samples: &[InstrumentSample],
    tools: Vec<Pose<f64>>,
    lines: &[usize],
    options: &Options,
) -> Result<Report, CheckError> {
    let with_noise = |s: &InstrumentSample| s.clone().with_noise(options.instrument);
    let samples: &Vec<InstrumentSample> = &samples.iter().map(with_noise).collect();
    enough(loaded, samples, options)?;
    let placed = Placed::new(loaded, samples, tools, options);
    let arm = BlobArm::new(loaded, &placed.tools);
    let weighed = Weighed::new(&placed, &arm)?;
    let scales = weighed.scales;
    let nuisance = weighed.nuisance(options);
    let all: Vec<Hypothesis> = weighed
        .all
        .iter()
        .filter(|h| {
            !(options.refit_base && h.part == Part::Base
                || options.refit_tool && h.part == Part::Tool)
        })
        .cloned()
        .collect();
    let effects: Vec<Columns> = all
        .iter()
        .map(|h| columns(&weighed.whiten(&h.effect)))
        .collect();
    let numbers: Vec<usize> = all.iter().map(|h| number(h.part)).collect();
    let y = &weighed.y;
    let (white, free) = (weighed.whiten(y), columns(&weighed.whiten(&nuisance)));
    let test = Test::new(&white, &free, &effects, numbers, weighed.absent);
    let choices = test.choose(options.false_alarms);
    let taken: Vec<usize> = choices.iter().map(|c| c.hypothesis).collect();
    let chosen: Vec<&Hypothesis> = taken.iter().map(|h| &all[*h]).collect();
    let fit = Fit::new(&weighed, &nuisance, &chosen).ok_or(CheckError::Unsolvable)?;
    let reach = test.reach() * test.variance().sqrt();
    let changes = choices.iter().enumerate().map(|(i, choice)| Change {
        or_else: alternatives(&test, &all, &taken, i, options.false_alarms),
        ..change(&all[choice.hypothesis], fit.of(i), reach, choice.p_value)
    });
    let effect = fit.effect();
    let left = y - fit.free() - &effect;
    let errors = placed.errors();
    Ok(Report {
        errors: ErrorSummary::new(&errors),
        rows: errors
            .iter()
            .enumerate()
            .map(|(k, error)| RowError {
                line: lines.get(k).copied().unwrap_or(0),
                position_mm: error.position_mm,
            })
            .collect(),
        false_alarm_rate: options.false_alarms,
        changes: changes.collect(),
        effect_mm: lengths(&effect, samples, scales),
        without_mm: lengths(&left, samples, scales),
        noise_mm: 1e3 * scales.position * weighed.factors[0].sqrt(),
        noise_mrad: samples
            .iter()
            .any(|s| s.observation.has_orientation())
            .then_some(1e3 * scales.orientation * weighed.factors[1].sqrt()),
        model_mm: weighed.model_mm,
        model_knows_its_error: arm.knows_its_error,
        sensitivity: sensitivity(&test, &all, options.false_alarms),
        odd_lines: odd(&left, samples, scales, lines),
    })
}

fn enough(
    loaded: &LoadedBlob,
    samples: &[InstrumentSample],
    options: &Options,
) -> Result<(), CheckError> {
    let equations = samples.iter().map(|s| s.observation.equations());
    let each = equations.max().unwrap_or(ROWS);
    // Each tool that is mounted anew is an unknown of its own.
    let tools = if options.refit_tool {
        tool_count(samples)
    } else {
        1
    };
    // Base, tool (of positions alone, where its target is), joints and payload.
    let unknowns = 6 + each * tools + loaded.model().joints() + 1 + FEWEST_FREEDOM;
    let needed = unknowns.div_ceil(each);
    if samples.len() < needed {
        return Err(CheckError::TooFew {
            poses: samples.len(),
            equations: each * samples.len(),
            needed,
        });
    }
    Ok(())
}

/// The residuals with their covariance.
struct Weighed<'a> {
    arm: &'a BlobArm,
    samples: &'a [InstrumentSample],
    /// Units of the rows.
    scales: Scales,
    /// Residuals.
    y: Mat<f64>,
    /// Effects of everything that is looked for.
    all: Vec<Hypothesis>,
    base: Mat<f64>,
    tool: Mat<f64>,
    /// Variances of the noise in units of the scales.
    factors: Factors,
    /// Of one position component, mm.
    model_mm: f64,
    /// Rows that are not there: orientations of positions alone.
    absent: usize,
    lower: Mat<f64>,
}

impl<'a> Weighed<'a> {
    fn new(placed: &'a Placed<'_>, arm: &'a BlobArm) -> Result<Self, CheckError> {
        let samples = placed.samples;
        let quietest = InstrumentNoise::quietest(samples);
        let mut scales = Scales {
            quietest,
            ..Scales::uniform(
                quietest.position.unwrap_or(FIRST_GUESS.0),
                quietest.orientation.unwrap_or(FIRST_GUESS.1),
            )
        };
        let kind = kinds(samples);
        let mut round = 0;
        loop {
            let at = arm.linearise(samples, scales);
            let y = placed.residuals(scales);
            let payload = placed.payload_effect(scales);
            let all = hypotheses(arm, &at, samples, payload);
            let fixed = arm
                .error_covariance(samples, &at, scales)
                .ok_or(CheckError::Unsolvable)?;
            let smooth = (!arm.knows_its_error).then(|| arm.smooth_covariance(samples, &at));
            let stated: Vec<f64> = at.common_share.iter().map(|share| 1.0 - share).collect();
            let parts = Parts {
                fixed: &fixed,
                stated: &stated,
                kind: &kind,
                smooth: smooth.as_ref(),
            };
            let least = [
                (quietest.position.unwrap_or(QUIETEST.0) / scales.position).powi(2),
                (quietest.orientation.unwrap_or(QUIETEST.1) / scales.orientation).powi(2),
                0.0,
            ];
            let effects: Columns = all.iter().flat_map(|h| columns(&h.effect)).collect();
            let free = drift_test::basis(&effects, &[]);
            let x = Mat::from_fn(y.nrows(), free.len(), |i, j| free[j][i]);
            let factors = parts.fitted(&y, &x, &least).ok_or(CheckError::Unsolvable)?;
            round += 1;
            if round < ROUNDS {
                scales.position *= factors[0].sqrt();
                scales.orientation *= factors[1].sqrt();
                continue;
            }
            let covariance = parts.covariance(&factors);
            let known =
                |i: usize| fixed[(i, i)] + smooth.as_ref().map_or(0.0, |s| factors[2] * s[(i, i)]);
            let positions: Vec<usize> = (0..kind.len()).filter(|i| kind[*i] == Some(0)).collect();
            let variance =
                positions.iter().map(|i| known(*i)).sum::<f64>() / positions.len() as f64;
            let lower = covariance.llt(Side::Lower);
            return Ok(Self {
                arm,
                samples,
                scales,
                y,
                base: base_effect(&at),
                tool: tool_effect(arm, &at, samples),
                all,
                factors,
                model_mm: 1e3 * scales.position * variance.max(0.0).sqrt(),
                absent: kind.iter().filter(|k| k.is_none()).count(),
                lower: lower.map_err(|_| CheckError::Unsolvable)?.L().to_owned(),
            });
        }
    }

    /// L⁻¹ x.
    fn whiten(&self, x: &Mat<f64>) -> Mat<f64> {
        let mut out = x.clone();
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(
            self.lower.as_ref(),
            out.as_mut(),
            faer::Par::Seq,
        );
        out
    }

    /// What is free in any case: base and tools that were set up anew.
    fn nuisance(&self, options: &Options) -> Mat<f64> {
        let mut free: Columns = Vec::new();
        if options.refit_base {
            free.extend(columns(&self.base));
        }
        if options.refit_tool {
            // Each tool was mounted by itself.
            for tool in 0..self.arm.state.tools.len() {
                free.extend(columns(&self.tool).into_iter().map(|mut column| {
                    for (k, s) in self.samples.iter().enumerate() {
                        if s.tool != tool {
                            column[ROWS * k..ROWS * (k + 1)].fill(0.0);
                        }
                    }
                    column
                }));
            }
        }
        Mat::from_fn(self.y.nrows(), free.len(), |i, j| free[j][i])
    }
}

/// Which noise every row has: 0 of position, 1 of rotation; none where it is not there.
fn kinds(samples: &[InstrumentSample]) -> Vec<Option<usize>> {
    let of = |s: &InstrumentSample| {
        let rotation = s.observation.has_orientation().then_some(1);
        [Some(0), Some(0), Some(0), rotation, rotation, rotation]
    };
    samples.iter().flat_map(of).collect()
}

fn columns(x: &Mat<f64>) -> Columns {
    (0..x.ncols())
        .map(|j| (0..x.nrows()).map(|i| x[(i, j)]).collect())
        .collect()
}

/// A number for each part.
fn number(part: Part) -> usize {
    match part {
        Part::Base => 0,
        Part::Tool => 1,
        Part::Payload => 2,
        Part::Joint(joint) => 2 + joint,
    }
}

/// Lines of measurements that stand out from all others, once what has moved is taken out.
fn odd(
    left: &Mat<f64>,
    samples: &[InstrumentSample],
    scales: Scales,
    lines: &[usize],
) -> Vec<usize> {
    let row = |k: usize| std::array::from_fn::<f64, ROWS, _>(|i| left[(ROWS * k + i, 0)]);
    let in_units = |k: usize| {
        let own = scales.of(&samples[k]);
        let r = row(k);
        [0, 1, 2, 3, 4, 5].map(|i| r[i] * if i < 3 { own.position } else { own.orientation })
    };
    let all: Vec<[f64; ROWS]> = (0..samples.len()).map(in_units).collect();
    let robust = Scales::robust(&all, samples);
    let far = |k: &usize| {
        let own = robust.of(&samples[*k]);
        let square = |i: usize| {
            let sigma = if i < 3 { own.position } else { own.orientation };
            (all[*k][i] / sigma).powi(2)
        };
        let components = samples[*k].observation.equations();
        (0..components).map(square).sum::<f64>() > LEFT_OUT
    };
    (0..samples.len())
        .filter(far)
        .map(|k| lines.get(k).copied().unwrap_or(0))
        .collect()
}
