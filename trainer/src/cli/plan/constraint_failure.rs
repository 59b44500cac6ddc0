//! The error for a robot cell that allows too few poses: which constraints forbid them, and which would free some.

use std::path::PathBuf;

use crate::cli::failure::Failure;
use poegp_calibration::input_error::InputError;
use poegp_calibration::planning::TooTight;
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::planning::refusals::{Refusals, Release};
use poegp_calibration::robot::Robot;

/// Largest number of suggestions for constraints to drop.
const MOST_NAMED: usize = 3;

/// Creates the error for too few configurations; it points at the constraint that would free the most.
pub(super) fn too_tight(constraints: &Constraints, robot: &Robot, error: &TooTight) -> Failure {
    let found = format!(
        "{} of {} random configurations allowed",
        error.allowed, error.drawn
    );
    let expected = format!("at least {} to plan with", error.needed);
    let rules = &constraints.rules;
    let percent = |i: usize| share(error.refusals.forbidden_by(i), error.drawn);
    let forbidden: Vec<String> = (0..rules.len())
        .map(|i| format!("{} by {}", percent(i), rules[i].name()))
        .collect();
    let mut help = format!(
        "forbidden: {}; {}",
        forbidden.join(", "),
        releases(constraints, &error.refusals)
    );
    if let Some(wider) = &error.wider_range {
        help += &format!(
            "; without the range of joint \"{}\", {} of {} would be allowed",
            robot.joints[wider.joint].name, wider.allowed, wider.drawn
        );
    }
    // The error points at a constraint that is in the file; of those, at the one that frees the most.
    let releases = error.refusals.releases();
    let to_look_at = releases.iter().flat_map(|release| &release.rules);
    let blamed = to_look_at.chain(&[]).find(|i| rules[**i].line.is_some());
    let error = match &constraints.file {
        Some(file) => InputError::new(file, found, expected),
        None => InputError::new(PathBuf::from("<no constraints>"), found, expected),
    };
    match blamed.and_then(|i| Some((&rules[*i], rules[*i].line?))) {
        Some((rule, line)) => error.at_line(line).at_column(1, rule.name()),
        None => error,
    }
    .with_help(help)
    .into()
}

/// Describes, as part of a sentence, which constraints must give way to allow more configurations.
pub(super) fn releases(constraints: &Constraints, refusals: &Refusals) -> String {
    let releases = refusals.releases();
    let Some(first) = releases.first() else {
        return "only the joint ranges limit the poses".to_owned();
    };
    let named = |release: &Release| {
        let names: Vec<String> = release
            .rules
            .iter()
            .map(|i| constraints.rules[*i].name())
            .collect();
        format!("{} more without {}", release.frees, names.join(" and "))
    };
    let list: Vec<String> = releases.iter().take(MOST_NAMED).map(named).collect();
    let prefix = match first.rules.len() {
        1 => "there would be ",
        _ => "dropping a single constraint would allow none; there would be ",
    };
    let mut remedies: Vec<&str> = first
        .rules
        .iter()
        .map(|i| constraints.rules[*i].remedy())
        .collect();
    remedies.dedup();
    format!(
        "{prefix}{}; to allow more, {}",
        list.join(", "),
        remedies.join(", and ")
    )
}

/// Formats a share in per cent, never rounded to 0 or 100.
fn share(part: usize, whole: usize) -> String {
    let percent = 100.0 * part as f64 / whole.max(1) as f64;
    match percent {
        _ if part == whole => "all".to_owned(),
        _ if part == 0 => "none".to_owned(),
        p if p < 0.1 => "less than 0.1 %".to_owned(),
        p if p > 99.9 => "more than 99.9 %".to_owned(),
        p => format!("{p:.1} %"),
    }
}
