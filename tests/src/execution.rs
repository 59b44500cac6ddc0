//! Every instruction that a device executes between two moments, as QEMU tells it.
//!
//! The image that is measured is the one that ships: nothing in it knows that it is watched. QEMU translates one
//! instruction at a time, which costs it speed and the machine nothing, and writes down where it is while a recording
//! lasts (`log exec,nochain` in its monitor).

use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use crate::firmware_build::{Board, firmware_of};
use poegp_trainer::device::emulator::{Clock, Machine};

use crate::device::{Device, DeviceError};

/// QEMU opens its monitor at once; a loaded machine may take long to get to it.
const PATIENCE: Duration = Duration::from_secs(60);
const PROMPT: &[u8] = b"(qemu) ";

/// The monitor of a machine.
#[derive(Debug)]
pub struct Recorder {
    monitor: UnixStream,
    folder: tempfile::TempDir,
}

/// Why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// There is no device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The monitor or the log.
    #[error("QEMU's monitor or log: {0}")]
    System(#[from] io::Error),
    /// A line of the log.
    #[error("QEMU's log has another format: {0:?}")]
    Format(String),
}

/// QEMU's way to say "one instruction at a time", which changed in version 8.1.
fn one_at_a_time() -> io::Result<&'static [&'static str]> {
    let help = Command::new("qemu-system-arm").arg("--help").output()?;
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    Ok(if help.contains("one-insn-per-tb") {
        &["-accel", "tcg,one-insn-per-tb=on"]
    } else {
        &["-singlestep"]
    })
}

impl Recorder {
    /// A device of the usual board that is watched, with time that counts instructions.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn start() -> Result<(Device, Self), RecordError> {
        let folder = tempfile::Builder::new().prefix("poegp-record-").tempdir()?;
        let socket = folder.path().join("monitor");
        let chardev = format!(
            "socket,id=monitor,path={},server=on,wait=off",
            socket.display()
        );
        let watching = ["-chardev", &chardev, "-mon", "monitor"];
        let arguments: Vec<String> = one_at_a_time()?
            .iter()
            .chain(&watching)
            .map(|word| (*word).to_owned())
            .collect();
        let board = Board::default();
        let elf = &firmware_of(board).map_err(DeviceError::from)?.elf;
        let machine = Machine {
            board,
            elf,
            clock: Clock::Counting,
            flash_image: None,
        };
        let device = Device::watched(&machine, &arguments)?;
        let until = Instant::now() + PATIENCE;
        let monitor = loop {
            match UnixStream::connect(&socket) {
                Ok(monitor) => break monitor,
                Err(error) if Instant::now() > until => return Err(error.into()),
                Err(_) => thread::sleep(Duration::from_millis(10)),
            }
        };
        monitor.set_read_timeout(Some(PATIENCE))?;
        let mut recorder = Self { monitor, folder };
        recorder.wait()?;
        Ok((device, recorder))
    }

    fn wait(&mut self) -> io::Result<()> {
        let mut heard = Vec::new();
        while !heard.ends_with(PROMPT) {
            let mut byte = [0];
            self.monitor.read_exact(&mut byte)?;
            heard.push(byte[0]);
        }
        Ok(())
    }

    fn say(&mut self, command: &str) -> io::Result<()> {
        self.monitor.write_all(format!("{command}\n").as_bytes())?;
        self.wait()
    }

    /// Addresses of all instructions that are executed while `work` is done, in their order.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn record(&mut self, work: impl FnOnce()) -> Result<Vec<u32>, RecordError> {
        let path: PathBuf = self.folder.path().join("execution");
        self.say(&format!("logfile {}", path.display()))?;
        self.say("log exec,nochain")?;
        work();
        self.say("log none")?;
        let log = fs::read_to_string(&path)?;
        fs::remove_file(&path)?;
        let mut addresses = Vec::new();
        for line in log.lines() {
            let bad = || RecordError::Format(line.to_owned());
            let address = || {
                let inside = line.split('[').nth(1)?;
                let inside = inside.split(']').next()?;
                let field = inside.split('/').nth(1).unwrap_or(inside);
                u32::from_str_radix(field.trim_start_matches("0x"), 16).ok()
            };
            if line.starts_with("Trace ") {
                addresses.push(address().ok_or_else(bad)?);
            } else if line.starts_with("Stopped execution of TB chain before ") {
                // It was announced and not executed; it comes again.
                if addresses.last() == Some(&address().ok_or_else(bad)?) {
                    addresses.pop();
                }
            }
        }
        Ok(addresses)
    }
}
