//! The intermediate results of one evaluation as bits. They are compared stage by stage, so that a difference names the
//! stage in which it arises.

use std::fmt::Write;

use poegp_protocol::blob::{self, DecodeError};
use poegp_protocol::limits::OUTPUTS;
use poegp_protocol::link::{Corrected, Evaluation, Query, Trace};
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::{Model, words_for};

/// Capacity of the host's model: larger than that of any device, because no result may depend on it.
const HOST_WORDS: usize = words_for(2048);

/// The runtime on the workstation with a loaded model.
#[derive(Debug)]
pub struct Host(Box<Model<f32, HOST_WORDS>>);

/// Why the host could not load a model.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub enum HostError {
    /// The bytes are not a blob.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The blob is not a usable model.
    #[error(transparent)]
    Load(#[from] LoadError),
}

impl Host {
    /// Loads a blob.
    ///
    /// # Errors
    /// [`HostError`].
    pub fn load(bytes: &[u8]) -> Result<Self, HostError> {
        let mut model = Box::new(Model::new());
        model.load_decoded(&blob::decode(bytes)?)?;
        Ok(Self(model))
    }

    /// Returns the answer that the device must give to `Request::Trace`.
    pub fn stages(&self, query: &Query) -> Stages {
        let mut kept = poegp_runtime::trace::Stages::new();
        let result = self
            .0
            .evaluate_in_stages(&query.joints, query.payload_kg, &mut kept);
        let pairs = kept.motions().iter().flatten().copied();
        Stages {
            values: [
                bits(&pairs.collect::<Vec<f32>>()),
                bits(
                    kept.mean
                        .first_chunk::<OUTPUTS>()
                        .unwrap_or(&[0.0; OUTPUTS]),
                ),
                bits(&kept.chain.to_rows()),
                bits(&result.correction.to_array()),
                bits(&result.pose.to_rows()),
                vec![u32::from(result.status.bits())],
            ],
        }
    }
}

impl Host {
    /// Returns the bits of trust and standard deviation in the format of [`trust_line`].
    pub fn trust_line(&self, query: &Query) -> String {
        let answer = self.0.evaluate(&query.joints, query.payload_kg);
        trust_bits(answer.trust, answer.position_sigma)
    }

    /// Returns the answer that the device must give to `Request::Correct`.
    pub fn command(&self, query: &Query) -> CommandBits {
        let answer = self.0.correct(&query.joints, query.payload_kg);
        let joints: Vec<f32> = (0..query.joints.len())
            .map(|joint| answer.joints.get(joint).copied().unwrap_or(0.0))
            .collect();
        CommandBits {
            joints: bits(&joints),
            applied: answer.applied.to_bits(),
            position_error: answer.position_error.to_bits(),
            rotation_error: answer.rotation_error.to_bits(),
            status: answer.status.bits(),
        }
    }
}

/// Returns the bits of trust and standard deviation (`-` if there is none) of an answer, in the format of the golden file.
pub fn trust_line(answer: &Evaluation) -> String {
    trust_bits(answer.trust, answer.position_sigma)
}

fn trust_bits(trust: f32, sigma: Option<f32>) -> String {
    let sigma = sigma.map_or("-".to_owned(), |s| format!("{:08x}", s.to_bits()));
    format!("{:08x} {sigma}", trust.to_bits())
}

/// A corrected command as bits, for exact comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommandBits {
    joints: Vec<u32>,
    applied: u32,
    position_error: u32,
    rotation_error: u32,
    /// Bits of the runtime's `Status`.
    pub status: u8,
}

impl From<&Corrected> for CommandBits {
    fn from(answer: &Corrected) -> Self {
        Self {
            joints: bits(&answer.joints),
            applied: answer.applied.to_bits(),
            position_error: answer.position_error.to_bits(),
            rotation_error: answer.rotation_error.to_bits(),
            status: answer.status,
        }
    }
}

impl CommandBits {
    /// Returns the joints, in rad or m.
    pub fn joints(&self) -> Vec<f32> {
        self.joints
            .iter()
            .map(|bits| f32::from_bits(*bits))
            .collect()
    }

    /// Returns whether any joint or error is not finite.
    pub fn has_non_finite(&self) -> bool {
        let numbers = [&self.applied, &self.position_error, &self.rotation_error];
        let words = self.joints.iter().chain(numbers);
        words
            .map(|bits| f32::from_bits(*bits))
            .any(|value| !value.is_finite())
    }

    /// Returns joints, position error and status in hexadecimal, with groups separated by ` | `.
    pub fn line(&self) -> String {
        let mut line = String::new();
        for word in &self.joints {
            write!(line, "{word:08x} ").expect("strings grow");
        }
        let (error, status) = (self.position_error, self.status);
        line + &format!("| {error:08x} | {status:02x}")
    }

    /// Returns whether the joints are exactly those of the request.
    pub fn is_the_command_of(&self, query: &Query) -> bool {
        self.joints == bits(&query.joints)
    }
}

/// Names of the stages, in the order of the computation.
pub const NAMES: [&str; 6] = ["sin_cos", "mean", "chain", "correction", "pose", "status"];

/// The intermediate results of one evaluation, as bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stages {
    values: [Vec<u32>; NAMES.len()],
}

impl From<&Trace> for Stages {
    fn from(trace: &Trace) -> Self {
        let evaluation = &trace.evaluation;
        Self {
            values: [
                bits(&trace.sin_cos),
                bits(&trace.mean),
                bits(&trace.chain),
                bits(&evaluation.correction),
                bits(&evaluation.pose),
                vec![u32::from(evaluation.status)],
            ],
        }
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

impl Stages {
    /// Returns the first stage in which `self` and `other` differ, with both values.
    pub fn difference(&self, other: &Self) -> Option<String> {
        for (name, (left, right)) in NAMES.iter().zip(self.values.iter().zip(&other.values)) {
            if left.len() != right.len() {
                return Some(format!(
                    "{name}: {} words, {} words",
                    left.len(),
                    right.len()
                ));
            }
            if let Some(index) = left.iter().zip(right).position(|(l, r)| l != r) {
                let (l, r) = (left[index], right[index]);
                return Some(format!(
                    "{name}[{index}]: {l:08x} ({:e}), {r:08x} ({:e})",
                    f32::from_bits(l),
                    f32::from_bits(r)
                ));
            }
        }
        None
    }

    /// Returns the bits of the status.
    pub fn status(&self) -> u8 {
        self.values[5].first().map_or(0, |bits| *bits as u8)
    }

    /// Returns whether any number of the answer is not finite.
    pub fn has_non_finite_answer(&self) -> bool {
        self.values[3..5]
            .iter()
            .flatten()
            .any(|bits| !f32::from_bits(*bits).is_finite())
    }

    /// Returns query and results on one line in hexadecimal, with groups separated by ` | ` and the query (joints, payload)
    /// first.
    pub fn line(&self, query: &Query) -> String {
        let mut asked = bits(&query.joints);
        asked.push(query.payload_kg.to_bits());
        let mut line = String::new();
        for (index, group) in std::iter::once(&asked).chain(&self.values).enumerate() {
            line.push_str(if index == 0 { "" } else { " |" });
            for word in group {
                let space = if line.is_empty() { "" } else { " " };
                write!(line, "{space}{word:08x}").expect("strings grow");
            }
        }
        line
    }
}
