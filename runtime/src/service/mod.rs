//! What the device does with a request, as pure code that can be tested on a PC. The firmware only moves bytes and time.
//!
//! ```text
//!            bytes                 frames              services
//!  line ───────────────> Cycle ──────────────────────────────────> Background ──> Store (flash)
//!       <─────────────── answers cyclic requests      <── orders ── loads the spare model
//!            answers     with the active model         ── spare ──> verifies, commits, rolls back
//! ```
//!
//! [`Cycle`] runs at high priority and is short and bounded: it finds frames, answers `Evaluate`, `Correct` and `Command`
//! with the active model, and passes everything else on. [`Background`] runs when there is nothing else to do, may take
//! long, and is pre-empted by every cycle. Nothing is shared: at any time a model belongs to one of them, and it becomes
//! active by being handed over whole, between two cycles ([`CycleCommand::Run`]).
//!
//! `Correct` is a question whose answer stands alone. `Command` is the command of a controller's cycle, and its answer goes
//! through a [`crate::filter::CommandFilter`], which never steps. While the filter applies a correction, a model that was
//! ordered waits: the filter takes the correction back, the models are exchanged, and the filter applies the new correction.
//! When commands stop, for half a second or by `StopCyclic`, the model waits no longer. While a model waits, the background
//! has no spare model, and answers [`poegp_protocol::link::Refusal::Busy`] to every request that needs one.
//!
//! A blob arrives in pieces in a staging buffer. Nothing of it is trusted before `VerifyUpload` has checked the announced
//! CRC, the envelope, the signature if a key is provisioned, and every number. Until the blob is activated, and after any
//! refusal, the active model answers. Without a model, and whatever else goes wrong, a correction is answered with the
//! unchanged command and a status that says why.

mod admission;
mod authority;
mod background;
mod commands;
mod cycle;
mod exchange;
mod frames;
mod loaded_model;
mod self_test;
mod upload;

pub use crate::service::background::{Background, Device};
pub use crate::service::cycle::{Clock, Cycle, FrameOutcome};
pub use crate::service::exchange::{BoardInfo, CycleAck, CycleCommand};
pub use crate::service::loaded_model::ModelSlot;
pub use crate::service::self_test::self_test;
