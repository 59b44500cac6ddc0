//! One damped Newton step towards a pose: what the solver of corrected joints is made of.
//!
//! Errors and Jacobians are hybrid: the displacement of the target's origin in metres and the rotation in radians, both
//! along the axes of the base. A step solves min |W (J d − e)|² + λ |d|², W = diag(1, 1, 1, w, w, w), by the factors
//! L D Lᵀ of a 6×6 matrix: of JᵀW²J + λI for up to six joints, of W J JᵀW + λI for more, where the other one would be
//! singular but for λ. Both are the same step. No pivot is taken below λ, so that singular arms give finite steps.

use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::deflection::{CouplingMatrix, PerJoint};
use crate::scalar::Scalar;
use crate::se3::{Pose, cross, dot, subtract};

/// Rows of the hybrid Jacobian: three of the position (m per rad or m), three of the rotation; columns are joints.
pub type Rows<T> = [PerJoint<T>; 6];

/// Joints up to which the normal equations are those of the joints.
const EQUATIONS: usize = 6;

/// How `pose` must be displaced (m) and turned (rad) to be `target`, for angles of a few degrees.
#[inline(always)]
pub fn pose_error<T: Scalar>(target: &Pose<T>, pose: &Pose<T>) -> [T; 6] {
    let moved = subtract(&target.translation, &pose.translation);
    // ½ Σ r_k × r′_k over the columns is the axis times sin θ; differences first, which do not cancel.
    let mut turned = [T::ZERO; 3];
    for k in 0..3 {
        let from = pose.rotation.column(k).into_owned();
        let to = target.rotation.column(k).into_owned();
        let part = cross(&from, &subtract(&to, &from));
        for (sum, value) in turned.iter_mut().zip(part.iter()) {
            *sum += *value;
        }
    }
    let half = T::from_f64(0.5);
    [
        moved[0],
        moved[1],
        moved[2],
        half * turned[0],
        half * turned[1],
        half * turned[2],
    ]
}

/// The hybrid Jacobian at `point` (m, base frame) by the controller's joints, from the frames of the serial joints;
/// columns beyond the last joint stay as they are.
#[inline(never)]
pub fn jacobian<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Pose<T>; MAX_JOINTS],
    point: &nalgebra::Vector3<T>,
    coupling: Option<&CouplingMatrix<T>>,
    out: &mut Rows<T>,
) {
    for (i, (kind, frame)) in kinds.iter().zip(frames).enumerate() {
        let axis = frame.rotation.column(2).into_owned();
        let arm = subtract(point, &frame.translation);
        let turning = cross(&axis, &arm);
        let column = match kind {
            JointKind::Revolute => [
                turning[0], turning[1], turning[2], axis[0], axis[1], axis[2],
            ],
            JointKind::Prismatic => [axis[0], axis[1], axis[2], T::ZERO, T::ZERO, T::ZERO],
        };
        for (row, value) in out.iter_mut().zip(column) {
            // i < MAX_JOINTS; the remainder says so to the compiler.
            row[i % MAX_JOINTS] = value;
        }
    }
    if let Some(coupling) = coupling {
        for row in out {
            let serial = *row;
            *row = [T::ZERO; MAX_JOINTS];
            for (value, weights) in serial.iter().zip(coupling) {
                for (sum, weight) in row.iter_mut().zip(weights) {
                    *sum += *value * *weight;
                }
            }
        }
    }
}

/// J d: displacement and rotation to first order.
#[inline(never)]
pub fn displaced<T: Scalar>(rows: &Rows<T>, d: &PerJoint<T>) -> [T; 6] {
    let mut out = [T::ZERO; 6];
    for (sum, row) in out.iter_mut().zip(rows) {
        *sum = crate::kernel::inner_product(row, d);
    }
    out
}

/// |position|² and |rotation|² of an error.
#[inline(always)]
pub fn squares<T: Scalar>(error: &[T; 6]) -> (T, T) {
    let v = |a: usize| nalgebra::Vector3::new(error[a], error[a + 1], error[a + 2]);
    let (p, r) = (v(0), v(3));
    (dot(&p, &p), dot(&r, &r))
}

/// The damped normal equations at one place, factored: any number of errors can be taken away with them.
#[derive(Clone, Copy, Debug)]
pub struct Normal<T> {
    joints: usize,
    rotation_weight: T,
    /// L below the diagonal.
    lower: [[T; EQUATIONS]; EQUATIONS],
    /// Reciprocals of D.
    reciprocal: [T; EQUATIONS],
}

impl<T: Scalar> Normal<T> {
    /// Nothing factored yet, for an arm of so many joints and this w.
    pub fn new(joints: usize, rotation_weight: T) -> Self {
        Self {
            joints,
            rotation_weight,
            lower: [[T::ZERO; EQUATIONS]; EQUATIONS],
            reciprocal: [T::ZERO; EQUATIONS],
        }
    }

    #[inline(always)]
    fn weight(&self, row: usize) -> T {
        if row < 3 {
            T::ONE
        } else {
            self.rotation_weight
        }
    }

    /// Factors the equations of this Jacobian with this λ.
    #[inline(never)]
    pub fn factor(&mut self, rows: &Rows<T>, damping: T) {
        let mut gram = [[T::ZERO; EQUATIONS]; EQUATIONS];
        let many = self.joints > EQUATIONS;
        let terms = if many { self.joints } else { 6 };
        for term in 0..terms {
            let mut v = [T::ZERO; EQUATIONS];
            if many {
                for (r, (value, row)) in v.iter_mut().zip(rows).enumerate() {
                    *value = row[term % MAX_JOINTS] * self.weight(r);
                }
            } else {
                for (value, element) in v.iter_mut().zip(&rows[term % 6]) {
                    *value = *element * self.weight(term);
                }
            }
            let mut i = 0;
            while i < EQUATIONS {
                let mut j = 0;
                while j <= i {
                    gram[i][j] += v[i] * v[j];
                    j += 1;
                }
                i += 1;
            }
        }
        let mut i = 0;
        while i < EQUATIONS {
            // Row i of L D first, then of L.
            let mut j = 0;
            while j < i {
                let mut k = 0;
                while k < j {
                    gram[i][j] -= gram[i][k] * gram[j][k];
                    k += 1;
                }
                j += 1;
            }
            let mut pivot = gram[i][i] + damping;
            j = 0;
            while j < i {
                let scaled = gram[i][j];
                gram[i][j] = scaled * self.reciprocal[j];
                pivot -= scaled * gram[i][j];
                j += 1;
            }
            // Also when it is NaN.
            self.reciprocal[i] = T::ONE / if pivot > damping { pivot } else { damping };
            i += 1;
        }
        self.lower = gram;
    }

    /// The step that takes `error` away; zero beyond the last joint.
    #[inline(never)]
    pub fn step(&self, rows: &Rows<T>, error: &[T; 6]) -> PerJoint<T> {
        let many = self.joints > EQUATIONS;
        let mut right = [T::ZERO; EQUATIONS];
        for (r, (row, e)) in rows.iter().zip(error).enumerate() {
            let w = self.weight(r);
            if many {
                right[r % EQUATIONS] = *e * w;
            } else {
                let e = *e * w * w;
                for (sum, element) in right.iter_mut().zip(row) {
                    *sum += *element * e;
                }
            }
        }
        let mut i = 0;
        while i < EQUATIONS {
            let mut j = 0;
            while j < i {
                right[i] -= self.lower[i][j] * right[j];
                j += 1;
            }
            i += 1;
        }
        while i > 0 {
            i -= 1;
            right[i] = right[i] * self.reciprocal[i];
            let mut j = i + 1;
            while j < EQUATIONS {
                right[i] -= self.lower[j][i] * right[j];
                j += 1;
            }
        }
        let mut out = [T::ZERO; MAX_JOINTS];
        if many {
            for (r, (row, z)) in rows.iter().zip(&right).enumerate() {
                let z = *z * self.weight(r);
                for (sum, element) in out.iter_mut().zip(row).take(self.joints) {
                    *sum += *element * z;
                }
            }
        } else {
            for (slot, z) in out.iter_mut().zip(&right) {
                *slot = *z;
            }
        }
        out
    }
}
