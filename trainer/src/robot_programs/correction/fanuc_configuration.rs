//! Reads the configurations of positions in Fanuc TP listings.

use crate::robot_programs::correction::program::{Configuration, Says, Stated, of_turn};
use crate::robot_programs::correction::source::Number;
use crate::robot_programs::correction::tokens::Text;

/// Letters of the two sides of wrist (flipped or not), elbow (up or down) and shoulder (top or back).
const LETTERS: [(&str, &str); 3] = [("N", "F"), ("U", "D"), ("T", "B")];

/// Reads a configuration such as `'N U T, 0, 0, 0'`: three letters, and the whole turns of joints 1, 4 and 6.
pub fn configuration(text: &Text<'_>, at: usize) -> Option<Configuration> {
    let span = text.byte(at)..text.end_of(at);
    let spelling = std::str::from_utf8(text.source.slice(&span)).ok()?;
    let sides = spelling.split(',').next()?.trim_matches(['\'', '"']);
    let letters = LETTERS.map(|(one, other)| {
        let letter = sides
            .split_whitespace()
            .find(|letter| [one, other].contains(letter))?;
        Some(letter == other)
    });
    let mut from = text.byte(at);
    let mut turns = Vec::new();
    for part in spelling.split(',') {
        let digits = part.trim_matches(['\'', '"', ' ']);
        let start = from + part.find(digits).unwrap_or(0);
        turns.extend(Number::parse(
            text.file,
            text.source,
            &(start..start + digits.len()),
        ));
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
