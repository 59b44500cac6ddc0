//! Handlers for faults and for the link's interrupts. Only these and the interrupts of the cycle are enabled.

use cortex_m_rt::{ExceptionFrame, exception};
use poegp_protocol::link::StartReason;

use crate::watchdog;

/// Restarts the device after a fault at any priority, because no part of the firmware can continue.
// SAFETY of the declaration: it is called by the processor alone, and does what a safe handler may do.
#[allow(unsafe_code)]
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    watchdog::restart(StartReason::Fault {
        address: frame.pc(),
    })
}

/// Handles the link's interrupts on boards that use the vector table of cortex-m-rt.
// SAFETY of the declaration: it is called by the processor alone, and does what a safe handler may do.
#[cfg(feature = "mps2")]
#[allow(unsafe_code)]
#[exception]
unsafe fn DefaultHandler(_number: i16) {
    crate::uart::interrupt();
}

#[cfg(feature = "stm32f405")]
use stm32f4xx_hal::pac::interrupt;

/// Handles an idle line; without DMA, a received byte or a byte that can be written.
#[cfg(all(feature = "stm32f405", not(feature = "spi-link")))]
#[interrupt]
fn USART1() {
    crate::uart::interrupt();
}

/// Handles a DMA receive ring that has reached its middle or its end.
#[cfg(all(feature = "stm32f405", not(feature = "spi-link")))]
#[interrupt]
fn DMA2_STREAM5() {
    crate::uart::interrupt();
}

/// Handles the end of a piece that DMA has sent.
#[cfg(all(feature = "stm32f405", not(feature = "spi-link")))]
#[interrupt]
fn DMA2_STREAM7() {
    crate::uart::interrupt();
}

/// Handles the end of a transfer by the controller (NSS rises).
#[cfg(feature = "spi-link")]
#[interrupt]
fn EXTI4() {
    crate::uart::interrupt();
}

/// Handles a DMA receive ring that has reached its middle or its end.
#[cfg(feature = "spi-link")]
#[interrupt]
fn DMA2_STREAM0() {
    crate::uart::interrupt();
}

/// Handles a DMA send ring that has reached its middle or its end.
#[cfg(feature = "spi-link")]
#[interrupt]
fn DMA2_STREAM3() {
    crate::uart::interrupt();
}
