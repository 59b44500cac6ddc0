//! Finds joints at which a tip is where a feature needs it: on a point, a plane or a sphere.
//!
//! From any start, the shortest steps of the joints lead to the feature. Starts all over the joint ranges therefore end in
//! orientations all over the feature. A tip need not be real: it may be the point that a camera looks at.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::robot::Robot;

/// Largest number of steps before a start is given up.
const STEPS: usize = 60;
/// Distance from the feature at which the tip counts as arrived, in m.
const NEAR: f64 = 1e-7;
/// Longest step of the tip, in m: beyond it the first-order formula does not hold.
const LONGEST_STEP: f64 = 0.1;
/// Damping that keeps a step finite if the arm cannot move the tip that way, in m².
const DAMPING: f64 = 1e-8;

/// The target of a tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// A point, in m.
    Point(Vector3<f64>),
    /// The plane with this unit normal at this distance from the origin, in m.
    Plane(Vector3<f64>, f64),
    /// The sphere about this centre with this radius, in m.
    Sphere(Vector3<f64>, f64),
}

impl Surface {
    /// Returns the shortest vector from `at` to the surface, in m.
    fn way(&self, at: &Vector3<f64>) -> Vector3<f64> {
        match *self {
            Self::Point(point) => point - at,
            Self::Plane(normal, distance) => normal * (distance - normal.dot(at)),
            Self::Sphere(centre, radius) => {
                let out = at - centre;
                let length = out.norm();
                match length > 0.0 {
                    true => out * (radius / length - 1.0),
                    false => Vector3::new(radius, 0.0, 0.0),
                }
            }
        }
    }

    /// Returns the projection onto the directions in which the tip must move to reach the surface.
    fn projection(&self, at: &Vector3<f64>) -> Matrix3<f64> {
        let normal = match *self {
            Self::Point(_) => return Matrix3::identity(),
            Self::Plane(normal, _) => normal,
            Self::Sphere(centre, _) => match (at - centre).norm() {
                length if length > 0.0 => (at - centre) / length,
                _ => Vector3::x(),
            },
        };
        normal * normal.transpose()
    }
}

/// Moves the tip of an arm to a surface.
pub struct Settler<'a> {
    robot: &'a Robot,
    /// Chain from the base to the tip.
    chain: Poe<f64>,
    /// Ranges of the controller's joints, in rad or m.
    ranges: &'a [(f64, f64)],
}

impl<'a> Settler<'a> {
    /// Creates a settler for a nominal arm, base to flange, with a tip in the flange frame (m) and ranges of the
    /// controller's joints.
    pub fn new(
        robot: &'a Robot,
        nominal: &Poe<f64>,
        tip: Vector3<f64>,
        ranges: &'a [(f64, f64)],
    ) -> Self {
        let flange_from_tip = Pose {
            translation: tip,
            ..Pose::identity()
        };
        let mut chain = *nominal;
        if let Some(last) = chain.frames_mut().last_mut() {
            *last = *last * flange_from_tip;
        }
        Self {
            robot,
            chain,
            ranges,
        }
    }

    /// Returns the tip of the nominal arm, in m.
    pub fn nominal(&self, joints: &[f64]) -> Vector3<f64> {
        self.chain
            .forward(&self.robot.serial_joints(joints))
            .translation
    }

    /// Returns the controller's joints near `start` at which the tip is on the surface. `position` returns the tip at given
    /// joints: that of the nominal arm, or of another arm that is nearly so. `None` if the path ends at the limit of a
    /// joint's range.
    pub fn settle(
        &self,
        start: &[f64],
        surface: Surface,
        position: impl Fn(&[f64]) -> Vector3<f64>,
    ) -> Option<Vec<f64>> {
        let mut joints = start.to_vec();
        for _ in 0..STEPS {
            let at = position(&joints);
            let way = surface.way(&at);
            let length = way.norm();
            if length < NEAR {
                return Some(joints);
            }
            let step = way * (LONGEST_STEP / length).min(1.0);
            let columns = self.columns(&joints);
            let projection = surface.projection(&at);
            let damping = Matrix3::identity() * DAMPING;
            let normal = columns.iter().fold(damping, |sum, column| {
                let column = projection * column;
                sum + column * column.transpose()
            });
            let weights = normal.try_inverse()? * step;
            for ((joint, column), (lower, upper)) in
                joints.iter_mut().zip(&columns).zip(self.ranges)
            {
                *joint = (*joint + (projection * column).dot(&weights)).clamp(*lower, *upper);
            }
        }
        None
    }

    /// Returns how the tip moves with each of the controller's joints, in m per rad or m.
    fn columns(&self, joints: &[f64]) -> Vec<Vector3<f64>> {
        let serial = self.robot.serial_joints(joints);
        let (twists, tip) = self.chain.space_jacobian(&serial);
        let count = joints.len();
        let serial_columns: Vec<Vector3<f64>> = twists[..count]
            .iter()
            .map(|twist| twist.at_point(&tip.translation).linear)
            .collect();
        match &self.robot.coupling {
            None => serial_columns,
            Some(rows) => (0..count)
                .map(|j| {
                    let by_row = rows.iter().zip(&serial_columns);
                    by_row.fold(Vector3::zeros(), |sum, (row, column)| sum + column * row[j])
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Settler, Surface};
    use crate::robot::{LoadOptions, Robot};
    use nalgebra::Vector3;

    /// From wherever it begins, the tip ends on the surface and the joints within their ranges; a coupled arm, too.
    #[test]
    fn tips_settle_on_points_planes_and_spheres() {
        for name in ["ur10", "abb-irb4400"] {
            let robot = Robot::load(name, &LoadOptions::default()).unwrap();
            let chain = robot.chain().unwrap();
            let ranges = vec![(-2.0, 2.0); robot.joints.len()];
            let settler = Settler::new(&robot, &chain, Vector3::new(0.02, 0.01, 0.15), &ranges);
            let middle: Vec<f64> = (0..6).map(|i| 0.3 - 0.1 * f64::from(i)).collect();
            let at = settler.nominal(&middle);
            let normal = Vector3::new(0.6, 0.0, 0.8);
            for surface in [
                Surface::Point(at),
                Surface::Plane(normal, normal.dot(&at)),
                Surface::Sphere(at + Vector3::new(0.05, 0.0, 0.0), 0.05),
            ] {
                let mut settled = 0;
                for turn in 0..8 {
                    let start: Vec<f64> = middle
                        .iter()
                        .zip(0..)
                        .map(|(q, i): (&f64, i32)| q + 0.1 * f64::from((turn * (i + 1)) % 7 - 3))
                        .collect();
                    let Some(q) = settler.settle(&start, surface, |q| settler.nominal(q)) else {
                        continue;
                    };
                    settled += 1;
                    assert!(
                        surface.way(&settler.nominal(&q)).norm() < 1e-7,
                        "{name} {surface:?}"
                    );
                    assert!(q.iter().all(|q| q.abs() <= 2.0), "{name} {surface:?}");
                }
                assert!(settled >= 6, "{name} {surface:?}: {settled} of 8");
            }
        }
    }
}
