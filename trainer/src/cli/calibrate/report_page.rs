//! `--report`: the held-out errors that the reports show, and the reports of `calibrate` and `compare`.

use crate::cli::calibrate::document::{CalibrateJson, TouchJson};
use crate::cli::calibrate::elastic_summary::ElasticSummary;
use crate::cli::calibrate::job::Job;
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::inputs::{Arm, Tests, enough_poses, equations};
use crate::cli::terminal::interrupt::own_flag;
use crate::cli::terminal::progress;
use crate::report::certificate::Certificate;
use crate::report::sections;
use crate::report::{
    FileSummary, HeldOutSummary, HoldOutMethod, Page, Provenance, ReportData, Section,
};
use poegp_calibration::blob;
use poegp_calibration::blob::write::CalibratedBlob;
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
pub fn held_out(
    a: &Job,
    arm: &Arm,
    (set, samples): (&MeasurementSet, &[InstrumentSample]),
    tests: &Tests,
    options: &Config,
    origin: &blob::write::Provenance,
    found: &CalibratedBlob,
) -> Result<Option<ReportData>, Failure> {
    let is_judged = a.statement.tolerances.is_stated();
    if a.report.is_none() && !is_judged && tests.sets.is_empty() {
        return Ok(None);
    }
    let own = own_flag();
    let task = Task {
        robot: &arm.robot,
        train: samples,
        tests: &tests.sets,
        folds: if tests.sets.is_empty() { FOLDS } else { 0 },
        seed: SEED,
        origin,
        cancel: own.as_deref().unwrap_or(&NEVER),
        threads: threads(),
    };
    let loaded = |samples: &[InstrumentSample]| samples.iter().all(|s| s.payload_kg.is_some());
    if options.method == Method::PoeGpLoad
        && let Some(file) = a
            .tests
            .iter()
            .zip(&tests.sets)
            .find(|(_, set)| !loaded(&set.samples))
    {
        return Err(calibration_failure(file.0, &CalibrationError::NoPayload));
    }
    let whole =
        |samples: &[InstrumentSample]| samples.iter().all(|s| s.observation.has_orientation());
    let simpler = |method: &Method| {
        *method < options.method
            && (a.report.is_some() || *method == Method::BaseTool)
            && (*method != Method::PoeGpLoad || tests.sets.iter().all(|t| loaded(&t.samples)))
            && (!method.requires().whole_poses || tests.sets.iter().all(|t| whole(&t.samples)))
    };
    let mut methods = applicable(samples);
    methods.retain(simpler);
    let sizes = if a.report.is_some() {
        learning::sizes(&task, options).len()
    } else {
        0
    };
    let own = if tests.sets.is_empty() { FOLDS } else { 0 };
    let bar = progress::bar(
        methods.len() * task.calibrations() + own + sizes,
        "held-out errors",
    );
    let mut models: Vec<ModelComparison> = Vec::new();
    for method in methods {
        let options = Config {
            method,
            max_correction_mm: None,
            max_correction_mrad: None,
            ..a.config
        };
        match task.run(&options, &mut || bar.inc(1)) {
            Ok(model) => models.push(model),
            // A method that is only compared with the calibration may fail.
            Err(error) => bar.suspend(|| {
                crate::cli::terminal::print::note(format_args!(
                    "`{}` is left out of the comparison: {}",
                    error.model, error.error
                ))
            }),
        }
    }
    let last = if tests.sets.is_empty() {
        task.run(options, &mut || bar.inc(1))
            .map_err(|e| device_failure(&a.train, e.error))?
    } else {
        let of = |test: &TestSet| SetErrors::new(&test.name, found.held_out(&test.samples));
        ModelComparison {
            model: options.method.name(),
            cross_validation: None,
            sets: tests.sets.iter().map(of).collect(),
        }
    };
    models.push(last);
    let (how, sets) = if tests.sets.is_empty() {
        let how = HoldOutMethod::CrossValidation {
            folds: FOLDS,
            seed: SEED,
        };
        (how, vec![set])
    } else {
        (HoldOutMethod::TestSets, tests.files.iter().collect())
    };
    let mut evidence = ReportData::new(how, &sets, &models, arm.nominal.kinds(), true);
    if let (Some(evidence), true) = (&mut evidence, sizes > 0) {
        bar.set_message("learning curve");
        let poses = evidence.calibrated().poses.clone();
        evidence.learning = learning::curve(&task, options, &poses, &mut || bar.inc(1));
    }
    bar.finish_and_clear();
    Ok(evidence)
}

/// Returns the provenance of a calibration: the files that were read.
pub fn provenance(
    robot: &str,
    arm: &Arm,
    origin: &blob::write::Provenance,
    seed: Option<u64>,
    train: &MeasurementSet,
    tests: &[MeasurementSet],
) -> Provenance {
    let mut files = vec![FileSummary::of_set("training", train)];
    files.extend(tests.iter().map(|set| FileSummary::of_set("test", set)));
    provenance_of_files(robot, arm, origin, seed, files)
}

/// Returns the provenance of a result: `files` that were read, and the robot's file if it has one.
fn provenance_of_files(
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
