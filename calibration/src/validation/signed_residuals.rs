//! Residuals with their signs: along and about the axes of the base, and as the error of each joint that would explain them.
//!
//! A residual is the measured minus the predicted pose. Least squares projects it on joint j through the joint's column J_j
//! of the Jacobian at that pose, δ = J_jᵀ W r / (J_jᵀ W J_j): the error of that joint alone that explains most of the
//! residual.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Twist;
use serde::Serialize;

use crate::robot::{Robot, coupled};
use crate::validation::held_out::HeldOutPose;

/// Mean and standard deviation of signed values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Signed {
    /// The mean.
    pub mean: f64,
    /// Standard deviation of single values about the mean.
    pub std: f64,
}

impl Signed {
    /// Computes the mean and the standard deviation of pairs of a value and its weight.
    fn new(values: &[(f64, f64)]) -> Self {
        let sum: f64 = values.iter().map(|(_, w)| w).sum();
        if sum <= 0.0 {
            return Self::default();
        }
        let mean = values.iter().map(|(x, w)| w * x).sum::<f64>() / sum;
        let square = values
            .iter()
            .map(|(x, w)| w * (x - mean).powi(2))
            .sum::<f64>()
            / sum;
        Self {
            mean,
            std: square.sqrt(),
        }
    }
}

/// Signed residuals of one model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SignedResiduals {
    /// Residuals along x, y and z of the base, mm.
    pub axes_mm: [Signed; 3],
    /// Residuals about x, y and z of the base, mrad; absent if only positions were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes_mrad: Option<[Signed; 3]>,
    /// Errors of the controller's joints that explain most of the residuals, mrad; mm for a prismatic joint. Each pose is
    /// weighted by how much the joint moves the target there.
    pub joints: Vec<Signed>,
}

/// Joints of the controller (rad or m), with the held-out pose at these joints.
pub type Row<'a> = (&'a [f64], &'a HeldOutPose);

/// Returns, for each joint, how it moves the target at a row: the Jacobian columns in the components of
/// [`HeldOutPose::residual`].
pub fn jacobian(robot: &Robot, chain: &Poe<f64>, (joints, pose): &Row) -> Vec<[f64; 6]> {
    let (columns, _) = chain.space_jacobian(&robot.serial_joints(joints));
    let n = robot.joints.len();
    let point = Vector3::from(pose.position);
    let column = |joint: usize| {
        let mut unit = vec![0.0; n];
        unit[joint] = 1.0;
        let shares = coupled(robot.coupling.as_deref(), &unit);
        let mut out = [0.0; 6];
        for (column, share) in columns.iter().zip(&shares) {
            let twist: Twist<f64> = column.at_point(&point);
            for (out, value) in out.iter_mut().zip(twist.to_array()) {
                *out += share * value;
            }
        }
        out
    };
    (0..n).map(column).collect()
}

/// Returns the error of one joint, rad or m, that explains most of a residual, and its weight.
pub fn projected(column: &[f64; 6], residual: &[f64; 6], weights: &[f64; 6]) -> (f64, f64) {
    let product =
        |a: &[f64; 6], b: &[f64; 6]| -> f64 { (0..6).map(|i| weights[i] * a[i] * b[i]).sum() };
    let weight = product(column, column);
    (
        product(column, residual) / weight.max(f64::MIN_POSITIVE),
        weight,
    )
}

/// Returns the weights of positions and orientations: the inverse of the mean square of each in these residuals.
/// Orientations that were not measured have weight zero.
pub fn weights(rows: &[Row]) -> [f64; 6] {
    let weight = |axes: std::ops::Range<usize>| {
        let values = rows.iter().flat_map(|(_, pose)| {
            axes.clone()
                .filter(|axis| *axis < pose.components())
                .map(|axis| pose.residual[axis])
        });
        let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x * x, count + 1));
        if sum > 0.0 {
            f64::from(count) / sum
        } else {
            0.0
        }
    };
    let (position, rotation) = (weight(0..3), weight(3..6));
    [position, position, position, rotation, rotation, rotation]
}

impl SignedResiduals {
    /// Computes the signed residuals of `rows`, with `weights` for positions and orientations and the Jacobian of `chain`.
    pub fn new(robot: &Robot, chain: &Poe<f64>, rows: &[Row], weights: &[f64; 6]) -> Self {
        let axis = |axis: usize| {
            let measured = rows.iter().filter(|(_, pose)| axis < pose.components());
            let values: Vec<(f64, f64)> = measured
                .map(|(_, pose)| (1e3 * pose.residual[axis], 1.0))
                .collect();
            Signed::new(&values)
        };
        let is_turned = rows.iter().any(|(_, pose)| pose.components() > 3);
        let mut of_joints: Vec<Vec<(f64, f64)>> = vec![Vec::new(); robot.joints.len()];
        for row in rows {
            let mut own = *weights;
            own[row.1.components()..].fill(0.0);
            for (values, column) in of_joints.iter_mut().zip(jacobian(robot, chain, row)) {
                let (error, weight) = projected(&column, &row.1.residual, &own);
                values.push((1e3 * error, weight));
            }
        }
        Self {
            axes_mm: [0, 1, 2].map(axis),
            axes_mrad: is_turned.then(|| [3, 4, 5].map(axis)),
            joints: of_joints.iter().map(|values| Signed::new(values)).collect(),
        }
    }
}
