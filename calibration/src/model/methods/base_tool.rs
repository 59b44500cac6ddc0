//! The base-tool method: calibrates base and tool frames alone; every other frame keeps its nominal value.

use crate::model::correction::Correction;
use crate::model::error::CalibrationError;
use crate::model::methods::problem::{
    CalibrationMethod, Fit, FrameEstimate, Problem, seen_from_first,
};
use crate::progress::FitContext;

/// Method that calibrates base and tool frames alone.
pub struct BaseTool;

impl CalibrationMethod for BaseTool {
    fn parameters(&self, _: usize) -> usize {
        12
    }

    fn fit(&self, problem: &Problem, _: &FitContext) -> Result<Fit, CalibrationError> {
        Ok(Fit {
            chain: problem.nominal,
            tools: seen_from_first(&problem.tools),
            correction: Correction::None,
            estimate: FrameEstimate::Nominal,
            outliers: Vec::new(),
            warm_up: None,
        })
    }
}
