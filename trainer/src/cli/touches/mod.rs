//! Touches in the commands that judge models by them: reading, and the table of touched features.

pub mod compare;
mod compare_page;
mod document;
pub mod evaluate;

use std::path::Path;

use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::robot_of;
use crate::cli::terminal::print::{Printer, note};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, is_touch_file};
use poegp_calibration::model::touches::summary::{DistanceSummary, FeatureSummary, NoiseSummary};
use poegp_calibration::robot::Robot;
use poegp_calibration::validation::touches::nominal_arm;

/// Whether a file contains touches: a features file is given, or the header of the file is that of touches.
pub fn are_touches(path: &Path, features: Option<&Path>) -> bool {
    features.is_some() || is_touch_file(path)
}

/// Whether the measurements of a caller that embeds this program are touches.
///
/// # Errors
/// [`Failure::Usage`] for a features file with a table in memory.
pub fn are_touches_in_file(input: &Input<'_>, features: Option<&Path>) -> Result<bool, Failure> {
    match (input.bytes, features) {
        (None, _) => Ok(are_touches(input.path, features)),
        (Some(_), None) => Ok(false),
        (Some(_), Some(_)) => Err(features_of_a_table(input.path)),
    }
}

/// Creates the error about a features file with a table of poses.
pub fn features_of_a_table(table: &Path) -> Failure {
    Failure::Usage(format!(
        "found --features with the table {}, expected the touches in a file",
        table.display()
    ))
}

/// Refuses the first given option that has no meaning for touches.
///
/// # Errors
/// [`Failure::Usage`].
pub fn refuse_options(path: &Path, given: &[(bool, &str)]) -> Result<(), Failure> {
    match given.iter().find(|(is_given, _)| *is_given) {
        Some((_, option)) => Err(Failure::Usage(format!(
            "found {option} with touches ({}), expected measurements of a tracker for it",
            path.display()
        ))),
        None => Ok(()),
    }
}

/// Reads touches; notes go to standard error.
pub fn read(path: &Path, features: Option<&Path>, robot: &Robot) -> Result<TouchSet, InputError> {
    let set = TouchSet::read(path, features, robot)?;
    for text in &set.notes {
        note(format_args!("{}: {text}", path.display()));
    }
    Ok(set)
}

/// Returns the arm of a blob nominal, from base to flange.
pub fn nominal_robot(loaded: &BlobModel) -> Robot {
    Robot {
        parent_from_joint: nominal_arm(loaded),
        ..robot_of(loaded)
    }
}

/// Refuses touches without a payload for a model that depends on it.
pub fn with_payload(loaded: &BlobModel, set: &TouchSet) -> Result<(), InputError> {
    let is_needed = loaded.blob().ranges.payload_kg.is_some();
    match is_needed && set.rows.iter().any(|row| row.payload_kg.is_none()) {
        true => Err(InputError::new(
            &set.path,
            "no payload_kg column",
            "a payload_kg column, because the model depends on the payload",
        )),
        false => Ok(()),
    }
}

/// Prints the table of touched features: a row for each feature, with the RMS of one component nominal and with each of
/// `models`, which are a name and the summaries of the same features.
pub fn table(report: Printer, models: &[(&str, Vec<&FeatureSummary>)]) {
    let mut header = vec!["feature", "kind", "rows", "left out", "nominal"];
    header.extend(models.iter().map(|(name, _)| *name));
    header.push("");
    let Some((_, first)) = models.first() else {
        return;
    };
    let row = |(k, f): (usize, &&FeatureSummary)| {
        let mut row = vec![
            f.name.clone(),
            f.kind.to_owned(),
            f.rows.to_string(),
            f.rejected.to_string(),
            format!("{:.3}", f.rms[0]),
        ];
        row.extend(
            models
                .iter()
                .map(|(_, features)| format!("{:.3}", features[k].rms[1])),
        );
        row.push(f.unit.to_owned());
        row
    };
    let rows: Vec<Vec<String>> = first.iter().enumerate().map(row).collect();
    report.table(&header, &rows);
}

/// Prints known distances: as stated, nominal, and as calculated with a model.
pub fn print_distances(report: Printer, distances: &[DistanceSummary], model: &str) {
    for distance in distances {
        let [a, b] = &distance.between;
        report.line(format_args!(
            "  {a} to {b}: {:.3} mm ± {:.3}, nominal {:+.3}, {model} {:+.3}",
            distance.stated_mm, distance.sigma_mm, distance.error_mm[0], distance.error_mm[1]
        ));
    }
}

/// Prints the noise of each kind of reading.
pub fn print_noise(report: Printer, noise: &[NoiseSummary]) {
    for noise in noise {
        report.line(format_args!(
            "  noise of {}: {:.3} {} stated, {:.3} beyond",
            noise.kind, noise.stated, noise.unit, noise.beyond
        ));
    }
}
