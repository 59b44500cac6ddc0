//! The only unsafe code of the project: device registers and the painted stack.
//!
//! Both are safe to use from outside. A [`Register`] can only be made, at compile time, for an aligned address of the
//! peripheral region of the ARMv7-M memory map, where no Rust object ever lies; no DMA is used. The stack is only read.
#![allow(unsafe_code)]

use core::ptr;

/// A 32-bit device register.
#[derive(Clone, Copy)]
pub struct Register(usize);

impl Register {
    /// The register at `address`, to be evaluated at compile time.
    pub const fn at(address: usize) -> Self {
        assert!(
            address >= 0x4000_0000 && address < 0x6000_0000 && address.is_multiple_of(4),
            "not a register of the ARMv7-M peripheral region"
        );
        Self(address)
    }

    /// Its value now.
    #[inline(always)]
    pub fn read(self) -> u32 {
        // SAFETY: aligned and in the peripheral region (checked in `at`): device memory, no Rust object.
        unsafe { ptr::with_exposed_provenance::<u32>(self.0).read_volatile() }
    }

    /// Sets it.
    #[inline(always)]
    pub fn write(self, value: u32) {
        // SAFETY: as in `read`.
        unsafe { ptr::with_exposed_provenance_mut::<u32>(self.0).write_volatile(value) }
    }
}

/// Deepest use of the stack since the start, in bytes: from the top down to the lowest word that lost its paint.
///
/// ```text
///  _stack_end (low)                                       _stack_start (high)
///  | paint  paint  paint  paint | used ... used ... used |
///                               ^-- the answer is counted from here
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
