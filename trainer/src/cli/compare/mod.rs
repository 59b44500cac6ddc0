//! `trainer compare`.

mod args;
mod comparison;
mod document;

use std::path::{Path, PathBuf};

pub use crate::cli::compare::args::Compare;
use crate::cli::compare::comparison::{Compared, compared, statement};
pub use crate::cli::compare::document::CompareJson;
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::instrument_drift;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, document_text, write_texts};
use crate::cli::terminal::print::Printer;
use crate::cli::tolerance;
use crate::report::{never_held_out, sections};
use poegp_calibration::validation::cross_validation::ModelComparison;

pub fn run(a: &Compare) -> Result<(), Failure> {
    refuse_models(a)?;
    let output = [
        (a.json.as_deref(), Kind::Json),
        (a.report.as_deref(), Kind::Report),
    ];
    let inputs = [a.train.as_path(), Path::new(&a.robot.robot)];
    let inputs: Vec<&Path> = inputs
        .into_iter()
        .chain(a.tests.iter().map(PathBuf::as_path))
        .collect();
    let output = check_outputs(&output, &inputs)?;
    let Compared {
        document,
        report: html,
        drift,
        rows,
    } = compared(a, &Input::file(&a.train))?;
    let json = a
        .json
        .as_ref()
        .map(|_| document_text(&document))
        .transpose()?;
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

/// Compares methods on measured poses without writing any output, and returns the JSON document. The flag of a caller that
/// embeds this program cancels it.
///
/// # Errors
/// [`Failure`] about the inputs. A tolerance that is not met is no error.
pub fn document(a: &Compare, input: &Input<'_>) -> Result<String, Failure> {
    refuse_models(a)?;
    document_text(&compared(a, input)?.document)
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
