//! The input and output of every calibration method: [`Problem`] and [`Fit`].

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde::{Deserialize, Serialize};

use crate::identification::base_tools::tool_count;
use crate::identification::frame_fit::FrameFit;
use crate::identification::parametric::gear_line::GearLine;
use crate::learning::elastic::options::ElasticOptions;
use crate::learning::elastic::outliers::{Outlier, gross_outliers};
use crate::learning::elastic::predictive_variance::Uncertainty;
use crate::learning::elastic::warm_up::WarmUp;
use crate::learning::task_space::fit::{HyperparameterSharing, SignalVarianceLimit};
use crate::measurement::repeats::Repeats;
use crate::measurement::sample::{BaseSample, Sample};
use crate::measurement::shared_range::shared_payload;
use crate::model::correction::Correction;
use crate::model::error::CalibrationError;
use crate::progress::FitContext;

/// Bytes that a fit needs for one pose and its linear equations.
pub(super) const FOR_A_POSE: u64 = 10_000;

/// A calibration method.
pub trait CalibrationMethod: Sync {
    /// Returns what the method requires of the data.
    fn requires(&self) -> DataRequirements {
        DataRequirements::default()
    }

    /// Returns an upper limit on the identifiable parameters of a robot with `joints` joints: 4 for each revolute joint, 6
    /// for the tool.
    fn parameters(&self, joints: usize) -> usize {
        4 * joints + 6
    }

    /// Returns the least number of whole poses that a robot with `joints` joints needs: equations for all parameters, and
    /// six more.
    fn min_poses(&self, joints: usize) -> usize {
        self.parameters(joints).div_ceil(6) + 1
    }

    /// Returns the largest number of poses that the method accepts, if there is a limit.
    fn max_poses(&self) -> Option<usize> {
        None
    }

    /// Returns the memory that a fit to `poses` poses takes, in bytes.
    fn memory(&self, poses: usize, _hyperparameters: HyperparameterSharing) -> u64 {
        FOR_A_POSE * poses as u64
    }

    /// Fits the model.
    fn fit(&self, problem: &Problem, context: &FitContext) -> Result<Fit, CalibrationError>;
}

/// Returns `first_target_from_target` of every tool.
pub(crate) fn seen_from_first(tools: &[Pose<f64>]) -> Vec<Pose<f64>> {
    tools.iter().map(|t| tools[0].inverse() * *t).collect()
}

/// What a method requires of the data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DataRequirements {
    /// Whether every measurement must be a whole pose, not a position alone.
    pub whole_poses: bool,
    /// Whether every measurement must have a payload.
    pub payload: bool,
}

impl DataRequirements {
    /// Returns whether `samples` meet the requirements.
    pub fn are_met_by<F>(&self, samples: &[Sample<F>]) -> bool {
        (!self.whole_poses || has_whole_poses(samples))
            && (!self.payload || samples.iter().all(|s| s.payload_kg.is_some()))
    }
}

pub(crate) fn has_whole_poses<F>(samples: &[Sample<F>]) -> bool {
    samples.iter().all(|s| s.observation.has_orientation())
}

pub(super) fn has_whole_poses_of_one_tool<F>(samples: &[Sample<F>]) -> bool {
    tool_count(samples) == 1 && has_whole_poses(samples)
}

/// How poses are weighted in the frame fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// All poses have the same weight, as in the paper: the residual is the spatial twist in metres and radians.
    #[default]
    None,
    /// Poses are weighted by the noise of position and rotation, with the rotation taken at the tool point.
    Noise,
}

/// The problem that a method solves: samples in the base frame of the base-tool fit, and the settings.
pub struct Problem<'a> {
    /// The nominal chain from base to the first target.
    pub nominal: Poe<f64>,
    /// `joint_n_from_target` of every tool on the nominal robot.
    pub tools: Vec<Pose<f64>>,
    /// Joint coupling C, with q_serial = C q.
    pub coupling: Option<&'a Vec<Vec<f64>>>,
    /// Gear lines that the robot's description states.
    pub gear_lines: Vec<GearLine>,
    /// The measured poses, as `base_from_target`: the mean of the measurements of each.
    pub samples: Vec<BaseSample>,
    /// All measurements, as `base_from_target`.
    pub measurements: Vec<BaseSample>,
    /// The measurements of each pose.
    pub repeats: Repeats,
    /// How poses are weighted in the frame fit.
    pub weighting: Weighting,
    /// How the outputs of the task-space process share their hyperparameters.
    pub hyperparameters: HyperparameterSharing,
    /// Limit on the signal variance of the task-space process.
    pub signal_variance: &'a SignalVarianceLimit,
    /// Options of the elastic fit.
    pub elastic: ElasticOptions,
}

impl Problem<'_> {
    /// Converts outliers among the poses to outliers among the measurements: all measurements of those poses.
    pub(crate) fn of_measurements(&self, outliers: &[Outlier]) -> Vec<Outlier> {
        let rows = |outlier: &Outlier| {
            let rows = self.repeats.rows(outlier.sample).to_vec();
            let outlier = *outlier;
            rows.into_iter()
                .map(move |sample| Outlier { sample, ..outlier })
        };
        outliers.iter().flat_map(rows).collect()
    }

    /// Returns the gross outliers: samples that no geometry with gravity terms explains. Those that share a payload are none:
    /// they show how the arm gives way under it.
    pub(crate) fn gross_outliers(&self) -> Vec<Outlier> {
        let (tools, samples) = (&self.tools, &self.samples);
        let mut found = gross_outliers(&self.nominal, tools, self.coupling, samples, &self.elastic);
        let payloads: Vec<Option<f64>> = samples.iter().map(|s| s.payload_kg).collect();
        let rows: Vec<usize> = found.iter().map(|outlier| outlier.sample).collect();
        if let Some(payload) = shared_payload(&payloads, &rows) {
            found.retain(|outlier| payloads[outlier.sample] != Some(payload));
        }
        found
    }
}

/// A fitted model.
pub struct Fit {
    /// The calibrated chain from base to the first target.
    pub chain: Poe<f64>,
    /// `first_target_from_target` of every tool.
    pub tools: Vec<Pose<f64>>,
    /// The correction that the model adds to the chain.
    pub correction: Correction,
    /// How the frames were estimated.
    pub estimate: FrameEstimate,
    /// Outliers that the method itself found among its samples, by the index of the sample.
    pub outliers: Vec<Outlier>,
    /// The warm-up that the evidence shows.
    pub warm_up: Option<WarmUp>,
}

impl Fit {
    /// Predicts `base_from_target` of the sample's tool by the chain alone.
    pub(super) fn predict(&self, sample: &BaseSample) -> Pose<f64> {
        let first = self.chain.forward(&sample.serial_joints);
        match sample.tool {
            0 => first,
            tool => first * self.tools[tool],
        }
    }
}

/// How the frames of a calibration were estimated.
#[derive(Debug)]
pub enum FrameEstimate {
    /// They were not estimated: the frames are the nominal ones.
    Nominal,
    /// They were estimated by least squares over all frames.
    LeastSquares(FrameFit),
    /// They were estimated together with all other parameters of the elastic model.
    Parametric {
        /// The predictive covariance, if there are processes.
        uncertainty: Option<Box<Uncertainty>>,
        /// Effective numbers of parameters that positions and rotations determine, where they are not the method's.
        parameters: Option<[f64; 2]>,
    },
}
