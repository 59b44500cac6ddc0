//! Splits RAPID into statements, each with its routine and the conditions around it.

use crate::robot_programs::correction::flow::Step;
use crate::robot_programs::correction::rapid::data::Setting;
use crate::robot_programs::correction::rapid::syntax::shape;
use crate::robot_programs::correction::tokens::{Kind, Text};

/// One statement: tokens `from` to `end` of a file, without its semicolon.
#[derive(Clone, Debug)]
pub struct Statement {
    /// Index of the file.
    pub file: usize,
    /// Number of the routine in its file, from 1; 0 for the module itself.
    pub routine: usize,
    /// Conditions and loops around the statement, outermost first.
    pub blocks: Vec<usize>,
    /// Index of the first token.
    pub from: usize,
    /// Index of the token behind the last one.
    pub end: usize,
    /// Whether it belongs to an error handler, which may run at any time.
    pub is_handler: bool,
    /// What a keyword of conditions and loops does.
    pub step: Step<Setting>,
}

/// A routine of a file.
#[derive(Clone, Debug)]
pub struct Routine {
    /// Name in lower case.
    pub name: String,
    /// Index of the file.
    pub file: usize,
    /// Number in its file, from 1.
    pub number: usize,
    /// Whether only its own module sees it.
    pub is_local: bool,
    /// Whether an interrupt calls it.
    pub is_trap: bool,
    /// Its parameters.
    pub parameters: Vec<Parameter>,
}

/// A parameter of a routine.
#[derive(Clone, Debug)]
pub struct Parameter {
    /// Type in lower case.
    pub kind: String,
    /// Name in lower case.
    pub name: String,
    /// Whether it stands for the data of the caller, and not for their value.
    pub is_reference: bool,
    /// Whether a caller may leave it out.
    pub is_optional: bool,
    /// Whether the routine changes what it stands for.
    pub is_changed: bool,
}

/// Returns the parameters in a list.
fn parameters(text: &Text<'_>, from: usize, end: usize) -> Vec<Parameter> {
    let is_mode = |at: usize| matches!(text.name(at).as_str(), "inout" | "var" | "pers" | "ref");
    let mut out = Vec::new();
    let (mut start, mut is_optional) = (from, false);
    while start < end {
        // Optional ones follow without a comma, and a bar stands between those of which one is given: \\num n | num m
        let stop = text.find(start, end, b",\\|");
        let first = (start..stop).find(|at| !text.name(*at).is_empty() && !is_mode(*at));
        out.extend(first.map(|at| Parameter {
            kind: text.name(at),
            name: text.name(at + 1),
            is_reference: (start..at).any(is_mode),
            is_optional,
            is_changed: false,
        }));
        is_optional = text.is(stop, b'\\') || is_optional && text.is(stop, b'|');
        start = stop + 1;
    }
    out
}

/// Returns the first token of the statement behind the condition of an IF on one line: two operands without an operator
/// between them are the end of the condition and the beginning of the statement.
fn behind_condition(text: &Text<'_>, from: usize, end: usize) -> usize {
    let is_operator = |at: usize| {
        matches!(
            text.name(at).as_str(),
            "and" | "or" | "xor" | "not" | "div" | "mod"
        )
    };
    let mut depth = 0_usize;
    for at in from..end {
        match text.at(at).map(|token| token.kind) {
            Some(Kind::Mark(b'(' | b'[' | b'{')) => depth += 1,
            Some(Kind::Mark(b')' | b']' | b'}')) => depth = depth.saturating_sub(1),
            _ => {}
        }
        let is_end = text.at(at).is_some_and(|token| match token.kind {
            Kind::Mark(mark) => matches!(mark, b')' | b']' | b'}'),
            _ => !is_operator(at),
        });
        let is_start = text.at(at + 1).is_some_and(|token| match token.kind {
            Kind::Name => !is_operator(at + 1),
            kind => kind == Kind::Mark(b'%'),
        });
        if depth == 0 && is_end && is_start {
            return at + 1;
        }
    }
    end
}

/// Returns all statements and routines of a file. Its tokens must not contain line ends.
pub fn statements(text: &Text<'_>) -> (Vec<Statement>, Vec<Routine>) {
    let (mut out, mut routines) = (Vec::new(), Vec::new());
    let (mut routine, mut count) = (0, 0);
    let (mut is_local, mut is_handler) = (false, false);
    let mut blocks: Vec<usize> = Vec::new();
    // Conditions that end with the statement.
    let mut on_one_line = 0;
    let mut next_block = 0;
    let mut at = 0;
    let end = text.tokens.len();
    // Returns the first token behind a keyword, searched from `from` up to a semicolon.
    let behind = |from: usize, keyword: &str| {
        let stop = text.find(from, end, b";");
        (from..stop)
            .find(|i| text.name(*i) == keyword)
            .map(|i| i + 1)
    };
    // Skips the header: %%% VERSION:1 LANGUAGE:ENGLISH %%%
    if text.is(at, b'%') {
        let is_mark = |i: &usize| text.is(*i, b'%');
        let next = (at..end).filter(is_mark).nth(5);
        at = next.map_or(at + 1, |last| last + 1);
    }
    while at < end {
        let mut open = |blocks: &mut Vec<usize>| {
            next_block += 1;
            blocks.push(next_block);
        };
        let found = |blocks: &[usize], step, from, end| Statement {
            file: text.file,
            routine,
            blocks: blocks.to_vec(),
            from,
            end,
            is_handler,
            step,
        };
        let start = at;
        let word = text.name(at);
        let next = text.name(at + 1);
        match word.as_str() {
            "local" if matches!(next.as_str(), "proc" | "func" | "trap") => {
                is_local = true;
                at += 1;
            }
            "module" => {
                at += 2;
                if text.is(at, b'(') {
                    at = text.find(at + 1, end, b")") + 1;
                }
            }
            "proc" | "func" | "trap" => {
                count += 1;
                routine = count;
                blocks.clear();
                is_handler = false;
                let name_at = at + 1 + usize::from(word == "func");
                let mut own = Routine {
                    name: text.name(name_at),
                    file: text.file,
                    number: routine,
                    is_local: std::mem::take(&mut is_local),
                    is_trap: word == "trap",
                    parameters: Vec::new(),
                };
                at = name_at + 1;
                if text.is(at, b'(') {
                    let close = text.find(at + 1, end, b")");
                    own.parameters = parameters(text, at + 1, close);
                    at = close + 1;
                }
                routines.push(own);
            }
            "endproc" | "endfunc" | "endtrap" | "endmodule" => {
                routine = 0;
                is_handler = false;
                blocks.clear();
                at += 1;
            }
            "record" => {
                at = (at..end)
                    .find(|i| text.name(*i) == "endrecord")
                    .unwrap_or(end)
                    + 1;
            }
            "if" => {
                let stop = text.find(at, end, b";");
                let then = behind(at, "then");
                // Without THEN, one statement follows on the same line.
                at = then.unwrap_or_else(|| behind_condition(text, at + 1, stop));
                on_one_line += usize::from(then.is_none());
                out.push(found(&blocks, Step::Branch, start, at));
                open(&mut blocks);
            }
            "elseif" | "else" | "case" | "default" => {
                blocks.pop();
                at = match word.as_str() {
                    "elseif" => behind(at, "then").unwrap_or(at + 1),
                    "case" => text.find(at, end, b":;") + 1,
                    _ => at + 1 + usize::from(text.is(at + 1, b':') && !text.is(at + 2, b'=')),
                };
                let is_rest = matches!(word.as_str(), "else" | "default");
                out.push(found(&blocks, Step::Next(is_rest), start, at));
                open(&mut blocks);
            }
            "error" | "undo" | "backward" => {
                blocks.clear();
                is_handler = true;
                open(&mut blocks);
                at += 1;
            }
            "for" | "while" => {
                at = behind(at, "do").unwrap_or(at + 1);
                out.push(found(&blocks, Step::Loop, start, at));
                open(&mut blocks);
            }
            "test" => {
                let is_case =
                    |i: &usize| matches!(text.name(*i).as_str(), "case" | "default" | "endtest");
                at = (at + 1..end).find(is_case).unwrap_or(end);
                out.push(found(&blocks, Step::Cases, start, at));
                open(&mut blocks);
            }
            "endif" | "endfor" | "endwhile" | "endtest" => {
                blocks.pop();
                at += 1;
                out.push(found(&blocks, Step::End, start, at));
            }
            _ => {
                let is_label = text.at(at).is_some_and(|token| token.kind == Kind::Name)
                    && text.is(at + 1, b':')
                    && !text.is(at + 2, b'=');
                if is_label {
                    // A label: a jump may lead here from anywhere.
                    let label = Step::Label(word);
                    out.push(found(&blocks, label, at, at + 1));
                    at += 2;
                    continue;
                }
                let stop = text.find(at, end, b";");
                if stop > at {
                    let step = match word.as_str() {
                        "goto" => Step::Jump(next),
                        "return" | "exit" | "exitcycle" | "raise" | "retry" | "trynext" => {
                            Step::Return
                        }
                        _ => Step::Other,
                    };
                    out.push(found(&blocks, step, at, stop));
                }
                for _ in 0..std::mem::take(&mut on_one_line) {
                    blocks.pop();
                    out.push(found(&blocks, Step::End, stop, stop));
                }
                at = stop + 1;
            }
        }
    }
    (out, routines)
}

/// Returns whether a name is that of a motion; other instructions for triggers only describe what happens on the way.
pub fn is_instruction(name: &str) -> bool {
    let describes = [
        "io", "equip", "int", "checkio", "rampao", "speed", "stopproc", "data",
    ];
    match name.strip_prefix("trigg") {
        Some(rest) => !describes.iter().any(|start| rest.starts_with(start)),
        None => name.starts_with("move") || shape(name).is_some(),
    }
}
