//! Replaces the origins of a nominal URDF and keeps every other byte.
//!
//! The file is not parsed and written again, which would lose comments, order and what this program does not know: an XML
//! reader finds the positions of the `<origin>` tags, and only they are replaced.

use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::export::CalibratedChain;
use crate::export::urdf::{Changes, NEW_LINK, added_joint, check_added, comment, origin_tag};
use crate::export::xml::escaped;
use poegp_calibration::input_error::InputError;

/// Position of the origin in the text of a joint.
#[derive(Clone, Debug)]
struct Location {
    /// Bytes of the `<origin …>` tag; where there is none, an empty range behind the joint's start tag.
    origin: Range<usize>,
    /// Whether the tag is self-closing.
    closed: bool,
    /// Whether the joint has an `<origin …>` tag.
    there: bool,
}

/// Positions of the elements in a file.
struct Locations {
    joints: HashMap<String, Location>,
    links: Vec<String>,
    joint_names: Vec<String>,
    /// Position before `<robot …>`.
    robot: usize,
    /// Position before `</robot>`.
    end: usize,
}

/// Returns the nominal file `text` with `changes` made in it; `file` is for messages.
///
/// # Errors
/// [`InputError`] where a joint cannot be found, a name for a new link is taken, or the text is no XML.
pub fn rewritten(
    file: &Path,
    text: &str,
    chain: &CalibratedChain,
    changes: &Changes,
) -> Result<String, InputError> {
    let mut locations = locations(file, text)?;
    let line_end = if text.contains("\r\n") { "\r\n" } else { "\n" };
    let mut edits: Vec<(Range<usize>, String)> = Vec::new();
    for corrected in &changes.corrected {
        let Some(location) = locations.joints.get(&corrected.joint) else {
            let found = format!("no <joint name=\"{}\"> below <robot>", corrected.joint);
            return Err(InputError::new(
                file,
                found,
                "every joint of the chain once, as it was read",
            ));
        };
        let tag = origin_tag(&corrected.after, if location.closed { "/" } else { "" });
        let tag = if location.there {
            tag
        } else {
            format!("{line_end}    {tag}")
        };
        edits.push((location.origin.clone(), tag));
    }
    let mut added = String::new();
    for new in &changes.added {
        check_added(new, &locations.links, &locations.joint_names).map_err(|bad| {
            InputError::new(file, bad.found, NEW_LINK)
                .with_help("choose another name for --target-link, or a tip after a fixed joint")
        })?;
        locations.links.push(new.link.clone());
        locations.joint_names.push(new.joint());
        added += &format!(
            "  <link name=\"{}\"/>\n{}",
            escaped(&new.link),
            added_joint("  ", new)
        );
    }
    edits.push((locations.end..locations.end, added.replace('\n', line_end)));
    edits.push((
        locations.robot..locations.robot,
        comment(chain, &chain.not_in_links()).replace('\n', line_end),
    ));
    edits.sort_by_key(|(range, _)| range.start);
    let mut out = String::with_capacity(text.len() + 4096);
    let mut at = 0;
    for (range, new) in edits {
        out += &text[at..range.start];
        out += &new;
        at = range.end;
    }
    out += &text[at..];
    Ok(out)
}

fn locations(file: &Path, text: &str) -> Result<Locations, InputError> {
    let mut reader = Reader::from_str(text);
    let mut locations = Locations {
        joints: HashMap::new(),
        links: Vec::new(),
        joint_names: Vec::new(),
        robot: 0,
        end: text.len(),
    };
    // Names of the open elements, and the joint among them.
    let mut open: Vec<Vec<u8>> = Vec::new();
    let mut joint: Option<String> = None;
    loop {
        let start = reader.buffer_position() as usize;
        let event = reader.read_event().map_err(|error| {
            let line = 1 + text[..start.min(text.len())].matches('\n').count();
            InputError::new(file, error.to_string(), "XML").at_line(line)
        })?;
        let range = start..reader.buffer_position() as usize;
        match event {
            Event::Eof => return Ok(locations),
            Event::Start(tag) => {
                seen(&mut locations, &mut joint, &open, &tag, range, false);
                open.push(tag.name().as_ref().to_vec());
            }
            Event::Empty(tag) => {
                let before = joint.clone();
                seen(&mut locations, &mut joint, &open, &tag, range, true);
                // An element without content encloses nothing.
                joint = before;
            }
            Event::End(_) => {
                open.pop();
                match open.len() {
                    0 => locations.end = start,
                    1 => joint = None,
                    _ => {}
                }
            }
            _ => {}
        }
    }
}

fn seen(
    locations: &mut Locations,
    joint: &mut Option<String>,
    open: &[Vec<u8>],
    tag: &BytesStart<'_>,
    range: Range<usize>,
    closed: bool,
) {
    let name = tag.name();
    match (open.len(), name.as_ref()) {
        (0, b"robot") => locations.robot = range.start,
        (1, b"link") => locations.links.extend(attribute(tag, "name")),
        (1, b"joint") => {
            *joint = attribute(tag, "name");
            locations.joint_names.extend(joint.clone());
            if let (Some(name), false) = (joint.as_ref(), closed) {
                let location = Location {
                    origin: range.end..range.end,
                    closed: true,
                    there: false,
                };
                locations.joints.insert(name.clone(), location);
            }
        }
        (2, b"origin") => {
            if let Some(location) = joint
                .as_ref()
                .and_then(|name| locations.joints.get_mut(name))
            {
                *location = Location {
                    origin: range,
                    closed,
                    there: true,
                };
            }
        }
        _ => {}
    }
}

fn attribute(tag: &BytesStart<'_>, key: &str) -> Option<String> {
    let found = tag.try_get_attribute(key).ok()??;
    let value = found.unescape_value().ok()?;
    Some(value.into_owned())
}
