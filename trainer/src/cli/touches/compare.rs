//! `trainer compare` with touches: compares existing models by the same touches.

use std::path::{Path, PathBuf};

use crate::cli::args::RobotArgs;
use crate::cli::failure::Failure;
use crate::cli::inputs::{Arm, file_name, is_training_data, origin, warn_of_training_data};
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, warning};
use crate::cli::touches::document::{CompareTouchesJson, ModelJson};
use crate::cli::touches::evaluate::FITTED;
use crate::cli::touches::{compare_page, outliers_text, read, table, with_payload};
use crate::report::provenance::command_line;
use crate::report::{FileSummary, Provenance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, features_beside};
use poegp_calibration::validation::touches::evaluate_touches;

/// The options of a comparison by touches.
pub struct Asked<'a> {
    pub robot: &'a RobotArgs,
    pub touches: &'a Path,
    pub features: Option<&'a Path>,
    pub blobs: &'a [PathBuf],
    pub report: Option<&'a Path>,
    pub json: Option<&'a Path>,
}

/// Compares models, writes the outputs and prints the result.
///
/// # Errors
/// [`Failure`].
pub fn run(a: &Asked<'_>) -> Result<(), Failure> {
    if a.blobs.is_empty() {
        return Err(Failure::Usage(format!(
            "found touches ({}) without --blob, expected the models to compare by them: --blob a.blob --blob b.blob",
            a.touches.display()
        )));
    }
    let beside = features_beside(a.touches);
    let mut inputs = vec![a.touches, a.features.unwrap_or(&beside)];
    inputs.push(Path::new(&a.robot.robot));
    inputs.extend(a.blobs.iter().map(PathBuf::as_path));
    let outputs = [a.json, a.report];
    check_outputs(&outputs, &inputs)?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let set = read(a.touches, a.features, &arm.robot)?;
    let mut loaded = Vec::new();
    for path in a.blobs {
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
    let models = found.into_iter().zip(&loaded).zip(a.blobs);
    let models = models.map(|((touches, loaded), path)| ModelJson {
        file: path.display().to_string(),
        method: loaded.host().provenance.method.to_owned(),
        training_data: is_training_data(loaded, set.sha256[0]),
        touches,
    });
    let document = CompareTouchesJson {
        version: env!("CARGO_PKG_VERSION"),
        name: file_name(a.touches),
        models: models.collect(),
        provenance: provenance(a, &arm.robot.name, &set, &loaded),
    };
    let json = json_text(&document)?;
    let page = a.report.map(|path| (path, compare_page::page(&document)));
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(page.iter().map(|(path, html)| (*path, html.as_bytes())));
    files.extend(a.json.map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(Printer::for_outputs(&outputs), a, &document);
    Ok(())
}

fn provenance(a: &Asked<'_>, robot: &str, set: &TouchSet, loaded: &[BlobModel]) -> Provenance {
    let mut files: Vec<FileSummary> = FileSummary::of_touches(set).into();
    let models = loaded.iter().zip(a.blobs);
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
    Provenance {
        command: command_line(),
        version: env!("CARGO_PKG_VERSION"),
        date: origin(set.sha256[0], "", Vec::new()).date,
        seed: None,
        robot: robot.to_owned(),
        serial_number: serial_number.to_owned(),
        files,
    }
}

fn print(report: Printer, a: &Asked<'_>, document: &CompareTouchesJson) {
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
            "  {a} to {b}: {:.3} mm ± {:.3}, as drawn {:+.3}, {}",
            distance.said_mm,
            distance.sigma_mm,
            distance.error_mm[0],
            each.join(", ")
        ));
    }
    for model in &document.models {
        report.line(format_args!(
            "  over all rows {} misses by {:.2} times what the drawing misses by",
            model.file, model.touches.ratio
        ));
    }
    report.line(FITTED);
    for model in document.models.iter().filter(|model| model.training_data) {
        warn_of_training_data(a.touches, &model.file);
    }
    if let Some(text) = outliers_text(&first.outliers, first.rows) {
        warning(format_args!("{}: {text}", a.touches.display()));
    }
}
