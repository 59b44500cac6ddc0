//! Reads tools and user frames of a Fanuc controller from the text of its variables (`SYSFRAME.VA`, or `SYSTEM.VA` of older
//! controllers).
//!
//! A variable begins with `[*SYSTEM*]$MNUTOOL  Storage: …` or `$MNUFRAME`. After `[1,3] =`, number 3 of the first group,
//! come lines with `X:`, `Y:` and `Z:` in mm and `W:`, `P:` and `R:` in degrees. Other variables and other groups are not
//! used.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::frames::{Given, Numbered};
use crate::robot_programs::correction::source::Source;

/// Names of the files, in upper case.
pub const NAMES: [&str; 2] = ["SYSFRAME.VA", "SYSTEM.VA"];

/// Labels of the numbers of a frame.
const LABELS: [&str; 6] = ["X:", "Y:", "Z:", "W:", "P:", "R:"];

/// Returns the frames of all variable files; where two files have the same number, the first file counts.
pub fn frames(sources: &[Source]) -> Numbered {
    let mut out = Numbered::new();
    for source in sources {
        let origin = source.path.display().to_string();
        let text = String::from_utf8_lossy(&source.bytes);
        let (mut is_tool, mut reading) = (None, None);
        for line in text.lines().map(str::trim) {
            if let Some((_, variable)) = line.split_once("]$").filter(|_| line.starts_with('[')) {
                is_tool = match variable.split_whitespace().next() {
                    Some("MNUTOOL") => Some(true),
                    Some("MNUFRAME") => Some(false),
                    _ => None,
                };
                reading = None;
            } else if line.starts_with('[') {
                let key = is_tool.zip(index(line));
                reading = key.map(|key| (key, [None; 6]));
            } else if let Some((key, numbers)) = &mut reading {
                for (slot, label) in numbers.iter_mut().zip(LABELS) {
                    *slot = slot.or_else(|| labelled(line, label));
                }
                if let Some(pose) = pose(numbers) {
                    let given = Given {
                        pose,
                        payload_kg: None,
                    };
                    out.entry(*key).or_insert((given, origin.clone()));
                    reading = None;
                }
            }
        }
    }
    out
}

/// Returns the second index of `[1,3] =`; `None` for another group than the first.
fn index(line: &str) -> Option<u32> {
    let (inside, _) = line.strip_prefix('[')?.split_once(']')?;
    let (group, number) = inside.split_once(',')?;
    (group.trim() == "1").then_some(number.trim().parse().ok()?)
}

/// Returns the number behind a label.
fn labelled(line: &str, label: &str) -> Option<f64> {
    let (before, behind) = line.split_once(label)?;
    let is_word = before.is_empty() || before.ends_with(char::is_whitespace);
    let number = behind.split_whitespace().next()?.parse::<f64>().ok()?;
    (is_word && number.is_finite()).then_some(number)
}

fn pose(numbers: &[Option<f64>; 6]) -> Option<Pose<f64>> {
    let numbers: Vec<f64> = numbers.iter().copied().collect::<Option<_>>()?;
    let dialect = Language::Fanuc.dialect();
    Some(Pose {
        rotation: dialect.orientation.rotation(&numbers[3..])?,
        translation: Vector3::new(numbers[0], numbers[1], numbers[2]) * dialect.metre,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn frames_of_the_first_group_are_found_by_number() {
        let text = "[*SYSTEM*]$MNUFRAME  Storage: SHADOW  Access: RW  : ARRAY[2,9] OF POSITION\r\n     [1,1] = \r\n  Group: 1   \
            Config: N D B, 0, 0, 0\r\n  X:   900.000   Y:  -300.000   Z:   420.000\r\n  W:     0.000   P:     0.000   R:    20.000\r\n     \
            [1,2] =  Uninitialized\r\n     [1,3] = 'fixture' Group: 1\r\n  X:********   Y:     0.000   Z:     0.000\r\n     [2,4] = \r\n  \
            X:     1.000   Y:     0.000   Z:     0.000\r\n  W:     0.000   P:     0.000   R:     0.000\r\n\
            [*SYSTEM*]$MNUFRAMENUM  Storage: SHADOW  Access: RW  : ARRAY[2] OF BYTE\r\n     [1] = 1\r\n\
            [*SYSTEM*]$MNUTOOL  Storage: SHADOW  Access: RW  : ARRAY[2,10] OF POSITION\r\n     [1,3] =\r\n  Group: 1   \
            Config: N D B, 0, 0, 0\r\n  X:    30.000   Y:   -45.000   Z:   210.000\r\n  W:    25.000   P:     0.000   R:     0.000\r\n\
            [*SYSTEM*]$OTHER  Storage: CMOS  Access: RW  : ARRAY[1,10] OF POSITION\r\n     [1,7] = \r\n  X:    30.000   Y:   -45.000   \
            Z:   210.000\r\n  W:    25.000   P:     0.000   R:     0.000\r\n";
        let source = Source::new(Path::new("sysframe.va"), text.as_bytes().to_vec(), false);
        let all = frames(&[source]);
        let keys: Vec<_> = all.keys().copied().collect();
        assert_eq!(keys, [(false, 1), (true, 3)]);
        let (frame, origin) = &all[&(false, 1)];
        assert_eq!(origin, "sysframe.va");
        assert_eq!(frame.pose.translation, Vector3::new(0.9, -0.3, 0.42));
        assert!((frame.pose.rotation[(1, 0)] - 20_f64.to_radians().sin()).abs() < 1e-12);
        let (tool, _) = &all[&(true, 3)];
        assert!((tool.pose.rotation[(2, 1)] - 25_f64.to_radians().sin()).abs() < 1e-12);
    }
}
