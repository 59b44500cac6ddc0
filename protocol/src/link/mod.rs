//! The messages between a controller or workstation and the device.
//!
//! The device answers each [`Request`] with one [`Response`] that has the same sequence number; [`frame`] carries both.
//! Every request may be repeated: the device does not repeat the work, and its answer reports the current state. A request
//! for a change states what it expects ([`Request::Activate`] the model to run, [`Request::RollBack`] the model to leave),
//! so that a second copy changes nothing.
//!
//! The cycle, which pre-empts everything else, answers the *cyclic* requests. All other requests are *services*: the
//! background carries them out one at a time. A service that arrives during another one is answered with
//! [`Refusal::Busy`] and has to be sent again.
//!
//! A controller that sends a command in every period may use the shorter frame of [`cyclic`] for it.
//!
//! [`REQUESTS`] and [`RESPONSES`] list every message; `docs/reference/link.md` has the same tables with the bytes. Within a
//! protocol version, variants are only appended: the position of a variant is its number on the wire.

pub mod cobs;
pub mod cyclic;
pub mod frame;
mod refusal;
mod request;
mod response;
mod table;

pub use refusal::Refusal;
pub use request::{CycleSettings, Cyclic, MAX_SIGNED, NONCE_LENGTH, Query, Request, order};
pub use response::{
    Commanded, Corrected, CyclicResponse, Evaluation, Identity, Key, KeyId, ModelIdentity,
    Response, StartReason, Statistics, StoredModel, Trace,
};
pub use table::{Message, REQUESTS, RESPONSES};

/// Version of messages and frames. Both sides must have the same version.
pub const PROTOCOL_VERSION: u8 = 1;
/// Maximum number of blob bytes in one `UploadChunk`: few, so that a correction never waits long behind a chunk on the line.
pub const MAX_CHUNK: usize = 256;
/// Maximum length in bytes of a name in an [`Identity`]; longer names are cut.
pub const MAX_NAME: usize = 32;
