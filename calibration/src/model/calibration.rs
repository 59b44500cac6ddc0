//! A calibrated robot in `f64`.

use poegp_protocol::limits::OUTPUTS;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tools::{BaseAndTools, UNKNOWN_TOOL};
use crate::identification::frame_fit::{FrameFit, ResidualFrame, residual_components};
use crate::learning::elastic::device_variance::around;
use crate::learning::elastic::options::OutlierPolicy;
use crate::learning::elastic::outliers::Outlier;
use crate::learning::elastic::predictive_variance::Uncertainty;
use crate::learning::elastic::warm_up::WarmUp;
use crate::measurement::sample::{BaseSample, InstrumentSample, Sample, in_base_frame};
use crate::model::config::Config;
use crate::model::correction::Correction;
use crate::model::gauge::Gauge;
use crate::model::methods::problem::FrameEstimate;

/// A calibrated robot in `f64`.
#[derive(Debug)]
pub struct Calibration {
    /// The settings that the calibration was made with.
    pub config: Config,
    /// The gauge: the base and tool frames that the model is stated in.
    pub gauge: Gauge,
    /// Base and tools on the nominal robot, in `gauge`.
    pub base_and_tools: BaseAndTools,
    /// Calibrated `first_target_from_target` of each tool.
    pub tools: Vec<Pose<f64>>,
    /// The nominal chain from base to target.
    pub nominal: Poe<f64>,
    /// The calibrated chain from base to target.
    pub calibrated: Poe<f64>,
    /// The correction that the model adds to the chain.
    pub correction: Correction,
    /// How the frames were estimated.
    pub estimate: FrameEstimate,
    /// Outliers, by the index of their measurement; `config.outliers` says whether they were trained on.
    pub outliers: Vec<Outlier>,
    /// The warm-up that the evidence shows; it was removed from the training samples if its report says so.
    pub warm_up: Option<WarmUp>,
    /// Standard deviation of one position and one rotation component of a new measurement, in m and rad, for models whose
    /// deviation is the same for all poses: the RMS of the residuals times m/(m − p), with p parameters and m components.
    pub constant_deviation: (f64, f64),
    /// The correction limit: displacement in m and angle in rad.
    pub correction_limit: (f64, f64),
}

impl Calibration {
    /// Returns the measurements of `all` that the model was trained on.
    pub fn trained_on<F: Clone>(&self, all: &[Sample<F>]) -> Vec<Sample<F>> {
        let rejects = self.config.outliers == OutlierPolicy::Reject;
        let is_kept = |i: usize| !rejects || !self.outliers.iter().any(|o| o.sample == i);
        let kept = all.iter().enumerate().filter(|(i, _)| is_kept(*i));
        kept.map(|(_, sample)| sample.clone()).collect()
    }

    /// Returns the warm-up if it was removed from the training samples.
    pub(super) fn removed_warm_up(&self) -> Option<&WarmUp> {
        self.warm_up.as_ref().filter(|w| w.report.removed)
    }

    /// Removes the warm-up from `samples` of the training file if the training removed it, too; otherwise returns them
    /// unchanged.
    pub fn without_warm_up(&self, samples: Vec<InstrumentSample>) -> Vec<InstrumentSample> {
        let Some(warm_up) = self.removed_warm_up() else {
            return samples;
        };
        let instrument_from_base = &self.base_and_tools.instrument_from_base;
        let own = in_base_frame(&samples, instrument_from_base);
        let corrected = warm_up.removed_from(&own).into_iter();
        let seen = |(sample, own): (InstrumentSample, BaseSample)| InstrumentSample {
            observation: own.observation.transformed(instrument_from_base),
            ..sample
        };
        samples.into_iter().zip(corrected).map(seen).collect()
    }

    /// Returns the report of the least-squares fit of the frames, if there was one.
    pub fn frame_fit(&self) -> Option<&FrameFit> {
        match &self.estimate {
            FrameEstimate::LeastSquares(fit) => Some(fit),
            _ => None,
        }
    }

    /// Predicts `base_from_target` of the sample's tool with the f64 model, without the correction limit; not a number for a
    /// tool that was not calibrated.
    pub fn predict<F>(&self, sample: &Sample<F>) -> Pose<f64> {
        let first = self.correction.corrected(&self.calibrated, sample).0;
        self.with_tool(first, sample.tool)
    }

    /// Converts the pose of the first tool to that of tool `tool`.
    fn with_tool(&self, first: Pose<f64>, tool: usize) -> Pose<f64> {
        match tool {
            0 => first,
            tool => first * self.tools.get(tool).copied().unwrap_or(UNKNOWN_TOOL),
        }
    }

    /// Returns the predictive standard deviation of a new measurement: position along the axes of the base frame in metres,
    /// rotation about them in radians. The elastic model computes it from parameters, processes and noise, the task-space
    /// process from eq. 7 and its noise; the chain alone has one value for all poses.
    pub fn standard_deviation<F: Clone>(&self, sample: &Sample<F>) -> Option<[f64; OUTPUTS]> {
        if let FrameEstimate::Parametric {
            uncertainty: Some(uncertainty),
            ..
        } = &self.estimate
        {
            let sample = sample.clone().with_noise(self.config.instrument_noise());
            return Some(uncertainty.standard_deviation(&sample));
        }
        if let Correction::TaskSpace(task_space) = &self.correction {
            let first = self.calibrated.forward(&sample.serial_joints);
            let tool = self.with_tool(first, sample.tool);
            return Some(task_space.standard_deviation(sample, &tool));
        }
        let (p, r) = self.constant_deviation;
        Some([p, p, p, r, r, r])
    }

    /// Returns whether the standard deviation depends on the pose.
    pub fn has_local_deviation(&self) -> bool {
        match &self.estimate {
            FrameEstimate::Parametric { uncertainty, .. } => uncertainty.is_some(),
            _ => matches!(self.correction, Correction::TaskSpace(_)),
        }
    }

    /// Returns whether processes describe what the geometry cannot, so that the noise is that of the measurement alone.
    pub fn has_processes(&self) -> bool {
        match &self.estimate {
            FrameEstimate::Parametric { parameters, .. } => parameters.is_none(),
            _ => matches!(self.correction, Correction::TaskSpace(_)),
        }
    }

    /// Computes the standard deviation of new poses from the residuals of the training `samples`, one of each pose, by
    /// generalised cross-validation (Golub, Heath and Wahba 1979): their RMS times m/(m − p), with p parameters fitted to m
    /// components. Where it is known how many parameters the positions and the rotations determine, each has a factor of its own. A model that knows its
    /// deviation everywhere states no less than its root mean square over the trained ranges: poses may be few, or alike.
    pub(super) fn constant_deviation_of(&self, samples: &[BaseSample]) -> (f64, f64) {
        let components: usize = samples.iter().map(|s| s.observation.equations()).sum();
        let of_positions = (3 * samples.len()) as f64;
        let of_rotations = components as f64 - of_positions;
        // Parameters can follow all rows to the last digit: residuals and what is left of m then fall alike.
        let factor = |components: f64, parameters: f64| {
            components.max(1.0) / (components - parameters).max(1e-9)
        };
        let factors = match self.estimate {
            FrameEstimate::Parametric {
                parameters: Some([by_positions, by_rotations]),
                ..
            } => (
                factor(of_positions, by_positions),
                factor(of_rotations, by_rotations),
            ),
            _ => {
                let method = self.config.method.implementation();
                let other_tools = self.tools.len().saturating_sub(1);
                let parameters = method.parameters(self.nominal.kinds().len()) + 6 * other_tools;
                let both = factor(components as f64, parameters as f64);
                (both, both)
            }
        };
        let (position, rotation) = self.rms(samples);
        let of_residuals = (factors.0 * position, factors.1 * rotation);
        let (position, rotation) = match &self.estimate {
            FrameEstimate::Parametric {
                uncertainty: Some(known),
                parameters: Some(_),
            } if self.config.device_variance => self.rms_over_ranges(known, samples),
            _ => of_residuals,
        };
        let is_turned = of_rotations > 0.0;
        (
            of_residuals.0.max(position),
            of_residuals.1.max(if is_turned { rotation } else { 0.0 }),
        )
    }

    /// Returns the root mean square of the `known` deviations over the ranges of the samples, in m and rad.
    fn rms_over_ranges(&self, known: &Uncertainty, samples: &[BaseSample]) -> (f64, f64) {
        let elastic = self.correction.elastic();
        let coupling = elastic.and_then(|model| model.coupling.as_ref());
        let noise = self.config.instrument_noise();
        let all: Vec<[f64; OUTPUTS]> = around(samples, coupling, 1.0)
            .into_iter()
            .map(|pose| known.standard_deviation(&pose.with_noise(noise)))
            .collect();
        let rms = |first: usize| {
            let squares = all.iter().flat_map(|d| &d[first..first + 3]).map(|d| d * d);
            (squares.sum::<f64>() / (3 * all.len()) as f64).sqrt()
        };
        (rms(0), rms(3))
    }

    /// Computes the RMS of one position and one rotation component of the residuals of `samples`, in m and rad.
    fn rms(&self, samples: &[BaseSample]) -> (f64, f64) {
        let of = |s: &BaseSample| {
            residual_components(
                ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
                &s.observation,
                &self.predict(s),
            )
        };
        let (mut position, mut orientation, mut whole) = (0.0, 0.0, 0);
        for sample in samples {
            let r = of(sample);
            position += r[..3].iter().map(|x| x * x).sum::<f64>();
            if sample.observation.has_orientation() {
                orientation += r[3..].iter().map(|x| x * x).sum::<f64>();
                whole += 1;
            }
        }
        let rms = |sum: f64, n: usize| (sum / (3 * n).max(1) as f64).sqrt();
        (rms(position, samples.len()), rms(orientation, whole))
    }

    /// Returns the correction limit in m and rad: the one that `config` sets, otherwise twice the largest correction of
    /// `samples`.
    pub(super) fn limit(&self, samples: &[BaseSample]) -> (f64, f64) {
        let (mut displacement, mut angle) = (0.0_f64, 0.0_f64);
        for sample in samples {
            let (_, twist) = self.correction.corrected(&self.calibrated, sample);
            let point = self.calibrated.forward(&sample.serial_joints).translation;
            displacement = displacement.max(twist.at_point(&point).linear.norm());
            angle = angle.max(twist.angular.norm());
        }
        let asked = |value: Option<f64>, twice| value.map_or(twice, |x| 1e-3 * x);
        (
            asked(self.config.max_correction_mm, 2.0 * displacement),
            asked(self.config.max_correction_mrad, 2.0 * angle),
        )
    }
}
