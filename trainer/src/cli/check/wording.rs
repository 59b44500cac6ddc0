//! The sentences in which `trainer check` states its findings and its advice.

use poegp_calibration::identification::identifiability::list;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::{Change, Estimate, Report, Sensitivity};

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

/// States the findings of a check.
pub fn findings(r: &Report) -> Vec<String> {
    let rotation = r
        .noise_mrad
        .map_or(String::new(), |mrad| format!(" and {mrad:.4} mrad"));
    let mut out = vec![format!(
        "Noise of these measurements: {:.4} mm{rotation} per axis; the model is expected to be off by {:.4} mm per axis.",
        r.noise_mm, r.model_mm
    )];
    if !r.model_knows_its_error {
        out.push(
            "warning: a model without processes of the joints does not know its own error: false alarms are more frequent than \
             stated (14 in 100 at 1 % with `poe` on a measured arm); calibrate with `--method elastic` to have them."
                .to_owned(),
        );
    }
    out.extend(drift(
        &r.changes,
        "base, tool, joint or payload",
        r.false_alarm_rate,
    ));
    if !r.odd_lines.is_empty() {
        let lines: Vec<String> = r
            .odd_lines
            .iter()
            .take(SHOWN)
            .map(|l| l.to_string())
            .collect();
        let more = if r.odd_lines.len() > SHOWN {
            ", …"
        } else {
            ""
        };
        out.push(format!(
            "warning: {} of {} measurements stand out from the others: lines {}{more}. Measure them again.",
            r.odd_lines.len(),
            r.errors.poses,
            lines.join(", ")
        ));
    }
    out
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

fn sentence(c: &Change) -> String {
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
        Part::Base => ("the base has moved against the instrument", "the base's"),
        Part::Tool => ("the target has moved at the flange", "the target's"),
        Part::Payload => {
            let size = c.mass_kg;
            let size = size.map(|e| format!("{:+.3} ± {:.3} kg", e.value, e.plus_minus));
            let size = known(size);
            return format!("the payload weighs more than the file says, by {size} ({p})");
        }
        Part::Size => {
            let size = c.size_ppm;
            let size = known(size.map(|e| format!("{:+.0} ± {:.0} ppm", e.value, e.plus_minus)));
            return format!(
                "by the stated lengths, the arm is larger than its model by {size} ({p})"
            );
        }
        Part::Joint(joint) => {
            let size = |e: Option<Estimate>, unit: &str| {
                e.map(|e| format!("{:+.4} ± {:.4}{unit}", e.value, e.plus_minus))
            };
            let size = known(size(c.offset_deg, "°").or(size(c.offset_mm, " mm")));
            return format!("joint {joint} stands {size} from where its controller says ({p})");
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
pub fn sensitivity(found: &[Sensitivity]) -> Vec<String> {
    let shown = |s: &Sensitivity| {
        let smallest = s.smallest?;
        Some(match s.unit {
            "deg" => format!("{} {smallest:.4}°", part(s.part)),
            unit => format!("{} {smallest:.3} {unit}", part(s.part)),
        })
    };
    let all: Vec<String> = found.iter().filter_map(shown).collect();
    let mut out = vec![format!(
        "These poses show nine times in ten a change of: {}.",
        all.join(", ")
    )];
    let hidden = found.iter().filter(|s| s.smallest.is_none());
    let hidden: Vec<String> = hidden.map(|s| part(s.part)).collect();
    if !hidden.is_empty() {
        out.push(format!(
            "They show no change of {}, however large.",
            list(&hidden)
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

/// States that a drift may be hidden although it would matter.
pub fn hidden(found: &[Sensitivity], max_drift_mm: f64) -> Option<String> {
    let shifts = found.iter().filter(|s| s.unit == "mm");
    let frames = shifts.filter(|s| matches!(s.part, Part::Base | Part::Tool));
    let largest = frames.filter_map(|s| s.smallest).fold(0.0, f64::max);
    (largest > max_drift_mm).then(|| {
        format!(
            "a shift of base or tool of up to {largest:.3} mm may be hidden, and more than {max_drift_mm} mm matters \
             (--max-drift-mm): measure more poses"
        )
    })
}

/// The findings that the advice depends on.
#[derive(Clone, Copy)]
pub struct Outcome<'a> {
    /// Changes that were found.
    pub changes: &'a [Change],
    /// Mean error after these changes are taken out, mm.
    pub without_mm: f64,
    /// Lines of measurements that stand out from the others.
    pub odd_lines: &'a [usize],
    /// Measurements that a new calibration needs, as in `measure 100 poses or more`.
    pub more: &'a str,
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
        odd_lines,
        more,
    } = *found;
    let mut out = Vec::new();
    for change in changes {
        let alone = if changes.len() == 1 && without_mm <= max_mm {
            "; the rest of the calibration is as it was"
        } else {
            ""
        };
        let step = match change.part {
            Part::Base => {
                "see what moved, robot or instrument, and measure the base frame again".to_owned()
            }
            Part::Tool => {
                "see whether the tool or the target is loose, and measure the tool frame again"
                    .to_owned()
            }
            Part::Joint(joint) => {
                format!(
                    "reset the zero of joint {joint} (a collision? a lost encoder?) and check again"
                )
            }
            Part::Payload => "weigh what is mounted, and give its mass".to_owned(),
            Part::Size => {
                "measure the known distances, radii and wires again: an arm does not change its size"
                    .to_owned()
            }
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
        out.push(step + &others + alone);
    }
    if changes.is_empty() && !tolerance_met {
        out.push(if odd_lines.is_empty() {
            format!("nothing that has moved explains it: {more} and calibrate again")
        } else {
            "measure the poses again that stand out, then check again".to_owned()
        });
    } else if !tolerance_met && without_mm > max_mm {
        out.push(format!(
            "that does not explain all: {more} and calibrate again"
        ));
    } else if !changes.is_empty() && !drift_matters && tolerance_met {
        out.push("the drift is too small to matter; check again soon".to_owned());
    }
    out
}
