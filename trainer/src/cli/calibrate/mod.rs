//! `trainer calibrate`.

pub mod args;
mod document;
pub mod elastic_summary;
pub mod gauge;
pub mod job;
mod made;
pub mod print;
mod project;
pub mod report_page;
pub mod touches;
mod written_project;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::cli::calibrate::args::Calibrate;
use crate::cli::calibrate::document::{document, outliers};
use crate::cli::calibrate::elastic_summary::ElasticSummary;
use crate::cli::calibrate::gauge::Known;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::made::Made;
use crate::cli::calibrate::project::{Data, payloads_and_tools};
use crate::cli::calibrate::written_project::Read;
use crate::cli::examination::Examined;
use crate::cli::failure::{Failure, device_failure};
use crate::cli::input::Input;
use crate::cli::inputs::{Arm, Tests, enough_poses, equations, origin};
use crate::cli::instrument_drift;
use crate::cli::output::{check_not_signed, check_outputs, json_text, write_with_blob};
use crate::cli::terminal::interrupt::cancellable;
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use crate::cli::tolerance;
use crate::cli::touches::features_of_a_table;
use crate::report::certificate::Certificate;
use crate::report::controller::ControllerSummary;
use crate::report::{FileSummary, ReportData};
use poegp_calibration::blob::write::{CalibratedBlob, DeviceError, Provenance, calibrate_in_gauge};
use poegp_calibration::measurement::folds::configurations;
use poegp_calibration::measurement::reader::SampleFile;
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::identified::of_calibration;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::trust::{Cause, Finding, Findings, Tier};
use poegp_calibration::validation::cross_validation::{Task, applicable};
use poegp_calibration::validation::device_budget::{BudgetTrial, TRIALS, fit_to_budget};
use poegp_calibration::validation::model_selection::{
    Choice, FOLDS, GAIN, candidates, folds, keep_named, named_and_simpler, select_model,
};
use poegp_calibration::validation::next_steps::{self, Knowledge, NextSteps};
use poegp_calibration::validation::work_volume::ExpectedError;

pub fn run(arguments: &Calibrate) -> Result<(), Failure> {
    let a = &Job::new(arguments)?;
    if touches::are_touches(a) {
        return touches::run(a);
    }
    let outputs = a.outputs();
    let mut inputs = vec![a.train.as_path(), Path::new(&a.robot)];
    inputs.extend(a.tests.iter().chain(&a.project).map(PathBuf::as_path));
    inputs.extend(a.gauge.inputs());
    check_outputs(&outputs, &inputs)?;
    check_not_signed(&a.out)?;
    let made = make(a)?;
    let json = json_text(&made.document)?;
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
    if a.features.is_some() {
        return Err(features_of_a_table(&a.train));
    }
    if !a.prior.is_empty() {
        return Err(Failure::Usage(format!(
            "found --prior with measurements of a tracker ({}), expected a touch file for it",
            a.train.display()
        )));
    }
    let mut config = a.config;
    if a.auto {
        config.method = Method::BaseTool;
    }
    let mut arm = Arm::load(&a.robot, &a.chain)?;
    arm.gravity = config.gravity_m_s2.into();
    let known = Known::read(&a.gauge, &arm.robot.name)?;
    let mut tools = Vec::new();
    let input = Input {
        path: &a.train,
        bytes: a.table.as_deref(),
    };
    let SampleFile {
        set,
        samples,
        drift,
        ..
    } = instrument_drift::read(&arm, &input, &mut tools, a.correct_drift)?;
    enough_poses(
        &a.train,
        (different_poses(&samples), samples.len()),
        equations(&samples),
        config.method,
        arm.robot.joints.len(),
    )?;
    let examined = Examined {
        path: &a.train,
        robot: &arm.robot,
        set: &set,
        samples: &samples,
        gravity: arm.gravity,
        json: a.json.as_deref(),
        accept: &a.accept,
    };
    let methods: &[Method] = if a.auto {
        &Method::ALL
    } else {
        &[a.config.method]
    };
    let mut warnings = examined.for_training(methods, &config)?;
    let tests = Tests::read(&arm, &a.tests, &set, &tools, drift.as_ref())?;
    let of_tests = tests.examine(&arm, &a.tests, a.json.as_deref(), &a.accept)?;
    report_page::check(a, &samples, config.method, arm.robot.joints.len())?;
    let mut origin = origin(set.sha256, &a.serial_number, tools);
    if let Some(date) = &a.date {
        origin.date.clone_from(date);
    }
    let choice = choose_model(a, &arm, &samples, &config, &origin)?;
    let mut findings = Findings::default();
    match &choice {
        Some(choice) => {
            config = choice.config;
            for out in &choice.left_out {
                note(format_args!(
                    "`{}` is not a candidate: {}",
                    out.candidate, out.reason
                ));
            }
            findings.0.extend(choice.findings());
        }
        // A method that these data do not allow fails with an error of its own.
        None if config.method != Method::BaseTool
            && applicable(&samples).contains(&config.method) =>
        {
            findings.0.push(too_few_to_show(different_poses(&samples)));
        }
        None => {}
    }
    warnings.extend(examined.settle(findings)?);
    origin.warnings = warnings.iter().map(|f| f.cause).collect();
    origin.accepted = a.accept.iter().copied().collect();
    let mut fitted = None;
    if !a.budget.is_unlimited() {
        if !a.auto && config.method != Method::Elastic {
            return Err(Failure::Usage(
                "--max-instructions and --max-blob-bytes choose the size of the elastic model"
                    .into(),
            ));
        }
        let (chosen, rows) = fit_budget(a, &arm, &samples, &config, &origin)?;
        config = chosen;
        fitted = Some(rows);
    }
    let found = progress::calibrating(|context| {
        calibrate_in_gauge(
            &arm.robot,
            &samples,
            &config,
            &known.choice,
            &origin,
            context,
        )
    })?;
    let found = found.map_err(|e| device_failure(&a.train, e))?;
    let train = (&set, samples.as_slice());
    let evidence = report_page::held_out(a, &arm, train, &tests, &config, &origin, &found)?;
    let CalibratedBlob {
        calibration,
        blob,
        precision_loss,
    } = &found;
    let trained_on = calibration.without_warm_up(calibration.trained_on(&samples));
    let training = ErrorSummary::new(&blob.errors(&trained_on));
    let seed = evidence.is_some().then_some(report_page::SEED);
    let mut provenance = report_page::provenance(&a.robot, &arm, &origin, seed, &set, &tests.files);
    let file = a.out.display().to_string();
    let written = FileSummary::of_bytes("result", file, blob.bytes());
    let sum = written.sha256.clone();
    provenance.files.push(written);
    let mut document = document(a, calibration, blob, precision_loss, training, provenance);
    document.gauge = Some(known.summary(calibration, blob, &samples)?);
    document.held_out = evidence.as_ref().map(ReportData::summary);
    document.certificate = evidence.as_ref().map(|evidence| {
        let drift = instrument_drift::known(drift.as_ref().map(|d| &d.report), &set);
        Certificate::new(evidence.judged(), &a.statement, drift, &a.serial_number)
    });
    document.elastic = ElasticSummary::new(calibration, &samples);
    document.outliers = outliers(calibration, &set, &samples);
    document.choice = choice.as_ref().map(|choice| choice.table.clone());
    document.chosen = choice.as_ref().map(Choice::reason);
    // The blob records only those about what it was trained on.
    document.warnings = [warnings, of_tests].concat();
    document.budget = fitted;
    document.drift = drift.map(|d| d.report);
    document.identifiability = of_calibration(calibration, &arm.robot, &samples);
    let knowledge = Knowledge::new(calibration, &arm.robot, &samples);
    let choice = choice.as_ref();
    let own = (knowledge.expected_error()).filter(|_| calibration.has_local_deviation());
    document.expected_error = own
        .map(|own| own.at_least(choice))
        .or_else(|| ExpectedError::new(calibration, &arm.robot, &samples, choice));
    document.next_steps = Some(NextSteps::new(&next_steps::Task {
        calibration,
        robot: &arm.robot,
        samples: &samples,
        knowledge: &knowledge,
        expected: document.expected_error,
        identifiability: document.identifiability.as_ref(),
        instrument_moved_mm: match a.correct_drift {
            true => None,
            false => instrument_drift::clear_motion(&set),
        },
        warnings: &document.warnings,
    }));
    document.controller = Some(ControllerSummary::new(
        blob,
        &arm.robot,
        knowledge.predictions(),
        evidence.as_ref(),
    ));
    document.repeats = a.repeats(&sum);
    let project = a.write_project.as_deref().map(|path| {
        let tests = a.tests.iter().zip(&tests.files);
        let read = Read {
            train: Data::of_set(&a.train, &set),
            features: None,
            tests: tests.map(|(path, set)| Data::of_set(path, set)).collect(),
            payloads_and_tools: payloads_and_tools(&set),
        };
        written_project::text(a, path, read, config, &origin.date, blob.bytes())
    });
    let shown = evidence.as_ref().zip(document.held_out.as_ref());
    let shown =
        shown.map(|(evidence, summary)| report_page::of_calibration(&document, evidence, summary));
    Ok(Made {
        report: shown,
        project,
        previous: known.previous.map(|(path, _)| path),
        document,
        found,
    })
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
        candidates.len() * folds(configurations(samples, &arm.robot.kinds()).len()),
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

/// Chooses the model that fits the budget; returns its configuration with the trials.
fn fit_budget(
    a: &Job,
    arm: &Arm,
    samples: &[InstrumentSample],
    options: &Config,
    origin: &Provenance,
) -> Result<(Config, Vec<BudgetTrial>), Failure> {
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
