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
    let mut splitter = Splitter {
        text,
        end: text.tokens.len(),
        at: 0,
        routine: 0,
        is_local: false,
        is_handler: false,
        blocks: Vec::new(),
        last_block: 0,
        on_one_line: 0,
        statements: Vec::new(),
        routines: Vec::new(),
    };
    splitter.skip_header();
    while splitter.at < splitter.end {
        splitter.split();
    }
    (splitter.statements, splitter.routines)
}

/// Goes through the tokens of a file.
struct Splitter<'a> {
    text: &'a Text<'a>,
    /// Number of tokens.
    end: usize,
    /// Index of the next token.
    at: usize,
    /// Number of the routine in the file, from 1; 0 for the module itself.
    routine: usize,
    /// Whether LOCAL stands before a routine.
    is_local: bool,
    /// Whether this is an error handler.
    is_handler: bool,
    /// Conditions and loops around the token, outermost first.
    blocks: Vec<usize>,
    last_block: usize,
    /// Number of conditions that end with the statement.
    on_one_line: usize,
    statements: Vec<Statement>,
    routines: Vec<Routine>,
}

impl Splitter<'_> {
    /// Skips the header: %%% VERSION:1 LANGUAGE:ENGLISH %%%
    fn skip_header(&mut self) {
        if self.text.is(self.at, b'%') {
            let is_mark = |i: &usize| self.text.is(*i, b'%');
            let next = (self.at..self.end).filter(is_mark).nth(5);
            self.at = next.map_or(self.at + 1, |last| last + 1);
        }
    }

    /// Splits off what begins here.
    fn split(&mut self) {
        let (text, start) = (self.text, self.at);
        let word = text.name(start);
        match word.as_str() {
            "local" if matches!(text.name(start + 1).as_str(), "proc" | "func" | "trap") => {
                self.is_local = true;
                self.at += 1;
            }
            "module" => {
                self.at += 2;
                if text.is(self.at, b'(') {
                    self.at = text.find(self.at + 1, self.end, b")") + 1;
                }
            }
            "proc" | "func" | "trap" => self.begin_routine(&word),
            "endproc" | "endfunc" | "endtrap" | "endmodule" => {
                self.routine = 0;
                self.is_handler = false;
                self.blocks.clear();
                self.at += 1;
            }
            "record" => {
                let is_end = |i: &usize| text.name(*i) == "endrecord";
                self.at = (start..self.end).find(is_end).unwrap_or(self.end) + 1;
            }
            "if" => {
                let stop = text.find(start, self.end, b";");
                let then = self.behind("then");
                // Without THEN, one statement follows on the same line.
                self.at = then.unwrap_or_else(|| behind_condition(text, start + 1, stop));
                self.on_one_line += usize::from(then.is_none());
                self.begin_block(Step::Branch, start);
            }
            "elseif" | "else" | "case" | "default" => self.next_branch(&word),
            "error" | "undo" | "backward" => {
                self.blocks.clear();
                self.is_handler = true;
                self.open();
                self.at += 1;
            }
            "for" | "while" => {
                self.at = self.behind("do").unwrap_or(start + 1);
                self.begin_block(Step::Loop, start);
            }
            "test" => {
                let is_case =
                    |i: &usize| matches!(text.name(*i).as_str(), "case" | "default" | "endtest");
                self.at = (start + 1..self.end).find(is_case).unwrap_or(self.end);
                self.begin_block(Step::Cases, start);
            }
            "endif" | "endfor" | "endwhile" | "endtest" => {
                self.blocks.pop();
                self.at += 1;
                self.add(Step::End, start, self.at);
            }
            _ => self.instruction(word),
        }
    }

    /// Adds a statement within the conditions and loops that are open.
    fn add(&mut self, step: Step<Setting>, from: usize, end: usize) {
        self.statements.push(Statement {
            file: self.text.file,
            routine: self.routine,
            blocks: self.blocks.clone(),
            from,
            end,
            is_handler: self.is_handler,
            step,
        });
    }

    /// Returns the first token behind a keyword, searched from here up to a semicolon.
    fn behind(&self, keyword: &str) -> Option<usize> {
        let stop = self.text.find(self.at, self.end, b";");
        (self.at..stop)
            .find(|i| self.text.name(*i) == keyword)
            .map(|i| i + 1)
    }

    fn open(&mut self) {
        self.last_block += 1;
        self.blocks.push(self.last_block);
    }

    /// Adds the statement from `start` to here, which begins a condition or a loop.
    fn begin_block(&mut self, step: Step<Setting>, start: usize) {
        self.add(step, start, self.at);
        self.open();
    }

    /// Begins the next branch of a condition.
    fn next_branch(&mut self, word: &str) {
        let (text, start) = (self.text, self.at);
        self.blocks.pop();
        self.at = match word {
            "elseif" => self.behind("then").unwrap_or(start + 1),
            "case" => text.find(start, self.end, b":;") + 1,
            _ => start + 1 + usize::from(text.is(start + 1, b':') && !text.is(start + 2, b'=')),
        };
        let is_rest = matches!(word, "else" | "default");
        self.begin_block(Step::Next(is_rest), start);
    }

    /// Begins a routine; `word` is its kind.
    fn begin_routine(&mut self, word: &str) {
        let text = self.text;
        self.routine = self.routines.len() + 1;
        self.blocks.clear();
        self.is_handler = false;
        let name_at = self.at + 1 + usize::from(word == "func");
        let mut own = Routine {
            name: text.name(name_at),
            file: text.file,
            number: self.routine,
            is_local: std::mem::take(&mut self.is_local),
            is_trap: word == "trap",
            parameters: Vec::new(),
        };
        self.at = name_at + 1;
        if text.is(self.at, b'(') {
            let close = text.find(self.at + 1, self.end, b")");
            own.parameters = parameters(text, self.at + 1, close);
            self.at = close + 1;
        }
        self.routines.push(own);
    }

    /// Splits off a label, or an instruction up to its semicolon; `word` is its first.
    fn instruction(&mut self, word: String) {
        let (text, at) = (self.text, self.at);
        let is_label = text.at(at).is_some_and(|token| token.kind == Kind::Name)
            && text.is(at + 1, b':')
            && !text.is(at + 2, b'=');
        if is_label {
            // A jump may lead here from anywhere.
            self.add(Step::Label(word), at, at + 1);
            self.at += 2;
            return;
        }
        let stop = text.find(at, self.end, b";");
        if stop > at {
            let step = match word.as_str() {
                "goto" => Step::Jump(text.name(at + 1)),
                "return" | "exit" | "exitcycle" | "raise" | "retry" | "trynext" => Step::Return,
                _ => Step::Other,
            };
            self.add(step, at, stop);
        }
        for _ in 0..std::mem::take(&mut self.on_one_line) {
            self.blocks.pop();
            self.add(Step::End, stop, stop);
        }
        self.at = stop + 1;
    }
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
