//! The drivers of the boards against models of the hardware: DMA that writes at any moment, and the flash controller of the
//! STM32F4.

#[allow(dead_code)]
#[path = "../../src/drivers/mod.rs"]
mod drivers;

mod flash_controller;
mod flash_rules;
mod lines;
mod store;

/// Returns a random number below `below` (xorshift).
pub fn random(state: &mut u64, below: usize) -> usize {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    ((*state >> 11) % below as u64) as usize
}
