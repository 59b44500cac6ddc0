//! What the cycle and the background exchange.

use poegp_protocol::link::{CycleSettings, ModelIdentity, StartReason, Statistics};

use crate::filter::FilterError;
use crate::service::loaded_model::ModelSlot;
use crate::store::Slot;

/// Fixed properties of the device.
#[derive(Clone, Copy, Debug)]
pub struct BoardInfo {
    /// Name of the board.
    pub board: &'static str,
    /// CRC-32C of the firmware image.
    pub image_crc: u32,
    /// Frequency of the tick counter in hertz.
    pub tick_hz: u32,
    /// Ticks within which a cyclic request is to be answered.
    pub deadline_ticks: u32,
    /// Actual frequency of the processor clock in hertz.
    pub clock_hz: u32,
    /// Least clock frequency in hertz: below it neither the deadline nor the number of instructions holds, and no model is
    /// accepted.
    pub needed_clock_hz: u32,
    /// Instructions that a cycle has time for, until another number is provisioned.
    pub max_instructions: u32,
    /// Whether the processor stalls while the flash erases or writes. The flash is then left alone while cycles run.
    pub flash_blocks: bool,
    /// Number of times that the slots may be changed between two starts, because a loop of uploads would wear out the flash.
    pub slot_writes: u32,
    /// Result of [`self_test`](crate::service::self_test). No model is accepted unless it is true.
    pub self_test: bool,
    /// Reason for which the device started.
    pub start: StartReason,
}

/// Order of the background to the cycle.
#[derive(Debug)]
pub enum CycleCommand<'m, const WORDS: usize> {
    /// Do nothing but report.
    Report,
    /// Run this model: now, or when the correction by the active one has been taken back.
    Run(&'m mut ModelSlot<WORDS>),
    /// Note that this slot now holds the model with this CRC and no other.
    Stored {
        /// CRC in the header of the model's blob.
        blob_crc: u32,
        /// Slot that holds the blob.
        slot: Slot,
    },
    /// Apply these settings. No correction begins before the next order, so that other settings may still take their place.
    Settings(CycleSettings),
    /// Answer commands without correction if true, with it if false.
    Bypass(bool),
    /// Expect no more cyclic requests.
    Stop,
    /// Refuse if commands come and a correction is applied to them, which a restart would end in one step.
    Restart,
    /// Count a refused request.
    Refused,
    /// Count an intact frame whose message could not be read.
    Unreadable,
}

/// Report with which the cycle answers an order.
#[derive(Debug)]
pub struct CycleAck<'m, const WORDS: usize> {
    /// Model that was active before the one of [`CycleCommand::Run`]; only in the first report after the exchange.
    pub replaced: Option<&'m mut ModelSlot<WORDS>>,
    /// Identity of the model that waits, otherwise of the active one.
    pub model: Option<ModelIdentity>,
    /// Whether that model is waiting.
    pub pending: bool,
    /// Flash slot that holds that model.
    pub slot: Option<Slot>,
    /// Settings in force.
    pub cycle: CycleSettings,
    /// Reason why [`CycleCommand::Settings`] or [`CycleCommand::Restart`] was not carried out.
    pub refused: Option<FilterError>,
    /// Whether corrections are bypassed.
    pub bypass: bool,
    /// Whether cyclic requests are expected.
    pub running: bool,
    /// Whether any command has come since the start or the last [`CycleCommand::Stop`].
    pub commanded: bool,
    /// Counters of the cycle.
    pub statistics: Statistics,
}
