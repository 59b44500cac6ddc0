//! Finds the start tags of VAL3 files, and the comments of the programs in them.

use std::ops::Range;

use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::Token;

/// A start tag: its name, and the positions of its attributes' values.
pub struct Tag {
    pub name: String,
    /// First byte of the tag.
    pub at: usize,
    pub attributes: Vec<(String, Range<usize>)>,
}

impl Tag {
    /// Returns the value of an attribute.
    pub fn value(&self, source: &Source, key: &str) -> Option<String> {
        let (_, span) = self.attributes.iter().find(|(own, _)| own == key)?;
        Some(String::from_utf8_lossy(source.slice(span)).into_owned())
    }
}

/// Returns the start tags of an XML file, without comments.
pub fn tags(source: &Source) -> Vec<Tag> {
    let bytes = &source.bytes;
    let mut out = Vec::new();
    let mut at = 0;
    while let Some(open) = bytes[at..].iter().position(|b| *b == b'<').map(|i| at + i) {
        let rest = &bytes[open..];
        if rest.starts_with(b"<!--") {
            let end = rest.windows(3).position(|w| w == b"-->");
            at = open + end.map_or(rest.len(), |end| end + 3);
            continue;
        }
        let is_name = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b':' | b'-');
        let name_end = open + 1 + bytes[open + 1..].iter().take_while(|b| is_name(b)).count();
        let mut tag = Tag {
            name: String::from_utf8_lossy(&bytes[open + 1..name_end]).into_owned(),
            at: open,
            attributes: Vec::new(),
        };
        at = name_end.max(open + 1);
        while let Some(byte) = bytes.get(at) {
            if *byte == b'>' {
                at += 1;
                break;
            }
            let length = bytes[at..].iter().take_while(|b| is_name(b)).count();
            let quote_at = at + length + 1;
            if length > 0
                && bytes.get(at + length) == Some(&b'=')
                && matches!(bytes.get(quote_at), Some(b'"' | b'\''))
            {
                let quote = bytes[quote_at];
                let inside = bytes[quote_at + 1..]
                    .iter()
                    .take_while(|b| **b != quote)
                    .count();
                let span = quote_at + 1..quote_at + 1 + inside;
                let key = String::from_utf8_lossy(&bytes[at..at + length]).into_owned();
                at = (span.end + 1).min(bytes.len());
                tag.attributes.push((key, span));
            } else {
                at += length.max(1);
            }
        }
        if !tag.name.is_empty() {
            out.push(tag);
        }
    }
    out
}

/// Returns whether a token is in a comment, from `//` to the end of the line.
pub fn is_comment(source: &Source, token: &Token) -> bool {
    let before = &source.bytes[..token.start as usize];
    let start = before
        .iter()
        .rposition(|b| matches!(b, b'\n' | b'\r'))
        .map_or(0, |i| i + 1);
    before[start..].windows(2).any(|w| w == b"//")
}
