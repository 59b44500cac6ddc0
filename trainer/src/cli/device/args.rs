//! What can be typed after `trainer device`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use poegp_protocol::link::{Identity, MAX_CHUNK};

use crate::cli::failure::Failure;
use crate::cli::keys::read_secret_key;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, write_summary};
use crate::cli::terminal::print::Printer;
use crate::device::board::Board;
use crate::device::client::{Client, Options};
use crate::device::error::ClientError;
use crate::device::port::Address;

/// `trainer device`.
#[derive(Debug, Args)]
#[command(
    after_help = "Without hardware: `trainer device emulate` starts a firmware image in QEMU and prints its port.\n\n\
    Examples:\n  trainer device emulate --elf firmware.elf --listen unix:link\n  trainer device info --port unix:link\n  \
    trainer device flash arm.blob --port /dev/ttyUSB0"
)]
pub struct Device {
    /// Command.
    #[command(subcommand)]
    pub command: DeviceCommand,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum DeviceCommand {
    /// Show the device, its firmware and its active model.
    Info(Info),
    /// Put a model onto the device: upload, verify, store, run.
    Flash(Flash),
    /// Print the errors of the device's poses against measurements, and compare the poses with the host's bit for bit.
    Evaluate(Evaluate),
    /// Correct the commands of a measurement file on the device; write CSV.
    Correct(Correct),
    /// Switch corrections off (commands come back unchanged) or on again.
    Bypass(Bypass),
    /// Return to the other stored model.
    Rollback(Rollback),
    /// Print the device's counters since its start.
    Statistics(Statistics),
    /// Watch the statistics and the log.
    Monitor(Monitor),
    /// Restart the device with its stored models.
    Restart(Restart),
    /// State that the controller has stopped and sends no more commands.
    Stop(Stop),
    /// Store a public key permanently: the device then accepts only models signed with its secret key.
    Provision(Provision),
    /// Set the period and limits of the controller's cycle.
    Cycle(Cycle),
    /// Run the firmware in QEMU until Ctrl-C, with a port for the other commands.
    Emulate(Emulate),
}

/// How to reach a device.
#[derive(Clone, Debug, Args)]
pub struct Link {
    /// Port of the device: /dev/ttyUSB0[@BAUD], unix:PATH or tcp:HOST:PORT.
    #[arg(long)]
    pub port: Address,
    /// Speed of a serial line (default: 115200).
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub baud: Option<u32>,
    /// Longest wait for one answer in milliseconds; the program sends a request up to three times.
    #[arg(long, value_name = "MS", default_value_t = 2_000, value_parser = clap::value_parser!(u64).range(1..=600_000))]
    pub timeout_ms: u64,
}

impl Link {
    /// Returns the port with the speed of `--baud`.
    pub fn address(&self) -> Address {
        self.port.clone().with_baud(self.baud)
    }

    /// Opens the port and identifies the device.
    pub fn connect(&self) -> Result<(Client, Identity), ClientError> {
        let mut client = Client::open(&self.address(), self.options())?;
        let identity = client.identify()?;
        Ok((client, identity))
    }

    /// Returns the options of the client, with the timeout of `--timeout-ms`.
    pub fn options(&self) -> Options {
        Options {
            timeout: Duration::from_millis(self.timeout_ms),
            ..Options::default()
        }
    }
}

/// What signs requests.
#[derive(Debug, Args)]
pub struct Authority {
    /// Secret key that signs the request, for a device with a public key.
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
}

impl Authority {
    /// Connects as [`Link::connect`] does, and gives the client the key.
    pub fn connect(&self, link: &Link) -> Result<(Client, Identity), Failure> {
        // The key is read first, so that a wrong path is reported without a device.
        let key = self.key.as_deref().map(read_secret_key).transpose()?;
        let (mut client, identity) = link.connect()?;
        if let Some(key) = key {
            client.set_signer(key.signer());
        }
        Ok((client, identity))
    }
}

/// How to reach a device, and where the result goes.
#[derive(Debug, Args)]
pub struct LinkAndJson {
    #[command(flatten)]
    pub link: Link,
    /// Write the result as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl LinkAndJson {
    /// Refuses, before the work, a file that cannot be written or that would overwrite an input.
    pub fn check(&self, inputs: &[&Path]) -> Result<(), Failure> {
        check_outputs(&[(self.json.as_deref(), Kind::Json)], inputs).map(drop)
    }

    /// Writes the results as JSON if a file is given, and returns the printer for the user.
    pub fn report(&self, summary: serde_json::Value) -> Result<Printer, Failure> {
        write_summary(self.json.as_deref(), summary)?;
        Ok(Printer::for_outputs(&[self.json.as_deref()]))
    }
}

/// `trainer device info`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer device info --port /dev/ttyUSB0")]
pub struct Info {
    #[command(flatten)]
    pub common: LinkAndJson,
}

/// `trainer device flash`.
#[derive(Debug, Args)]
#[command(
    after_help = "The device runs its old model until the new one is uploaded, verified and stored.\n\n\
    Example: trainer device flash arm.blob --port /dev/ttyUSB0"
)]
pub struct Flash {
    /// Model (`.blob`).
    pub blob: PathBuf,
    #[command(flatten)]
    pub common: LinkAndJson,
    #[command(flatten)]
    pub authority: Authority,
    /// Upload even if the device runs the model already, has no room for it or would reject its signature.
    #[arg(long)]
    pub force: bool,
    /// The device has moved to another robot: accept that robot's model.
    #[arg(long)]
    pub replace_robot: bool,
    /// Bytes of the model in one message; smaller chunks delay corrections less.
    #[arg(long, value_name = "BYTES", default_value_t = MAX_CHUNK as u16,
          value_parser = clap::value_parser!(u16).range(1..=MAX_CHUNK as i64))]
    pub chunk_size: u16,
}

/// `trainer device evaluate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Without --blob, the command fits the device's base frame to the measurements.\n\n\
    Example: trainer device evaluate test.csv --blob arm.blob --port /dev/ttyUSB0"
)]
pub struct Evaluate {
    /// Measurements that the model was not trained on.
    pub test: PathBuf,
    #[command(flatten)]
    pub common: LinkAndJson,
    /// Model that the device runs, for the instrument's frame and to compare the bits of every answer.
    #[arg(long, value_name = "FILE")]
    pub blob: Option<PathBuf>,
}

/// `trainer device correct`.
#[derive(Debug, Args)]
#[command(
    after_help = "One row per command, in order: the joints in the columns and units of TEST, then position_error_um \
    (the remaining error, according to the model) and status.\n\n\
    Example: trainer device correct test.csv --port /dev/ttyUSB0 --out corrected.csv"
)]
pub struct Correct {
    /// Joint commands (and payloads) in the columns of a measurement file.
    pub test: PathBuf,
    #[command(flatten)]
    pub link: Link,
    /// Model that the device runs, to compare the bits of every answer.
    #[arg(long, value_name = "FILE")]
    pub blob: Option<PathBuf>,
    /// Write the corrected joints (`-`: standard output).
    #[arg(long, value_name = "FILE", default_value = "-")]
    pub out: PathBuf,
    /// Write the summary as JSON (`-`: standard output, with --out elsewhere).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Off or on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// Commands come back unchanged.
    On,
    /// Commands are corrected.
    Off,
}

/// `trainer device bypass`.
#[derive(Debug, Args)]
#[command(
    after_help = "The bypass lasts until it is switched off or the power fails.\n\n\
    Example: trainer device bypass on --port /dev/ttyUSB0"
)]
pub struct Bypass {
    /// Switch the bypass on or off.
    #[arg(value_enum)]
    pub switch: Switch,
    #[command(flatten)]
    pub common: LinkAndJson,
    #[command(flatten)]
    pub authority: Authority,
}

/// `trainer device rollback`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer device rollback --port /dev/ttyUSB0")]
pub struct Rollback {
    #[command(flatten)]
    pub common: LinkAndJson,
    #[command(flatten)]
    pub authority: Authority,
}

/// `trainer device statistics`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer device statistics --port /dev/ttyUSB0 --json -")]
pub struct Statistics {
    #[command(flatten)]
    pub common: LinkAndJson,
}

/// `trainer device monitor`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: trainer device monitor --port /dev/ttyUSB0 --log /dev/ttyUSB1 --elf poegp-firmware"
)]
pub struct Monitor {
    #[command(flatten)]
    pub link: Link,
    /// Print once instead of every second until Ctrl-C.
    #[arg(long)]
    pub once: bool,
    /// Print JSON (`-`), one document per line: statistics or a line of the log. With --once, one document,
    /// also to a file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Port of the defmt log.
    #[arg(long, value_name = "PORT", requires = "elf")]
    pub log: Option<Address>,
    /// Image that runs on the device, with the texts of its log.
    #[arg(long, value_name = "FILE", requires = "log")]
    pub elf: Option<PathBuf>,
}

/// `trainer device restart`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer device restart --port /dev/ttyUSB0")]
pub struct Restart {
    #[command(flatten)]
    pub common: LinkAndJson,
    #[command(flatten)]
    pub authority: Authority,
}

/// `trainer device stop`.
#[derive(Debug, Args)]
#[command(
    after_help = "If you do not stop the cycles, the device restarts a few seconds after the last command.\n\n\
    Example: trainer device stop --port /dev/ttyUSB0"
)]
pub struct Stop {
    #[command(flatten)]
    pub common: LinkAndJson,
    #[command(flatten)]
    pub authority: Authority,
}

/// `trainer device provision`.
#[derive(Debug, Args)]
#[command(
    after_help = "Provisioning cannot be undone: from then on, the device runs only models that `trainer sign` has signed with \
    the matching secret key.\n\n\
    Example: trainer device provision cell7.pub --port /dev/ttyUSB0"
)]
pub struct Provision {
    /// Public key written by `trainer keys new`.
    pub key: PathBuf,
    #[command(flatten)]
    pub common: LinkAndJson,
}

/// `trainer device cycle`.
#[derive(Debug, Args)]
#[command(
    after_help = "Settings that are not given keep their values; without any setting, the command shows the current \
    ones. The device \
    refuses changes while a correction is applied: switch it off first with `trainer device bypass on`.\n\n\
    Example: trainer device cycle --period-us 2000 --port /dev/ttyUSB0"
)]
pub struct Cycle {
    #[command(flatten)]
    pub common: LinkAndJson,
    #[command(flatten)]
    pub authority: Authority,
    /// Time between two commands of the controller, in microseconds (50 to 100000).
    #[arg(long, value_name = "US")]
    pub period_us: Option<u32>,
    /// Largest rate of the correction beyond the motion of the path, in rad/s (0.0001 to 1).
    #[arg(long, value_name = "RAD_PER_S")]
    pub rate: Option<f32>,
    /// Largest acceleration of the correction beyond the motion of the path, in rad/s² (0.001 to 100).
    #[arg(long, value_name = "RAD_PER_S2")]
    pub acceleration: Option<f32>,
    /// Shortest time to switch a correction on or off, in seconds (0.01 to 10).
    #[arg(long, value_name = "S")]
    pub blend: Option<f32>,
    /// Largest number of instructions for one command, frames included. The device rejects models that may take more
    /// (`trainer inspect`).
    #[arg(long, value_name = "N")]
    pub max_instructions: Option<u32>,
}

/// `trainer device emulate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Needs qemu-system-arm. In a clone of the repository this command builds an image:\n  \
    cargo run --release -p poegp-tests --example firmware firmware.elf\n\n\
    Example: trainer device emulate --elf firmware.elf --flash-image flash.bin --listen tcp:127.0.0.1:4000"
)]
pub struct Emulate {
    /// Board to emulate.
    #[arg(long, value_enum, default_value_t = Board::Mps2An386)]
    pub board: Board,
    /// Firmware image for the board.
    #[arg(long, value_name = "FILE")]
    pub elf: PathBuf,
    /// Socket of the link: unix:PATH or tcp:HOST:PORT (port 0: any) (default: a socket in the folder for temporary files).
    #[arg(long, value_name = "PORT")]
    pub listen: Option<Address>,
    /// Socket of the log: unix:PATH or tcp:HOST:PORT (port 0: any) (default: a socket in the folder for temporary files).
    #[arg(long, value_name = "PORT")]
    pub log: Option<Address>,
    /// Keep the flash in this file; created if it does not exist (default: models are lost at the end).
    #[arg(long, value_name = "FILE")]
    pub flash_image: Option<PathBuf>,
    /// Count 64 ns for each instruction instead of real time, so that tick counts repeat exactly.
    #[arg(long)]
    pub deterministic_clock: bool,
    /// Write the ports as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}
