//! The refusal of touches that contradict what is stated of lengths, as text for the user.

use poegp_protocol::cause::Cause;

use crate::identification::identifiability::list;
use crate::identification::touch::lengths::{Doubt, Doubted, OWN, SIZE, StatedLength};
use crate::measurement::touch::{FeatureKind, Reading, TouchSet};
use crate::trust::{Finding, Tier};

/// Largest number of lengths that the sentence lists.
const LISTED: usize = 4;

/// Returns the finding about what is in doubt.
pub fn doubted(set: &TouchSet, found: &Doubted) -> Finding {
    let doubt = &found.doubt;
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
                "by {} this arm is {:.2} % {size} than nominal, {sigmas:.1} standard deviations (limit \
                 {SIZE}, or {OWN} where the touches determine the size poorly): either all of them are too {length} by about {:.2} % (a unit, a scale, a nominal length), \
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
        StatedLength::Scale(_) | StatedLength::Distance(_) => compared(set, found),
    };
    let is_size = doubt.length == StatedLength::All;
    let (cause, threshold) = match is_size {
        true => (Cause::Frames, SIZE),
        false => (Cause::Noise, OWN),
    };
    Finding::new(cause, Tier::Refused, text, sigmas, threshold)
}

/// Describes a wire or a board and a known distance that contradict each other, or the one of them that is wrong.
fn compared(set: &TouchSet, found: &Doubted) -> String {
    let one = |doubt: &Doubt| match doubt.length {
        StatedLength::Scale(feature) => scale(set, feature, doubt),
        StatedLength::Distance(index) => distance(set, index, doubt),
        _ => String::new(),
    };
    let (doubt, sigmas) = (one(&found.doubt), found.doubt.sigmas());
    let is_board = |length: StatedLength| match length {
        StatedLength::Scale(feature) => {
            matches!(set.features[feature].kind, FeatureKind::Board(_))
        }
        _ => false,
    };
    match &found.or {
        None if is_board(found.doubt.length) => format!(
            "{doubt}, {sigmas:.1} standard deviations (limit {OWN}): measure its squares and check the camera's focal \
             lengths, or state a larger scale_sigma_ppm"
        ),
        None => format!(
            "{doubt}, {sigmas:.1} standard deviations (limit {OWN}): measure a known length with this wire, and correct its \
             readings, or state a larger scale_sigma_ppm"
        ),
        Some(or) => format!(
            "two stated lengths contradict each other, and the touches do not show which of them is wrong: either {doubt}, \
             or {}; measure the distance again, and {}",
            one(or),
            match is_board(found.doubt.length) || is_board(or.length) {
                true => "the squares of the board",
                false => "a known length with the wire",
            }
        ),
    }
}

/// Describes the wrong scale of a wire or of a board.
fn scale(set: &TouchSet, feature: usize, doubt: &Doubt) -> String {
    let (ppm, plus_minus) = (1e6 * doubt.off, 1.96e6 * doubt.sigma);
    let (name, off) = (&set.features[feature].name, ppm.abs());
    let is_less = ppm < 0.0;
    let (stated, wrong) = match &set.features[feature].kind {
        FeatureKind::Board(board) => {
            let than = if is_less { "smaller" } else { "larger" };
            let text = format!("\"{name}\" is {off:.0} ± {plus_minus:.0} ppm {than} than stated");
            (board.scale_sigma, text)
        }
        FeatureKind::Anchor { scale_sigma, .. } => {
            let by = if is_less { "much" } else { "little" };
            let text = format!("\"{name}\" reads {off:.0} ± {plus_minus:.0} ppm too {by}");
            (*scale_sigma, text)
        }
        _ => (0.0, name.clone()),
    };
    format!(
        "{wrong} by the touches, and the file states {:.0} ppm (scale_sigma_ppm)",
        1e6 * stated
    )
}

/// Describes a wrong known distance.
fn distance(set: &TouchSet, index: usize, doubt: &Doubt) -> String {
    let known = &set.distances[index];
    let [a, b] = known.between.map(|feature| &set.features[feature].name);
    let stated = 1e3 * known.distance;
    format!(
        "the distance of \"{a}\" and \"{b}\" is {:.2} ± {:.2} mm by the touches and {stated:.2} mm in the file",
        stated + 1e3 * doubt.off,
        1.96e3 * doubt.sigma
    )
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
