//! `trainer compare`.

mod comparison;
mod document;

use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::args::{FitArgs, RobotArgs, heading, method};
use crate::cli::compare::comparison::{Compared, compared, statement};
pub use crate::cli::compare::document::CompareJson;
use crate::cli::examination::AcceptArgs;
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::instrument_drift;
use crate::cli::output::{check_outputs, json_text, write_texts};
use crate::cli::terminal::print::Printer;
use crate::cli::tolerance::{self, ToleranceArgs};
use crate::cli::touches::{self, are_touches_in_file};
use crate::report::{never_held_out, sections};
use poegp_calibration::model::Method;
use poegp_calibration::validation::cross_validation::ModelComparison;

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
    refuse_models(a)?;
    let output = [a.json.as_deref(), a.report.as_deref()];
    let inputs = [a.train.as_path(), Path::new(&a.robot.robot)];
    let inputs: Vec<&Path> = inputs
        .into_iter()
        .chain(a.tests.iter().map(PathBuf::as_path))
        .collect();
    check_outputs(&output, &inputs)?;
    let Compared {
        document,
        report: html,
        drift,
        rows,
    } = compared(a, &Input::file(&a.train))?;
    let json = a.json.as_ref().map(|_| json_text(&document)).transpose()?;
    write_texts(&[
        (a.json.as_deref(), json.as_deref()),
        (a.report.as_deref(), html.as_deref()),
    ])?;
    let report = Printer::for_outputs(&output);
    let models = &document.methods;
    match (&drift, &document.methods_without_correction) {
        (Some(drift), Some(uncorrected)) => {
            report.line(drift.report.lines().join("\n"));
            report.line(instrument_drift::NO_LEAK);
            report.line("");
            print(
                report,
                &[(uncorrected, ""), (models, ", drift corrected")],
                rows,
                a,
            );
        }
        _ => print(report, &[(models, "")], rows, a),
    }
    if let Some(path) = &a.report {
        report.line(format_args!(
            "\nWrote {}: open it in a browser.",
            path.display()
        ));
    }
    let certificate = document.shown.as_ref().map(|part| &part.certificate);
    if let Some(conformity) = certificate.and_then(|c| c.conformity.as_ref())
        && let Some(line) = sections::verdict_line(conformity)
    {
        report.line(format_args!("\nVerdict on the best model: {line}."));
    }
    tolerance::outcome(certificate, &statement(a))
}

/// Compares without writing any output, and returns the JSON document. `table` holds the measurements if they are not in a
/// file. The flag of a caller that embeds this program cancels it.
///
/// # Errors
/// [`Failure`] about the inputs. A tolerance that is not met is no error.
pub fn document(a: &Compare, table: Option<&[u8]>) -> Result<String, Failure> {
    let input = Input {
        path: &a.train,
        bytes: table,
    };
    if are_touches_in_file(&input, a.features.as_deref())? {
        return json_text(&touches::compare::compared(a)?);
    }
    refuse_models(a)?;
    json_text(&compared(a, &input)?.document)
}

/// Refuses models: they are compared by touches alone.
fn refuse_models(a: &Compare) -> Result<(), Failure> {
    if a.blobs.is_empty() {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "found --blob with {}, expected touches: on measured poses, compare models with `trainer evaluate`, one by one",
        a.train.display()
    )))
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
