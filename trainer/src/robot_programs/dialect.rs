//! Units and orientations of the controllers' languages, for writing programs and for correcting them.

use nalgebra::{Matrix3, Vector3};
use poegp_calibration::numeric::rotation::rotated;
use poegp_calibration::robot::normal_form::{roll_pitch_yaw, rotation_about};
use poegp_runtime::math::se3::{Pose, Twist};

use crate::robot_programs::Language;

/// Angle in radians below which nothing counts as turned.
const NOT_TURNED: f64 = 1e-12;

/// Notation of an orientation in a language.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orientation {
    /// Quaternion w, x, y, z.
    Quaternion,
    /// Degrees about the fixed axes x, y, z: R = Rz(c) Ry(b) Rx(a).
    FixedXyz,
    /// Degrees about z, the new y, the new x: R = Rz(a) Ry(b) Rx(c).
    TurnedZyx,
    /// Degrees about x, the new y, the new z: R = Rx(a) Ry(b) Rz(c).
    TurnedXyz,
    /// Rotation vector: axis times angle, in radians.
    RotationVector,
}

impl Orientation {
    /// Returns the rotation of these numbers; `None` for too few numbers, or for a quaternion that is not of unit length.
    pub fn rotation(self, numbers: &[f64]) -> Option<Matrix3<f64>> {
        Some(match (self, numbers) {
            (Self::Quaternion, [w, x, y, z]) => {
                let norm = (w * w + x * x + y * y + z * z).sqrt();
                // The tolerance allows for four decimals and a little more.
                let is_unit = (norm - 1.0).abs() < 1e-2;
                if !is_unit {
                    return None;
                }
                Pose::from_quaternion(*w, &Vector3::new(*x, *y, *z), Vector3::zeros()).rotation
            }
            (Self::RotationVector, [x, y, z]) => {
                let twist = Twist::from_array(&[0.0, 0.0, 0.0, *x, *y, *z]);
                Pose::exp(&twist).rotation
            }
            (_, [a, b, c]) => {
                let about =
                    |axis, degrees: f64| rotation_about(axis, degrees.to_radians()).rotation;
                match self {
                    Self::FixedXyz => about(2, *c) * about(1, *b) * about(0, *a),
                    Self::TurnedZyx => about(2, *a) * about(1, *b) * about(0, *c),
                    _ => about(0, *a) * about(1, *b) * about(2, *c),
                }
            }
            _ => return None,
        })
    }

    /// Turns the orientation `old` by the small rotation `turn` in the tool's frame, and returns its numbers. Angles stay on
    /// their turn, a quaternion keeps its sign and length; without a rotation the numbers are the old ones to the bit.
    pub fn turned(self, old: &[f64], turn: &Matrix3<f64>) -> Option<Vec<f64>> {
        if rotated(*turn).log().angular.norm() < NOT_TURNED {
            return Some(old.to_vec());
        }
        let new = self.rotation(old)? * turn;
        Some(match (self, old) {
            (Self::Quaternion, [w0, x0, y0, z0]) => {
                let (w, v) = rotated(new).quaternion();
                let same = w * w0 + v[0] * x0 + v[1] * y0 + v[2] * z0;
                let norm = (w0 * w0 + x0 * x0 + y0 * y0 + z0 * z0).sqrt();
                let factor = if same < 0.0 { -norm } else { norm };
                vec![factor * w, factor * v[0], factor * v[1], factor * v[2]]
            }
            (Self::RotationVector, [x0, y0, z0]) => {
                let old = Vector3::new(*x0, *y0, *z0);
                let vector = rotated(new).log().angular;
                let angle = vector.norm();
                // Candidates: the same rotation a whole turn on, either way, or about the opposite axis.
                let axis = match angle > 1e-9 {
                    true => vector / angle,
                    false => old / old.norm().max(1e-9),
                };
                let turns = (-2..=2).map(|k| axis * (angle + std::f64::consts::TAU * f64::from(k)));
                let nearest = turns.min_by(|a, b| (a - old).norm().total_cmp(&(b - old).norm()))?;
                vec![nearest[0], nearest[1], nearest[2]]
            }
            (_, [a0, b0, c0]) => {
                let [a, b, c] = self.angles(&new);
                // Every rotation has two triples of angles.
                let near = |old: f64, new: f64| new + 360.0 * ((old - new) / 360.0).round();
                let triples = [[a, b, c], [a + 180.0, 180.0 - b, c + 180.0]]
                    .map(|[a, b, c]| [near(*a0, a), near(*b0, b), near(*c0, c)]);
                let far = |t: &[f64; 3]| (t[0] - a0).abs() + (t[1] - b0).abs() + (t[2] - c0).abs();
                let [first, second] = triples;
                let nearest = if far(&second) < far(&first) {
                    second
                } else {
                    first
                };
                nearest.to_vec()
            }
            _ => return None,
        })
    }

    /// Returns the numbers of a rotation in this notation.
    pub fn numbers(self, rotation: &Matrix3<f64>) -> Vec<f64> {
        let pose = rotated(*rotation);
        match self {
            Self::Quaternion => {
                let (w, v) = pose.quaternion();
                vec![w, v[0], v[1], v[2]]
            }
            Self::RotationVector => pose.log().angular.as_slice().to_vec(),
            _ => self.angles(rotation).to_vec(),
        }
    }

    /// Returns one of the two triples of angles of a rotation, in degrees.
    fn angles(self, rotation: &Matrix3<f64>) -> [f64; 3] {
        match self {
            Self::FixedXyz => roll_pitch_yaw(rotation),
            Self::TurnedZyx => {
                let [roll, pitch, yaw] = roll_pitch_yaw(rotation);
                [yaw, pitch, roll]
            }
            _ => roll_pitch_yaw(&rotation.transpose()).map(|angle| -angle),
        }
        .map(f64::to_degrees)
    }

    /// Returns the number of decimals that shows 1 µrad.
    pub fn decimals(self) -> usize {
        match self {
            Self::Quaternion => 7,
            Self::RotationVector => 6,
            _ => 5,
        }
    }
}

/// Units of a language, and the decimals of its formats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dialect {
    /// Metres in a unit of length.
    pub metre: f64,
    /// Number of decimals of a length that shows 1 µm.
    pub length_decimals: usize,
    /// Radians in a unit of a joint.
    pub radian: f64,
    /// Number of decimals of a joint that shows 1 µrad.
    pub joint_decimals: usize,
    /// Notation of orientations.
    pub orientation: Orientation,
    /// Largest number of decimals that the format allows: for lengths, and for joints and angles.
    pub most_decimals: Option<(usize, usize)>,
}

/// Dialect of millimetres and degrees.
pub const MILLIMETRES: Dialect = Dialect {
    metre: 1e-3,
    length_decimals: 3,
    radian: std::f64::consts::PI / 180.0,
    joint_decimals: 5,
    orientation: Orientation::FixedXyz,
    most_decimals: None,
};

/// Dialect of Yaskawa INFORM, whose angles have two decimals, and whose joints are whole pulses.
pub const INFORM: Dialect = Dialect {
    joint_decimals: 0,
    most_decimals: Some((3, 2)),
    ..MILLIMETRES
};

/// Dialect of Stäubli VAL3.
pub const VAL3: Dialect = Dialect {
    orientation: Orientation::TurnedXyz,
    ..MILLIMETRES
};

impl Language {
    /// Returns the dialect of this language.
    pub fn dialect(self) -> Dialect {
        match self {
            Self::Rapid => Dialect {
                orientation: Orientation::Quaternion,
                ..MILLIMETRES
            },
            Self::Krl => Dialect {
                orientation: Orientation::TurnedZyx,
                ..MILLIMETRES
            },
            Self::Fanuc => Dialect {
                most_decimals: Some((3, 3)),
                ..MILLIMETRES
            },
            Self::UrScript => Dialect {
                metre: 1.0,
                length_decimals: 6,
                radian: 1.0,
                joint_decimals: 6,
                orientation: Orientation::RotationVector,
                most_decimals: None,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Orientation; 5] = [
        Orientation::Quaternion,
        Orientation::FixedXyz,
        Orientation::TurnedZyx,
        Orientation::TurnedXyz,
        Orientation::RotationVector,
    ];

    /// Three numbers of an orientation, or a quaternion of them.
    fn numbers(orientation: Orientation, a: f64, b: f64, c: f64) -> Vec<f64> {
        match orientation {
            Orientation::Quaternion => {
                let rotation = Orientation::FixedXyz.rotation(&[a, b, c]).unwrap();
                let (w, v) = rotated(rotation).quaternion();
                vec![-w, -v[0], -v[1], -v[2]]
            }
            Orientation::RotationVector => vec![a / 60.0, b / 60.0, c / 60.0],
            _ => vec![a, b, c],
        }
    }

    /// The turned numbers are the turned rotation, near the old numbers, also beyond half a turn and at a pole.
    #[test]
    fn turned_numbers_are_the_turned_rotation() {
        let twist = Twist::from_array(&[0.0, 0.0, 0.0, 3e-4, -5e-4, 2e-4]);
        let turn = Pose::exp(&twist).rotation;
        for orientation in ALL {
            for a in [-179.99, 0.0, 35.0, 180.0, 200.0] {
                for b in [-80.0, 0.0, 12.0, 89.0, 100.0] {
                    for c in [-180.0, 0.0, 120.0] {
                        let old = numbers(orientation, a, b, c);
                        let new = orientation.turned(&old, &turn).unwrap();
                        let wanted = orientation.rotation(&old).unwrap() * turn;
                        let found = orientation.rotation(&new).unwrap();
                        let off = (wanted - found).amax();
                        assert!(off < 1e-12, "{orientation:?} {a} {b} {c}: {off:e}");
                        let far = old.iter().zip(&new).map(|(a, b)| (a - b).abs());
                        let far = far.fold(0.0, f64::max);
                        assert!(far < 5.0, "{orientation:?} {old:?} {new:?}");
                        let again = orientation.rotation(&orientation.numbers(&wanted));
                        assert!((wanted - again.unwrap()).amax() < 1e-12, "{orientation:?}");
                        let same = orientation.turned(&old, &Matrix3::identity()).unwrap();
                        assert_eq!(same, old);
                    }
                }
            }
        }
    }
}
