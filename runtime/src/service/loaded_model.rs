//! A model in RAM, with its identity. There are two: the active and the spare one.

use heapless::String;
use poegp_protocol::blob::{self, envelope};
use poegp_protocol::cause::Causes;
use poegp_protocol::link::{MAX_NAME, ModelIdentity, Refusal};

use crate::math::scalar::Scalar;
use crate::model::Model;
use crate::model::signature;
use crate::store::Slot;

/// A model and its origin. It is all zeros when empty, so that a static one takes no flash. The device computes in `f32`.
#[derive(Debug)]
pub struct ModelSlot<const WORDS: usize, T = f32> {
    pub(super) model: Model<T, WORDS>,
    robot: String<MAX_NAME>,
    serial_number: String<MAX_NAME>,
    pub(super) blob_crc: u32,
    /// Bound on the instructions of a command.
    instructions: u32,
    warnings: Causes,
    /// 1 when the signature was verified. A `bool` would give an `Option` around this struct a state that is not zero.
    signed: u8,
    /// Revision under the signature.
    revision: u32,
    /// Index of the flash slot that holds the model, plus one; 0 for none.
    slot: u8,
}

impl<const WORDS: usize, T: Scalar> Default for ModelSlot<WORDS, T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const WORDS: usize, T: Scalar> ModelSlot<WORDS, T> {
    /// Creates a slot without a model.
    pub const fn new() -> Self {
        Self {
            model: Model::new(),
            robot: String::new(),
            serial_number: String::new(),
            blob_crc: 0,
            instructions: 0,
            warnings: Causes::NONE,
            signed: 0,
            revision: 0,
            slot: 0,
        }
    }

    /// Verifies `bytes` in every respect and loads their model, all or nothing.
    ///
    /// # Errors
    /// [`Refusal::Blob`], [`Refusal::Signature`], [`Refusal::Model`].
    // Not inlined: the large stack frames of the two steps must not lie on top of each other.
    pub fn load(&mut self, bytes: &[u8], key: Option<&[u8; 32]>) -> Result<(), Refusal> {
        let revision = match key {
            None => None,
            Some(key) => Some(signed_revision(bytes, key)?),
        };
        self.load_unverified(bytes)?;
        self.signed = u8::from(revision.is_some());
        self.revision = revision.unwrap_or(0);
        Ok(())
    }

    /// Does the same as [`ModelSlot::load`] without a key. A program that calls only this function links no cryptography.
    ///
    /// # Errors
    /// [`Refusal::Blob`], [`Refusal::Model`].
    pub fn load_unverified(&mut self, bytes: &[u8]) -> Result<(), Refusal> {
        self.load_blob(bytes)?;
        self.blob_crc = blob::stored_crc(bytes).unwrap_or(0);
        self.signed = 0;
        self.slot = 0;
        Ok(())
    }

    #[inline(never)]
    fn load_blob(&mut self, bytes: &[u8]) -> Result<(), Refusal> {
        // Matched by reference, because every move would be a copy of the blob on the stack.
        match &blob::decode(bytes) {
            Err(error) => Err(Refusal::Blob(*error)),
            Ok(blob) => {
                self.model
                    .load_decoded(blob)
                    .map_err(|error| Refusal::Model { code: error.code() })?;
                self.robot = name(blob.robot.name);
                self.serial_number = name(blob.robot.serial_number);
                self.warnings = blob.warnings;
                self.instructions = self.model.size().map_or(0, |size| size.command_bound());
                Ok(())
            }
        }
    }

    /// Returns the model that computes.
    pub fn model(&self) -> &Model<T, WORDS> {
        &self.model
    }

    /// Forgets the model.
    pub(super) fn unload(&mut self) {
        self.model.unload();
        self.blob_crc = 0;
        self.signed = 0;
        self.slot = 0;
    }

    /// Returns the identity of the model; `None` when there is no model.
    pub fn identity(&self) -> Option<ModelIdentity> {
        let joints = self.model.joints();
        (joints > 0).then(|| ModelIdentity {
            robot: self.robot.clone(),
            serial_number: self.serial_number.clone(),
            blob_crc: self.blob_crc,
            joints: joints as u8,
            inducing_points: self.model.inducing_points() as u32,
            instructions: self.instructions,
            revision: (self.signed != 0).then_some(self.revision),
            warnings: self.warnings,
        })
    }

    /// Returns the flash slot that holds the same model.
    pub fn slot(&self) -> Option<Slot> {
        match self.slot {
            1 => Some(Slot::A),
            2 => Some(Slot::B),
            _ => None,
        }
    }

    /// Notes that `slot` now holds the model with this CRC and no other.
    pub(super) fn note_stored(&mut self, blob_crc: u32, slot: Slot) {
        if self.blob_crc == blob_crc {
            self.set_slot(Some(slot));
        } else if self.slot() == Some(slot) {
            self.set_slot(None);
        }
    }

    pub(super) fn set_slot(&mut self, slot: Option<Slot>) {
        self.slot = match slot {
            None => 0,
            Some(Slot::A) => 1,
            Some(Slot::B) => 2,
        };
    }
}

/// Verifies the signature and returns the revision. Damage is reported before a signature is checked, which also keeps the
/// long computation for whole blobs.
#[inline(never)]
fn signed_revision(bytes: &[u8], key: &[u8; 32]) -> Result<u32, Refusal> {
    if let Err(error) = envelope::open(bytes) {
        return Err(Refusal::Blob(error));
    }
    signature::verify(bytes, key).map_err(|error| Refusal::Signature { code: error.code() })
}

/// Returns as much of `text` as fits, cut between characters.
pub(super) fn name(text: &str) -> String<MAX_NAME> {
    let mut out = String::new();
    for letter in text.chars() {
        if out.push(letter).is_err() {
            break;
        }
    }
    out
}
