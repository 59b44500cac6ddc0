//! Decodes the log that the firmware writes with defmt.
//!
//! This replaces `defmt-decoder`: that crate turns on `arbitrary_precision` of `serde_json`, and features of one member of
//! the workspace are features of all. The firmware logs only strings and small integers, and no time:
//!
//! ```text
//!  stream:  frame 0x00 frame 0x00 …            each frame rzCOBS-encoded, to be read from its end
//!  frame:   | index of the format string, u16 LE | arguments one after the other |
//!  string:  a symbol of the section .defmt; its address is the index, its name JSON with "tag" and "data"
//! ```

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use object::{Object, ObjectSection, ObjectSymbol};

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The image that wrote the log cannot be read.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// The image that wrote the log is no ELF image.
    #[error("not an ELF image: {0}")]
    Image(#[from] object::Error),
    /// A frame of the log cannot be decoded.
    #[error("frame {frame:02x?} of the log: {problem}")]
    Frame {
        /// Decoded bytes of the frame.
        frame: Vec<u8>,
        /// Description of the problem.
        problem: String,
    },
}

/// Returns the lines of `log`, written by the image `elf`: level, colon, message. An incomplete last frame is left out.
pub fn lines(elf: &Path, log: &[u8]) -> Result<Vec<String>, LogError> {
    Decoder::new(elf)?.push(log).into_iter().collect()
}

/// Reads a log while it is being written.
#[derive(Debug)]
pub struct Decoder {
    strings: Strings,
    /// Bytes since the last zero.
    begun: Vec<u8>,
}

impl Decoder {
    /// Creates a decoder for the log that the image `elf` writes.
    ///
    /// # Errors
    /// [`LogError::File`], [`LogError::Image`].
    pub fn new(elf: &Path) -> Result<Self, LogError> {
        Ok(Self {
            strings: strings(elf)?,
            begun: Vec::new(),
        })
    }

    /// Returns the lines that these bytes complete.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<Result<String, LogError>> {
        let mut lines = Vec::new();
        for byte in bytes {
            if *byte != 0 {
                self.begun.push(*byte);
            } else if !self.begun.is_empty() {
                let frame = unstuffed(&std::mem::take(&mut self.begun));
                let line = formatted(&self.strings, &frame);
                lines.push(line.map_err(|problem| LogError::Frame { frame, problem }));
            }
        }
        lines
    }
}

/// Tag and text of each interned string, by index.
type Strings = HashMap<u64, (String, String)>;

fn strings(elf: &Path) -> Result<Strings, LogError> {
    let bytes = fs::read(elf)?;
    let file = object::File::parse(&*bytes)?;
    let section = file
        .section_by_name(".defmt")
        .map(|section| section.index());
    let mut strings = HashMap::new();
    for symbol in file.symbols() {
        if symbol.section_index().is_some() && symbol.section_index() == section {
            let name = symbol.name()?;
            if let (Some(tag), Some(text)) = (field(name, "tag"), field(name, "data")) {
                strings.insert(symbol.address(), (tag.to_owned(), text.to_owned()));
            }
        }
    }
    Ok(strings)
}

/// Returns a string of a flat JSON object without escapes.
fn field<'a>(json: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = json.split_once(&format!("\"{key}\":\""))?;
    rest.split('"').next()
}

/// Decodes rzCOBS. The result may have too many zeros at its end; truncated frames give fewer bytes.
fn unstuffed(frame: &[u8]) -> Vec<u8> {
    let mut from_end = frame.iter().rev().copied();
    let mut out = Vec::new();
    while let Some(code) = from_end.next() {
        match code {
            0xff => out.extend(from_end.by_ref().take(134)),
            0x80.. => {
                out.push(0);
                out.extend(from_end.by_ref().take(usize::from(code & 0x7f) + 7));
            }
            _ => {
                for bit in (0..7).rev() {
                    let stored = if code >> bit & 1 == 1 {
                        Some(0)
                    } else {
                        from_end.next()
                    };
                    out.extend(stored);
                }
            }
        }
    }
    out.reverse();
    out
}

fn formatted(strings: &Strings, frame: &[u8]) -> Result<String, String> {
    let mut arguments = frame;
    let mut take = |length: usize| -> Result<u64, String> {
        let (head, tail) = arguments.split_at_checked(length).ok_or("too short")?;
        arguments = tail;
        Ok(head
            .iter()
            .rev()
            .fold(0, |value, byte| value << 8 | u64::from(*byte)))
    };
    let string = |index: u64| strings.get(&index).ok_or(format!("no string {index}"));
    let (tag, format) = string(take(2)?)?;
    let mut line = format!("{}: ", tag.trim_start_matches("defmt_"));
    let mut rest = &**format;
    while let Some((text, after)) = rest.split_once('{') {
        line.push_str(text);
        let (parameter, after) = after.split_once('}').ok_or("open brace")?;
        rest = after;
        match parameter {
            "=u8" => line.push_str(&take(1)?.to_string()),
            "=u32" => line.push_str(&take(4)?.to_string()),
            "=u32:08x" => line.push_str(&format!("{:08x}", take(4)?)),
            "=istr" => line.push_str(&string(take(2)?)?.1),
            "=str" => {
                for _ in 0..take(4)? {
                    line.push(take(1)? as u8 as char);
                }
            }
            other => return Err(format!("parameter {{{other}}} is not known here")),
        }
    }
    line.push_str(rest);
    Ok(line)
}

#[cfg(test)]
mod tests {
    use super::unstuffed;

    #[test]
    fn rzcobs_is_undone() {
        // By hand from the definition: 01 02 and five padded ones; six bytes with a zero at place 1.
        assert_eq!(unstuffed(&[1, 2, 0b111_1100]), [1, 2, 0, 0, 0, 0, 0]);
        assert_eq!(
            unstuffed(&[1, 3, 4, 5, 6, 7, 0b000_0010]),
            [1, 0, 3, 4, 5, 6, 7]
        );
        assert_eq!(
            unstuffed(&[1, 2, 3, 4, 5, 6, 7, 0x80]),
            [1, 2, 3, 4, 5, 6, 7, 0]
        );
        assert_eq!(
            unstuffed(&[9; 134].into_iter().chain([0xff]).collect::<Vec<_>>()),
            [9; 134]
        );
    }
}
