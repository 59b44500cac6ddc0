//! The paper's method: all frames of the chain, and a Gaussian process on the residual twist of the tool.

use poegp_protocol::limits::OUTPUTS;

use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::learning::task_space;
use crate::model::correction::{Correction, TaskSpaceCorrection};
use crate::model::error::CalibrationError;
use crate::model::methods::poe::fit_chain;
use crate::model::methods::problem::{
    CalibrationMethod, DataRequirements, Fit, FrameEstimate, Problem, seen_from_first,
};
use crate::progress::FitContext;

/// All frames of the chain and a Gaussian process of the joints.
pub struct TaskSpace {
    /// Whether the payload is an input of the process, too.
    pub with_payload: bool,
}

impl CalibrationMethod for TaskSpace {
    fn requires(&self) -> DataRequirements {
        DataRequirements {
            single_tool_full_poses: true,
            payload: self.with_payload,
        }
    }

    /// A few poses more than hyperparameters.
    fn min_poses(&self, joints: usize) -> usize {
        let for_the_chain = self.parameters(joints).div_ceil(6) + 1;
        for_the_chain.max(6) + 4
    }

    fn max_poses(&self) -> Option<usize> {
        Some(task_space::MAX_POINTS)
    }

    fn fit(&self, problem: &Problem, context: &FitContext) -> Result<Fit, CalibrationError> {
        let (chain, frame_fit) = fit_chain(problem);
        // The residual twist in the base frame (eq. 8–12).
        let residuals: Vec<[f64; OUTPUTS]> = problem
            .samples
            .iter()
            .map(|s| {
                residual_components(
                    ResidualFrame::Space,
                    &s.observation,
                    &chain.forward(&s.serial_joints),
                )
            })
            .collect();
        let inputs = problem
            .samples
            .iter()
            .map(|s| task_space::input(&s.joints, s.payload_kg.filter(|_| self.with_payload)));
        let gp = task_space::fit::fit(
            inputs.collect(),
            &residuals,
            problem.hyperparameters,
            problem.signal_variance,
            context,
        )?;
        Ok(Fit {
            chain,
            tools: seen_from_first(&problem.tools),
            correction: Correction::TaskSpace(Box::new(TaskSpaceCorrection {
                posterior_mean: gp.mean(),
                gp,
                with_payload: self.with_payload,
                max_signal_variance: problem.signal_variance.value,
            })),
            estimate: FrameEstimate::LeastSquares(frame_fit),
            outliers: Vec::new(),
        })
    }
}
