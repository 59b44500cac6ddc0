//! Splits a URScript into lines, each with its function and the conditions around it. Several statements on one line of the
//! file are several lines here.

use crate::robot_programs::correction::flow::Step;
use crate::robot_programs::correction::tokens::{Kind, Text, Token};
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

/// Words between or before two operands of an expression.
const OPERATORS: [&str; 4] = ["and", "or", "xor", "not"];

/// Returns all lines of a script that are not empty.
pub fn lines_of(text: &Text<'_>) -> Vec<Line> {
    let mut lines = Vec::new();
    let (mut functions, mut count) = (vec![0], 0);
    let mut blocks: Vec<(usize, bool)> = Vec::new();
    let mut from = 0;
    let mut next = call_end(text, from);
    for at in 0..=text.tokens.len() {
        let is_within = |token: &Token| !(token.kind == Kind::LineEnd || token.is(b';'));
        let is_mark = !text.at(at).is_some_and(is_within);
        if !is_mark && next != Some(at) {
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
        from = at + usize::from(is_mark);
        next = call_end(text, from);
    }
    lines
}

/// Returns the token behind a call that begins a statement, if it begins the next statement.
fn call_end(text: &Text<'_>, from: usize) -> Option<usize> {
    let is_keyword =
        |name: &str| !matches!(step_of(name), Step::Other) || OPERATORS.contains(&name);
    let name = text.name(from);
    if name.is_empty() || is_keyword(&name) || !text.is(from + 1, b'(') {
        return None;
    }
    let behind = text.find(from + 2, text.tokens.len(), b")") + 1;
    let next = text.name(behind);
    (!next.is_empty() && !OPERATORS.contains(&next.as_str())).then_some(behind)
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
