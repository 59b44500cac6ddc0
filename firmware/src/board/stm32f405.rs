//! Board support for the STM32F405 with stm32f4xx-hal and a crystal of 8 MHz, for instance on an Olimex STM32-H405. For
//! another crystal (12 MHz on an Adafruit Feather, 25 MHz on a Netduino Plus 2) change `CRYSTAL_MHZ` first, or the clock is
//! wrong.
//!
//! ```text
//!  PA9, PA10   USART1   link, 1 Mbaud, by DMA            168 MHz from the crystal; without it 16 MHz and no model
//!  PA4 to PA7  SPI1     link with feature spi-link       NSS, SCK, MISO, MOSI
//!  PA2, PA3    USART2   defmt, 115 200 baud
//!  PB0         output   strobe
//!  TIM2                 ticks, 1 MHz
//!  flash       sectors 0–5 image, 6 settings, 7 key, 8–9 slot A, 10–11 slot B (6 to 11: 128 kB each; the head of a
//!                       slot takes one)
//! ```
//!
//! The feature `fast-link` sets the link to 4 Mbaud, which needs the crystal.
//!
//! The flash has one bank: while it erases or writes, the processor stalls. So the service refuses to touch the flash while
//! cyclic requests are expected ([`Board::FLASH_BLOCKS`]).
//!
//! QEMU's `netduinoplus2` runs the same image. It models neither the clock tree (the crystal never starts), nor DMA (the
//! link takes an interrupt for each byte), nor the flash controller (nothing can be stored). The feature `stated-clock`,
//! which no product has, assumes that the clock is right.

mod dma;
mod serial;
#[cfg(feature = "spi-link")]
mod spi;

use poegp_runtime::store::Layout;
use stm32f4xx_hal::gpio::{Output, PB0};
use stm32f4xx_hal::pac::{self, Interrupt, TIM2, USART2};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{Config, Enable, Rcc, Reset};
use stm32f4xx_hal::serial as hal_serial;

use crate::board::{Board, Parts};
use crate::drivers::flash::{self, FlashRegister, FlashRegisters, SectorFlash};
use crate::hal_unsafe::{Region, Register, enable_interrupt};

const CRYSTAL_MHZ: u32 = 8;
const CORE_MHZ: u32 = 168;
/// Number of polls of the crystal before it counts as missing: some milliseconds; a crystal starts within 2 ms.
const CRYSTAL_LOOKS: u32 = 20_000;
/// Baud rates of the link without and with the crystal. Without it, only the lower one works on the internal oscillator.
#[cfg(not(feature = "spi-link"))]
const LINK_BAUD: [u32; 2] = [1_000_000, FAST_BAUD];
#[cfg(all(feature = "fast-link", not(feature = "spi-link")))]
const FAST_BAUD: u32 = 4_000_000;
#[cfg(not(any(feature = "fast-link", feature = "spi-link")))]
const FAST_BAUD: u32 = 1_000_000;
const LOG_BAUD: u32 = 115_200;
const TICK_HZ: u32 = 1_000_000;

const TIM2_COUNT: Register = Register::at(0x4000_0024);

const IWDG_KEY: Register = Register::at(0x4000_3000);
const IWDG_PRESCALER: Register = Register::at(0x4000_3004);
const IWDG_RELOAD: Register = Register::at(0x4000_3008);
const IWDG_START: u32 = 0xcccc;
const IWDG_UNLOCK: u32 = 0x5555;
const IWDG_FEED: u32 = 0xaaaa;
/// Timeout of the watchdog in ticks of 32 kHz / 256: 8 s. An erase of one sector takes up to 4 s.
const IWDG_TICKS: u32 = 1_000;

const RCC_AHB2_ENABLE: Register = Register::at(0x4002_3834);
const RNG_ENABLE: u32 = 1 << 6;
const RNG_CONTROL: Register = Register::at(0x5006_0800);
const RNG_STATUS: Register = Register::at(0x5006_0804);
const RNG_DATA: Register = Register::at(0x5006_0808);
const RNG_RUN: u32 = 1 << 2;
const RNG_READY: u32 = 1;
/// Status bits of the random number generator: ready, clock error and noise error.
const RNG_STATES: u32 = RNG_READY | 0b110;
const RNG_LOOKS: u32 = 10_000;

const SECTOR: u32 = flash::SECTOR;
const STORE: Region = Region::at(
    0x0800_0000 + flash::START_OFFSET as usize,
    flash::BYTES as usize / 4,
);
/// Number of polls of the busy flag, about eight cycles each: longer than any erase, shorter than the watchdog's timeout.
const FLASH_LOOKS: u32 = 100_000_000;

const RCC_AHB1_ENABLE: Register = Register::at(0x4002_3830);
const DMA2_CLOCK: u32 = 1 << 22;

/// The flash controller at 0x4002_3c00, and the sectors after the image.
pub struct Controller;

const fn register(register: FlashRegister) -> Register {
    Register::at(0x4002_3c00 + register as usize)
}

impl FlashRegisters for Controller {
    fn get(&mut self, which: FlashRegister) -> u32 {
        register(which).read()
    }

    fn set(&mut self, which: FlashRegister, value: u32) {
        register(which).write(value);
    }

    fn load(&mut self, offset: u32) -> Option<u32> {
        STORE.read(offset.checked_sub(flash::START_OFFSET)? as usize / 4)
    }

    fn store_word(&mut self, offset: u32, value: u32) {
        let inside = offset.wrapping_sub(flash::START_OFFSET);
        STORE.write(inside as usize / 4, value);
    }

    fn store_byte(&mut self, offset: u32, value: u8) {
        let inside = offset.wrapping_sub(flash::START_OFFSET);
        STORE.write_byte(inside as usize, value);
    }
}

/// The STM32F405 board.
pub struct Stm32F405;

/// Sets the clock to 168 MHz from the crystal, or to the internal oscillator if the crystal does not start.
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
    // The update event loads the prescaler.
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
    // The limit is for 1 ms at 1.75 cycles per instruction: loads, divisions and roots take several cycles, and so do wait
    // states of the flash. It was not measured on a board. Without the crystal the device accepts no model.
    const CLOCK_HZ: u32 = CORE_MHZ * 1_000_000;
    const MAX_INSTRUCTIONS: u32 = CORE_MHZ * 1_000 * 4 / 7;
    const FLASH_BLOCKS: bool = true;
    // One hundredth of the 10 000 erases per sector that the data sheet guarantees.
    const SLOT_WRITES: u32 = 100;
    #[cfg(not(feature = "spi-link"))]
    type Link = serial::Uart;
    #[cfg(feature = "spi-link")]
    type Link = spi::Spi;
    type Log = serial::Line<USART2>;
    type Flash = SectorFlash<Controller>;
    type Strobe = PB0<Output>;

    // Not inlined, so that the background does not keep the stack frame of this function.
    #[inline(never)]
    fn start() -> Option<Parts<Self>> {
        let parts = pac::Peripherals::take()?;
        let mut rcc = start_clock(parts.RCC);
        let gpioa = parts.GPIOA.split(&mut rcc);
        let gpiob = parts.GPIOB.split(&mut rcc);
        let config = |baud: u32| hal_serial::Config::default().baudrate(baud.bps());
        RCC_AHB1_ENABLE.write(RCC_AHB1_ENABLE.read() | DMA2_CLOCK);
        #[cfg(not(feature = "spi-link"))]
        let link = {
            let fast = usize::from(rcc.clocks.hclk().raw() >= Self::CLOCK_HZ);
            let baud = LINK_BAUD.get(fast).copied()?;
            let pins = (gpioa.pa9, gpioa.pa10);
            let line = parts.USART1.serial(pins, config(baud), &mut rcc).ok()?;
            serial::Uart::new(line)
        };
        #[cfg(feature = "spi-link")]
        let link = {
            // The pins keep their function after these values are dropped.
            gpioa.pa4.into_alternate::<5>();
            gpioa.pa5.into_alternate::<5>();
            gpioa.pa6.into_alternate::<5>();
            gpioa.pa7.into_alternate::<5>();
            spi::Spi::start()
        };
        let log = parts
            .USART2
            .serial((gpioa.pa2, gpioa.pa3), config(LOG_BAUD), &mut rcc)
            .ok()?;
        start_ticks(parts.TIM2, &mut rcc);
        start_watchdog();
        Some(Parts {
            core_hz: rcc.clocks.hclk().raw(),
            link,
            log: serial::Line(log),
            flash: SectorFlash::new(Controller, FLASH_LOOKS),
            layout: Layout {
                slots: [2 * SECTOR..4 * SECTOR, 4 * SECTOR..6 * SECTOR],
                key: SECTOR..2 * SECTOR,
                cycle: 0..SECTOR,
            },
            strobe: gpiob.pb0.into_push_pull_output(),
        })
    }

    #[cfg(not(feature = "spi-link"))]
    fn listen() {
        enable_interrupt(Interrupt::USART1);
        enable_interrupt(Interrupt::DMA2_STREAM5);
        enable_interrupt(Interrupt::DMA2_STREAM7);
    }

    #[cfg(feature = "spi-link")]
    fn listen() {
        enable_interrupt(Interrupt::EXTI4);
        enable_interrupt(Interrupt::DMA2_STREAM0);
        enable_interrupt(Interrupt::DMA2_STREAM3);
    }

    #[inline(always)]
    fn ticks() -> u32 {
        TIM2_COUNT.read()
    }

    fn random() -> Option<u32> {
        RCC_AHB2_ENABLE.write(RCC_AHB2_ENABLE.read() | RNG_ENABLE);
        RNG_CONTROL.write(RNG_RUN);
        // A number takes 40 clocks of 48 MHz. Without the crystal there is none, because its PLL generates that clock.
        let ready = (0..RNG_LOOKS).any(|_| RNG_STATUS.read() & RNG_STATES == RNG_READY);
        ready.then(|| RNG_DATA.read())
    }

    fn supply_is_sure() -> bool {
        SectorFlash::new(Controller, 1).supply_is_sure()
    }

    fn feed_watchdog() {
        IWDG_KEY.write(IWDG_FEED);
    }
}
