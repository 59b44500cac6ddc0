//! `trainer calibrate`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::arguments::Calibrate;
use crate::cli::elastic_facts::ElasticFacts;
use crate::cli::page;
use crate::cli::page::Tests;
use crate::cli::report::{Report, remark};
use crate::cli::{
    Arm, Failure, cell, check_outputs, device_failure, drift, enough_poses, equations,
    instrument_noise, json_text, origin, progress, write_outputs,
};
use crate::report::{Evidence, FileFacts, HeldOutFacts, Provenance};
use poegp_calibration::blob;
use poegp_calibration::blob::precision_loss::SinglePrecisionLoss;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{CalibratedBlob, calibrate_to_blob};
use poegp_calibration::device_cost::{ElasticSize, instructions};
use poegp_calibration::identification::frame_fit::FrameFit;
use poegp_calibration::identification::identifiability::IdentifyReport;
use poegp_calibration::learning::task_space::fit::MAX_SIGNAL_VARIANCE;
use poegp_calibration::measurement::instrument_drift::DriftReport;
use poegp_calibration::measurement::reader::SampleFile;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::correction::Correction;
use poegp_calibration::model::frame_changes::{FrameChange, changes};
use poegp_calibration::model::identified::of_calibration;
use poegp_calibration::model::{Calibration, Method};
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::validation::cross_validation::Task;
use poegp_calibration::validation::device_budget::{Budget, Fitted, TRIALS, fill};
use poegp_calibration::validation::model_selection::{Choice, FOLDS, Row, candidates, choose};

/// What `--json` writes.
#[derive(Serialize)]
pub struct Document {
    version: &'static str,
    model: &'static str,
    robot: String,
    training_poses: usize,
    training: ErrorSummary,
    /// Errors on poses that were not trained on, where some were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    held_out: Option<HeldOutFacts>,
    step1: Option<Step1>,
    hyperparameters: Vec<Hyperparameters>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elastic: Option<ElasticFacts>,
    /// The table that `--model auto` chose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub choice: Option<Vec<Row>>,
    /// The table that a budget was fitted by; the first row has all support points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget: Option<Vec<Fitted>>,
    pub bound_mm: f64,
    pub bound_mrad: f64,
    pub f32_error_um: F32Error,
    #[serde(skip_serializing_if = "Option::is_none")]
    drift: Option<DriftReport>,
    pub identifiability: Option<IdentifyReport>,
    /// By how much the frames differ from the drawing.
    pub frames: Vec<FrameChange>,
    pub blob: BlobFacts,
    /// Whether the blob is, to the byte, the one that a project file states.
    #[serde(skip_serializing_if = "Option::is_none")]
    repeats: Option<bool>,
    pub provenance: Provenance,
}

#[derive(Serialize)]
struct Step1 {
    parameters: usize,
    identifiable: usize,
    iterations: usize,
    rms: f64,
}

#[derive(Serialize)]
struct Hyperparameters {
    theta: [f64; 4],
    noise_variance: f64,
}

#[derive(Serialize)]
pub struct F32Error {
    pub mean: f64,
    pub max: f64,
}

#[derive(Serialize)]
pub struct BlobFacts {
    pub file: String,
    pub bytes: usize,
    pub support: usize,
    /// Of one evaluation on a Cortex-M4F, by the cost model of the elastic model.
    pub instructions: Option<u64>,
}

pub fn run(a: &Calibrate) -> Result<(), Failure> {
    let outputs = [
        Some(a.out.as_path()),
        a.json.as_deref(),
        a.report.as_deref(),
        a.write_cell.as_deref(),
    ];
    let mut inputs = vec![a.train.as_path(), Path::new(&a.robot.robot)];
    inputs.extend(a.tests.iter().map(PathBuf::as_path));
    inputs.extend(a.project.as_ref().map(|project| project.file.as_path()));
    check_outputs(&outputs, &inputs)?;
    let mut options = Config {
        max_correction_mm: positive("--max-correction-mm", a.max_correction_mm, 1000.0)?,
        max_correction_mrad: positive("--max-correction-mrad", a.max_correction_mrad, 500.0)?,
        ..a.fit.config(a.model.method().unwrap_or(Method::BaseTool))
    };
    let arm = Arm::load(&a.robot)?;
    let mut tools = Vec::new();
    let SampleFile {
        set,
        samples,
        drift,
        ..
    } = drift::read(&arm, &a.train, &mut tools, a.correct_drift)?;
    enough_poses(
        &a.train,
        samples.len(),
        equations(&samples),
        options.method,
        arm.robot.joints.len(),
    )?;
    let tests = Tests::read(&arm, &a.tests, &set, &tools, drift.as_ref())?;
    page::check(a, &samples, options.method, arm.robot.joints.len())?;
    instrument_noise(a.fit.position_sigma_mm, a.fit.orientation_sigma_mrad)?;
    let mut origin = origin(set.sha256, &a.serial_number, tools);
    if let Some(date) = &a.date {
        origin.date.clone_from(date);
    }
    let table = match a.model.method() {
        Some(_) => None,
        None => {
            let choice = choose_model(a, &arm, &samples, &options, &origin)?;
            options = choice.config;
            for out in &choice.left_out {
                remark(format_args!(
                    "`{}` is left out of the choice: {}",
                    out.candidate, out.reason
                ));
            }
            Some(choice.table)
        }
    };
    let budget = Budget {
        instructions: a.max_instructions,
        bytes: a.max_flash_bytes,
    };
    let mut fitted = None;
    if !budget.is_unlimited() && options.method == Method::Elastic {
        let (chosen, rows) = fit_budget(a, &budget, &arm, &samples, &options, &origin)?;
        options = chosen;
        fitted = Some(rows);
    } else if !budget.is_unlimited() {
        return Err(Failure::Usage(
            "--max-instructions and --max-flash-bytes choose the size of the elastic model".into(),
        ));
    }
    let found = progress::calibrating(|context| {
        calibrate_to_blob(&arm.robot, &samples, &options, &origin, context)
    });
    let found = found.map_err(|e| device_failure(&a.train, e))?;
    let train = (&set, samples.as_slice());
    let evidence = page::held_out(a, &arm, train, &tests, &options, &origin, &found)?;
    let CalibratedBlob {
        calibration,
        blob,
        precision_loss,
    } = found;
    let training = ErrorSummary::new(&blob.errors(&samples));
    let lines: Vec<usize> = set.measurements.iter().map(|m| m.line).collect();
    let seed = evidence.is_some().then_some(page::SEED);
    let mut provenance = page::provenance(&a.robot.robot, &arm, &origin, seed, &set, &tests.files);
    let file = a.out.display().to_string();
    let written = FileFacts::of_bytes("result", file, blob.bytes());
    provenance.files.push(written);
    let mut document = document(
        a,
        &calibration,
        &blob,
        &precision_loss,
        training,
        provenance,
    );
    document.held_out = evidence.as_ref().map(Evidence::facts);
    document.elastic = ElasticFacts::new(&calibration, &samples, &lines);
    document.choice = table;
    document.budget = fitted;
    document.drift = drift.map(|d| d.report);
    document.identifiability = of_calibration(&calibration, &arm.robot, &samples);
    let stated = a.project.as_ref().and_then(|p| p.blob_sha256.as_ref());
    document.repeats = stated.map(|stated| {
        let sum = FileFacts::of_bytes("", "", blob.bytes()).sha256;
        stated.eq_ignore_ascii_case(&sum)
    });
    let cell = a.write_cell.as_deref().map(|path| {
        let text = cell::text(a, path, &set, &tests.files, &origin, blob.bytes());
        (path, text)
    });
    let json = json_text(&document)?;
    let shown = evidence.as_ref().zip(document.held_out.as_ref());
    let shown = shown.map(|(evidence, facts)| page::of_calibration(&document, evidence, facts));
    let mut files = vec![(a.out.as_path(), blob.bytes())];
    let html = a.report.as_deref().zip(shown.as_deref());
    files.extend(html.map(|(path, html)| (path, html.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    files.extend(cell.iter().map(|(path, text)| (*path, text.as_bytes())));
    write_outputs(&files)?;
    let report = Report::beside(&outputs);
    if let Some(rows) = &document.choice {
        print_choice(report, rows);
    }
    if let Some(rows) = &document.budget {
        print_budget(report, rows);
    }
    if let Some(drift) = &document.drift {
        report.line(drift.lines().join("\n"));
        report.line(drift::NO_LEAK);
    }
    print(report, a, &calibration, &blob, &precision_loss, &document);
    Ok(())
}

/// Cross-validation within the training data, for a choice.
fn selection<'a>(
    arm: &'a Arm,
    samples: &'a [InstrumentSample],
    origin: &'a blob::write::Provenance,
) -> Task<'a> {
    Task {
        robot: &arm.robot,
        train: samples,
        tests: &[],
        folds: FOLDS,
        seed: 1,
        origin,
    }
}

/// Lets the training data choose.
fn choose_model(
    a: &Calibrate,
    arm: &Arm,
    samples: &[InstrumentSample],
    options: &Config,
    origin: &blob::write::Provenance,
) -> Result<Choice, Failure> {
    let task = selection(arm, samples, origin);
    let candidates = candidates(samples, arm.robot.joints.len(), options);
    let bar = progress::bar(candidates.len() * FOLDS, "choosing the model");
    let choice = choose(&task, &candidates, &mut || bar.inc(1));
    bar.finish_and_clear();
    choice.map_err(|e| device_failure(&a.train, e.error))
}

/// Chooses support points and length scales for a budget.
fn fit_budget(
    a: &Calibrate,
    budget: &Budget,
    arm: &Arm,
    samples: &[InstrumentSample],
    options: &Config,
    origin: &blob::write::Provenance,
) -> Result<(Config, Vec<Fitted>), Failure> {
    let task = selection(arm, samples, origin);
    let bar = progress::bar(TRIALS * FOLDS, "fitting the budget");
    let filled = fill(budget, &task, options, &mut || bar.inc(1));
    bar.finish_and_clear();
    filled
        .map_err(|e| device_failure(&a.train, e.error))?
        .ok_or_else(|| {
            Failure::Quality(
                "not even one support point fits the budget; nothing was written".into(),
            )
        })
}

fn print_budget(report: Report, rows: &[Fitted]) {
    report.line("Fitted to the budget; errors held out within the training data, in mm.\n");
    let cells: Vec<Vec<String>> = rows
        .iter()
        .enumerate()
        .map(|(i, r)| {
            let scales = if r.tied { "tied" } else { "own" };
            vec![
                format!(
                    "{} {scales}{}",
                    if r.taken { "*" } else { " " },
                    match (i, r.per_output) {
                        (0, _) => ", all points",
                        (_, true) => ", a set for each joint",
                        (_, false) => "",
                    }
                ),
                r.support.to_string(),
                r.instructions.to_string(),
                r.bytes.to_string(),
                format!("{:.4}", r.position_mm.mean),
                format!(
                    "{:+.1} %",
                    100.0 * (r.position_mm.mean / rows[0].position_mm.mean - 1.0)
                ),
            ]
        })
        .collect();
    report.table(
        &[
            "length scales",
            "points",
            "instructions",
            "bytes",
            "mean",
            "loss",
        ],
        &cells,
    );
    report.line("");
}

fn print_choice(report: Report, rows: &[Row]) {
    report.line(
        "Chosen by cross-validation (mm): the simplest within one standard error of the best.\n",
    );
    let cells = rows.iter().map(|r| {
        vec![
            format!("{} {}", if r.chosen { "*" } else { " " }, r.candidate),
            format!("{:.4}", r.position_mm.mean),
            format!("{:.4}", r.position_mm.p95),
            format!("{:.4} ± {:.4}", r.behind_best_mm, r.standard_error_mm),
        ]
    });
    let cells: Vec<Vec<String>> = cells.collect();
    report.table(&["candidate", "mean", "p95", "behind the best"], &cells);
    report.line("");
}

fn positive(name: &str, value: Option<f64>, limit: f64) -> Result<Option<f64>, Failure> {
    match value {
        Some(x) if !(x > 0.0 && x <= limit) => Err(Failure::Usage(format!(
            "{name} {x}: expected a number above 0 and at most {limit}"
        ))),
        _ => Ok(value),
    }
}

fn print(
    report: Report,
    a: &Calibrate,
    calibration: &Calibration,
    blob: &BlobModel,
    precision_loss: &SinglePrecisionLoss,
    document: &Document,
) {
    let training = &document.training;
    let p = &training.position_mm;
    report.line(format_args!(
        "Calibrated {} with `{}` on {} poses.",
        a.robot.robot,
        calibration.config.method.name(),
        training.poses
    ));
    if let Some(fit) = calibration.frame_fit() {
        report.line(format_args!(
            "  step 1: {} of {} parameters can be identified",
            fit.rank, fit.parameters
        ));
    }
    report.line(format_args!(
        "  error on the training poses themselves: {:.4} mm mean, {:.4} mm largest",
        p.mean, p.max
    ));
    match &document.held_out {
        None => report.line(
            "  (they were trained on: for honest figures use --report, `trainer compare` or `trainer evaluate`)",
        ),
        Some(held_out) => {
            let (before, after) = (&held_out.before.errors, &held_out.after.errors);
            report.line(format_args!(
                "  error on {} held-out poses ({}): {:.4} mm mean, 95 % within {:.4} mm; before {:.4} and {:.4} mm",
                after.poses,
                held_out.how,
                after.position_mm.mean,
                after.position_mm.p95,
                before.position_mm.mean,
                before.position_mm.p95
            ));
        }
    }
    if let Some(facts) = &document.elastic {
        facts.print(report);
    }
    if !matches!(calibration.correction, Correction::None) {
        let (m, rad) = calibration.correction_limit;
        report.line(format_args!(
            "  corrections are bounded to {:.3} mm and {:.3} mrad",
            1e3 * m,
            1e3 * rad
        ));
    }
    report.line(format_args!(
        "  single precision costs {:.3} µm in the mean, {:.3} µm at most",
        1e6 * precision_loss.mean_m,
        1e6 * precision_loss.max_m
    ));
    if let Some(task_space) = calibration.correction.task_space()
        && task_space.max_signal_variance < MAX_SIGNAL_VARIANCE
    {
        report.line(format_args!(
            "  note: the signal variance was held below {} for the sake of single precision",
            task_space.max_signal_variance
        ));
    }
    match &document.identifiability {
        Some(told) => report.line(told.lines().join("\n")),
        None => report.line("  what these poses tell about the geometry could not be computed"),
    }
    let support = blob.model().support();
    report.line(format_args!(
        "Wrote {} ({} bytes, {support} support points).",
        a.out.display(),
        blob.bytes().len()
    ));
    match document.repeats {
        Some(true) => {
            report.line(
                "It is to the byte the blob that was made when the project file was written.",
            );
        }
        Some(false) => remark(format_args!(
            "{} is not to the byte the blob that the project file states (output.blob_sha256): another trainer, or another \
             kind of processor; `trainer evaluate` on held-out poses tells whether it matters",
            a.out.display()
        )),
        None => {}
    }
    if let Some(path) = &a.write_cell {
        report.line(format_args!(
            "Wrote {}: `trainer calibrate {}` does the same again.",
            path.display(),
            path.display()
        ));
    }
    if let Some(path) = &a.report {
        report.line(format_args!(
            "Wrote {}: open it in a browser.",
            path.display()
        ));
    }
}

fn document(
    a: &Calibrate,
    calibration: &Calibration,
    blob: &BlobModel,
    precision_loss: &SinglePrecisionLoss,
    training: ErrorSummary,
    provenance: Provenance,
) -> Document {
    let step1 = |fit: &FrameFit| Step1 {
        parameters: fit.parameters,
        identifiable: fit.rank,
        iterations: fit.iterations,
        rms: fit.rms,
    };
    let hyperparameters = calibration
        .correction
        .task_space()
        .into_iter()
        .flat_map(|task_space| &task_space.gp.hyperparameters)
        .map(|h| {
            let [a, b, c, d, noise_variance] = h.to_array();
            Hyperparameters {
                theta: [a, b, c, d],
                noise_variance,
            }
        });
    Document {
        version: env!("CARGO_PKG_VERSION"),
        model: calibration.config.method.name(),
        robot: blob.blob().robot.name.to_owned(),
        training_poses: training.poses,
        training,
        held_out: None,
        step1: calibration.frame_fit().map(step1),
        hyperparameters: hyperparameters.collect(),
        elastic: None,
        choice: None,
        budget: None,
        bound_mm: 1e3 * calibration.correction_limit.0,
        bound_mrad: 1e3 * calibration.correction_limit.1,
        f32_error_um: F32Error {
            mean: 1e6 * precision_loss.mean_m,
            max: 1e6 * precision_loss.max_m,
        },
        drift: None,
        identifiability: None,
        frames: changes(calibration),
        blob: BlobFacts {
            file: a.out.display().to_string(),
            bytes: blob.bytes().len(),
            support: blob.model().support(),
            instructions: ElasticSize::of_blob(blob.blob(), blob.model().support())
                .map(|size| instructions(&size)),
        },
        repeats: None,
        provenance,
    }
}
