//! Other readings of orientations: quaternions with another order or other signs, and angles of another convention.

use crate::numeric::rotation::{self, rotated};
use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::Pose;

/// Converts a rotation to its value in another reading.
pub type OfRotation = Box<dyn Fn(&Matrix3<f64>) -> Matrix3<f64>>;

/// Returns other readings of orientations, each with its statement about the file, the usual mistakes first.
pub fn other_orientations() -> Vec<(String, OfRotation)> {
    let mut out: Vec<(String, OfRotation)> = Vec::new();
    let rebuilt = |map: Box<dyn Fn([f64; 4]) -> [f64; 4]>| -> OfRotation {
        Box::new(move |r: &Matrix3<f64>| {
            let (w, v) = rotated(*r).quaternion();
            let q = map([w, v[0], v[1], v[2]]);
            let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
            let q = q.map(|x| x / norm);
            Pose::from_quaternion(q[0], &Vector3::new(q[1], q[2], q[3]), Vector3::zeros()).rotation
        })
    };
    let names = ["qw", "qx", "qy", "qz"];
    out.push((
        "the quaternions look inverted (qw, or qx, qy and qz negated)".to_owned(),
        Box::new(|r| r.transpose()),
    ));
    for negated in 1..4 {
        let name = names[negated];
        out.push((
            format!("{name} of the quaternions looks negated"),
            rebuilt(Box::new(move |mut q| {
                q[negated] = -q[negated];
                q
            })),
        ));
    }
    for order in permutations() {
        let listed: Vec<&str> = (0..4)
            .map(|column| names[order.iter().position(|o| *o == column).unwrap_or(0)])
            .collect();
        out.push((
            format!(
                "the quaternion's columns look like {} where the header says qw, qx, qy, qz",
                listed.join(", ")
            ),
            rebuilt(Box::new(move |q| order.map(|o| q[o]))),
        ));
    }
    let conventions = Convention::all();
    for from in &conventions {
        for to in &conventions {
            for reversed in [false, true] {
                if from == to && !reversed {
                    continue;
                }
                let (from, to) = (*from, *to);
                out.push((
                    format!(
                        "the orientations look like angles {}{} that were read as {}",
                        to.name(),
                        if reversed { " in reversed order" } else { "" },
                        from.name()
                    ),
                    Box::new(move |r: &Matrix3<f64>| {
                        let mut angles = from.angles(r);
                        if reversed {
                            angles.reverse();
                        }
                        to.rotation(&angles)
                    }),
                ));
            }
        }
    }
    out
}

/// Returns all orders of the four columns except the right one.
fn permutations() -> Vec<[usize; 4]> {
    let mut out = Vec::new();
    // The most common mistake comes first: w last.
    for code in [147_usize].into_iter().chain(0..256) {
        let order: [usize; 4] = std::array::from_fn(|i| code >> (2 * i) & 3);
        let mut sorted = order;
        sorted.sort_unstable();
        if sorted == [0, 1, 2, 3] && order != [0, 1, 2, 3] && !out.contains(&order) {
            out.push(order);
        }
    }
    out
}

/// A convention for describing a rotation by three angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Convention {
    /// Rotations about these axes, each in the frame that results from the one before it.
    Intrinsic([usize; 3]),
    /// Rotation vector.
    Vector,
}

impl Convention {
    fn all() -> Vec<Self> {
        let mut out = vec![Self::Vector];
        for axes in [
            [0, 1, 2],
            [2, 1, 0],
            [2, 1, 2],
            [2, 0, 2],
            [1, 0, 2],
            [2, 0, 1],
            [0, 2, 1],
            [1, 2, 0],
        ] {
            out.push(Self::Intrinsic(axes));
        }
        out
    }

    fn name(self) -> String {
        match self {
            Self::Vector => "of a rotation vector".to_owned(),
            Self::Intrinsic(axes) => axes.iter().map(|axis| ['X', 'Y', 'Z'][*axis]).collect(),
        }
    }

    fn rotation(self, angles: &[f64; 3]) -> Matrix3<f64> {
        match self {
            Self::Vector => turn(&Vector3::new(angles[0], angles[1], angles[2])),
            Self::Intrinsic(axes) => {
                axes.iter()
                    .zip(angles)
                    .fold(Matrix3::identity(), |r, (axis, angle)| {
                        let mut vector = Vector3::zeros();
                        vector[*axis] = *angle;
                        r * turn(&vector)
                    })
            }
        }
    }

    /// Returns the angles of a rotation. Of two possible solutions it is the one whose middle angle is within ±90° (0 to
    /// 180° if the third axis equals the first).
    fn angles(self, r: &Matrix3<f64>) -> [f64; 3] {
        match self {
            Self::Vector => {
                let v = rotated(*r).log().angular;
                [v[0], v[1], v[2]]
            }
            Self::Intrinsic([i, j, k]) if i == k => {
                let l = 3 - i - j;
                let sign = if (i + 1) % 3 == j { 1.0 } else { -1.0 };
                let middle = libm::acos(r[(i, i)].clamp(-1.0, 1.0));
                let first = libm::atan2(r[(j, i)], -sign * r[(l, i)]);
                let last = libm::atan2(r[(i, j)], sign * r[(i, l)]);
                [first, middle, last]
            }
            Self::Intrinsic([i, j, k]) => {
                let sign = if (i + 1) % 3 == j { 1.0 } else { -1.0 };
                let middle = libm::asin((sign * r[(i, k)]).clamp(-1.0, 1.0));
                let first = libm::atan2(-sign * r[(j, k)], r[(k, k)]);
                let last = libm::atan2(-sign * r[(i, j)], r[(i, i)]);
                [first, middle, last]
            }
        }
    }
}

fn turn(vector: &Vector3<f64>) -> Matrix3<f64> {
    rotation::turn(*vector).rotation
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_convention_gives_back_the_rotation_of_its_angles() {
        for convention in Convention::all() {
            let r = turn(&Vector3::new(0.7, -0.4, 1.1));
            let angles = convention.angles(&r);
            let again = convention.rotation(&angles);
            assert!((again - r).norm() < 1e-12, "{convention:?} {angles:?}");
        }
    }

    #[test]
    fn all_orders_of_four_columns_are_tried() {
        assert_eq!(permutations().len(), 23);
    }
}
