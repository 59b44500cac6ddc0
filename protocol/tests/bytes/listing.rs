//! Reads hex listings of documents and data, so that tests can compare them with the encoder's bytes.

/// Returns the bytes of every ` ```hex ` block of `markdown`. Its lines have an offset, bytes, and a remark after `#`.
///
/// # Panics
/// If an offset does not match the number of bytes before it.
pub fn hex_blocks(markdown: &str) -> Vec<Vec<u8>> {
    let blocks = markdown.split("```hex\n").skip(1);
    blocks
        .map(|rest| hex_lines(rest.split("```").next().unwrap_or("")))
        .collect()
}

/// Returns the bytes of hexadecimal digits, two digits each.
fn hex(digits: &str) -> Vec<u8> {
    let pairs = digits.as_bytes().chunks(2);
    pairs
        .map(|pair| {
            let pair = std::str::from_utf8(pair).expect("ASCII");
            u8::from_str_radix(pair, 16).expect("a byte")
        })
        .collect()
}

fn hex_lines(block: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut start = None;
    for line in block.lines() {
        let code = line.split('#').next().unwrap_or("");
        let mut words = code.split_whitespace();
        let Some(offset) = words.next() else { continue };
        let offset = usize::from_str_radix(offset, 16).expect("an offset");
        let start = *start.get_or_insert(offset);
        assert_eq!(offset, start + bytes.len(), "offset of the line {line:?}");
        bytes.extend(words.flat_map(hex));
    }
    bytes
}

/// Returns the cells of every table row of `markdown` whose first cell is a number, as in the tables of messages.
pub fn numbered_rows(markdown: &str) -> Vec<(u8, Vec<String>)> {
    let cells = |line: &str| -> Vec<String> {
        let inner = line.trim().trim_start_matches('|').trim_end_matches('|');
        inner
            .split('|')
            .map(|cell| cell.trim().to_owned())
            .collect()
    };
    let rows = markdown.lines().filter(|line| line.starts_with('|'));
    rows.map(cells)
        .filter_map(|row| Some((row.first()?.parse().ok()?, row)))
        .collect()
}
