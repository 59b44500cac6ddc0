//! Rotations in the notations of measurement files: quaternions, Euler angles, rotation vectors, matrices.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::Pose;

use crate::import::column_map::{AngleUnit, EulerAxes, MatrixLayout, QuaternionOrder};
use crate::import::value::RowValues;
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::rotation::nearest_rotation;
use poegp_calibration::numeric::rotation::turn;
use poegp_calibration::robot::normal_form::rotation_about;

/// Largest deviation of a quaternion's norm from 1, or of a matrix from an orthonormal one;
/// [`poegp_calibration::measurement`] uses the same limit.
const TOLERANCE: f64 = 1e-3;

/// A rotation, and by how much the numbers in the file deviated from a rotation.
pub struct ReadOrientation {
    pub rotation: Matrix3<f64>,
    pub off: f64,
}

/// Column indices of an orientation, and its notation.
pub enum Reader {
    Quaternion([usize; 4], QuaternionOrder),
    Euler([usize; 3], [usize; 3], EulerAxes, AngleUnit),
    RotationVector([usize; 3], AngleUnit),
    Matrix([usize; 9], MatrixLayout),
}

impl Reader {
    /// Returns the indices of the columns that this reader reads.
    pub fn columns(&self) -> &[usize] {
        match self {
            Self::Quaternion(columns, _) => columns,
            Self::Euler(columns, ..) | Self::RotationVector(columns, _) => columns,
            Self::Matrix(columns, _) => columns,
        }
    }

    pub fn read(&self, fields: &RowValues<'_>) -> Result<ReadOrientation, InputError> {
        match self {
            Self::Quaternion(columns, order) => quaternion(fields, columns, *order),
            Self::Euler(columns, axes, how, unit) => {
                let mut rotation = Matrix3::identity();
                for (column, axis) in columns.iter().zip(axes) {
                    let turn = rotation_about(*axis, fields.radians(*column, *unit)?).rotation;
                    rotation = match how {
                        EulerAxes::Intrinsic => rotation * turn,
                        EulerAxes::Extrinsic => turn * rotation,
                    };
                }
                Ok(ReadOrientation { rotation, off: 0.0 })
            }
            Self::RotationVector(columns, unit) => {
                let mut angular = Vector3::zeros();
                for (x, column) in angular.iter_mut().zip(columns) {
                    *x = fields.radians(*column, *unit)?;
                }
                Ok(ReadOrientation {
                    rotation: turn(angular).rotation,
                    off: 0.0,
                })
            }
            Self::Matrix(columns, layout) => {
                let mut m = Matrix3::zeros();
                for (i, column) in columns.iter().enumerate() {
                    let location = match layout {
                        MatrixLayout::Rows => (i / 3, i % 3),
                        MatrixLayout::Columns => (i % 3, i / 3),
                    };
                    m[location] = fields.number(*column, "an element of a rotation matrix")?;
                }
                matrix(fields, columns[0], &m)
            }
        }
    }
}

/// Returns the axes of an order such as `zyx` as numbers from 0 to 2; `None` where it is no order of Euler angles.
pub fn axes(order: &str) -> Option<[usize; 3]> {
    let axis = |c: char| "xyz".find(c.to_ascii_lowercase());
    let axes: Vec<usize> = order.chars().map(axis).collect::<Option<_>>()?;
    let axes = <[usize; 3]>::try_from(axes).ok()?;
    (axes[0] != axes[1] && axes[1] != axes[2]).then_some(axes)
}

fn quaternion(
    fields: &RowValues<'_>,
    columns: &[usize; 4],
    order: QuaternionOrder,
) -> Result<ReadOrientation, InputError> {
    let mut numbers = [0.0; 4];
    for (x, column) in numbers.iter_mut().zip(columns) {
        *x = fields.number(*column, "a component of a quaternion")?;
    }
    let [w, x, y, z] = match order {
        QuaternionOrder::Wxyz => numbers,
        QuaternionOrder::Xyzw => [numbers[3], numbers[0], numbers[1], numbers[2]],
    };
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    let off = (norm - 1.0).abs();
    if off.is_nan() || off > TOLERANCE {
        let found = format!("a quaternion of norm {norm:.6}");
        return Err(fields
            .error(
                columns[0],
                found,
                format!("a unit quaternion (norm within {TOLERANCE} of 1)"),
            )
            .with_help("are these the four columns of one quaternion?"));
    }
    let pose = Pose::from_quaternion(w, &Vector3::new(x, y, z), Vector3::zeros());
    Ok(ReadOrientation {
        rotation: pose.rotation,
        off,
    })
}

/// Returns the rotation nearest to a matrix of a file. `column` is the first column of the matrix, for messages.
pub fn matrix(
    fields: &RowValues<'_>,
    column: usize,
    m: &Matrix3<f64>,
) -> Result<ReadOrientation, InputError> {
    let off = (m * m.transpose() - Matrix3::identity()).amax();
    if off.is_nan() || off > TOLERANCE || m.determinant() < 0.0 {
        let found = match m.determinant() < 0.0 && off <= TOLERANCE {
            true => "a reflection (determinant −1)".to_owned(),
            false => format!("a matrix whose rows deviate from orthonormal by {off:.1e}"),
        };
        return Err(fields
            .error(
                column,
                found,
                format!("a rotation matrix, orthonormal within {TOLERANCE}"),
            )
            .with_help(
                "are the columns in the order of the map (layout = \"rows\" or \"columns\")?",
            ));
    }
    Ok(ReadOrientation {
        rotation: nearest_rotation(m),
        off,
    })
}

#[cfg(test)]
mod tests {
    use super::axes;

    #[test]
    fn there_are_twelve_orders() {
        let letters = ["x", "Y", "z"];
        let mut count = 0;
        for a in letters {
            for b in letters {
                for c in letters {
                    count += usize::from(axes(&format!("{a}{b}{c}")).is_some());
                }
            }
        }
        assert_eq!(count, 12);
        assert_eq!(axes("ZYX"), Some([2, 1, 0]));
        for wrong in ["", "XY", "XXY", "XYZX", "ABC"] {
            assert_eq!(axes(wrong), None, "{wrong}");
        }
    }
}
