//! What the cycle and the background hand to each other.

use poegp_protocol::link::{CycleSettings, ModelIdentity, StartReason, Statistics};

use crate::filter::FilterError;
use crate::service::loaded_model::ModelSlot;
use crate::store::Slot;

/// What does not change about the device.
#[derive(Clone, Copy, Debug)]
pub struct BoardInfo {
    /// Name of the board.
    pub board: &'static str,
    /// CRC-32C of the firmware's image.
    pub image_crc: u32,
    /// Frequency of the tick counter in hertz.
    pub tick_hz: u32,
    /// Ticks in which a cyclic request is to be answered.
    pub deadline_ticks: u32,
    /// Frequency of the processor's clock in hertz, as it is.
    pub clock_hz: u32,
    /// Below this frequency neither the deadline nor the number of instructions is true, and no model is taken.
    pub needed_clock_hz: u32,
    /// Instructions for which there is time in a cycle, until another number is provisioned.
    pub max_instructions: u32,
    /// Whether the processor waits while the flash erases or writes. Then it is left alone while cycles run.
    pub flash_blocks: bool,
    /// How often the slots may be changed between two starts. A loop of uploads would wear out the flash.
    pub slot_writes: u32,
    /// What [`self_test`](crate::service::self_test) has said. Without it no model is taken.
    pub self_test: bool,
    /// Why the device started.
    pub start: StartReason,
}

/// What the background wants of the cycle.
#[derive(Debug)]
pub enum CycleCommand<'m, const WORDS: usize> {
    /// Nothing but a report.
    Report,
    /// Run this model: from now on, or when the correction by the active one has been taken back.
    Run(&'m mut ModelSlot<WORDS>),
    /// The model of this name is in this slot now, and no other.
    Stored {
        /// CRC in the header of its blob.
        blob_crc: u32,
        /// Where it is.
        slot: Slot,
    },
    /// Take these settings.
    Settings(CycleSettings),
    /// Answer commands as they come, or correct them again.
    Bypass(bool),
    /// No more cyclic requests will come.
    Stop,
    /// A request was refused: count it.
    Refused,
    /// The message of an intact frame was none: count it.
    Unreadable,
}

/// What the cycle says to an order.
#[derive(Debug)]
pub struct CycleAck<'m, const WORDS: usize> {
    /// The model that was active before the one of [`CycleCommand::Run`], once: in the first report after the exchange.
    pub replaced: Option<&'m mut ModelSlot<WORDS>>,
    /// The active model, or the one that waits.
    pub model: Option<ModelIdentity>,
    /// Whether it waits.
    pub pending: bool,
    /// The slot that holds it.
    pub slot: Option<Slot>,
    /// Settings in force.
    pub cycle: CycleSettings,
    /// Why [`CycleCommand::Settings`] was not obeyed.
    pub refused: Option<FilterError>,
    /// Whether corrections are bypassed.
    pub bypass: bool,
    /// Whether cyclic requests are expected.
    pub running: bool,
    /// Whether a command was among those that came since the start or the last [`CycleCommand::Stop`].
    pub commanded: bool,
    /// What the cycle has counted.
    pub statistics: Statistics,
}
