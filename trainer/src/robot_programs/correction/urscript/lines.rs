//! Splits a URScript into lines, each with its function and the conditions around it.

use crate::robot_programs::correction::flow::Step;
use crate::robot_programs::correction::tokens::{Kind, Text};
use crate::robot_programs::correction::urscript::states::Setting;

/// One line, with its function and the conditions around it.
#[derive(Clone)]
pub struct Line {
    /// First token, and below it the token behind the last one.
    pub from: usize,
    pub end: usize,
    /// Number of the function in the order of the script; 0 outside all functions.
    pub function: usize,
    /// Whether the function begins at the line.
    pub is_definition: bool,
    /// Conditions and loops around the line, outermost first.
    pub blocks: Vec<usize>,
    /// What its first word does to the order of the lines.
    pub step: Step<Setting>,
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
            let is_definition = matches!(word.as_str(), "def" | "thread" | "sec");
            let mut step = step_of(&word);
            if matches!(word.as_str(), "end" | "else" | "elif" | "elsif") {
                match blocks.pop() {
                    Some((_, true)) => {
                        functions.pop();
                        step = Step::Other;
                    }
                    Some(_) => {}
                    None => step = Step::Other,
                }
            }
            count += 1;
            if is_definition {
                functions.push(count);
                blocks.push((count, true));
            }
            lines.push(Line {
                from,
                end: at,
                function: functions.last().copied().unwrap_or(0),
                is_definition,
                blocks: blocks.iter().filter(|b| !b.1).map(|b| b.0).collect(),
                step,
            });
            if matches!(
                word.as_str(),
                "if" | "while" | "for" | "switch" | "else" | "elif" | "elsif"
            ) {
                blocks.push((count, false));
            }
        }
        from = at + 1;
    }
    lines
}

fn step_of(word: &str) -> Step<Setting> {
    match word {
        "if" => Step::Branch,
        "switch" => Step::Cases,
        "elif" | "elsif" | "case" => Step::Next(false),
        "else" | "default" => Step::Next(true),
        "while" | "for" => Step::Loop,
        "end" => Step::End,
        "break" => Step::Break,
        "continue" => Step::Continue,
        "return" | "halt" => Step::Return,
        _ => Step::Other,
    }
}
