//! Splits RAPID into statements, each with its routine and the conditions around it.

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
}

/// Returns all statements and routines of a file. Its tokens must not contain line ends.
pub fn statements(text: &Text<'_>) -> (Vec<Statement>, Vec<Routine>) {
    let (mut out, mut routines) = (Vec::new(), Vec::new());
    let (mut routine, mut count) = (0, 0);
    let mut blocks: Vec<usize> = Vec::new();
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
        match text.name(at).as_str() {
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
                let is_function = text.name(at) == "func";
                let name_at = at + 1 + usize::from(is_function);
                routines.push(Routine {
                    name: text.name(name_at),
                    file: text.file,
                    number: routine,
                });
                at = name_at + 1;
                if text.is(at, b'(') {
                    at = text.find(at + 1, end, b")") + 1;
                }
            }
            "endproc" | "endfunc" | "endtrap" | "endmodule" => {
                routine = 0;
                blocks.clear();
                at += 1;
            }
            "record" => {
                at = (at..end)
                    .find(|i| text.name(*i) == "endrecord")
                    .unwrap_or(end)
                    + 1;
            }
            "if" => match behind(at, "then") {
                Some(next) => {
                    open(&mut blocks);
                    at = next;
                }
                // One statement on the same line under a condition.
                None => {
                    let stop = text.find(at, end, b";");
                    let from = (at + 1..stop)
                        .find(|i| is_instruction(&text.name(*i)))
                        .unwrap_or(at + 1);
                    open(&mut blocks);
                    out.push(Statement {
                        file: text.file,
                        routine,
                        blocks: blocks.clone(),
                        from,
                        end: stop,
                    });
                    blocks.pop();
                    at = stop + 1;
                }
            },
            "elseif" => {
                blocks.pop();
                open(&mut blocks);
                at = behind(at, "then").unwrap_or(at + 1);
            }
            "else" | "error" | "undo" | "backward" | "default" => {
                blocks.pop();
                open(&mut blocks);
                at += 1;
                if text.is(at, b':') && !text.is(at + 1, b'=') {
                    at += 1;
                }
            }
            "for" | "while" => {
                open(&mut blocks);
                at = behind(at, "do").unwrap_or(at + 1);
            }
            "test" => {
                open(&mut blocks);
                let is_case =
                    |i: &usize| matches!(text.name(*i).as_str(), "case" | "default" | "endtest");
                at = (at + 1..end).find(is_case).unwrap_or(end);
            }
            "case" => {
                blocks.pop();
                open(&mut blocks);
                at = text.find(at, end, b":;") + 1;
            }
            "endif" | "endfor" | "endwhile" | "endtest" => {
                blocks.pop();
                at += 1;
            }
            _ => {
                let is_label = text.at(at).is_some_and(|token| token.kind == Kind::Name)
                    && text.is(at + 1, b':')
                    && !text.is(at + 2, b'=');
                if is_label {
                    // A label: a jump may lead here from anywhere.
                    out.push(Statement {
                        file: text.file,
                        routine,
                        blocks: blocks.clone(),
                        from: at,
                        end: at + 1,
                    });
                    at += 2;
                    continue;
                }
                let stop = text.find(at, end, b";");
                if stop > at {
                    out.push(Statement {
                        file: text.file,
                        routine,
                        blocks: blocks.clone(),
                        from: at,
                        end: stop,
                    });
                }
                at = stop + 1;
            }
        }
    }
    (out, routines)
}

/// Returns whether a name is that of a motion.
pub fn is_instruction(name: &str) -> bool {
    ["move", "trigg"]
        .iter()
        .any(|start| name.starts_with(start))
        && name != "triggio"
}
