//! The correction that a calibrated model adds to the chain.

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};
use poegp_runtime::gp::quadratic_posterior::MeanHeader;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::learning::elastic::reduced_model::ElasticModel;
use crate::learning::task_space::{self, TaskSpaceGp};
use crate::measurement::sample::Sample;

/// The correction that a model adds to the calibrated chain, as the runtime evaluates it.
#[derive(Clone, Debug)]
pub enum Correction {
    /// No correction: the model is the chain alone.
    None,
    /// A Gaussian process that predicts a twist of the tool.
    TaskSpace(Box<TaskSpaceCorrection>),
    /// Deflections of the joints.
    Elastic(Box<ElasticModel>),
}

/// The Gaussian process of the paper, which predicts the residual twist of the tool.
#[derive(Clone, Debug)]
pub struct TaskSpaceCorrection {
    /// The process, conditioned on the training poses.
    pub gp: TaskSpaceGp,
    /// The posterior mean of the process in the form that the runtime evaluates: header and rows of the inducing points.
    pub posterior_mean: (MeanHeader<f64>, Vec<f64>),
    /// Whether the payload is an input of the process.
    pub with_payload: bool,
    /// Upper limit on the signal variance of the process, in units of the outputs' mean square.
    pub max_signal_variance: f64,
}

impl TaskSpaceCorrection {
    /// Returns the input x = [q, m] of the process; the payload m is left out if it is not an input.
    pub fn inputs(&self, joints: &[f64], payload_kg: Option<f64>) -> Vec<f64> {
        task_space::input(joints, payload_kg.filter(|_| self.with_payload))
    }

    /// Returns the mean residual twist of the tool in the base frame, in m and rad.
    fn twist<F>(&self, sample: &Sample<F>) -> Twist<f64> {
        let inputs = self.inputs(&sample.joints, sample.payload_kg);
        let x: [f64; MAX_INPUTS] = task_space::padded(&inputs);
        let (header, rows) = &self.posterior_mean;
        Twist::from_array(&header.mean(rows, &x))
    }

    /// Returns the predictive standard deviation of a new measurement whose tool is at `tool`: position along the axes of
    /// the base frame in metres, rotation about them in radians (eq. 7, transformed to the tool point, plus the noise).
    pub(crate) fn standard_deviation<F>(
        &self,
        sample: &Sample<F>,
        tool: &Pose<f64>,
    ) -> [f64; OUTPUTS] {
        let gp = &self.gp;
        let latent = gp.variance(&self.inputs(&sample.joints, sample.payload_kg));
        let variance =
            |c: usize| latent[c] + gp.output(c).noise_variance * gp.output_scale[c].powi(2);
        let p = tool.translation;
        // v + ω × p, component by component; the outputs are independent.
        std::array::from_fn(|i| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let lever = if i < 3 {
                p[k].powi(2) * variance(3 + j) + p[j].powi(2) * variance(3 + k)
            } else {
                0.0
            };
            (variance(i) + lever).sqrt()
        })
    }
}

impl Correction {
    /// Returns the task-space process, if the correction is one.
    pub fn task_space(&self) -> Option<&TaskSpaceCorrection> {
        match self {
            Self::TaskSpace(task_space) => Some(task_space),
            _ => None,
        }
    }

    /// Returns the elastic model, if the correction is one.
    pub fn elastic(&self) -> Option<&ElasticModel> {
        match self {
            Self::Elastic(elastic) => Some(elastic),
            _ => None,
        }
    }

    /// Rotates what is stated in the axes of the base to a new base; `new_from_old` is the old base seen from the new one,
    /// and `chain` is the calibrated chain in the new base.
    pub(crate) fn turn_base(&mut self, new_from_old: &Pose<f64>, chain: &Poe<f64>) {
        if let Self::Elastic(elastic) = self {
            elastic.turn_base(new_from_old, chain);
        }
    }

    /// Returns `base_from_target` of the first tool with the unlimited correction, and the correction as a twist in the base
    /// frame.
    pub(crate) fn corrected<F>(
        &self,
        chain: &Poe<f64>,
        sample: &Sample<F>,
    ) -> (Pose<f64>, Twist<f64>) {
        match self {
            Self::None => (chain.forward(&sample.serial_joints), Twist::zero()),
            Self::TaskSpace(task_space) => {
                let pose = chain.forward(&sample.serial_joints);
                let twist = task_space.twist(sample);
                (pose.corrected(&twist), twist)
            }
            Self::Elastic(elastic) => elastic.corrected(chain, &sample.joints, sample.payload_kg),
        }
    }
}
