//! Computes the new numbers of corrected targets, and writes the files with them.

use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::program::{Goal, Program};
use crate::robot_programs::correction::source::{Decimals, Number, rewritten};
use crate::robot_programs::correction::target_poses::frames_of;

/// A corrected target with its joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Index of the target.
    pub target: usize,
    /// Joints by the nominal model.
    pub joints: Joints,
    /// Joints to command instead.
    pub command: Joints,
    /// Payload in kg.
    pub payload_kg: f64,
    /// Distance by which the written pose of the tool moves, in m and rad.
    pub moved: (f64, f64),
    /// Distance of the real tool from its target without correction, predicted by the model, in m.
    pub before: f64,
    /// Distance that remains with correction, predicted by the model, in m.
    pub after: f64,
    /// Rotation that remains with correction, predicted by the model, in rad.
    pub after_turned: f64,
    /// Standard deviation of a coordinate of the model's prediction, in m, if the model states one.
    pub sigma: Option<f64>,
    /// Whether the correction is complete, as it is except near singularities.
    pub is_complete: bool,
    /// Status of the model's evaluation at the joints.
    pub status: Status,
}

/// A number to be replaced, or, where the span is empty, a text to be inserted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replacement {
    /// Index of the file.
    pub file: usize,
    /// First byte, and the byte behind the last.
    pub span: (usize, usize),
    /// New number, or inserted text.
    pub text: Vec<u8>,
}

/// Returns tool⁻¹ · nominal(q)⁻¹ · nominal(q*) · tool, exactly the identity where q* is q.
fn motion(program: &Program, commander: &Commander, solved: &Solved) -> Pose<f64> {
    if solved.command == solved.joints {
        return Pose::identity();
    }
    let (tool, _) = frames_of(program, &program.targets[solved.target]);
    let [from, to] = [&solved.joints, &solved.command].map(|q| commander.nominal_flange(q));
    tool.inverse() * from.inverse() * to * tool
}

/// Writes a solved target. Returns roughly how far, in m, its rounded decimals leave it from where it should be.
pub fn replace(
    program: &Program,
    commander: &Commander,
    solved: &Solved,
    out: &mut Vec<Replacement>,
) -> f64 {
    let dialect = &program.dialect;
    let target = &program.targets[solved.target];
    let mut rounding = 0.0_f64;
    let mut put = |number: &Number, value: f64, decimals: Decimals, metres: f64| {
        let old = program.sources[number.file as usize].slice(&number.span());
        let new = rewritten(old, number.value, value, decimals);
        let written = new
            .as_ref()
            .map_or(number.value, |text| text.parse().unwrap_or(value));
        rounding = rounding.max(metres * (written - value).abs());
        if let Some(text) = new {
            let span = (number.start as usize, number.end as usize);
            out.push(Replacement {
                file: number.file as usize,
                span,
                text: text.into_bytes(),
            });
        }
    };
    let most = dialect.most_decimals;
    let lengths = Decimals {
        least: dialect.length_decimals,
        most: most.map(|m| m.0),
    };
    let joints = Decimals {
        least: dialect.joint_decimals,
        most: most.map(|m| m.1),
    };
    let angles = Decimals {
        least: dialect.orientation.decimals(),
        most: most.map(|m| m.1),
    };
    match &target.goal {
        Goal::Joints(numbers) => {
            for (i, number) in numbers.iter().enumerate() {
                // Adds to the number as it is written, so that a joint without a change keeps its number.
                let radian = program.radian(i);
                let change = (solved.command[i] - solved.joints[i]) / radian;
                // A joint error of 1 rad moves the tool by an arm's length.
                put(number, number.value + change, joints, 2.0 * radian.abs());
            }
        }
        Goal::Pose {
            position,
            orientation,
        } => {
            let motion = motion(program, commander, solved);
            let old: Vec<f64> = orientation.iter().map(|n| n.value).collect();
            let (Some(rotation), Some(turned)) = (
                dialect.orientation.rotation(&old),
                dialect.orientation.turned(&old, &motion.rotation),
            ) else {
                return 0.0;
            };
            let shift = rotation * motion.translation / dialect.metre;
            for (i, number) in position.iter().enumerate() {
                put(number, number.value + shift[i], lengths, dialect.metre);
            }
            for (number, value) in orientation.iter().zip(&turned) {
                put(number, *value, angles, 0.0);
            }
            for stated in target.configuration.iter().flat_map(|c| &c.stated) {
                let (number, value) = (stated.number, stated.at(&solved.joints, &solved.command));
                if value != number.value {
                    out.push(Replacement {
                        file: number.file as usize,
                        span: (number.start as usize, number.end as usize),
                        text: stated.text(value).into_bytes(),
                    });
                }
            }
        }
    }
    rounding
}

/// A file with its new numbers, and the spans of the inserted texts in it.
pub type Rewritten = (Vec<u8>, Vec<(usize, usize)>);

/// Returns the files with their new numbers; `replacements` are in the order of the files.
pub fn rewrite(program: &Program, replacements: &[Replacement]) -> Vec<Rewritten> {
    let mut out: Vec<Rewritten> = Vec::new();
    for (file, source) in program.sources.iter().enumerate() {
        let mut bytes = Vec::with_capacity(source.bytes.len() + 64);
        let (mut from, mut inserted) = (0, Vec::new());
        for r in replacements.iter().filter(|r| r.file == file) {
            let (start, end) = r.span;
            if start < from {
                continue;
            }
            bytes.extend_from_slice(&source.bytes[from..start]);
            let at = bytes.len();
            bytes.extend_from_slice(&r.text);
            if start == end {
                inserted.push((at, bytes.len()));
            }
            from = end;
        }
        bytes.extend_from_slice(&source.bytes[from..]);
        out.push((bytes, inserted));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use crate::robot_programs::Language;
    use crate::robot_programs::correction::source::Source;

    /// Behind numbers that become longer and shorter, too.
    #[test]
    fn what_was_inserted_can_be_taken_out() {
        let source = Source::new(Path::new("a.mod"), b"p 1.5 20.25 MoveL p; 3".to_vec(), true);
        let program = Program::new("ABB RAPID", Language::Rapid.dialect(), vec![source]);
        let put = |span: (usize, usize), text: &str| Replacement {
            file: 0,
            span,
            text: text.as_bytes().to_vec(),
        };
        let numbers = [
            put((2, 5), "1.50001"),
            put((6, 11), "2"),
            put((21, 22), "-3.1"),
        ];
        let copies = [
            put((12, 12), "MoveL q; MoveL r; "),
            put((21, 21), "MoveL s; "),
        ];
        let mut all = [numbers.as_slice(), &copies].concat();
        all.sort_by_key(|r| r.span);
        let [(split, inserted)] = &rewrite(&program, &all)[..] else {
            unreachable!()
        };
        let [(plain, none)] = &rewrite(&program, &numbers)[..] else {
            unreachable!()
        };
        assert!(none.is_empty() && inserted.len() == 2);
        let split = Source::new(Path::new("a.mod"), split.clone(), true);
        let rest = split.without(inserted).unwrap();
        assert_eq!(rest.bytes, *plain);
        assert_eq!(plain, b"p 1.50001 2 MoveL p; -3.1");
        assert!(split.without(&[(3, 2)]).is_none() && split.without(&[(0, 99)]).is_none());
    }
}
