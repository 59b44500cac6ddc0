//! What `trainer check` says of its findings, and what to do next.

use poegp_calibration::identification::identifiability::list;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::{Change, Estimate, Report, Sensitivity};

/// A p-value below this is one.
pub const LEAST_P: f64 = 1e-4;
/// Lines of a file that are listed.
const SHOWN: usize = 10;

/// Name of a part.
pub fn part(part: Part) -> String {
    match part {
        Part::Base => "the base".to_owned(),
        Part::Tool => "the tool".to_owned(),
        Part::Joint(joint) => format!("joint {joint}"),
        Part::Payload => "the payload's mass".to_owned(),
    }
}

/// What was fitted before anything was asked.
pub fn fitted(base: bool, tool: bool) -> Vec<String> {
    let what = match (base, tool) {
        (false, false) => return Vec::new(),
        (true, false) => "The base frame was",
        (false, true) => "The tool frames were",
        (true, true) => "Base and tool frames were",
    };
    vec![format!(
        "{what} fitted to these measurements, which flatters the errors a little and hides any drift of theirs."
    )]
}

/// What was found.
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
             stated (14 in 100 at 1 % with `poe` on a measured arm); use `elastic`."
                .to_owned(),
        );
    }
    if r.changes.is_empty() {
        out.push(format!(
            "Drift: none found of base, tool, joint or payload (false alarms in {} % of checks).",
            100.0 * r.false_alarm_rate
        ));
    }
    for change in &r.changes {
        out.push(format!("Drift: {}", sentence(change)));
        if !change.or_else.is_empty() {
            let others: Vec<String> = change.or_else.iter().map(|p| part(*p)).collect();
            out.push(format!(
                "  these measurements would fit a change of {} just as well",
                list(&others)
            ));
        }
    }
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

fn sentence(c: &Change) -> String {
    let p = if c.p_value < LEAST_P {
        format!("p < {LEAST_P}")
    } else {
        format!("p = {:.4}", c.p_value)
    };
    let three = |parts: &[Estimate], unit: &str| {
        let all: Vec<String> = parts
            .iter()
            .map(|e| format!("{:.3} ± {:.3}", e.value, e.plus_minus))
            .collect();
        format!("({}) {unit}", all.join(", "))
    };
    let what = match c.part {
        Part::Base => "the base has moved against the instrument",
        Part::Tool => "the target has moved at the flange",
        Part::Payload => "the payload weighs more than the file says",
        Part::Joint(joint) => {
            let (size, unit) = match (&c.offset_deg, &c.offset_mm) {
                (Some(e), _) => (*e, "°"),
                (_, Some(e)) => (*e, " mm"),
                _ => (
                    Estimate {
                        value: 0.0,
                        plus_minus: 0.0,
                    },
                    "",
                ),
            };
            return format!(
                "joint {joint} stands {:+.4} ± {:.4}{unit} from where its controller says ({p})",
                size.value, size.plus_minus
            );
        }
    };
    if let Some(kg) = &c.mass_kg {
        return format!(
            "{what}, by {:+.3} ± {:.3} kg ({p})",
            kg.value, kg.plus_minus
        );
    }
    let axes = if c.part == Part::Base {
        "the base's"
    } else {
        "the target's"
    };
    let mut out = c.shift_mm.map_or(what.to_owned(), |e| {
        format!(
            "{what} by {:.3} ± {:.3} mm, {} along {axes} axes",
            e.value,
            e.plus_minus,
            three(&c.shift_xyz_mm, "mm")
        )
    });
    if let Some(e) = &c.turn_mrad {
        out += &format!(
            ", and turned by {:.3} ± {:.3} mrad, {}",
            e.value,
            e.plus_minus,
            three(&c.turn_xyz_mrad, "mrad")
        );
    }
    format!("{out} ({p}; ± is 95 %)")
}

/// What the check can find, and what looks alike in it.
pub fn sensitivity(r: &Report) -> Vec<String> {
    let shown = |s: &Sensitivity| match s.unit {
        "deg" => format!("{} {:.4}°", part(s.part), s.smallest),
        unit => format!("{} {:.3} {unit}", part(s.part), s.smallest),
    };
    let all: Vec<String> = r.sensitivity.iter().map(shown).collect();
    let mut out = vec![format!(
        "These poses show nine times in ten a change of: {}.",
        all.join(", ")
    )];
    for owner in [Part::Base, Part::Tool] {
        let alike: Vec<String> = r
            .sensitivity
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

/// What to do next.
pub fn advice(r: &Report, tolerance_met: bool, drift_matters: bool, max_mm: f64) -> Vec<String> {
    let mut out = Vec::new();
    for change in &r.changes {
        let alone = if r.changes.len() == 1 && r.without_mm.mean <= max_mm {
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
    if r.changes.is_empty() && !tolerance_met {
        out.push(if r.odd_lines.is_empty() {
            "nothing that has moved explains it: measure 100 poses or more and calibrate again"
                .to_owned()
        } else {
            "measure the poses again that stand out, then check again".to_owned()
        });
    } else if !tolerance_met && r.without_mm.mean > max_mm {
        out.push(
            "that does not explain all: measure 100 poses or more and calibrate again".to_owned(),
        );
    } else if !r.changes.is_empty() && !drift_matters && tolerance_met {
        out.push("the drift is too small to matter; check again soon".to_owned());
    }
    out
}
