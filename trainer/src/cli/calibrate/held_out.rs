//! The held-out errors of a calibration, which `--report`, a tolerance or `--test` asks for.

use indicatif::ProgressBar;

use crate::cli::calibrate::calibrated::Calibrated;
use crate::cli::calibrate::job::Job;
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::inputs::{enough_poses, equations};
use crate::cli::terminal::interrupt::own_flag;
use crate::cli::terminal::print::note;
use crate::cli::terminal::progress;
use crate::report::{HoldOutMethod, ReportData};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::folds::held_out_together;
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::validation::cross_validation::{
    ModelComparison, SetErrors, Task, TestSet, applicable,
};
use poegp_calibration::validation::learning_curve as learning;
use poegp_calibration::validation::model_selection::folds;

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
    let held_out = poses.div_ceil(folds(poses).max(1));
    let smallest = poses - held_out;
    enough_poses(&a.train, (smallest, smallest), equations(samples), method, joints).map_err(|_| {
        InputError::new(
            &a.train,
            format!("{poses} different poses"),
            format!(
                "more poses: a report or a verdict holds out {held_out} at a time, and `{}` cannot be calibrated on the \
                 others",
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
    let folds = match tests.sets.is_empty() {
        true => folds(held_out_together(&c.measured.samples, &c.measured.arm.robot.kinds()).len()),
        false => 0,
    };
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
