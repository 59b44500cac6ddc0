//! Splits Rust sources into words, symbols, string literals and documentation.

use std::path::{Path, PathBuf};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Word,
    Symbol,
    /// The content of a string literal.
    Text,
    /// A line of documentation.
    Doc,
}

#[derive(Clone, Debug)]
pub struct Token {
    pub kind: Kind,
    pub text: String,
    pub line: usize,
}

impl Token {
    pub fn is(&self, text: &str) -> bool {
        matches!(self.kind, Kind::Word | Kind::Symbol) && self.text == text
    }
}

/// Returns a folder of the workspace.
pub fn workspace(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

/// Returns every `.rs` file in a folder and below it.
pub fn sources(folder: &Path) -> Vec<PathBuf> {
    files(folder, "rs")
}

/// Returns the files with an extension in a folder and in those below it.
pub fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Returns the tokens of a source, without numbers and lifetimes.
pub fn tokens(source: &str) -> Vec<Token> {
    let mut out = Vec::new();
    let mut rest = source;
    let mut line = 1;
    while let Some(first) = rest.chars().next() {
        let (kind, text, length) = next(rest, first);
        if let Some(kind) = kind {
            out.push(Token {
                kind,
                text: text.to_owned(),
                line,
            });
        }
        line += rest[..length].matches('\n').count();
        rest = &rest[length..];
    }
    out
}

/// Returns the kind of the token at the beginning of `rest`, its text, and the number of bytes read.
fn next(rest: &str, first: char) -> (Option<Kind>, &str, usize) {
    let line = || &rest[..rest.find('\n').unwrap_or(rest.len())];
    if rest.starts_with("///") || rest.starts_with("//!") {
        return (Some(Kind::Doc), &line()[3..], line().len());
    }
    if rest.starts_with("//") {
        return (None, "", line().len());
    }
    if rest.starts_with("/*") {
        return (None, "", rest.find("*/").expect("a comment ends") + 2);
    }
    if let Some(string) = string(rest) {
        return string;
    }
    if first == '\'' {
        return (None, "", character(rest));
    }
    if first.is_alphabetic() || first == '_' {
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_');
        let word = &rest[..end.unwrap_or(rest.len())];
        return (Some(Kind::Word), word, word.len());
    }
    if first.is_ascii_digit() {
        let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        return (None, "", end.unwrap_or(rest.len()));
    }
    if rest.starts_with("::") {
        return (Some(Kind::Symbol), "::", 2);
    }
    let kind = (!first.is_whitespace()).then_some(Kind::Symbol);
    (kind, &rest[..first.len_utf8()], first.len_utf8())
}

/// Reads a string literal: ordinary, raw, or of bytes.
fn string(rest: &str) -> Option<(Option<Kind>, &str, usize)> {
    let prefix = rest.len() - rest.trim_start_matches(['b', 'c', 'r']).len();
    let is_raw = rest[..prefix].contains('r');
    let hashes = if is_raw {
        rest[prefix..].len() - rest[prefix..].trim_start_matches('#').len()
    } else {
        0
    };
    let begin = prefix + hashes + 1;
    if prefix > 2 || !rest[prefix + hashes..].starts_with('"') {
        return None;
    }
    let end = if is_raw {
        begin + rest[begin..].find(&format!("\"{}", "#".repeat(hashes)))?
    } else {
        let mut is_escaped = false;
        begin
            + rest[begin..].find(|c| {
                let ends = c == '"' && !is_escaped;
                is_escaped = c == '\\' && !is_escaped;
                ends
            })?
    };
    Some((Some(Kind::Text), &rest[begin..end], end + 1 + hashes))
}

/// Returns the length of a character literal, or of the mark of a lifetime.
fn character(rest: &str) -> usize {
    let inside: Vec<char> = rest.chars().skip(1).take(12).collect();
    let closed = |n: usize| inside.get(n) == Some(&'\'');
    let count = match inside.first() {
        Some('\\') => 2 + inside.iter().skip(2).position(|c| *c == '\'').unwrap(),
        Some(_) if closed(1) => 1,
        _ => return 1,
    };
    rest.chars().take(2 + count).map(char::len_utf8).sum()
}

/// Returns the tokens without code for tests only, and the names of the test modules that have files of their own.
pub fn without_tests(tokens: &[Token]) -> (Vec<Token>, Vec<String>) {
    const MARK: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];
    let (mut kept, mut modules) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < tokens.len() {
        let found = tokens[at..]
            .iter()
            .zip(MARK)
            .filter(|(t, m)| t.is(m))
            .count();
        if found < MARK.len() {
            kept.push(tokens[at].clone());
            at += 1;
            continue;
        }
        let end = at + MARK.len() + item(&tokens[at + MARK.len()..]);
        let words = &tokens[at + MARK.len()..end];
        if let Some(name) = words.iter().position(|t| t.is("mod"))
            && words.last().unwrap().is(";")
        {
            modules.push(words[name + 1].text.clone());
        }
        at = end;
    }
    (kept, modules)
}

/// Returns the number of tokens of an item: up to its semicolon or the end of its braces.
fn item(tokens: &[Token]) -> usize {
    let is_use = tokens.iter().take(3).any(|t| t.is("use"));
    let mut depth = 0;
    for (i, token) in tokens.iter().enumerate() {
        match token.text.as_str() {
            _ if token.kind != Kind::Symbol => {}
            "{" | "(" | "[" => depth += 1,
            "}" | ")" | "]" => depth -= 1,
            _ => {}
        }
        let ends = token.is(";") || token.is("}") && !is_use;
        if depth == 0 && ends {
            return i + 1;
        }
    }
    tokens.len()
}
