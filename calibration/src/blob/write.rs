//! Converts the f64 calibration to the bytes of a blob: the only module where numbers become `f32`.
//!
//! The loss of precision is measured on all data, and a model that loses too much is rejected: a smooth kernel and a small
//! noise can make the weights so large that their sum cancels in `f32` (the error is about √N·2⁻²⁴·max|weight|/σ · signal).

use heapless::Vec as FixedVec;
use poegp_protocol::blob::{
    self, Blob, Correction, CorrectionLimit, Elastic, Gauge, Geometry, Host, Joint,
    Provenance as WireProvenance, Ranges, Robot as WireRobot, TaskSpace, Tool, Transform, Units,
    Variance,
};
use poegp_protocol::cause::Causes;
use poegp_protocol::limits::OUTPUTS;
use poegp_runtime::kinematics::minimal_chain::MinimalForm;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::model::words_for;

use crate::blob::precision_loss::{
    MAX_F32_ERROR_M, MEAN_F32_ERROR_M, SinglePrecisionLoss, precision_loss,
};
use crate::blob::predict::{BlobError, BlobModel};
use crate::blob::wire_corrections::{DoesNotFit, elastic, fixed, little_endian, task_space};
use crate::learning::elastic::device_variance::DeviceVariance;
use crate::learning::task_space::Hyperparameters;
use crate::learning::task_space::fit::SignalVarianceLimit;
use crate::measurement::folds::configurations;
use crate::measurement::sample::InstrumentSample;
use crate::measurement::sample::ToolName;
use crate::measurement::samples::Samples;
use crate::model::config::Config;
use crate::model::correction as model;
use crate::model::gauge::GaugeChoice;
use crate::model::{Calibration, CalibrationError, calibrate, calibrate_within};
use crate::numeric::statistics::extremes;
use crate::progress::FitContext;
use crate::robot::Robot;

/// The provenance of a calibration.
#[derive(Clone, Debug, Default)]
pub struct Provenance {
    /// Serial number of the arm; empty if unknown.
    pub serial_number: String,
    /// Date of the calibration in UTC, ISO 8601.
    pub date: String,
    /// SHA-256 of the measurement file.
    pub data_sha256: [u8; 32],
    /// Names of the tools; the samples refer to them by index.
    pub tools: Vec<ToolName>,
    /// Causes of the warnings about the measurements.
    pub warnings: Causes,
    /// Causes that the user accepted.
    pub accepted: Causes,
}

impl Provenance {
    /// Creates the provenance of a calibration with `data` on the day `date`; the serial number is left empty.
    pub fn new(data: &Samples, date: &str) -> Self {
        Self {
            serial_number: String::new(),
            date: date.to_owned(),
            data_sha256: data.sha256,
            tools: data.tools.clone(),
            ..Self::default()
        }
    }
}

/// A calibration and its blob.
#[derive(Debug)]
pub struct CalibratedBlob {
    /// The model in f64.
    pub calibration: Calibration,
    /// The model in f32, as the device will have it.
    pub blob: BlobModel,
    /// Distance of the blob's poses from the f64 model's.
    pub precision_loss: SinglePrecisionLoss,
}

/// Limits on the signal variance that are tried if single precision loses too much, highest first.
const SMALLER_SIGNAL_VARIANCES: [f64; 3] = [30.0, 10.0, 3.0];
/// Share of the precision limits that a calibration should not exceed, so that other poses also stay within the limits.
const COMFORTABLE: f64 = 0.7;

/// Calibrates `robot` with [`calibrate`] and writes the blob with [`Calibration::into_blob`].
pub fn calibrate_to_blob(
    robot: &Robot,
    samples: &[InstrumentSample],
    config: &Config,
    provenance: &Provenance,
    context: &FitContext,
) -> Result<CalibratedBlob, DeviceError> {
    let gauge = GaugeChoice::default();
    calibrate_in_gauge(robot, samples, config, &gauge, provenance, context)
}

/// Calibrates as [`calibrate_to_blob`] does, in the gauge that `gauge` chooses.
pub fn calibrate_in_gauge(
    robot: &Robot,
    samples: &[InstrumentSample],
    config: &Config,
    gauge: &GaugeChoice,
    provenance: &Provenance,
    context: &FitContext,
) -> Result<CalibratedBlob, DeviceError> {
    let mut calibration = calibrate(robot, samples, config, context)?;
    if *gauge != GaugeChoice::MEASURED_POSES {
        calibration = calibration
            .in_gauge(robot, gauge)
            .map_err(CalibrationError::Gauge)?;
    }
    calibration.into_blob(robot, samples, provenance, context)
}

impl Calibration {
    /// Writes the blob of a calibration with these samples. If single precision would lose too much, the task-space process
    /// is fitted again with a smaller limit on its signal variance (on ten simulated robots 30 instead of 300 costs 0.5 % of
    /// accuracy and saves five sixths of the rounding error); `TaskSpaceCorrection::max_signal_variance` states the limit
    /// that was used.
    pub fn into_blob(
        self,
        robot: &Robot,
        samples: &[InstrumentSample],
        provenance: &Provenance,
        context: &FitContext,
    ) -> Result<CalibratedBlob, DeviceError> {
        let mut best = self.stored(robot, samples, provenance)?;
        let mut last = best.hyperparameters();
        for value in SMALLER_SIGNAL_VARIANCES {
            if last.is_none() || best.precision_loss.worst_share() <= COMFORTABLE {
                break;
            }
            let limit = SignalVarianceLimit {
                value,
                under_higher: last,
            };
            let config = &best.calibration.config;
            let next = calibrate_within(robot, samples, config, &limit, context)?;
            let next = next.stated_in(&best.calibration.gauge);
            let next = next.stored(robot, samples, provenance)?;
            last = next.hyperparameters();
            if next.precision_loss.worst_share() < best.precision_loss.worst_share() {
                best = next;
            }
        }
        match best.precision_loss.worst_share() <= 1.0 {
            true => Ok(best),
            false => Err(ExportError::SinglePrecisionLossTooLarge(best.precision_loss).into()),
        }
    }

    /// Converts the calibration to a blob, whatever the loss of precision.
    fn stored(
        self,
        robot: &Robot,
        samples: &[InstrumentSample],
        provenance: &Provenance,
    ) -> Result<CalibratedBlob, ExportError> {
        let bytes = to_bytes(&self, robot, provenance, samples)?;
        let blob = BlobModel::from_bytes(bytes)?;
        Ok(CalibratedBlob {
            precision_loss: precision_loss(&self, &blob, samples),
            calibration: self,
            blob,
        })
    }
}

impl CalibratedBlob {
    /// Returns the hyperparameters of the six outputs, if the correction is a task-space process.
    fn hyperparameters(&self) -> Option<[Hyperparameters; OUTPUTS]> {
        let task_space = self.calibration.correction.task_space()?;
        Some(std::array::from_fn(|c| *task_space.gp.output(c)))
    }
}

/// Why a calibration for the device failed.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The data could not be fitted.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The blob could not be made.
    #[error(transparent)]
    Export(#[from] ExportError),
}

/// Why a model could not be stored in a blob.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A part of the model does not fit into the format of a blob.
    #[error("the model does not fit into a blob: {0}")]
    DoesNotFit(&'static str),
    /// The runtime rejects the blob.
    #[error("the model cannot be run: {0}")]
    Unusable(#[from] BlobError),
    /// The poses of the blob are too far from the f64 model's.
    #[error(
        "the f32 model differs from the f64 fit by up to {:.2} µm (limit {:.0} µm) and by {:.3} µm on average (limit \
         {:.1} µm); the fit is ill-conditioned: check units and joint order",
        .0.max_m * 1e6, MAX_F32_ERROR_M * 1e6, .0.mean_m * 1e6, MEAN_F32_ERROR_M * 1e6
    )]
    SinglePrecisionLossTooLarge(SinglePrecisionLoss),
}

impl From<DoesNotFit> for ExportError {
    fn from(DoesNotFit(what): DoesNotFit) -> Self {
        Self::DoesNotFit(what)
    }
}

fn chain<const N: usize>(poe: &Poe<f64>) -> Result<FixedVec<Transform<f32>, N>, DoesNotFit> {
    fixed(
        MinimalForm::new(poe)
            .poe
            .frames()
            .iter()
            .map(|f| f.cast::<f32>().to_rows()),
        "frames",
    )
}

/// Memory words for rows that a device has room for.
const DEVICE_ROOM: usize = words_for(400);

/// Largest length of the host section, in bytes.
const MAX_HOST_LENGTH: usize = 1 << 20;

fn to_bytes(
    calibration: &Calibration,
    robot: &Robot,
    provenance: &Provenance,
    samples: &[InstrumentSample],
) -> Result<Vec<u8>, ExportError> {
    let joints = robot.joints.iter().map(|joint| Joint {
        kind: joint.kind,
        limits: joint
            .limits
            .map(|(lower, upper)| (lower as f32, upper as f32)),
    });
    let correction = WireCorrection::new(calibration, robot)?;
    let host = host(calibration, robot, provenance, samples)?;
    let blob = Blob {
        robot: WireRobot {
            name: &robot.name,
            serial_number: &provenance.serial_number,
            joints: fixed(joints, "joints")?,
            coupling: fixed(
                robot.coupling.iter().flatten().flatten().map(|c| *c as f32),
                "coupling",
            )?,
        },
        units: Units::SI,
        ranges: ranges(calibration, robot, samples)?,
        geometry: Geometry {
            calibrated: chain(&calibration.calibrated)?,
            nominal: chain(&calibration.nominal)?,
        },
        correction: correction.whole(),
        warnings: provenance.warnings,
        host: &host,
        variance: match correction.variance(robot.joints.len()) {
            Some(variance) => Some(variance),
            None => constant_variance(calibration),
        },
    };
    let room = blob::HEADER_LENGTH
        + blob::MAX_LENGTH_WITHOUT_ROWS
        + robot.name.len()
        + provenance.serial_number.len()
        + host.len()
        + correction.length();
    let mut buffer = vec![0; room];
    let length = blob::encode(&blob, &mut buffer)
        .map_err(|_| ExportError::DoesNotFit("names"))?
        .len();
    buffer.truncate(length);
    Ok(buffer)
}

/// Returns the encoded part of the blob that the device does not read.
fn host(
    calibration: &Calibration,
    robot: &Robot,
    provenance: &Provenance,
    samples: &[InstrumentSample],
) -> Result<Vec<u8>, ExportError> {
    let host = Host {
        provenance: WireProvenance {
            method: calibration.config.method.name(),
            trainer_version: env!("CARGO_PKG_VERSION"),
            date: &provenance.date,
            data_sha256: provenance.data_sha256,
            training_poses: configurations(samples, &robot.kinds()).len() as u32,
        },
        gauge: wire_gauge(calibration)?,
        tools: fixed(wire_tools(calibration, provenance), "tools")?,
        accepted: provenance.accepted,
    };
    let mut bytes = vec![0; MAX_HOST_LENGTH];
    let length = host
        .encode(&mut bytes)
        .map_err(|_| ExportError::DoesNotFit("names of tools"))?
        .len();
    bytes.truncate(length);
    Ok(bytes)
}

/// Returns the ranges of the samples; the payload's, if the model depends on it.
fn ranges(
    calibration: &Calibration,
    robot: &Robot,
    samples: &[InstrumentSample],
) -> Result<Ranges, ExportError> {
    let knows_payload = match &calibration.correction {
        model::Correction::None => false,
        model::Correction::TaskSpace(task_space) => task_space.with_payload,
        model::Correction::Elastic(_) => samples.iter().all(|s| s.payload_kg.is_some()),
    };
    let range = |value: &dyn Fn(&InstrumentSample) -> f64| {
        let (low, high) = extremes(samples.iter().map(value));
        (low as f32, high as f32)
    };
    Ok(Ranges {
        joints: fixed(
            (0..robot.joints.len()).map(|i| range(&|s| s.joints[i])),
            "joint ranges",
        )?,
        payload_kg: knows_payload.then(|| range(&|s| s.payload_kg.unwrap_or(0.0))),
    })
}

/// A correction with the lists of its numbers as bytes.
struct WireCorrection<'a> {
    /// The correction without its lists.
    header: Correction<'static>,
    rows: Vec<u8>,
    curves: Vec<u8>,
    /// Landmarks of the variance.
    landmarks: Vec<u8>,
    /// Number of landmarks of a task-space process.
    landmark_count: u8,
    /// Variance of an elastic model.
    sigma: Option<&'a DeviceVariance>,
}

impl<'a> WireCorrection<'a> {
    fn new(calibration: &'a Calibration, robot: &Robot) -> Result<Self, ExportError> {
        let limit = CorrectionLimit {
            position_m: calibration.correction_limit.0 as f32,
            angle_rad: calibration.correction_limit.1 as f32,
        };
        let (header, rows, curves, sigma) = match &calibration.correction {
            model::Correction::None => (Correction::None, Vec::new(), Vec::new(), None),
            model::Correction::TaskSpace(t) => {
                let (correction, rows) = task_space(t, limit)?;
                (Correction::TaskSpace(correction), rows, Vec::new(), None)
            }
            model::Correction::Elastic(e) => {
                let (inducing_points, curves) = e.rows_and_curves();
                (
                    Correction::Elastic(elastic(e, calibration, limit)?),
                    little_endian(inducing_points),
                    little_endian(curves),
                    e.sigma.as_ref(),
                )
            }
        };
        // A model whose rows exceed the room of a device is for workstations and has no limit.
        let room = DEVICE_ROOM
            .checked_sub(rows.len() / 4)
            .unwrap_or(usize::MAX);
        let squared_levers = |inputs: &[f64]| {
            let joints = robot.serial_joints(&inputs[..robot.joints.len()]);
            let p = calibration.calibrated.forward(&joints).translation;
            std::array::from_fn(|i| p.norm_squared() - p[i] * p[i])
        };
        let task_space_variance = calibration
            .correction
            .task_space()
            .filter(|_| calibration.config.device_variance)
            .and_then(|t| t.gp.device_variance(room, &squared_levers));
        let of_task_space = task_space_variance.as_ref().map(|v| &v.rows);
        let landmarks = of_task_space.or(sigma.map(|s| &s.rows));
        Ok(Self {
            header,
            rows,
            curves,
            landmarks: landmarks.map_or(Vec::new(), |rows| little_endian(rows)),
            landmark_count: task_space_variance.map_or(0, |v| v.landmarks as u8),
            sigma,
        })
    }

    /// Returns the correction with its lists.
    fn whole(&self) -> Correction<'_> {
        match self.header.clone() {
            Correction::None => Correction::None,
            Correction::TaskSpace(header) => Correction::TaskSpace(TaskSpace {
                rows: &self.rows,
                landmarks: self.landmark_count,
                landmark_rows: &self.landmarks,
                ..header
            }),
            Correction::Elastic(header) => Correction::Elastic(Elastic {
                rows: &self.rows,
                curves: &self.curves,
                ..header
            }),
        }
    }

    /// Returns the variance of an elastic model.
    fn variance(&self, joints: usize) -> Option<Variance<'_>> {
        let sigma = self.sigma?;
        let rates = sigma.header.rates[..joints].iter();
        Some(Variance {
            rates: rates.map(|rate| *rate as f32).collect(),
            payload_rate: sigma.header.payload_rate as f32,
            floor_m2: sigma.header.floor as f32,
            noise_m2: sigma.noise as f32,
            gain: sigma.header.gain as f32,
            landmarks: sigma.header.landmarks as u8,
            rows: &self.landmarks,
        })
    }

    /// Returns the number of bytes of all lists.
    fn length(&self) -> usize {
        self.rows.len() + self.curves.len() + self.landmarks.len()
    }
}

/// Returns the constant variance of a model without processes, if the device needs a variance.
fn constant_variance<'a>(calibration: &Calibration) -> Option<Variance<'a>> {
    let has_processes = match &calibration.correction {
        model::Correction::None => false,
        model::Correction::TaskSpace(_) => true,
        model::Correction::Elastic(elastic) => !elastic.deflection.processes.sets.is_empty(),
    };
    let (position, _) = calibration.constant_deviation;
    let is_wanted = calibration.config.device_variance && !has_processes;
    is_wanted.then(|| Variance {
        floor_m2: (position * position) as f32,
        noise_m2: 0.0,
        gain: 0.0,
        rates: FixedVec::new(),
        payload_rate: 0.0,
        landmarks: 0,
        rows: &[],
    })
}

fn wire_gauge(calibration: &Calibration) -> Result<Gauge, ExportError> {
    let (own, gauge) = (&calibration.base_and_tools, &calibration.gauge);
    let ranges = gauge.grid.ranges.iter();
    Ok(Gauge {
        instrument_from_base: own.instrument_from_base.to_rows(),
        flange_from_target: own.flange_from_targets[0].to_rows(),
        base: gauge.base.source,
        tool: gauge.tool.source,
        ranges: fixed(
            ranges.map(|(lower, upper)| (*lower as f32, *upper as f32)),
            "joint ranges",
        )?,
        payload_kg: gauge.grid.payload_kg.map(|kg| kg as f32),
    })
}

/// Returns the tools by name; none if there is only one tool and it has no name.
fn wire_tools<'a>(
    calibration: &'a Calibration,
    provenance: &'a Provenance,
) -> impl Iterator<Item = Tool<'a>> {
    let named =
        provenance.tools.len() > 1 || provenance.tools.iter().any(|t| *t != ToolName::default());
    let tools = if named {
        provenance.tools.as_slice()
    } else {
        &[]
    };
    tools
        .iter()
        .zip(&calibration.tools)
        .map(|(name, pose)| Tool {
            session: &name.session,
            target: &name.target,
            first_from_target: pose.cast::<f32>().to_rows(),
        })
}
