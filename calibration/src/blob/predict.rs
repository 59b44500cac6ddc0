//! A blob as the device will run it: decoded, checked and evaluated by the `f32` runtime. This is the only source of
//! predictions.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use poegp_protocol::blob::{self, Blob, DecodeError, FrameSource, Host};
use poegp_protocol::{JointKind, Transform};
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::{Model, words_for};

use crate::identification::base_tools::UNKNOWN_TOOL;
use crate::input_error::{InputError, is_printable};
use crate::learning::task_space::MAX_POINTS;
use crate::measurement::sample::{InstrumentSample, ToolName};
use crate::numeric::rotation::nearest_rotation;
use crate::numeric::statistics::PoseError;

/// The workstation's instance of the runtime model. The device's instance holds fewer points; the results are the same.
pub type HostModel = Model<f32, { words_for(MAX_POINTS) }>;

/// Why bytes are not a usable model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlobError {
    /// The bytes are not a blob.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The blob is intact but not a usable model.
    #[error("the blob is intact but not a usable model: {0}")]
    Load(#[from] LoadError),
    /// A name holds characters that could change what a terminal or a file shows.
    #[error("the name {0:?} holds control characters")]
    Name(String),
}

/// The decoded contents of a blob.
#[derive(Debug)]
struct Contents<'a> {
    blob: Blob<'a>,
    host: Host<'a>,
}

self_cell::self_cell!(
    /// The bytes of a blob and their decoded contents.
    struct Decoded {
        owner: Vec<u8>,
        #[covariant]
        dependent: Contents,
    }

    impl {Debug}
);

/// A blob and the model that it contains.
#[derive(Debug)]
pub struct BlobModel {
    decoded: Decoded,
    model: Box<HostModel>,
    instrument_from_base: Pose<f64>,
    tools: Vec<(ToolName, Pose<f64>)>,
}

/// Number of bytes of a file that are read as a blob; the largest blobs have a hundredth of it.
const LARGEST: u64 = 256 << 20;

/// One prediction of a [`BlobModel`].
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// `instrument_from_target`.
    pub pose: Pose<f64>,
    /// The status flags of the prediction.
    pub status: Status,
    /// Trust: 1 within the trained ranges, falling to 0 outside.
    pub trust: f32,
    /// Standard deviation of one position component of a new measurement, in metres, if the blob has a variance.
    pub position_sigma: Option<f32>,
}

impl BlobModel {
    /// Decodes and checks `bytes`.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self, BlobError> {
        let decoded = Decoded::try_new(bytes, |bytes| {
            let blob = blob::decode(bytes)?;
            let host = Host::decode(blob.host)?;
            Ok::<_, DecodeError>(Contents { blob, host })
        })?;
        let Contents { blob, host } = decoded.borrow_dependent();
        let of_tools = host.tools.iter().flat_map(|t| [t.session, t.target]);
        let known = &host.provenance;
        let own = [
            blob.robot.name,
            blob.robot.serial_number,
            known.method,
            known.trainer_version,
            known.date,
        ];
        if let Some(name) = own
            .into_iter()
            .chain(of_tools)
            .find(|name| !is_printable(name))
        {
            return Err(BlobError::Name(name.to_owned()));
        }
        let mut model = Box::new(HostModel::new());
        model.load_decoded(blob)?;
        let tool = |t: &blob::Tool<'_>| {
            let name = ToolName {
                session: t.session.to_owned(),
                target: t.target.to_owned(),
            };
            let pose = Pose::<f32>::from_rows(&t.first_from_target);
            (name, orthonormal(&pose.cast()))
        };
        Ok(Self {
            instrument_from_base: Pose::from_rows(&host.gauge.instrument_from_base),
            tools: host.tools.iter().map(tool).collect(),
            model,
            decoded,
        })
    }

    /// Reads a blob from a file.
    ///
    /// # Errors
    /// [`InputError`], which names the file and what is wrong with it.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let expected = "a model blob written by `trainer calibrate`";
        let read = |file: File| {
            let mut bytes = Vec::new();
            file.take(LARGEST).read_to_end(&mut bytes).map(|_| bytes)
        };
        let bytes = File::open(path)
            .and_then(read)
            .map_err(|e| InputError::unreadable(path, &e, expected))?;
        let found = |e: BlobError| {
            let error = InputError::new(path, e.to_string(), expected);
            match e {
                BlobError::Decode(DecodeError::UnknownVersion { .. }) => error
                    .with_help("use the version of the trainer that wrote it, or calibrate again"),
                BlobError::Decode(DecodeError::WrongMagic) => error,
                _ => error
                    .with_help("copy the file again from where it was written, or calibrate again"),
            }
        };
        Self::from_bytes(bytes).map_err(found)
    }

    /// Returns the part of the blob that the device reads.
    pub fn blob(&self) -> &Blob<'_> {
        &self.decoded.borrow_dependent().blob
    }

    /// Returns the part of the blob that only the host reads.
    pub fn host(&self) -> &Host<'_> {
        &self.decoded.borrow_dependent().host
    }

    /// Returns the bytes of the blob.
    pub fn bytes(&self) -> &[u8] {
        self.decoded.borrow_owner()
    }

    /// Returns the runtime model.
    pub fn model(&self) -> &HostModel {
        &self.model
    }

    /// Predicts `instrument_from_target` for the controller's joints and the payload (0 if it is not known): the runtime's
    /// `f32` pose in the base frame, transformed to the instrument's frame in `f64`.
    pub fn predict(&self, joints: &[f64], payload_kg: Option<f64>) -> Prediction {
        let joints: Vec<f32> = joints.iter().map(|q| *q as f32).collect();
        let answer = self
            .model
            .evaluate(&joints, payload_kg.unwrap_or(0.0) as f32);
        Prediction {
            pose: self.in_instrument(&answer.pose),
            status: answer.status,
            trust: answer.trust,
            position_sigma: answer.position_sigma,
        }
    }

    /// Returns the base frame of the model, seen from the instrument.
    pub fn instrument_from_base(&self) -> Pose<f64> {
        self.instrument_from_base
    }

    /// Returns whether the model knows the pose of an instrument. A calibration by touches alone does not: such a model
    /// states its poses in the base of the nominal model, and a base must be fitted to measurements of an instrument
    /// ([`FittedFrames`](super::fitted_frames::FittedFrames)).
    pub fn knows_instrument(&self) -> bool {
        // A base that was fitted to measured poses is never exactly that of the nominal model.
        self.instrument_from_base != Pose::identity()
            || self.host().gauge.base == FrameSource::Stated
    }

    /// Returns the kinds of the joints.
    pub fn kinds(&self) -> Vec<JointKind> {
        let joints = self.blob().robot.joints.iter();
        joints.map(|joint| joint.kind).collect()
    }

    /// Returns the calibrated chain, from the base to the first target.
    pub fn chain(&self) -> Poe<f64> {
        let frames = poses(&self.blob().geometry.calibrated);
        Poe::new(&self.kinds(), &frames).expect("a loaded blob is a chain")
    }

    /// Returns the joint coupling C of q_serial = C q by rows; `None` means the identity.
    pub fn coupling(&self) -> Option<Vec<Vec<f64>>> {
        let robot = &self.blob().robot;
        let row = |row: &[f32]| row.iter().map(|c| f64::from(*c)).collect();
        let rows = robot.coupling.chunks(robot.joints.len().max(1));
        (!robot.coupling.is_empty()).then(|| rows.map(row).collect())
    }

    /// Transforms a pose from the base frame, as the runtime or a device computed it, to the instrument's frame.
    pub fn in_instrument(&self, base_from_target: &Pose<f32>) -> Pose<f64> {
        orthonormal(&(self.instrument_from_base * base_from_target.cast::<f64>()))
    }

    /// Returns the tools that the blob names; empty if there was only one tool without a name.
    pub fn tools(&self) -> &[(ToolName, Pose<f64>)] {
        &self.tools
    }

    /// Predicts as [`BlobModel::predict`] does, for the tool of the blob with index `tool`; the pose of a tool that the blob
    /// does not have is not a number.
    pub fn predict_tool(&self, joints: &[f64], payload_kg: Option<f64>, tool: usize) -> Prediction {
        let first = self.predict(joints, payload_kg);
        if tool == 0 {
            return first;
        }
        let known = self.tools.get(tool).map(|(_, tool)| *tool);
        Prediction {
            pose: first.pose * known.unwrap_or(UNKNOWN_TOOL),
            ..first
        }
    }

    /// Returns the error of each sample's prediction, in order.
    pub fn errors(&self, samples: &[InstrumentSample]) -> Vec<PoseError> {
        samples
            .iter()
            .map(|s| {
                let predicted = self.predict_tool(&s.joints, s.payload_kg, s.tool).pose;
                s.observation.error(&predicted)
            })
            .collect()
    }
}

/// Returns the frames of a blob in f64.
pub fn poses(frames: &[Transform<f32>]) -> Vec<Pose<f64>> {
    let frames = frames.iter();
    frames.map(|f| Pose::<f32>::from_rows(f).cast()).collect()
}

/// Returns the frames of a blob in f64, each with the nearest rotation.
pub fn rigid_poses(frames: &[Transform<f32>]) -> Vec<Pose<f64>> {
    let mut out = poses(frames);
    for pose in &mut out {
        pose.rotation = nearest_rotation(&pose.rotation);
    }
    out
}

/// Returns the pose with a rotation matrix that is orthonormal to f64; a matrix of f32 is orthonormal to seven digits only.
/// A quaternion in a file states the nearest rotation, and errors recomputed from that file must be the reported ones.
pub(super) fn orthonormal(pose: &Pose<f64>) -> Pose<f64> {
    let (w, v) = pose.quaternion();
    Pose::from_quaternion(w, &v, pose.translation)
}
