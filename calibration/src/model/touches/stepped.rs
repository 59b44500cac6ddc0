//! The finding of a step along the rows, as text for the user.

use poegp_protocol::cause::Cause;

use crate::identification::touch::added::Part;
use crate::identification::touch::steps::Step;
use crate::measurement::touch::TouchSet;
use crate::trust::wording::{fits_equally, length, lines, three_digits};
use crate::trust::{Finding, Tier};

/// Share of the nominal model's expected error from which on a step is refused.
const GRAVE: f64 = 1.0 / 3.0;

/// Returns the finding about a step; `nominal_mm` is the expected error of the nominal arm.
pub fn stepped(set: &TouchSet, step: &Step, nominal_mm: f64) -> Finding {
    let first: Vec<usize> = step.first.iter().map(|row| set.rows[*row].line).collect();
    let text = format!(
        "from {} on, {}: keep the rows on one side of this and measure the others again",
        lines(&first),
        described(set, step)
    );
    let is_grave = 1e3 * step.displacement > GRAVE * nominal_mm;
    let (drop, needed) = step.drop;
    let tier = Tier::refused_if(is_grave);
    Finding::new(Cause::Step, tier, text, drop, needed).of_rows(first)
}

/// Describes what changed and by how much, and what else explains the rows as well.
pub fn described(set: &TouchSet, step: &Step) -> String {
    format!("{}{}", change(set, step), others(set, step))
}

/// Describes what changed, and by how much.
fn change(set: &TouchSet, step: &Step) -> String {
    let (metres, radians) = step.moved;
    let mrad = format!("{} mrad", three_digits(1e3 * radians));
    let by = match (metres > 0.0, radians > 0.0) {
        (true, true) => format!("{} and {mrad}", length(metres)),
        (false, true) => mrad,
        _ => length(metres),
    };
    match step.part {
        Part::Joint(joint) => format!(
            "the zero of joint {} is {by} from where it was, {} at the tip",
            joint + 1,
            length(step.displacement)
        ),
        part => format!("{} by {by}", verb(set, part)),
    }
}

/// Names a change of a part.
fn verb(set: &TouchSet, part: Part) -> String {
    match part {
        Part::Feature(feature) => format!("\"{}\" was moved", set.features[feature].name),
        Part::Together => "all features, or the base of the arm, were moved".to_owned(),
        Part::Tip(tip) => format!("the tip \"{}\" slipped at the flange", set.tips[tip].name),
        Part::Camera => "the camera was moved on its mount".to_owned(),
        Part::Instrument => "the tracker or the base of the arm was moved".to_owned(),
        Part::Joint(joint) => format!("the zero of joint {} changed", joint + 1),
    }
}

/// Lists the other changes that explain the rows as well.
fn others(set: &TouchSet, step: &Step) -> String {
    let others: Vec<String> = step.others.iter().map(|part| verb(set, *part)).collect();
    fits_equally(&others)
}
