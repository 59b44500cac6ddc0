//! The machine the firmware runs on: QEMU's `mps2-an386`, a Cortex-M4F, with a hard time limit.
//!
//! The command link is a socket that QEMU inherits as its standard input, so there is no path and no moment when it is
//! not there; when QEMU ends, the link ends. The second serial line, defmt, goes to a file.

use std::fs;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

const PROGRAM: &str = "qemu-system-arm";
const LOG: &str = "defmt.bin";
const COMPLAINTS: &str = "stderr.txt";

/// How time passes in the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// As on the wall.
    Real,
    /// 64 ns for each instruction, whatever the load of the host: tick counts repeat exactly.
    Counting,
}

/// Nanoseconds of one instruction under [`Clock::Counting`]: `-icount shift=6`.
const NANOSECONDS_PER_INSTRUCTION: f64 = 64.0;

/// Instructions in so many ticks of a counter with `tick_hz` under [`Clock::Counting`].
pub fn instructions(ticks: u32, tick_hz: u32) -> f64 {
    f64::from(ticks) * (1e9 / f64::from(tick_hz)) / NANOSECONDS_PER_INSTRUCTION
}

/// Why the machine did not start.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// QEMU is not installed.
    #[error("{PROGRAM} is not installed: apt-get install qemu-system-arm (Debian)")]
    Missing,
    /// The system refused.
    #[error("{PROGRAM} does not start: {0}")]
    System(#[from] io::Error),
}

/// A running machine. Dropping it switches it off.
#[derive(Debug)]
pub struct Emulator {
    child: Arc<Mutex<Child>>,
    watchdog: Option<(Sender<()>, JoinHandle<()>)>,
    directory: tempfile::TempDir,
}

impl Emulator {
    /// Switches on a machine with the image `elf`, and off after `time_limit` at the latest. Returns the command link.
    ///
    /// # Errors
    /// [`EmulatorError`].
    pub fn start(
        elf: &Path,
        clock: Clock,
        time_limit: Duration,
    ) -> Result<(Self, UnixStream), EmulatorError> {
        let directory = tempfile::Builder::new().prefix("poegp-").tempdir()?;
        let (link, inherited) = UnixStream::pair()?;
        let mut command = Command::new(PROGRAM);
        command
            .args(["-M", "mps2-an386", "-cpu", "cortex-m4", "-kernel"])
            .arg(elf)
            .args(["-display", "none", "-monitor", "none"])
            .args(["-chardev", "socket,id=link,fd=0", "-serial", "chardev:link"])
            .arg("-serial")
            .arg(format!("file:{}", directory.path().join(LOG).display()));
        if clock == Clock::Counting {
            command.args(["-icount", "shift=6"]);
        }
        let child = command
            .stdin(OwnedFd::from(inherited))
            .stdout(Stdio::null())
            .stderr(fs::File::create(directory.path().join(COMPLAINTS))?)
            .spawn()
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => EmulatorError::Missing,
                _ => EmulatorError::System(error),
            })?;
        let child = Arc::new(Mutex::new(child));
        let (alive, dropped) = mpsc::channel();
        let watched = Arc::clone(&child);
        let watchdog = thread::spawn(move || {
            if dropped.recv_timeout(time_limit) == Err(RecvTimeoutError::Timeout) {
                // The reader of the link sees its end.
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

    /// What the firmware has logged so far, in defmt's encoding.
    pub fn log(&self) -> Vec<u8> {
        fs::read(self.directory.path().join(LOG)).unwrap_or_default()
    }

    /// What QEMU has complained about.
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
