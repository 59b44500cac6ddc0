//! Plain tables for a terminal: columns aligned, the first to the left.

/// The lines of `rows` under `header`.
pub fn lines(header: &[&str], rows: &[Vec<String>]) -> Vec<String> {
    let width = |c: usize| {
        let cells = rows
            .iter()
            .filter_map(|r| r.get(c))
            .map(|s| s.chars().count());
        cells.chain([header[c].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let mut out = String::from(" ");
        for (c, (cell, width)) in cells.zip(&widths).enumerate() {
            let pad = " ".repeat(width - cell.chars().count());
            out += " ";
            out += &if c == 0 {
                format!("{cell}{pad}")
            } else {
                format!("{pad}{cell}")
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
