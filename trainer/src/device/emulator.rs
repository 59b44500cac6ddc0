//! Emulates a board: QEMU, with the firmware on it.
//!
//! The command link is a socket that QEMU inherits as its standard input, so it exists at every moment. [`serve`] turns this
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
use std::process::Command;

use crate::device::board::Board;
use crate::device::port::Address;

const PROGRAM: &str = "qemu-system-arm";
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

/// Reason why the machine did not start.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// QEMU is not installed.
    #[error(
        "{PROGRAM} is not installed\nhelp: apt-get install qemu-system-arm (Debian, Ubuntu), or brew install qemu (macOS)"
    )]
    Missing,
    /// QEMU cannot keep the flash of this board.
    #[error("QEMU cannot keep the flash of the board {0} in a file\nhelp: use --board mps2-an386")]
    NoMemory(&'static str),
    /// The operating system reports an error.
    #[error("{PROGRAM} does not start: {0}")]
    System(#[from] io::Error),
}

impl EmulatorError {
    /// Why QEMU did not start.
    pub fn of_start(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::NotFound => Self::Missing,
            _ => Self::System(error),
        }
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
    pub fn command(&self, link: &str, folder: &Path) -> Result<Command, EmulatorError> {
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
pub fn escaped(path: &Path) -> String {
    path.display().to_string().replace(',', ",,")
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
    EmulatorError::of_start(error)
}
