//! Base-tool, step 1 and the maximum likelihood on a whole training set, against numpy, scipy and scikit-learn.

use poegp_calibration::identification::frame_fit::{ResidualFrame, residual_components};
use poegp_calibration::learning::task_space::fit::{
    HyperparameterSharing, MAX_SIGNAL_VARIANCE, SignalVarianceLimit, fit, maximise_likelihood,
};
use poegp_calibration::learning::task_space::likelihood::log_marginal_likelihood;
use poegp_calibration::learning::task_space::{Pairs, input, scale_outputs};
use poegp_calibration::measurement::sample::in_base_frame;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{Method, calibrate};
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::progress::FitContext;
use poegp_protocol::limits::OUTPUTS;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::json::{array, largest_difference, list, parse};
use crate::{say, sets};

const OPTIMUM: &str = include_str!("../../../tests/data/vectors/gp_optimum.json");
/// How far our optimum may be below scikit-learn's, in nats per pose and output.
const WORSE: f64 = 1e-3;

#[test]
fn residuals_after_step_1_are_numpys() {
    let (robot, _) = sets::arm();
    let train = sets::simulated(&robot, "train");
    let theirs: Vec<[f64; OUTPUTS]> = list(&parse(OPTIMUM)["residuals"])
        .iter()
        .map(array)
        .collect();
    let found = calibrate(
        &robot,
        &train,
        &Config::new(Method::Poe),
        &FitContext::default(),
    )
    .unwrap();
    let ours: Vec<[f64; OUTPUTS]> =
        in_base_frame(&train, &found.base_and_tools.instrument_from_base)
            .iter()
            .map(|s| {
                let chain = found.calibrated.forward(&s.serial_joints);
                residual_components(ResidualFrame::Space, &s.observation, &chain)
            })
            .collect();
    let worst = largest_difference(ours.as_flattened(), theirs.as_flattened());
    say(format_args!(
        "residuals of 300 poses after base-tool and step 1: {worst:.1e} m and rad from numpy's"
    ));
    assert!(worst <= 1e-8, "{worst:e}");
}

#[test]
fn the_optimum_is_as_likely_as_scikit_learns() {
    let (robot, _) = sets::arm();
    let inputs: Vec<Vec<f64>> = sets::simulated(&robot, "train")
        .iter()
        .map(|s| input(&s.joints, s.payload_kg))
        .collect();
    let file = parse(OPTIMUM);
    let residuals: Vec<[f64; OUTPUTS]> = list(&file["residuals"]).iter().map(array).collect();
    let (_, scaled) = scale_outputs(&residuals);
    let pairs = Pairs::new(&inputs);
    let check = |name: &str, outputs: &Mat<f64>, reference: &serde_json::Value| {
        let (found, ours) =
            maximise_likelihood(&pairs, outputs, MAX_SIGNAL_VARIANCE, &FitContext::default())
                .unwrap();
        let theirs = reference["log_likelihood"].as_f64().unwrap();
        say(format_args!(
            "{name}: log likelihood {ours:.4}, scikit-learn's {theirs:.4} at {:.3?}, ours at {:.3?}",
            array::<5>(&reference["hyperparameters"]),
            found.to_array()
        ));
        let values = (outputs.nrows() * outputs.ncols()) as f64;
        assert!(ours >= theirs - WORSE * values, "{name}");
    };
    check("all outputs", &scaled, &file["shared"]);
    for (c, reference) in list(&file["per_output"]).iter().enumerate() {
        let column = Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, c)]);
        check(&format!("output {}", c + 1), &column, reference);
    }
}

/// With a bound of the signal variance, the search may start where the search without the bound ended. It must reach the same
/// likelihood as from the usual starts. For these smooth outputs the unbounded optimum has other lengthscales.
#[test]
fn a_bounded_search_that_begins_elsewhere_ends_as_high() {
    const BOUND: f64 = 30.0;
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let mut draw = || random.random_range(-1.0..1.0_f64);
    let inputs: Vec<Vec<f64>> = (0..150).map(|_| (0..7).map(|_| draw()).collect()).collect();
    let residuals: Vec<[f64; OUTPUTS]> = inputs
        .iter()
        .map(|x| {
            std::array::from_fn(|c| {
                let smooth = x[c] * x[c + 1] * 3.0 + x[1] * x[1] * x[c] * 2.0 + x[6] * x[0] * 4.0;
                1e-3 * (smooth + 0.03 * draw())
            })
        })
        .collect();
    let per_output = |limit: SignalVarianceLimit| {
        fit(
            inputs.clone(),
            &residuals,
            HyperparameterSharing::PerOutput,
            &limit,
            &FitContext::default(),
        )
        .unwrap()
        .hyperparameters
    };
    let larger = per_output(SignalVarianceLimit::HIGHEST);
    let found = per_output(SignalVarianceLimit {
        value: BOUND,
        under_higher: Some(larger.as_slice().try_into().unwrap()),
    });
    let (pairs, (_, scaled)) = (Pairs::new(&inputs), scale_outputs(&residuals));
    let mut bounded = 0;
    for (c, hyperparameters) in found.iter().enumerate() {
        let column = Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, c)]);
        let likelihood = log_marginal_likelihood(&pairs, &column, hyperparameters).unwrap();
        let best = maximise_likelihood(&pairs, &column, BOUND, &FitContext::default())
            .unwrap()
            .1;
        let lost = (best - likelihood.log_likelihood) / inputs.len() as f64;
        bounded += usize::from(larger[c].kernel.signal_variance > BOUND);
        assert!(
            lost <= WORSE,
            "output {c}: {lost} nats per pose below the optimum"
        );
    }
    say(format_args!(
        "{bounded} of 6 outputs beyond the bound: as likely as from the usual starts"
    ));
    assert!(bounded > 0);
}
