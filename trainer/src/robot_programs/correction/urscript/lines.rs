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

/// Words that begin a function.
const FUNCTIONS: [&str; 3] = ["def", "thread", "sec"];

/// Words between or before two operands of an expression.
const OPERATORS: [&str; 4] = ["and", "or", "xor", "not"];

/// What an `end` closes.
#[derive(Clone, Copy, PartialEq)]
enum Block {
    Function,
    /// A condition, a loop or a list of cases.
    Inner,
    /// A case that has an `end` of its own.
    Case,
}

/// Returns all lines of a script that are not empty; the error is the token of a list of cases, where the number of `end`
/// does not show whether each case has one.
pub fn lines_of(text: &Text<'_>) -> Result<Vec<Line>, usize> {
    let statements = statements(text);
    let count = |starts: &[&str]| {
        let is_one = |(from, _): &&(usize, usize)| starts.contains(&text.name(*from).as_str());
        statements.iter().filter(is_one).count()
    };
    let begun = count(&FUNCTIONS) + count(&["if", "while", "for", "switch"]);
    let (cases, ends) = (count(&["case", "default"]), count(&["end"]));
    let are_cases_ended = cases > 0 && ends == begun + cases;
    let mut starts = statements.iter().map(|(from, _)| *from);
    if let Some(switch) = starts.find(|at| text.name(*at) == "switch")
        && !are_cases_ended
        && ends != begun
    {
        return Err(switch);
    }
    let mut lines = Vec::new();
    let (mut functions, mut count) = (vec![0], 0);
    let mut blocks: Vec<(usize, Block)> = Vec::new();
    for (from, end) in statements {
        let word = text.name(from);
        let is_definition = FUNCTIONS.contains(&word.as_str());
        let mut step = step_of(&word);
        if matches!(word.as_str(), "end" | "else" | "elif" | "elsif") {
            match blocks.pop() {
                Some((_, Block::Function)) => {
                    functions.pop();
                    step = Step::Other;
                }
                Some((_, Block::Inner)) => {}
                Some((_, Block::Case)) | None => step = Step::Other,
            }
        }
        count += 1;
        if is_definition {
            functions.push(count);
            blocks.push((count, Block::Function));
        }
        let inner = blocks.iter().filter(|block| block.1 == Block::Inner);
        lines.push(Line {
            from,
            end,
            function: functions.last().copied().unwrap_or(0),
            is_definition,
            blocks: inner.map(|block| block.0).collect(),
            step,
        });
        match word.as_str() {
            "if" | "while" | "for" | "switch" | "else" | "elif" | "elsif" => {
                blocks.push((count, Block::Inner));
            }
            "case" | "default" if are_cases_ended => blocks.push((count, Block::Case)),
            _ => {}
        }
    }
    Ok(lines)
}

/// Returns the statements that are not empty: tokens up to the one behind the last.
fn statements(text: &Text<'_>) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut from = 0;
    let mut next = call_end(text, from);
    for at in 0..=text.tokens.len() {
        let is_within = |token: &Token| !(token.kind == Kind::LineEnd || token.is(b';'));
        let is_mark = !text.at(at).is_some_and(is_within);
        if !is_mark && next != Some(at) {
            continue;
        }
        if at > from {
            out.push((from, at));
        }
        from = at + usize::from(is_mark);
        next = call_end(text, from);
    }
    out
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
