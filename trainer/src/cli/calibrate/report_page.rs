//! `--report`: the held-out errors that the reports show, and the reports of `calibrate` and `compare`.

use indicatif::ProgressBar;

use crate::cli::calibrate::document::{CalibrateJson, TouchJson};
use crate::cli::calibrate::elastic_summary::ElasticSummary;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::made::Calibrated;
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::inputs::{Arm, enough_poses, equations};
use crate::cli::terminal::interrupt::own_flag;
use crate::cli::terminal::print::note;
use crate::cli::terminal::progress;
use crate::report::certificate::Certificate;
use crate::report::sections;
use crate::report::{
    FileSummary, HeldOutSummary, HoldOutMethod, Page, Provenance, ReportData, Section,
};
use poegp_calibration::blob;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::cross_validation::{
    ModelComparison, SetErrors, Task, TestSet, applicable,
};
use poegp_calibration::validation::learning_curve as learning;
use poegp_calibration::validation::model_selection::FOLDS;
use poegp_calibration::validation::touches::TouchResidual;

/// Seed of the folds of `calibrate`, which has no option for it.
pub const SEED: u64 = 1;

/// Refuses data with too few poses to hold some out, before the calibration begins.
pub fn check(
    a: &Job,
    samples: &[InstrumentSample],
    method: Method,
    joints: usize,
) -> Result<(), Failure> {
    let is_judged = a.statement.tolerances.is_stated();
    if a.report.is_none() && !is_judged || !a.tests.is_empty() {
        return Ok(());
    }
    let poses = different_poses(samples);
    let smallest = poses - poses.div_ceil(FOLDS);
    enough_poses(&a.train, (smallest, smallest), equations(samples), method, joints).map_err(|_| {
        InputError::new(
            &a.train,
            format!("{poses} different poses"),
            format!(
                "more poses: a report or a verdict holds out a fifth, and `{}` cannot be calibrated on the others",
                method.name()
            ),
        )
        .with_help("give --test FILE with held-out poses, measure more poses, or leave --report and the tolerances out")
        .into()
    })
}

/// Computes the held-out errors of a calibration: on the test sets with the new blob, otherwise by cross-validation.
/// Without a report it computes only the errors that `--test` asks for.
pub fn held_out(c: &Calibrated<'_>) -> Result<Option<ReportData>, Failure> {
    let (a, tests, config) = (c.job, c.tests, c.config);
    let is_judged = a.statement.tolerances.is_stated();
    if a.report.is_none() && !is_judged && tests.sets.is_empty() {
        return Ok(None);
    }
    let own = own_flag();
    let folds = if tests.sets.is_empty() { FOLDS } else { 0 };
    let task = Task {
        robot: &c.measured.arm.robot,
        train: &c.measured.samples,
        tests: &tests.sets,
        folds,
        seed: SEED,
        origin: c.origin,
        cancel: own.as_deref().unwrap_or(&NEVER),
        threads: threads(),
    };
    let methods = simpler_methods(c)?;
    let sizes = if a.report.is_some() {
        learning::sizes(&task, config).len()
    } else {
        0
    };
    let bar = progress::bar(
        methods.len() * task.calibrations() + folds + sizes,
        "held-out errors",
    );
    let mut models = compared(&task, &methods, &a.config, &bar);
    models.push(if tests.sets.is_empty() {
        task.run(config, &mut || bar.inc(1))
            .map_err(|e| device_failure(&a.train, e.error))?
    } else {
        let of = |test: &TestSet| SetErrors::new(&test.name, c.found.held_out(&test.samples));
        ModelComparison {
            model: config.method.name(),
            cross_validation: None,
            sets: tests.sets.iter().map(of).collect(),
        }
    });
    let (how, sets) = if tests.sets.is_empty() {
        let how = HoldOutMethod::CrossValidation { folds, seed: SEED };
        (how, vec![&c.measured.set])
    } else {
        (HoldOutMethod::TestSets, tests.files.iter().collect())
    };
    let kinds = c.measured.arm.nominal.kinds();
    let mut evidence = ReportData::new(how, &sets, &models, kinds, true);
    if let (Some(evidence), true) = (&mut evidence, sizes > 0) {
        bar.set_message("learning curve");
        let poses = evidence.calibrated().poses.clone();
        evidence.learning = learning::curve(&task, config, &poses, &mut || bar.inc(1));
    }
    bar.finish_and_clear();
    Ok(evidence)
}

/// Returns the methods below that of a calibration that its data and its tests allow; without a report, of these only the
/// base-tool fit. Refuses tests without the payloads that the calibration needs.
fn simpler_methods(c: &Calibrated<'_>) -> Result<Vec<Method>, Failure> {
    let (a, tests, own) = (c.job, &c.tests.sets, c.config.method);
    let loaded = |test: &TestSet| test.samples.iter().all(|s| s.payload_kg.is_some());
    let mut files = a.tests.iter().zip(tests);
    if own == Method::PoeGpLoad
        && let Some((path, _)) = files.find(|(_, test)| !loaded(test))
    {
        return Err(calibration_failure(path, &CalibrationError::NoPayload));
    }
    let whole = |test: &TestSet| {
        let mut samples = test.samples.iter();
        samples.all(|s| s.observation.has_orientation())
    };
    let mut methods = applicable(&c.measured.samples);
    methods.retain(|method| {
        *method < own
            && (a.report.is_some() || *method == Method::BaseTool)
            && (*method != Method::PoeGpLoad || tests.iter().all(loaded))
            && (!method.requires().whole_poses || tests.iter().all(whole))
    });
    Ok(methods)
}

/// Evaluates the methods that a calibration is compared with. One that fails is noted and left out.
fn compared(
    task: &Task<'_>,
    methods: &[Method],
    config: &Config,
    bar: &ProgressBar,
) -> Vec<ModelComparison> {
    let mut models = Vec::new();
    for method in methods {
        let config = Config {
            method: *method,
            max_correction_mm: None,
            max_correction_mrad: None,
            ..*config
        };
        match task.run(&config, &mut || bar.inc(1)) {
            Ok(model) => models.push(model),
            Err(error) => bar.suspend(|| {
                note(format_args!(
                    "`{}` is left out of the comparison: {}",
                    error.model, error.error
                ))
            }),
        }
    }
    models
}

/// Returns the provenance of a calibration: the files that were read.
pub fn provenance(c: &Calibrated<'_>, seed: Option<u64>) -> Provenance {
    let read = files_of_sets(&c.measured.set, &c.tests.files);
    provenance_of_files(&c.job.robot, &c.measured.arm, c.origin, seed, read)
}

/// Summarises the files of measurements that were read.
pub fn files_of_sets(train: &MeasurementSet, tests: &[MeasurementSet]) -> Vec<FileSummary> {
    let mut files = vec![FileSummary::of_set("training", train)];
    files.extend(tests.iter().map(|set| FileSummary::of_set("test", set)));
    files
}

/// Returns the provenance of a result: `files` that were read, and the robot's file if it has one.
pub fn provenance_of_files(
    robot: &str,
    arm: &Arm,
    origin: &blob::write::Provenance,
    seed: Option<u64>,
    mut files: Vec<FileSummary>,
) -> Provenance {
    // A built-in robot has no file; its name and the trainer's version identify it.
    if let Ok(bytes) = std::fs::read(robot) {
        files.push(FileSummary::of_bytes("robot", robot, &bytes));
    }
    let date = origin.date.clone();
    Provenance {
        seed,
        ..Provenance::new(&arm.robot.name, &origin.serial_number, date, files)
    }
}

/// Returns the provenance of a calibration by touches, including the blob that it made.
pub fn provenance_of_touches(
    robot: &str,
    arm: &Arm,
    origin: &blob::write::Provenance,
    set: &TouchSet,
) -> Provenance {
    let files = FileSummary::of_touches(set).to_vec();
    provenance_of_files(robot, arm, origin, None, files)
}

/// Creates a page with its title and the line below it.
fn page(what: &str, provenance: &Provenance) -> Page {
    Page::new(
        format!("{what} {}", provenance.arm()),
        format!("{}, poegp trainer {}", provenance.date, provenance.version),
    )
}

/// Renders the report of `calibrate`.
pub fn of_calibration(
    document: &CalibrateJson,
    evidence: &ReportData,
    summary: &HeldOutSummary,
) -> String {
    let elastic = document.elastic.as_ref();
    let limit = (document.correction_limit_mm, document.correction_limit_mrad);
    let serial_number = &document.provenance.serial_number;
    let next = document.next_steps.as_ref();
    let mut page = page("Calibration of", &document.provenance);
    if let Some(certificate) = &document.certificate {
        let live = document.controller.as_ref().map(|found| &found.live);
        page = page.with(sections::verdict(
            certificate,
            &document.warnings,
            live,
            next,
        ));
    }
    page = page
        .with(sections::headline(evidence, summary))
        .with(sections::next_steps(next));
    if let Some(certificate) = &document.certificate {
        page = page
            .with(sections::uncertainty_budget(certificate))
            .with(sections::record(certificate, serial_number));
    }
    sections::held_out(page, evidence, summary)
        .with(sections::parameters(
            document.identifiability.as_ref(),
            &document.frames,
            elastic.map_or(&[], |elastic| &elastic.ripple),
            elastic.and_then(ElasticSummary::listed_curve),
            elastic.and_then(|elastic| elastic.warm_up.as_ref()),
        ))
        .with(sections::controller(document.controller.as_ref()))
        .with(sections::outliers(
            evidence,
            summary,
            Ok(&document.outliers),
        ))
        .with(sections::choice(
            document.chosen.as_deref().zip(document.choice.as_deref()),
            &document.warnings,
            document.budget.as_deref(),
        ))
        .with(sections::device(
            &document.blob,
            limit,
            document.single_precision_loss_um,
        ))
        .with(sections::provenance(&document.provenance))
        .render()
}

/// Renders the report of `calibrate` by touches; `residuals` are those of the blob.
pub fn of_touches(document: &TouchJson, residuals: &[TouchResidual]) -> String {
    let found = &document.touches;
    let limit = (document.correction_limit_mm, document.correction_limit_mrad);
    let mut page = page("Calibration of", &document.provenance);
    if let Some(certificate) = &document.certificate {
        let live = Some(&document.controller.live);
        page = page.with(sections::verdict(
            certificate,
            &document.warnings,
            live,
            None,
        ));
    }
    page = page.with(sections::touch_headline(found));
    if let Some(certificate) = &document.certificate {
        page = page
            .with(sections::uncertainty_budget(certificate))
            .with(sections::record(
                certificate,
                &document.provenance.serial_number,
            ));
    }
    page.with(sections::touched(found, residuals))
        .with(sections::distances(found))
        .with(sections::unseen(found))
        .with(sections::touch_outliers(found))
        .with(sections::class(found))
        .with(sections::controller(Some(&document.controller)))
        .with(sections::device(
            &document.blob,
            limit,
            document.single_precision_loss_um,
        ))
        .with(sections::provenance(&document.provenance))
        .render()
}

/// Renders the report of `compare`.
pub fn of_comparison(
    provenance: &Provenance,
    evidence: &ReportData,
    summary: &HeldOutSummary,
    certificate: &Certificate,
    warnings: &[Finding],
) -> String {
    let page = page("Comparison of models for", provenance)
        .with(sections::verdict(certificate, warnings, None, None))
        .with(sections::headline(evidence, summary))
        .with(sections::uncertainty_budget(certificate));
    sections::held_out(page, evidence, summary)
        .with(sections::outliers(
            evidence,
            summary,
            Err("Outliers among the training poses are in the report of `trainer calibrate`."),
        ))
        .with(Section::new("parameters", "What is not here").missing(
            "A comparison makes models to compare them and keeps none. The parameters of the arm, the choice of the model \
             and the file for the controller are in the report of `trainer calibrate --report`.",
        ))
        .with(sections::provenance(provenance))
        .render()
}
