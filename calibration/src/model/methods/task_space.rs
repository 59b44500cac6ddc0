//! The paper's method: all frames of the chain, and a Gaussian process on the residual twist of the tool.

use poegp_protocol::limits::OUTPUTS;

use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::learning::task_space;
use crate::learning::task_space::fit::HyperparameterSharing;
use crate::measurement::sample::BaseSample;
use crate::model::correction::{Correction, TaskSpaceCorrection};
use crate::model::error::CalibrationError;
use crate::model::methods::poe::PoeMethod;
use crate::model::methods::problem::{
    CalibrationMethod, DataRequirements, FOR_A_POSE, Fit, Problem,
};
use crate::progress::FitContext;

/// Method that fits all frames of the chain and a Gaussian process of the joints.
pub struct TaskSpace {
    /// Whether the payload is also an input of the process.
    pub with_payload: bool,
}

impl CalibrationMethod for TaskSpace {
    fn requires(&self) -> DataRequirements {
        DataRequirements {
            whole_poses: true,
            payload: self.with_payload,
        }
    }

    /// Returns the poses that the chain needs, at least six, and four more: a few poses more than hyperparameters.
    fn min_poses(&self, joints: usize) -> usize {
        let for_the_chain = self.parameters(joints).div_ceil(6) + 1;
        for_the_chain.max(6) + 4
    }

    fn max_poses(&self) -> Option<usize> {
        Some(task_space::MAX_POINTS)
    }

    /// Measured memory was 60 and 55 bytes for each pair of poses with 1 000 and 2 000 poses. If each output has its own
    /// hyperparameters, it also has its own Cholesky factor.
    fn memory(&self, poses: usize, hyperparameters: HyperparameterSharing) -> u64 {
        let matrices = match hyperparameters {
            HyperparameterSharing::Shared => 8,
            HyperparameterSharing::PerOutput => 8 + OUTPUTS as u64 - 1,
        };
        8 * matrices * (poses as u64).pow(2) + FOR_A_POSE * poses as u64
    }

    fn fit(&self, problem: &Problem, context: &FitContext) -> Result<Fit, CalibrationError> {
        let step1 = PoeMethod.fit(problem, context)?;
        // The residual twist in the base frame (eq. 8–12); it does not depend on the tool of the sample.
        let residual = |s: &BaseSample| -> [f64; OUTPUTS] {
            let predicted = step1.predict(s);
            residual_components(ResidualFrame::Space, &s.observation, &predicted)
        };
        let residuals: Vec<_> = problem.samples.iter().map(residual).collect();
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
            correction: Correction::TaskSpace(Box::new(TaskSpaceCorrection {
                posterior_mean: gp.mean(),
                gp,
                with_payload: self.with_payload,
                max_signal_variance: problem.signal_variance.value,
            })),
            ..step1
        })
    }
}
