//! The supported boards. A cargo feature selects one of them here. The rest of the firmware uses only the names below and no
//! addresses.
//!
//! To support another board, add a module with an implementation of [`Board`], built on the traits of embedded-io (serial
//! lines), embedded-storage (flash) and embedded-hal (a pin). `docs/reference/porting.md` explains the smallest board.

use embedded_hal::digital::OutputPin;
use embedded_io::{Read, ReadReady, Write, WriteReady};
use embedded_storage::nor_flash::NorFlash;
use poegp_runtime::store::Layout;

#[cfg(feature = "mps2")]
mod mps2;

#[cfg(feature = "stm32f405")]
mod stm32f405;

#[cfg(feature = "mps2")]
pub use mps2::Mps2 as Chosen;
#[cfg(feature = "stm32f405")]
pub use stm32f405::Stm32F405 as Chosen;

#[cfg(not(any(feature = "mps2", feature = "stm32f405")))]
compile_error!("choose a board by its feature, for instance --features mps2-an386");

/// A board: its properties, its peripherals and its start.
pub trait Board {
    /// Name of the board.
    const NAME: &'static str;
    /// Frequency of the counter [`Board::ticks`], in Hz.
    const TICK_HZ: u32;
    /// Frequency of the processor's clock in Hz for which [`Board::DEADLINE_TICKS`] and [`Board::MAX_INSTRUCTIONS`] hold.
    /// With a slower clock ([`Parts::core_hz`]) the device accepts no model.
    const CLOCK_HZ: u32;
    /// Deadline for the answer to a cyclic request, in ticks.
    const DEADLINE_TICKS: u32;
    /// Number of instructions that the processor certainly executes within [`Board::DEADLINE_TICKS`].
    const MAX_INSTRUCTIONS: u32;
    /// Whether the processor stalls while the flash erases or writes. If so, the flash is not touched while cycles run.
    const FLASH_BLOCKS: bool;
    /// Maximum number of changes of the model slots between two starts.
    const SLOT_WRITES: u32;
    /// Serial line to the controller and the workstation.
    type Link: Link;
    /// Serial line for the defmt log.
    type Log: Write + WriteReady;
    /// Flash memory that stores the models.
    type Flash: NorFlash;
    /// Output pin that is high while a frame is being answered, for an oscilloscope.
    type Strobe: OutputPin;

    /// Starts clocks, timer, serial lines and watchdog. The first call returns the parts, any further call `None`.
    fn start() -> Option<Parts<Self>>
    where
        Self: Sized;
    /// Enables the link's interrupts at a priority above the lowest.
    fn listen();
    /// Reads a free-running counter that wraps around at 2³².
    fn ticks() -> u32;
    /// Returns a random number from the hardware, if there is one. Without it, only a count and the time of the request make
    /// nonces differ.
    fn random() -> Option<u32> {
        None
    }
    /// Whether the supply voltage is guaranteed to suffice for fast flash writes. Logged at the start if not.
    fn supply_is_sure() -> bool {
        true
    }
    /// Feeds the watchdog, so that it does not restart the board. Only the module `watchdog` calls this.
    fn feed_watchdog();
}

/// The peripherals and properties of a started board.
pub struct Parts<B: Board> {
    /// Actual frequency of the processor's clock, in Hz.
    pub core_hz: u32,
    /// Started [`Board::Link`].
    pub link: B::Link,
    /// Started [`Board::Log`].
    pub log: B::Log,
    /// The [`Board::Flash`].
    pub flash: B::Flash,
    /// Layout of models, key and settings in the flash.
    pub layout: Layout,
    /// The [`Board::Strobe`] pin.
    pub strobe: B::Strobe,
}

/// A serial line with interrupts, whose handlers are in the module `interrupts`. Reads and writes never block, and move one
/// byte or several.
pub trait Link: Read + ReadReady + Write + WriteReady {
    /// Whether one interrupt delivers several bytes, as with DMA. They then arrived no later than that interrupt was raised.
    const IN_BULK: bool = false;

    /// Clears the cause of the interrupt, unless reading and writing do. The interrupt handler calls this first.
    fn acknowledge(&mut self);
    /// Enables or disables the interrupt that occurs when a byte can be written.
    fn notify_writable(&mut self, wanted: bool);
    /// Whether everything has been sent except the one or two bytes that a UART holds.
    fn is_sent(&mut self) -> bool {
        true
    }
    /// Returns the number of received bytes that were lost before they could be read, since the last call.
    fn lost(&mut self) -> u32 {
        0
    }
}
