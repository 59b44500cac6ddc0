//! The device's only loop, and what happens when there is no way on.

use cortex_m_rt::entry;
use poegp_protocol::blob::{HEADER_LENGTH, MAX_LENGTH_WITHOUT_ROWS};
use poegp_protocol::frame::{MAX_FRAME, Receiver};
use poegp_runtime::model::words_for;
use poegp_runtime::service::{Board, Service};
use static_cell::ConstStaticCell;

use crate::board::{self, Link};
use crate::log::Logged;

/// Words of support rows: 512 points of the longest row, twice what a paper model has.
const WORDS: usize = words_for(512);
/// Bytes of a blob with as many rows.
const BYTES: usize = HEADER_LENGTH + MAX_LENGTH_WITHOUT_ROWS + 4 * WORDS;

// Everything large is static, so that the linker proves that it fits. All of it is zero at the start and takes no flash.
static SERVICE: ConstStaticCell<Service<WORDS, BYTES>> = ConstStaticCell::new(Service::new());
static RECEIVER: ConstStaticCell<Receiver> = ConstStaticCell::new(Receiver::new());
static SCRATCH: ConstStaticCell<[u8; MAX_FRAME]> = ConstStaticCell::new([0; MAX_FRAME]);
static ANSWER: ConstStaticCell<[u8; MAX_FRAME]> = ConstStaticCell::new([0; MAX_FRAME]);

#[entry]
fn main() -> ! {
    // `None` cannot happen: the reset handler calls this once.
    let (Some(service), Some(receiver), Some(scratch), Some(answer), Some((board, link))) = (
        SERVICE.try_take(),
        RECEIVER.try_take(),
        SCRATCH.try_take(),
        ANSWER.try_take(),
        board::start(),
    ) else {
        halt()
    };
    defmt::info!(
        "firmware {=str} on {=str}",
        env!("CARGO_PKG_VERSION"),
        board.name()
    );
    let mut board = Logged::new(board);
    loop {
        let byte = link.receive();
        let length = service.receive(byte, receiver, &mut board, scratch, answer);
        for byte in answer.get(..length).unwrap_or(&[]) {
            link.send(*byte);
        }
    }
}

/// Stops for good. The peer sees a request without an answer, a watchdog a device to restart.
fn halt() -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

// No message: formatting would cost more flash than the whole model code, and nothing here is meant to panic. A hard
// fault ends the same way, in the default handler of cortex-m-rt.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    halt()
}
