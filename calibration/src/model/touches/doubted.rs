//! The refusal of touches that contradict what is stated of lengths, as text for the user.

use poegp_protocol::cause::Cause;

use crate::identification::identifiability::list;
use crate::identification::touch::lengths::{Doubt, OWN, SIZE, StatedLength};
use crate::measurement::touch::{FeatureKind, Reading, TouchSet};
use crate::trust::{Finding, Tier};

/// Largest number of lengths that the sentence lists.
const LISTED: usize = 4;

/// Returns the finding about what is in doubt.
pub fn doubted(set: &TouchSet, doubt: &Doubt) -> Finding {
    let name = |feature: usize| format!("\"{}\"", set.features[feature].name);
    let plus_minus = 1.96e3 * doubt.sigma;
    let (mm, sigmas) = (1e3 * doubt.off, doubt.sigmas());
    let text = match doubt.length {
        StatedLength::All => {
            let percent = 100.0 * doubt.off;
            let (size, length) = match doubt.off > 0.0 {
                true => ("larger", "long"),
                false => ("smaller", "short"),
            };
            format!(
                "by {} this arm is {:.2} % {size} than nominal, {sigmas:.1} standard deviations of its class (limit \
                 {SIZE}): either all of them are too {length} by about {:.2} % (a unit, a scale, a nominal length), \
                 or the robot description is of another variant; measure one of them again with another method",
                lengths(set),
                percent.abs(),
                percent.abs()
            )
        }
        StatedLength::Zero(feature) => format!(
            "{} reads {:.1} ± {plus_minus:.1} mm too {}, {sigmas:.1} standard deviations (limit {OWN}): measure its \
             zero again, or state a larger zero_sigma_mm",
            name(feature),
            mm.abs(),
            if mm < 0.0 { "much" } else { "little" }
        ),
        StatedLength::Radius(feature) => {
            let stated = match set.features[feature].kind {
                FeatureKind::Sphere { radius, .. } => 1e3 * radius.unwrap_or(0.0),
                _ => 0.0,
            };
            format!(
                "the radius of {} is {:.2} ± {plus_minus:.2} mm by the touches and {stated} mm in the file, \
                 {sigmas:.1} standard deviations (limit {OWN}): is it from the centre of the ball to that of the tip? \
                 Measure it again, or state a larger radius_sigma_mm",
                name(feature),
                stated + mm
            )
        }
        StatedLength::Tip(tip, axis) => format!(
            "the tip \"{}\" is {mm:+.1} ± {plus_minus:.1} mm along {} of the flange from its tip_mm, {sigmas:.1} \
             standard deviations (limit {OWN}): measure it again, or state a larger sigma_mm",
            set.tips[tip].name,
            ["x", "y", "z"][axis]
        ),
    };
    let is_size = doubt.length == StatedLength::All;
    let (cause, threshold) = match is_size {
        true => (Cause::Frames, SIZE),
        false => (Cause::Noise, OWN),
    };
    Finding::new(cause, Tier::Refused, text, sigmas, threshold)
}

/// Names the stated lengths of a set.
fn lengths(set: &TouchSet) -> String {
    let name = |feature: usize| format!("\"{}\"", set.features[feature].name);
    let mut all: Vec<String> = set
        .distances
        .iter()
        .map(|known| {
            format!(
                "the distance of {} and {}",
                name(known.between[0]),
                name(known.between[1])
            )
        })
        .collect();
    let features = set.features.iter().enumerate();
    all.extend(features.filter_map(|(index, feature)| match feature.kind {
        FeatureKind::Sphere {
            radius: Some(_), ..
        } => Some(format!("the radius of {}", name(index))),
        FeatureKind::Anchor { .. } => Some(format!("the readings of {}", name(index))),
        FeatureKind::Board(_) => Some(format!("the size of {}", name(index))),
        _ => None,
    }));
    let is_tracked = set
        .rows
        .iter()
        .any(|row| matches!(row.reading, Reading::Tracker(_)));
    all.extend(is_tracked.then(|| "the tracker".to_owned()));
    if let Some(more) = all.len().checked_sub(LISTED).filter(|more| *more > 0) {
        all.truncate(LISTED);
        all.push(format!("{more} more"));
    }
    list(&all)
}
