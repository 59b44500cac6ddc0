//! The predictive standard deviation of the elastic model, tested by an identity that uses none of its formulas.

use poegp_calibration::identification::base_tools::fit_base_and_tools;
use poegp_calibration::identification::base_tools::with_base_and_tool;
use poegp_calibration::learning::elastic::fit::fit;
use poegp_calibration::learning::elastic::options::{ElasticOptions, InducingLimits, NominalArm};
use poegp_calibration::learning::elastic::predictive_variance::Uncertainty;
use poegp_calibration::learning::elastic::reduced_model::ElasticModel;
use poegp_calibration::measurement::sample::in_base_frame;
use poegp_calibration::progress::FitContext;
use poegp_runtime::math::se3::Pose;

use crate::say;
use crate::sets::{arm, simulated};

/// A training pose measured once more: with S = P + N its covariance is N + P − P S⁻¹ P = 2 N − N S⁻¹ N, which needs only the
/// factor of S.
#[test]
fn the_deviation_of_a_trained_pose_is_that_of_the_factor() {
    let (robot, nominal) = arm();
    let mut samples = simulated(&robot, "train");
    samples.truncate(40);
    let found = fit_base_and_tools(&nominal, &samples);
    let samples = in_base_frame(&samples, &found.instrument_from_base);
    let chain = with_base_and_tool(&nominal, &Pose::identity(), &found.flange_from_targets[0]);
    let tools = vec![chain.frames()[6]];
    let options = ElasticOptions {
        inducing: InducingLimits {
            points: 20,
            ..InducingLimits::default()
        },
        ..ElasticOptions::default()
    };
    let arm = NominalArm {
        chain,
        tools,
        coupling: None,
        gear_lines: Vec::new(),
    };
    let mut found = fit(&arm, &samples, &options, &FitContext::default()).unwrap();
    let blocks = found.solved.as_ref().unwrap().factor.inverse_blocks(6);
    let noise: Vec<f64> = found.hyperparameters[..2]
        .iter()
        .map(|h| libm::exp(*h))
        .collect();
    let scales = [found.scales.position, found.scales.orientation];
    // The reduced model moves the parameters; their uncertainty stays that of the data.
    ElasticModel::new(&mut found, &samples, &samples, None, &options).unwrap();
    let uncertainty = Uncertainty::new(found, &samples, [1.0; 2]).unwrap();
    let mut worst = 0.0_f64;
    for (k, sample) in samples.iter().enumerate() {
        for (row, sd) in uncertainty.standard_deviation(sample).iter().enumerate() {
            let kind = usize::from(row >= 3);
            let n = noise[kind];
            let expected = scales[kind] * (2.0 * n - n * n * blocks[k][(row, row)]).sqrt();
            worst = worst.max((sd / expected - 1.0).abs());
        }
    }
    say(format_args!(
        "standard deviation of a trained pose against the factor: {worst:.1e}"
    ));
    assert!(worst <= 1e-6, "{worst}");
}
