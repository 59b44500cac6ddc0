//! Reads the configurations of positions in Fanuc TP listings.

use crate::robot_programs::correction::program::{Configuration, Says, Stated, of_turn};
use crate::robot_programs::correction::source::Number;
use crate::robot_programs::correction::tokens::Text;

/// Letters of the two sides of wrist (flipped or not), elbow (up or down) and shoulder (top or back).
const LETTERS: [(&str, &str); 3] = [("N", "F"), ("U", "D"), ("T", "B")];

/// Letters of an arm that is on the left or on the right; no side of the branch is known from them.
const LEFT_OR_RIGHT: [&str; 2] = ["L", "R"];

/// Reads a configuration such as `'N U T, 0, 0, 0'`: letters of three sides, and the whole turns of joints 1, 4 and 6. `None`
/// where a part of it has no meaning.
pub fn configuration(text: &Text<'_>, at: usize) -> Option<Configuration> {
    let span = text.byte(at)..text.end_of(at);
    let spelling = std::str::from_utf8(text.source.slice(&span)).ok()?;
    let sides = spelling.split(',').next()?.trim_matches(['\'', '"']);
    let is_known = |letter: &str| {
        let is_side = LETTERS.iter().any(|(a, b)| [*a, *b].contains(&letter));
        is_side || LEFT_OR_RIGHT.contains(&letter)
    };
    let mut stated = sides.split_whitespace().peekable();
    if stated.peek().is_none() || !stated.all(is_known) {
        return None;
    }
    let letters = LETTERS.map(|(one, other)| {
        let letter = sides
            .split_whitespace()
            .find(|letter| [one, other].contains(letter))?;
        Some(letter == other)
    });
    let mut from = text.byte(at);
    let mut turns = Vec::new();
    for (index, part) in spelling.split(',').enumerate() {
        let digits = part.trim_matches(['\'', '"', ' ']);
        let start = from + part.find(digits).unwrap_or(0);
        if index > 0 {
            let span = start..start + digits.len();
            let turn = Number::parse(text.file, text.source, &span)?;
            turns.push(Some(turn).filter(|turn| turn.value.fract() == 0.0)?);
        }
        from += part.len() + 1;
    }
    let turns: Vec<(usize, Number)> = [0, 3, 5].into_iter().zip(turns).collect();
    let stated = |(joint, number): &(usize, Number)| Stated {
        number: *number,
        says: Says::Turn(*joint),
    };
    let bound = |(joint, number): &(usize, Number)| of_turn(*joint, number.value);
    Some(Configuration {
        letters,
        stated: turns.iter().map(stated).collect(),
        ..Configuration::monitored(turns.iter().map(bound).collect())
    })
}
