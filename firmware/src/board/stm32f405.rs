//! STM32F405 with stm32f4xx-hal: for instance an Olimex STM32-H405, an Adafruit Feather, or a Netduino Plus 2.
//!
//! ```text
//!  PA9, PA10   USART1   link, 1 Mbaud              8 MHz crystal: 168 MHz. None, or QEMU: 16 MHz, internal oscillator
//!  PA2, PA3    USART2   defmt, 115 200 baud
//!  PB0         output   strobe
//!  TIM2                 ticks, 1 MHz
//!  flash       sectors 0–5 image, 6 settings, 7 key, 8–9 slot A, 10–11 slot B (6 to 11: 128 kB each; the head of a
//!                       slot takes one)
//! ```
//!
//! The flash has one bank: while it erases or writes, the processor waits. So the service refuses to touch it while
//! cyclic requests are expected ([`Board::FLASH_BLOCKS`]).
//!
//! QEMU's `netduinoplus2` runs the same image. It models neither the clock tree (the crystal never starts, so the
//! internal oscillator is used) nor the flash controller: there, nothing can be stored.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use embedded_storage::nor_flash::{
    ErrorType as FlashErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use poegp_runtime::store::Layout;
use stm32f4xx_hal::flash::FlashExt;
use stm32f4xx_hal::gpio::{Output, PB0};
use stm32f4xx_hal::pac::{self, FLASH, Interrupt, TIM2, USART1, USART2};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{Config, Enable, Rcc, Reset};
use stm32f4xx_hal::serial::{self, Event, RxISR, Serial, TxISR};

use crate::board::{Board, Link, Parts};
use crate::hal_unsafe::{Region, Register, enable_interrupt};

const CRYSTAL_MHZ: u32 = 8;
const CORE_MHZ: u32 = 168;
/// Looks at the crystal before it is taken to be missing: some milliseconds; it starts within two.
const CRYSTAL_LOOKS: u32 = 20_000;
const LINK_BAUD: u32 = 1_000_000;
const LOG_BAUD: u32 = 115_200;
const TICK_HZ: u32 = 1_000_000;

const TIM2_COUNT: Register = Register::at(0x4000_0024);

const IWDG_KEY: Register = Register::at(0x4000_3000);
const IWDG_PRESCALER: Register = Register::at(0x4000_3004);
const IWDG_RELOAD: Register = Register::at(0x4000_3008);
const IWDG_START: u32 = 0xcccc;
const IWDG_UNLOCK: u32 = 0x5555;
const IWDG_FEED: u32 = 0xaaaa;
/// 32 kHz / 256: 8 s. Erasing one sector takes up to 4.
const IWDG_TICKS: u32 = 1_000;

const RCC_AHB2_ENABLE: Register = Register::at(0x4002_3834);
const RNG_ENABLE: u32 = 1 << 6;
const RNG_CONTROL: Register = Register::at(0x5006_0800);
const RNG_STATUS: Register = Register::at(0x5006_0804);
const RNG_DATA: Register = Register::at(0x5006_0808);
const RNG_RUN: u32 = 1 << 2;
const RNG_READY: u32 = 1;
/// Ready, and the two errors: of the clock, of the noise.
const RNG_STATES: u32 = RNG_READY | 0b110;
const RNG_LOOKS: u32 = 10_000;

/// A serial line of the HAL with the traits of embedded-io.
pub struct Line<U: serial::Instance>(Serial<U>);

impl<U: serial::Instance> ErrorType for Line<U> {
    type Error = Infallible;
}

impl<U: serial::Instance> ReadReady for Line<U> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_rx_not_empty())
    }
}

impl<U: serial::Instance> Read for Line<U>
where
    Serial<U>: embedded_hal_nb::serial::Read<u8>,
{
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        // A byte that the hardware finds wrong is as good as lost: the frame's CRC shows it.
        match (
            buffer.first_mut(),
            embedded_hal_nb::serial::Read::read(&mut self.0),
        ) {
            (Some(slot), Ok(byte)) => {
                *slot = byte;
                Ok(1)
            }
            _ => Ok(0),
        }
    }
}

impl<U: serial::Instance> WriteReady for Line<U> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_tx_empty())
    }
}

impl<U: serial::Instance> Write for Line<U>
where
    Serial<U>: embedded_hal_nb::serial::Write<u8>,
{
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.first().map_or(0, |byte| {
            // It is ready: the writer has asked.
            usize::from(embedded_hal_nb::serial::Write::write(&mut self.0, *byte).is_ok())
        }))
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Link for Line<USART1> {
    // Reading and writing the data register clear everything.
    fn acknowledge(&mut self) {}
    fn notify_writable(&mut self, wanted: bool) {
        if wanted {
            self.0.listen(Event::TxEmpty);
        } else {
            self.0.unlisten(Event::TxEmpty);
        }
    }
}

const SECTOR: u32 = 128 * 1024;
/// Sector 6, which begins as far from the start of the flash.
const STORE_START: u32 = 2 * SECTOR;
const STORE_BYTES: u32 = 6 * SECTOR;
const STORE: Region = Region::at(0x0800_0000 + STORE_START as usize, STORE_BYTES as usize / 4);
const FIRST_SECTOR: u32 = 6;

/// Sectors 6 to 11 of the internal flash.
pub struct InternalFlash(FLASH);

/// The flash controller has refused, or the address is beyond the end.
#[derive(Clone, Copy, Debug)]
pub struct FlashFault;

impl NorFlashError for FlashFault {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl FlashErrorType for InternalFlash {
    type Error = FlashFault;
}

impl ReadNorFlash for InternalFlash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashFault> {
        for (word, chunk) in (offset as usize / 4..).zip(bytes.chunks_mut(4)) {
            let value = STORE.read(word).ok_or(FlashFault)?;
            for (slot, byte) in chunk.iter_mut().zip(value.to_le_bytes()) {
                *slot = byte;
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        STORE_BYTES as usize
    }
}

impl NorFlash for InternalFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashFault> {
        for sector in from / SECTOR..to / SECTOR {
            let erased = self.0.unlocked().erase((FIRST_SECTOR + sector) as u8);
            erased.map_err(|_| FlashFault)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashFault> {
        let at = (STORE_START + offset) as usize;
        let written = self.0.unlocked().program(at, bytes.iter());
        written.map_err(|_| FlashFault)
    }
}

/// The board.
pub struct Stm32F405;

/// 168 MHz from the crystal, when it starts.
fn start_clock(rcc: pac::RCC) -> Rcc {
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    let starts = (0..CRYSTAL_LOOKS).any(|_| rcc.cr().read().hserdy().bit_is_set());
    rcc.freeze(if starts {
        Config::hse(CRYSTAL_MHZ.MHz())
            .sysclk(CORE_MHZ.MHz())
            .require_pll48clk()
    } else {
        Config::hsi()
    })
}

fn start_ticks(timer: TIM2, rcc: &mut Rcc) {
    TIM2::enable(rcc);
    TIM2::reset(rcc);
    let prescaler = rcc.clocks.timclk1().raw() / TICK_HZ;
    timer
        .psc()
        .write(|w| w.psc().set(prescaler.saturating_sub(1) as u16));
    timer.arr().write(|w| w.arr().set(u32::MAX));
    // Takes the prescaler over.
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr1().modify(|_, w| w.cen().set_bit());
}

fn start_watchdog() {
    IWDG_KEY.write(IWDG_START);
    IWDG_KEY.write(IWDG_UNLOCK);
    IWDG_PRESCALER.write(0b110);
    IWDG_RELOAD.write(IWDG_TICKS);
    IWDG_KEY.write(IWDG_FEED);
}

impl Board for Stm32F405 {
    const NAME: &'static str = "stm32f405";
    const TICK_HZ: u32 = TICK_HZ;
    const DEADLINE_TICKS: u32 = TICK_HZ / 1_000;
    // In 1 ms at 1.75 cycles per instruction: loads, divisions and roots take several cycles, and so does flash that has to
    // be waited for. Not measured on a board, and not true without its crystal.
    const MAX_INSTRUCTIONS: u32 = CORE_MHZ * 1_000 * 4 / 7;
    const FLASH_BLOCKS: bool = true;
    // Of the 10 000 erases of a sector that the data sheet promises, a hundredth part.
    const SLOT_WRITES: u32 = 100;
    type Link = Line<USART1>;
    type Log = Line<USART2>;
    type Flash = InternalFlash;
    type Strobe = PB0<Output>;

    fn start() -> Option<Parts<Self>> {
        let parts = pac::Peripherals::take()?;
        let mut rcc = start_clock(parts.RCC);
        let gpioa = parts.GPIOA.split(&mut rcc);
        let gpiob = parts.GPIOB.split(&mut rcc);
        let config = |baud: u32| serial::Config::default().baudrate(baud.bps());
        let mut link = parts
            .USART1
            .serial((gpioa.pa9, gpioa.pa10), config(LINK_BAUD), &mut rcc)
            .ok()?;
        link.listen(Event::RxNotEmpty);
        let log = parts
            .USART2
            .serial((gpioa.pa2, gpioa.pa3), config(LOG_BAUD), &mut rcc)
            .ok()?;
        start_ticks(parts.TIM2, &mut rcc);
        start_watchdog();
        Some(Parts {
            core_hz: rcc.clocks.hclk().raw(),
            link: Line(link),
            log: Line(log),
            flash: InternalFlash(parts.FLASH),
            layout: Layout {
                slots: [2 * SECTOR..4 * SECTOR, 4 * SECTOR..6 * SECTOR],
                key: SECTOR..2 * SECTOR,
                cycle: 0..SECTOR,
            },
            strobe: gpiob.pb0.into_push_pull_output(),
        })
    }

    fn listen() {
        enable_interrupt(Interrupt::USART1);
    }

    #[inline(always)]
    fn ticks() -> u32 {
        TIM2_COUNT.read()
    }

    fn random() -> Option<u32> {
        RCC_AHB2_ENABLE.write(RCC_AHB2_ENABLE.read() | RNG_ENABLE);
        RNG_CONTROL.write(RNG_RUN);
        // 40 clocks of 48 MHz each; none without the crystal, whose PLL makes that clock.
        let ready = (0..RNG_LOOKS).any(|_| RNG_STATUS.read() & RNG_STATES == RNG_READY);
        ready.then(|| RNG_DATA.read())
    }

    fn feed_watchdog() {
        IWDG_KEY.write(IWDG_FEED);
    }
}
