//! What a controller or a workstation and the device say to each other.
//!
//! One [`Request`] is answered by one [`Response`] with the same sequence number; [`frame`] carries both. Every
//! request may be repeated: what was done is not done again, and the answer says what is. A request that asks for a
//! change names what it expects ([`Request::Activate`] the model to run, [`Request::RollBack`] the model to leave), so
//! that a second copy changes nothing.
//!
//! The *cyclic* requests are answered by the cycle, which pre-empts everything else; the others are *services*, carried
//! out one at a time in the background. A service that comes while another one is being carried out is answered
//! [`Refusal::Busy`] and is to be sent again.
//!
//! A controller that sends a command every period may use the shorter frame of [`cyclic`] for it.
//!
//! [`REQUESTS`] and [`RESPONSES`] list every message; `docs/reference/link.md` has the same tables with the bytes. Variants are
//! append-only within a protocol version: their order is their number on the wire.

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

/// Version of messages and frames. Both sides must have the same.
pub const PROTOCOL_VERSION: u8 = 1;
/// Most bytes of a blob in one `UploadChunk`: short, so that a correction never waits long behind one on the line.
pub const MAX_CHUNK: usize = 256;
/// Most bytes of a name in an [`Identity`]; longer ones are cut.
pub const MAX_NAME: usize = 32;
