//! `--report`: held-out errors for the page, and the pages of `calibrate` and `compare`.

use std::path::{Path, PathBuf};

use crate::cli::arguments::Calibrate;
use crate::cli::calibrate::Document;
use crate::cli::{Arm, Failure, device_failure, enough_poses, equations, file_name, progress};
use crate::report::sections;
use crate::report::sections::DeviceFacts;
use crate::report::{Evidence, FileFacts, HeldOutFacts, How, Page, Provenance, Section};
use poegp_calibration::blob;
use poegp_calibration::blob::write::CalibratedBlob;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::Drift;
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::validation::cross_validation::{
    ModelComparison, SetErrors, Task, TestSet, applicable,
};
use poegp_calibration::validation::learning_curve as learning;
use poegp_calibration::validation::model_selection::FOLDS;

/// Seed of the folds of `calibrate`, which has no option for it.
pub const SEED: u64 = 1;

/// A test file of the same arm, whose tools have to be among the first `trained_tools`.
pub fn read_test(
    arm: &Arm,
    path: &Path,
    tools: &mut Vec<ToolName>,
    trained_tools: usize,
    correction: DriftCorrection,
) -> Result<SampleFile, Failure> {
    let file = arm.read(path, tools, correction)?;
    if let Some(unknown) = tools.get(trained_tools) {
        return Err(InputError::new(
            path,
            format!("{unknown}, which the training data do not have"),
            "tools that were trained",
        )
        .with_help("calibrate, then `trainer evaluate --fit-tool ROWS` fits a new tool to some of its rows")
        .into());
    }
    Ok(file)
}

/// Test files, with the drift taken out when the training data have it taken out.
pub struct Tests {
    /// As they were read.
    pub files: Vec<MeasurementSet>,
    /// As they are predicted.
    pub sets: Vec<TestSet>,
}

impl Tests {
    /// Reads them all; the training file itself is refused.
    pub fn read(
        arm: &Arm,
        paths: &[PathBuf],
        train: &MeasurementSet,
        tools: &[ToolName],
        drift: Option<&Drift>,
    ) -> Result<Self, Failure> {
        let (mut files, mut sets) = (Vec::new(), Vec::new());
        let mut names = tools.to_vec();
        for path in paths {
            let correction = drift.map_or(DriftCorrection::None, DriftCorrection::RelativeTo);
            let SampleFile { set, samples, .. } =
                read_test(arm, path, &mut names, tools.len(), correction)?;
            if set.sha256 == train.sha256 {
                let found = "the measurements that are trained on";
                return Err(InputError::new(path, found, "poses that are held out").into());
            }
            let name = file_name(path);
            files.push(set);
            sets.push(TestSet { name, samples });
        }
        Ok(Self { files, sets })
    }
}

/// Refuses before the work what could not be held out.
pub fn check(
    a: &Calibrate,
    samples: &[InstrumentSample],
    method: Method,
    joints: usize,
) -> Result<(), Failure> {
    if a.report.is_none() || !a.tests.is_empty() {
        return Ok(());
    }
    let smallest = samples.len() - samples.len().div_ceil(FOLDS);
    enough_poses(&a.train, smallest, equations(samples), method, joints).map_err(|_| {
        InputError::new(
            &a.train,
            format!("{} poses", samples.len()),
            format!(
                "more of them: the report holds out a fifth, and `{}` cannot be calibrated on the others",
                method.name()
            ),
        )
        .with_help("name a file of fresh poses with --test FILE, measure more, or leave --report out")
        .into()
    })
}

/// Held-out errors of a calibration: on test sets by the blob that was made, else by cross-validation. Without a report
/// only what `--test` asks for.
pub fn held_out(
    a: &Calibrate,
    arm: &Arm,
    (set, samples): (&MeasurementSet, &[InstrumentSample]),
    tests: &Tests,
    options: &Config,
    origin: &blob::write::Provenance,
    found: &CalibratedBlob,
) -> Result<Option<Evidence>, Failure> {
    if a.report.is_none() && tests.sets.is_empty() {
        return Ok(None);
    }
    let task = Task {
        robot: &arm.robot,
        train: samples,
        tests: &tests.sets,
        folds: if tests.sets.is_empty() { FOLDS } else { 0 },
        seed: SEED,
        origin,
    };
    let loaded = |samples: &[InstrumentSample]| samples.iter().all(|s| s.payload_kg.is_some());
    if options.method == Method::PoeGpLoad
        && let Some(file) = a
            .tests
            .iter()
            .zip(&tests.sets)
            .find(|(_, set)| !loaded(&set.samples))
    {
        return Err(super::calibration_failure(
            file.0,
            &CalibrationError::NoPayload,
        ));
    }
    let whole =
        |samples: &[InstrumentSample]| samples.iter().all(|s| s.observation.has_orientation());
    let simpler = |method: &Method| {
        *method < options.method
            && (a.report.is_some() || *method == Method::BaseTool)
            && (*method != Method::PoeGpLoad || tests.sets.iter().all(|t| loaded(&t.samples)))
            && (!method.requires().single_tool_full_poses
                || tests.sets.iter().all(|t| whole(&t.samples)))
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
        let options = a.fit.config(method);
        match task.run(&options, &mut || bar.inc(1)) {
            Ok(model) => models.push(model),
            // What the calibration is compared with need not be possible.
            Err(error) => bar.suspend(|| {
                crate::cli::report::remark(format_args!(
                    "`{}` is not compared: {}",
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
        let how = How::CrossValidation {
            folds: FOLDS,
            seed: SEED,
        };
        (how, vec![set])
    } else {
        (How::TestSets, tests.files.iter().collect())
    };
    let mut evidence = Evidence::new(how, &sets, &models, arm.nominal.kinds(), true);
    if let (Some(evidence), true) = (&mut evidence, sizes > 0) {
        bar.set_message("learning curve");
        let poses = evidence.after().poses.clone();
        evidence.learning = learning::curve(&task, options, &poses, &mut || bar.inc(1));
    }
    bar.finish_and_clear();
    Ok(evidence)
}

/// Where a result comes from: what was read.
pub fn provenance(
    robot: &str,
    arm: &Arm,
    origin: &blob::write::Provenance,
    seed: Option<u64>,
    train: &MeasurementSet,
    tests: &[MeasurementSet],
) -> Provenance {
    let mut files = vec![FileFacts::of_set("training", train)];
    files.extend(tests.iter().map(|set| FileFacts::of_set("test", set)));
    // A built-in robot has no file; its name and the version say it all.
    if let Ok(bytes) = std::fs::read(robot) {
        files.push(FileFacts::of_bytes("robot", robot, &bytes));
    }
    Provenance {
        command: crate::report::provenance::command_line(),
        version: env!("CARGO_PKG_VERSION"),
        date: origin.date.clone(),
        seed,
        robot: arm.robot.name.clone(),
        serial_number: origin.serial_number.clone(),
        files,
    }
}

/// Title and line below it.
fn page(what: &str, provenance: &Provenance) -> Page {
    let serial = match provenance.serial_number.as_str() {
        "" => String::new(),
        number => format!(", serial number {number}"),
    };
    Page::new(
        format!("{what} {}{serial}", provenance.robot),
        format!("{}, poegp trainer {}", provenance.date, provenance.version),
    )
}

/// The page of `calibrate`.
pub fn of_calibration(document: &Document, evidence: &Evidence, facts: &HeldOutFacts) -> String {
    let elastic = document.elastic.as_ref();
    let listed = elastic.map(crate::cli::elastic_facts::ElasticFacts::listed_outliers);
    let ripple = elastic.map(crate::cli::elastic_facts::ElasticFacts::listed_ripple);
    let device = DeviceFacts {
        file: document.blob.file.clone(),
        bytes: document.blob.bytes,
        support: document.blob.support,
        instructions: document.blob.instructions,
        bound: (document.bound_mm, document.bound_mrad),
        f32_error_um: (document.f32_error_um.mean, document.f32_error_um.max),
    };
    let page =
        page("Calibration of", &document.provenance).with(sections::headline(evidence, facts));
    sections::held_out(page, evidence, facts)
        .with(sections::parameters(
            document.identifiability.as_ref(),
            &document.frames,
            &ripple.unwrap_or_default(),
        ))
        .with(sections::outliers(
            evidence,
            facts,
            listed
                .as_deref()
                .ok_or("Only the elastic model looks for outliers among its training poses."),
        ))
        .with(sections::choice(
            document.choice.as_deref(),
            document.budget.as_deref(),
        ))
        .with(sections::device(&device))
        .with(sections::provenance(&document.provenance))
        .render()
}

/// The page of `compare`.
pub fn of_comparison(provenance: &Provenance, evidence: &Evidence, facts: &HeldOutFacts) -> String {
    let page =
        page("Comparison of models for", provenance).with(sections::headline(evidence, facts));
    sections::held_out(page, evidence, facts)
        .with(sections::outliers(
            evidence,
            facts,
            Err("Outliers among the training poses are in the report of `trainer calibrate`."),
        ))
        .with(Section::new("parameters", "What is not here").missing(
            "A comparison makes models to compare them and keeps none. The parameters of the arm, the choice of the model \
             and the file for the controller are in the report of `trainer calibrate --report`.",
        ))
        .with(sections::provenance(provenance))
        .render()
}
