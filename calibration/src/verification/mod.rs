//! Checks whether a calibration still holds: ten to twenty fresh measurements are compared with the blob's predictions.
//!
//! The check answers three separate questions:
//!
//! - **How large is the error now?** Mean, 95 % and largest error, as `evaluate` reports them.
//! - **Are the errors those that the model expects?** What no drift explains is compared with what the blob states
//!   ([`unexplained`]).
//! - **Has something moved?** A change of the base, the tool, the zero of one joint or the mass of the payload is fitted to
//!   the residuals. These are weighted by their covariance, which has three parts: the noise of the measurements, found from
//!   the residuals whatever has moved ([`noise`]); what the calibration did not know, from the blob itself ([`arm`]); and
//!   what a row states of itself. An alarm is raised at a stated rate of false alarms ([`drift_test`]). What moved while the
//!   rows were measured is found first. Rows with a payload that the model was never trained with say nothing.
//!
//! All equations are linear, because a drift is millimetres and milliradians. A base or a tool that was set up again is
//! fitted first and then is free in the test.

pub mod arm;
pub mod columns;
pub mod drift_test;
mod during;
mod estimate;
pub mod hypotheses;
pub mod noise;
mod options;
mod payload;
pub mod result;
pub mod touches;
mod unchanged;
pub mod unexplained;
pub mod unknown_frames;
mod whitened;

use poegp_runtime::math::se3::Pose;

use crate::blob::fitted_frames::{FittedFrames, Registered, evenly_spaced};
use crate::blob::predict::BlobModel;
use crate::identification::parametric::state::ROWS;
use crate::learning::elastic::outliers::LEFT_OUT;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::{InstrumentSample, different_poses};
use crate::measurement::samples::Samples;
use crate::numeric::matrix::Mat;
use crate::numeric::statistics::ErrorSummary;
use crate::validation::held_out::HeldOutPose;
use crate::verification::arm::BlobArm;
use crate::verification::columns::{Columns, columns};
use crate::verification::drift_test::DriftTest;
use crate::verification::estimate::{Fit, angles, can_be_found, changes, lengths, sensitivity};
use crate::verification::hypotheses::{Hypothesis, Part};
use crate::verification::result::{Report, RowError};
use crate::verification::unexplained::Unexplained;
use crate::verification::whitened::Whitened;

pub use crate::verification::options::Options;
pub use crate::verification::result::CheckError;

/// Largest median error of position and rotation, mm and mrad, for which measurements and predictions can be in the same
/// frames.
const SAME_FRAME: (f64, f64) = (10.0, 100.0);
/// Largest share of rows that may stand out from the others.
const MOST_ODD: f64 = 0.2;
/// Most rows in which changes are searched for, of a model without processes and of one that knows its error. Time grows with
/// their cube; the error of the former, which more rows do not lessen, hides what more rows would show.
const MOST_SEARCHED: (usize, usize) = (100, 300);
/// Fewest degrees of freedom to find the noise from.
const FEWEST_FREEDOM: usize = 6;

/// Checks `loaded` against `samples` (poses `instrument_from_target`).
///
/// A change is found from the rows whose payload the model was trained with and that do not stand out: one wrong row can look
/// like the change of another joint. Of more than 100 rows (300, if the model knows its error), as many evenly spread ones are
/// searched.
///
/// `tools` are the frames of the tools that the samples name, `first_target_from_target`; they are ignored where tools are
/// fitted. `lines` are the lines of the samples in their file.
pub fn check(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    tools: Vec<Pose<f64>>,
    lines: &[usize],
    options: &Options,
) -> Result<Report, CheckError> {
    let checked = |samples: &[InstrumentSample], lines: &[usize], searched: &[usize]| {
        check_rows(loaded, samples, tools.clone(), (lines, searched), options)
    };
    let all = checked(samples, lines, &[])?;
    if lines.len() != samples.len() {
        return showing(all);
    }
    let without = |left_out: &[usize], samples: &[InstrumentSample], lines: &[usize]| {
        let kept = samples.iter().zip(lines);
        let kept = kept.filter(|(_, line)| !left_out.contains(line));
        kept.map(|(sample, line)| (sample.clone(), *line)).unzip()
    };
    let untrained: Vec<usize> = (samples.iter().zip(lines))
        .filter(|(sample, line)| {
            is_untrained(loaded, sample) && all.rows.iter().any(|row| row.line == **line)
        })
        .map(|(_, line)| *line)
        .collect();
    let (samples, lines): (Vec<InstrumentSample>, Vec<usize>) = without(&untrained, samples, lines);
    let trained = match untrained.is_empty() {
        true => all.clone(),
        false => match checked(&samples, &lines, &[]) {
            Ok(found) => found,
            Err(_) => all.clone().unsearched(),
        },
    };
    let outlier_lines = trained.outlier_lines.clone();
    let searched_lines = trained.searched_lines.clone();
    let is_few =
        outlier_lines.len() as f64 <= MOST_ODD * trained.searched_rows(samples.len()) as f64;
    let mut found = trained;
    if found.is_searched && !outlier_lines.is_empty() && is_few {
        let (kept, rest): (Vec<InstrumentSample>, Vec<usize>) =
            without(&outlier_lines, &samples, &lines);
        found = checked(&kept, &rest, &searched_lines).unwrap_or(found);
    }
    found = match showing(found) {
        Err(_) if !untrained.is_empty() => all.clone().unsearched(),
        found => found?,
    };
    Ok(Report {
        errors: all.errors,
        rows: all.rows,
        poses: all.poses,
        outlier_lines,
        searched_lines,
        untrained_payload: untrained,
        ..found
    })
}

/// Returns `found` if its rows show a change of any part. A row that stands out hides all changes, so this is asked only once
/// such rows are left out.
fn showing(found: Report) -> Result<Report, CheckError> {
    let shows_nothing = found.sensitivity.iter().all(|s| s.smallest.is_none());
    match found.is_searched && shows_nothing {
        true => Err(CheckError::NothingShown),
        false => Ok(found),
    }
}

/// Returns whether the payload of a row is outside the range that the model was trained with.
fn is_untrained(loaded: &BlobModel, sample: &InstrumentSample) -> bool {
    let outside = |(kg, (light, heavy)): (f64, (f32, f32))| {
        // As the device reads it.
        let kg = kg as f32;
        kg < light || kg > heavy
    };
    let range = loaded.blob().ranges.payload_kg;
    sample.payload_kg.zip(range).is_some_and(outside)
}

/// Checks all of these rows; see [`check`]. Changes are searched for in the lines `searched`, or, without any, in as many
/// evenly spread rows as may be.
fn check_rows(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    tools: Vec<Pose<f64>>,
    (lines, searched): (&[usize], &[usize]),
    options: &Options,
) -> Result<Report, CheckError> {
    let frames = FittedFrames::new(loaded, samples, tools, options.frames)?;
    let (samples, lines) = compared((samples, lines), &frames, options);
    enough(loaded, &samples, &frames)?;
    let placed = Registered::new(loaded, &samples, &frames);
    let (errors, poses) = (placed.errors(), held_out(&placed));
    let summary = ErrorSummary::new(&errors);
    if !is_same_frame(&summary) {
        return Err(CheckError::OtherFrame {
            median_mm: summary.position_mm.median,
            median_mrad: summary.orientation_mrad.map_or(0.0, |o| o.median),
        });
    }
    let rows = errors.iter().zip(&lines).map(|(error, line)| RowError {
        line: *line,
        position_mm: error.position_mm,
    });
    let rows: Vec<RowError> = rows.collect();
    let arm = BlobArm::new(loaded, &placed.frames.tools);
    let chosen = chosen_rows(&lines, searched, arm.has_error_covariance);
    let samples: &Vec<InstrumentSample> = &chosen.iter().map(|k| samples[*k].clone()).collect();
    let lines: &Vec<usize> = &chosen.iter().map(|k| lines[*k]).collect();
    let placed = Registered::new(loaded, samples, &frames);
    let (weighed, during) = during::examine(&placed, &arm, Whitened::new(&placed, &arm, None)?)?;
    let scales = weighed.scales;
    let nuisance = weighed.nuisance(&frames, during.as_ref().map(|d| &d.change));
    let all = possible(&weighed, &frames);
    let test = drift_test(&weighed, &nuisance, &all).ok_or(CheckError::Unsolvable)?;
    let sensitivity = sensitivity(&test, &all, options.false_alarms);
    let choices = test.choose(options.false_alarms, |h| {
        can_be_found(&all[h], &sensitivity)
    });
    let chosen: Vec<&Hypothesis> = choices.iter().map(|c| &all[c.hypothesis]).collect();
    let y = &weighed.y;
    let fit = Fit::new((y, &weighed.factor), &nuisance, &chosen).ok_or(CheckError::Unsolvable)?;
    let moved = during
        .as_ref()
        .map(|d| fit.last_free(d.change.effect(&weighed.all).ncols()));
    let left = y - fit.free() - fit.effect();
    let effect = match &moved {
        Some(moved) => fit.effect() + moved,
        None => fit.effect(),
    };
    let noise_mm = weighed.noise_mm;
    let without_mm = lengths(&left, samples, scales);
    let model_mm = match arm.has_error_covariance {
        // What the calibration leaves unknown is stated by few numbers, and rather too large; the rows show no more than this.
        true => weighed.model_mm.min(excess(without_mm.rms, noise_mm)),
        false => weighed.model_mm,
    };
    Ok(Report {
        errors: summary,
        base_fitted: frames.is_base_fitted,
        tool_fitted: frames.is_tool_fitted.contains(&true),
        searched_lines: match lines.len() < rows.len() {
            true => lines.clone(),
            false => Vec::new(),
        },
        rows,
        false_alarm_rate: options.false_alarms,
        changes: changes(&test, &all, &choices, &fit, options.false_alarms),
        during: during.zip(moved).map(|(found, effect)| {
            found.moved(&effect, lines, |k| 1e3 * scales.of(&samples[k]).position)
        }),
        untrained_payload: Vec::new(),
        is_searched: true,
        effect_mm: lengths(&effect, samples, scales),
        without_mm,
        without_mrad: angles(&left, samples, scales),
        unexplained: Unexplained::new(loaded, samples, (&left, scales), fit.count()),
        noise_mm: arm.has_error_covariance.then_some(noise_mm),
        scatter_mm: (noise_mm * noise_mm + model_mm * model_mm).sqrt(),
        noise_mrad: samples
            .iter()
            .any(|s| arm.has_error_covariance && s.observation.has_orientation())
            .then_some(weighed.noise_mrad),
        model_mm,
        model_has_error_covariance: arm.has_error_covariance,
        sensitivity,
        outlier_lines: outliers(&left, samples, scales, lines),
        poses,
    })
}

/// Returns how far errors of this RMS length exceed noise of one component, as one component.
fn excess(rms_mm: f64, noise_mm: f64) -> f64 {
    (rms_mm * rms_mm / 3.0 - noise_mm * noise_mm)
        .max(0.0)
        .sqrt()
}

/// Returns the rows that are compared, with the noise that the instrument states at least, and their lines.
fn compared(
    (samples, lines): (&[InstrumentSample], &[usize]),
    frames: &FittedFrames,
    options: &Options,
) -> (Vec<InstrumentSample>, Vec<usize>) {
    let of = |i: usize| {
        let line = lines.get(i).copied().unwrap_or(0);
        (samples[i].clone().with_noise(options.instrument), line)
    };
    let compared = (0..samples.len()).filter(|i| !frames.left_out.contains(i));
    compared.map(of).unzip()
}

/// Returns the indices of the rows in which changes are searched for: those of the lines `searched`, or, without any, evenly
/// spread ones.
fn chosen_rows(lines: &[usize], searched: &[usize], has_error_covariance: bool) -> Vec<usize> {
    let most = match has_error_covariance {
        false => MOST_SEARCHED.0,
        true => MOST_SEARCHED.1,
    };
    let every: Vec<usize> = (0..lines.len()).collect();
    match searched {
        [] => evenly_spaced(&every, most),
        _ => (every.into_iter())
            .filter(|k| searched.contains(&lines[*k]))
            .collect(),
    }
}

/// Returns the hypotheses without those on frames that were set up again.
fn possible(weighed: &Whitened<'_>, frames: &FittedFrames) -> Vec<Hypothesis> {
    let mut samples = weighed.samples.iter();
    let are_tools_fitted = samples.all(|s| frames.is_tool_fitted[s.tool]);
    let is_possible = |h: &&Hypothesis| {
        !(frames.is_base_fitted && h.part == Part::Base || are_tools_fitted && h.part == Part::Tool)
    };
    weighed.all.iter().filter(is_possible).cloned().collect()
}

/// Creates the test of `all`; `nuisance` is free in any case. Returns `None` if an equation cannot be solved.
fn drift_test(
    weighed: &Whitened<'_>,
    nuisance: &Mat<f64>,
    all: &[Hypothesis],
) -> Option<DriftTest> {
    let effects: Vec<Columns> = all
        .iter()
        .map(|h| columns(&weighed.whiten(&h.effect)))
        .collect();
    let numbers: Vec<usize> = all.iter().map(|h| number(h.part)).collect();
    let white = weighed.whiten(&weighed.y);
    let free = columns(&weighed.whiten(nuisance));
    DriftTest::with_unchanged(
        (&white, Some(&weighed.unchanged)),
        &free,
        &effects,
        numbers,
        weighed.absent,
    )
}

fn held_out(placed: &Registered) -> Vec<HeldOutPose> {
    let base_from_instrument = placed.frames.instrument_from_base.inverse();
    let of = |(sample, predicted): (&InstrumentSample, &Pose<f64>)| {
        HeldOutPose::new(sample, &base_from_instrument, predicted)
    };
    placed
        .samples
        .iter()
        .zip(&placed.predicted())
        .map(of)
        .collect()
}

/// Runs [`check`] on a file of fresh measurements that was read after the tools of the blob.
pub fn verify(blob: &BlobModel, fresh: &Samples, options: &Options) -> Result<Report, CheckError> {
    let known = blob.tools().len();
    let is_only_one = known == 0 && fresh.tools.len() == 1;
    if let Some(name) = fresh.tools.get(known)
        && !(is_only_one || options.frames.tools)
    {
        return Err(CheckError::UnknownTool(name.to_string()));
    }
    let mut tools: Vec<Pose<f64>> = blob.tools().iter().map(|(_, pose)| *pose).collect();
    tools.resize_with(fresh.tools.len().max(known), Pose::identity);
    check(blob, fresh, tools, &fresh.lines, options)
}

/// Returns whether predictions with these errors can be in the same base and tool frames as the measurements.
pub fn is_same_frame(errors: &ErrorSummary) -> bool {
    let turn = errors.orientation_mrad.map_or(0.0, |o| o.median);
    errors.position_mm.median <= SAME_FRAME.0 && turn <= SAME_FRAME.1
}

fn enough(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    frames: &FittedFrames,
) -> Result<(), CheckError> {
    let equations = samples.iter().map(|s| s.observation.equations());
    let each = equations.max().unwrap_or(ROWS);
    // Each fitted tool is an unknown of its own.
    let tools = frames.is_tool_fitted.iter().filter(|fitted| **fitted);
    let tools = tools.count().max(1);
    // The unknowns are base, tool (from positions alone, the position of its target), joints and payload.
    let unknowns = 6 + each * tools + loaded.model().joints() + 1 + FEWEST_FREEDOM;
    let needed = unknowns.div_ceil(each);
    let poses = different_poses(samples);
    if poses < needed {
        return Err(CheckError::TooFew {
            poses,
            equations: each * poses,
            needed,
        });
    }
    Ok(())
}

/// Returns a number for each part.
fn number(part: Part) -> usize {
    match part {
        Part::Base => 0,
        Part::Tool => 1,
        Part::Payload => 2,
        Part::Size => 3,
        Part::Joint(joint) => 3 + joint,
    }
}

/// Returns the lines of measurements that stand out from all others once the change of what has moved is removed.
fn outliers(
    left: &Mat<f64>,
    samples: &[InstrumentSample],
    scales: NoiseScales,
    lines: &[usize],
) -> Vec<usize> {
    let row = |k: usize| std::array::from_fn::<f64, ROWS, _>(|i| left[(ROWS * k + i, 0)]);
    let in_units = |k: usize| {
        let own = scales.of(&samples[k]);
        let r = row(k);
        [0, 1, 2, 3, 4, 5].map(|i| r[i] * if i < 3 { own.position } else { own.orientation })
    };
    let all: Vec<[f64; ROWS]> = (0..samples.len()).map(in_units).collect();
    let robust = NoiseScales::robust(&all, samples);
    let far = |k: &usize| {
        let own = robust.of(&samples[*k]);
        let square = |i: usize| {
            let sigma = if i < 3 { own.position } else { own.orientation };
            (all[*k][i] / sigma).powi(2)
        };
        let components = samples[*k].observation.equations();
        (0..components).map(square).sum::<f64>() > LEFT_OUT
    };
    (0..samples.len()).filter(far).map(|k| lines[k]).collect()
}
