//! Splits textual languages into names, numbers, strings, comments and lists, all of which keep their positions in bytes.

use std::ops::Range;

use crate::robot_programs::correction::source::{Number, Source};

/// Lexical rules of a language: comments, strings and names.
#[derive(Clone, Copy, Debug)]
pub struct Lexicon {
    /// Byte that begins a comment, which goes to the end of its line.
    pub comment: u8,
    /// Bytes that begin and end a string.
    pub quotes: &'static [u8],
    /// Bytes that names contain besides letters, digits and underscores.
    pub in_names: &'static [u8],
    /// Whether a number with a sign may follow a name: `A -5`.
    pub has_pairs: bool,
}

/// Kind of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A name or keyword.
    Name,
    /// A number, with its sign if it has one.
    Number,
    /// A string.
    Text,
    /// Any other byte.
    Mark(u8),
    /// The end of a line.
    LineEnd,
}

/// A token of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token {
    /// Kind of the token.
    pub kind: Kind,
    /// First byte.
    pub start: u32,
    /// Byte behind the last one.
    pub end: u32,
}

impl Token {
    /// Returns the bytes of the token.
    pub fn span(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }

    /// Returns whether the token is this mark.
    pub fn is(&self, mark: u8) -> bool {
        self.kind == Kind::Mark(mark)
    }
}

/// Returns the tokens of a file, without comments and blanks.
pub fn tokens(bytes: &[u8], lexicon: &Lexicon) -> Vec<Token> {
    let mut out: Vec<Token> = Vec::new();
    // Skips a byte order mark, which is no part of the program.
    let mut at = if bytes.starts_with(b"\xef\xbb\xbf") {
        3
    } else {
        0
    };
    while let Some(byte) = bytes.get(at).copied() {
        let rest = &bytes[at..];
        let length_of = |is: &dyn Fn(u8) -> bool| rest.iter().take_while(|b| is(**b)).count();
        // All bytes beyond ASCII belong to names: letters in UTF-8 or Latin-1, for no other character may stand there.
        let is_name = |b: u8| {
            b.is_ascii_alphanumeric() || b == b'_' || !b.is_ascii() || lexicon.in_names.contains(&b)
        };
        // After an operand, a sign is an operator.
        let is_operand = out.last().is_some_and(|last: &Token| match last.kind {
            Kind::Number | Kind::Mark(b')' | b']' | b'}') => true,
            Kind::Name => !lexicon.has_pairs || last.end as usize == at,
            _ => false,
        });
        let (kind, length) = match byte {
            b'\n' | b'\r' => (Kind::LineEnd, 1),
            _ if byte == lexicon.comment => {
                at += length_of(&|b| !matches!(b, b'\n' | b'\r'));
                continue;
            }
            _ if lexicon.quotes.contains(&byte) => (Kind::Text, text_length(rest, byte)),
            _ if number_length(rest, !is_operand) > 0 => {
                (Kind::Number, number_length(rest, !is_operand))
            }
            _ if is_name(byte) => (Kind::Name, length_of(&is_name)),
            _ if byte.is_ascii_whitespace() => {
                at += 1;
                continue;
            }
            _ => (Kind::Mark(byte), 1),
        };
        out.push(Token {
            kind,
            start: at as u32,
            end: (at + length) as u32,
        });
        at += length;
    }
    out
}

/// Decodes bytes as UTF-8, or as Latin-1 if they are not valid UTF-8.
fn decoded(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().copied().map(char::from).collect(),
    }
}

/// Returns the length of a string up to the next quote on the same line; a doubled quote belongs to the string.
fn text_length(rest: &[u8], quote: u8) -> usize {
    let mut at = 1;
    while let Some(byte) = rest.get(at) {
        match *byte {
            b'\n' | b'\r' => return at,
            b if b == quote && rest.get(at + 1) == Some(&quote) => at += 2,
            b if b == quote => return at + 1,
            _ => at += 1,
        }
    }
    at
}

/// Returns the number of bytes of the number at the beginning; 0 for none. No name begins with a digit, so `2x` is a number
/// and a name.
pub fn number_length(rest: &[u8], with_sign: bool) -> usize {
    let digits = |from: usize| {
        rest[from..]
            .iter()
            .take_while(|b| b.is_ascii_digit())
            .count()
    };
    let mut at = usize::from(with_sign && matches!(rest.first(), Some(b'-' | b'+')));
    let whole = digits(at.min(rest.len()));
    at += whole;
    let mut fraction = 0;
    if rest.get(at) == Some(&b'.') {
        fraction = digits(at + 1);
        at += 1 + fraction;
    }
    if whole + fraction == 0 {
        return 0;
    }
    if matches!(rest.get(at), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(rest.get(at + 1), Some(b'-' | b'+')));
        let exponent = digits((at + 1 + sign).min(rest.len()));
        if exponent > 0 {
            at += 1 + sign + exponent;
        }
    }
    at
}

/// A file and its tokens.
#[derive(Clone, Copy, Debug)]
pub struct Text<'a> {
    /// Index of the file.
    pub file: usize,
    /// Source of the tokens.
    pub source: &'a Source,
    /// Tokens of the file.
    pub tokens: &'a [Token],
}

/// A written value: a number, or a list of values.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A number.
    Number(Number),
    /// A single name, in lower case.
    Name(String),
    /// A string.
    Text,
    /// A list.
    List(Vec<Value>),
    /// Anything that the controller computes.
    Computed,
}

impl Value {
    /// Returns the values of a list with this length.
    pub fn list(&self, length: usize) -> Option<&[Value]> {
        match self {
            Self::List(values) if values.len() == length => Some(values),
            _ => None,
        }
    }

    /// Returns the numbers of a list of N numbers.
    pub fn numbers<const N: usize>(&self) -> Option<[Number; N]> {
        let mut all = self.list(N)?.iter().map(|value| match value {
            Self::Number(number) => Some(*number),
            _ => None,
        });
        let mut out = [Number {
            file: 0,
            start: 0,
            end: 0,
            value: 0.0,
        }; N];
        for slot in &mut out {
            *slot = all.next()??;
        }
        Some(out)
    }

    /// Returns the value of a number.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(number.value),
            _ => None,
        }
    }

    /// Returns the name, if the value is one.
    pub fn name(&self) -> Option<&str> {
        match self {
            Self::Name(name) => Some(name),
            _ => None,
        }
    }
}

impl<'a> Text<'a> {
    /// Returns the texts of files with their tokens.
    pub fn of_files(sources: &'a [Source], tokens: &'a [Vec<Token>]) -> Vec<Self> {
        let files = sources.iter().zip(tokens).enumerate();
        let text = |(file, (source, tokens)): (usize, (&'a Source, &'a Vec<Token>))| Self {
            file,
            source,
            tokens,
        };
        files.map(text).collect()
    }

    /// Returns a token; `None` behind the last one.
    pub fn at(&self, at: usize) -> Option<&'a Token> {
        self.tokens.get(at)
    }

    /// Returns whether a token is this mark.
    pub fn is(&self, at: usize, mark: u8) -> bool {
        self.at(at).is_some_and(|token| token.is(mark))
    }

    /// Returns the name at a token in lower case; empty for any other token.
    pub fn name(&self, at: usize) -> String {
        match self.at(at) {
            Some(token) if token.kind == Kind::Name => {
                decoded(self.source.slice(&token.span())).to_lowercase()
            }
            _ => String::new(),
        }
    }

    /// Returns whether a token is this name, which is in lower case.
    pub fn has_name(&self, at: usize, name: &str) -> bool {
        self.at(at).is_some_and(|token| {
            let bytes = self.source.slice(&token.span());
            token.kind == Kind::Name && bytes.eq_ignore_ascii_case(name.as_bytes())
        })
    }

    /// Returns the text of a token as it is written.
    pub fn spelling(&self, at: usize) -> String {
        let span = self.at(at).map_or(0..0, Token::span);
        decoded(self.source.slice(&span))
    }

    /// Returns the first byte of a token, or the end of the file.
    pub fn byte(&self, at: usize) -> usize {
        self.at(at)
            .map_or(self.source.bytes.len(), |token| token.start as usize)
    }

    /// Returns the byte behind a token, or the end of the file.
    pub fn end_of(&self, at: usize) -> usize {
        self.at(at)
            .map_or(self.source.bytes.len(), |token| token.end as usize)
    }

    /// Returns the number at a token.
    pub fn number(&self, at: usize) -> Option<Number> {
        let token = self.at(at).filter(|token| token.kind == Kind::Number)?;
        Number::parse(self.file, self.source, &token.span())
    }

    /// Returns the first token from `from` on, outside all brackets, that is one of `marks`; `end` if there is none.
    pub fn find(&self, from: usize, end: usize, marks: &[u8]) -> usize {
        let mut depth = 0_usize;
        for at in from..end {
            let Some(Token {
                kind: Kind::Mark(mark),
                ..
            }) = self.at(at)
            else {
                continue;
            };
            if depth == 0 && marks.contains(mark) {
                return at;
            }
            match mark {
                b'(' | b'[' | b'{' => depth += 1,
                b')' | b']' | b'}' => depth = depth.saturating_sub(1),
                _ => {}
            }
        }
        end
    }

    /// Splits the tokens from `from` to `end` at commas outside all brackets.
    pub fn arguments(&self, from: usize, end: usize) -> Vec<(usize, usize)> {
        let mut out = Vec::new();
        let mut start = from;
        while start < end {
            let comma = self.find(start, end, b",");
            out.push((start, comma));
            start = comma + 1;
        }
        out
    }

    /// Returns the value of the tokens from `from` to `end`; lists are in square brackets.
    pub fn value(&self, from: usize, end: usize) -> Value {
        self.nested(from, end, 0)
    }

    fn nested(&self, from: usize, end: usize, depth: usize) -> Value {
        // No list of a target is deeper than this.
        if depth > 6 {
            return Value::Computed;
        }
        let is_alone = end == from + 1;
        match self.at(from).map(|token| token.kind) {
            Some(Kind::Number) if is_alone => {
                self.number(from).map_or(Value::Computed, Value::Number)
            }
            Some(Kind::Name) if is_alone => Value::Name(self.name(from)),
            Some(Kind::Text) if is_alone => Value::Text,
            Some(Kind::Mark(b'[')) if self.find(from + 1, end, b"]") == end - 1 => {
                let inner = self.arguments(from + 1, end - 1);
                let values = inner.iter().map(|(a, b)| self.nested(*a, *b, depth + 1));
                Value::List(values.collect())
            }
            _ => Value::Computed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const RAPID: Lexicon = Lexicon {
        comment: b'!',
        quotes: b"\"",
        in_names: b"",
        has_pairs: false,
    };

    #[test]
    fn numbers_names_strings_and_comments() {
        let bytes = b"p1:=[[-1.5,2E+03,+4],[9E9]]; ! [1,2]\r\nTPWrite \"[3,4]\"; a-1".to_vec();
        let source = Source::new(Path::new("a.mod"), bytes, true);
        let all = tokens(&source.bytes, &RAPID);
        let texts: Vec<&str> = all
            .iter()
            .map(|t| std::str::from_utf8(source.slice(&t.span())).unwrap())
            .collect();
        assert_eq!(
            texts,
            [
                "p1",
                ":",
                "=",
                "[",
                "[",
                "-1.5",
                ",",
                "2E+03",
                ",",
                "+4",
                "]",
                ",",
                "[",
                "9E9",
                "]",
                "]",
                ";",
                "\r",
                "\n",
                "TPWrite",
                "\"[3,4]\"",
                ";",
                "a",
                "-",
                "1"
            ]
        );
        let text = Text {
            file: 0,
            source: &source,
            tokens: &all,
        };
        let value = text.value(3, 16);
        let lists = value.list(2).unwrap();
        assert_eq!(
            lists[0].numbers::<3>().unwrap().map(|n| n.value),
            [-1.5, 2000.0, 4.0]
        );
        assert_eq!(text.value(22, 25), Value::Computed);
    }
}
