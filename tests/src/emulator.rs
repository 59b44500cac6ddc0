//! An emulated machine that one test owns: when QEMU ends, the link ends, and a hard time limit ends QEMU.

use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use poegp_trainer::device::emulator::escaped;
pub use poegp_trainer::device::emulator::{Clock, EmulatorError, Machine};

const LOG: &str = "defmt.bin";
const COMPLAINTS: &str = "stderr.txt";
/// Nanoseconds of one instruction under [`Clock::Counting`]: `-icount shift=6`.
const NANOSECONDS_PER_INSTRUCTION: f64 = 64.0;

/// Returns the number of instructions in `ticks` of a counter with `tick_hz` under [`Clock::Counting`].
pub fn instructions(ticks: u32, tick_hz: u32) -> f64 {
    f64::from(ticks) * (1e9 / f64::from(tick_hz)) / NANOSECONDS_PER_INSTRUCTION
}

/// A running machine. Dropping it switches it off, like a power cut.
#[derive(Debug)]
pub struct Emulator {
    child: Arc<Mutex<Child>>,
    watchdog: Option<(Sender<()>, JoinHandle<()>)>,
    directory: tempfile::TempDir,
}

impl Emulator {
    /// Switches on a machine, and switches it off after `time_limit` at the latest. Returns it with the command link.
    pub fn start(
        machine: &Machine<'_>,
        time_limit: Duration,
    ) -> Result<(Self, UnixStream), EmulatorError> {
        Self::start_with(machine, time_limit, &[])
    }

    /// Starts a machine as [`Emulator::start`] does, with further arguments for QEMU that watch the machine but do not
    /// change it.
    pub fn start_with(
        machine: &Machine<'_>,
        time_limit: Duration,
        arguments: &[String],
    ) -> Result<(Self, UnixStream), EmulatorError> {
        let directory = tempfile::Builder::new().prefix("poegp-").tempdir()?;
        let (link, inherited) = UnixStream::pair()?;
        let child = machine
            .command("socket,id=link,fd=0", directory.path())?
            .arg("-serial")
            .arg(format!("file:{}", escaped(&directory.path().join(LOG))))
            .args(arguments)
            .stdin(OwnedFd::from(inherited))
            .stdout(Stdio::null())
            .stderr(fs::File::create(directory.path().join(COMPLAINTS))?)
            .spawn()
            .map_err(EmulatorError::of_start)?;
        let child = Arc::new(Mutex::new(child));
        let (alive, dropped) = mpsc::channel();
        let watched = Arc::clone(&child);
        let watchdog = thread::spawn(move || {
            if dropped.recv_timeout(time_limit) == Err(RecvTimeoutError::Timeout) {
                // The reader of the link then sees the end of the stream.
                let _ = lock(&watched).kill();
            }
        });
        let emulator = Self {
            child,
            watchdog: Some((alive, watchdog)),
            directory,
        };
        Ok((emulator, link))
    }

    /// Returns what the firmware has logged so far, in defmt's encoding.
    pub fn log(&self) -> Vec<u8> {
        fs::read(self.directory.path().join(LOG)).unwrap_or_default()
    }

    /// Returns the messages that QEMU has printed.
    pub fn complaints(&self) -> String {
        fs::read_to_string(self.directory.path().join(COMPLAINTS)).unwrap_or_default()
    }
}

fn lock(child: &Mutex<Child>) -> MutexGuard<'_, Child> {
    child.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let mut child = lock(&self.child);
        let _ = child.kill();
        let _ = child.wait();
        drop(child);
        if let Some((alive, watchdog)) = self.watchdog.take() {
            drop(alive);
            let _ = watchdog.join();
        }
    }
}
