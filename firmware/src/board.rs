//! The boards. One is chosen here, by feature; the rest of the firmware knows the names below and no address.
//!
//! A board of one's own is one more module with an implementation of [`Board`], made of the traits of embedded-io
//! (serial lines), embedded-storage (flash) and embedded-hal (a pin). `docs/reference/porting.md` goes through the smallest one.

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

/// A board.
pub trait Board {
    /// Its name.
    const NAME: &'static str;
    /// Frequency of [`Board::ticks`] in hertz.
    const TICK_HZ: u32;
    /// Frequency of the processor's clock in hertz for which the next two are true. With a lower one
    /// ([`Parts::core_hz`]) the device takes no model.
    const CLOCK_HZ: u32;
    /// Ticks in which a cyclic request is to be answered.
    const DEADLINE_TICKS: u32;
    /// Instructions that the processor is sure to carry out until then.
    const MAX_INSTRUCTIONS: u32;
    /// Whether the processor waits while the flash erases or writes. Then it is left alone while cycles run.
    const FLASH_BLOCKS: bool;
    /// How often the slots of models may be changed between two starts.
    const SLOT_WRITES: u32;
    /// The serial line to controller and workstation.
    type Link: Link;
    /// The line that defmt logs on.
    type Log: Write + WriteReady;
    /// The flash with the models.
    type Flash: NorFlash;
    /// High while a frame is being answered: what an oscilloscope looks at.
    type Strobe: OutputPin;

    /// Starts everything: clocks, timer, lines and the watchdog. May be called once; `None` when called again.
    fn start() -> Option<Parts<Self>>
    where
        Self: Sized;
    /// Lets the interrupt of the link through, at a priority above the lowest.
    fn listen();
    /// A free-running counter that wraps around at 2³².
    fn ticks() -> u32;
    /// A random number of the hardware. Without one, what makes nonces differ is the time at which they are asked for.
    fn random() -> Option<u32> {
        None
    }
    /// Whether the supply is sure to be what fast writing of the flash needs; logged at the start.
    fn supply_is_sure() -> bool {
        true
    }
    /// Keeps the watchdog from restarting the board. Only `watchdog` calls this.
    fn feed_watchdog();
}

/// What a started board hands out.
pub struct Parts<B: Board> {
    /// Frequency of the processor's clock in hertz.
    pub core_hz: u32,
    /// See [`Board::Link`].
    pub link: B::Link,
    /// See [`Board::Log`].
    pub log: B::Log,
    /// See [`Board::Flash`].
    pub flash: B::Flash,
    /// Where the models lie in it.
    pub layout: Layout,
    /// See [`Board::Strobe`].
    pub strobe: B::Strobe,
}

/// A line with interrupts, whose handlers are in `interrupts`. Reading and writing never wait, and move a byte or many.
pub trait Link: Read + ReadReady + Write + WriteReady {
    /// Whether bytes wait for an interrupt together, as with DMA: then they came when it was raised, at the latest.
    const IN_BULK: bool = false;

    /// Called first in the handler: clears what made it run, where reading and writing do not.
    fn acknowledge(&mut self);
    /// Whether the interrupt is wanted when a byte can be written.
    fn notify_writable(&mut self, wanted: bool);
    /// Whether everything is sent but the byte or two that a UART holds.
    fn is_sent(&mut self) -> bool {
        true
    }
    /// Received bytes that were lost before they could be read, since this was last asked.
    fn lost(&mut self) -> u32 {
        0
    }
}
