//! Everything that needs unsafe Rust: registers, memory outside of Rust's own, priorities, interrupts.
//!
//! The interface of this module is safe. A [`Register`] or a [`Region`] can only be created, at compile time, for addresses
//! at which no Rust object ever lies. A DMA controller only accesses a [`DmaMemory`], to which no reference exists. The
//! stack and the image are only read.
#![allow(unsafe_code)]

use core::ptr;

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use poegp_protocol::blob::CRC;

/// A 32-bit device register.
#[derive(Clone, Copy)]
pub struct Register(usize);

impl Register {
    /// Creates the register at `address`. To be evaluated at compile time.
    pub const fn at(address: usize) -> Self {
        assert!(
            address >= 0x4000_0000 && address < 0x6000_0000 && address.is_multiple_of(4),
            "not a register of the ARMv7-M peripheral region"
        );
        Self(address)
    }

    /// Reads the register.
    #[inline(always)]
    pub fn read(self) -> u32 {
        // SAFETY: aligned and in the peripheral region (checked in `at`): device memory, no Rust object.
        unsafe { ptr::with_exposed_provenance::<u32>(self.0).read_volatile() }
    }

    /// Writes the register.
    #[inline(always)]
    pub fn write(self, value: u32) {
        // SAFETY: as in `read`.
        unsafe { ptr::with_exposed_provenance_mut::<u32>(self.0).write_volatile(value) }
    }
}

/// Memory that the linker does not use: the external RAM of the MPS2 boards, or the flash of the STM32F405 after the image.
#[derive(Clone, Copy)]
pub struct Region {
    start: usize,
    words: usize,
}

impl Region {
    /// Creates the region of `words` words from `start` on. To be evaluated at compile time.
    pub const fn at(start: usize, words: usize) -> Self {
        let end = start + 4 * words;
        assert!(
            (start >= 0x2100_0000 && end <= 0x2200_0000)
                || (start >= 0x6000_0000 && end <= 0x6100_0000)
                || (start >= 0x0804_0000 && end <= 0x0810_0000),
            "not memory that the linker leaves alone"
        );
        assert!(start.is_multiple_of(4), "not aligned");
        Self { start, words }
    }

    /// Reads the word at index `word`; `None` beyond the end.
    #[inline(always)]
    pub fn read(self, word: usize) -> Option<u32> {
        (word < self.words).then(|| {
            // SAFETY: aligned and inside the region (checked in `at` and above), which no Rust object shares.
            unsafe { ptr::with_exposed_provenance::<u32>(self.start + 4 * word).read_volatile() }
        })
    }

    /// Writes the word at index `word`; does nothing beyond the end.
    #[inline(always)]
    pub fn write(self, word: usize, value: u32) {
        if word < self.words {
            let address = self.start + 4 * word;
            // SAFETY: as in `read`.
            unsafe { ptr::with_exposed_provenance_mut::<u32>(address).write_volatile(value) }
        }
    }

    /// Writes the byte at offset `byte`; does nothing beyond the end.
    #[cfg(feature = "stm32f405")]
    pub fn write_byte(self, byte: usize, value: u8) {
        if byte < 4 * self.words {
            // SAFETY: as in `read`.
            unsafe {
                ptr::with_exposed_provenance_mut::<u8>(self.start + byte).write_volatile(value)
            }
        }
    }
}

/// Memory that a DMA controller may read or write at any time. It is zero at the start.
#[cfg(feature = "stm32f405")]
pub struct DmaMemory<const BYTES: usize>(core::cell::UnsafeCell<[u8; BYTES]>);

// SAFETY: nothing has a reference to the bytes. Each access is one byte, volatile; any bits are a byte.
#[cfg(feature = "stm32f405")]
unsafe impl<const BYTES: usize> Sync for DmaMemory<BYTES> {}

#[cfg(feature = "stm32f405")]
impl<const BYTES: usize> DmaMemory<BYTES> {
    /// Creates zeroed memory, for a `static`.
    pub const fn new() -> Self {
        Self(core::cell::UnsafeCell::new([0; BYTES]))
    }

    /// Returns the address of the memory, for the address register of a stream that moves at most `BYTES` bytes.
    pub fn address(&'static self) -> u32 {
        self.0.get().expose_provenance() as u32
    }

    /// Reads the byte at index `at`; 0 beyond the end.
    #[inline(always)]
    pub fn read(&'static self, at: usize) -> u8 {
        if at >= BYTES {
            return 0;
        }
        // SAFETY: inside, and see above.
        unsafe { self.0.get().cast::<u8>().add(at).read_volatile() }
    }

    /// Writes the byte at index `at`; does nothing beyond the end.
    #[inline(always)]
    pub fn write(&'static self, at: usize, byte: u8) {
        if at < BYTES {
            // SAFETY: inside, and see above.
            unsafe { self.0.get().cast::<u8>().add(at).write_volatile(byte) }
        }
    }
}

/// Returns the maximum stack usage since the start, in bytes: from the top down to the lowest word that lost its paint.
///
/// ```text
///  _stack_end (low)                                       _stack_start (high)
///  | paint  paint  paint  paint | used ... used ... used |
///                               ^-- the result is counted from here
/// ```
pub fn stack_bytes() -> u32 {
    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }
    let end = &raw const _stack_start;
    let mut word = &raw const _stack_end;
    // SAFETY: cortex-m-rt provides both symbols, aligned to words; between them is RAM that it has painted, and what
    // the stack holds is read as plain words and not kept.
    unsafe {
        while word < end && word.read_volatile() == cortex_m_rt::STACK_PAINT_VALUE {
            word = word.add(1);
        }
    }
    end.addr().wrapping_sub(word.addr()) as u32
}

/// Computes the CRC-32C of the image in flash: vectors, code, constants and initial values. Padding bytes between them are
/// excluded, because their values are unspecified.
pub fn image_crc() -> u32 {
    unsafe extern "C" {
        static __vector_table: u8;
        static __etext: u8;
        static __srodata: u8;
        static __erodata: u8;
        static __sidata: u8;
        static __sdata: u8;
        static __edata: u8;
    }
    let data = (&raw const __edata).addr() - (&raw const __sdata).addr();
    let initial_values = (&raw const __sidata).addr();
    let parts = [
        (
            (&raw const __vector_table).addr(),
            (&raw const __etext).addr(),
        ),
        ((&raw const __srodata).addr(), (&raw const __erodata).addr()),
        (initial_values, initial_values + data),
    ];
    let mut digest = CRC.digest();
    for (start, end) in parts {
        for address in start..end {
            // SAFETY: between the symbols of the linker lies the image, which nobody writes. Not a slice: on some boards
            // it starts at address 0, where Rust has no object.
            let byte = unsafe { ptr::with_exposed_provenance::<u8>(address).read_volatile() };
            digest.update(&[byte]);
        }
    }
    digest.finalize()
}

/// Numbers that survive a restart, but not a power failure: the start neither loads nor clears them. After each number comes
/// a check word, its complement mixed with a constant. Memory that has lost its power, or a write that a restart has cut
/// short, therefore reads as no number.
///
/// ```text
///  number  0  restarts so far  1  bypass  2  reason for the next start  3  location of a panic or fault  4  nonces so far
/// ```
#[unsafe(link_section = ".uninit.retained")]
static mut RETAINED: [u32; 2 * NUMBERS] = [0; 2 * NUMBERS];

const NUMBERS: usize = 5;
const CHECK: u32 = !0x706f_6567;

/// The numbers that survive a restart. Each is written at one priority only, or by code that ends in a restart.
#[derive(Clone, Copy)]
pub enum Retained {
    /// Number of restarts since power-on. Written at the start.
    Restarts,
    /// 1 if corrections are bypassed, else 0. Written by the background.
    Bypass,
    /// Reason for the next start. Written by SysTick.
    Reason,
    /// Detail of the reason: the line of a panic or the address of a fault.
    Where,
    /// Number of nonces since power-on. Written by the background.
    Nonces,
}

/// Reads a retained number; `None` if its check word does not match.
pub fn retained(which: Retained) -> Option<u32> {
    let number = (&raw const RETAINED)
        .cast::<u32>()
        .wrapping_add(2 * which as usize);
    // SAFETY: inside the array, which nothing but this and `retain` touches; any bits are a number. An interrupt between
    // the two reads writes neither: see `Retained`.
    let (value, check) = unsafe { (number.read_volatile(), number.add(1).read_volatile()) };
    (value ^ check == CHECK).then_some(value)
}

/// Writes a number that survives a restart.
pub fn retain(which: Retained, value: u32) {
    let number = (&raw mut RETAINED)
        .cast::<u32>()
        .wrapping_add(2 * which as usize);
    // SAFETY: as above.
    unsafe {
        number.write_volatile(value);
        number.add(1).write_volatile(value ^ CHECK);
    }
}

/// Sets PendSV and SysTick to the lowest priority and starts SysTick with a period of `cycles` core cycles.
pub fn start_system_handlers(cycles: u32) {
    // SAFETY: called once, by `main`, which is the only owner of the core's peripherals; no critical section relies on
    // priorities.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    unsafe {
        core.SCB.set_priority(SystemHandler::PendSV, 0xff);
        core.SCB.set_priority(SystemHandler::SysTick, 0xff);
    }
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(cycles.clamp(1, 0x00ff_ffff));
    core.SYST.clear_current();
    core.SYST.enable_interrupt();
    core.SYST.enable_counter();
}

/// Sleeps until an interrupt comes, unless `there_is_work` returns true. It is called with interrupts disabled.
pub fn sleep_unless(there_is_work: impl FnOnce() -> bool) {
    critical_section::with(|_| {
        if !there_is_work() {
            // A pending interrupt wakes the processor and runs when the critical section ends.
            cortex_m::asm::wfi();
        }
    });
}

/// Resets the processor and its peripherals.
pub fn reset() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

/// Enables an interrupt.
pub fn enable_interrupt(interrupt: impl InterruptNumber) {
    // SAFETY: its handler shares nothing that is not behind a critical section, which is no mask of priorities.
    unsafe { cortex_m::peripheral::NVIC::unmask(interrupt) }
}

/// Interrupt number on a board that uses the vector table of cortex-m-rt.
#[cfg(feature = "mps2")]
#[derive(Clone, Copy)]
pub struct Interrupt(pub u16);

// SAFETY: the board's modules name interrupts that there are; all lead to `DefaultHandler` of `interrupts`.
#[cfg(feature = "mps2")]
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self.0
    }
}
