//! The `f32` functions, and the `f64` functions that the sweeps use as reference, against 50 digits.

use poegp_runtime::gp::quadratic_kernel::QuadraticKernel;
use poegp_runtime::math::scalar::Scalar;
use serde_json::Value;

use crate::sweep::Worst;
use crate::table::ulp;

/// Largest error of an `f64` function in its own ulp, so that [`crate::table::REFERENCE`] covers it.
const REFERENCE_ULP: f64 = 1.0;

struct Truth {
    arguments: Vec<f32>,
    high: f64,
    low: f64,
}

impl Truth {
    /// Returns the error of `value` in ulp of a type with `digits` binary digits more than `f32`.
    fn error(&self, value: f64, digits: i32) -> f64 {
        let error = ((value - self.high) - self.low).abs();
        error / ulp(self.high) * libm::ldexp(1.0, digits)
    }
}

fn table(name: &str) -> Vec<Truth> {
    let text = include_str!("../../../tests/data/vectors/scalar.json");
    let file: Value = serde_json::from_str(text).unwrap();
    let rows = file[name].as_array().unwrap();
    rows.iter()
        .map(|row| {
            let row = row.as_array().unwrap();
            let (arguments, truth) = row.split_at(row.len() - 2);
            Truth {
                arguments: arguments
                    .iter()
                    .map(|bits| f32::from_bits(bits.as_u64().unwrap() as u32))
                    .collect(),
                high: truth[0].as_f64().unwrap(),
                low: truth[1].as_f64().unwrap(),
            }
        })
        .collect()
}

/// Compares both functions at every argument of a table.
fn compare(
    name: &str,
    single: impl Fn(&[f32]) -> f32,
    double: impl Fn(&[f64]) -> f64,
    allowed: f64,
) {
    let (mut worst, mut reference) = (Worst::NOTHING, Worst::NOTHING);
    let table = table(name);
    assert!(table.len() >= 100, "{name}");
    for truth in &table {
        let at = truth.arguments[0];
        worst.add(truth.error(f64::from(single(&truth.arguments)), 0), at);
        let exact: Vec<f64> = truth.arguments.iter().copied().map(f64::from).collect();
        reference.add(truth.error(double(&exact), 29), at);
    }
    println!(
        "{name:<12} | {} of 50 digits | f32 {:.4} ulp at {:e}, {allowed} allowed | f64 {:.4} of its ulp at {:e}",
        worst.count, worst.error, worst.at, reference.error, reference.at
    );
    assert!(worst.error <= allowed, "{name}: {worst:?}");
    assert!(reference.error <= REFERENCE_ULP, "{name}: {reference:?}");
}

#[test]
fn exp2_and_sqrt() {
    compare("exp2", |x| Scalar::exp2(x[0]), |x| Scalar::exp2(x[0]), 2.2);
    compare("sqrt", |x| Scalar::sqrt(x[0]), |x| Scalar::sqrt(x[0]), 0.5);
}

/// In ulp of numbers from ½ to 1, because near a zero the `f32` functions promise only an absolute error.
#[test]
fn sine_and_cosine() {
    for (name, sine) in [("sin", true), ("cos", false)] {
        let pick = |(s, c): (f64, f64)| if sine { s } else { c };
        let mut reference = Worst::NOTHING;
        let mut worst = Worst::NOTHING;
        for truth in table(name) {
            let at = truth.arguments[0];
            let (s, c): (f32, f32) = Scalar::sin_cos(at);
            let value = pick((f64::from(s), f64::from(c)));
            let error = ((value - truth.high) - truth.low).abs();
            worst.add(error * f64::from(1 << 24), at);
            let value = pick(Scalar::sin_cos(f64::from(at)));
            reference.add(truth.error(value, 29), at);
        }
        println!(
            "{name:<12} | {} of 50 digits | f32 {:.4} ulp of 1/2 to 1 at {:e} | f64 {:.4} of its ulp at {:e}",
            worst.count, worst.error, worst.at, reference.error, reference.at
        );
        assert!(worst.error <= 1.6, "{name}: {worst:?}");
        assert!(reference.error <= REFERENCE_ULP, "{name}: {reference:?}");
    }
}

#[test]
fn arc_tangent() {
    compare(
        "atan2",
        |a| Scalar::atan2(a[0], a[1]),
        |a| Scalar::atan2(a[0], a[1]),
        1.0,
    );
}

/// The reference of the sweep also takes the power of a rounded exponent, so it has more ulp of `f64`; the sweep adds them.
#[test]
fn correlation() {
    let kernel = QuadraticKernel::<f32> {
        signal_variance: 1.0,
        inverse_squared_lengthscale: 1.0,
        constant_variance: 0.0,
        linear_variance: 0.0,
    };
    let (mut worst, mut reference) = (Worst::NOTHING, Worst::NOTHING);
    for truth in table("correlation") {
        let at = truth.arguments[0];
        worst.add(truth.error(f64::from(kernel.correlation(at)), 0), at);
        let exact = Scalar::exp2(-0.5 * core::f64::consts::LOG2_E * f64::from(at));
        reference.add(truth.error(exact, 29), at);
    }
    println!("correlation  | f32 {worst:?} | f64 {reference:?}");
    assert!(worst.error <= 64.0, "{worst:?}");
    assert!(reference.error <= 128.0, "{reference:?}");
}
