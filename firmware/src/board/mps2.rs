//! Board support for the Arm MPS2 with FPGA image AN386 (Cortex-M4F) or AN500 (Cortex-M7), and the MPS3 with AN547
//! (Cortex-M55), as QEMU emulates them.
//!
//! Sources of the registers: the application notes of the images, the "Cortex-M System Design Kit TRM" (ARM DDI 0479: APB
//! UART, ch. 4.3, APB timer, ch. 4.1, APB watchdog, ch. 4.5) and, for AN547, the "SSE-300 TRM" (ARM 101773: system counter).
//!
//! The clock of the MPS2 is 25 MHz. That of the MPS3 is 32 MHz; its UARTs run at 25 MHz and its watchdog at 32 768 Hz. The
//! MPS3 starts in secure state and stays there.
//!
//! ```text
//!  MPS2         MPS3
//!  0x4000_0000  -            TIMER0    CTRL +0  VALUE +4  RELOAD +8                       Board::ticks
//!  -            0x5810_0000  COUNTER   CNTCR +0  CNTCV +8                                 Board::ticks
//!  0x4000_4000  0x5930_3000  UART0     DATA +0  STATE +4  CTRL +8  INT +12  BAUDDIV +16   link; two interrupts
//!  0x4000_5000  0x5930_4000  UART1     as UART0                                           defmt
//!  0x4000_8000  0x5802_e000  WATCHDOG  LOAD +0  CTRL +8  INTCLR +12  LOCK +0xc00
//!  0x4002_8000  0x5930_2000  FPGAIO    LED +0                                             strobe
//!  0x2100_0000  0x6000_0000  PSRAM     (AN500: 0x6000_0000) stands for NOR flash: QEMU can keep it in a file
//! ```

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use embedded_storage::nor_flash::{
    ErrorType as FlashErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use poegp_runtime::store::Layout;
use static_cell::ConstStaticCell;

use crate::board::{Board, Link, Parts};
use crate::hal_unsafe::{Interrupt, Region, Register, enable_interrupt};

/// Addresses and clocks of the MPS2.
#[cfg(not(feature = "mps3-an547"))]
mod addresses {
    use crate::hal_unsafe::Register;

    pub const CLOCK_HZ: u32 = 25_000_000;
    pub const UART_HZ: u32 = CLOCK_HZ;
    pub const WATCHDOG_HZ: u32 = CLOCK_HZ;
    pub const UART0: usize = 0x4000_4000;
    pub const UART1: usize = 0x4000_5000;
    pub const UART0_INTERRUPTS: [u16; 2] = [0, 1];
    pub const WATCHDOG: usize = 0x4000_8000;
    pub const FPGAIO: usize = 0x4002_8000;
    #[cfg(feature = "mps2-an386")]
    pub const PSRAM: usize = 0x2100_0000;
    #[cfg(feature = "mps2-an500")]
    pub const PSRAM: usize = 0x6000_0000;

    const TIMER_CTRL: Register = Register::at(0x4000_0000);
    const TIMER_VALUE: Register = Register::at(0x4000_0004);
    const TIMER_RELOAD: Register = Register::at(0x4000_0008);
    const TIMER_ENABLE: u32 = 1;

    pub fn start_counter() {
        TIMER_RELOAD.write(u32::MAX);
        TIMER_VALUE.write(u32::MAX);
        TIMER_CTRL.write(TIMER_ENABLE);
    }

    #[inline(always)]
    pub fn counter() -> u32 {
        // The timer counts down from 2³² − 1.
        !TIMER_VALUE.read()
    }
}

/// Addresses and clocks of the MPS3.
#[cfg(feature = "mps3-an547")]
mod addresses {
    use crate::hal_unsafe::Register;

    pub const CLOCK_HZ: u32 = 32_000_000;
    pub const UART_HZ: u32 = 25_000_000;
    pub const WATCHDOG_HZ: u32 = 32_768;
    pub const UART0: usize = 0x5930_3000;
    pub const UART1: usize = 0x5930_4000;
    pub const UART0_INTERRUPTS: [u16; 2] = [33, 34];
    pub const WATCHDOG: usize = 0x5802_e000;
    pub const FPGAIO: usize = 0x5930_2000;
    pub const PSRAM: usize = 0x6000_0000;

    const COUNTER_CTRL: Register = Register::at(0x5810_0000);
    const COUNTER_VALUE: Register = Register::at(0x5810_0008);
    const COUNTER_ENABLE: u32 = 1;

    pub fn start_counter() {
        COUNTER_CTRL.write(COUNTER_ENABLE);
    }

    #[inline(always)]
    pub fn counter() -> u32 {
        // This is the lower half of a 64-bit counter.
        COUNTER_VALUE.read()
    }
}

use addresses::{CLOCK_HZ, FPGAIO, PSRAM, UART_HZ, UART0, UART0_INTERRUPTS, UART1, WATCHDOG};

const BAUD: u32 = 115_200;
/// Timeout of the watchdog. It restarts the board when it was not fed for twice this time.
const WATCHDOG_TICKS: u32 = 4 * addresses::WATCHDOG_HZ;

const WATCHDOG_LOAD: Register = Register::at(WATCHDOG);
const WATCHDOG_CTRL: Register = Register::at(WATCHDOG + 8);
const WATCHDOG_INTCLR: Register = Register::at(WATCHDOG + 0xc);
const WATCHDOG_LOCK: Register = Register::at(WATCHDOG + 0xc00);
const WATCHDOG_UNLOCK: u32 = 0x1acc_e551;
const WATCHDOG_COUNT_AND_RESET: u32 = 3;

const LED: Register = Register::at(FPGAIO);

/// One APB UART.
pub struct Uart {
    data: Register,
    state: Register,
    ctrl: Register,
    interrupt: Register,
}

const STATE_TX_FULL: u32 = 1;
const STATE_RX_FULL: u32 = 2;
const CTRL_ENABLE: u32 = 0b0011;
const CTRL_TX_INTERRUPT: u32 = 0b0100;
const CTRL_RX_INTERRUPT: u32 = 0b1000;
const ALL_INTERRUPTS: u32 = 0b1111;

macro_rules! uart {
    ($base:expr) => {
        Uart {
            data: const { Register::at($base) },
            state: const { Register::at($base + 4) },
            ctrl: const { Register::at($base + 8) },
            interrupt: const { Register::at($base + 12) },
        }
    };
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.state.read() & STATE_RX_FULL != 0)
    }
}

impl Read for Uart {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(buffer.first_mut().map_or(0, |slot| {
            *slot = self.data.read() as u8;
            1
        }))
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.state.read() & STATE_TX_FULL == 0)
    }
}

impl Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.first().map_or(0, |byte| {
            self.data.write(u32::from(*byte));
            1
        }))
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Link for Uart {
    fn acknowledge(&mut self) {
        self.interrupt.write(ALL_INTERRUPTS);
    }
    fn notify_writable(&mut self, wanted: bool) {
        let transmit = if wanted { CTRL_TX_INTERRUPT } else { 0 };
        self.ctrl.write(CTRL_ENABLE | CTRL_RX_INTERRUPT | transmit);
    }
}

/// The external RAM with the rules of NOR flash: a write only clears bits, and an erase sets all bits of a page. The RAM
/// holds the complement of the data, so that RAM that was never written reads as erased.
pub struct PsramFlash;

const PAGE: u32 = 4_096;
const SLOT: u32 = 16 * PAGE;
const FLASH_BYTES: u32 = 2 * SLOT + 2 * PAGE;
const FLASH: Region = Region::at(PSRAM, FLASH_BYTES as usize / 4);

/// The error for an access that is not aligned or beyond the end.
#[derive(Clone, Copy, Debug)]
pub struct BadAddress;

impl NorFlashError for BadAddress {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::OutOfBounds
    }
}

impl FlashErrorType for PsramFlash {
    type Error = BadAddress;
}

impl ReadNorFlash for PsramFlash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), BadAddress> {
        for (word, chunk) in (offset as usize / 4..).zip(bytes.chunks_mut(4)) {
            let value = !FLASH.read(word).ok_or(BadAddress)?;
            for (slot, byte) in chunk.iter_mut().zip(value.to_le_bytes()) {
                *slot = byte;
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        FLASH_BYTES as usize
    }
}

impl NorFlash for PsramFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), BadAddress> {
        for word in from / 4..to / 4 {
            FLASH.write(word as usize, 0);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), BadAddress> {
        for (word, chunk) in (offset as usize / 4..).zip(bytes.as_chunks::<4>().0) {
            let before = FLASH.read(word).ok_or(BadAddress)?;
            FLASH.write(word, before | !u32::from_le_bytes(*chunk));
        }
        Ok(())
    }
}

/// The first LED, which serves as strobe.
pub struct Led;

impl embedded_hal::digital::ErrorType for Led {
    type Error = Infallible;
}

impl embedded_hal::digital::OutputPin for Led {
    fn set_low(&mut self) -> Result<(), Infallible> {
        LED.write(0);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        LED.write(1);
        Ok(())
    }
}

/// The MPS2 or MPS3 board.
pub struct Mps2;

impl Board for Mps2 {
    #[cfg(feature = "mps2-an386")]
    const NAME: &'static str = "mps2-an386";
    #[cfg(feature = "mps2-an500")]
    const NAME: &'static str = "mps2-an500";
    #[cfg(feature = "mps3-an547")]
    const NAME: &'static str = "mps3-an547";
    const TICK_HZ: u32 = CLOCK_HZ;
    const CLOCK_HZ: u32 = CLOCK_HZ;
    // 4 ms: at 25 MHz a correction with 100 inducing points takes more than 1 ms.
    const DEADLINE_TICKS: u32 = CLOCK_HZ / 250;
    // QEMU counts 64 ns for each instruction.
    const MAX_INSTRUCTIONS: u32 = 4_000_000 / 64;
    const FLASH_BLOCKS: bool = false;
    // RAM does not wear, so the number of changes is unlimited.
    const SLOT_WRITES: u32 = u32::MAX;
    type Link = Uart;
    type Log = Uart;
    type Flash = PsramFlash;
    type Strobe = Led;

    fn start() -> Option<Parts<Self>> {
        static ONCE: ConstStaticCell<()> = ConstStaticCell::new(());
        ONCE.try_take()?;
        for divider in const { [Register::at(UART0 + 16), Register::at(UART1 + 16)] } {
            divider.write(UART_HZ / BAUD);
        }
        let (link, log) = (uart!(UART0), uart!(UART1));
        log.ctrl.write(CTRL_ENABLE);
        link.ctrl.write(CTRL_ENABLE | CTRL_RX_INTERRUPT);
        addresses::start_counter();
        WATCHDOG_LOCK.write(WATCHDOG_UNLOCK);
        WATCHDOG_LOAD.write(WATCHDOG_TICKS);
        WATCHDOG_CTRL.write(WATCHDOG_COUNT_AND_RESET);
        let layout = Layout {
            slots: [0..SLOT, SLOT..2 * SLOT],
            key: 2 * SLOT..2 * SLOT + PAGE,
            cycle: 2 * SLOT + PAGE..FLASH_BYTES,
        };
        Some(Parts {
            core_hz: CLOCK_HZ,
            link,
            log,
            flash: PsramFlash,
            layout,
            strobe: Led,
        })
    }

    fn listen() {
        for number in UART0_INTERRUPTS {
            enable_interrupt(Interrupt(number));
        }
    }

    #[inline(always)]
    fn ticks() -> u32 {
        addresses::counter()
    }

    fn feed_watchdog() {
        WATCHDOG_INTCLR.write(1);
    }
}
