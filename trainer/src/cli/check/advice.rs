//! What `trainer check` advises to do next.

use crate::cli::check::unexplained::{Rest, doubtful};
use crate::cli::check::wording::part;
use crate::cli::failure::Failure;
use poegp_calibration::identification::identifiability::list;
use poegp_calibration::numeric::statistics::MEAN_LENGTH;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::{Change, Estimate, Moved, Report};

/// Returns the failure of a check whose calibration does not hold: the reasons that apply, each with the mm allowed.
pub fn does_not_hold(reasons: [(Option<String>, f64); 2], advice: &[String]) -> Failure {
    let of = |(reason, mm)| Some(format!("{}, above the {mm} mm allowed", reason?));
    let reasons: Vec<String> = reasons.into_iter().filter_map(of).collect();
    Failure::Quality(format!(
        "the calibration does not hold: {}\nhelp: {}",
        reasons.join(", and "),
        advice.join("; ")
    ))
}

/// The findings that the advice depends on.
#[derive(Clone, Copy)]
pub struct Outcome<'a> {
    /// Changes that were found.
    pub changes: &'a [Change],
    /// Error after these changes are taken out, in the statistic that the tolerance is for, mm.
    pub without_mm: f64,
    /// How the errors without these changes compare with what the model expects.
    pub rest: Rest<'a>,
    /// Lines of measurements that stand out from the others.
    pub outlier_lines: &'a [usize],
    /// What moved while the rows were measured.
    pub during: Option<&'a Moved>,
    /// What to do about payloads that the model was not trained with, or that it does not know.
    pub payloads: Option<&'a str>,
    /// Whether changes were searched for.
    pub is_searched: bool,
    /// What a new calibration needs, as in `measure 100 poses or more and calibrate again`.
    pub more: &'a str,
}

/// Advises what to do about rows that carry something else than the training.
pub fn trained_payload(trained: &str, carried: &str) -> String {
    format!("check with a payload of {trained}, or calibrate with poses that carry {carried}, too")
}

/// Advises what to do where a model does not know which payloads it was trained with.
pub fn unknown_payload(carried: &str) -> String {
    format!(
        "first make sure that the training poses had a payload of {carried}; if not, check with theirs"
    )
}

/// Returns what a new calibration needs: a richer model if this one is the cause of the error, and otherwise more poses.
pub fn new_calibration(r: &Report) -> String {
    let is_of_model = 2.0 * MEAN_LENGTH * r.model_mm >= r.without_mm.mean;
    let is_excess = matches!(Rest::of(r), Rest::Excess(_));
    match r.model_has_error_covariance || !is_of_model || is_excess {
        true => "measure 100 poses or more and calibrate again".to_owned(),
        false => format!(
            "the model error estimated from these rows is {:.3} mm per axis; calibrate with a richer model (--method elastic, or auto)",
            r.model_mm
        ),
    }
}

/// States what to do next.
pub fn advice(
    found: &Outcome<'_>,
    tolerance_met: bool,
    drift_matters: bool,
    max_mm: f64,
) -> Vec<String> {
    let Outcome {
        changes,
        without_mm,
        rest,
        outlier_lines,
        during,
        payloads,
        is_searched,
        more,
    } = *found;
    let doubt = match rest {
        Rest::Excess(rest) => Some(match changes.is_empty() {
            true => format!("find out what changed; {more}"),
            false => doubtful(rest, more),
        }),
        _ => None,
    };
    if tolerance_met && !drift_matters {
        return match (doubt, changes) {
            (Some(doubt), _) => vec![doubt],
            (None, []) => Vec::new(),
            (None, _) => vec![tolerated(changes)],
        };
    }
    let mut out = Vec::new();
    out.extend(payloads.map(str::to_owned));
    out.extend(during.map(after_motion));
    if !changes.is_empty() && !outlier_lines.is_empty() {
        out.push("first measure the outliers again and repeat the check".to_owned());
    }
    let is_doubtful = doubt.is_some() && !changes.is_empty();
    out.extend(doubt.filter(|_| is_doubtful));
    let is_sure =
        matches!(rest, Rest::AsExpected) && outlier_lines.is_empty() && payloads.is_none();
    let is_advised = |change: &&Change| !is_doubtful || change.part == Part::Payload;
    for change in changes.iter().filter(is_advised) {
        let alone = if changes.len() == 1 && is_sure {
            "; the rest of the calibration is as it was"
        } else {
            ""
        };
        let others: Vec<String> = change.or_else.iter().map(|p| part(*p)).collect();
        let others = if others.is_empty() {
            String::new()
        } else {
            format!(
                " (or look at {}: these poses cannot distinguish them)",
                list(&others)
            )
        };
        out.push(repair(change) + &others + alone);
    }
    if !is_searched || changes.is_empty() && during.is_some() {
        return out;
    }
    if changes.is_empty() && !tolerance_met {
        out.push(if outlier_lines.is_empty() {
            format!("no detectable change explains the error: {more}")
        } else {
            "measure the outliers again and repeat the check".to_owned()
        });
    } else if !tolerance_met && without_mm > max_mm && !is_doubtful {
        out.push(match rest {
            Rest::AsExpected => format!(
                "without this drift, the errors are what the model expects, but more than is allowed: {more}"
            ),
            _ => format!("this does not explain the whole error: {more}"),
        });
    }
    out
}

/// Advises about a drift that does not matter.
fn tolerated(changes: &[Change]) -> String {
    let parts: Vec<String> = changes.iter().map(|c| part(c.part)).collect();
    format!(
        "the drift of {} is within what is allowed for positions: the calibration can stay in use, with this drift in its errors",
        list(&parts)
    )
}

/// Advises what to do about rows during which something moved.
fn after_motion(moved: &Moved) -> String {
    match moved.from_line {
        Some(line) => format!(
            "find out what moved before line {line} was measured, and measure these rows again; a base, tool or zero from \
             rows before and after it would be an average of two"
        ),
        None => "find out what moved slowly, let instrument and arm settle, and measure these rows again; reference points \
             beside the robot and --correct-drift remove a slow motion of the instrument"
            .to_owned(),
    }
}

/// Advises what to do about a part that has changed.
fn repair(changed: &Change) -> String {
    match changed.part {
        Part::Base => {
            "find out whether the robot or the instrument moved, and measure the base frame again"
                .to_owned()
        }
        Part::Tool => {
            "check whether the tool or the target is loose, and measure the tool frame again"
                .to_owned()
        }
        Part::Joint(joint) => {
            let by = |e: Option<Estimate>, unit| Some(format!("{:+.4}{unit}", e?.value));
            let by = by(changed.offset_deg, "°").or(by(changed.offset_mm, " mm"));
            let by = by.map_or_else(String::new, |by| {
                format!(", whose true position is the displayed one {by},")
            });
            format!(
                "reset the zero of joint {joint} (a collision? a lost encoder?){by} and check again"
            )
        }
        Part::Payload => "weigh what is mounted, and correct payload_kg if it differs".to_owned(),
        Part::Size => {
            "measure the known distances, radii and wires again: an arm does not change its size"
                .to_owned()
        }
    }
}
