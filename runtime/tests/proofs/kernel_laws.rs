//! The paper's kernel (eq. 5), for one value and for many at once.

use poegp_runtime::gp::quadratic_kernel::QuadraticKernel;
use poegp_runtime::math::scalar::Scalar;
use proptest::prelude::*;

use crate::seeded::config;

fn close<T: Scalar>(found: T, expected: f64, tolerance: f64) -> bool {
    (found.to_f64() - expected).abs() <= tolerance * (1.0 + expected.abs())
}

fn kernel<T: Scalar>(theta: [f64; 4]) -> QuadraticKernel<T> {
    let [signal, rate, constant, linear] = theta.map(T::from_f64);
    QuadraticKernel {
        signal_variance: signal,
        inverse_squared_lengthscale: rate,
        constant_variance: constant,
        linear_variance: linear,
    }
}

proptest! {
    #![proptest_config(config(701, 256))]

    #[test]
    fn a_value_is_the_formula(
        theta in prop::array::uniform4(0.1..3.0_f64),
        squared_distance in 0.0..20.0_f64,
        inner_product in -5.0..5.0_f64,
    ) {
        let [signal, rate, constant, linear] = theta;
        let correlation = libm::exp(-0.5 * rate * squared_distance);
        let expected = signal * correlation + constant + linear * inner_product;
        let double: QuadraticKernel<f64> = kernel(theta);
        prop_assert!(close(double.value(squared_distance, inner_product), expected, 1e-14));
        let single: QuadraticKernel<f32> = kernel(theta);
        let found = single.value(squared_distance as f32, inner_product as f32);
        prop_assert!(close(found, expected, 3e-6));
    }

    /// Writes as many values as the shorter slice has, and no more.
    #[test]
    fn many_at_once_are_the_same(
        theta in prop::array::uniform4(0.1..3.0_f64),
        squared_distances in prop::collection::vec(0.0..20.0_f64, 0..40),
        room in 0..40_usize,
    ) {
        let double: QuadraticKernel<f64> = kernel(theta);
        let mut out = vec![-1.0; room];
        double.correlations(&squared_distances, &mut out);
        let single: QuadraticKernel<f32> = kernel(theta);
        let narrow: Vec<f32> = squared_distances.iter().map(|d| *d as f32).collect();
        let mut out_narrow = vec![-1.0_f32; room];
        single.correlations(&narrow, &mut out_narrow);
        for (i, d) in squared_distances.iter().enumerate().take(room) {
            let expected = libm::exp(-0.5 * theta[1] * d);
            prop_assert!(close(out[i], expected, 1e-14), "{} {}", out[i], expected);
            prop_assert!(close(out_narrow[i], expected, 3e-6), "{} {}", out_narrow[i], expected);
        }
    }
}
