//! The record of a calibration by touches that helps to calibrate sister arms: the parameters of the arm with their
//! covariance, stored in the JSON of the calibration.

use nalgebra::DVector;
use poegp_runtime::math::se3::Pose;
use serde::{Deserialize, Serialize};

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{Scales, TouchFit, TouchProblem};
use crate::identification::touch::sisters::{Sister, SisterPrior};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;

/// Largest difference between frames of the same nominal model, which differ only by rounding, in m and rad.
const SAME_NOMINAL: f64 = 1e-6;

/// The record of a calibrated arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmRecord {
    /// The frames of the nominal model, each row by row, in m.
    pub nominal: Vec<[f64; 12]>,
    /// The calibrated parameters of the arm.
    pub parameters: Vec<Parameter>,
    /// Covariance of the parameters, each in units of its standard deviation before the touches: the lower triangle row by
    /// row.
    pub covariance: Vec<f64>,
    /// Whether sister arms contributed to the calibration; such a record is not independent evidence.
    pub has_sisters: bool,
}

/// One parameter of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// The kind of the parameter.
    pub group: Group,
    /// Index of the frame, or of the joint of a gravity term, counted from 0.
    pub index: usize,
    /// Value of the parameter in m or rad; for gravity terms in rad/(m/s²) and the like.
    pub value: f64,
    /// Standard deviation of the parameter before the touches.
    pub prior: f64,
}

/// Why a record cannot be used for this arm.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotASisterArm {
    /// The record is of an arm with another nominal model.
    #[error("an arm with another nominal geometry")]
    Nominal,
    /// The calibration of the record itself depends on sister arms.
    #[error("an arm that was calibrated with --prior itself")]
    Leans,
    /// The record is not what the trainer writes.
    #[error("parameters that do not match their covariance")]
    Broken,
}

fn nominal(problem: &TouchProblem) -> Vec<[f64; 12]> {
    problem.nominal.frames().iter().map(Pose::to_rows).collect()
}

impl ArmRecord {
    /// Creates the record of a fit; `None` if its equations cannot be solved.
    pub fn new(problem: &TouchProblem, fit: &TouchFit) -> Option<Self> {
        let covariance = fit.solved(problem)?.covariance();
        let priors = fit.priors(problem);
        let all = fit.arm.columns.iter().zip(&fit.arm.theta).zip(&priors);
        let parameter = |((column, value), prior): (
            (&crate::identification::touch::arm::Column, &f64),
            &f64,
        )| Parameter {
            group: column.group,
            index: column.index,
            value: *value,
            prior: *prior,
        };
        let lower = (0..priors.len()).flat_map(|i| (0..=i).map(move |j| (i, j)));
        Some(Self {
            nominal: nominal(problem),
            parameters: all.map(parameter).collect(),
            covariance: lower.map(|at| covariance[at]).collect(),
            has_sisters: problem.sisters.is_some(),
        })
    }

    /// Returns the information on the class parameters that the touches alone give, in units of the class of `problem`.
    fn sister(&self, problem: &TouchProblem) -> Result<Sister, NotASisterArm> {
        if self.has_sisters {
            return Err(NotASisterArm::Leans);
        }
        let same = |a: &[f64; 12], b: &[f64; 12]| {
            a.iter().zip(b).all(|(a, b)| (a - b).abs() < SAME_NOMINAL)
        };
        let own_nominal = nominal(problem);
        if own_nominal.len() != self.nominal.len()
            || !own_nominal
                .iter()
                .zip(&self.nominal)
                .all(|(a, b)| same(a, b))
        {
            return Err(NotASisterArm::Nominal);
        }
        let n = self.parameters.len();
        let own: Vec<usize> = (0..n)
            .filter(|j| self.parameters[*j].group.is_of_class())
            .collect();
        let usable = self.covariance.len() == n * (n + 1) / 2
            && own.iter().all(|j| self.parameters[*j].prior > 0.0)
            && own.len() == 6 * (own_nominal.len() - 2);
        if !usable {
            return Err(NotASisterArm::Broken);
        }
        let at = |i: usize, j: usize| self.covariance[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
        let p = own.len();
        let covariance = Mat::from_fn(p, p, |a, b| at(own[a], own[b]));
        let inverse = Factor::new(covariance, 1)
            .map_err(|_| NotASisterArm::Broken)?
            .inverse();
        let class = Scales::new(&problem.class);
        // Class scale over the parameter's own prior: converts information from units of that prior to units of the class.
        let ratio = |a: usize| {
            let parameter = &self.parameters[own[a]];
            class.of(parameter.group).unwrap_or(1.0) / parameter.prior
        };
        let identity = |a: usize, b: usize| f64::from(u8::from(a == b));
        let information = Mat::from_fn(p, p, |a, b| {
            ratio(a) * (0.5 * (inverse[(a, b)] + inverse[(b, a)]) - identity(a, b)) * ratio(b)
        });
        let values = DVector::from_fn(p, |a, _| {
            self.parameters[own[a]].value / self.parameters[own[a]].prior
        });
        let weighted = DVector::from_fn(p, |a, _| {
            ratio(a) * (0..p).map(|b| inverse[(a, b)] * values[b]).sum::<f64>()
        });
        Ok(Sister {
            information,
            weighted,
        })
    }
}

/// Computes the prior of an arm from the records of its sister arms.
///
/// # Errors
/// The index of a record that cannot be used for this arm, and why.
pub fn by_sisters(
    problem: &TouchProblem,
    records: &[ArmRecord],
) -> Result<Option<SisterPrior>, (usize, NotASisterArm)> {
    if records.is_empty() {
        return Ok(None);
    }
    let sister = |(k, record): (usize, &ArmRecord)| record.sister(problem).map_err(|e| (k, e));
    let sisters = records
        .iter()
        .enumerate()
        .map(sister)
        .collect::<Result<Vec<_>, _>>()?;
    let arm = problem.arm(0);
    let of_class = || arm.columns.iter().filter(|c| c.group.is_of_class());
    let groups: Vec<Group> = of_class().map(|c| c.group).collect();
    let frames = problem.nominal.frames();
    let mut seen = vec![0; frames.len()];
    let size = of_class().map(|column| {
        if column.group != Group::Length {
            return 0.0;
        }
        let frame = &frames[column.index];
        let lever = frame.rotation.transpose() * frame.translation;
        seen[column.index] += 1;
        lever[seen[column.index] - 1]
    });
    let size = DVector::from_vec(size.collect());
    Ok(SisterPrior::new(&sisters, &groups, &size))
}
