//! `trainer calibrate`.

pub mod args;
mod calibrated;
mod document;
pub mod elastic_summary;
pub mod gauge;
mod held_out;
pub mod job;
mod kept_frames;
mod made;
mod measured;
pub mod print;
mod project;
pub mod provenance;
pub mod report_page;
pub mod touches;
mod written_project;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::cli::calibrate::args::Calibrate;
use crate::cli::calibrate::calibrated::Calibrated;
use crate::cli::calibrate::document::document;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::made::Made;
use crate::cli::calibrate::measured::Measured;
use crate::cli::failure::{Failure, device_failure};
use crate::cli::inputs::Arm;
use crate::cli::output::{check_not_signed, check_outputs, document_text, write_with_blob};
use crate::cli::terminal::interrupt::cancellable;
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use crate::cli::tolerance;
use crate::cli::touches::features_of_a_table;
use crate::report::controller::ControllerSummary;
use poegp_calibration::blob::write::{DeviceError, Provenance, calibrate_in_gauge};
use poegp_calibration::measurement::folds::held_out_together;
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::trust::{Cause, Finding, Findings, Tier};
use poegp_calibration::validation::cross_validation::{Task, applicable};
use poegp_calibration::validation::device_budget::{BudgetTrial, TRIALS, fit_to_budget};
use poegp_calibration::validation::model_selection::{
    Choice, FOLDS, GAIN, candidates, folds, keep_named, named_and_simpler, select_model,
};

pub fn run(arguments: &Calibrate) -> Result<(), Failure> {
    let a = &Job::new(arguments)?;
    if touches::are_touches(a) {
        return touches::run(a);
    }
    let mut inputs = vec![a.train.as_path(), Path::new(&a.robot)];
    inputs.extend(a.tests.iter().chain(&a.project).map(PathBuf::as_path));
    inputs.extend(a.gauge.inputs());
    let outputs = check_outputs(&a.outputs(), &inputs)?;
    check_not_signed(&a.out)?;
    let made = make(a)?;
    let json = document_text(&made.document)?;
    let controller = made.document.controller.as_ref();
    let csv = controller.map(ControllerSummary::to_csv);
    write_with_blob(
        (&a.out, made.found.blob.bytes()),
        &[
            (a.report.as_deref(), made.report.as_deref()),
            (a.json.as_deref(), Some(&json)),
            (a.write_project.as_deref(), made.project.as_deref()),
            (a.controller_csv.as_deref(), csv.as_deref()),
        ],
    )?;
    print::all(Printer::for_outputs(&outputs), a, &made);
    tolerance::outcome(made.document.certificate.as_ref(), &a.statement)
}

/// Calibrates as the job says, without writing anything.
///
/// # Errors
/// [`Failure`] about the inputs or about the result.
pub fn make(a: &Job) -> Result<Made, Failure> {
    refuse_options_of_touches(a)?;
    let mut config = a.config;
    if a.auto {
        config.method = Method::BaseTool;
    }
    let measured = Measured::read(a, &config)?;
    let (arm, samples) = (&measured.arm, measured.samples.as_slice());
    let examined = measured.examined(a);
    let methods: &[Method] = if a.auto {
        &Method::ALL
    } else {
        &[a.config.method]
    };
    let mut warnings = examined.for_training(methods, &config)?;
    warnings.extend(examined.settle(kept_frames::moved(&measured, &config))?);
    let tests = measured.tests(&a.tests)?;
    let of_tests = tests.examine(arm, &a.tests, a.json.as_deref(), &a.accept)?;
    held_out::check(a, samples, config.method, arm.robot.joints.len())?;
    let mut origin = measured.origin(a);
    let choice = choose_model(a, arm, samples, &config, &origin)?;
    let mut findings = findings_of_choice(choice.as_ref(), &measured, config.method);
    findings
        .0
        .retain(|found| !warnings.iter().any(|named| found.is_named_by(named)));
    if let Some(choice) = &choice {
        config = choice.config;
    }
    warnings.extend(examined.settle(findings)?);
    origin.warnings = warnings.iter().map(|f| f.cause).collect();
    origin.accepted = a.accept.iter().copied().collect();
    let mut trials = None;
    if !a.budget.is_unlimited() {
        let (fitting, tried) = fit_budget(a, arm, samples, &config, &origin)?;
        config = fitting;
        trials = Some(tried);
    }
    let found = progress::calibrating(|context| {
        let gauge = &measured.known.choice;
        calibrate_in_gauge(&arm.robot, samples, &config, gauge, &origin, context)
    })?;
    let found = found.map_err(|e| device_failure(&a.train, e))?;
    let calibrated = Calibrated {
        job: a,
        measured: &measured,
        tests: &tests,
        config: &config,
        origin: &origin,
        found: &found,
    };
    let evidence = held_out::held_out(&calibrated)?;
    // The blob records only those about what it was trained on.
    let warnings = [warnings, of_tests].concat();
    let mut document = document(&calibrated, evidence.as_ref(), choice.as_ref(), warnings)?;
    document.budget = trials;
    let shown = evidence.as_ref().zip(document.held_out.as_ref());
    Ok(Made {
        report: shown
            .map(|(evidence, summary)| report_page::of_calibration(&document, evidence, summary)),
        project: a
            .write_project
            .as_deref()
            .map(|path| calibrated.project(path)),
        previous: measured.known.previous().map(|(path, _)| path.clone()),
        document,
        found,
    })
}

/// Refuses options that belong to touches.
fn refuse_options_of_touches(a: &Job) -> Result<(), Failure> {
    if a.features.is_some() {
        return Err(features_of_a_table(&a.train));
    }
    if !a.prior.is_empty() {
        return Err(Failure::Usage(format!(
            "found --prior with measurements of a tracker ({}), expected a touch file for it",
            a.train.display()
        )));
    }
    Ok(())
}

/// Notes which candidates could not be compared, and returns what the choice says about the measurements; without a choice,
/// whether they are too few for one. `method` is that before the choice.
fn findings_of_choice(choice: Option<&Choice>, measured: &Measured, method: Method) -> Findings {
    let samples = measured.samples.as_slice();
    let mut findings = Findings::default();
    match choice {
        Some(choice) => {
            for out in &choice.left_out {
                note(format_args!(
                    "`{}` is not a candidate: {}",
                    out.candidate, out.reason
                ));
            }
            let rows = measured.set.measurements.iter();
            let lines: Vec<usize> = rows.map(|row| row.line).collect();
            findings.0.extend(choice.findings(&lines));
        }
        // A method that these data do not allow fails with an error of its own.
        None if method != Method::BaseTool && applicable(samples).contains(&method) => {
            findings.0.push(too_few_to_show(different_poses(samples)));
        }
        None => {}
    }
    findings
}

/// Creates the cross-validation within the training data by which models are chosen.
fn selection<'a>(
    arm: &'a Arm,
    samples: &'a [InstrumentSample],
    origin: &'a Provenance,
    cancel: &'a AtomicBool,
) -> Task<'a> {
    Task {
        robot: &arm.robot,
        train: samples,
        tests: &[],
        folds: FOLDS,
        seed: 1,
        origin,
        cancel,
        threads: threads(),
    }
}

/// Lets the training data choose the method, or compares the named method with simpler ones. Returns `None` if there are
/// too few poses to hold some out.
fn choose_model(
    a: &Job,
    arm: &Arm,
    samples: &[InstrumentSample],
    options: &Config,
    origin: &Provenance,
) -> Result<Option<Choice>, Failure> {
    let candidates = match a.auto {
        true => candidates(samples, &arm.robot, options),
        false => named_and_simpler(samples, &arm.robot, options),
    };
    if candidates.is_empty() || !a.auto && options.method == Method::BaseTool {
        return Ok(None);
    }
    let bar = progress::bar(
        candidates.len() * folds(held_out_together(samples, &arm.robot.kinds()).len()),
        "choosing the model",
    );
    let choice = cancellable(|cancel| {
        let task = selection(arm, samples, origin, cancel);
        match a.auto {
            true => select_model(&task, &candidates, &mut || bar.inc(1)),
            false => keep_named(&task, &candidates, &mut || bar.inc(1)),
        }
    });
    bar.finish_and_clear();
    choice?.map(Some).map_err(|e| match e.error {
        DeviceError::Export(error) if a.auto => Failure::Data(format!(
            "{}: {}: no candidate can be calibrated on a part of these poses ({error}); measure more poses",
            a.train.display(),
            Cause::Gain
        )),
        error => device_failure(&a.train, error),
    })
}

/// Creates the finding that there are too few poses to hold some out, so that nothing shows that the calibration helps.
fn too_few_to_show(poses: usize) -> Finding {
    let text = format!(
        "{poses} poses are too few to hold one out: nothing shows that a calibration helps; measure more poses"
    );
    Finding::new(Cause::Gain, Tier::Refused, text, 1.0, GAIN)
}

/// Chooses the elastic model that fits the budget; returns its configuration with the trials. Refuses another method.
fn fit_budget(
    a: &Job,
    arm: &Arm,
    samples: &[InstrumentSample],
    options: &Config,
    origin: &Provenance,
) -> Result<(Config, Vec<BudgetTrial>), Failure> {
    if !a.auto && options.method != Method::Elastic {
        return Err(Failure::Usage(
            "--max-instructions and --max-blob-bytes choose the size of the elastic model".into(),
        ));
    }
    let task = selection(arm, samples, origin, &NEVER);
    let bar = progress::bar(TRIALS * FOLDS, "fitting the budget");
    let found = fit_to_budget(&a.budget, &task, options, &mut || bar.inc(1));
    bar.finish_and_clear();
    found
        .map_err(|e| device_failure(&a.train, e.error))?
        .map_err(|smallest| {
            Failure::Quality(format!(
                "no model fits the budget: without inducing points, a command takes up to {} instructions and the blob {} bytes; \
                 nothing was written",
                smallest.instructions, smallest.bytes
            ))
        })
}
