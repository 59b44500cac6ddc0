//! The comparison itself: methods that are calibrated with the same data and judged by held-out poses.

use std::sync::atomic::AtomicBool;

use crate::cli::calibrate::provenance::{files_of_sets, provenance_of_files};
use crate::cli::calibrate::report_page;
use crate::cli::compare::args::Compare;
use crate::cli::compare::document::{CompareJson, HeldOutPart};
use crate::cli::examination::Examined;
use crate::cli::failure::{Failure, calibration_failure, device_failure};
use crate::cli::input::Input;
use crate::cli::inputs::{Arm, Tests, enough_poses, equations, origin};
use crate::cli::instrument_drift;
use crate::cli::terminal::interrupt::cancellable_by_caller;
use crate::cli::terminal::print::note;
use crate::cli::terminal::progress;
use crate::cli::tolerance::ToleranceTable;
use crate::report::certificate::{Certificate, Statement};
use crate::report::{HoldOutMethod, ReportData};
use poegp_calibration::blob::write::Provenance;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::Drift;
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::progress::threads;
use poegp_calibration::validation::cross_validation::{ModelComparison, Task, TestSet, applicable};
use poegp_calibration::validation::learning_curve as learning;

/// Compared methods, before anything is written.
pub struct Compared {
    pub document: CompareJson,
    /// The HTML report, if it is asked for.
    pub report: Option<String>,
    /// Drift that was removed from the training data.
    pub drift: Option<Drift>,
    /// Number of training rows.
    pub rows: usize,
}

/// Compares methods on measured poses.
///
/// # Errors
/// [`Failure`] about the inputs.
pub fn compared(a: &Compare, input: &Input<'_>) -> Result<Compared, Failure> {
    cancellable_by_caller(|cancel| compared_until(a, input, cancel))?
}

/// Returns what the arm must meet, and the noise of the instrument.
pub fn statement(a: &Compare) -> Statement {
    Statement {
        tolerances: a.tolerance.completed(&ToleranceTable::default()).0,
        noise: a.fit.config(Method::Elastic).instrument_noise(),
        ..Statement::default()
    }
}

fn compared_until(
    a: &Compare,
    input: &Input<'_>,
    cancel: &AtomicBool,
) -> Result<Compared, Failure> {
    if a.folds() == 1 {
        return Err(Failure::Usage(
            "--folds 1 leaves nothing to train on: use 0 for none, or at least 2".into(),
        ));
    }
    let data = Data::read(a, input)?;
    let methods = methods(a, &data.train, &data.tests.sets)?;
    a.fit.note_unused(&methods);
    if a.fit.no_variance {
        note("--no-variance has no effect: a comparison writes no blob");
    }
    data.enough_poses(a, &methods)?;
    data.examine(a, &methods)?;
    if a.folds() == 0 && a.tests.is_empty() {
        return Err(Failure::Usage(
            "--folds 0 without --test leaves no held-out errors to compare: give --test, or at least --folds 2"
                .into(),
        ));
    }
    let task = Task {
        robot: &data.arm.robot,
        train: &data.train,
        tests: &data.tests.sets,
        folds: a.folds(),
        seed: a.seed(),
        origin: &data.origin,
        cancel,
        threads: threads(),
    };
    let rounds = 1 + usize::from(data.corrected.is_some());
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
    if let Some((train, tests)) = &data.corrected {
        uncorrected = Some(models);
        last_task = Task {
            train,
            tests,
            ..last_task
        };
        models = run(&last_task)?;
    }
    bar.finish_and_clear();
    let (mut shown, mut html) = (None, None);
    let statement = statement(a);
    if a.report.is_some() || statement.tolerances.is_stated() {
        let evidence = evidence(a, &last_task, &models, &data)?;
        let part = data.held_out_part(a, &evidence, &statement);
        html = a.report.is_some().then(|| {
            report_page::of_comparison(
                &part.provenance,
                &evidence,
                &part.held_out,
                &part.certificate,
            )
        });
        shown = Some(part);
    }
    let document = CompareJson {
        version: env!("CARGO_PKG_VERSION"),
        seed: a.seed(),
        per_output: a.fit.per_output,
        weighting: a.fit.weighting.unwrap_or_default(),
        methods: models,
        shown,
        drift: data.drift.as_ref().map(|d| d.report.clone()),
        methods_without_correction: uncorrected,
    };
    Ok(Compared {
        document,
        report: html,
        drift: data.drift,
        rows: data.train.len(),
    })
}

/// What a comparison reads.
struct Data {
    arm: Arm,
    set: MeasurementSet,
    /// Samples of the rows of `set`.
    train: Vec<InstrumentSample>,
    tests: Tests,
    origin: Provenance,
    /// Drift of the instrument while it measured `set`, if it is to be removed.
    drift: Option<Drift>,
    /// Training and test data without their drift.
    corrected: Option<(Vec<InstrumentSample>, Vec<TestSet>)>,
}

impl Data {
    /// Reads the arm, the training data and the test files.
    fn read(a: &Compare, input: &Input<'_>) -> Result<Self, Failure> {
        let mut arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
        arm.gravity = a.fit.config(Method::Elastic).gravity_m_s2.into();
        let mut tools = Vec::new();
        let SampleFile {
            set,
            samples: train,
            ..
        } = arm.read(input, &mut tools, DriftCorrection::None)?;
        let drift = a.correct_drift.then(|| Drift::estimate(&set)).transpose()?;
        if a.folds() > train.len() {
            return Err(Failure::Usage(format!(
                "--folds {}: expected at most the {} poses of the file",
                a.folds(),
                train.len()
            )));
        }
        let tests = Tests::read(&arm, &a.tests, &set, &tools, None)?;
        let corrected = match &drift {
            Some(drift) => {
                let mut corrected = tests.sets.clone();
                for (file, test) in tests.files.iter().zip(&mut corrected) {
                    test.samples = Drift::estimate_as(file, drift)?.correct(&test.samples);
                }
                Some((drift.correct(&train), corrected))
            }
            None => None,
        };
        Ok(Self {
            origin: origin(set.sha256, "", tools),
            arm,
            set,
            train,
            tests,
            drift,
            corrected,
        })
    }

    /// Refuses methods for which the smallest fold is too small.
    fn enough_poses(&self, a: &Compare, methods: &[Method]) -> Result<(), Failure> {
        // A fold may exceed its share by one group of equal configurations; the calibration itself checks its number of
        // poses.
        let held_out = |rows: usize| {
            if a.folds() == 0 {
                0
            } else {
                rows.div_ceil(a.folds())
            }
        };
        let smallest = |rows: usize| rows - held_out(rows);
        let poses = smallest(different_poses(&self.train));
        for method in methods {
            enough_poses(
                &a.train,
                (poses, smallest(self.train.len())),
                equations(&self.train),
                *method,
                self.arm.robot.joints.len(),
            )?;
        }
        Ok(())
    }

    /// Examines the training data and the test files.
    fn examine(&self, a: &Compare, methods: &[Method]) -> Result<(), Failure> {
        let (json, accept) = (a.json.as_deref(), &a.accepted.accept);
        let examined = Examined {
            path: &a.train,
            robot: &self.arm.robot,
            set: &self.set,
            samples: &self.train,
            gravity: self.arm.gravity,
            json,
            accept,
        };
        examined.for_training(methods, &a.fit.config(Method::Elastic))?;
        self.tests.examine(&self.arm, &a.tests, json, accept)?;
        Ok(())
    }

    /// Returns the part of the document about held-out errors.
    fn held_out_part(
        &self,
        a: &Compare,
        evidence: &ReportData,
        statement: &Statement,
    ) -> HeldOutPart {
        let (from, seed) = (&a.robot.robot, Some(a.seed()));
        let read = files_of_sets(&self.set, &self.tests.files);
        let provenance = provenance_of_files(from, &self.arm, &self.origin, seed, read);
        let drift = self.drift.as_ref().map(|d| &d.report);
        HeldOutPart {
            held_out: evidence.summary(),
            certificate: Certificate::new(
                evidence.judged(&self.tests.trained),
                statement,
                instrument_drift::known(drift, &self.set),
                &provenance.serial_number,
            ),
            provenance,
        }
    }
}

/// Collects what the report shows: `models`, the base-tool fit for comparison if it is not among them, and the learning
/// curve of the best model.
fn evidence(
    a: &Compare,
    task: &Task,
    models: &[ModelComparison],
    data: &Data,
) -> Result<ReportData, Failure> {
    let mut all = models.to_vec();
    if !models.iter().any(|m| m.model == Method::BaseTool.name()) {
        let first = task.run(&a.fit.config(Method::BaseTool), &mut || ());
        all.insert(0, first.map_err(|e| device_failure(&a.train, e.error))?);
    }
    let (how, sets) = if a.tests.is_empty() {
        let how = HoldOutMethod::CrossValidation {
            folds: a.folds(),
            seed: a.seed(),
        };
        (how, vec![&data.set])
    } else {
        let files = data.tests.files.iter();
        (HoldOutMethod::TestSets, files.collect())
    };
    let kinds = task.robot.kinds();
    let nothing = || Failure::Usage("the report has no held-out pose to show".into());
    let mut evidence = ReportData::new(how, &sets, &all, &kinds, false).ok_or_else(nothing)?;
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
