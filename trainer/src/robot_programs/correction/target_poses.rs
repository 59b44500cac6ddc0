//! Poses of targets: as they are written, and in their frames.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::program::{Goal, Program, Target};

/// Returns the written pose of a target; `None` where the numbers are no orientation.
pub fn written_pose(program: &Program, target: &Target) -> Option<Pose<f64>> {
    let Goal::Pose {
        position,
        orientation,
    } = &target.goal
    else {
        return None;
    };
    let dialect = &program.dialect;
    let numbers: Vec<f64> = orientation.iter().map(|n| n.value).collect();
    let [x, y, z] = position.map(|n| dialect.metre * n.value);
    Some(Pose {
        rotation: dialect.orientation.rotation(&numbers)?,
        translation: Vector3::new(x, y, z),
    })
}

/// Returns `flange_from_tool` and `base_from_frame` of a target.
pub fn frames_of(program: &Program, target: &Target) -> (Pose<f64>, Pose<f64>) {
    let of = |index: Option<usize>| {
        let frame = index.and_then(|index| program.frames.get(index));
        frame.map_or_else(Pose::identity, |frame| frame.pose)
    };
    (of(target.tool), of(target.base))
}
