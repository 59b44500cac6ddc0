//! What stays between the ends of lines and arcs.
//!
//! A controller goes straight, or on a circle, between the ends that are written, by the drawing. The ends are corrected; in
//! between the arm's own error is another one. It is computed by the model at some points of each move.

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_calibration::numeric::parallel::map_all;
use poegp_calibration::progress::threads;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::robot_programs::correction::program::{Location, Program, Way, frames_of};
use crate::robot_programs::correction::replacement::Solved;

/// Points of a move, and of all moves together, at most.
const POINTS: usize = 20;
const ALL_POINTS: usize = 20_000;
/// Less than this share of the chord squared, twice the area of three points is none: they are on a line.
const FLAT: f64 = 1e-9;

/// The error between the ends of all moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// Lines and arcs.
    pub moves: usize,
    /// Points of each that were looked at.
    pub points: usize,
    /// Largest distance of the real tool from the way between the wanted ends, m.
    pub largest: f64,
    /// The target that the worst move ends at.
    pub location: Location,
}

/// A move between solved targets: its ends, and on an arc a point between them.
struct Piece<'a> {
    points: Vec<&'a Solved>,
}

/// Looks between the ends of lines and arcs whose targets were corrected; `None` without any.
pub fn between(program: &Program, commander: &Commander, solved: &[Solved]) -> Option<Between> {
    let mut by_target: Vec<Option<&Solved>> = vec![None; program.targets.len()];
    for one in solved {
        by_target[one.target] = Some(one);
    }
    let mut pieces = Vec::new();
    let (mut last, mut via): (Option<&Solved>, Option<Option<&Solved>>) = (None, None);
    for step in &program.moves {
        let here = by_target[step.target];
        match (step.way, via.take()) {
            (Way::Arc, None) => {
                via = Some(here);
                continue;
            }
            (Way::Arc, Some(middle)) => {
                if let (Some(a), Some(b), Some(c)) = (last, middle, here) {
                    pieces.push(Piece {
                        points: vec![a, b, c],
                    });
                }
            }
            (Way::Line, _) => {
                if let (Some(a), Some(b)) = (last, here) {
                    pieces.push(Piece { points: vec![a, b] });
                }
            }
            (Way::Joints, _) => {}
        }
        last = here;
    }
    let points = (ALL_POINTS / pieces.len().max(1)).clamp(1, POINTS);
    let errors = map_all(threads(), &pieces, |piece| {
        error(program, commander, piece, points)
    });
    let worst = errors
        .iter()
        .zip(&pieces)
        .max_by(|a, b| a.0.total_cmp(b.0))?;
    let end = worst.1.points.last()?;
    Some(Between {
        moves: pieces.len(),
        points,
        largest: *worst.0,
        location: program.targets[end.target].location,
    })
}

/// The largest error at points of a move, m.
fn error(program: &Program, commander: &Commander, piece: &Piece<'_>, points: usize) -> f64 {
    let (Some(first), Some(end)) = (piece.points.first(), piece.points.last()) else {
        return 0.0;
    };
    let (tool, _) = frames_of(program, &program.targets[end.target]);
    let poses = |joints: fn(&Solved) -> &Joints| -> Vec<Pose<f64>> {
        let pose = |s: &&Solved| commander.nominal_flange(joints(s)) * tool;
        piece.points.iter().map(pose).collect()
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

/// The pose at a share of the way from the first to the last of two poses, or three on a circle.
fn at(poses: &[Pose<f64>], share: f64) -> Pose<f64> {
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

/// The point at a share of the arc from `a` through `via` to `b`.
fn on_circle(a: &Vector3<f64>, via: &Vector3<f64>, b: &Vector3<f64>, share: f64) -> Vector3<f64> {
    let (u, v) = (via - a, b - a);
    let normal = u.cross(&v);
    let area = normal.norm_squared();
    if area < FLAT * u.norm_squared() * v.norm_squared() || area == 0.0 {
        return a + v * share;
    }
    // The centre of the circle about a triangle.
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
