//! Reads condition files of Yaskawa controllers: tools (`TOOL.CND`) and user frames (`UFRAME.CND`).
//!
//! `//TOOL n` is followed by a line of six numbers (mm and degrees from the flange), the centre of gravity, the weight in kg
//! and the inertia. `//UFRAME n` has its frame in the line `////BUSER`. Other lines are not used.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::frames::{Given, Numbered};
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::dialect::INFORM;

/// Names of the files, in upper case.
pub const NAMES: [&str; 2] = ["TOOL.CND", "UFRAME.CND"];

/// Returns the tools and user frames of the files that are no jobs.
pub fn conditions(sources: &[Source]) -> Numbered {
    let mut out = Numbered::new();
    for source in sources {
        let text = String::from_utf8_lossy(&source.bytes);
        let mut key = None;
        for line in text.lines().map(str::trim) {
            let rest = line.trim_start_matches('/');
            let (word, value) = rest.split_once(' ').unwrap_or((rest, ""));
            let depth = line.len() - rest.len();
            match (depth, word) {
                (2, "TOOL" | "UFRAME") => {
                    key = value.trim().parse().ok().map(|n: u32| (word == "TOOL", n));
                }
                (2, _) => key = None,
                (4.., "BUSER") | (0, _) => {
                    let is_frame = depth > 0;
                    let numbers = numbers(if is_frame { value } else { line });
                    let Some(key) = key.filter(|(is_tool, _)| *is_tool != is_frame) else {
                        continue;
                    };
                    note(&mut out, key, &numbers, &source.path.display().to_string());
                }
                _ => {}
            }
        }
    }
    out
}

fn numbers(text: &str) -> Vec<f64> {
    let all = text.split(',').map(|n| n.trim().parse::<f64>().ok());
    let finite = all.map(|n| n.filter(|n| n.is_finite()));
    finite.collect::<Option<Vec<f64>>>().unwrap_or_default()
}

/// Notes a line of numbers: six numbers are the pose, which comes first; one number is the weight.
fn note(out: &mut Numbered, key: (bool, u32), numbers: &[f64], origin: &str) {
    match (numbers, out.get_mut(&key)) {
        ([x, y, z, angles @ ..], None) => {
            let Some(rotation) = INFORM.orientation.rotation(angles) else {
                return;
            };
            let pose = Pose {
                rotation,
                translation: Vector3::new(*x, *y, *z) * INFORM.metre,
            };
            let given = Given {
                pose,
                payload_kg: None,
            };
            out.insert(key, (given, origin.to_owned()));
        }
        ([kg], Some((given, _))) if given.payload_kg.is_none() && *kg >= 0.0 => {
            given.payload_kg = Some(*kg);
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn tools_have_their_weight_and_frames_their_line() {
        let tools = "//TOOL 0\r\n///NAME\r\n0,0,0,0,0,0\r\n0,0,0\r\n0.000\r\n0,0,0\r\n//TOOL 3\r\n///NAME GUN\r\n\
            30.000,-45.000,210.000,25.0000,0.0000,0.0000\r\n1,2,3\r\n2.500\r\n0.1,0.1,0.1\r\n";
        let frames = "//UFRAME 2\n///NAME TABLE\n///TOOL 3\n///GROUP 1,0,0\n///PULSE\n////RORG C000=1,2,3,4,5,6\n\
            ////BUSER 900.000,-300.000,420.000,0.0000,0.0000,20.0000\n";
        let source =
            |name: &str, text: &str| Source::new(Path::new(name), text.as_bytes().to_vec(), false);
        let all = conditions(&[source("TOOL.CND", tools), source("UFRAME.CND", frames)]);
        assert_eq!(all.len(), 3);
        let (tool, origin) = &all[&(true, 3)];
        assert_eq!((tool.payload_kg, origin.as_str()), (Some(2.5), "TOOL.CND"));
        assert_eq!(tool.pose.translation, Vector3::new(0.03, -0.045, 0.21));
        let (frame, _) = &all[&(false, 2)];
        assert!((frame.pose.rotation[(0, 0)] - 20_f64.to_radians().cos()).abs() < 1e-12);
        assert!((frame.pose.translation - Vector3::new(0.9, -0.3, 0.42)).norm() < 1e-12);
        assert_eq!(all[&(true, 0)].0.payload_kg, Some(0.0));
    }
}
