//! Log marginal likelihood, gradient, mean and variance at fixed hyperparameters, against scikit-learn and numpy.

use poegp_calibration::learning::task_space::likelihood::log_marginal_likelihood;
use poegp_calibration::learning::task_space::{
    Hyperparameters, Pairs, TaskSpaceGp, padded, scale_outputs,
};
use poegp_calibration::numeric::matrix::Mat;
use poegp_protocol::limits::OUTPUTS;
use serde_json::Value;

use crate::json::{array, list, numbers, parse};
use crate::say;

const LIKELIHOOD: &str = include_str!("../../../tests/data/vectors/gp_likelihood.json");
const PAPER_KERNEL: &str = include_str!("../../../tests/data/vectors/gp_paper_kernel.json");

fn inputs(points: &Value) -> Vec<Vec<f64>> {
    list(points).iter().map(numbers).collect()
}

fn outputs(values: &Value) -> Vec<[f64; OUTPUTS]> {
    list(values).iter().map(array).collect()
}

fn hyperparameters(theta: &Value, noise_variance: &Value) -> Hyperparameters {
    let mut values = numbers(theta);
    values.push(noise_variance.as_f64().unwrap());
    Hyperparameters::from_array(&values)
}

fn column(of: &Mat<f64>, c: usize) -> Mat<f64> {
    Mat::from_fn(of.nrows(), 1, |i, _| of[(i, c)])
}

/// Returns |a − b| / |b|.
fn relative(a: f64, b: f64) -> f64 {
    (a - b).abs() / b.abs()
}

#[test]
fn value_and_gradient_are_scikit_learns() {
    let file = parse(LIKELIHOOD);
    let pairs = Pairs::new(&inputs(&file["X"]));
    let (_, scaled) = scale_outputs(&outputs(&file["Y"]));
    let (mut value, mut slope, mut difference) = (0.0_f64, 0.0_f64, 0.0_f64);
    for case in list(&file["cases"]) {
        let h = hyperparameters(&case["theta"], &case["noise_variance"]);
        let mut check = |y: &Mat<f64>, likelihood: &Value, gradient: &Value| {
            let ours = log_marginal_likelihood(&pairs, y, &h).unwrap();
            value = value.max(relative(ours.log_likelihood, likelihood.as_f64().unwrap()));
            let theirs = array::<5>(gradient);
            let largest = theirs.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
            for k in 0..5 {
                slope = slope.max((ours.gradient[k] - theirs[k]).abs() / largest);
                let at = |step: f64| {
                    let mut theta = h.to_array();
                    theta[k] *= libm::exp(step);
                    let h = Hyperparameters::from_array(&theta);
                    log_marginal_likelihood(&pairs, y, &h)
                        .unwrap()
                        .log_likelihood
                };
                // Fourth order, so that the error of the difference is rounding rather than curvature.
                let step = 1e-3;
                let central = (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step)))
                    / (12.0 * step);
                difference = difference.max((ours.gradient[k] - central).abs() / largest);
            }
        };
        check(&scaled, &case["log_likelihood_sum"], &case["gradient_sum"]);
        for c in 0..OUTPUTS {
            let (likelihood, gradient) = (&case["log_likelihood"][c], &case["gradient"][c]);
            check(&column(&scaled, c), likelihood, gradient);
        }
    }
    say(format_args!(
        "log marginal likelihood: relative {value:.1e}; gradient: {slope:.1e} of its largest component, \
         {difference:.1e} against differences"
    ));
    assert!(value <= 1e-10 && slope <= 1e-8 && difference <= 1e-8);
}

/// Returns the largest relative differences at `points`: of the mean (as a share of the output's largest) and of the
/// standard deviation.
fn posterior(
    gp: &TaskSpaceGp,
    points: &[Vec<f64>],
    mean: &[[f64; OUTPUTS]],
    variance: &[[f64; OUTPUTS]],
) -> (f64, f64) {
    let (header, rows) = gp.mean();
    let (mut worst_mean, mut worst_variance) = (0.0_f64, 0.0_f64);
    for (i, x) in points.iter().enumerate() {
        let ours = header.mean(&rows, &padded(x));
        let spread = gp.variance(x);
        for c in 0..OUTPUTS {
            let largest = mean.iter().fold(0.0_f64, |m, row| m.max(row[c].abs()));
            worst_mean = worst_mean.max((ours[c] - mean[i][c]).abs() / largest);
            worst_variance = worst_variance.max(relative(spread[c], variance[i][c]));
        }
    }
    (worst_mean, worst_variance)
}

#[test]
fn mean_and_variance_are_scikit_learns() {
    let file = parse(LIKELIHOOD);
    let (x, y, points) = (
        inputs(&file["X"]),
        outputs(&file["Y"]),
        inputs(&file["X_test"]),
    );
    let (mut mean, mut variance) = (0.0_f64, 0.0_f64);
    for case in list(&file["cases"]) {
        let h = hyperparameters(&case["theta"], &case["noise_variance"]);
        let std = outputs(&case["std"]);
        let squares: Vec<_> = std.iter().map(|row| row.map(|s| s * s)).collect();
        // Six equal sets of hyperparameters give the same process by a different formula.
        for hyperparameters in [vec![h], vec![h; OUTPUTS]] {
            let gp = TaskSpaceGp::condition(hyperparameters, x.clone(), &y).unwrap();
            let (m, v) = posterior(&gp, &points, &outputs(&case["mean"]), &squares);
            (mean, variance) = (mean.max(m), variance.max(v));
        }
    }
    say(format_args!(
        "posterior against scikit-learn: mean {mean:.1e} of the output's largest, variance relative {variance:.1e}"
    ));
    assert!(mean <= 1e-10 && variance <= 1e-10);
}

#[test]
fn the_papers_kernel_is_numpys() {
    let file = parse(PAPER_KERNEL);
    let (x, y, points) = (
        inputs(&file["X"]),
        outputs(&file["Y"]),
        inputs(&file["X_test"]),
    );
    let (scale, scaled) = scale_outputs(&y);
    for (ours, theirs) in scale.iter().zip(numbers(&file["y_scale"])) {
        assert!(relative(*ours, theirs) < 1e-14, "{ours} {theirs}");
    }
    let pairs = Pairs::new(&x);
    let (mut mean, mut variance, mut value) = (0.0_f64, 0.0_f64, 0.0_f64);
    for case in list(&file["cases"]) {
        let h = hyperparameters(&case["theta"], &case["noise_var"]);
        let gp = TaskSpaceGp::condition(vec![h], x.clone(), &y).unwrap();
        let (m, v) = posterior(
            &gp,
            &points,
            &outputs(&case["mean"]),
            &outputs(&case["var"]),
        );
        (mean, variance) = (mean.max(m), variance.max(v));
        let ours = log_marginal_likelihood(&pairs, &scaled, &h)
            .unwrap()
            .log_likelihood;
        let constants = 0.5 * (OUTPUTS * x.len()) as f64 * libm::log(2.0 * std::f64::consts::PI);
        let of = |name: &str| case[name].as_f64().unwrap();
        value = value
            .max(relative(ours, of("sklearn_lml_sum6")))
            .max(relative(-ours - constants, of("nll_sum6_without_2pi")));
    }
    say(format_args!(
        "the paper's kernel against numpy: mean {mean:.1e}, variance {variance:.1e}, log likelihood {value:.1e}"
    ));
    assert!(mean <= 1e-10 && variance <= 1e-10 && value <= 1e-10);
}
