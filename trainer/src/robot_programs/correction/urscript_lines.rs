//! Splits a URScript into lines, each with its function and the conditions around it.

use crate::robot_programs::correction::tokens::{Kind, Text};

/// One line, with its function and the conditions around it.
#[derive(Clone)]
pub struct Line {
    /// First token, and below it the token behind the last one.
    pub from: usize,
    pub end: usize,
    /// Number of the function in the order of the script; 0 outside all functions.
    pub function: usize,
    /// Conditions and loops around the line, outermost first.
    pub blocks: Vec<usize>,
}

/// Returns all lines of a script that are not empty.
pub fn lines_of(text: &Text<'_>) -> Vec<Line> {
    let mut lines = Vec::new();
    let (mut functions, mut count) = (vec![0], 0);
    let mut blocks: Vec<(usize, bool)> = Vec::new();
    let mut from = 0;
    for at in 0..=text.tokens.len() {
        if text.at(at).is_some_and(|token| token.kind != Kind::LineEnd) {
            continue;
        }
        if at > from {
            let word = text.name(from);
            if matches!(word.as_str(), "end" | "else" | "elif" | "elsif")
                && let Some((_, true)) = blocks.pop()
            {
                functions.pop();
            }
            lines.push(Line {
                from,
                end: at,
                function: functions.last().copied().unwrap_or(0),
                blocks: blocks.iter().filter(|b| !b.1).map(|b| b.0).collect(),
            });
            count += 1;
            match word.as_str() {
                "def" | "thread" | "sec" => {
                    functions.push(count);
                    blocks.push((count, true));
                }
                "if" | "while" | "for" | "switch" | "else" | "elif" | "elsif" => {
                    blocks.push((count, false));
                }
                _ => {}
            }
        }
        from = at + 1;
    }
    lines
}
