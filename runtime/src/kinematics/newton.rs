//! Damped Newton steps towards a pose, for corrected joints and for the inverse.
//!
//! Errors e and Jacobians J have the displacement of the target's origin in metres first, then its rotation in radians,
//! both along the axes of the base. A step is d = Jᵀ (J Jᵀ + Λ)⁻¹ e with Λ = diag(λ_p, λ_p, λ_p, λ_r, λ_r, λ_r), which
//! minimises |d|² + |e_p − J_p d|²/λ_p + |e_r − J_r d|²/λ_r. This form suits arms with any number of joints, and in it
//! position and rotation can be given up separately ([`crate::correct::step_limit`]). For the inverse, the 6×6 matrix is
//! factored as L D Lᵀ. No pivot is taken below its damping, so that the steps of singular arms are finite.

use core::hint::black_box;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::kinematics::coupling::{Coupling, PerJoint};
use crate::math::scalar::Scalar;
use crate::math::se3::{Pose, cross, dot, subtract, third_column};

/// A pose error: displacement in m, then rotation in rad.
pub type PoseError6<T> = [T; 6];

/// The Jacobian by columns, one for each of the controller's joints; zeros beyond the last joint.
pub type Jacobian<T> = [PoseError6<T>; MAX_JOINTS];

/// A symmetric 6×6 matrix over displacement and rotation, such as J Jᵀ.
pub type Gram<T> = [PoseError6<T>; 6];

/// Computes the displacement and the rotation that take `pose` to `target`, for angles of a few degrees.
#[inline(never)]
pub fn pose_error<T: Scalar>(target: &Pose<T>, pose: &Pose<T>) -> PoseError6<T> {
    let moved = subtract(&target.translation, &pose.translation);
    // ½ Σ r_k × r′_k over the columns is the axis times sin θ. The differences r′_k − r_k come first, so that nothing
    // cancels.
    let (from, to) = (&pose.rotation, &target.rotation);
    let mut turned = [T::ZERO; 3];
    for k in 0..3 {
        let r = Vector3::new(from[(0, k)], from[(1, k)], from[(2, k)]);
        let difference = Vector3::new(to[(0, k)] - r[0], to[(1, k)] - r[1], to[(2, k)] - r[2]);
        let part = cross(&r, &difference);
        turned[0] += part[0];
        turned[1] += part[1];
        turned[2] += part[2];
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

/// Returns |displacement|² and |rotation|².
#[inline(always)]
pub fn squared_norms<T: Scalar>(hybrid: &PoseError6<T>) -> (T, T) {
    let v = |a: usize| Vector3::new(hybrid[a], hybrid[a + 1], hybrid[a + 2]);
    let (p, r) = (v(0), v(3));
    (dot(&p, &p), dot(&r, &r))
}

/// The Jacobian J at one configuration, and J Jᵀ, which [`NormalEquations::factor`] replaces with its factors.
#[derive(Clone, Debug)]
pub struct NormalEquations<T> {
    joints: usize,
    columns: Jacobian<T>,
    /// J Jᵀ; once factored, L below the diagonal and the reciprocals of D on it.
    gram: Gram<T>,
}

/// The configuration at which normal equations are formed.
#[derive(Clone, Copy, Debug)]
pub struct LinearizationPoint<'a, T> {
    /// Kinds of the serial joints.
    pub kinds: &'a [JointKind],
    /// Frames of the serial joints after they moved.
    pub frames: &'a [Pose<T>],
    /// Position of the target, in m, base frame.
    pub point: &'a Vector3<T>,
    /// Joint coupling C.
    pub coupling: Option<&'a Coupling<T>>,
}

/// Damping of displacements and of rotations, λ_p and λ_r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping<T> {
    /// λ_p, the damping of displacements.
    pub position: T,
    /// λ_r, the damping of rotations.
    pub rotation: T,
}

impl<T: Scalar> Default for NormalEquations<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> NormalEquations<T> {
    /// Returns equations of zeros; [`NormalEquations::form`] fills them.
    #[inline(always)]
    pub fn new() -> Self {
        Self {
            joints: 0,
            columns: [[T::ZERO; 6]; MAX_JOINTS],
            gram: [[T::ZERO; 6]; 6],
        }
    }

    /// Computes J and J Jᵀ at this configuration.
    #[inline(never)]
    pub fn form(&mut self, at: &LinearizationPoint<'_, T>) {
        self.joints = at.kinds.len();
        for ((column, kind), frame) in self.columns.iter_mut().zip(at.kinds).zip(at.frames) {
            *column = column_of(*kind, frame, at.point);
        }
        if let Some(coupling) = at.coupling {
            self.couple(coupling);
        }
        // The columns beyond the last joint are zero.
        if self.joints > 6 {
            self.multiply::<MAX_JOINTS>();
        } else {
            self.multiply::<6>();
        }
    }

    /// Replaces the Jacobian J of the serial joints with that of the controller's joints, J C.
    #[inline(never)]
    fn couple(&mut self, coupling: &Coupling<T>) {
        let serial_columns = self.columns;
        for (serial, joint, weight) in coupling.terms() {
            if let (Some(column), Some(part)) =
                (self.columns.get_mut(joint), serial_columns.get(serial))
            {
                add_scaled(column, part, weight);
            }
        }
    }

    /// Computes J Jᵀ from the first N columns.
    // Column by column, so that all sums stay in registers and each number is read once.
    #[inline(always)]
    fn multiply<const N: usize>(&mut self) {
        macro_rules! entries {
            ($($sum:ident: $i:literal $j:literal,)*) => {
                let column = &self.columns[0];
                $(let mut $sum = column[$i] * column[$j];)*
                for column in black_box(&self.columns).iter().take(N).skip(1) {
                    $($sum += column[$i] * column[$j];)*
                }
                $(
                    self.gram[$i][$j] = $sum;
                    self.gram[$j][$i] = $sum;
                )*
            };
        }
        entries!(
            a00: 0 0,
            a10: 1 0, a11: 1 1,
            a20: 2 0, a21: 2 1, a22: 2 2,
            a30: 3 0, a31: 3 1, a32: 3 2, a33: 3 3,
            a40: 4 0, a41: 4 1, a42: 4 2, a43: 4 3, a44: 4 4,
            a50: 5 0, a51: 5 1, a52: 5 2, a53: 5 3, a54: 5 4, a55: 5 5,
        );
    }

    /// Returns J by columns; zeros beyond the last joint.
    pub fn columns(&self) -> &Jacobian<T> {
        &self.columns
    }

    /// Returns J Jᵀ, before it is factored.
    #[inline(always)]
    pub fn gram(&self) -> &Gram<T> {
        &self.gram
    }

    /// Factors J Jᵀ + Λ as L D Lᵀ, in place.
    #[inline(never)]
    #[allow(unused_mut)] // of the first row
    pub fn factor(&mut self, damping: &Damping<T>) {
        let f = &mut self.gram;
        let Damping { position, rotation } = *damping;
        // First row i of L D, then row i of L. Written out, because compilers do not unroll triangular loops.
        macro_rules! row {
            ($damping:ident, $i:literal, $($j:literal: [$($k:literal)*])*) => {
                let mut row = f[$i];
                $($(row[$j] -= row[$k] * f[$j][$k];)*)*
                let mut pivot = row[$i] + $damping;
                $(
                    let scaled = row[$j];
                    row[$j] = scaled * f[$j][$j];
                    pivot -= scaled * row[$j];
                )*
                // The damping also if the pivot is NaN.
                row[$i] = T::ONE / if pivot > $damping { pivot } else { $damping };
                f[$i] = row;
            };
        }
        row!(position, 0,);
        row!(position, 1, 0: []);
        row!(position, 2, 0: [] 1: [0]);
        row!(rotation, 3, 0: [] 1: [0] 2: [0 1]);
        row!(rotation, 4, 0: [] 1: [0] 2: [0 1] 3: [0 1 2]);
        row!(rotation, 5, 0: [] 1: [0] 2: [0 1] 3: [0 1 2] 4: [0 1 2 3]);
    }

    /// Computes (J Jᵀ + Λ)⁻¹ e, once [`NormalEquations::factor`] was called.
    #[inline(never)]
    pub fn solve(&self, error: &PoseError6<T>) -> PoseError6<T> {
        let mut x = *error;
        let f = &self.gram;
        let mut i = 1;
        while i < 6 {
            let mut j = 0;
            while j < i {
                x[i] -= f[i][j] * x[j];
                j += 1;
            }
            i += 1;
        }
        while i > 0 {
            i -= 1;
            x[i] = x[i] * f[i][i];
            let mut j = i + 1;
            while j < 6 {
                x[i] -= f[j][i] * x[j];
                j += 1;
            }
        }
        x
    }

    /// Computes Jᵀ x, the joint changes that belong to x; zero beyond the last joint.
    pub fn joints_of(&self, x: &PoseError6<T>) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        for (slot, column) in out.iter_mut().zip(&self.columns).take(self.joints) {
            *slot = inner(column, x);
        }
        out
    }

    /// Computes J d, the displacement and rotation of the target by the joint changes d, to first order.
    pub fn moved(&self, d: &PerJoint<T>) -> PoseError6<T> {
        let mut moved = [T::ZERO; 6];
        for (column, delta) in self.columns.iter().zip(d).take(self.joints) {
            let mut r = 0;
            while r < 6 {
                moved[r] += column[r] * *delta;
                r += 1;
            }
        }
        moved
    }
}

/// Returns the column of the Jacobian that belongs to a serial joint.
#[inline(always)]
fn column_of<T: Scalar>(kind: JointKind, frame: &Pose<T>, point: &Vector3<T>) -> PoseError6<T> {
    let axis = third_column(frame);
    match kind {
        JointKind::Revolute => {
            let v = cross(&axis, &subtract(point, &frame.translation));
            [v[0], v[1], v[2], axis[0], axis[1], axis[2]]
        }
        JointKind::Prismatic => [axis[0], axis[1], axis[2], T::ZERO, T::ZERO, T::ZERO],
    }
}

/// Adds s b to a.
#[inline(always)]
fn add_scaled<T: Scalar>(a: &mut PoseError6<T>, b: &PoseError6<T>, s: T) {
    for (value, part) in a.iter_mut().zip(b) {
        *value += *part * s;
    }
}

/// Returns a − s b.
#[inline(always)]
pub fn subtract_scaled<T: Scalar>(a: &PoseError6<T>, s: T, b: &PoseError6<T>) -> PoseError6<T> {
    let mut out = *a;
    for (value, part) in out.iter_mut().zip(b) {
        *value -= s * *part;
    }
    out
}

/// Returns aᵀb.
#[inline(always)]
fn inner<T: Scalar>(a: &PoseError6<T>, b: &PoseError6<T>) -> T {
    let mut sum = a[0] * b[0];
    let mut r = 1;
    while r < 6 {
        sum += a[r] * b[r];
        r += 1;
    }
    sum
}
