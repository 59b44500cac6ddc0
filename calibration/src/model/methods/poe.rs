//! The POE method: calibrates all frames of the chain (step 1 of the paper).

use poegp_runtime::kinematics::poe::Poe;

use crate::identification::frame_fit::{
    FrameFit, ResidualFrame, fit_frames, followed_share, residual_components,
};
use crate::learning::elastic::options::ElasticOptions;
use crate::measurement::noise::{NoiseOfFits, NoiseScales};
use crate::measurement::sample::BaseSample;
use crate::model::correction::Correction;
use crate::model::error::CalibrationError;
use crate::model::methods::elastic::fit_elastic;
use crate::model::methods::problem::{
    CalibrationMethod, Fit, FrameEstimate, Problem, Weighting, has_whole_poses_of_one_tool,
    seen_from_first,
};
use crate::progress::FitContext;

/// Method that calibrates all frames of the chain.
pub struct PoeMethod;

impl CalibrationMethod for PoeMethod {
    fn fit(&self, problem: &Problem, context: &FitContext) -> Result<Fit, CalibrationError> {
        if has_whole_poses_of_one_tool(&problem.samples) {
            let (chain, frame_fit) = fit_chain(problem);
            return Ok(Fit {
                chain,
                tools: seen_from_first(&problem.tools),
                correction: Correction::None,
                estimate: FrameEstimate::LeastSquares(frame_fit),
                outliers: Vec::new(),
                warm_up: None,
            });
        }
        // The paper compares whole poses of one tool; other data get the same parameters by weighted least squares.
        let options = ElasticOptions {
            gravity_terms: false,
            processes: false,
            ripple: false,
            ..problem.elastic
        };
        let fit = fit_elastic(problem, &options, context)?;
        Ok(Fit {
            correction: Correction::None,
            estimate: FrameEstimate::Parametric {
                uncertainty: None,
                parameters: None,
            },
            ..fit
        })
    }
}

/// Fits all frames of the chain by least squares, weighted as `problem` says.
fn fit_chain(problem: &Problem) -> (Poe<f64>, FrameFit) {
    let (mut chain, samples) = (problem.nominal, &problem.samples);
    let free: Vec<usize> = (0..chain.frames().len()).collect();
    if problem.weighting == Weighting::None {
        let fit = fit_frames(&mut chain, samples, &free, ResidualFrame::Space);
        return (chain, fit);
    }
    // Noise and model error of position and rotation are estimated from the residuals; a few rounds are enough to converge.
    let mut fit = fit_frames(
        &mut chain,
        samples,
        &free,
        ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
    );
    let mut kind = ResidualFrame::TOOL_POINT_UNIT_WEIGHTS;
    let mut noise = NoiseOfFits::default();
    for _ in 0..NOISE_ROUNDS {
        let share = followed_share(&chain, samples, &free, kind);
        kind = ResidualFrame::ToolPoint(noise.of(estimated_noise(&chain, samples), share));
        fit = fit_frames(&mut chain, samples, &free, kind);
    }
    (chain, fit)
}

/// Number of rounds of noise estimation in a weighted fit.
const NOISE_ROUNDS: usize = 4;

/// Estimates the noise of position and rotation at the tool point from the residuals; rows that declare their own noise keep
/// it.
fn estimated_noise(chain: &Poe<f64>, samples: &[BaseSample]) -> NoiseScales {
    let residual = |s: &BaseSample| {
        residual_components(
            ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
            &s.observation,
            &chain.forward(&s.serial_joints),
        )
    };
    let residuals: Vec<[f64; 6]> = samples.iter().map(residual).collect();
    NoiseScales::estimated(&residuals, samples).at_least(1e-9)
}
