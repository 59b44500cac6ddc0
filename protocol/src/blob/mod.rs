//! The model blob: a calibrated arm at rest.
//!
//! This file has the payload, the postcard encoding of [`Blob`]; the [`envelope`] around it has the magic, the format
//! version, the length, the checksum and, if somebody signed it, the signature. [`host`] has the section that the device
//! skips by its length.
//!
//! [`decode`] rejects a foreign file, another version, a length that does not fit, any changed bit and any byte too few or
//! too many, each with an error of its own. It does *not* judge the numbers: that is
//! the checked constructor of the runtime. `docs/reference/blob-format.md` has a worked example in hex.
//!
//! What the device would have to precompute is stored ready made: frames are exponentiated, inputs scaled by their
//! reciprocal length scales, the constant and linear parts of the kernel collapsed into an affine map. All numbers of
//! the cyclic path are `f32`; the transform to the instrument's frame is `f64`, because the host applies it.

pub mod envelope;
pub mod host;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::JointKind;
pub use crate::Transform;
use crate::cause::Causes;
use crate::limits::{
    MAX_FRAMES, MAX_GROUPS, MAX_INPUTS, MAX_JOINTS, MAX_LINK_TERMS, MAX_RIPPLE, OUTPUTS,
};

/// Most bytes that the payload takes beside the rows of inducing points; generous (the largest seen is below 3 kB).
pub const MAX_LENGTH_WITHOUT_ROWS: usize = 4_096;

pub use envelope::{
    BufferTooSmall, CRC, DecodeError, FORMAT_VERSION, HEADER_LENGTH, MAGIC, blob_crc, stored_crc,
};
pub use host::{FrameSource, Gauge, Host, Provenance, Tool};

/// A calibrated arm. Borrowed from the bytes it was decoded from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Blob<'a> {
    /// Which arm this is.
    #[serde(borrow)]
    pub robot: Robot<'a>,
    /// What the numbers are measured in.
    pub units: Units,
    /// Inputs that the training data covered.
    pub ranges: Ranges,
    /// The chain, before and after calibration.
    pub geometry: Geometry,
    /// What geometry does not explain.
    #[serde(borrow)]
    pub correction: Correction<'a>,
    /// How well the position is known, of an elastic correction with processes.
    #[serde(borrow)]
    pub variance: Option<Variance<'a>>,
    /// Causes of the warnings about the measurements that the model was calibrated with.
    pub warnings: Causes,
    /// The encoding of [`Host`]; the device does not read it. Empty in a blob for the device alone.
    pub host: &'a [u8],
}

/// Which arm this is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Robot<'a> {
    /// Name of the robot model.
    pub name: &'a str,
    /// Serial number of this very arm; empty when nobody gave one.
    pub serial_number: &'a str,
    /// The controller's joints, base first.
    pub joints: Vec<Joint, MAX_JOINTS>,
    /// q_serial = C q, n×n row by row; empty for the identity.
    pub coupling: Vec<f32, { MAX_JOINTS * MAX_JOINTS }>,
}

/// One joint of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Revolute (radians) or prismatic (metres).
    pub kind: JointKind,
    /// Mechanical limits, rad or m; absent when the joint turns without end.
    pub limits: Option<(f32, f32)>,
}

/// Units of everything in the blob, spelled out so that a reader need not guess.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Units {
    /// Unit of angles.
    pub angle: AngleUnit,
    /// Unit of lengths.
    pub length: LengthUnit,
    /// Unit of the payload.
    pub mass: MassUnit,
}

impl Units {
    /// Radian, metre, kilogram: the only units there are.
    pub const SI: Self = Self {
        angle: AngleUnit::Radian,
        length: LengthUnit::Metre,
        mass: MassUnit::Kilogram,
    };
}

/// Unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AngleUnit {
    /// rad.
    Radian,
}

/// Unit of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LengthUnit {
    /// m.
    Metre,
}

/// Unit of masses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MassUnit {
    /// kg.
    Kilogram,
}

/// Inputs that the training data covered. Outside them the status says so.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ranges {
    /// Smallest and largest value of each of the controller's joints, rad or m.
    pub joints: Vec<(f32, f32), MAX_JOINTS>,
    /// Lightest and heaviest payload in kg; absent when the model does not know the payload.
    pub payload_kg: Option<(f32, f32)>,
}

/// The chain, before and after calibration: n + 1 frames each, every joint about or along the z axis of its frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// `parent_from_joint` of the calibrated chain, e^p̂_i of the paper, already exponentiated. The first starts at the
    /// base of the base-tool calibration, the last ends at the target.
    pub calibrated: Vec<Transform<f32>, MAX_FRAMES>,
    /// The same for the nominal chain with the target of the base-tool calibration.
    pub nominal: Vec<Transform<f32>, MAX_FRAMES>,
}

/// What geometry does not explain.
// The variants differ in size and nothing can be boxed: there is no heap.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Correction<'a> {
    /// Nothing: the model is the chain alone.
    None,
    /// The paper's Gaussian process on the residual twist in the base frame (eq. 4–13).
    #[serde(borrow)]
    TaskSpace(TaskSpace<'a>),
    /// Deflection of the joints: gravity, gear ripple and a Gaussian process for each joint.
    #[serde(borrow)]
    Elastic(Elastic<'a>),
}

/// The posterior mean of the paper's Gaussian process, ready to evaluate:
///
/// g_c(x) = affine_c · (1, x) + Σ_j weight_jc · 2^(−rate_c · |scale∘x − u_j|²), c = 1…6 in the order (v, ω).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskSpace<'a> {
    /// The correction is scaled back to these.
    pub limit: CorrectionLimit,
    /// θ₀, θ₁, θ₂, θ₃, noise variance as fitted: one entry when shared, else one for each output. Beside landmarks θ₀ and the
    /// noise are part of the predictive variance; the rest is for the reader only.
    pub hyperparameters: Vec<[f32; 5], OUTPUTS>,
    /// RMS of each output before scaling, m and rad. It is in the weights, and beside landmarks a part of the predictive variance.
    pub output_scale: [f32; OUTPUTS],
    /// Reciprocal length scale of each input, √(θ₁ log₂e / 2) when shared; its length is the number of inputs D:
    /// the joints, then the payload if the model knows it.
    pub input_scale: Vec<f32, MAX_INPUTS>,
    /// Exponent rate of each output; absent when shared (all 1).
    pub rates: Option<[f32; OUTPUTS]>,
    /// Constant and linear part of the posterior mean of each output: first the constant, then D slopes.
    pub affine: [Vec<f32, { MAX_INPUTS + 1 }>; OUTPUTS],
    /// Rows of inducing points, `f32` little endian, 4·(D + 6) bytes each: D scaled inputs u_j, then six weights; folded ones with
    /// [`TaskSpace::centre`].
    pub rows: &'a [u8],
    /// Centre of a folded mean in the units of the inputs, rad, m and kg; empty unless it is folded:
    ///
    /// g_c(x) = affine_c · (1, x) + 2^(−|v|²) Σ_j weight_jc · 2^(2 v · v_j) with v = scale ∘ (x − centre), v_j in the rows.
    pub centre: Vec<f32, MAX_INPUTS>,
    /// Number of landmarks L of the predictive variance (eq. 7); 0 for none. The runtime's module `gp::quadratic_variance` has
    /// its formula.
    pub landmarks: u8,
    /// Their rows, `f32` little endian. Of each landmark its D scaled inputs z_j, −|z_j|² and zeros up to 8 words (16 from 8
    /// inputs on). Then of each four landmarks the coefficients of their four kernels, and 16 for each four up to themselves:
    /// those of the products of the first kernel with the four, of the second with the four, …; zeros above the diagonal.
    pub landmark_rows: &'a [u8],
}

/// The elastic correction; the runtime's room `elastic` has its formulas.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Elastic<'a> {
    /// The correction is scaled back to these.
    pub limit: CorrectionLimit,
    /// Gravity in the base frame, m/s².
    pub gravity: [f32; 3],
    /// Gravity coefficients of joint c and link j ≥ c, joint by joint: n(n + 1)/2 of three; empty when there are none.
    pub links: Vec<[f32; 3], MAX_LINK_TERMS>,
    /// Lever and offset coefficients of the payload for each joint; empty when the payload has no such effect.
    pub payload: Vec<[f32; 4], MAX_JOINTS>,
    /// Gear ripple.
    pub ripple: Vec<Ripple, MAX_RIPPLE>,
    /// The kernel of each joint; empty when there is no process.
    pub kernels: Vec<JointKernel, MAX_JOINTS>,
    /// The payload of each group of inducing points, kg.
    pub group_payloads_kg: Vec<f32, MAX_GROUPS>,
    /// How many inducing points of each payload group each joint has; empty when there is no process.
    pub sets: Vec<SetPoints, MAX_JOINTS>,
    /// The inducing points joint by joint, sorted by payload group, `f32` little endian. Of joint c 4·(2D + 1) bytes each:
    /// sine and cosine (value and 0 of a prismatic one) of each of the D joints whose rate in kernel c is not zero, then the
    /// weight.
    pub rows: &'a [u8],
    /// Own-joint curves, `f32` little endian: for every joint the amplitudes of sin q and cos q, of sin 2q and cos 2q, … in
    /// rad, as many orders for each joint, at most 64. Empty when there are none.
    pub curves: &'a [u8],
}

/// One sine and cosine of gear ripple.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ripple {
    /// The joint, from 0.
    pub joint: u8,
    /// Cycles per turn.
    pub cycles: f32,
    /// Amplitude of the sine, rad or m.
    pub sin: f32,
    /// Amplitude of the cosine.
    pub cos: f32,
}

/// The kernel of one joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointKernel {
    /// Exponent rate of each joint.
    pub rates: Vec<f32, MAX_JOINTS>,
    /// Exponent rate of the squared payload difference, 1/kg².
    pub payload_rate: f32,
    /// Amplitude.
    pub amplitude: f32,
    /// Amplitude by the product of the payloads, 1/kg².
    pub payload_amplitude: f32,
}

/// Inducing points of each payload group of one joint.
pub type SetPoints = Vec<u16, MAX_GROUPS>;

/// How well the position of the target is known; the runtime's module `elastic::position_variance` has its formula.
///
/// A model without processes has no rates, and the variance is `floor_m2` for all poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Variance<'a> {
    /// Variance of one position component where the processes are known, m²: parameters and noise.
    pub floor_m2: f32,
    /// The share of it that is the noise of the measurements, m². For the reader only.
    pub noise_m2: f32,
    /// Factor of what the processes do not know; has the third that makes a mean of three axes.
    pub gain: f32,
    /// Exponent rate of each joint in the correlation with a landmark.
    pub rates: Vec<f32, MAX_JOINTS>,
    /// Exponent rate of the squared payload difference in it, 1/kg².
    pub payload_rate: f32,
    /// Number of landmarks.
    pub landmarks: u8,
    /// Landmark j = 0, 1, …, `f32` little endian: two words of each joint (sine and cosine; of a prismatic one its value q
    /// and −q²/2), the payload in kg, then j + 1 words of the triangular factor: 4·(2n + 2 + j) bytes.
    pub rows: &'a [u8],
}

/// The largest correction that is believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CorrectionLimit {
    /// Displacement of the target in metres.
    pub position_m: f32,
    /// Rotation in radians.
    pub angle_rad: f32,
}

/// Writes `blob` with its envelope to the front of `buffer` and returns the bytes used.
///
/// # Errors
/// [`BufferTooSmall`].
pub fn encode<'b>(blob: &Blob<'_>, buffer: &'b mut [u8]) -> Result<&'b [u8], BufferTooSmall> {
    let (_, payload) = buffer
        .split_at_mut_checked(HEADER_LENGTH)
        .ok_or(BufferTooSmall)?;
    let length = postcard::to_slice(blob, payload)
        .map_err(|_| BufferTooSmall)?
        .len();
    envelope::seal(length, buffer)
}

/// The blob in `bytes`, which must hold it exactly, signed or not. The signature is not verified.
///
/// # Errors
/// [`DecodeError`], in the order of its variants: length of the header, magic, version, length, CRC, payload.
pub fn decode(bytes: &[u8]) -> Result<Blob<'_>, DecodeError> {
    match envelope::open(bytes) {
        Ok(envelope) => decode_payload(envelope.payload),
        Err(error) => Err(error),
    }
}

// Not inlined, and called last: the blob is decoded where the caller wants it.
#[inline(never)]
fn decode_payload(payload: &[u8]) -> Result<Blob<'_>, DecodeError> {
    // Not `postcard::take_from_bytes`: its pair of blob and rest is one more copy of the blob on the device's stack.
    let mut deserializer = postcard::Deserializer::from_bytes(payload);
    let decoded = Blob::deserialize(&mut deserializer);
    if deserializer.finalize().is_ok_and(<[u8]>::is_empty) {
        decoded.map_err(|_| DecodeError::MalformedPayload)
    } else {
        Err(DecodeError::MalformedPayload)
    }
}
