//! Renders an error in a user's file with the line that it is about, and carets below the faulty part.
//!
//! ```text
//! error: train.csv:17: column 4 (q4_deg): found "abc", expected a number in degrees
//!    |
//! 17 | 10.5,-20.1,3.0,abc,88.2
//!    |                ^^^
//! help: …
//! ```
//!
//! The error's own text comes first; the line is read again from the file. If the line no longer fits the error (the file
//! has changed, or has an unknown structure), there is no caret rather than a wrong one. Of long lines, the part around the
//! caret is shown.

use std::ops::Range;
use std::path::Path;

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};

use poegp_calibration::input_error::InputError;

/// Largest number of characters of a line that are shown; of a longer line, the part around the caret is shown.
const WIDTH: usize = 96;

/// Renders the error, its line with carets, and the help.
pub fn render(error: &InputError) -> String {
    let without_help = InputError {
        help: None,
        ..error.clone()
    };
    let mut out = without_help.to_string();
    if let Some(picture) = picture(error) {
        out += &format!("\n{picture}");
    }
    if let Some(help) = &error.help {
        out += &format!("\nhelp: {help}");
    }
    out
}

fn picture(error: &InputError) -> Option<String> {
    let number = error.line?;
    if !may_be_shown(&error.file) {
        return None;
    }
    let bytes = std::fs::read(&error.file).ok()?;
    // A spreadsheet (a ZIP archive) has no lines of text.
    if bytes.starts_with(b"PK\x03\x04") {
        return None;
    }
    let text = String::from_utf8_lossy(&bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let line = text.lines().nth(number.checked_sub(1)?)?;
    // The width of a tab depends on the terminal, and other control characters could have any effect on it.
    let raw: Vec<char> = line.chars().collect();
    let line: String = raw
        .iter()
        .map(|c| if c.is_control() { ' ' } else { *c })
        .collect();
    Some(drawn(number, &line, span(error, &raw)))
}

/// Whether a file may be read and shown: a key is secret, and a device or a pipe cannot be read again.
fn may_be_shown(file: &Path) -> bool {
    !has_extension(file, &["key"]) && std::fs::metadata(file).is_ok_and(|there| there.is_file())
}

fn has_extension(file: &Path, names: &[&str]) -> bool {
    file.extension()
        .is_some_and(|e| names.iter().any(|name| e.eq_ignore_ascii_case(name)))
}

/// Returns the range of characters of the line that the error is about.
fn span(error: &InputError, line: &[char]) -> Option<Range<usize>> {
    let quoted = quoted(&error.found);
    let (column, name) = error.column.as_ref()?;
    let begin = column.checked_sub(1)?;
    if has_extension(&error.file, &["toml", "urdf", "xml", "xacro"]) {
        let rest = line.get(begin..).filter(|rest| !rest.is_empty())?;
        let length = match name.as_str() {
            _ if starts_with(rest, name) => name.chars().count(),
            _ => rest.iter().take_while(|c| is_word(**c)).count().max(1),
        };
        return Some(begin..begin + length);
    }
    let field = fields(line).into_iter().nth(begin)?;
    let inside: String = line[field.clone()].iter().collect();
    let fits = quoted.is_none_or(|text| inside.contains(text));
    fits.then(|| trimmed(line, field))
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || "_-.+\"".contains(c)
}

fn starts_with(line: &[char], word: &str) -> bool {
    !word.is_empty()
        && word
            .chars()
            .enumerate()
            .all(|(i, c)| line.get(i) == Some(&c))
}

/// Returns the text between double quotes, which is quoted from the file.
fn quoted(found: &str) -> Option<&str> {
    let rest = &found[found.find('"')? + 1..];
    rest.rfind('"').map(|end| &rest[..end])
}

/// Splits a line into fields: at semicolons if there are any, else at tabs, else at commas, else at spaces. Quotes hold
/// a field together.
fn fields(line: &[char]) -> Vec<Range<usize>> {
    let separator = [';', '\t', ','].into_iter().find(|c| line.contains(c));
    let mut out = Vec::new();
    let (mut begin, mut in_quotes) = (0, false);
    for (i, c) in line.iter().enumerate() {
        in_quotes ^= *c == '"';
        let ends = match separator {
            Some(separator) => *c == separator,
            None => c.is_whitespace(),
        };
        if ends && !in_quotes {
            out.push(begin..i);
            begin = i + 1;
        }
    }
    out.push(begin..line.len());
    if separator.is_none() {
        out.retain(|field| !field.is_empty());
    }
    out
}

/// Removes the spaces around a field; an empty field keeps its range.
fn trimmed(line: &[char], field: Range<usize>) -> Range<usize> {
    let inside = &line[field.clone()];
    let Some(first) = inside.iter().position(|c| !c.is_whitespace()) else {
        return field;
    };
    let last = inside
        .iter()
        .rposition(|c| !c.is_whitespace())
        .unwrap_or(first);
    field.start + first..field.start + last + 1
}

fn drawn(number: usize, line: &str, span: Option<Range<usize>>) -> String {
    let mut snippet = Snippet::source(line).line_start(number).fold(false);
    if let Some(span) = span {
        let byte = |at: usize| {
            line.char_indices()
                .nth(at)
                .map_or(line.len(), |(byte, _)| byte)
        };
        snippet =
            snippet.annotation(AnnotationKind::Primary.span(byte(span.start)..byte(span.end)));
    }
    let group = Group::with_level(Level::ERROR).element(snippet);
    Renderer::plain().term_width(WIDTH).render(&[group])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(name: &str, text: &str, column: usize, key: &str, found: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        let error = InputError::new(&file, found, "x")
            .at_line(2)
            .at_column(column, key);
        picture(&error).unwrap_or_default()
    }

    #[test]
    fn carets_are_below_the_place() {
        assert_eq!(
            shown("a.csv", "a,b,c\n1.5, abc ,3\n", 2, "b", "\"abc\""),
            "  |\n2 | 1.5, abc ,3\n  |      ^^^"
        );
        assert_eq!(
            shown("a.csv", "a;b\n1,5;\n", 2, "b", "nothing"),
            "  |\n2 | 1,5;\n  |     ^"
        );
        assert_eq!(
            shown("a.csv", "a,b\n\"x, y\",zz\n", 2, "b", "\"zz\""),
            "  |\n2 | \"x, y\",zz\n  |        ^^"
        );
        assert_eq!(
            shown("a.toml", "[x]\nsupprt = 3\n", 1, "supprt", "x"),
            "  |\n2 | supprt = 3\n  | ^^^^^^"
        );
        // Characters, not bytes.
        assert_eq!(
            shown("a.csv", "a,b\nµµ,?\n", 2, "b", "\"?\""),
            "  |\n2 | µµ,?\n  |    ^"
        );
    }

    #[test]
    fn a_place_that_does_not_fit_has_no_caret() {
        assert_eq!(
            shown("a.csv", "a,b\n1,2\n", 2, "b", "\"7\""),
            "  |\n2 | 1,2\n  |"
        );
        assert_eq!(shown("a.csv", "a,b\n", 2, "b", "\"7\""), "");
        assert_eq!(shown("a.key", "a\nsecret\n", 1, "", "x"), "");
    }

    #[test]
    fn long_lines_are_shown_around_the_place() {
        let fields: Vec<String> = (0..100).map(|i| format!("field{i}")).collect();
        let text = format!("header\n{}\n", fields.join(","));
        let out = shown("a.csv", &text, 51, "", "\"field50\"");
        let lines: Vec<&str> = out.lines().collect();
        assert!(
            lines.iter().all(|line| line.chars().count() < WIDTH + 10),
            "{out}"
        );
        let at = lines[2].find('^').unwrap();
        let below: String = lines[1].chars().skip(at).take(7).collect();
        assert_eq!(below, "field50", "{out}");
        assert!(
            lines[2].ends_with("^^^^^^^") && !lines[2].ends_with("^^^^^^^^"),
            "{out}"
        );
    }
}
