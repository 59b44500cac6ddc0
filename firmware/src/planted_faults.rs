//! Faults that the tests plant. Only the feature `planted-faults` compiles them; no product image has it.
//!
//! `Activate` with the CRC of a model that cannot exist requests a fault; a product image answers that there is no such
//! model. The numbers are those of `tests/tests/device/planted.rs`. That test looks for the functions below in the image,
//! so they are not inlined.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::asm;
use poegp_protocol::link::Request;

use crate::board::{Board, Chosen};

static FLASH_STAYS_BUSY: AtomicBool = AtomicBool::new(false);
static FLASH_IS_SLOW: AtomicBool = AtomicBool::new(false);
static FLASH_STOPS_THE_PROCESSOR: AtomicBool = AtomicBool::new(false);
static CYCLE_HANGS: AtomicBool = AtomicBool::new(false);

fn hang() -> ! {
    loop {
        asm::nop();
    }
}

/// Waits 4 s, the longest time that the STM32F405 takes to erase a sector.
fn wait_4_s() {
    let start = Chosen::ticks();
    while Chosen::ticks().wrapping_sub(start) < 4 * Chosen::TICK_HZ {}
}

/// Triggers a fault that `request` asks for. Called by the background before each service.
#[inline(never)]
pub fn in_background(request: &Request<'_>) {
    let Request::Activate { blob_crc } = request else {
        return;
    };
    match blob_crc {
        0xfa17_0001 => panic!(),
        0xfa17_0002 => hang(),
        0xfa17_0003 => FLASH_STAYS_BUSY.store(true, Ordering::Relaxed),
        0xfa17_0004 => cortex_m::interrupt::free(|_| hang()),
        0xfa17_0005 => asm::udf(),
        0xfa17_0006 => CYCLE_HANGS.store(true, Ordering::Relaxed),
        0xfa17_0007 => FLASH_IS_SLOW.store(true, Ordering::Relaxed),
        0xfa17_0008 => FLASH_STOPS_THE_PROCESSOR.store(true, Ordering::Relaxed),
        _ => {}
    }
}

/// Triggers planted flash faults. Called before each flash erase.
#[inline(never)]
pub fn in_flash() {
    if FLASH_STAYS_BUSY.load(Ordering::Relaxed) {
        hang();
    }
    if FLASH_IS_SLOW.load(Ordering::Relaxed) {
        wait_4_s();
    }
    if FLASH_STOPS_THE_PROCESSOR.load(Ordering::Relaxed) {
        cortex_m::interrupt::free(|_| wait_4_s());
    }
}

/// Triggers a planted hang. Called by the cycle.
#[inline(never)]
pub fn in_cycle() {
    if CYCLE_HANGS.load(Ordering::Relaxed) {
        hang();
    }
}
