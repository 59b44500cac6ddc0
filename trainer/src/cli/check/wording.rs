//! The sentences in which `trainer check` states its findings and its advice.

use crate::cli::check::unexplained;
use poegp_calibration::identification::identifiability::list;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::{Change, Estimate, Moved, Report, Sensitivity};
use poegp_calibration::verification::touches::TouchReport;

/// Smallest p-value that is stated as a number; a smaller one is stated as less than this.
pub const LEAST_P: f64 = 1e-4;
/// Text in place of a size that the measurements do not determine.
pub const UNDETERMINED: &str = "an amount that these measurements do not determine";
/// Largest number of lines of a file that a sentence lists.
const SHOWN: usize = 10;

/// Returns the name of a part of the robot.
pub fn part(part: Part) -> String {
    match part {
        Part::Base => "the base".to_owned(),
        Part::Tool => "the tool".to_owned(),
        Part::Joint(joint) => format!("joint {joint}"),
        Part::Payload => "the payload's mass".to_owned(),
        Part::Size => "the arm's size".to_owned(),
    }
}

/// Fewest training poses of a model without the covariance of its error with which the check keeps its rate of false alarms.
const ENOUGH: u32 = 12;

/// States that false alarms are more frequent than stated: the check estimates the error of a model that does not contain its
/// covariance. From few poses it came out too different, and a simple method leaves errors that look like changes.
pub fn unknown_error(r: &Report, method: &str, training_poses: u32) -> Option<String> {
    let which = match (training_poses < ENOUGH, method == "parametric") {
        _ if r.model_has_error_covariance => return None,
        (true, _) => {
            format!("that was trained on {training_poses} poses, fewer than {ENOUGH}")
        }
        (false, false) => format!("of the method `{method}`"),
        (false, true) => return None,
    };
    Some(format!(
        "a model {which} does not contain the covariance of its error, which the check estimates from these measurements: false \
         alarms are more frequent than stated. A model calibrated with `--method elastic` contains the covariance."
    ))
}

/// States that false alarms are more frequent than stated in a check by touches, of any number of poses.
pub fn unknown_error_by_touches(r: &TouchReport) -> Option<String> {
    (!r.model_has_error_covariance).then(|| {
        "this model does not contain the covariance of its error: false alarms are more frequent than stated (up to 1 in 10 at \
         1 % on simulated arms)."
            .to_owned()
    })
}

/// States the findings of a check of a model of this method that was trained on so many poses.
pub fn findings(r: &Report, method: &str, training_poses: u32) -> Vec<String> {
    let mut out = Vec::new();
    if r.is_searched {
        out.push(unexplained::scatter(r));
        let unknown = unknown_error(r, method, training_poses);
        out.extend(unknown.map(|text| format!("warning: {text}")));
    }
    if !r.searched_lines.is_empty() {
        out.push(searched(r.searched_lines.len(), r.errors.poses));
    }
    if let Some(moved) = &r.during {
        out.push(format!("Moved during the check: {}.", during(moved)));
    }
    let parts = match r.during {
        Some(_) => "base, tool, joint or payload beside this",
        None => "base, tool, joint or payload",
    };
    if r.is_searched {
        out.extend(drift(&r.changes, parts, r.false_alarm_rate));
    } else {
        out.push(NOT_SEARCHED.to_owned());
    }
    if !r.outlier_lines.is_empty() {
        let lines: Vec<String> = r
            .outlier_lines
            .iter()
            .take(SHOWN)
            .map(|l| l.to_string())
            .collect();
        let more = if r.outlier_lines.len() > SHOWN {
            ", …"
        } else {
            ""
        };
        let all = r.searched_rows(r.errors.poses);
        let (which, again) = match r.outlier_lines.len() {
            1 => (
                format!("one of {all} measurements is an outlier: line"),
                "it",
            ),
            count => (
                format!("{count} of {all} measurements are outliers: lines"),
                "them",
            ),
        };
        out.push(format!(
            "warning: {which} {}{more}. Measure {again} again.",
            lines.join(", ")
        ));
    }
    out
}

/// States in how many rows changes were searched for.
pub fn searched(rows: usize, all: usize) -> String {
    format!(
        "Drift and outliers are searched for in {rows} of the {all} measurements, evenly spread. Errors are those of all."
    )
}

/// States that no change was searched for.
pub const NOT_SEARCHED: &str = "Drift: not searched for, because too few measurements have a payload that the model was trained with.";

/// Describes what moved while the rows were measured.
pub fn during(moved: &Moved) -> String {
    let size = moved.moves_mm;
    let what = match (moved.from_line, moved.part) {
        (Some(line), Part::Base) => {
            format!(
                "from line {line} on the measurements are shifted by {size:.3} mm: the instrument (base) moved"
            )
        }
        (Some(line), Part::Tool) => {
            format!(
                "from line {line} on the measurements are shifted by {size:.3} mm: the target slipped or was remounted"
            )
        }
        (Some(line), other) => format!(
            "from line {line} on the measurements are shifted by {size:.3} mm: the zero of {} changed",
            part(other)
        ),
        (None, Part::Base) => format!(
            "the measurements drift by {size:.3} mm from the first row to the last: the instrument or its stand moves, or the \
             arm warms up"
        ),
        (None, other) => format!(
            "the measurements drift by {size:.3} mm from the first row to the last, as if {} moved",
            part(other)
        ),
    };
    if moved.or_else.is_empty() {
        return what;
    }
    let others: Vec<String> = moved.or_else.iter().map(|p| part(*p)).collect();
    format!("{what} (a change of {} fits equally)", list(&others))
}

/// States that rows have payloads that the model was not trained with.
pub fn untrained_payload(count: usize, rows: usize, carried: &str, trained: &str) -> String {
    format!(
        "{count} of {rows} measurements have a payload of {carried}, but the model was trained with {trained}: it \
        does not describe how the arm sags under another payload, so the check searches for no drift in these measurements"
    )
}

/// States that a model does not know which payloads it was trained with.
pub fn unknown_payload(carried: &str) -> String {
    format!(
        "these measurements have a payload of {carried}, and this model has no record of its training payloads: under \
        another payload the arm sags differently, which looks like a change of joints"
    )
}

/// Formats a range of payloads.
pub fn payloads((light, heavy): (f64, f64)) -> String {
    match light < heavy {
        true => format!("{light} to {heavy} kg"),
        false => format!("{light} kg"),
    }
}

/// States which of the tested parts have moved.
pub fn drift(changes: &[Change], parts: &str, false_alarm_rate: f64) -> Vec<String> {
    let mut out = Vec::new();
    if changes.is_empty() {
        out.push(format!(
            "Drift: none found of {parts} (false alarms in {} % of checks).",
            100.0 * false_alarm_rate
        ));
    }
    for change in changes {
        out.push(format!("Drift: {}", sentence(change)));
        if !change.or_else.is_empty() {
            let others: Vec<String> = change.or_else.iter().map(|p| part(*p)).collect();
            out.push(format!(
                "  these measurements would fit a change of {} just as well",
                list(&others)
            ));
        }
    }
    out
}

/// States one change.
pub fn sentence(c: &Change) -> String {
    let p = if c.p_value < LEAST_P {
        format!("p < {LEAST_P}")
    } else {
        format!("p = {:.4}", c.p_value)
    };
    let text = |e: Estimate| format!("{:.3} ± {:.3}", e.value, e.plus_minus);
    let known = |size: Option<String>| size.unwrap_or(UNDETERMINED.to_owned());
    let length = |all: Option<Estimate>, parts: &[Option<Estimate>], unit: &str| {
        let of = |e: &Option<Estimate>| e.map_or("?".to_owned(), text);
        let parts: Vec<String> = parts.iter().map(of).collect();
        let all = known(all.map(|e| format!("{} {unit}", text(e))));
        format!("{all}, ({}) {unit}", parts.join(", "))
    };
    let (what, axes) = match c.part {
        Part::Base => (
            "the base has moved relative to the instrument",
            "the base's",
        ),
        Part::Tool => ("the target has moved on the flange", "the target's"),
        Part::Payload => {
            let Some(size) = c.mass_kg else {
                return format!(
                    "the payload weighs something else than the file says, by {UNDETERMINED} ({p})"
                );
            };
            let more = match size.value < 0.0 {
                true => "less",
                false => "more",
            };
            return format!(
                "the payload weighs {more} than the file says, by {:.3} ± {:.3} kg ({p})",
                size.value.abs(),
                size.plus_minus
            );
        }
        Part::Size => {
            let size = c.size_ppm;
            let than = match size.is_some_and(|e| e.value < 0.0) {
                true => "smaller",
                false => "larger",
            };
            let text = |e: Estimate| format!("{:.0} ± {:.0} ppm", e.value.abs(), e.plus_minus);
            let size = known(size.map(text));
            return format!(
                "by the stated lengths, the arm is {than} than its model by {size} ({p})"
            );
        }
        Part::Joint(joint) => {
            let size = |e: Option<Estimate>, unit: &str| {
                e.map(|e| format!("{:+.4} ± {:.4}{unit}", e.value, e.plus_minus))
            };
            let size = known(size(c.offset_deg, "°").or(size(c.offset_mm, " mm")));
            return format!("joint {joint} is off by {size} from what its controller shows ({p})");
        }
    };
    let mut out = format!(
        "{what} by {} along {axes} axes",
        length(c.shift_mm, &c.shift_xyz_mm, "mm")
    );
    if !c.turn_xyz_mrad.is_empty() {
        out += &format!(
            ", and turned by {}",
            length(c.turn_mrad, &c.turn_xyz_mrad, "mrad")
        );
    }
    format!("{out} ({p}; ± is 95 %)")
}

/// States which changes these poses can show, and which they cannot distinguish.
///
/// `these` are what was measured, as in `These poses`.
pub fn sensitivity(found: &[Sensitivity], these: &str) -> Vec<String> {
    let shown = |s: &Sensitivity| {
        let smallest = s.smallest?;
        Some(match s.unit {
            "deg" => format!("{} {smallest:.4}°", part(s.part)),
            unit => format!("{} {smallest:.3} {unit}", part(s.part)),
        })
    };
    let all: Vec<String> = found.iter().filter_map(shown).collect();
    let mut out = Vec::new();
    if !all.is_empty() {
        out.push(format!(
            "Smallest changes that {} detect in nine cases of ten: {}.",
            these.to_lowercase(),
            all.join(", ")
        ));
    }
    let hidden = found.iter().filter(|s| s.smallest.is_none());
    let hidden: Vec<String> = hidden.map(|s| part(s.part)).collect();
    if !hidden.is_empty() {
        out.push(format!(
            "{these} cannot reveal a change of {}, however large.",
            alternatives(&hidden)
        ));
    }
    for owner in [Part::Base, Part::Tool] {
        let alike: Vec<String> = found
            .iter()
            .filter(|s| s.looks_like == Some(owner))
            .map(|s| part(s.part))
            .collect();
        if !alike.is_empty() {
            out.push(format!(
                "They cannot distinguish a change of {} from one of {}.",
                list(&alike),
                part(owner)
            ));
        }
    }
    out
}

/// Joins names by commas and `or`; `joint` is said once, as in `joint 1 or 6`.
fn alternatives(names: &[String]) -> String {
    let (mut out, mut was_joint) = (String::new(), false);
    for (i, name) in names.iter().enumerate() {
        let joint = name.strip_prefix("joint ");
        out += match i {
            0 => "",
            _ if i + 1 == names.len() => " or ",
            _ => ", ",
        };
        out += joint.filter(|_| was_joint).unwrap_or(name);
        was_joint = joint.is_some();
    }
    out
}

/// States that a drift may be hidden although it would matter.
///
/// `is_default` states whether the limit is the default one.
pub fn hidden(found: &[Sensitivity], max_drift_mm: f64, is_default: bool) -> Option<String> {
    let shifts = found.iter().filter(|s| s.unit == "mm");
    let frames = shifts.filter(|s| matches!(s.part, Part::Base | Part::Tool));
    let never = found
        .iter()
        .find(|s| matches!(s.part, Part::Base | Part::Tool) && s.smallest.is_none());
    if let Some(frame) = never {
        let frame = part(frame.part);
        return Some(format!(
            "a shift of {frame}, however large, may be hidden: measure poses in other orientations"
        ));
    }
    let largest = frames.filter_map(|s| s.smallest).fold(0.0, f64::max);
    (largest > max_drift_mm).then(|| {
        format!(
            "a shift of base or tool of up to {largest:.3} mm may be hidden, and more than {max_drift_mm} mm matters \
             ({}): measure more poses",
            match is_default {
                true => "half of --max-mm, because --max-drift-mm is not given",
                false => "--max-drift-mm",
            }
        )
    })
}

/// States that a change of a joint may be hidden from touches although it would matter.
pub fn hidden_joint(found: &[Sensitivity], max_drift_mm: f64) -> Option<String> {
    let moves = |s: &&Sensitivity| s.moves_mm.unwrap_or(0.0);
    let worst = found.iter().max_by(|a, b| moves(a).total_cmp(&moves(b)))?;
    let mm = worst.moves_mm.filter(|mm| *mm > max_drift_mm)?;
    let joint = part(worst.part);
    let size = match worst.smallest {
        Some(_) => format!(" that moves the tip by up to {mm:.3} mm on average"),
        None => ", however large,".to_owned(),
    };
    Some(format!(
        "a change of {joint}{size} may be hidden, and more than {max_drift_mm} mm matters (--max-drift-mm): touch more often, \
         over a wider range of {joint}"
    ))
}

/// States which changes no touch shows.
pub const TOUCHES_DO_NOT_SHOW: &str = "Touches show neither a moved base nor a remounted tool: features and tips were \
fitted to them. A changed zero of the first joint looks like a moved base, one of the last joint like a remounted tool.";

#[cfg(test)]
mod tests {
    use super::*;

    fn of(part: Part, smallest: Option<f64>) -> Sensitivity {
        Sensitivity {
            part,
            smallest,
            unit: "mm",
            moves_mm: None,
            looks_like: None,
        }
    }

    /// A payload that the file overstates weighs less.
    #[test]
    fn a_payload_weighs_more_or_less() {
        for (value, said) in [
            (-4.951, "less than the file says, by 4.951"),
            (2.0, "more than the file says, by 2.000"),
        ] {
            let mass_kg = Some(Estimate {
                value,
                plus_minus: 0.1,
            });
            let change = Change {
                mass_kg,
                ..Change::of(Part::Payload, 1e-3)
            };
            assert!(sentence(&change).contains(said), "{}", sentence(&change));
        }
    }

    /// Where no change can be detected, the sentence names its subject.
    #[test]
    fn poses_that_detect_nothing_are_named() {
        let joint = of(Part::Joint(2), None);
        let (joint_4, base) = (of(Part::Joint(4), None), of(Part::Base, Some(0.1)));
        let said = |parts: &[Sensitivity]| sensitivity(parts, "These poses");
        let alone = said(&[joint]);
        assert_eq!(
            alone,
            ["These poses cannot reveal a change of joint 2, however large."]
        );
        let beside = said(&[base, joint, joint_4]);
        assert_eq!(
            beside[1],
            "These poses cannot reveal a change of joint 2 or 4, however large."
        );
    }

    /// What these poses never show is hidden more than what they show late.
    #[test]
    fn a_frame_that_no_pose_shows_is_hidden() {
        let base = of(Part::Base, Some(0.01));
        for (tool, said) in [
            (Some(0.01), None),
            (Some(0.3), Some("up to 0.300 mm")),
            (None, Some("the tool, however large")),
        ] {
            let found = hidden(&[base, of(Part::Tool, tool)], 0.1, true);
            let is_said = found
                .as_ref()
                .map(|text| said.is_some_and(|s| text.contains(s)));
            assert_eq!(is_said, said.map(|_| true), "{found:?}");
        }
        // A limit that nobody gave is named as what it is.
        let limit =
            |is_default: bool| hidden(&[of(Part::Tool, Some(0.3))], 0.1, is_default).unwrap();
        assert!(limit(true).contains("half of --max-mm"));
        assert!(!limit(false).contains("half of --max-mm"));
    }
}
