//! Plain tables for a terminal: columns aligned, the first to the left.

/// Prints `rows` under `header`.
pub fn print(header: &[&str], rows: &[Vec<String>]) {
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
        println!("{}", out.trim_end());
    };
    line(&mut header.iter().copied());
    println!(
        "  {}",
        "-".repeat(widths.iter().sum::<usize>() + 2 * (widths.len() - 1))
    );
    for row in rows {
        line(&mut row.iter().map(String::as_str));
    }
}
