//! Damped Newton steps towards a pose: what the solver of corrected joints is made of.
//!
//! Errors and Jacobians are hybrid: the displacement of the target's origin in metres and the rotation in radians, both
//! along the axes of the base, the rotation times a weight w. A step solves min |J d − e|² + λ |d|² by L D Lᵀ of a 6×6
//! matrix: JᵀJ + λI for up to six joints, J Jᵀ + λI for more, where the other one would be singular but for λ. Both
//! give the same step. No pivot is taken below λ, so that the steps of singular arms are finite.

use core::hint::black_box;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::deflection::{CouplingMatrix, PerJoint};
use crate::scalar::Scalar;
use crate::se3::{Pose, cross, dot, subtract, third_column};

/// Displacement in metres and rotation in radians times w.
pub type Hybrid<T> = [T; 6];

/// The hybrid Jacobian by columns, one for each of the controller's joints; beyond the last joint zeros.
pub type Columns<T> = [Hybrid<T>; MAX_JOINTS];

/// Joints up to which the normal equations are those of the joints.
const EQUATIONS: usize = 6;

/// How `pose` must be displaced and turned to be `target`, for angles of a few degrees.
#[inline(never)]
pub fn pose_error<T: Scalar>(target: &Pose<T>, pose: &Pose<T>, rotation_weight: T) -> Hybrid<T> {
    let moved = subtract(&target.translation, &pose.translation);
    // ½ Σ r_k × r′_k over the columns is the axis times sin θ; differences first, which do not cancel.
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
    let half = T::from_f64(0.5) * rotation_weight;
    [
        moved[0],
        moved[1],
        moved[2],
        half * turned[0],
        half * turned[1],
        half * turned[2],
    ]
}

/// |displacement|² and |rotation|².
#[inline(always)]
pub fn squares<T: Scalar>(hybrid: &Hybrid<T>) -> (T, T) {
    let v = |a: usize| Vector3::new(hybrid[a], hybrid[a + 1], hybrid[a + 2]);
    let (p, r) = (v(0), v(3));
    (dot(&p, &p), dot(&r, &r))
}

/// The equations of one place, factored: any number of errors can be taken away with them.
#[derive(Clone, Debug)]
pub struct Equations<T> {
    joints: usize,
    columns: Columns<T>,
    /// L below the diagonal; D, as reciprocals, on it.
    factors: [[T; EQUATIONS]; EQUATIONS],
    /// [`Equations::serial_levers`] where the columns are no longer those of the serial joints.
    serial_levers: Option<PerJoint<T>>,
}

/// Where equations are formed.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a, T> {
    /// Kinds of the serial joints.
    pub kinds: &'a [JointKind],
    /// Their frames after they moved.
    pub frames: &'a [Pose<T>],
    /// The target, in m, base frame.
    pub point: &'a Vector3<T>,
    /// C.
    pub coupling: Option<&'a CouplingMatrix<T>>,
}

impl<T: Scalar> Default for Equations<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> Equations<T> {
    /// Nothing yet.
    #[inline(always)]
    pub fn new() -> Self {
        Self {
            joints: 0,
            columns: [[T::ZERO; 6]; MAX_JOINTS],
            factors: [[T::ZERO; EQUATIONS]; EQUATIONS],
            serial_levers: None,
        }
    }

    /// Those of this place, with this λ.
    #[inline(never)]
    pub fn form(&mut self, at: &Place<'_, T>, rotation_weight: T, damping: T) {
        self.joints = at.kinds.len();
        for ((column, kind), frame) in self.columns.iter_mut().zip(at.kinds).zip(at.frames) {
            *column = column_of(*kind, frame, at.point, rotation_weight);
        }
        if let Some(coupling) = at.coupling {
            self.couple(coupling);
        }
        if self.joints > EQUATIONS {
            self.gram_of_rows();
        } else {
            self.gram_of_columns();
        }
        self.factor(damping);
    }

    /// Columns of the controller's joints from those of the serial ones: J C.
    #[inline(never)]
    fn couple(&mut self, coupling: &CouplingMatrix<T>) {
        // Of columns that are coupled parts may cancel, of second derivatives not.
        self.serial_levers = Some(self.levers());
        let mut out = [[T::ZERO; 6]; MAX_JOINTS];
        // Loops of which the compiler does not know the length: unrolled they are 1.3 kB.
        for (serial, weights) in self.columns.iter().zip(black_box(coupling)) {
            for (column, weight) in black_box(out.as_mut_slice()).iter_mut().zip(weights) {
                add_scaled(column, serial, *weight);
            }
        }
        self.columns = out;
    }

    fn gram_of_columns(&mut self) {
        for (i, (row, a)) in self.factors.iter_mut().zip(&self.columns).enumerate() {
            for (slot, b) in row.iter_mut().zip(&self.columns).take(i + 1) {
                *slot = inner(a, b);
            }
        }
    }

    #[inline(never)]
    fn gram_of_rows(&mut self) {
        self.factors = [[T::ZERO; EQUATIONS]; EQUATIONS];
        for column in self.columns.iter().take(self.joints) {
            // In slices of which the compiler does not know the length: unrolled it is a kilobyte.
            for (row, a) in black_box(self.factors.as_mut_slice())
                .iter_mut()
                .zip(column)
            {
                add_scaled(row, column, *a);
            }
        }
    }

    /// L D Lᵀ of the lower half of the Gram matrix + λ, in place.
    #[inline(always)]
    #[allow(unused_mut)] // of the first row
    fn factor(&mut self, damping: T) {
        let f = &mut self.factors;
        // Row i of L D first, then of L. Written out, for compilers leave triangular loops as they are.
        macro_rules! row {
            ($i:literal, $($j:literal: [$($k:literal)*])*) => {
                let mut row = f[$i];
                $($(row[$j] -= row[$k] * f[$j][$k];)*)*
                let mut pivot = row[$i] + damping;
                $(
                    let scaled = row[$j];
                    row[$j] = scaled * f[$j][$j];
                    pivot -= scaled * row[$j];
                )*
                // Also when it is NaN.
                row[$i] = T::ONE / if pivot > damping { pivot } else { damping };
                f[$i] = row;
            };
        }
        row!(0,);
        row!(1, 0: []);
        row!(2, 0: [] 1: [0]);
        row!(3, 0: [] 1: [0] 2: [0 1]);
        row!(4, 0: [] 1: [0] 2: [0 1] 3: [0 1 2]);
        row!(5, 0: [] 1: [0] 2: [0 1] 3: [0 1 2] 4: [0 1 2 3]);
    }

    /// The damped step that takes `error` away; zero beyond the last joint.
    #[inline(never)]
    pub fn step(&self, error: &Hybrid<T>) -> PerJoint<T> {
        let many = self.joints > EQUATIONS;
        let mut x = *error;
        if !many {
            for (slot, column) in x.iter_mut().zip(&self.columns) {
                *slot = inner(column, error);
            }
        }
        let f = &self.factors;
        let mut i = 1;
        while i < EQUATIONS {
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
            while j < EQUATIONS {
                x[i] -= f[j][i] * x[j];
                j += 1;
            }
        }
        let mut out = [T::ZERO; MAX_JOINTS];
        if many {
            for (slot, column) in out.iter_mut().zip(&self.columns) {
                *slot = inner(column, &x);
            }
        } else {
            for (slot, value) in out.iter_mut().zip(&x) {
                *slot = *value;
            }
        }
        out
    }

    /// J d: what the joint changes d do to first order.
    #[inline(never)]
    pub fn moved(&self, d: &PerJoint<T>) -> Hybrid<T> {
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

    /// The same of the serial joints.
    #[inline(always)]
    pub fn serial_levers(&self) -> PerJoint<T> {
        match self.serial_levers {
            Some(levers) => levers,
            None => self.levers(),
        }
    }

    /// How far a radian of each of the controller's joints moves the target, m.
    #[inline(never)]
    pub fn levers(&self) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        for (slot, column) in out.iter_mut().zip(&self.columns).take(self.joints) {
            *slot = squares(column).0.sqrt();
        }
        out
    }
}

/// What a serial joint does to the target.
#[inline(always)]
fn column_of<T: Scalar>(
    kind: JointKind,
    frame: &Pose<T>,
    point: &Vector3<T>,
    rotation_weight: T,
) -> Hybrid<T> {
    let axis = third_column(frame);
    match kind {
        JointKind::Revolute => {
            let v = cross(&axis, &subtract(point, &frame.translation));
            let w = rotation_weight;
            [v[0], v[1], v[2], w * axis[0], w * axis[1], w * axis[2]]
        }
        JointKind::Prismatic => [axis[0], axis[1], axis[2], T::ZERO, T::ZERO, T::ZERO],
    }
}

/// The most by which the second derivative of a chain moves its target, |f″[a, b]|, for small changes of the serial joints, in
/// metres.
///
/// The derivative by joints k ≤ l is z_k × (z_l × r_l), no longer than the lever of the outer one. So what the wrist does is
/// weighed by its short levers: Σ_kl |a_k| |b_l| lever_max(k,l).
#[inline(never)]
pub fn bent<T: Scalar>(levers: &PerJoint<T>, a: &PerJoint<T>, b: &PerJoint<T>) -> T {
    let (mut sum, mut inner_a, mut inner_b) = (T::ZERO, T::ZERO, T::ZERO);
    for (lever, (a, b)) in levers.iter().zip(a.iter().zip(b)) {
        let (a, b) = (a.abs(), b.abs());
        inner_a += a;
        sum += *lever * (b * inner_a + a * inner_b);
        inner_b += b;
    }
    sum
}

/// Half of [`bent`] by the same changes twice.
#[inline(never)]
pub fn half_bent<T: Scalar>(levers: &PerJoint<T>, changes: &PerJoint<T>) -> T {
    let (mut sum, mut inner) = (T::ZERO, T::ZERO);
    for (lever, change) in levers.iter().zip(changes) {
        let change = change.abs();
        sum += *lever * change * (inner + T::from_f64(0.5) * change);
        inner += change;
    }
    sum
}

/// a + s b.
#[inline(never)]
fn add_scaled<T: Scalar>(a: &mut Hybrid<T>, b: &Hybrid<T>, s: T) {
    for (value, part) in a.iter_mut().zip(b) {
        *value += *part * s;
    }
}

/// a − s b.
#[inline(always)]
pub fn less<T: Scalar>(a: &Hybrid<T>, s: T, b: &Hybrid<T>) -> Hybrid<T> {
    let mut out = *a;
    for (value, part) in out.iter_mut().zip(b) {
        *value -= s * *part;
    }
    out
}

/// aᵀb.
#[inline(always)]
fn inner<T: Scalar>(a: &Hybrid<T>, b: &Hybrid<T>) -> T {
    let mut sum = a[0] * b[0];
    let mut r = 1;
    while r < 6 {
        sum += a[r] * b[r];
        r += 1;
    }
    sum
}
