//! The panic handler. A static library without `std` must have one, but no program that links it should contain it.
//!
//! Nothing in the runtime can panic: `tests/tests/capi` checks that the linked example contains neither this function nor
//! `core::panicking`. A program that links several Rust libraries may contain only one panic handler: build the libraries
//! as one.

use core::panic::PanicInfo;

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
