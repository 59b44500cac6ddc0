//! Records every instruction that a device executes between two moments, with QEMU.
//!
//! The measured image is the one that ships; it contains no instrumentation. QEMU translates one instruction at a time,
//! which slows QEMU but does not change the emulated machine, and logs every address during a recording (`log exec,nochain`
//! in its monitor).

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

/// Time limit for QEMU's monitor, which opens at once unless the workstation is loaded.
const PATIENCE: Duration = Duration::from_secs(60);
const PROMPT: &[u8] = b"(qemu) ";

/// A recorder that controls the monitor of an emulated machine.
#[derive(Debug)]
pub struct Recorder {
    monitor: UnixStream,
    folder: tempfile::TempDir,
}

/// Why a recording failed.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The device could not be started.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The monitor or the log could not be used.
    #[error("QEMU's monitor or log: {0}")]
    System(#[from] io::Error),
    /// A line of the log has an unknown format.
    #[error("QEMU's log has another format: {0:?}")]
    Format(String),
}

/// Returns QEMU's option for "one instruction at a time", which changed in version 8.1.
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
    /// Starts a device of the default board, with a recorder and a clock that counts instructions.
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

    /// Runs `work` and returns the addresses of all instructions that are executed meanwhile, in order.
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
                // The instruction was announced but not executed; it is announced again later.
                if addresses.last() == Some(&address().ok_or_else(bad)?) {
                    addresses.pop();
                }
            }
        }
        Ok(addresses)
    }
}
