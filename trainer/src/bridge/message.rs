//! The two messages of RSI: the packet of the controller, and the answer to it.
//!
//! ```text
//! <Rob Type="KUKA"><RIst X="…" …/><ASPos A1="0.0" … A6="0.0"/><Delay D="0"/><IPOC>123645634563</IPOC></Rob>
//! <Sen Type="ImFree"><AK A1="0.000000" … A6="0.000000"/><IPOC>123645634563</IPOC></Sen>
//! ```
//!
//! Elements and attributes come in any order, and those with other names are ignored. ("KUKA.RobotSensorInterface", RSI 3
//! and 4.)

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::bridge::{AXES, Axes};

/// Largest size of a datagram that is read, in bytes. Those of a controller have a few hundred.
pub const MAX_PACKET: usize = 4096;

/// Names of the attributes with the axes.
const NAMES: [&str; AXES] = ["A1", "A2", "A3", "A4", "A5", "A6"];
/// Parts of a degree in an answer, which has six decimals.
const PARTS: u64 = 1_000_000;

/// Which axis values are corrected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setpoint {
    /// `ASPos`: the setpoints without a correction.
    Commanded,
    /// `AIPos`: the actual values, which contain the correction.
    Actual,
}

impl Setpoint {
    /// Returns the name of the element with these values.
    pub fn element(self) -> &'static str {
        match self {
            Self::Commanded => "ASPos",
            Self::Actual => "AIPos",
        }
    }
}

/// A packet that has an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet {
    /// Time stamp of the controller, which the answer sends back.
    pub ipoc: u64,
    /// Axis values in rad; `None` where one is missing, repeated or no finite number.
    pub axes: Option<Axes>,
}

/// Reads a packet. Returns `None` where there is nothing to answer: no XML, another root, or not exactly one IPOC.
pub fn read(bytes: &[u8], setpoint: Setpoint) -> Option<Packet> {
    if bytes.len() > MAX_PACKET {
        return None;
    }
    let mut reader = Reader::from_reader(bytes);
    let mut contents = Contents::default();
    loop {
        match reader.read_event().ok()? {
            Event::Start(tag) => {
                contents.open(&tag, setpoint)?;
                contents.depth += 1;
            }
            Event::Empty(tag) => {
                contents.open(&tag, setpoint)?;
                contents.in_ipoc = false;
            }
            Event::End(_) => {
                contents.depth = contents.depth.checked_sub(1)?;
                contents.in_ipoc = false;
            }
            Event::Text(text) => contents.text(&text)?,
            Event::Decl(_) | Event::Comment(_) => {}
            Event::Eof => break,
            // No packet has any of these, and entities could hide anything.
            Event::CData(_) | Event::PI(_) | Event::DocType(_) | Event::GeneralRef(_) => {
                return None;
            }
        }
    }
    let is_whole = contents.has_root && contents.depth == 0;
    let ipoc = contents.ipoc.filter(|_| is_whole)?;
    Some(Packet {
        ipoc,
        axes: contents.axes.flatten(),
    })
}

/// Contents of a packet that were read so far.
#[derive(Default)]
struct Contents {
    depth: usize,
    has_root: bool,
    in_ipoc: bool,
    ipoc: Option<u64>,
    /// Axis values of the element with the setpoints: `None` until it is read, `Some(None)` where they cannot be used.
    axes: Option<Option<Axes>>,
}

impl Contents {
    fn open(&mut self, tag: &BytesStart<'_>, setpoint: Setpoint) -> Option<()> {
        if self.in_ipoc {
            return None;
        }
        let name = tag.name();
        match self.depth {
            0 => {
                let is_root = name.as_ref() == b"Rob" && !self.has_root;
                self.has_root = true;
                return is_root.then_some(());
            }
            1 if name.as_ref() == b"IPOC" => self.in_ipoc = true,
            1 if name.as_ref() == setpoint.element().as_bytes() => {
                let axes = if self.axes.is_none() { axes(tag) } else { None };
                self.axes = Some(axes);
                return Some(());
            }
            _ => {}
        }
        // The other elements are not used, but they must be valid XML.
        tag.attributes().all(|a| a.is_ok()).then_some(())
    }

    fn text(&mut self, text: &[u8]) -> Option<()> {
        let text = text.trim_ascii();
        if self.in_ipoc && self.depth == 2 && !text.is_empty() {
            let is_number = text.iter().all(u8::is_ascii_digit) && self.ipoc.is_none();
            let text = std::str::from_utf8(text).ok().filter(|_| is_number)?;
            self.ipoc = Some(text.parse().ok()?);
        }
        (self.depth > 0 || text.is_empty()).then_some(())
    }
}

/// Returns the axis values of an element, in rad.
fn axes(tag: &BytesStart<'_>) -> Option<Axes> {
    let mut axes = [None; AXES];
    for attribute in tag.attributes() {
        let attribute = attribute.ok()?;
        let name = attribute.key.as_ref();
        if let Some(axis) = NAMES.iter().position(|n| n.as_bytes() == name) {
            let text = std::str::from_utf8(attribute.value.trim_ascii()).ok()?;
            let degrees: f64 = text.parse().ok()?;
            axes[axis] = degrees.is_finite().then_some(degrees.to_radians());
        }
    }
    let mut whole = [0.0; AXES];
    for (slot, axis) in whole.iter_mut().zip(axes) {
        *slot = axis?;
    }
    Some(whole)
}

/// A correction as it is written: integer millionths of a degree, which are exact.
pub type MicroDegrees = [i64; AXES];

/// Converts radians to millionths of a degree.
pub fn micro_degrees(axes: &Axes) -> MicroDegrees {
    // A correction is a few degrees, far within the exact integers of `f64`.
    axes.map(|rad| (rad.to_degrees() * PARTS as f64).round() as i64)
}

/// Writes the answer to the packet of `ipoc` into `out`.
pub fn write(ipoc: u64, correction: &MicroDegrees, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(b"<Sen Type=\"ImFree\"><AK");
    for (name, value) in NAMES.iter().zip(correction) {
        out.push(b' ');
        out.extend_from_slice(name.as_bytes());
        out.extend_from_slice(b"=\"");
        if *value < 0 {
            out.push(b'-');
        }
        let size = value.unsigned_abs();
        digits(size / PARTS, 1, out);
        out.push(b'.');
        digits(size % PARTS, 6, out);
        out.push(b'"');
    }
    out.extend_from_slice(b"/><IPOC>");
    digits(ipoc, 1, out);
    out.extend_from_slice(b"</IPOC></Sen>");
}

/// Appends a number, with leading zeros up to `least` digits.
fn digits(mut number: u64, least: usize, out: &mut Vec<u8>) {
    // 2⁶⁴ has 20 digits.
    let mut reversed = [b'0'; 20];
    let mut length = 0;
    while number > 0 || length < least {
        reversed[length] = b'0' + (number % 10) as u8;
        number /= 10;
        length += 1;
    }
    out.extend(reversed[..length].iter().rev());
}

#[cfg(test)]
mod tests;
