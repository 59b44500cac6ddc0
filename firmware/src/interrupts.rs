//! The interrupts of the link, the only ones that are enabled beside the cycle's; and faults.

use cortex_m_rt::{ExceptionFrame, exception};
use poegp_protocol::link::StartReason;

use crate::watchdog;

/// Restarts the device after a fault at any priority: nothing can continue.
// SAFETY of the declaration: it is called by the processor alone, and does what a safe handler may do.
#[allow(unsafe_code)]
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    watchdog::restart(StartReason::Fault {
        address: frame.pc(),
    })
}

/// Handles the link's interrupts on a board whose vector table is that of cortex-m-rt.
// SAFETY of the declaration: it is called by the processor alone, and does what a safe handler may do.
#[cfg(feature = "mps2")]
#[allow(unsafe_code)]
#[exception]
unsafe fn DefaultHandler(_number: i16) {
    crate::uart::interrupt();
}

#[cfg(feature = "stm32f405")]
use stm32f4xx_hal::pac::interrupt;

/// The line is idle; or, without DMA, a byte.
#[cfg(all(feature = "stm32f405", not(feature = "spi-link")))]
#[interrupt]
fn USART1() {
    crate::uart::interrupt();
}

/// Half of what can be received has come.
#[cfg(all(feature = "stm32f405", not(feature = "spi-link")))]
#[interrupt]
fn DMA2_STREAM5() {
    crate::uart::interrupt();
}

/// A piece was sent.
#[cfg(all(feature = "stm32f405", not(feature = "spi-link")))]
#[interrupt]
fn DMA2_STREAM7() {
    crate::uart::interrupt();
}

/// The controller ends a transfer.
#[cfg(feature = "spi-link")]
#[interrupt]
fn EXTI4() {
    crate::uart::interrupt();
}

/// Half of what can be received has come.
#[cfg(feature = "spi-link")]
#[interrupt]
fn DMA2_STREAM0() {
    crate::uart::interrupt();
}

/// Half of what is sent was sent.
#[cfg(feature = "spi-link")]
#[interrupt]
fn DMA2_STREAM3() {
    crate::uart::interrupt();
}
