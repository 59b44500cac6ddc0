//! Emulates a board: QEMU, with the firmware on it.
//!
//! The command link is a socket that QEMU inherits as its standard input, so it exists at every moment. [`Emulator`] is for
//! one program that owns the machine: when QEMU ends, the link ends, and a hard time limit ends QEMU. [`serve`] turns this
//! program into a machine for others, which connect to a listening socket.
//!
//! With a flash image, the board's flash survives whatever happens to QEMU, so that a power cut can be repeated.

use std::fs;
use std::io;
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::device::board::Board;
use crate::device::port::Address;

const PROGRAM: &str = "qemu-system-arm";
const LOG: &str = "defmt.bin";
const COMPLAINTS: &str = "stderr.txt";
/// Name of the file with erased flash, which replaces the zeros that QEMU has there.
const ERASED: &str = "poegp-erased-flash.bin";

/// Clock of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Real time.
    Real,
    /// 64 ns for each instruction, whatever the load of the host: tick counts repeat exactly.
    Counting,
}

/// Nanoseconds of one instruction under [`Clock::Counting`]: `-icount shift=6`.
const NANOSECONDS_PER_INSTRUCTION: f64 = 64.0;

/// Returns the number of instructions in `ticks` of a counter with `tick_hz` under [`Clock::Counting`].
pub fn instructions(ticks: u32, tick_hz: u32) -> f64 {
    f64::from(ticks) * (1e9 / f64::from(tick_hz)) / NANOSECONDS_PER_INSTRUCTION
}

/// Reason why the machine did not start.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// QEMU is not installed.
    #[error(
        "{PROGRAM} is not installed\nhelp: apt-get install qemu-system-arm (Debian, Ubuntu), or brew install qemu (macOS)"
    )]
    Missing,
    /// QEMU cannot keep the flash of this board.
    #[error("QEMU cannot keep the flash of the board {0} in a file\nhelp: take --board mps2-an386")]
    NoMemory(&'static str),
    /// The operating system reports an error.
    #[error("{PROGRAM} does not start: {0}")]
    System(#[from] io::Error),
}

fn not_started(error: io::Error) -> EmulatorError {
    match error.kind() {
        io::ErrorKind::NotFound => EmulatorError::Missing,
        _ => EmulatorError::System(error),
    }
}

/// A board with its firmware, clock and flash.
#[derive(Clone, Copy, Debug)]
pub struct Machine<'a> {
    /// Board to emulate.
    pub board: Board,
    /// ELF file of the firmware.
    pub elf: &'a Path,
    /// Clock of the machine.
    pub clock: Clock,
    /// File that keeps the flash; created when it does not exist.
    pub flash_image: Option<&'a Path>,
}

impl Machine<'_> {
    /// Returns the command that starts QEMU, with standard input for the link and without the second serial line. Writes the
    /// files that QEMU reads at its start to `folder`.
    fn command(&self, link: &str, folder: &Path) -> Result<Command, EmulatorError> {
        let mut machine = self.board.machine().to_owned();
        let mut command = Command::new(PROGRAM);
        if let Some(path) = self.flash_image {
            let size = self.board.memory_mib();
            let size = size.ok_or(EmulatorError::NoMemory(self.board.name()))?;
            machine += ",memory-backend=ps";
            command.arg("-object").arg(format!(
                "memory-backend-file,id=ps,size={size}M,share=on,mem-path={}",
                escaped(path)
            ));
        }
        command
            .args(["-M", &machine, "-cpu", self.board.cpu(), "-kernel"])
            .arg(self.elf)
            .args(["-display", "none", "-monitor", "none"])
            .args(["-chardev", link, "-serial", "chardev:link"]);
        if let Some((address, bytes)) = self.board.erased_flash() {
            let path = folder.join(ERASED);
            let erased = vec![0xff; bytes];
            if fs::read(&path).ok().as_ref() != Some(&erased) {
                fs::write(&path, erased)?;
            }
            command.arg("-device").arg(format!(
                "loader,file={},addr={address:#x},force-raw=on",
                escaped(&path)
            ));
        }
        if self.clock == Clock::Counting {
            command.args(["-icount", "shift=6"]);
        }
        Ok(command)
    }
}

/// Escapes a path for an option of QEMU, where a comma ends a value and two commas stand for one.
fn escaped(path: &Path) -> String {
    path.display().to_string().replace(',', ",,")
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
    ///
    /// # Errors
    /// [`EmulatorError`].
    pub fn start(
        machine: &Machine<'_>,
        time_limit: Duration,
    ) -> Result<(Self, UnixStream), EmulatorError> {
        Self::start_with(machine, time_limit, &[])
    }

    /// Starts a machine as [`Emulator::start`] does, with further arguments for QEMU that watch the machine but do not
    /// change it.
    ///
    /// # Errors
    /// [`EmulatorError`].
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
            .map_err(not_started)?;
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

/// A socket to which other programs connect.
#[derive(Debug)]
pub struct Listener {
    socket: OwnedFd,
    address: Address,
}

impl Listener {
    /// Listens at a socket address; port 0 of TCP stands for any free port. Replaces the socket file of a program that has
    /// ended.
    ///
    /// # Errors
    /// What the system says; `Unsupported` for a serial line.
    pub fn at(address: &Address) -> io::Result<Self> {
        let (socket, address) = match address {
            Address::Serial { .. } => return Err(io::ErrorKind::Unsupported.into()),
            Address::Unix(path) => {
                if UnixStream::connect(path)
                    .is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused)
                {
                    fs::remove_file(path)?;
                }
                // Bind to the path as given: the path of a socket may not be longer than a hundred letters.
                let socket = UnixListener::bind(path)?;
                (socket.into(), Address::Unix(std::path::absolute(path)?))
            }
            Address::Tcp(location) => {
                let listener = TcpListener::bind(location)?;
                let address = Address::Tcp(listener.local_addr()?.to_string());
                (listener.into(), address)
            }
        };
        Ok(Self { socket, address })
    }

    /// Returns the address to connect to.
    pub fn address(&self) -> &Address {
        &self.address
    }
}

/// Turns this process into the machine, with the link at one socket and the log at another: the process is QEMU from here
/// on, so whatever ends it ends the machine. It serves one client at a time, and the next one when that has gone. Both
/// sockets exist before the call, so clients that connect early wait.
///
/// Returns only when QEMU does not start.
pub fn serve(machine: &Machine<'_>, link: Listener, log: Listener) -> EmulatorError {
    // Always the same bytes, so that one file serves all machines and nobody has to remove it.
    let folder = std::env::temp_dir();
    let mut command = match machine.command("socket,id=link,fd=0,server=on,wait=off", &folder) {
        Ok(command) => command,
        Err(error) => return error,
    };
    let error = command
        .args([
            "-chardev",
            "socket,id=log,fd=1,server=on,wait=off",
            "-serial",
            "chardev:log",
        ])
        .stdin(link.socket)
        .stdout(log.socket)
        .exec();
    not_started(error)
}
