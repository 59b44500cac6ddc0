//! Inputs that are kept in `fuzz/`: those with which the fuzzer reaches all code that it has reached, and those that once
//! broke a law.
//!
//! Each target has a text file with one input on each line; bytes that are not printable are written as `\n`, `\x00` and the
//! like. The files are short, and their changes are readable.

use std::fs;
use std::io;
use std::path::PathBuf;

use crate::workspace;

/// Largest number of bytes that are kept of a target's inputs.
pub const MOST_BYTES: usize = 4_000;

/// The two collections of kept inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// Inputs that reach code, in `fuzz/corpus`.
    Corpus,
    /// Inputs that once broke a law, in `fuzz/regressions`.
    Regressions,
}

fn path(kept: Kept, target: &str) -> PathBuf {
    let folder = match kept {
        Kept::Corpus => "fuzz/corpus",
        Kept::Regressions => "fuzz/regressions",
    };
    workspace().join(folder).join(format!("{target}.txt"))
}

/// Returns the kept inputs of a target; none if it has no file.
///
/// # Errors
/// When the file cannot be read, or has a line that was not written here.
pub fn read(kept: Kept, target: &str) -> io::Result<Vec<Vec<u8>>> {
    let path = path(kept, target);
    let text = match fs::read_to_string(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other?,
    };
    let odd =
        |number: usize| io::Error::other(format!("{}:{number}: not an input", path.display()));
    (1..)
        .zip(text.lines())
        .map(|(number, line)| unescaped(line).ok_or_else(|| odd(number)))
        .collect()
}

/// Writes the shortest of `inputs`, up to [`MOST_BYTES`].
///
/// # Errors
/// When the file cannot be written.
pub fn write(kept: Kept, target: &str, mut inputs: Vec<Vec<u8>>) -> io::Result<()> {
    inputs.sort_by_key(|bytes| (bytes.len(), bytes.clone()));
    inputs.dedup();
    let mut length = 0;
    let lines = inputs.iter().take_while(|bytes| {
        length += bytes.len();
        length <= MOST_BYTES
    });
    let text: String = lines
        .map(|bytes| format!("{}\n", bytes.escape_ascii()))
        .collect();
    let path = path(kept, target);
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::write(path, text)
}

/// Reverses `escape_ascii`.
fn unescaped(line: &str) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    let mut rest = line.bytes();
    while let Some(byte) = rest.next() {
        out.push(match byte {
            b'\\' => match rest.next()? {
                b'n' => b'\n',
                b'r' => b'\r',
                b't' => b'\t',
                b'x' => {
                    let digits = [rest.next()?, rest.next()?];
                    u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?
                }
                same @ (b'\\' | b'\'' | b'"') => same,
                _ => return None,
            },
            b' '..=b'~' => byte,
            _ => return None,
        });
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_byte_is_read_as_it_was_written() {
        let all: Vec<u8> = (0..=255).collect();
        let line = all.escape_ascii().to_string();
        assert_eq!(super::unescaped(&line), Some(all));
        assert!(["\\", "\\x1", "\\xg0", "\\q", "ä"].map(super::unescaped) == [const { None }; 5]);
    }
}
