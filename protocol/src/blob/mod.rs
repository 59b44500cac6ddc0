//! The model blob: the stored form of a calibrated arm.
//!
//! This file defines the payload, the postcard encoding of [`Blob`]. The [`envelope`] around it holds the magic, the format
//! version, the length, the checksum and, for a signed blob, the signature. [`host`] defines the section that the device
//! skips by its length.
//!
//! [`decode`] rejects a foreign file, another version, a wrong length, any changed bit and any missing or extra byte, each
//! with an error of its own. It does *not* check the numbers; the checked constructor of the runtime does.
//! `docs/reference/blob-format.md` has a worked example in hex.
//!
//! The blob stores precomputed values, so that the device need not compute them: frames are exponentiated, inputs are scaled
//! by their reciprocal lengthscales, and the constant and linear parts of the kernel are collapsed into an affine map. All
//! numbers of the cyclic path are `f32`; the transform to the instrument's frame is `f64`, because the host applies it.

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

/// Maximum size of the payload in bytes without the rows of inducing points; generous (the largest seen is below 3 kB).
pub const MAX_LENGTH_WITHOUT_ROWS: usize = 4_096;

pub use envelope::{
    BufferTooSmall, CRC, DecodeError, FORMAT_VERSION, HEADER_LENGTH, MAGIC, blob_crc, stored_crc,
};
pub use host::{FrameSource, Gauge, Host, Provenance, Tool};

/// A calibrated arm. It borrows from the bytes that it was decoded from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Blob<'a> {
    /// The identity and joints of the arm.
    #[serde(borrow)]
    pub robot: Robot<'a>,
    /// Units of all numbers in the blob.
    pub units: Units,
    /// Input ranges that the training data covered.
    pub ranges: Ranges,
    /// The nominal and the calibrated chain.
    pub geometry: Geometry,
    /// Model of the errors that the geometry does not explain.
    #[serde(borrow)]
    pub correction: Correction<'a>,
    /// Predictive variance of the position, for an elastic correction or a model without a correction.
    #[serde(borrow)]
    pub variance: Option<Variance<'a>>,
    /// Causes of warnings about the measurements from which the model was calibrated.
    pub warnings: Causes,
    /// The encoded [`Host`] section, which the device does not read. Empty in a blob for the device alone.
    pub host: &'a [u8],
}

/// Identity, joints and joint coupling of an arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Robot<'a> {
    /// Name of the robot model.
    pub name: &'a str,
    /// Serial number of this individual arm; empty if none was stated.
    pub serial_number: &'a str,
    /// The controller's joints, from the base outwards.
    pub joints: Vec<Joint, MAX_JOINTS>,
    /// Joint coupling C of q_serial = C q, an n×n matrix in row-major order; empty for the identity.
    pub coupling: Vec<f32, { MAX_JOINTS * MAX_JOINTS }>,
}

/// One joint of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Revolute (radians) or prismatic (metres).
    pub kind: JointKind,
    /// Mechanical limits (lower, upper) in rad or m; `None` for a joint that turns without end.
    pub limits: Option<(f32, f32)>,
}

/// Units of all numbers in the blob, stated explicitly so that a reader need not guess.
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
    /// Radian, metre and kilogram, the only supported units.
    pub const SI: Self = Self {
        angle: AngleUnit::Radian,
        length: LengthUnit::Metre,
        mass: MassUnit::Kilogram,
    };
}

/// Unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AngleUnit {
    /// Radian (rad).
    Radian,
}

/// Unit of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LengthUnit {
    /// Metre (m).
    Metre,
}

/// Unit of masses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MassUnit {
    /// Kilogram (kg).
    Kilogram,
}

/// Input ranges that the training data covered. The status reports inputs outside them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ranges {
    /// Smallest and largest trained value of each of the controller's joints, in rad or m.
    pub joints: Vec<(f32, f32), MAX_JOINTS>,
    /// Lightest and heaviest trained payload in kg; `None` if the model does not depend on the payload.
    pub payload_kg: Option<(f32, f32)>,
}

/// The nominal and the calibrated chain: n + 1 fixed frames each. Every joint acts about or along the z axis of its frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// `parent_from_joint` transforms of the calibrated chain, e^p̂_i of the paper, already exponentiated. The first starts
    /// at the base of the base-tool calibration, the last ends at the target.
    pub calibrated: Vec<Transform<f32>, MAX_FRAMES>,
    /// `parent_from_joint` transforms of the nominal chain, with the target of the base-tool calibration.
    pub nominal: Vec<Transform<f32>, MAX_FRAMES>,
}

/// Model of the errors that the geometry does not explain.
// The variants differ in size and nothing can be boxed: there is no heap.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Correction<'a> {
    /// No correction: the model is the calibrated chain alone.
    None,
    /// The paper's Gaussian process on the residual twist in the base frame (eq. 4–13).
    #[serde(borrow)]
    TaskSpace(TaskSpace<'a>),
    /// Joint deflections from gravity, gear ripple and one Gaussian process for each joint.
    #[serde(borrow)]
    Elastic(Elastic<'a>),
}

/// The posterior mean of the paper's Gaussian process, ready to evaluate:
///
/// g_c(x) = affine_c · (1, x) + Σ_j weight_jc · 2^(−rate_c · |scale∘x − u_j|²), c = 1…6 in the order (v, ω).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskSpace<'a> {
    /// Limit to which a larger correction is scaled back.
    pub limit: CorrectionLimit,
    /// Fitted θ₀, θ₁, θ₂, θ₃ and noise variance: one entry if shared, else one for each output. With landmarks, θ₀ and the
    /// noise variance enter the predictive variance; all other values are for the reader only.
    pub hyperparameters: Vec<[f32; 5], OUTPUTS>,
    /// RMS of each output before scaling, in m and rad. The weights include it; with landmarks, it also enters the
    /// predictive variance.
    pub output_scale: [f32; OUTPUTS],
    /// Reciprocal lengthscale of each input, √(θ₁ log₂e / 2) if shared. Its length is the number of inputs D: the joints,
    /// then the payload if the model depends on it.
    pub input_scale: Vec<f32, MAX_INPUTS>,
    /// Exponent rate of each output; `None` if shared (all 1).
    pub rates: Option<[f32; OUTPUTS]>,
    /// Affine part of the posterior mean of each output: the constant, then D slopes.
    pub affine: [Vec<f32, { MAX_INPUTS + 1 }>; OUTPUTS],
    /// Rows of the inducing points, `f32` little endian, 4·(D + 6) bytes each: D scaled inputs u_j, then six weights. With a
    /// [`TaskSpace::centre`] the rows are folded.
    pub rows: &'a [u8],
    /// Centre of a folded posterior mean in the units of the inputs (rad, m and kg); empty unless the mean is folded:
    ///
    /// g_c(x) = affine_c · (1, x) + 2^(−|v|²) Σ_j weight_jc · 2^(2 v · v_j) with v = scale ∘ (x − centre), v_j from rows.
    pub centre: Vec<f32, MAX_INPUTS>,
    /// Number of landmarks L of the predictive variance (eq. 7); 0 for none. The runtime's module `gp::quadratic_variance`
    /// states its formula.
    pub landmarks: u8,
    /// Rows of the landmarks, `f32` little endian. For each landmark: its D scaled inputs z_j, −|z_j|², and zeros up to 8
    /// words (16 words from 8 inputs on). Then for each block of four landmarks: the coefficients of its four kernels, and
    /// 16 coefficients for each block up to and including itself. These belong to the products of the first kernel with the
    /// four, of the second with the four, …; zeros above the diagonal.
    pub landmark_rows: &'a [u8],
}

/// The elastic correction. The runtime's module `elastic` states its formulas.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Elastic<'a> {
    /// Limit to which a larger correction is scaled back.
    pub limit: CorrectionLimit,
    /// Gravity in the base frame, m/s².
    pub gravity: [f32; 3],
    /// Gravity coefficients of joint c and link j ≥ c, joint by joint: n(n + 1)/2 triples; empty if there are none.
    pub links: Vec<[f32; 3], MAX_LINK_TERMS>,
    /// Lever and offset coefficients of the payload for each joint; empty if the payload has no such effect.
    pub payload: Vec<[f32; 4], MAX_JOINTS>,
    /// Gear-ripple terms.
    pub ripple: Vec<Ripple, MAX_RIPPLE>,
    /// Kernel of each joint's Gaussian process; empty if there is none.
    pub kernels: Vec<JointKernel, MAX_JOINTS>,
    /// Payload of each group of inducing points, in kg.
    pub group_payloads_kg: Vec<f32, MAX_GROUPS>,
    /// Number of inducing points of each joint in each payload group; empty if there is no Gaussian process.
    pub sets: Vec<SetPoints, MAX_JOINTS>,
    /// Inducing points joint by joint, sorted by payload group, `f32` little endian. Each point of joint c takes 4·(2D + 1)
    /// bytes: sine and cosine (for a prismatic joint, value and 0) of each of the D joints whose rate in kernel c is not
    /// zero, then the weight.
    pub rows: &'a [u8],
    /// Own-joint curves, `f32` little endian: for every joint the amplitudes of sin q and cos q, of sin 2q and cos 2q, … in
    /// rad. All joints have the same number of orders, at most 64. Empty if there are no curves.
    pub curves: &'a [u8],
}

/// One sine and cosine term of gear ripple.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ripple {
    /// Index of the joint, from 0.
    pub joint: u8,
    /// Cycles per turn of the joint.
    pub cycles: f32,
    /// Amplitude of the sine in rad or m.
    pub sin: f32,
    /// Amplitude of the cosine in rad or m.
    pub cos: f32,
}

/// Kernel of one joint's Gaussian process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointKernel {
    /// Exponent rate for each input joint.
    pub rates: Vec<f32, MAX_JOINTS>,
    /// Exponent rate for the squared payload difference, in 1/kg².
    pub payload_rate: f32,
    /// Constant part of the kernel's amplitude.
    pub amplitude: f32,
    /// Part of the kernel's amplitude that multiplies the product of the two payloads, in 1/kg².
    pub payload_amplitude: f32,
}

/// Number of inducing points of one joint in each payload group.
pub type SetPoints = Vec<u16, MAX_GROUPS>;

/// Predictive variance of the target's position. The runtime's module `elastic::position_variance` states its formula.
///
/// A model without Gaussian processes has no rates, and its variance is `floor_m2` for all poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Variance<'a> {
    /// Variance of one position component where the Gaussian processes are known, in m²: parameters and noise.
    pub floor_m2: f32,
    /// Part of `floor_m2` that is measurement noise, in m². For the reader only.
    pub noise_m2: f32,
    /// Factor of the variance that the Gaussian processes leave unexplained. It includes the factor 1/3 that averages over
    /// the three axes.
    pub gain: f32,
    /// Exponent rate of each joint in the correlation with a landmark.
    pub rates: Vec<f32, MAX_JOINTS>,
    /// Exponent rate for the squared payload difference in the correlation with a landmark, in 1/kg².
    pub payload_rate: f32,
    /// Number of landmarks.
    pub landmarks: u8,
    /// Rows of the landmarks j = 0, 1, …, `f32` little endian, 4·(2n + 2 + j) bytes each: two words for each joint (sine and
    /// cosine; for a prismatic joint its value q and −q²/2), the payload in kg, then j + 1 words of the triangular factor.
    pub rows: &'a [u8],
}

/// Correction limit: the largest correction that is believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CorrectionLimit {
    /// Largest displacement of the target, in m.
    pub position_m: f32,
    /// Largest rotation, in rad.
    pub angle_rad: f32,
}

/// Writes `blob` in an unsigned envelope to the front of `buffer` and returns the bytes used.
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

/// Decodes a blob, signed or unsigned, from `bytes`, which must contain nothing else. Does not verify the signature.
///
/// # Errors
/// [`DecodeError`], in the order of its variants: length of the header, magic, version, length, CRC, payload.
pub fn decode(bytes: &[u8]) -> Result<Blob<'_>, DecodeError> {
    match envelope::open(bytes) {
        Ok(envelope) => decode_payload(envelope.payload),
        Err(error) => Err(error),
    }
}

// Not inlined, and called last, so that the blob is decoded directly into the caller's memory.
#[inline(never)]
fn decode_payload(payload: &[u8]) -> Result<Blob<'_>, DecodeError> {
    // `postcard::take_from_bytes` returns a pair of blob and rest: one more copy of the blob on the device's stack.
    let mut deserializer = postcard::Deserializer::from_bytes(payload);
    let decoded = Blob::deserialize(&mut deserializer);
    if deserializer.finalize().is_ok_and(<[u8]>::is_empty) {
        decoded.map_err(|_| DecodeError::MalformedPayload)
    } else {
        Err(DecodeError::MalformedPayload)
    }
}
