//! Touches in the commands that judge models by them: how they are read, and the table of what was touched.

pub mod compare;
mod compare_page;
mod document;
pub mod evaluate;

use std::path::Path;

use crate::cli::failure::Failure;
use crate::cli::inputs::robot_of;
use crate::cli::terminal::print::{Printer, note};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{TouchSet, is_touch_file};
use poegp_calibration::model::touches::summary::{
    DistanceSummary, FeatureSummary, NoiseSummary, TouchOutlier,
};
use poegp_calibration::robot::Robot;
use poegp_calibration::validation::touches::drawing;

/// Whether a file is one of touches: its features are named, or its header says so.
pub fn are_touches(path: &Path, features: Option<&Path>) -> bool {
    features.is_some() || is_touch_file(path)
}

/// Refuses the first option that was given and means nothing for touches.
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
///
/// # Errors
/// [`InputError`].
pub fn read(path: &Path, features: Option<&Path>, robot: &Robot) -> Result<TouchSet, InputError> {
    let set = TouchSet::read(path, features, robot)?;
    for text in &set.notes {
        note(format_args!("{}: {text}", path.display()));
    }
    Ok(set)
}

/// The arm of a blob as drawn, from base to flange.
pub fn drawn_robot(loaded: &BlobModel) -> Robot {
    Robot {
        parent_from_joint: drawing(loaded),
        ..robot_of(loaded.blob())
    }
}

/// Refuses touches without a payload for a model that depends on it.
///
/// # Errors
/// [`InputError`].
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

/// The table of what was touched: one row each, with the RMS of a component as drawn and for each of `models`, a name and what
/// it makes of the same features.
pub fn table(report: Printer, models: &[(&str, Vec<&FeatureSummary>)]) {
    let mut header = vec!["feature", "kind", "rows", "left out", "drawn"];
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

/// Known distances as stated, as drawn and by a model.
pub fn print_distances(report: Printer, distances: &[DistanceSummary], model: &str) {
    for distance in distances {
        let [a, b] = &distance.between;
        report.line(format_args!(
            "  {a} to {b}: {:.3} mm ± {:.3}, as drawn {:+.3}, {model} {:+.3}",
            distance.said_mm, distance.sigma_mm, distance.error_mm[0], distance.error_mm[1]
        ));
    }
}

/// The noise of each kind of reading.
pub fn print_noise(report: Printer, noise: &[NoiseSummary]) {
    for noise in noise {
        report.line(format_args!(
            "  noise of {}: {:.3} {} stated, {:.3} beyond",
            noise.kind, noise.stated, noise.unit, noise.beyond
        ));
    }
}

/// Rows that are listed.
const LISTED: usize = 8;

/// The rows that do not belong, in a sentence; `None` where all do.
pub fn outliers_text(outliers: &[TouchOutlier], rows: usize) -> Option<String> {
    let each: Vec<String> = outliers
        .iter()
        .take(LISTED)
        .map(|o| format!("line {} by {:.2} {}", o.line, o.error, o.unit))
        .collect();
    let more = match outliers.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    (!outliers.is_empty()).then(|| {
        format!(
            "{} of {rows} rows do not belong and were left out: {}{more}",
            outliers.len(),
            each.join(", ")
        )
    })
}
