//! The paper's kernel and posterior mean in `f64` against scikit-learn and numpy (`gp_paper_kernel.json`).

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};
use poegp_runtime::gp::quadratic_kernel::QuadraticKernel;
use poegp_runtime::gp::quadratic_posterior::{
    MeanHeader, accumulate_affine, input_scale, stored_weight,
};
use poegp_runtime::math::vector::{inner_product, squared_distance};
use serde_json::Value;

use crate::json::{array, list, numbers, parse};

const INPUTS: usize = 7;

fn kernel(case: &Value) -> QuadraticKernel<f64> {
    let [
        signal_variance,
        inverse_squared_lengthscale,
        constant_variance,
        linear_variance,
    ] = array(&case["theta"]);
    QuadraticKernel {
        signal_variance,
        inverse_squared_lengthscale,
        constant_variance,
        linear_variance,
    }
}

/// Returns the header and rows as the trainer writes them, from the weights K⁻¹ε of scaled outputs.
fn posterior(file: &Value, case: &Value) -> (MeanHeader<f64>, Vec<f64>) {
    let kernel = kernel(case);
    let output_scale = array::<OUTPUTS>(&file["y_scale"]);
    let scale = input_scale(kernel.inverse_squared_lengthscale);
    let mut header = MeanHeader::zero(INPUTS);
    header.input_scale[..INPUTS].fill(scale);
    let mut rows = Vec::new();
    for (x, weights) in list(&file["X"]).iter().zip(list(&case["alpha"])) {
        let (x, weights) = (array::<INPUTS>(x), array::<OUTPUTS>(weights));
        rows.extend(x.map(|value| value * scale));
        for c in 0..OUTPUTS {
            rows.push(stored_weight(&kernel, weights[c], output_scale[c]));
            accumulate_affine(
                &mut header.affine[c],
                &kernel,
                weights[c],
                output_scale[c],
                &x,
            );
        }
    }
    (header, rows)
}

#[test]
fn gram_matrix_agrees() {
    let file = parse(include_str!(
        "../../../tests/data/vectors/gp_paper_kernel.json"
    ));
    let points: Vec<[f64; INPUTS]> = list(&file["X"]).iter().map(array).collect();
    let mut worst = 0.0_f64;
    for case in list(&file["cases"]) {
        let (kernel, gram) = (kernel(case), numbers(&case["K"]));
        for (i, a) in points.iter().enumerate() {
            for (j, b) in points.iter().enumerate() {
                let value = kernel.value(squared_distance(a, b), inner_product(a, b));
                let reference = gram[i * points.len() + j];
                let difference = (value - reference).abs();
                worst = worst.max(difference / kernel.signal_variance);
                let mirrored = kernel.value(squared_distance(b, a), inner_product(b, a));
                assert_eq!(value, mirrored, "symmetric to the bit");
            }
        }
    }
    println!("K: {worst:.1e} of the signal variance");
    assert!(worst <= 1e-14, "{worst:e}");
}

/// Errors are relative to the largest mean of the output, because a mean near zero is a difference of large numbers.
#[test]
fn posterior_mean_agrees() {
    let file = parse(include_str!(
        "../../../tests/data/vectors/gp_paper_kernel.json"
    ));
    let tests: Vec<[f64; INPUTS]> = list(&file["X_test"]).iter().map(array).collect();
    let (mut worst, mut worst_folded, mut folds_of_cases) = (0.0_f64, 0.0_f64, 0);
    for case in list(&file["cases"]) {
        let (header, rows) = posterior(&file, case);
        let (mut folded, mut folded_rows) = (header, rows.clone());
        let folds = folded.fold(&mut folded_rows);
        folds_of_cases += u32::from(folds);
        for name in ["mean", "sklearn_mean"] {
            let reference: Vec<[f64; OUTPUTS]> = list(&case[name]).iter().map(array).collect();
            for (x, expected) in tests.iter().zip(&reference) {
                let mut input = [0.0; MAX_INPUTS];
                input[..INPUTS].copy_from_slice(x);
                let mean = header.mean(&rows, &input);
                for c in 0..OUTPUTS {
                    let largest = reference.iter().fold(0.0, |m: f64, r| m.max(r[c].abs()));
                    worst = worst.max((mean[c] - expected[c]).abs() / largest);
                    if folds {
                        let mean = folded.mean(&folded_rows, &input);
                        worst_folded = worst_folded.max((mean[c] - expected[c]).abs() / largest);
                    }
                }
            }
        }
    }
    println!(
        "posterior mean: {worst:.1e} of the output's largest, folded {worst_folded:.1e} ({folds_of_cases} cases)"
    );
    assert!(worst <= 1e-10, "{worst:e}");
    assert!(worst_folded <= 1e-10, "{worst_folded:e}");
    assert!(folds_of_cases > 0, "no case can be folded");
}
