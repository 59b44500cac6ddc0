//! The standard deviation of the paper's process: kernels of the landmarks, and the quadratic form in them.

use crate::assembly::BLOCK;
use crate::math::scalar::Scalar;

/// Number of coefficients of one block of landmarks with another.
const PAIR: usize = BLOCK * BLOCK;
/// Number of words of a short landmark; a long one has twice as many.
pub(crate) const LANDMARK: usize = 8;

#[inline(always)]
pub(crate) fn portable_landmark_kernels<T: Scalar>(
    landmarks: &[T],
    query: &[T],
    square: T,
    kernels: &mut [T],
) {
    for (kernel, landmark) in kernels.iter_mut().zip(landmarks.chunks_exact(query.len())) {
        let mut exponent = -square;
        for (a, b) in landmark
            .as_chunks::<LANDMARK>()
            .0
            .iter()
            .zip(query.as_chunks::<LANDMARK>().0)
        {
            let mut i = 0;
            while i < LANDMARK {
                exponent += a[i] * b[i];
                i += 1;
            }
        }
        *kernel = exponent.exp2();
    }
}

#[inline(always)]
pub(crate) fn portable_quadratic_form<T: Scalar>(
    coefficients: &[T],
    kernels: &[[T; BLOCK]],
    total: &mut T,
) {
    let mut sum = T::ZERO;
    let mut rest = coefficients;
    let mut words = PAIR;
    for own in kernels {
        let Some((single, after)) = rest.split_first_chunk::<BLOCK>() else {
            break;
        };
        let Some((pairs, after)) = after.split_at_checked(words) else {
            break;
        };
        rest = after;
        words += PAIR;
        let mut factors = *single;
        for (pair, other) in pairs.as_chunks::<PAIR>().0.iter().zip(kernels) {
            let mut i = 0;
            while i < BLOCK {
                factors[i] += (pair[i] * other[0] + pair[BLOCK + i] * other[1])
                    + (pair[2 * BLOCK + i] * other[2] + pair[3 * BLOCK + i] * other[3]);
                i += 1;
            }
        }
        let mut i = 0;
        while i < BLOCK {
            sum += factors[i] * own[i];
            i += 1;
        }
    }
    *total = sum;
}
