//! Syntax of RAPID's motions and lists.

use crate::robot_programs::correction::program::{Location, Way};
use crate::robot_programs::correction::rapid::data::{Read, target};
use crate::robot_programs::correction::tokens::{Text, Value};

/// Returns the path of a motion, its number of points, and the index of its tool argument.
pub fn shape(name: &str) -> Option<(Way, usize, usize)> {
    let known = |start: &str, tool: usize| {
        let rest = name.strip_prefix(start)?;
        let kinds = [
            ("absj", Way::Joints, 1),
            ("l", Way::Line, 1),
            ("j", Way::Joints, 1),
            ("c", Way::Arc, 2),
        ];
        kinds.into_iter().find_map(|(kind, way, points)| {
            let suffix = rest.strip_prefix(kind)?;
            let is_known = match start {
                // On a line or a circle alone.
                "arc" | "disp" => {
                    let process = suffix.trim_start_matches(['1', '2']);
                    kind.len() == 1 && kind != "j" && matches!(process, "" | "start" | "end")
                }
                _ => matches!(suffix, "" | "sync" | "do" | "ao" | "go"),
            };
            is_known.then_some((way, points, tool + points - 1))
        })
    };
    // Welding has data of seam and weld before the zone, dispensing those of the bead.
    known("move", 3)
        .or_else(|| known("trigg", 4))
        .or_else(|| known("arc", 5))
        .or_else(|| known("disp", 4))
}

/// Returns whether an instruction leaves the arm where it is, so that a line begins where the move before has ended.
pub fn stays(name: &str) -> bool {
    matches!(
        name,
        "set"
            | "reset"
            | "setdo"
            | "setao"
            | "setgo"
            | "pulsedo"
            | "waittime"
            | "waitdi"
            | "waitdo"
            | "waituntil"
            | "tpwrite"
            | "tperase"
            | "accset"
            | "velset"
            | "singarea"
            | "confl"
            | "confj"
            | "clkstart"
            | "clkstop"
            | "clkreset"
            | "incr"
            | "decr"
            | "add"
    )
}

/// An argument of an instruction or function.
pub struct Piece {
    /// Name of an optional argument in lower case; `None` for a positional one.
    pub switch: Option<String>,
    /// Its value: tokens `from` to `end`, none for a switch alone.
    pub from: usize,
    pub end: usize,
}

/// Returns the arguments between two tokens: `p10\ID:=5,v100\Far?w`.
pub fn pieces(text: &Text<'_>, from: usize, end: usize) -> Vec<Piece> {
    let mut out = Vec::new();
    let (mut start, mut is_optional) = (from, false);
    while start < end {
        let stop = text.find(start, end, b",\\");
        // The argument of an optional parameter may depend on that of the caller: \Far?w
        let value = match () {
            () if !is_optional => start,
            () if text.is(start + 1, b':') && text.is(start + 2, b'=') => start + 3,
            () if text.is(start + 1, b'?') => start + 2,
            () => stop,
        };
        if stop > start {
            out.push(Piece {
                switch: is_optional.then(|| text.name(start)),
                from: value.min(stop),
                end: stop,
            });
        }
        is_optional = text.is(stop, b'\\');
        start = stop + 1;
    }
    out
}

/// Returns the positional arguments, and the optional ones with the tokens of their values.
#[allow(clippy::type_complexity)]
pub fn arguments(
    text: &Text<'_>,
    from: usize,
    end: usize,
) -> (Vec<(usize, usize)>, Vec<(String, (usize, usize))>) {
    let (mut positional, mut switches) = (Vec::new(), Vec::new());
    for (start, stop) in text.arguments(from, end) {
        let mut slash = text.find(start, stop, b"\\");
        if slash > start {
            positional.push((start, slash));
        }
        while slash < stop {
            let next = text.find(slash + 1, stop, b"\\");
            let equals = text.find(slash + 1, next, b":");
            switches.push((text.name(slash + 1), ((equals + 2).min(next), next)));
            slash = next;
        }
    }
    (positional, switches)
}

/// Returns the token ranges of the elements of a list with `depth` dimensions; for depth 0, that of the list itself.
pub fn list_starts(text: &Text<'_>, from: usize, end: usize, depth: usize) -> Vec<(usize, usize)> {
    let is_list = text.is(from, b'[') && text.is(end.max(1) - 1, b']');
    if depth == 0 || !is_list {
        return vec![(from, end)];
    }
    let elements = text.arguments(from + 1, end - 1);
    // The list has more dimensions if its first element is no target, but a list that begins with one.
    let is_deeper = elements.first().is_some_and(|(a, b)| {
        let value = text.value(*a, *b);
        matches!(target(&value, Location { file: 0, at: 0 }), Read::Nothing)
            && matches!(&value, Value::List(inner) if inner.first().is_some_and(|v| {
                !matches!(target(v, Location { file: 0, at: 0 }), Read::Nothing)
            }))
    });
    elements
        .into_iter()
        .flat_map(|(a, b)| list_starts(text, a, b, usize::from(is_deeper)))
        .collect()
}
