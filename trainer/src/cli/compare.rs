//! `trainer compare`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::arguments::{Compare, FitArguments, Outliers};
use crate::cli::page;
use crate::cli::page::read_test;
use crate::cli::report::Report;
use crate::cli::{
    Arm, Failure, calibration_failure, check_outputs, device_failure, drift, enough_poses,
    equations, file_name, instrument_noise, json_text, origin, progress, write_outputs,
};
use crate::report::{Evidence, HeldOutFacts, How, Provenance};
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::{Drift, DriftReport};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::config::{Config, ProcessLayout, Weighting};
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::validation::cross_validation::{ModelComparison, Task, TestSet, applicable};
use poegp_calibration::validation::learning_curve as learning;

/// What `--json` writes.
#[derive(Serialize)]
pub struct Document<'a> {
    /// Version of the trainer.
    pub version: &'static str,
    /// Seed of the draw of folds.
    pub seed: u64,
    /// Config of the fit.
    pub per_output: bool,
    /// Config of the fit.
    pub weighted: bool,
    /// One entry for each method.
    pub models: &'a [ModelComparison],
    /// With `--report`: what it shows, of the test sets or of the folds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOutFacts>,
    /// Where this comes from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
    /// With `--correct-drift`: what was taken out of the data of `models`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift: Option<&'a DriftReport>,
    /// With `--correct-drift`: the same methods on the data as they were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub models_without_correction: Option<&'a [ModelComparison]>,
}

impl FitArguments {
    /// How to calibrate by `method`.
    pub fn config(&self, method: Method) -> Config {
        let layout = match (self.tied, self.support_per_output) {
            (_, Some(_)) => ProcessLayout::PerJointSets,
            (true, None) => ProcessLayout::Shared,
            (false, None) => ProcessLayout::PerJoint,
        };
        Config {
            weighting: match self.weighted {
                true => Weighting::Noise,
                false => Weighting::None,
            },
            hyperparameters: match self.per_output {
                true => HyperparameterSharing::PerOutput,
                false => HyperparameterSharing::Shared,
            },
            layout,
            inducing_points: match self.support_per_output {
                Some(functions) => Some(functions as usize),
                None => self.support.0,
            },
            device_variance: !self.no_device_sigma,
            outliers: match self.outliers {
                Outliers::Report => OutlierPolicy::Keep,
                Outliers::Reject => OutlierPolicy::Reject,
            },
            gravity_m_s2: self.gravity.0,
            position_sigma_mm: self.position_sigma_mm,
            orientation_sigma_mrad: self.orientation_sigma_mrad,
            ..Config::new(method)
        }
    }
}

pub fn run(a: &Compare) -> Result<(), Failure> {
    let output = [a.json.as_deref(), a.report.as_deref()];
    let inputs = [a.train.as_path(), Path::new(&a.robot.robot)];
    let inputs: Vec<&Path> = inputs
        .into_iter()
        .chain(a.tests.iter().map(PathBuf::as_path))
        .collect();
    check_outputs(&output, &inputs)?;
    if a.folds == 1 {
        return Err(Failure::Usage(
            "--folds 1 leaves nothing to train on: use 0 for none, or at least 2".into(),
        ));
    }
    if a.report.is_some() && a.folds == 0 && a.tests.is_empty() {
        return Err(Failure::Usage(
            "--folds 0 without --test holds nothing out: the report would be empty".into(),
        ));
    }
    let arm = Arm::load(&a.robot)?;
    let mut tools = Vec::new();
    let SampleFile {
        set,
        samples: train,
        ..
    } = arm.read(&a.train, &mut tools, DriftCorrection::None)?;
    let drift = a.correct_drift.then(|| Drift::estimate(&set)).transpose()?;
    let trained_tools = tools.len();
    if a.folds > train.len() {
        return Err(Failure::Usage(format!(
            "--folds {} for {} poses",
            a.folds,
            train.len()
        )));
    }
    let (mut tests, mut corrected_tests, mut test_files) = (Vec::new(), Vec::new(), Vec::new());
    for path in &a.tests {
        let none = DriftCorrection::None;
        let SampleFile { set, samples, .. } =
            read_test(&arm, path, &mut tools, trained_tools, none)?;
        let name = file_name(path);
        if let Some(drift) = &drift {
            let samples = Drift::estimate_as(&set, drift)?.correct(&samples);
            let name = name.clone();
            corrected_tests.push(TestSet { name, samples });
        }
        tests.push(TestSet { name, samples });
        test_files.push(set);
    }
    let methods = methods(a, &train, &tests)?;
    // A fold may be larger than its share by one group of equal configurations; the calibration itself checks again.
    let smallest = if a.folds == 0 {
        train.len()
    } else {
        train.len() - train.len().div_ceil(a.folds)
    };
    for method in &methods {
        enough_poses(
            &a.train,
            smallest,
            equations(&train),
            *method,
            arm.robot.joints.len(),
        )?;
    }
    let corrected = drift.as_ref().map(|drift| drift.correct(&train));
    let origin = origin(set.sha256, "", tools);
    let task = Task {
        robot: &arm.robot,
        train: &train,
        tests: &tests,
        folds: a.folds,
        seed: a.seed,
        origin: &origin,
    };
    instrument_noise(a.fit.position_sigma_mm, a.fit.orientation_sigma_mrad)?;
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
    let mut shown = None;
    if a.report.is_some() {
        let sets = if a.tests.is_empty() {
            vec![&set]
        } else {
            test_files.iter().collect()
        };
        let evidence = evidence(a, &last_task, &models, &sets)?;
        let from = &a.robot.robot;
        let seed = Some(a.seed);
        let provenance = page::provenance(from, &arm, &origin, seed, &set, &test_files);
        let facts = evidence.facts();
        let html = page::of_comparison(&provenance, &evidence, &facts);
        shown = Some((facts, provenance, html));
    }
    let (facts, provenance, html) = shown.map_or((None, None, None), |(facts, from, html)| {
        (Some(facts), Some(from), Some(html))
    });
    let mut json = None;
    if a.json.is_some() {
        let document = Document {
            version: env!("CARGO_PKG_VERSION"),
            seed: a.seed,
            per_output: a.fit.per_output,
            weighted: a.fit.weighted,
            models: &models,
            held_out: facts,
            provenance,
            drift: drift.as_ref().map(|d| &d.report),
            models_without_correction: uncorrected.as_deref(),
        };
        json = Some(json_text(&document)?);
    }
    let texts = [(&a.json, &json), (&a.report, &html)];
    let texts = texts
        .iter()
        .filter_map(|(path, text)| path.as_deref().zip(text.as_deref()));
    let files: Vec<(&Path, &[u8])> = texts.map(|(path, text)| (path, text.as_bytes())).collect();
    write_outputs(&files)?;
    let report = Report::beside(&output);
    match (&drift, &uncorrected) {
        (Some(drift), Some(uncorrected)) => {
            report.line(drift.report.lines().join("\n"));
            report.line(drift::NO_LEAK);
            report.line("");
            print(
                report,
                &[(uncorrected, ""), (&models, ", drift corrected")],
                a,
            );
        }
        _ => print(report, &[(&models, "")], a),
    }
    if let Some(path) = &a.report {
        report.line(format_args!(
            "\nWrote {}: open it in a browser.",
            path.display()
        ));
    }
    Ok(())
}

/// What the report shows: `models`, with base and tool alone for comparison when that was not asked for, and the learning
/// curve of the best one.
fn evidence(
    a: &Compare,
    task: &Task,
    models: &[ModelComparison],
    sets: &[&MeasurementSet],
) -> Result<Evidence, Failure> {
    let mut all = models.to_vec();
    if !models.iter().any(|m| m.model == Method::BaseTool.name()) {
        let first = task.run(&a.fit.config(Method::BaseTool), &mut || ());
        all.insert(0, first.map_err(|e| device_failure(&a.train, e.error))?);
    }
    let how = if a.tests.is_empty() {
        How::CrossValidation {
            folds: a.folds,
            seed: a.seed,
        }
    } else {
        How::TestSets
    };
    let kinds: Vec<_> = task.robot.joints.iter().map(|j| j.kind).collect();
    let nothing = || Failure::Usage("the report has no held-out pose to show".into());
    let mut evidence = Evidence::new(how, sets, &all, &kinds, false).ok_or_else(nothing)?;
    let best = evidence.after().name.clone();
    if let Ok(method) = best.parse::<Method>() {
        let options = a.fit.config(method);
        let bar = progress::bar(learning::sizes(task, &options).len(), "learning curve");
        let poses = evidence.after().poses.clone();
        evidence.learning = learning::curve(task, &options, &poses, &mut || bar.inc(1));
        bar.finish_and_clear();
    }
    Ok(evidence)
}

/// The methods asked for, or all that the data allow; where a payload is needed every file must have one.
fn methods(
    a: &Compare,
    train: &[InstrumentSample],
    tests: &[TestSet],
) -> Result<Vec<Method>, Failure> {
    let mut methods: Vec<Method> = a.models.iter().map(|m| Method::from(*m)).collect();
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

/// One table of all `runs`, each with what is said after the names of its sets.
fn print(report: Report, runs: &[(&Vec<ModelComparison>, &str)], a: &Compare) {
    report.line("Held-out errors: position in mm, orientation in mrad.");
    if a.folds > 0 {
        report.line(format_args!(
            "{} folds drawn with seed {}; equal configurations are never split.",
            a.folds, a.seed
        ));
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
            row.push(errors.orientation_cell());
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
