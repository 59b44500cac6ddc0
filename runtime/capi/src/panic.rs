//! What a static library without `std` must have, and what no program that links it should contain.
//!
//! Nothing of the runtime can panic; `tests/tests/capi` finds neither this function nor `core::panicking` in the linked
//! example. A program that links several Rust libraries needs one of their panic handlers only: it has to build them as
//! one.

use core::panic::PanicInfo;

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
