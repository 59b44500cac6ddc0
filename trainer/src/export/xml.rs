//! Escapes text for XML.

use std::fmt::Write;

/// Escapes text as the value of an attribute.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Returns an XML comment of these lines.
pub(super) fn comment_lines(lines: &[String]) -> String {
    let mut out = String::from("<!--\n");
    for line in lines {
        // Two hyphens would end the comment.
        let _ = writeln!(out, "  {}", line.replace("--", "- -"));
    }
    out + "-->\n"
}
