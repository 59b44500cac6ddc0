//! `trainer compare`.

use clap::Args;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::args::{FitArgs, RobotArgs, heading, method};
use crate::cli::calibrate::report_page;
use crate::cli::examination::{AcceptArgs, Examined};
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::input::Input;
use crate::cli::inputs;
use crate::cli::inputs::{Arm, KnownRows, enough_poses, equations, file_name, origin};
use crate::cli::instrument_drift;
use crate::cli::output::{check_outputs, json_text, write_texts};
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use crate::cli::tolerance::{self, ToleranceArgs, ToleranceTable};
use crate::report::certificate::{Certificate, Statement};
use crate::report::sections;
use crate::report::{HeldOutSummary, HoldOutMethod, Provenance, ReportData, never_held_out};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::{Drift, DriftReport};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::model::config::Weighting;
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::cross_validation::{ModelComparison, Task, TestSet, applicable};
use poegp_calibration::validation::learning_curve as learning;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct CompareJson<'a> {
    /// Version of the trainer.
    pub version: &'static str,
    /// Seed of the random division into folds.
    pub seed: u64,
    /// Setting of the fits: whether each output has its own hyperparameters.
    pub per_output: bool,
    /// Setting of the fits: weights of the measurements.
    pub weighting: Weighting,
    /// Warnings that the user must look at.
    pub warnings: &'a [Finding],
    /// One entry for each method.
    pub methods: &'a [ModelComparison],
    /// Held-out errors of the best method; present with `--report` or a tolerance.
    #[serde(flatten)]
    pub shown: Option<&'a HeldOutPart>,
    /// Drift that was removed from the data of `methods`; present with `--correct-drift`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift: Option<&'a DriftReport>,
    /// Results of the same methods on the data as they were measured; present with `--correct-drift`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub methods_without_correction: Option<&'a [ModelComparison]>,
}

/// The held-out part of a report, from the test sets or the folds.
#[derive(Serialize)]
pub struct HeldOutPart {
    /// Errors of the best method, before and after calibration.
    pub held_out: HeldOutSummary,
    /// Whether the arm conforms to the tolerance.
    pub certificate: Certificate,
    /// Provenance of the result.
    pub provenance: Provenance,
}

/// `trainer compare`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  trainer compare --robot abb-irb120 train.csv --test test1.csv --test test2.csv --folds 5\n  \
    trainer compare --robot abb-irb120 touches.csv --blob before.blob --blob after.blob"
)]
pub struct Compare {
    /// Measurements for training and cross-validation; with --blob, touches.
    pub train: PathBuf,
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Methods, separated by commas (default: all that the data allow).
    #[arg(long, value_name = "METHOD", value_delimiter = ',', value_parser = method())]
    pub methods: Vec<Method>,
    /// Models to compare on touches, without training; may be repeated.
    #[arg(long = "blob", value_name = "FILE")]
    pub blobs: Vec<PathBuf>,
    /// Held-out measurements; may be repeated.
    #[arg(long = "test", value_name = "FILE")]
    pub tests: Vec<PathBuf>,
    /// Number of folds of the cross-validation; 0 for none (default: 10).
    #[arg(long, value_name = "N")]
    pub folds: Option<usize>,
    /// Seed of the division into folds (default: 1).
    #[arg(long, value_name = "SEED")]
    pub seed: Option<u64>,
    /// Write an HTML report with errors and plots of the test sets, otherwise of the folds, or of the
    /// touches.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write the errors as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Description of the touched features (TOML; default: NAME.toml beside NAME.csv).
    #[arg(long, value_name = "FILE", help_heading = heading::MEASUREMENTS)]
    pub features: Option<PathBuf>,
    /// Remove the instrument's drift from every pose, estimated from reference points (columns ref1_x_mm …).
    #[arg(long, help_heading = heading::MEASUREMENTS)]
    pub correct_drift: bool,
    #[command(flatten, next_help_heading = heading::MEASUREMENTS)]
    pub accepted: AcceptArgs,
    #[command(flatten)]
    pub fit: FitArgs,
    #[command(flatten, next_help_heading = heading::TOLERANCE)]
    pub tolerance: ToleranceArgs,
}

impl Compare {
    fn folds(&self) -> usize {
        self.folds.unwrap_or(10)
    }

    fn seed(&self) -> u64 {
        self.seed.unwrap_or(1)
    }
}

pub fn run(a: &Compare) -> Result<(), Failure> {
    if !a.blobs.is_empty() {
        return Err(Failure::Usage(format!(
            "found --blob with {}, expected touches: on measured poses, compare models with `trainer evaluate`, one by \
             one",
            a.train.display()
        )));
    }
    let output = [a.json.as_deref(), a.report.as_deref()];
    let inputs = [a.train.as_path(), Path::new(&a.robot.robot)];
    let inputs: Vec<&Path> = inputs
        .into_iter()
        .chain(a.tests.iter().map(PathBuf::as_path))
        .collect();
    check_outputs(&output, &inputs)?;
    if a.folds() == 1 {
        return Err(Failure::Usage(
            "--folds 1 leaves nothing to train on: use 0 for none, or at least 2".into(),
        ));
    }
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let mut tools = Vec::new();
    let SampleFile {
        set,
        samples: train,
        ..
    } = arm.read(&Input::file(&a.train), &mut tools, DriftCorrection::None)?;
    let drift = a.correct_drift.then(|| Drift::estimate(&set)).transpose()?;
    let trained_tools = tools.len();
    if a.folds() > train.len() {
        return Err(Failure::Usage(format!(
            "--folds {}: expected at most the {} poses of the file",
            a.folds(),
            train.len()
        )));
    }
    let mut known = KnownRows::new(&set);
    let (mut tests, mut corrected_tests, mut test_files) = (Vec::new(), Vec::new(), Vec::new());
    for path in &a.tests {
        let none = DriftCorrection::None;
        let SampleFile {
            set: test, samples, ..
        } = inputs::read_test(&arm, path, &mut known, &mut tools, trained_tools, none)?;
        let name = file_name(path);
        if let Some(drift) = &drift {
            let samples = Drift::estimate_as(&test, drift)?.correct(&samples);
            let name = name.clone();
            corrected_tests.push(TestSet { name, samples });
        }
        tests.push(TestSet { name, samples });
        test_files.push(test);
    }
    let methods = methods(a, &train, &tests)?;
    a.fit.note_unused(&methods);
    if a.fit.no_variance {
        note("--no-variance has no effect: a comparison writes no blob");
    }
    // A fold may exceed its share by one group of equal configurations; the calibration itself checks its number of poses.
    let held_out = |rows: usize| {
        if a.folds() == 0 {
            0
        } else {
            rows.div_ceil(a.folds())
        }
    };
    let smallest = |rows: usize| rows - held_out(rows);
    let poses = smallest(different_poses(&train));
    for method in &methods {
        enough_poses(
            &a.train,
            (poses, smallest(train.len())),
            equations(&train),
            *method,
            arm.robot.joints.len(),
        )?;
    }
    let examined = Examined {
        path: &a.train,
        robot: &arm.robot,
        set: &set,
        samples: &train,
        json: a.json.as_deref(),
        accept: &a.accepted.accept,
    };
    let mut warnings = examined.for_training(&methods, &a.fit.config(Method::Elastic))?;
    let of_tests = (a.tests.iter().zip(&test_files).zip(&tests))
        .map(|((path, set), test)| (path.as_path(), set, test.samples.as_slice()));
    let accept = &a.accepted.accept;
    warnings.extend(inputs::examine_tests(
        &arm,
        of_tests,
        a.json.as_deref(),
        accept,
    )?);
    if a.folds() == 0 && a.tests.is_empty() {
        return Err(Failure::Usage(
            "--folds 0 without --test leaves no held-out errors to compare: give --test, or at least --folds 2"
                .into(),
        ));
    }
    let corrected = drift.as_ref().map(|drift| drift.correct(&train));
    let origin = origin(set.sha256, "", tools);
    let task = Task {
        robot: &arm.robot,
        train: &train,
        tests: &tests,
        folds: a.folds(),
        seed: a.seed(),
        origin: &origin,
        cancel: &NEVER,
        threads: threads(),
    };
    let rounds = 1 + usize::from(drift.is_some());
    let bar = progress::bar(rounds * methods.len() * task.calibrations(), "comparing");
    let run = |task: &Task| -> Result<Vec<ModelComparison>, Failure> {
        let run_one = |method: &Method| {
            bar.set_message(method.name());
            task.run(&a.fit.config(*method), &mut || bar.inc(1))
                .map_err(|e| device_failure(&a.train, e.error))
        };
        methods.iter().map(run_one).collect()
    };
    let mut models = run(&task)?;
    let mut uncorrected = None;
    let mut last_task = task;
    if let Some(train) = &corrected {
        let tests = &corrected_tests;
        uncorrected = Some(models);
        last_task = Task {
            train,
            tests,
            ..last_task
        };
        models = run(&last_task)?;
    }
    bar.finish_and_clear();
    let statement = Statement {
        tolerances: a.tolerance.completed(&ToleranceTable::default()).0,
        noise: a.fit.config(Method::Elastic).instrument_noise(),
        ..Statement::default()
    };
    let (mut shown, mut html) = (None, None);
    if a.report.is_some() || statement.tolerances.is_stated() {
        let sets = if a.tests.is_empty() {
            vec![&set]
        } else {
            test_files.iter().collect()
        };
        let evidence = evidence(a, &last_task, &models, &sets)?;
        let from = &a.robot.robot;
        let seed = Some(a.seed());
        let provenance = report_page::provenance(from, &arm, &origin, seed, &set, &test_files);
        let part = HeldOutPart {
            held_out: evidence.summary(),
            certificate: Certificate::new(
                evidence.judged(),
                &statement,
                instrument_drift::known(drift.as_ref().map(|d| &d.report), &set),
                &provenance.serial_number,
            ),
            provenance,
        };
        html = Some(report_page::of_comparison(
            &part.provenance,
            &evidence,
            &part.held_out,
            &part.certificate,
            &warnings,
        ));
        shown = Some(part);
    }
    let mut json = None;
    if a.json.is_some() {
        let document = CompareJson {
            version: env!("CARGO_PKG_VERSION"),
            seed: a.seed(),
            per_output: a.fit.per_output,
            weighting: a.fit.weighting.unwrap_or_default(),
            warnings: &warnings,
            methods: &models,
            shown: shown.as_ref(),
            drift: drift.as_ref().map(|d| &d.report),
            methods_without_correction: uncorrected.as_deref(),
        };
        json = Some(json_text(&document)?);
    }
    write_texts(&[
        (a.json.as_deref(), json.as_deref()),
        (a.report.as_deref(), html.as_deref()),
    ])?;
    let report = Printer::for_outputs(&output);
    match (&drift, &uncorrected) {
        (Some(drift), Some(uncorrected)) => {
            report.line(drift.report.lines().join("\n"));
            report.line(instrument_drift::NO_LEAK);
            report.line("");
            print(
                report,
                &[(uncorrected, ""), (&models, ", drift corrected")],
                train.len(),
                a,
            );
        }
        _ => print(report, &[(&models, "")], train.len(), a),
    }
    if let Some(path) = &a.report {
        report.line(format_args!(
            "\nWrote {}: open it in a browser.",
            path.display()
        ));
    }
    let certificate = shown.as_ref().map(|part| &part.certificate);
    if let Some(conformity) = certificate.and_then(|c| c.conformity.as_ref())
        && let Some(line) = sections::verdict_line(conformity)
    {
        report.line(format_args!("\nVerdict on the best model: {line}."));
    }
    tolerance::outcome(certificate, &statement)
}

/// Collects what the report shows: `models`, the base-tool fit for comparison if it is not among them, and the learning
/// curve of the best model.
fn evidence(
    a: &Compare,
    task: &Task,
    models: &[ModelComparison],
    sets: &[&MeasurementSet],
) -> Result<ReportData, Failure> {
    let mut all = models.to_vec();
    if !models.iter().any(|m| m.model == Method::BaseTool.name()) {
        let first = task.run(&a.fit.config(Method::BaseTool), &mut || ());
        all.insert(0, first.map_err(|e| device_failure(&a.train, e.error))?);
    }
    let how = if a.tests.is_empty() {
        HoldOutMethod::CrossValidation {
            folds: a.folds(),
            seed: a.seed(),
        }
    } else {
        HoldOutMethod::TestSets
    };
    let kinds = task.robot.kinds();
    let nothing = || Failure::Usage("the report has no held-out pose to show".into());
    let mut evidence = ReportData::new(how, sets, &all, &kinds, false).ok_or_else(nothing)?;
    let best = evidence.calibrated().name.clone();
    if let Ok(method) = best.parse::<Method>() {
        let options = a.fit.config(method);
        let bar = progress::bar(learning::sizes(task, &options).len(), "learning curve");
        let poses = evidence.calibrated().poses.clone();
        evidence.learning = learning::curve(task, &options, &poses, &mut || bar.inc(1));
        bar.finish_and_clear();
    }
    Ok(evidence)
}

/// Returns the methods that were asked for, or all that the data allow. Refuses a file without payloads if a method needs
/// them.
fn methods(
    a: &Compare,
    train: &[InstrumentSample],
    tests: &[TestSet],
) -> Result<Vec<Method>, Failure> {
    let mut methods: Vec<Method> = a.methods.clone();
    if methods.is_empty() {
        methods = applicable(train);
    }
    if methods.contains(&Method::PoeGpLoad) {
        let sets = std::iter::once((&a.train, train)).chain(
            a.tests
                .iter()
                .zip(tests.iter().map(|test| test.samples.as_slice())),
        );
        for (path, samples) in sets {
            if samples.iter().any(|sample| sample.payload_kg.is_none()) {
                return Err(calibration_failure(path, &CalibrationError::NoPayload));
            }
        }
    }
    Ok(methods)
}

/// Prints one table of all `runs`; the text of a run is appended to the names of its sets.
fn print(report: Printer, runs: &[(&Vec<ModelComparison>, &str)], rows: usize, a: &Compare) {
    report.line("Held-out errors: position in mm, orientation in mrad.");
    if a.folds() > 0 {
        report.line(format_args!(
            "{} folds drawn with seed {}; equal configurations are never split.",
            a.folds(),
            a.seed()
        ));
    }
    let first = runs.first().and_then(|(models, _)| models.first());
    let folds = first.and_then(|model| model.cross_validation.as_ref());
    let never = folds.and_then(|folds| never_held_out(rows - folds.rows.len()));
    if let Some(text) = never {
        report.line(text);
    }
    report.line("");
    let mut rows = Vec::new();
    let all = runs
        .iter()
        .flat_map(|(models, what)| models.iter().map(move |model| (model, *what)));
    for (model, what) in all {
        let folds = model
            .cross_validation
            .iter()
            .map(|cv| ("cross-validation", &cv.all, cv.coverage.clone()));
        let sets = model
            .sets
            .iter()
            .map(|s| (s.name.as_str(), &s.errors, s.coverage.clone()));
        for (name, errors, coverage) in folds.chain(sets) {
            let p = &errors.position_mm;
            let mut row = vec![
                model.model.to_owned(),
                format!("{name}{what}"),
                errors.poses.to_string(),
            ];
            row.extend([p.mean, p.median, p.p95, p.max].map(|x| format!("{x:.4}")));
            row.push(errors.orientation_text());
            row.push(coverage.map_or("–".to_owned(), |c| {
                format!(
                    "{:.0} / {:.0} %",
                    100.0 * c.all.one_sigma,
                    100.0 * c.all.two_sigma
                )
            }));
            rows.push(row);
        }
    }
    report.table(
        &[
            "model",
            "set",
            "poses",
            "mean",
            "median",
            "p95",
            "max",
            "orientation",
            "within 1σ / 2σ",
        ],
        &rows,
    );
}
