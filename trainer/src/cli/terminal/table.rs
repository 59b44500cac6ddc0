//! Plain tables for a terminal: columns are aligned, the first one to the left.

/// Formats the lines of a table of `rows` under `header`.
pub fn lines(header: &[&str], rows: &[Vec<String>]) -> Vec<String> {
    let width = |c: usize| {
        let fields = rows
            .iter()
            .filter_map(|r| r.get(c))
            .map(|s| s.chars().count());
        fields.chain([header[c].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let line = |fields: &mut dyn Iterator<Item = &str>| {
        let mut out = String::from(" ");
        for (c, (field, width)) in fields.zip(&widths).enumerate() {
            let pad = " ".repeat(width - field.chars().count());
            out += " ";
            out += &if c == 0 {
                format!("{field}{pad}")
            } else {
                format!("{pad}{field}")
            };
            out += " ";
        }
        out.trim_end().to_owned()
    };
    let rule = "-".repeat(widths.iter().sum::<usize>() + 2 * (widths.len() - 1));
    let mut out = vec![line(&mut header.iter().copied()), format!("  {rule}")];
    out.extend(
        rows.iter()
            .map(|row| line(&mut row.iter().map(String::as_str))),
    );
    out
}
