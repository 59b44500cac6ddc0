//! Arm MPS2 with FPGA image AN386: a Cortex-M4F, as QEMU emulates it (`-M mps2-an386`).
//!
//! Registers from "Application Note AN386" and the "Cortex-M System Design Kit TRM" (ARM DDI 0479): APB UART, ch. 4.3,
//! APB timer, ch. 4.1. The system clock, which feeds both, is 25 MHz.
//!
//! ```text
//!  0x4000_0000  TIMER0   CTRL +0  VALUE +4  RELOAD +8            Board::ticks
//!  0x4000_4000  UART0    DATA +0  STATE +4  CTRL +8  BAUDDIV +16 link
//!  0x4000_5000  UART1    the same                                defmt
//! ```

use core::convert::Infallible;

use poegp_runtime::service::Board;
use static_cell::ConstStaticCell;

use crate::board::Link;
use crate::memory::{self, Register};

const CLOCK_HZ: u32 = 25_000_000;
const BAUD: u32 = 115_200;

const TIMER_CTRL: Register = Register::at(0x4000_0000);
const TIMER_VALUE: Register = Register::at(0x4000_0004);
const TIMER_RELOAD: Register = Register::at(0x4000_0008);
const TIMER_ENABLE: u32 = 1;

/// One APB UART, polled.
pub struct Uart {
    data: Register,
    state: Register,
}

const STATE_TX_FULL: u32 = 1;
const STATE_RX_FULL: u32 = 2;
const CTRL_TX_ENABLE: u32 = 1;
const CTRL_RX_ENABLE: u32 = 2;

macro_rules! uart {
    ($base:literal) => {{
        const DATA: Register = Register::at($base);
        const STATE: Register = Register::at($base + 4);
        const CTRL: Register = Register::at($base + 8);
        const BAUDDIV: Register = Register::at($base + 16);
        BAUDDIV.write(CLOCK_HZ / BAUD);
        CTRL.write(CTRL_TX_ENABLE | CTRL_RX_ENABLE);
        Uart {
            data: DATA,
            state: STATE,
        }
    }};
}

impl Link for Uart {
    fn receive(&self) -> u8 {
        while self.state.read() & STATE_RX_FULL == 0 {}
        self.data.read() as u8
    }
    fn send(&self, byte: u8) {
        while self.state.read() & STATE_TX_FULL != 0 {}
        self.data.write(u32::from(byte));
    }
}

/// The second UART as the writer that defmt wants.
struct LogLine(Option<Uart>);

impl embedded_io::ErrorType for LogLine {
    type Error = Infallible;
}

impl embedded_io::Write for LogLine {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if let Some(uart) = &self.0 {
            for byte in bytes {
                uart.send(*byte);
            }
        }
        Ok(bytes.len())
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The board.
pub struct Mps2An386;

impl Board for Mps2An386 {
    fn name(&self) -> &str {
        "mps2-an386"
    }
    fn tick_hz(&self) -> u32 {
        CLOCK_HZ
    }
    #[inline(always)]
    fn ticks(&mut self) -> u32 {
        // The timer counts down from 2³² − 1.
        !TIMER_VALUE.read()
    }
    fn stack_bytes(&mut self) -> u32 {
        memory::stack_bytes()
    }
}

/// Starts timer, link and log; `None` when called again.
pub fn start() -> Option<(Mps2An386, impl Link)> {
    static LOG_LINE: ConstStaticCell<LogLine> = ConstStaticCell::new(LogLine(None));
    let log_line = LOG_LINE.try_take()?;
    log_line.0 = Some(uart!(0x4000_5000));
    defmt_serial::defmt_serial(log_line);
    TIMER_RELOAD.write(u32::MAX);
    TIMER_VALUE.write(u32::MAX);
    TIMER_CTRL.write(TIMER_ENABLE);
    Some((Mps2An386, uart!(0x4000_4000)))
}
