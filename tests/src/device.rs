//! A device under test: an emulated board and the trainer's client of its link.

use std::os::unix::net::UnixStream;
use std::time::Duration;

use crate::emulator::{Clock, Emulator, EmulatorError, Machine};
use crate::firmware_build::{Board, FirmwareError, firmware_of};
use poegp_protocol::link::{
    Commanded, Corrected, CycleSettings, Evaluation, Identity, Query, Refusal, Request, Response,
    Statistics, Trace,
};
use poegp_runtime::model::Model400;
use poegp_trainer::device::client::{Client, Options};
use poegp_trainer::device::error::ClientError;

/// Time limit of an emulated machine.
const TIME_LIMIT: Duration = Duration::from_secs(300);

/// Returns the options of the client. An answer takes milliseconds, but a loaded workstation may answer late. With a clock
/// in real time the watchdog may then restart the device during an upload, so uploads are repeated; with a clock that counts
/// instructions that cannot happen.
fn options(clock: Clock) -> Options {
    Options {
        timeout: Duration::from_secs(10),
        attempts: 3,
        busy_limit: Duration::from_secs(60),
        chunk_size: poegp_protocol::link::MAX_CHUNK,
        uploads: match clock {
            Clock::Real => 3,
            Clock::Counting => 1,
        },
        replaces_robot: true,
    }
}

/// Why a device gave no answer.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The image could not be built.
    #[error(transparent)]
    Firmware(#[from] FirmwareError),
    /// The emulated machine could not be started.
    #[error(transparent)]
    Emulator(#[from] EmulatorError),
    /// The device refused the request.
    #[error("the device refused: {0:?}")]
    Refused(Refusal),
    /// The link failed; it ends when the machine stops or its time is up.
    #[error("{error}; {complaints}")]
    Link {
        /// The error of the client.
        error: ClientError,
        /// Messages of QEMU.
        complaints: String,
    },
}

/// A device and the link to it.
#[derive(Debug)]
pub struct Device {
    emulator: Emulator,
    client: Client,
}

impl Device {
    /// Builds the firmware if necessary and switches a device on.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn start(clock: Clock) -> Result<Self, DeviceError> {
        let board = Board::default();
        Self::on(&Machine {
            board,
            elf: &firmware_of(board)?.elf,
            clock,
            flash_image: None,
        })
    }

    /// Switches on a device on the given machine.
    ///
    /// # Errors
    /// [`DeviceError::Emulator`].
    pub fn on(machine: &Machine<'_>) -> Result<Self, DeviceError> {
        Self::watched(machine, &[])
    }

    /// Switches on a device on the given machine, with its own time limit.
    ///
    /// # Errors
    /// [`DeviceError::Emulator`].
    pub fn on_for(machine: &Machine<'_>, time_limit: Duration) -> Result<Self, DeviceError> {
        Self::over(Emulator::start(machine, time_limit)?, machine.clock)
    }

    /// Switches on a device on the given machine, with further arguments for QEMU.
    ///
    /// # Errors
    /// [`DeviceError::Emulator`].
    pub fn watched(machine: &Machine<'_>, arguments: &[String]) -> Result<Self, DeviceError> {
        Self::over(
            Emulator::start_with(machine, TIME_LIMIT, arguments)?,
            machine.clock,
        )
    }

    fn over((emulator, link): (Emulator, UnixStream), clock: Clock) -> Result<Self, DeviceError> {
        let client = Client::over(Box::new(link), "the emulator".to_owned(), options(clock));
        Ok(Self { emulator, client })
    }

    /// Separates the machine and the client, for a test that switches the machine off while the client is in use.
    pub fn into_parts(self) -> (Emulator, Client) {
        (self.emulator, self.client)
    }

    /// Returns the emulated machine.
    pub fn emulator(&self) -> &Emulator {
        &self.emulator
    }

    /// Returns the client.
    pub fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    fn failed(&self, error: ClientError) -> DeviceError {
        match error {
            ClientError::Refused(refusal) => DeviceError::Refused(refusal),
            error => DeviceError::Link {
                error,
                complaints: self.emulator.complaints(),
            },
        }
    }

    /// Sends raw bytes.
    ///
    /// # Errors
    /// [`DeviceError::Link`].
    pub fn send_bytes(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let sent = self.client.send_bytes(bytes);
        sent.map_err(|error| self.failed(error))
    }

    /// Returns the next intact answer and its sequence number, or `None` if none arrives in time.
    ///
    /// # Errors
    /// [`DeviceError::Link`].
    pub fn receive(&mut self) -> Result<Option<(u16, Response)>, DeviceError> {
        let received = self.client.receive();
        received.map_err(|error| self.failed(error))
    }

    /// Returns the frame of a request with the next sequence number, including its final zero.
    pub fn frame(&mut self, request: &Request<'_>) -> (u16, Vec<u8>) {
        self.client.frame(request)
    }

    /// Sends a request, and repeats it if no answer arrives.
    ///
    /// # Errors
    /// [`DeviceError`]; a refusal is an answer.
    pub fn request(&mut self, request: &Request<'_>) -> Result<Response, DeviceError> {
        let answered = self.client.request(request);
        answered.map_err(|error| self.failed(error))
    }

    /// Asks the device for its identity.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn identify(&mut self) -> Result<Identity, DeviceError> {
        let identity = self.client.identify();
        identity.map_err(|error| self.failed(error))
    }

    /// Sends a blob in pieces, has it verified and written, and makes it the active model.
    ///
    /// # Errors
    /// [`DeviceError`]; after [`DeviceError::Refused`] the active model is unchanged.
    pub fn load(&mut self, blob: &[u8]) -> Result<Identity, DeviceError> {
        let loaded = self
            .allow(blob)
            .and_then(|()| self.client.install(blob, &mut |_| ()));
        loaded
            .map(|(_, identity)| identity)
            .map_err(|error| self.failed(error))
    }

    /// Provisions cycle settings that allow any model, however long it takes.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn allow_any_time(&mut self) -> Result<(), ClientError> {
        let settings = CycleSettings {
            max_instructions: u32::MAX,
            ..self.client.identify()?.cycle
        };
        self.client.stand_down()?;
        self.client.provision_cycle(&settings).map(|_| ())
    }

    /// Allows any time if the model in `blob` takes longer than the device allows; most tests compare bits, not time.
    fn allow(&mut self, blob: &[u8]) -> Result<(), ClientError> {
        let mut model = Box::new(Model400::new());
        let size = model.load(blob).ok().and_then(|()| model.size());
        let instructions = size.map_or(0, |size| size.command_bound());
        if instructions <= self.client.identify()?.cycle.max_instructions {
            return Ok(());
        }
        self.allow_any_time()
    }

    /// Asks the device for the corrected pose T_gp(q, m)·f(q).
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn evaluate(&mut self, query: &Query) -> Result<Evaluation, DeviceError> {
        let evaluation = self.client.evaluate(query);
        evaluation.map_err(|error| self.failed(error))
    }

    /// Asks the device for the corrected command.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn correct(&mut self, query: &Query) -> Result<Corrected, DeviceError> {
        let corrected = self.client.correct(query);
        corrected.map_err(|error| self.failed(error))
    }

    /// Sends the command of a cycle; the device corrects it without a step.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn command(&mut self, query: &Query) -> Result<Commanded, DeviceError> {
        let commanded = self.client.command(query);
        commanded.map_err(|error| self.failed(error))
    }

    /// Evaluates as [`Device::evaluate`] does, and returns the intermediate results, too.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn trace(&mut self, query: &Query) -> Result<Trace, DeviceError> {
        let trace = self.client.trace(query);
        trace.map_err(|error| self.failed(error))
    }

    /// Asks the device for its statistics.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn statistics(&mut self) -> Result<Statistics, DeviceError> {
        let statistics = self.client.statistics();
        statistics.map_err(|error| self.failed(error))
    }
}
