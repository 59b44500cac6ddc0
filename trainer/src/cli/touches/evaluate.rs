//! `trainer evaluate` with touches: the arm stays as the blob has it, and features, tips and instrument are fitted to the
//! touches.

use std::path::Path;

use crate::cli::failure::Failure;
use crate::cli::inputs::{file_name, is_training_data, warn_of_training_data};
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, warning};
use crate::cli::touches::document::EvaluateTouchesJson;
use crate::cli::touches::{
    drawn_robot, outliers_text, print_distances, print_noise, read, table, with_payload,
};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::measurement::touch::features_beside;
use poegp_calibration::validation::touches::evaluate_touches;

/// The options of an evaluation by touches.
pub struct Asked<'a> {
    pub blob: &'a Path,
    pub touches: &'a Path,
    pub features: Option<&'a Path>,
    pub json: Option<&'a Path>,
}

/// Evaluates a model, writes the outputs and prints the result.
///
/// # Errors
/// [`Failure`].
pub fn run(a: &Asked<'_>) -> Result<(), Failure> {
    let beside = features_beside(a.touches);
    let features = a.features.unwrap_or(&beside);
    check_outputs(&[a.json], &[a.blob, a.touches, features])?;
    let loaded = BlobModel::read(a.blob)?;
    let robot = drawn_robot(&loaded);
    let set = read(a.touches, a.features, &robot)?;
    with_payload(&loaded, &set)?;
    let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
    let found = evaluate_touches(&set, &nominal, robot.coupling.as_ref(), &[&loaded]);
    let Some(found) = found.first() else {
        return Ok(());
    };
    let document = EvaluateTouchesJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        training_data: is_training_data(&loaded, set.sha256[0]),
        name: file_name(a.touches),
        touches: found,
    };
    let json = json_text(&document)?;
    let json = a.json.map(|path| (path, json.as_bytes()));
    write_outputs(json.as_slice())?;
    print(Printer::for_outputs(&[a.json]), a, &document);
    Ok(())
}

fn print(report: Printer, a: &Asked<'_>, document: &EvaluateTouchesJson<'_>) {
    let found = document.touches;
    report.line(format_args!(
        "Model `{}` on {} touches ({} equations, {} states of the arm): root mean square of one component.\n",
        document.method, found.rows, found.equations, found.states
    ));
    let features = found.features.iter().chain(&found.tracker).collect();
    table(report, &[("model", features)]);
    print_distances(report, &found.distances, "by the model");
    print_noise(report, &found.noise);
    report.line(format_args!(
        "  over all rows the model misses by {:.2} times what the drawing misses by",
        found.ratio
    ));
    report.line(FITTED);
    if found.flagged > 0 {
        report.line(format_args!(
            "{} of {} states are outside of what the model was trained on.",
            found.flagged, found.states
        ));
    }
    if document.training_data {
        warn_of_training_data(a.touches, a.blob.display());
    }
    let file = a.touches.display();
    if let Some(text) = outliers_text(&found.outliers, found.rows) {
        warning(format_args!("{file}: {text}"));
    }
    if found.ratio >= 1.0 {
        warning(format_args!(
            "{file}: the drawing misses these touches by less than the model: it is of another arm, or was made of measurements that \
             do not show what these do"
        ));
    }
}

/// Note about the fitted parameters.
pub const FITTED: &str = "Features and tips were fitted to these touches, for the drawing and for the model alike, which flatters both a little. Touches see \
neither where the base is nor how the tool is turned.";
