//! A blob as the device will run it: decoded, checked, in the `f32` runtime. The only source of predictions.

use std::path::Path;

use poegp_protocol::blob::{self, Blob, DecodeError, FrameSource, Host};
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::{Model, words_for};

use crate::input_error::InputError;
use crate::learning::task_space::MAX_POINTS;
use crate::measurement::sample::{InstrumentSample, ToolName};
use crate::numeric::statistics::PoseError;

/// The workstation's instance. The device's holds fewer points; no result depends on it.
pub type HostModel = Model<f32, { words_for(MAX_POINTS) }>;

/// Why bytes are not a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlobError {
    /// Not a blob.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// Not a usable model.
    #[error("the blob is intact but not a usable model: {0}")]
    Load(#[from] LoadError),
}

/// What the bytes of a blob say.
#[derive(Debug)]
struct Contents<'a> {
    blob: Blob<'a>,
    host: Host<'a>,
}

self_cell::self_cell!(
    /// The bytes of a blob and what they say.
    struct Decoded {
        owner: Vec<u8>,
        #[covariant]
        dependent: Contents,
    }

    impl {Debug}
);

/// A blob and the model it holds.
#[derive(Debug)]
pub struct BlobModel {
    decoded: Decoded,
    model: Box<HostModel>,
    instrument_from_base: Pose<f64>,
    tools: Vec<(ToolName, Pose<f64>)>,
}

/// One prediction.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// `instrument_from_target`.
    pub pose: Pose<f64>,
    /// What it is worth.
    pub status: Status,
    /// 1 within what was trained, towards 0 far away.
    pub trust: f32,
    /// Standard deviation of one position component of a new measurement in metres, of a blob that knows it.
    pub position_sigma: Option<f32>,
}

impl BlobModel {
    /// Decodes and checks `bytes`.
    ///
    /// # Errors
    /// [`BlobError`].
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self, BlobError> {
        let decoded = Decoded::try_new(bytes, |bytes| {
            let blob = blob::decode(bytes)?;
            let host = Host::decode(blob.host)?;
            Ok::<_, DecodeError>(Contents { blob, host })
        })?;
        let Contents { blob, host } = decoded.borrow_dependent();
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
    /// [`InputError`] names the file and what is wrong with it.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let expected = "a model blob written by `trainer calibrate`";
        let bytes = std::fs::read(path).map_err(|e| InputError::unreadable(path, &e, expected))?;
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

    /// What the device reads of the blob.
    pub fn blob(&self) -> &Blob<'_> {
        &self.decoded.borrow_dependent().blob
    }

    /// What the host reads of the blob.
    pub fn host(&self) -> &Host<'_> {
        &self.decoded.borrow_dependent().host
    }

    /// The bytes of the blob.
    pub fn bytes(&self) -> &[u8] {
        self.decoded.borrow_owner()
    }

    /// The model.
    pub fn model(&self) -> &HostModel {
        &self.model
    }

    /// The predicted `instrument_from_target` for the controller's joints and the payload (0 when it is not known): the
    /// runtime's `f32` pose in the base frame, carried to the instrument's frame in `f64`.
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

    /// The base frame of the model, seen from the instrument.
    pub fn instrument_from_base(&self) -> Pose<f64> {
        self.instrument_from_base
    }

    /// Whether the model knows where an instrument stands. Touches alone show none: such a model states its poses in the
    /// base of the drawing, and measurements need a base of their own ([`FittedFrames`](super::fitted_frames::FittedFrames)).
    pub fn knows_instrument(&self) -> bool {
        // The base that is fitted to measured poses is never the drawing's to the last bit.
        self.instrument_from_base != Pose::identity()
            || self.host().gauge.base == FrameSource::Stated
    }

    /// C of q_serial = C q by rows; `None` is the identity.
    pub fn coupling(&self) -> Option<Vec<Vec<f64>>> {
        let robot = &self.blob().robot;
        let row = |row: &[f32]| row.iter().map(|c| f64::from(*c)).collect();
        let rows = robot.coupling.chunks(robot.joints.len().max(1));
        (!robot.coupling.is_empty()).then(|| rows.map(row).collect())
    }

    /// A pose in the base frame as the runtime or a device computed it, seen from the instrument.
    pub fn in_instrument(&self, base_from_target: &Pose<f32>) -> Pose<f64> {
        orthonormal(&(self.instrument_from_base * base_from_target.cast::<f64>()))
    }

    /// The tools that the blob names; empty when there was only one without a name.
    pub fn tools(&self) -> &[(ToolName, Pose<f64>)] {
        &self.tools
    }

    /// The same as [`BlobModel::predict`] for a tool of the blob, by its index.
    pub fn predict_tool(&self, joints: &[f64], payload_kg: Option<f64>, tool: usize) -> Prediction {
        let first = self.predict(joints, payload_kg);
        match self.tools.get(tool) {
            Some((_, first_from_target)) if tool > 0 => Prediction {
                pose: first.pose * *first_from_target,
                ..first
            },
            _ => first,
        }
    }

    /// The error of each sample's prediction, in order.
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

/// The same pose with a rotation that is one to f64: a matrix of f32 is one to seven digits only. The nearest rotation is
/// what a quaternion in a file says, and errors recomputed from that file must be the reported ones.
pub(super) fn orthonormal(pose: &Pose<f64>) -> Pose<f64> {
    let (w, v) = pose.quaternion();
    Pose::from_quaternion(w, &v, pose.translation)
}
