//! `trainer compare` with touches: compares existing models by the same touches.

use std::path::{Path, PathBuf};

use crate::cli::compare::Compare;
use crate::cli::failure::Failure;
use crate::cli::inputs::{Arm, file_name, is_training_data, now, training_data_warning};
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, document_text, write_texts};
use crate::cli::terminal::print::{Printer, warning};
use crate::cli::terminal::warnings;
use crate::cli::touches::document::{CompareTouchesJson, ModelJson};
use crate::cli::touches::evaluate::FITTED;
use crate::cli::touches::{compare_page, read, refuse_options, table, with_payload};
use crate::report::{FileSummary, Provenance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, features_beside};
use poegp_calibration::model::touches::findings::outliers_text;
use poegp_calibration::validation::touches::evaluate_touches;

/// Compares models, writes the outputs and prints the result.
pub fn run(a: &Compare) -> Result<(), Failure> {
    refuse_others(a)?;
    let features = a.features.as_deref();
    let beside = features_beside(&a.train);
    let mut inputs = vec![a.train.as_path(), features.unwrap_or(&beside)];
    inputs.push(Path::new(&a.robot.robot));
    inputs.extend(a.blobs.iter().map(PathBuf::as_path));
    let outputs = [
        (a.json.as_deref(), Kind::Json),
        (a.report.as_deref(), Kind::Report),
    ];
    let outputs = check_outputs(&outputs, &inputs)?;
    let document = compared(a)?;
    let json = document_text(&document)?;
    let page = a.report.as_ref().map(|_| compare_page::page(&document));
    write_texts(&[(outputs[1], page.as_deref()), (outputs[0], Some(&json))])?;
    print(Printer::for_outputs(&outputs), a, &document);
    Ok(())
}

/// Refuses options that have no meaning for touches, and touches without models.
fn refuse_others(a: &Compare) -> Result<(), Failure> {
    let given = [
        (!a.tests.is_empty(), "--test"),
        (!a.methods.is_empty(), "--methods"),
        (a.folds.is_some(), "--folds"),
        (a.seed.is_some(), "--seed"),
        (a.correct_drift, "--correct-drift"),
        (!a.accepted.accept.is_empty(), "--accept"),
        (
            a.tolerance.is_given(),
            "--tolerance-mm, --tolerance-mrad or --coverage",
        ),
    ];
    refuse_options(&a.train, &given)?;
    refuse_options(&a.train, &a.fit.given())?;
    if a.blobs.is_empty() {
        return Err(Failure::Usage(format!(
            "found touches ({}) without --blob, expected the models to compare by them: --blob a.blob --blob b.blob",
            a.train.display()
        )));
    }
    Ok(())
}

/// Compares models by touches in a file, and returns the JSON document.
///
/// # Errors
/// [`Failure`] about the inputs.
pub fn document(a: &Compare) -> Result<String, Failure> {
    document_text(&compared(a)?)
}

fn compared(a: &Compare) -> Result<CompareTouchesJson, Failure> {
    refuse_others(a)?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let set = read(&a.train, a.features.as_deref(), &arm.robot)?;
    let mut loaded = Vec::new();
    for path in &a.blobs {
        let blob = BlobModel::read(path)?;
        let name = blob.blob().robot.name;
        if name != arm.robot.name {
            let expected = format!("a model of {:?}, as --robot says", arm.robot.name);
            return Err(InputError::new(path, format!("a model of {name:?}"), expected).into());
        }
        with_payload(&blob, &set)?;
        loaded.push(blob);
    }
    let blobs: Vec<&BlobModel> = loaded.iter().collect();
    let found = evaluate_touches(&set, &arm.nominal, arm.robot.coupling.as_ref(), &blobs);
    let models = found.into_iter().zip(&loaded).zip(&a.blobs);
    let models = models.map(|((touches, loaded), path)| ModelJson {
        file: path.display().to_string(),
        method: loaded.host().provenance.method.to_owned(),
        training_data: is_training_data(loaded, set.sha256[0]),
        touches,
    });
    let document = CompareTouchesJson {
        version: env!("CARGO_PKG_VERSION"),
        name: file_name(&a.train),
        models: models.collect(),
        provenance: provenance(a, &arm.robot.name, &set, &loaded),
    };
    last_warnings(a, &document).iter().for_each(warnings::add);
    Ok(document)
}

fn provenance(a: &Compare, robot: &str, set: &TouchSet, loaded: &[BlobModel]) -> Provenance {
    let mut files: Vec<FileSummary> = FileSummary::of_touches(set).into();
    let models = loaded.iter().zip(&a.blobs);
    files.extend(models.map(|(loaded, path)| {
        FileSummary::of_bytes("model", path.display().to_string(), loaded.bytes())
    }));
    // Models of several arms of one type have no serial number in common.
    let mut numbers: Vec<&str> = loaded
        .iter()
        .map(|model| model.blob().robot.serial_number)
        .collect();
    numbers.dedup();
    let serial_number = match numbers[..] {
        [number] => number,
        _ => "",
    };
    let date = now().date().to_string();
    Provenance::new(robot, serial_number, date, files)
}

fn print(report: Printer, a: &Compare, document: &CompareTouchesJson) {
    let Some(first) = document.models.first().map(|model| &model.touches) else {
        return;
    };
    report.line(format_args!(
        "{} models on {} touches ({} equations, {} states of the arm): root mean square of one component.\n",
        document.models.len(),
        first.rows,
        first.equations,
        first.states
    ));
    let columns: Vec<_> = document
        .models
        .iter()
        .map(|model| {
            let found = &model.touches;
            let features = found.features.iter().chain(&found.tracker).collect();
            (model.file.as_str(), features)
        })
        .collect();
    table(report, &columns);
    for (k, distance) in first.distances.iter().enumerate() {
        let [a, b] = &distance.between;
        let each: Vec<String> = document
            .models
            .iter()
            .map(|model| {
                let error = model.touches.distances[k].error_mm[1];
                format!("by {} {error:+.3}", model.file)
            })
            .collect();
        report.line(format_args!(
            "  {a} to {b}: {:.3} mm ± {:.3}, nominal {:+.3}, {}",
            distance.stated_mm,
            distance.sigma_mm,
            distance.error_mm[0],
            each.join(", ")
        ));
    }
    for model in &document.models {
        report.line(format_args!(
            "  over all rows, the misses of {} are {:.2} times those of the nominal model",
            model.file, model.touches.ratio
        ));
    }
    report.line(FITTED);
    last_warnings(a, document).iter().for_each(warning);
}

/// Warnings that are printed after the results.
fn last_warnings(a: &Compare, document: &CompareTouchesJson) -> Vec<String> {
    let trained = document.models.iter().filter(|model| model.training_data);
    let trained = trained.map(|model| training_data_warning(&a.train, &model.file));
    let outliers = document.models.first().and_then(|first| {
        let text = outliers_text(&first.touches.outliers, first.touches.rows)?;
        Some(format!("{}: {text}", a.train.display()))
    });
    trained.chain(outliers).collect()
}
