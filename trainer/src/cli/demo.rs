//! `trainer demo`: repeats the paper's simulation, and prints the paper's Table I beside the new results.

use clap::{Args, Parser};
use std::ffi::OsString;
use std::path::Path;
use std::path::PathBuf;

use crate::cli::args::FrameArgs;
use crate::cli::calibrate;
use crate::cli::calibrate::args::Calibrate;
use crate::cli::evaluate;
use crate::cli::evaluate::Evaluate;
use crate::cli::examination::AcceptArgs;
use crate::cli::failure::{Failure, device_failure};
use crate::cli::inputs::{file_name, origin};
use crate::cli::output::kind::{Kind, check_kind};
use crate::cli::output::make_folder;
use crate::cli::output::{check_outputs, document_text, write_outputs, write_summary, write_texts};
use crate::cli::simulate::{SimulatedSet, simulated_sets};
use crate::cli::terminal::print::Printer;
use crate::cli::terminal::progress;
use crate::cli::terminal::warnings;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::progress::FitContext;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_calibration::validation::cross_validation::{ModelComparison, Task, TestSet};

/// Mean position errors in mm of the paper's Table I, simulation, for its three test sets.
const PAPER_TABLE_I: [(Method, [f64; 3]); 4] = [
    (Method::BaseTool, [1.94, 1.93, 1.89]),
    (Method::Poe, [0.90, 0.81, 0.81]),
    (Method::PoeGp, [0.71, 0.63, 0.62]),
    (Method::PoeGpLoad, [0.23, 0.24, 0.25]),
];

const ROBOT: &str = "abb-irb4400-serial";
const PAYLOADS: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];
const FOLDS: usize = 10;

/// Names of the files in the folder, and what is in them.
const WRITTEN: [(&str, &str, Kind); 8] = [
    ("train.csv", "measurements to train on", Kind::Simulated),
    (
        "test1.csv test2.csv test3.csv",
        "measurements to test on, with the noiseless truth",
        Kind::Simulated,
    ),
    (
        "arm.blob",
        "the model for the controller (`trainer inspect` shows it)",
        Kind::Model,
    ),
    (
        "predictions.csv",
        "its predictions for test1.csv",
        Kind::Predictions,
    ),
    (
        "chosen.blob",
        "the model that cross-validation chose",
        Kind::Model,
    ),
    (
        "report.html",
        "held-out errors with plots: open it in a browser",
        Kind::Report,
    ),
    ("report.json", "the numbers of the report", Kind::Json),
    ("compare.json", "all errors, for other programs", Kind::Json),
];

/// `trainer demo`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  trainer demo\n  trainer demo --seed 2 --out demo2")]
pub struct Demo {
    /// Seed of the simulated robot.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder to write into; created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Write the errors of all methods and the names of the files as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Demo) -> Result<(), Failure> {
    check_outputs(&[(a.json.as_deref(), Kind::Json)], &[])?;
    let report = Printer::for_outputs(&[a.json.as_deref()]);
    let _folder = make_folder(&a.out)?;
    for (names, _, kind) in WRITTEN {
        for name in names.split(' ') {
            check_kind(&a.out.join(name), kind)?;
        }
    }
    let robot = Robot::load(ROBOT, &poegp_calibration::robot::LoadOptions::default())?;

    report.line("1. Simulate: an ABB IRB 4400 with imperfect frames and joints that yield under gravity and five");
    report.line("   payloads, measured by a tracker with 30 µm of noise. 300 training poses, 3 × 100 test poses.");
    let mut simulator = Simulator::new(&robot, Scenario::Paper, &PAYLOADS, a.seed);
    let comment = format!("simulated {ROBOT} (seed {})", a.seed);
    let sets = simulated_sets(&robot, &mut simulator, 300, (3, 100), &a.out, &comment);
    write_texts(&sets.iter().map(SimulatedSet::output).collect::<Vec<_>>())?;

    let data = Data::read_back(&robot, &sets)?;
    report.line(format_args!(
        "2. Calibrate with the four methods of the paper, {FOLDS} folds and then all poses, and with the elastic model.\n"
    ));
    let models = compared(a, &robot, &data)?;
    print_table(report, &models);
    let found = calibrate_to_blob(
        &robot,
        &data.train,
        &Config::new(Method::PoeGpLoad),
        &data.origin,
        &FitContext::default(),
    )
    .map_err(|e| device_failure(data.path, e))?;
    let blob = a.out.join("arm.blob");
    write_outputs(&[(&blob, found.blob.bytes())])?;
    let document = crate::cli::compare::CompareJson {
        version: env!("CARGO_PKG_VERSION"),
        seed: a.seed,
        per_output: false,
        weighting: Weighting::None,
        methods: models[..PAPER_TABLE_I.len()].to_vec(),
        shown: None,
        drift: None,
        methods_without_correction: None,
    };
    write_outputs(&[(
        &a.out.join("compare.json"),
        document_text(&document)?.as_bytes(),
    )])?;
    report.line("\n3. Write the blob, read it back, and predict the first test set as the device does (f32):\n");
    // The warnings of the evaluation are in the summary of the demonstration.
    warnings::begin();
    evaluate::run(&Evaluate {
        accepted: AcceptArgs::default(),
        blob,
        test: sets[1].path.clone(),
        features: None,
        frames: FrameArgs::default(),
        trust: false,
        predictions: Some(a.out.join("predictions.csv")),
        json: None,
    })?;
    report.line(format_args!(
        "\nSingle-precision loss: {:.2} µm mean, {:.2} µm maximum.",
        1e6 * found.precision_loss.mean_m,
        1e6 * found.precision_loss.max_m
    ));
    report.line(
        "\n4. Let cross-validation choose the model, as `calibrate` does by default; hold out the test sets, and \
        write a report:\n",
    );
    calibrate_with_report(a, &sets, &a.out.join("chosen.blob"))?;
    let files = WRITTEN.iter().flat_map(|(names, _, _)| names.split(' '));
    let summary = serde_json::json!({
        "seed": a.seed,
        "methods": models,
        "files": files.collect::<Vec<_>>(),
    });
    write_summary(a.json.as_deref(), summary)?;
    report.line(format_args!("\nEverything is in {}:", a.out.display()));
    for (name, what, _) in WRITTEN {
        report.line(format_args!("  {name:30} {what}"));
    }
    Ok(())
}

/// The simulated measurements as a user's would be read.
struct Data<'a> {
    /// Path of the training data.
    path: &'a Path,
    train: Vec<InstrumentSample>,
    tests: Vec<TestSet>,
    origin: Provenance,
}

impl<'a> Data<'a> {
    /// Reads the files back, so that the demo takes the same path as real data. The first is the training data.
    fn read_back(robot: &Robot, sets: &'a [SimulatedSet]) -> Result<Self, Failure> {
        let path = &sets[0].path;
        let set = measurements::read(path)?;
        let mut tools = Vec::new();
        let train = samples(&set, robot, &mut tools)?;
        let mut tests = Vec::new();
        for test in &sets[1..] {
            let samples = samples(&measurements::read(&test.path)?, robot, &mut tools)?;
            tests.push(TestSet {
                name: file_name(&test.path),
                samples,
            });
        }
        Ok(Self {
            path,
            train,
            tests,
            origin: origin(set.sha256, "demo", tools),
        })
    }
}

/// Compares the paper's methods, the last of them with hyperparameters per output, and the elastic model, in this order.
fn compared(a: &Demo, robot: &Robot, data: &Data<'_>) -> Result<Vec<ModelComparison>, Failure> {
    let task = Task {
        robot,
        train: &data.train,
        tests: &data.tests,
        folds: FOLDS,
        seed: a.seed,
        origin: &data.origin,
        cancel: &NEVER,
        threads: threads(),
    };
    let own = Config {
        hyperparameters: HyperparameterSharing::PerOutput,
        ..Config::new(Method::PoeGpLoad)
    };
    let mut runs: Vec<Config> = PAPER_TABLE_I
        .iter()
        .map(|(method, _)| Config::new(*method))
        .collect();
    runs.push(own);
    let bar = progress::bar(runs.len() * task.calibrations() + 1, "calibrating");
    let mut models = Vec::new();
    for options in &runs {
        bar.set_message(options.method.name());
        let result = task.run(options, &mut || bar.inc(1));
        models.push(result.map_err(|e| device_failure(data.path, e.error))?);
    }
    // The elastic model takes seconds for each calibration, so it is compared on the test sets alone.
    bar.set_message(Method::Elastic.name());
    let elastic = Task { folds: 0, ..task };
    let result = elastic.run(&Config::new(Method::Elastic), &mut || bar.inc(1));
    models.push(result.map_err(|e| device_failure(data.path, e.error))?);
    bar.finish_and_clear();
    Ok(models)
}

/// Runs the command `calibrate` as a user would type it.
fn calibrate_with_report(a: &Demo, sets: &[SimulatedSet], out: &Path) -> Result<(), Failure> {
    let mut typed: Vec<OsString> = ["calibrate", "--robot", ROBOT].map(OsString::from).into();
    let (train, tests) = (&sets[0].path, &sets[1..]);
    typed.push(train.into());
    for test in tests {
        typed.extend(["--test".into(), (&test.path).into()]);
    }
    for (option, file) in [
        ("--out", out.to_owned()),
        ("--report", a.out.join("report.html")),
        ("--json", a.out.join("report.json")),
    ] {
        typed.extend([option.into(), file.into()]);
    }
    typed.extend(["--serial-number", "demo"].map(OsString::from));
    let parsed = Calibrate::try_parse_from(typed).map_err(|e| Failure::Usage(e.to_string()))?;
    calibrate::run(&parsed)
}

fn print_table(report: Printer, models: &[ModelComparison]) {
    report.line(format_args!(
        "Table I: mean position error in mm on the three test sets, and in {FOLDS}-fold cross-validation\n"
    ));
    let mut rows = Vec::new();
    for (i, model) in models.iter().enumerate() {
        let paper = PAPER_TABLE_I.get(i);
        let mut row = vec![match paper {
            Some((method, _)) => title(*method).to_owned(),
            None if model.model == Method::Elastic.name() => title(Method::Elastic).to_owned(),
            None => "  with hyperparameters per output".to_owned(),
        }];
        row.push(paper.map_or("–".to_owned(), |(_, m)| {
            format!("{:.2} / {:.2} / {:.2}", m[0], m[1], m[2])
        }));
        let ours: Vec<String> = model
            .sets
            .iter()
            .map(|s| format!("{:.2}", s.errors.position_mm.mean))
            .collect();
        row.push(ours.join(" / "));
        row.push(
            model
                .cross_validation
                .as_ref()
                .map_or("–".to_owned(), |cv| {
                    format!("{:.2}", cv.all.position_mm.mean)
                }),
        );
        rows.push(row);
    }
    report.table(&["", "paper", "here", "folds"], &rows);
    let mean = |m: &ModelComparison| {
        m.sets
            .iter()
            .map(|s| s.errors.position_mm.mean)
            .sum::<f64>()
            / m.sets.len().max(1) as f64
    };
    let cut = |m: &ModelComparison| {
        let percent: Vec<String> = models[..3]
            .iter()
            .map(|other| format!("{:.1}", 100.0 * (1.0 - mean(m) / mean(other))))
            .collect();
        percent.join(" / ")
    };
    report.line("\nPOE + GP with loading cuts the error of base-tool / POE / POE + GP by");
    report.line("  87.5 / 71.3 / 63.1 %  in the paper");
    report.line(format_args!("  {} %  here", cut(&models[3])));
    report.line(format_args!(
        "  {} %  here, with hyperparameters per output",
        cut(&models[4])
    ));
}

fn title(method: Method) -> &'static str {
    match method {
        Method::BaseTool => "Base-tool calibration",
        Method::Poe => "POE calibration",
        Method::PoeGp => "POE + GP",
        Method::PoeGpLoad => "POE + GP with loading",
        Method::Parametric => "Elastic joints, parameters alone",
        Method::Elastic => "Elastic joints",
    }
}
