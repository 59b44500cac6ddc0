//! Fits base and tool frames that were set up again after the calibration to new measurements.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::{Pose, Twist};

use crate::blob::predict::BlobModel;
use crate::identification::base_tools::{fit_base_and_tools, tool_count};
use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::identification::parametric::state::ROWS;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::{InstrumentSample, different_poses};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::rotation::{aligned, nearest_rotation};
use crate::numeric::statistics::PoseError;
pub use crate::numeric::statistics::evenly_spaced;

/// Number of Gauss–Newton steps that refine base and tools; from a start within a milliradian two are enough.
const STEPS: usize = 6;
/// Damping as a share of the largest diagonal element: what the poses do not identify stays unchanged.
const DAMPING: f64 = 1e-12;
/// Position error in m and rotation error in rad that have the same weight.
const WEIGHTS: NoiseScales = NoiseScales::TRACKER;
/// A prediction component whose standard deviation exceeds the measurements' by more than this factor is undetermined.
const UNDETERMINED: f64 = 30.0;
/// Equations that are required beyond the number of fitted parameters if the fitted rows are also compared: one pose.
const SPARE: usize = ROWS;

/// Which frames are fitted to new measurements, and to which rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FramesToFit {
    /// Whether `instrument_from_base` is fitted because the instrument was moved.
    pub base: bool,
    /// Whether the frames of tools that the blob does not know (remounted or new targets) are fitted.
    pub tools: bool,
    /// Number of rows of each tool, evenly spread, that the frames are fitted to and that are then not compared. `None`: the
    /// frames are fitted to all rows, which are also compared.
    pub rows: Option<usize>,
}

/// Base and tool frames at which a blob's predictions are compared with measurements.
#[derive(Clone, Debug)]
pub struct FittedFrames {
    /// `instrument_from_base`.
    pub instrument_from_base: Pose<f64>,
    /// `first_target_from_target` of each tool.
    pub tools: Vec<Pose<f64>>,
    /// Whether the base was fitted.
    pub is_base_fitted: bool,
    /// Whether each tool was fitted.
    pub is_tool_fitted: Vec<bool>,
    /// Indices of the samples that the frames were fitted to and that must not be compared.
    pub left_out: Vec<usize>,
}

/// Why frames cannot be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The fit would use all rows of a tool and leave none to compare.
    #[error("{rows} rows of tool {}: fitting to {wanted} leaves none to compare", tool + 1)]
    NothingLeft {
        /// Index of the tool, counted from 0.
        tool: usize,
        /// Number of rows of the tool.
        rows: usize,
        /// Number of rows requested for the fit.
        wanted: usize,
    },
    /// The samples give hardly more equations than there are fitted parameters.
    #[error("{poses} different poses for {numbers} fitted numbers")]
    TooFew {
        /// Number of rows that differ in joints, payload or tool.
        poses: usize,
        /// Number of fitted parameters.
        numbers: usize,
        /// Least number of poses that are needed.
        needed: usize,
    },
    /// The poses do not determine the frames well enough to predict other poses.
    #[error("poses that do not determine the fitted frames")]
    Undetermined,
}

impl FramesToFit {
    /// Returns the indices of the samples that the frames are fitted to and that are not compared.
    fn left_out(
        self,
        samples: &[InstrumentSample],
        is_tool_fitted: &[bool],
    ) -> Result<Vec<usize>, FrameError> {
        let mut out = Vec::new();
        let Some(count) = self.rows else {
            return Ok(out);
        };
        for (tool, is_fitted) in is_tool_fitted.iter().enumerate() {
            let is_own = |i: &usize| (*is_fitted || self.base) && samples[*i].tool == tool;
            let own: Vec<usize> = (0..samples.len()).filter(is_own).collect();
            if !own.is_empty() && own.len() <= count {
                return Err(FrameError::NothingLeft {
                    tool,
                    rows: own.len(),
                    wanted: count,
                });
            }
            out.extend(evenly_spaced(&own, count));
        }
        Ok(out)
    }
}

impl FittedFrames {
    /// Fits the frames that `which` selects and keeps the blob's base and the given `tools` otherwise; the first `tools` are
    /// those that the blob knows. The base is also fitted if the model knows no instrument
    /// ([`BlobModel::knows_instrument`]).
    pub fn new(
        blob: &BlobModel,
        samples: &[InstrumentSample],
        mut tools: Vec<Pose<f64>>,
        which: FramesToFit,
    ) -> Result<Self, FrameError> {
        let which = FramesToFit {
            base: which.base || !blob.knows_instrument(),
            ..which
        };
        let (known, count) = (blob.tools().len(), tools.len().max(tool_count(samples)));
        let is_new = |tool: usize| which.tools && tool >= known;
        let is_tool_fitted: Vec<bool> = (0..count).map(is_new).collect();
        tools.resize_with(count, Pose::identity);
        let mut out = Self {
            instrument_from_base: blob.instrument_from_base(),
            tools,
            is_base_fitted: which.base,
            left_out: which.left_out(samples, &is_tool_fitted)?,
            is_tool_fitted,
        };
        if !out.is_any_fitted() {
            return Ok(out);
        }
        let fitted: Vec<InstrumentSample> = match out.left_out.as_slice() {
            [] => samples.to_vec(),
            rows => rows.iter().map(|i| samples[*i].clone()).collect(),
        };
        let mut registered = Registered::new(blob, &fitted, &out);
        registered.start();
        for _ in 0..STEPS {
            registered.refine();
        }
        let information = registered.information();
        out = registered.frames;
        if out.left_out.is_empty() {
            out.enough(&fitted)?;
        } else if !Registered::new(blob, samples, &out).is_determined(information) {
            return Err(FrameError::Undetermined);
        }
        Ok(out)
    }

    /// Returns whether any frame was fitted.
    pub fn is_any_fitted(&self) -> bool {
        self.is_base_fitted || self.is_tool_fitted.contains(&true)
    }

    /// Rejects samples that have hardly more equations than there are fitted parameters.
    fn enough(&self, samples: &[InstrumentSample]) -> Result<(), FrameError> {
        let each = samples.iter().map(|s| s.observation.equations()).max();
        let each = each.unwrap_or(ROWS);
        let tools = self.is_tool_fitted.iter().filter(|fitted| **fitted).count();
        let numbers = 6 * usize::from(self.is_base_fitted) + each * tools;
        let (poses, needed) = (different_poses(samples), (numbers + SPARE).div_ceil(each));
        if poses < needed {
            return Err(FrameError::TooFew {
                poses,
                numbers,
                needed,
            });
        }
        Ok(())
    }
}

/// The predictions of a blob at samples, for one base and one set of tools.
pub struct Registered<'a> {
    /// The blob.
    pub blob: &'a BlobModel,
    /// The measurements.
    pub samples: &'a [InstrumentSample],
    /// `base_from_first_target` of every sample.
    first: Vec<Pose<f64>>,
    /// The base and tool frames.
    pub frames: FittedFrames,
}

impl<'a> Registered<'a> {
    /// Predicts the samples with the given frames.
    pub fn new(
        blob: &'a BlobModel,
        samples: &'a [InstrumentSample],
        frames: &FittedFrames,
    ) -> Self {
        Self {
            first: samples
                .iter()
                .map(|s| base_from_first_target(blob, s, s.payload_kg))
                .collect(),
            frames: frames.clone(),
            blob,
            samples,
        }
    }

    /// Sets initial values of the frames that are fitted.
    fn start(&mut self) {
        let frames = &self.frames;
        match (frames.is_base_fitted, frames.is_tool_fitted.contains(&true)) {
            (true, true) => self.start_both(),
            (true, false) => {
                let from: Vec<_> = (0..self.samples.len())
                    .map(|k| self.in_base(k).translation)
                    .collect();
                let to: Vec<_> = self
                    .samples
                    .iter()
                    .map(|s| s.observation.position())
                    .collect();
                self.frames.instrument_from_base = aligned(&from, &to);
            }
            _ => self.start_tools(),
        }
    }

    /// Computes base and tools without an initial value, from the calibrated chain, as the base-tool calibration does.
    fn start_both(&mut self) {
        let found = fit_base_and_tools(&self.blob.chain(), self.samples);
        self.frames.instrument_from_base = found.instrument_from_base;
        let tools = self.frames.tools.iter_mut().zip(found.flange_from_targets);
        for ((tool, fitted), is_fitted) in tools.zip(&self.frames.is_tool_fitted) {
            if *is_fitted {
                *tool = fitted;
            }
        }
    }

    /// Sets each tool to the mean of its measured targets, seen from the predicted first target, with the mean rotation
    /// projected to the nearest rotation. If all are positions alone, the rotation is that of the first target.
    fn start_tools(&mut self) {
        let frames = &mut self.frames;
        for (tool, frame) in frames.tools.iter_mut().enumerate() {
            if !frames.is_tool_fitted[tool] {
                continue;
            }
            let (mut turn, mut shift, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
            let mut whole = 0;
            let own = |(s, _): &(&InstrumentSample, &Pose<f64>)| s.tool == tool;
            for (sample, first) in self.samples.iter().zip(&self.first).filter(own) {
                let from_instrument = (frames.instrument_from_base * *first).inverse();
                let seen = sample.observation.transformed(&from_instrument);
                shift += seen.position();
                count += 1.0;
                if let Some(pose) = seen.pose() {
                    turn += pose.rotation;
                    whole += 1;
                }
            }
            if count > 0.0 {
                *frame = Pose {
                    rotation: match whole {
                        0 => Matrix3::identity(),
                        _ => nearest_rotation(&turn),
                    },
                    translation: shift / count,
                };
            }
        }
    }

    /// Returns the predicted `base_from_target` of sample `k`.
    fn in_base(&self, k: usize) -> Pose<f64> {
        self.first[k] * self.frames.tools[self.samples[k].tool]
    }

    /// Returns the Jacobian of the predictions by the twists of base and tools, in units of [`WEIGHTS`]; columns of frames
    /// that are not fitted are zero.
    fn effects(&self) -> Mat<f64> {
        let mut a = Mat::zeros(ROWS * self.samples.len(), 6 + 6 * self.frames.tools.len());
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
                if self.frames.is_base_fitted {
                    put(i, unit);
                }
                if self.frames.is_tool_fitted[sample.tool] {
                    put(
                        6 + 6 * sample.tool + i,
                        self.first[k].transform_twist(&unit),
                    );
                }
            }
        }
        a
    }

    /// Returns the damped normal matrix of [`Self::effects`].
    fn information(&self) -> Mat<f64> {
        let a = self.effects();
        let mut normal = product(Transposed(&a), &a);
        let count = normal.nrows();
        let largest = (0..count).map(|i| normal[(i, i)]).fold(0.0, f64::max);
        for i in 0..count {
            normal[(i, i)] += DAMPING * largest;
        }
        normal
    }

    /// Does one Gauss–Newton step of the fitted frames.
    fn refine(&mut self) {
        let Ok(factor) = Factor::new(self.information(), 1) else {
            return;
        };
        let a = self.effects();
        let step = factor.solve(&product(Transposed(&a), &self.residuals(WEIGHTS)));
        let twist = |at: usize| Twist::from_array(&std::array::from_fn(|i| step[(at + i, 0)]));
        let base = &mut self.frames.instrument_from_base;
        *base = *base * Pose::exp(&twist(0));
        for (i, tool) in self.frames.tools.iter_mut().enumerate() {
            *tool = Pose::exp(&twist(6 + 6 * i)) * *tool;
        }
    }

    /// Returns whether frames that were fitted with this `information` predict every component of these samples with an
    /// uncertainty of at most [`UNDETERMINED`] times that of the measurements.
    fn is_determined(&self, information: Mat<f64>) -> bool {
        let Ok(factor) = Factor::new(information, 1) else {
            return false;
        };
        let a = self.effects();
        let spread = product(&a, &factor.inverse());
        let variance =
            |row: usize| -> f64 { (0..a.ncols()).map(|j| spread[(row, j)] * a[(row, j)]).sum() };
        (0..a.nrows()).all(|row| variance(row) <= UNDETERMINED * UNDETERMINED)
    }

    /// Returns the residuals, measured minus predicted: displacement and rotation at the target along the axes of the base,
    /// in units of the scales of each row; zeros where an orientation was not measured.
    pub fn residuals(&self, scales: NoiseScales) -> Mat<f64> {
        let base_from_instrument = self.frames.instrument_from_base.inverse();
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

    /// Returns the error of each prediction.
    pub fn errors(&self) -> Vec<PoseError> {
        let predicted = self.predicted();
        let pairs = self.samples.iter().zip(&predicted);
        pairs.map(|(s, pose)| s.observation.error(pose)).collect()
    }

    /// Returns the predicted `instrument_from_target` of each sample.
    pub fn predicted(&self) -> Vec<Pose<f64>> {
        let of = |k: usize| self.frames.instrument_from_base * self.in_base(k);
        (0..self.samples.len()).map(of).collect()
    }
}

/// Predicts `base_from_first_target` of a sample, as the device does.
pub fn base_from_first_target(
    blob: &BlobModel,
    sample: &InstrumentSample,
    payload_kg: Option<f64>,
) -> Pose<f64> {
    let in_instrument = blob.predict(&sample.joints, payload_kg).pose;
    blob.instrument_from_base().inverse() * in_instrument
}
