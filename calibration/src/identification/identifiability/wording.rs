//! Wording of identifiability reports: names of frames and motions, and sentences for findings.

use crate::identification::identifiability::elementary_motions::{Combination, ElementaryMotion};
use crate::identification::identifiability::frames::Role;
use crate::identification::identifiability::report::{Finding, IdentifyReport};

/// Largest number of motions that a sentence names.
const NAMES: usize = 4;
/// Largest number of findings on a terminal.
const FINDINGS: usize = 5;

/// Joins items as "a", "a and b" or "a, b and c".
pub fn list(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

/// Joins numbers as [`list`] does.
pub fn numbers(items: &[usize]) -> String {
    list(&items.iter().map(ToString::to_string).collect::<Vec<_>>())
}

/// Returns the name of a frame.
pub fn role(role: Role) -> String {
    match role {
        Role::Base => "base".to_owned(),
        Role::Link(link) => format!("link {link}"),
        Role::Tool(None) => "tool".to_owned(),
        Role::Tool(Some(tool)) => format!("tool {tool}"),
    }
}

/// Returns the name of an elementary motion in the axes of its frame (of a link: those of the joint before it, z along
/// its axis).
pub fn atom(atom: &ElementaryMotion) -> String {
    if let (Role::Link(joint), true) = (atom.role, atom.offset) {
        return format!("joint {joint}'s offset");
    }
    let owner = match atom.role {
        Role::Link(_) => role(atom.role),
        _ => format!("the {}", role(atom.role)),
    };
    let axis = ["x", "y", "z"][atom.axis % 3];
    match (atom.role, atom.axis) {
        (Role::Link(_), 0..=2) => format!("{owner}'s length along {axis}"),
        (Role::Link(_), _) => format!("{owner}'s tilt about {axis}"),
        (_, 0..=2) => format!("{owner}'s position along {axis}"),
        _ => format!("{owner}'s rotation about {axis}"),
    }
}

/// Describes directions in sentences: at most `most` directions of few motions get one each, all others share one.
pub fn directions(combinations: &[Combination], most: usize) -> Vec<Finding> {
    let names = |circuit: &Combination| -> Vec<String> {
        circuit.iter().take(NAMES).map(|(a, _)| atom(a)).collect()
    };
    let (mut short, mut long): (Vec<&Combination>, Vec<&Combination>) =
        combinations.iter().partition(|c| c.len() <= NAMES);
    short.sort_by_key(|c| c.len());
    long.splice(0..0, short.drain(short.len().min(most)..));
    let mut out: Vec<Finding> = short
        .into_iter()
        .map(|circuit| Finding {
            text: match names(circuit).as_slice() {
                [one] => format!("{one} cannot be determined from these poses"),
                names => format!("{} cannot be distinguished by these poses", list(names)),
            },
            directions: 1,
            remedy: None,
        })
        .collect();
    if let Some(first) = long.first() {
        let text = format!(
            "combinations of many motions, one of them mostly {}, cannot be determined from these poses",
            list(&names(first))
        );
        out.push(Finding {
            text,
            directions: long.len(),
            remedy: None,
        });
    }
    out
}

/// Formats the report for a terminal.
pub fn report(r: &IdentifyReport) -> Vec<String> {
    let redundant = match r.redundant {
        0 => String::new(),
        count => format!(
            "; the other {count} are redundant for any data set (frames turned and shifted along their joints)"
        ),
    };
    let condition = r.condition.map_or(String::new(), |condition| {
        format!(" (condition number {condition:.0})")
    });
    let mut out = vec![format!(
        "  identifiability: {} of {} geometric parameters{condition}{redundant}",
        r.rank, r.parameters
    )];
    let shown = r.findings.len().min(FINDINGS);
    for finding in &r.findings[..shown] {
        let count = match finding.directions {
            0 => String::new(),
            1 => " (1 direction)".to_owned(),
            count => format!(" ({count} directions)"),
        };
        out.push(format!("  unidentified: {}{count}", finding.text));
    }
    if shown < r.findings.len() {
        out.push(format!(
            "  and {} more, in --json",
            r.findings.len() - shown
        ));
    } else if let Some(strongest) = r.correlations.first() {
        let more = match r.correlations.len() {
            1 => String::new(),
            count => format!(", and {} more pairs in --json", count - 1),
        };
        out.push(format!(
            "  strongly correlated: {} and {} (r = {:.3}){more}",
            strongest.first, strongest.second, strongest.r
        ));
    }
    out.push(format!(
        "  expected prediction error from measurement noise alone: {:.4} mm RMS, {:.4} mm worst pose",
        r.expected.rms_mm, r.expected.worst_mm
    ));
    out
}
