//! The error that remains between the corrected ends of lines and arcs.
//!
//! A controller moves on a line or a circle between the written ends, computed by the nominal model. The ends are corrected,
//! but the arm's own error differs between them. The model computes it at some points of each move.

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_calibration::numeric::parallel::map_all;
use poegp_calibration::progress::threads;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::robot_programs::correction::program::{Program, Way};
use crate::robot_programs::correction::replacement::Solved;
use crate::robot_programs::correction::target_poses::frames_of;

/// Largest number of points of a move, and below it that of all moves together.
pub const POINTS: usize = 20;
const ALL_POINTS: usize = 20_000;
/// Three points are on a line when the squared cross product of two sides of their triangle is below this share of the
/// product of these squared sides.
const FLAT: f64 = 1e-9;

/// A line or an arc between corrected targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch<'a> {
    /// Index of the move in [`Program::moves`].
    pub step: usize,
    /// Target at which the move begins.
    pub start: &'a Solved,
    /// Target between the ends of an arc; `None` for a line.
    pub via: Option<&'a Solved>,
    /// Target at which the move ends.
    pub end: &'a Solved,
}

impl Stretch<'_> {
    fn points(&self) -> Vec<&Solved> {
        [Some(self.start), self.via, Some(self.end)]
            .into_iter()
            .flatten()
            .collect()
    }
}

/// Remaining error between the ends of one move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// Index of the target at which the move ends.
    pub target: usize,
    /// Number of points of the move that were evaluated.
    pub points: usize,
    /// Largest distance of the real tool from the path between the wanted ends, in m.
    pub largest: f64,
}

/// Returns the lines and arcs whose targets were all corrected, in the order of the moves.
pub fn stretches<'a>(program: &Program, solved: &'a [Solved]) -> Vec<Stretch<'a>> {
    let mut by_target: Vec<Option<&Solved>> = vec![None; program.targets.len()];
    for one in solved {
        by_target[one.target] = Some(one);
    }
    let mut out = Vec::new();
    let (mut last, mut via): (Option<&Solved>, Option<Option<&Solved>>) = (None, None);
    for (index, step) in program.moves.iter().enumerate() {
        let here = by_target[step.target];
        let middle = via.take();
        if (step.way, middle) == (Way::Arc, None) {
            via = Some(here);
            continue;
        }
        let is_known = step.way != Way::Arc || middle.flatten().is_some();
        if let (Way::Line | Way::Arc, true, Some(start), Some(end)) =
            (step.way, is_known, last, here)
        {
            let via = middle.flatten().filter(|_| step.way == Way::Arc);
            out.push(Stretch {
                step: index,
                start,
                via,
                end,
            });
        }
        last = here;
    }
    out
}

/// Computes the remaining errors between the ends of lines and arcs.
pub fn between(
    program: &Program,
    commander: &Commander,
    stretches: &[Stretch<'_>],
) -> Vec<Between> {
    let points = (ALL_POINTS / stretches.len().max(1)).clamp(1, POINTS);
    map_all(threads(), stretches, |stretch| Between {
        target: stretch.end.target,
        points,
        largest: error(program, commander, stretch, points),
    })
}

/// Returns the largest position error at points of a move, in m.
pub fn error(
    program: &Program,
    commander: &Commander,
    stretch: &Stretch<'_>,
    points: usize,
) -> f64 {
    let (first, end) = (stretch.start, stretch.end);
    let (tool, _) = frames_of(program, &program.targets[end.target]);
    let poses = |joints: fn(&Solved) -> &Joints| -> Vec<Pose<f64>> {
        let pose = |s: &&Solved| commander.nominal_flange(joints(s)) * tool;
        stretch.points().iter().map(pose).collect()
    };
    let (wanted, written) = (poses(|s| &s.joints), poses(|s| &s.command));
    let mut largest = 0.0_f64;
    for k in 1..=points {
        let share = k as f64 / (points + 1) as f64;
        let mut near = first.command;
        for (q, to) in near.iter_mut().zip(&end.command) {
            *q += share * (to - *q);
        }
        let flange = at(&written, share) * tool.inverse();
        let found = commander.nominal_joints(&flange, &near);
        if found.status.contains(Status::PARTLY_CORRECTED) {
            continue;
        }
        let real = commander.real_flange(&found.joints, end.payload_kg) * tool;
        let off = real.translation - at(&wanted, share).translation;
        largest = largest.max(off.norm());
    }
    largest
}

/// Returns the pose at `share` of the path from the first to the last pose: a line for two poses, an arc for three.
pub fn at(poses: &[Pose<f64>], share: f64) -> Pose<f64> {
    let (Some(a), Some(b)) = (poses.first(), poses.last()) else {
        return Pose::identity();
    };
    let turned = (a.inverse() * *b).log().angular * share;
    let zero = Vector3::zeros();
    let turn = Pose::exp(&Twist {
        linear: zero,
        angular: turned,
    });
    let translation = match poses {
        [_, via, _] => on_circle(&a.translation, &via.translation, &b.translation, share),
        _ => a.translation + (b.translation - a.translation) * share,
    };
    Pose {
        rotation: a.rotation * turn.rotation,
        translation,
    }
}

/// Returns the point at `share` of the arc from `a` through `via` to `b`.
fn on_circle(a: &Vector3<f64>, via: &Vector3<f64>, b: &Vector3<f64>, share: f64) -> Vector3<f64> {
    let (u, v) = (via - a, b - a);
    let normal = u.cross(&v);
    let area = normal.norm_squared();
    if area < FLAT * u.norm_squared() * v.norm_squared() || area == 0.0 {
        return a + v * share;
    }
    // The centre of the circumscribed circle of the triangle.
    let centre = a
        + (v.cross(&normal) * -u.norm_squared() + u.cross(&normal) * v.norm_squared())
            / (-2.0 * area);
    let axis = normal / area.sqrt();
    let (x, z) = (a - centre, b - centre);
    let y = axis.cross(&x);
    let angle = z.dot(&y).atan2(z.dot(&x)).rem_euclid(std::f64::consts::TAU);
    let (sin, cos) = (share * angle).sin_cos();
    centre + x * cos + y * sin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_goes_through_its_three_points() {
        let point = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Vector3::new(1.0 + 0.3 * cos, 2.0 + 0.3 * sin, 0.5)
        };
        for (from, via, to) in [
            (10.0, 40.0, 100.0),
            (0.0, 170.0, 300.0),
            (50.0, 20.0, -90.0),
        ] {
            let (a, b, c) = (point(from), point(via), point(to));
            for (share, expected) in [(0.0, a), (1.0, c), (0.5, point(0.5 * (from + to)))] {
                let found = on_circle(&a, &b, &c, share);
                assert!(
                    (found - expected).norm() < 1e-12,
                    "{from} {via} {to} {share}: {found}"
                );
            }
            let share = (via - from) / (to - from);
            assert!((on_circle(&a, &b, &c, share) - b).norm() < 1e-12);
        }
        let [a, b, c] = [0.0, 1.0, 4.0].map(|x| Vector3::new(x, 0.0, 0.0));
        assert!((on_circle(&a, &b, &c, 0.5)[0] - 2.0).abs() < 1e-12);
    }
}
