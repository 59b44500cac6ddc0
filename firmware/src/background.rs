//! The start of the firmware, and the background, which runs the services one at a time and writes the log.

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use embedded_io::{Write, WriteReady};
use heapless::Vec;
use poegp_protocol::link::frame::{self, MAX_FRAME, Receiver};
use poegp_protocol::link::{ModelIdentity, NONCE_LENGTH, Response, StartReason, Statistics};
use poegp_runtime::service::{
    Background, BoardInfo, Cycle, CycleAck, CycleCommand, Device, ModelSlot, self_test,
};
use poegp_runtime::store::Store;
use static_cell::ConstStaticCell;

use crate::board::{Board, Chosen};
use crate::capacity::{BYTES, WORDS};
use crate::cycle::{self, Answer, Front};
use crate::hal_unsafe::{Retained, retain, retained};
use crate::uart::{self, LINE, Line};
use crate::watchdog::{self, WatchedFlash};
use crate::{defmt_ring, hal_unsafe, log};

// All large data are static, so that the linker proves that they fit. They are zero at the start and take no flash.
static MODELS: ConstStaticCell<[ModelSlot<WORDS>; 2]> =
    ConstStaticCell::new([ModelSlot::new(), ModelSlot::new()]);
static STAGED: ConstStaticCell<Vec<u8, BYTES>> = ConstStaticCell::new(Vec::new());
static RECEIVERS: ConstStaticCell<[Receiver; 2]> =
    ConstStaticCell::new([Receiver::new(), Receiver::new()]);
static BUFFERS: ConstStaticCell<[[u8; MAX_FRAME]; 4]> = ConstStaticCell::new([[0; MAX_FRAME]; 4]);

type Services = Background<'static, WatchedFlash<<Chosen as Board>::Flash>, WORDS, BYTES>;

#[entry]
fn main() -> ! {
    let reason = watchdog::start_reason();
    if let Some((mut services, mut shell)) = start(reason) {
        shell.boot(&mut services, &reason);
        loop {
            watchdog::beat();
            shell.turn(&mut services);
        }
    }
    // Unreachable: the reset handler calls this function once, and the layout of the board is valid.
    watchdog::restart(StartReason::Panic { line: line!() })
}

fn start(reason: StartReason) -> Option<(Services, Shell)> {
    let [active, spare] = MODELS.try_take()?;
    let [receiver, other_receiver] = RECEIVERS.try_take()?;
    let [scratch, out, own_scratch, answer] = BUFFERS.try_take()?;
    let staged = STAGED.try_take()?;
    let parts = Chosen::start()?;
    watchdog::beat();
    let board = BoardInfo {
        board: Chosen::NAME,
        image_crc: hal_unsafe::image_crc(),
        tick_hz: Chosen::TICK_HZ,
        deadline_ticks: Chosen::DEADLINE_TICKS,
        // QEMU has no clock tree; the stated clock lets tests of everything else run there.
        clock_hz: if cfg!(feature = "stated-clock") {
            Chosen::CLOCK_HZ
        } else {
            parts.core_hz
        },
        needed_clock_hz: Chosen::CLOCK_HZ,
        max_instructions: Chosen::MAX_INSTRUCTIONS,
        flash_blocks: Chosen::FLASH_BLOCKS,
        slot_writes: Chosen::SLOT_WRITES,
        self_test: self_test(spare),
        start: reason,
    };
    // A restart while the bypass was being noted leaves no valid number. It is then safer not to correct commands.
    let bypass = retained(Retained::Bypass) != Some(0);
    cycle::START.put(Front {
        cycle: Cycle::new(active, &board, bypass),
        receiver,
        other_receiver: Some(other_receiver),
        scratch,
        out,
        strobe: parts.strobe,
    });
    cycle::ANSWERED.put(answer);
    LINE.put(Line::new(parts.link));
    hal_unsafe::start_system_handlers(parts.core_hz / 100);
    Chosen::listen();
    let store = Store::new(WatchedFlash(parts.flash), parts.layout).ok()?;
    let shell = Shell {
        log: parts.log,
        scratch: own_scratch,
        calls: Calls,
        logged_crc: None,
    };
    Some((Background::new(board, spare, staged, store), shell))
}

/// Resources and state of the background.
struct Shell {
    log: <Chosen as Board>::Log,
    scratch: &'static mut [u8; MAX_FRAME],
    calls: Calls,
    /// CRC of the model in the last log message about the running model; 0 for no model, `None` before the first message.
    logged_crc: Option<u32>,
}

impl Shell {
    fn boot(&mut self, services: &mut Services, reason: &StartReason) {
        log::start(Chosen::NAME, reason);
        if !Chosen::supply_is_sure() {
            log::supply_is_not_sure();
        }
        for refusal in services.boot(&mut self.calls).iter().flatten() {
            log::not_started(refusal);
        }
        let model = self.calls.order(CycleCommand::Report).model;
        self.log_model(&model);
    }

    fn log_model(&mut self, model: &Option<ModelIdentity>) {
        let crc = model.as_ref().map_or(0, |model| model.blob_crc);
        if self.logged_crc != Some(crc) {
            self.logged_crc = Some(crc);
            log::running(model);
        }
    }

    fn turn(&mut self, services: &mut Services) {
        if let Some(receiver) = cycle::WORK.take() {
            #[cfg(feature = "planted-faults")]
            if let Ok((_, request)) = receiver.message() {
                crate::planted_faults::in_background(&request);
            }
            let sequence = receiver.sequence();
            let response = services.handle_frame(receiver, &mut self.calls);
            #[cfg(feature = "planted-faults")]
            let response = crate::measured::answer(receiver).unwrap_or(response);
            // Frees the receiver before the answer is sent, so that the sender's next service is never refused as busy.
            receiver.clear();
            cycle::WORKED.put(receiver);
            log::answered(&response);
            if let Response::Identity(identity) = &response {
                // Before the answer, which may wait for the line until a restart.
                retain(Retained::Bypass, u32::from(identity.bypass));
                self.log_model(&identity.model);
            }
            self.answer(sequence, &response);
            if response == Response::Restarting {
                let_the_answer_leave();
                watchdog::restart(StartReason::Requested);
            }
        }
        self.drain_log();
    }

    fn answer(&mut self, sequence: u16, response: &Response) {
        loop {
            if let Some(bytes) = cycle::ANSWERED.take() {
                // The answer always fits: the longest answer is shorter than the longest request.
                let length =
                    frame::encode(sequence, response, self.scratch, bytes).map_or(0, <[u8]>::len);
                cycle::ANSWER.put(Answer { bytes, length });
                SCB::set_pendsv();
                return;
            }
            // The previous answer still waits for an empty line. The controller may keep the line full; that is no hang.
            watchdog::beat();
            SCB::set_pendsv();
        }
    }

    /// Writes the log to its line; sleeps when there is nothing to write and no service to carry out.
    fn drain_log(&mut self) {
        while let Ok(true) = self.log.write_ready() {
            match defmt_ring::next() {
                Some(byte) => {
                    let _ = self.log.write(&[byte]);
                }
                None => {
                    hal_unsafe::sleep_unless(|| cycle::WORK.is_full());
                    return;
                }
            }
        }
    }
}

/// Waits until the answer has left the device, for a second at most: the other side of an SPI may not clock.
fn let_the_answer_leave() {
    let within = |start, ticks| Chosen::ticks().wrapping_sub(start) < ticks;
    let start = Chosen::ticks();
    while (cycle::ANSWER.is_full() || !uart::is_sent()) && within(start, Chosen::TICK_HZ) {
        SCB::set_pendsv();
    }
    // The hardware still holds one or two bytes.
    let start = Chosen::ticks();
    while within(start, Chosen::TICK_HZ / 1_000) {}
}

/// The background's access to the cycle and the device.
struct Calls;

impl Device<'static, WORDS> for Calls {
    fn order(&mut self, order: CycleCommand<'static, WORDS>) -> CycleAck<'static, WORDS> {
        cycle::ORDER.put(order);
        loop {
            // PendSV pre-empts this code at once and leaves its report. If a report never comes, the beats end.
            SCB::set_pendsv();
            cortex_m::asm::isb();
            if let Some(report) = cycle::REPORT.take() {
                return report;
            }
        }
    }

    fn nonce(&mut self) -> [u8; NONCE_LENGTH] {
        // The count distinguishes nonces since power-on; the random numbers distinguish them from earlier ones.
        let count = retained(Retained::Nonces).unwrap_or(0).wrapping_add(1);
        retain(Retained::Nonces, count);
        let random = || Chosen::random().unwrap_or(0);
        let words = [count, Chosen::ticks(), random(), random()];
        let mut nonce = [0; NONCE_LENGTH];
        for (bytes, word) in nonce.as_chunks_mut().0.iter_mut().zip(words) {
            *bytes = word.to_le_bytes();
        }
        nonce
    }

    fn complete(&mut self, statistics: &mut Statistics) {
        statistics.lost_bytes = uart::lost();
        statistics.lost_logs = defmt_ring::lost();
        statistics.restarts = retained(Retained::Restarts).unwrap_or(0);
        statistics.stack_bytes = hal_unsafe::stack_bytes();
    }
}
