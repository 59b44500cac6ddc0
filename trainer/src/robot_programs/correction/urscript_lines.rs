//! The lines of a URScript, each with the function and the conditions that it stands in.

use crate::robot_programs::correction::tokens::{Kind, Text};

/// One line, with the function and the conditions that it stands in.
#[derive(Clone)]
pub struct Line {
    /// Its first token, and the one behind its last.
    pub from: usize,
    pub end: usize,
    /// Which function, in the order of the script; 0 outside of all.
    pub function: usize,
    /// The conditions and loops, from the outermost.
    pub blocks: Vec<usize>,
}

/// All lines of a script that are not empty.
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
