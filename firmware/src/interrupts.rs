//! The interrupts of the link, the only ones that are enabled beside the cycle's; and faults.

use cortex_m_rt::{ExceptionFrame, exception};
use poegp_protocol::link::StartReason;

use crate::watchdog;

/// Of whatever priority: it is over.
// SAFETY of the declaration: it is called by the processor alone, and does what a safe handler may do.
#[allow(unsafe_code)]
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    watchdog::restart(StartReason::Fault {
        address: frame.pc(),
    })
}

/// Of a board whose vector table is that of cortex-m-rt.
// SAFETY of the declaration: it is called by the processor alone, and does what a safe handler may do.
#[cfg(feature = "mps2")]
#[allow(unsafe_code)]
#[exception]
unsafe fn DefaultHandler(_number: i16) {
    crate::uart::interrupt();
}

#[cfg(feature = "stm32f405")]
use stm32f4xx_hal::pac::interrupt;

#[cfg(feature = "stm32f405")]
#[interrupt]
fn USART1() {
    crate::uart::interrupt();
}
