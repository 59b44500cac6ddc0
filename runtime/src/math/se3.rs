//! SO(3) and SE(3): exponential, logarithm, adjoint and left Jacobian, in the order (v, ω).
//!
//! A [`Pose`] named `target_from_source` maps coordinates in `source` to coordinates in `target`, so that neighbours
//! cancel: `a_from_c = a_from_b * b_from_c`. A [`Twist`] has the linear part first; Modern Robotics and GTSAM write
//! (ω, v): swap the blocks when taking a formula from these. All coefficients of the maps are functions of θ²: a power
//! series up to θ² = 4, where its error is below half an ulp, and the closed form beyond. (In `f32` the closed form of
//! (θ − sin θ)/θ³ is 30 % wrong at 1e-3 rad.)

use core::ops::Mul;

use nalgebra::{Matrix3, Vector3};

use crate::math::scalar::Scalar;

/// A rigid transform: a rotation and a translation in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T> {
    /// Rotation matrix, 3×3, orthonormal.
    pub rotation: Matrix3<T>,
    /// Translation in metres.
    pub translation: Vector3<T>,
}

/// An element of se(3): (v, ω), metres and radians (or their rates).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist<T> {
    /// Linear part v.
    pub linear: Vector3<T>,
    /// Angular part ω.
    pub angular: Vector3<T>,
}

/// A 6×6 matrix in 3×3 blocks that acts on twists (v, ω): `[[upper_left, upper_right], [lower_left, lower_right]]`.
pub type Matrix6<T> = [[T; 6]; 6];

/// Returns the z axis of a frame, which is the axis of the frame's joint.
#[inline(always)]
pub fn third_column<T: Scalar>(frame: &Pose<T>) -> Vector3<T> {
    let r = &frame.rotation;
    Vector3::new(r[(0, 2)], r[(1, 2)], r[(2, 2)])
}

/// Returns a × b.
#[inline(always)]
pub fn cross<T: Scalar>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
}

/// Returns a · b, summed from the first component.
#[inline(always)]
pub fn dot<T: Scalar>(a: &Vector3<T>, b: &Vector3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns a + b.
#[inline(always)]
pub fn add<T: Scalar>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(a[0] + b[0], a[1] + b[1], a[2] + b[2])
}

/// Returns a − b.
#[inline(always)]
pub fn subtract<T: Scalar>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(a[0] - b[0], a[1] - b[1], a[2] - b[2])
}

/// Returns s·a.
#[inline(always)]
pub fn scale<T: Scalar>(s: T, a: &Vector3<T>) -> Vector3<T> {
    Vector3::new(s * a[0], s * a[1], s * a[2])
}

/// Returns R·v.
#[inline(always)]
pub fn rotate<T: Scalar>(r: &Matrix3<T>, v: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        r[(0, 0)] * v[0] + r[(0, 1)] * v[1] + r[(0, 2)] * v[2],
        r[(1, 0)] * v[0] + r[(1, 1)] * v[1] + r[(1, 2)] * v[2],
        r[(2, 0)] * v[0] + r[(2, 1)] * v[1] + r[(2, 2)] * v[2],
    )
}

/// Returns A·B, each element summed from the first term.
#[inline(always)]
pub fn product<T: Scalar>(a: &Matrix3<T>, b: &Matrix3<T>) -> Matrix3<T> {
    let element =
        |i: usize, j: usize| a[(i, 0)] * b[(0, j)] + a[(i, 1)] * b[(1, j)] + a[(i, 2)] * b[(2, j)];
    Matrix3::new(
        element(0, 0),
        element(0, 1),
        element(0, 2),
        element(1, 0),
        element(1, 1),
        element(1, 2),
        element(2, 0),
        element(2, 1),
        element(2, 2),
    )
}

/// Returns the skew-symmetric matrix `[a]` with `[a] b` = a × b.
#[inline(always)]
pub fn skew<T: Scalar>(a: &Vector3<T>) -> Matrix3<T> {
    let o = T::ZERO;
    Matrix3::new(o, -a[2], a[1], a[2], o, -a[0], -a[1], a[0], o)
}

/// Computes Σ_k (−1)^k numerator(k) z^k / (2k + offset)! with [`Scalar::SERIES_TERMS`] terms: every coefficient of the maps
/// has this form.
///
/// Horner's scheme on the ratios of neighbouring terms; `numerator` is small and exact.
#[inline(always)]
fn alternating_series<T: Scalar>(z: T, offset: usize, numerator: impl Fn(usize) -> f64) -> T {
    let mut sum = T::ZERO;
    let mut k = T::SERIES_TERMS;
    while k > 0 {
        k -= 1;
        let next = ((2 * k + offset + 1) * (2 * k + offset + 2)) as f64;
        sum = T::from_f64(numerator(k)) - sum * z * T::from_f64(1.0 / next);
    }
    let mut first = 1.0;
    let mut factor = 2;
    while factor <= offset {
        first *= factor as f64;
        factor += 1;
    }
    sum * T::from_f64(1.0 / first)
}

/// The coefficients of the exponential as functions of θ²: sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³.
#[derive(Clone, Copy, Debug)]
pub struct Coefficients<T> {
    /// sin θ / θ.
    pub a: T,
    /// (1 − cos θ) / θ².
    pub b: T,
    /// (θ − sin θ) / θ³.
    pub c: T,
}

impl<T: Scalar> Coefficients<T> {
    /// Computes the coefficients by the power series, for θ² ≤ 4 and without a branch. The controller's cycle, where θ is
    /// bounded, uses it.
    #[inline(always)]
    pub fn series(theta_squared: T) -> Self {
        let one = |_| 1.0;
        Self {
            a: alternating_series(theta_squared, 1, one),
            b: alternating_series(theta_squared, 2, one),
            c: alternating_series(theta_squared, 3, one),
        }
    }

    /// Computes the coefficients for any θ² ≥ 0.
    pub fn new(theta_squared: T) -> Self {
        if theta_squared <= T::from_f64(4.0) {
            return Self::series(theta_squared);
        }
        let theta = theta_squared.sqrt();
        let (sin, _) = theta.sin_cos();
        let (sin_half, _) = (theta * T::from_f64(0.5)).sin_cos();
        let a = sin / theta;
        Self {
            a,
            b: T::from_f64(2.0) * sin_half * sin_half / theta_squared,
            c: (T::ONE - a) / theta_squared,
        }
    }
}

/// Returns I + p[ω] + q[ω]², the form that the rotation, the left Jacobian and its inverse all have.
#[inline(always)]
fn polynomial_of_skew<T: Scalar>(omega: &Vector3<T>, p: T, q: T) -> Matrix3<T> {
    let (x, y, z) = (omega[0], omega[1], omega[2]);
    let (xx, yy, zz) = (q * x * x, q * y * y, q * z * z);
    let (xy, xz, yz) = (q * x * y, q * x * z, q * y * z);
    let (px, py, pz) = (p * x, p * y, p * z);
    Matrix3::new(
        T::ONE - (yy + zz),
        xy - pz,
        xz + py,
        xy + pz,
        T::ONE - (xx + zz),
        yz - px,
        xz - py,
        yz + px,
        T::ONE - (xx + yy),
    )
}

impl<T: Scalar> Pose<T> {
    /// Returns the identity.
    pub fn identity() -> Self {
        let (i, o) = (T::ONE, T::ZERO);
        Self {
            rotation: Matrix3::new(i, o, o, o, i, o, o, o, i),
            translation: Vector3::new(o, o, o),
        }
    }

    /// Computes Exp: se(3) → SE(3), e^{ξ̂} of the paper.
    pub fn exp(twist: &Twist<T>) -> Self {
        let omega = &twist.angular;
        let k = Coefficients::new(dot(omega, omega));
        Self {
            rotation: polynomial_of_skew(omega, k.a, k.b),
            translation: rotate(&polynomial_of_skew(omega, k.b, k.c), &twist.linear),
        }
    }

    /// Computes Log: SE(3) → se(3), the inverse of [`Pose::exp`] for angles up to π, `log(T)^V` of the paper.
    ///
    /// It goes through the unit quaternion, computed from its largest component, and so is accurate at 0 and at π.
    pub fn log(&self) -> Twist<T> {
        let (w, v) = self.quaternion();
        let sine = dot(&v, &v).sqrt();
        // θ = 2 atan2(|v|, w); the ratio θ/|v| tends to 2/w as |v| → 0.
        let ratio = if sine > T::from_f64(1e-30) {
            T::from_f64(2.0) * sine.atan2(w) / sine
        } else {
            T::from_f64(2.0) / w
        };
        let angular = scale(ratio, &v);
        Twist {
            linear: rotate(&inverse_left_jacobian_so3(&angular), &self.translation),
            angular,
        }
    }

    /// Returns the unit quaternion (w, (x, y, z)) of the rotation, w ≥ 0.
    pub fn quaternion(&self) -> (T, Vector3<T>) {
        let r = &self.rotation;
        let one = T::ONE;
        // Four times the squared components; the largest is at least one.
        let w = one + r[(0, 0)] + r[(1, 1)] + r[(2, 2)];
        let x = one + r[(0, 0)] - r[(1, 1)] - r[(2, 2)];
        let y = one - r[(0, 0)] + r[(1, 1)] - r[(2, 2)];
        let z = one - r[(0, 0)] - r[(1, 1)] + r[(2, 2)];
        let (a, b, c) = (
            r[(2, 1)] - r[(1, 2)],
            r[(0, 2)] - r[(2, 0)],
            r[(1, 0)] - r[(0, 1)],
        );
        let (xy, xz, yz) = (
            r[(0, 1)] + r[(1, 0)],
            r[(0, 2)] + r[(2, 0)],
            r[(1, 2)] + r[(2, 1)],
        );
        let (w, v) = if w >= x && w >= y && w >= z {
            (w, Vector3::new(a, b, c))
        } else if x >= y && x >= z {
            (a, Vector3::new(x, xy, xz))
        } else if y >= z {
            (b, Vector3::new(xy, y, yz))
        } else {
            (c, Vector3::new(xz, yz, z))
        };
        // Proportional to the quaternion: normalise, with the sign that makes w positive.
        let norm = (w * w + dot(&v, &v)).sqrt();
        let factor = if w < T::ZERO { -one / norm } else { one / norm };
        (w * factor, scale(factor, &v))
    }

    /// Creates the pose from the quaternion (w, x, y, z), which is normalised here, and a translation in metres.
    pub fn from_quaternion(w: T, v: &Vector3<T>, translation: Vector3<T>) -> Self {
        let norm = (w * w + dot(v, v)).sqrt();
        let (w, v) = (w / norm, scale(T::ONE / norm, v));
        let two = T::from_f64(2.0);
        Self {
            rotation: polynomial_of_skew(&v, two * w, two),
            translation,
        }
    }

    /// Returns T⁻¹.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        let t = rotate(&rotation, &self.translation);
        Self {
            rotation,
            translation: Vector3::new(-t[0], -t[1], -t[2]),
        }
    }

    /// Returns Ad_T = `[[R, [p]R], [0, R]]`, 6×6: `adjoint(T)·ξ` is the twist ξ seen from the other frame.
    pub fn adjoint(&self) -> Matrix6<T> {
        let pr = product(&skew(&self.translation), &self.rotation);
        blocks(&self.rotation, &pr, &self.rotation)
    }

    /// Computes Ad_T ξ without forming the matrix.
    pub fn transform_twist(&self, twist: &Twist<T>) -> Twist<T> {
        let angular = rotate(&self.rotation, &twist.angular);
        let linear = add(
            &rotate(&self.rotation, &twist.linear),
            &cross(&self.translation, &angular),
        );
        Twist { linear, angular }
    }

    /// Returns T·x for a point in metres.
    #[inline(always)]
    pub fn transform_point(&self, point: &Vector3<T>) -> Vector3<T> {
        add(&rotate(&self.rotation, point), &self.translation)
    }

    /// Computes Exp(ξ)·T for a correction |ω| ≤ 2 rad (paper, eq. 9), without a branch.
    ///
    /// The translation is moved by a small increment instead of being rotated, which keeps the rounding error of a
    /// correction of millimetres far below that of the metres to which it is added.
    #[inline(always)]
    pub fn corrected(&self, residual: &Twist<T>) -> Self {
        let omega = &residual.angular;
        let k = Coefficients::series(dot(omega, omega));
        let rotation = product(&polynomial_of_skew(omega, k.a, k.b), &self.rotation);
        let (v, p) = (&residual.linear, &self.translation);
        // R p − p = a ω×p + b ω×(ω×p), V v = v + b ω×v + c ω×(ω×v).
        let (wp, wv) = (cross(omega, p), cross(omega, v));
        let (wwp, wwv) = (cross(omega, &wp), cross(omega, &wv));
        let step = |i: usize| (k.a * wp[i] + k.b * wwp[i]) + (v[i] + (k.b * wv[i] + k.c * wwv[i]));
        Self {
            rotation,
            translation: Vector3::new(p[0] + step(0), p[1] + step(1), p[2] + step(2)),
        }
    }

    /// Returns all twelve numbers, row by row: three of the rotation, then one of the translation.
    pub fn to_rows(&self) -> [T; 12] {
        let (r, t) = (&self.rotation, &self.translation);
        [
            r[(0, 0)],
            r[(0, 1)],
            r[(0, 2)],
            t[0],
            r[(1, 0)],
            r[(1, 1)],
            r[(1, 2)],
            t[1],
            r[(2, 0)],
            r[(2, 1)],
            r[(2, 2)],
            t[2],
        ]
    }

    /// Creates the pose from the numbers of [`Pose::to_rows`]; checks and normalises nothing.
    pub fn from_rows(m: &[T; 12]) -> Self {
        Self {
            rotation: Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]),
            translation: Vector3::new(m[3], m[7], m[11]),
        }
    }

    /// Returns the pose in another number type.
    pub fn cast<U: Scalar>(&self) -> Pose<U> {
        Pose {
            rotation: self.rotation.map(|x| U::from_f64(x.to_f64())),
            translation: self.translation.map(|x| U::from_f64(x.to_f64())),
        }
    }
}

impl<T: Scalar> Mul for Pose<T> {
    type Output = Pose<T>;

    #[inline(always)]
    fn mul(self, other: Pose<T>) -> Pose<T> {
        Pose {
            rotation: product(&self.rotation, &other.rotation),
            translation: self.transform_point(&other.translation),
        }
    }
}

/// Computes the residual twist ε = Log(T′ T⁻¹) in the space frame (paper, eq. 8); [`Pose::corrected`] is its inverse.
pub fn residual<T: Scalar>(measured: &Pose<T>, predicted: &Pose<T>) -> Twist<T> {
    (*measured * predicted.inverse()).log()
}

impl<T: Scalar> Twist<T> {
    /// Returns the zero twist.
    pub fn zero() -> Self {
        Self::from_array(&[T::ZERO; 6])
    }

    /// Creates the twist from (v, ω).
    #[inline(always)]
    pub fn from_array(a: &[T; 6]) -> Self {
        Self {
            linear: Vector3::new(a[0], a[1], a[2]),
            angular: Vector3::new(a[3], a[4], a[5]),
        }
    }

    /// Returns (v, ω).
    #[inline(always)]
    pub fn to_array(&self) -> [T; 6] {
        let (v, w) = (&self.linear, &self.angular);
        [v[0], v[1], v[2], w[0], w[1], w[2]]
    }

    /// Returns the motion with its linear part taken at `point` (axes unchanged): v + ω × point.
    #[inline(always)]
    pub fn at_point(&self, point: &Vector3<T>) -> Self {
        Self {
            linear: add(&self.linear, &cross(&self.angular, point)),
            angular: self.angular,
        }
    }
}

/// Computes the inverse of the left Jacobian of SO(3), 3×3, for angles up to π: `I − ½[ω] + d[ω]²`.
fn inverse_left_jacobian_so3<T: Scalar>(omega: &Vector3<T>) -> Matrix3<T> {
    let theta_squared = dot(omega, omega);
    let k = Coefficients::new(theta_squared);
    // d = (1 − a/2b)/θ² = (2b − a)/θ² / 2b.
    let difference = if theta_squared <= T::from_f64(4.0) {
        // 2b − a = Σ (−1)^(k+1) z^k 2k/(2k+2)!, whose first term is zero; divided by z it does not cancel.
        alternating_series(theta_squared, 4, |k| (2 * k + 2) as f64)
    } else {
        (k.b + k.b - k.a) / theta_squared
    };
    polynomial_of_skew(omega, -T::from_f64(0.5), difference / (k.b + k.b))
}

/// Returns [[upper_left, upper_right], [0, lower_right]].
fn blocks<T: Scalar>(
    upper_left: &Matrix3<T>,
    upper_right: &Matrix3<T>,
    lower_right: &Matrix3<T>,
) -> Matrix6<T> {
    let mut out = [[T::ZERO; 6]; 6];
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = upper_left[(i, j)];
            out[i][j + 3] = upper_right[(i, j)];
            out[i + 3][j + 3] = lower_right[(i, j)];
        }
    }
    out
}
