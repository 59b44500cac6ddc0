//! A blob's predictions at the poses of a check, with a base or tools that were set up again fitted first.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::blob::predict::BlobModel;
use crate::blob::tool_fit::fit_tool_frame;
use crate::identification::base_tools::{aligned, fit_base_and_tools};
use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::identification::parametric::state::ROWS;
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::PoseError;
use crate::verification::options::Options;

/// Steps in which base and tools are refined; from a start within a milliradian two are enough.
const STEPS: usize = 6;
/// Damping, of the largest element: what the poses do not identify stays as it was.
const DAMPING: f64 = 1e-12;
/// Metres and radians that count alike: a tracker's noise.
const WEIGHTS: NoiseScales = NoiseScales::uniform(30e-6, 50e-6);
/// Part of the trained range of payloads by which the payload is changed to see what it does.
const PAYLOAD_STEP: f64 = 0.25;

/// The blob, the samples, and where base and tools are.
pub struct RegisteredResiduals<'a> {
    loaded: &'a BlobModel,
    /// The measurements.
    pub samples: &'a [InstrumentSample],
    /// `base_from_first_target` of every sample.
    first: Vec<Pose<f64>>,
    /// `instrument_from_base`.
    base: Pose<f64>,
    /// `first_target_from_target` of every tool.
    pub tools: Vec<Pose<f64>>,
}

impl<'a> RegisteredResiduals<'a> {
    /// With base and tools of the blob, or fitted as `options` say.
    pub fn new(
        loaded: &'a BlobModel,
        samples: &'a [InstrumentSample],
        tools: Vec<Pose<f64>>,
        options: &Options,
    ) -> Self {
        let mut out = Self {
            first: samples
                .iter()
                .map(|s| predicted(loaded, s, s.payload_kg))
                .collect(),
            base: loaded.instrument_from_base(),
            loaded,
            samples,
            tools,
        };
        if !(options.refit_base || options.refit_tool) {
            return out;
        }
        match (options.refit_base, options.refit_tool) {
            (true, true) => out.start_both(),
            (true, false) => {
                let from: Vec<_> = (0..samples.len())
                    .map(|k| out.in_base(k).translation)
                    .collect();
                let to: Vec<_> = samples.iter().map(|s| s.observation.position()).collect();
                out.base = aligned(&from, &to);
            }
            _ => {
                for tool in 0..out.tools.len() {
                    let own: Vec<&InstrumentSample> =
                        samples.iter().filter(|s| s.tool == tool).collect();
                    if !own.is_empty() {
                        out.tools[tool] = fit_tool_frame(loaded, &own);
                    }
                }
            }
        }
        for _ in 0..STEPS {
            out.refine(options);
        }
        out
    }

    /// Base and tools from nothing, by the calibrated chain as the base-tool calibration does it.
    fn start_both(&mut self) {
        let blob = self.loaded.blob();
        let kinds: Vec<JointKind> = blob.robot.joints.iter().map(|j| j.kind).collect();
        let frames: Vec<Pose<f64>> = blob
            .geometry
            .calibrated
            .iter()
            .map(|f| Pose::<f32>::from_rows(f).cast())
            .collect();
        if let Ok(chain) = Poe::new(&kinds, &frames) {
            let found = fit_base_and_tools(&chain, self.samples);
            self.base = found.instrument_from_base;
            for (tool, fitted) in self.tools.iter_mut().zip(found.flange_from_targets) {
                *tool = fitted;
            }
        }
    }

    /// `base_from_target` of a sample.
    fn in_base(&self, k: usize) -> Pose<f64> {
        let tool = self.tools.get(self.samples[k].tool);
        self.first[k] * tool.copied().unwrap_or_else(Pose::identity)
    }

    /// One Gauss–Newton step of what is fitted.
    fn refine(&mut self, options: &Options) {
        let count = 6 + 6 * self.tools.len();
        let residuals = self.residuals(WEIGHTS);
        let mut a = Mat::zeros(ROWS * self.samples.len(), count);
        for (k, sample) in self.samples.iter().enumerate() {
            let target = self.in_base(k).translation;
            let mut put = |column: usize, twist: Twist<f64>| {
                let at = twist.at_point(&target).to_array();
                let rows = sample.observation.equations();
                for (row, value) in at.iter().enumerate().take(rows) {
                    let unit = if row < 3 {
                        WEIGHTS.position
                    } else {
                        WEIGHTS.orientation
                    };
                    a[(ROWS * k + row, column)] = value / unit;
                }
            };
            for i in 0..6 {
                let unit = Twist::from_array(&std::array::from_fn(|j| f64::from(u8::from(i == j))));
                if options.refit_base {
                    put(i, unit);
                }
                if options.refit_tool {
                    put(
                        6 + 6 * sample.tool + i,
                        self.first[k].transform_twist(&unit),
                    );
                }
            }
        }
        let mut normal = a.transpose() * &a;
        let largest = (0..count).map(|i| normal[(i, i)]).fold(0.0, f64::max);
        for i in 0..count {
            normal[(i, i)] += DAMPING * largest;
        }
        let Ok(factor) = normal.llt(Side::Lower) else {
            return;
        };
        let step = factor.solve(a.transpose() * residuals);
        let twist = |at: usize| Twist::from_array(&std::array::from_fn(|i| step[(at + i, 0)]));
        self.base = self.base * Pose::exp(&twist(0));
        for (i, tool) in self.tools.iter_mut().enumerate() {
            *tool = Pose::exp(&twist(6 + 6 * i)) * *tool;
        }
    }

    /// Measured less predicted, displacement and rotation at the target along the axes of the base, in units of the
    /// scales of each row; zeros where an orientation was not measured.
    pub fn residuals(&self, scales: NoiseScales) -> Mat<f64> {
        let base_from_instrument = self.base.inverse();
        let mut out = Mat::zeros(ROWS * self.samples.len(), 1);
        for (k, sample) in self.samples.iter().enumerate() {
            let kind = ResidualFrame::ToolPoint(scales.of(sample));
            let measured = sample.observation.transformed(&base_from_instrument);
            let all = residual_components(kind, &measured, &self.in_base(k));
            for (row, value) in all.into_iter().enumerate() {
                out[(ROWS * k + row, 0)] = value;
            }
        }
        out
    }

    /// What a kilogram more does, in units of the scales of each row; `None` when the payload does not vary for the model
    /// or is not known.
    pub fn payload_effect(&self, scales: NoiseScales) -> Option<Mat<f64>> {
        let (light, heavy) = self.loaded.blob().ranges.payload_kg?;
        let (light, heavy) = (f64::from(light), f64::from(heavy));
        if heavy <= light {
            return None;
        }
        let step = PAYLOAD_STEP * (heavy - light);
        let mut out = Mat::zeros(ROWS * self.samples.len(), 1);
        for (k, sample) in self.samples.iter().enumerate() {
            let m = sample.payload_kg?.clamp(light, heavy);
            let (less, more) = ((m - step).max(light), (m + step).min(heavy));
            let tool = self.tools.get(sample.tool).copied();
            let pose = |kg: f64| {
                predicted(self.loaded, sample, Some(kg)) * tool.unwrap_or_else(Pose::identity)
            };
            let kind = ResidualFrame::ToolPoint(scales.of(sample));
            let rows = sample.observation.equations();
            let all = residual_components(kind, &Observation::Pose(pose(more)), &pose(less));
            for (row, value) in all.into_iter().enumerate().take(rows) {
                out[(ROWS * k + row, 0)] = value / (more - less);
            }
        }
        Some(out)
    }

    /// The error of each prediction.
    pub fn errors(&self) -> Vec<PoseError> {
        let of = |(k, sample): (usize, &InstrumentSample)| {
            sample.observation.error(&(self.base * self.in_base(k)))
        };
        self.samples.iter().enumerate().map(of).collect()
    }
}

/// `base_from_first_target` as the device has it.
fn predicted(loaded: &BlobModel, sample: &InstrumentSample, payload_kg: Option<f64>) -> Pose<f64> {
    let in_instrument = loaded.predict(&sample.joints, payload_kg).pose;
    loaded.instrument_from_base().inverse() * in_instrument
}
