//! A device to test: an emulated board and the trainer's client of its link.

use std::os::unix::net::UnixStream;
use std::time::Duration;

use crate::firmware_build::{Board, FirmwareError, firmware_of};
use poegp_protocol::link::{
    Commanded, Corrected, CycleSettings, Evaluation, Identity, Query, Refusal, Request, Response,
    Statistics, Trace,
};
use poegp_runtime::model::Model400;
use poegp_trainer::device::client::{Client, Options};
use poegp_trainer::device::emulator::{Clock, Emulator, EmulatorError, Machine};
use poegp_trainer::device::error::ClientError;

/// No machine of a test runs longer.
const TIME_LIMIT: Duration = Duration::from_secs(300);

/// An answer takes milliseconds; a loaded machine may take long to get to it. There, a watchdog in real time may restart
/// the device during an upload; where time counts instructions, it may not.
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

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// There is no image.
    #[error(transparent)]
    Firmware(#[from] FirmwareError),
    /// There is no machine.
    #[error(transparent)]
    Emulator(#[from] EmulatorError),
    /// The device will not.
    #[error("the device refused: {0:?}")]
    Refused(Refusal),
    /// Anything else; the link ends when the machine stops, or when its time is up.
    #[error("{error}; {complaints}")]
    Link {
        /// What went wrong.
        error: ClientError,
        /// What QEMU says.
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
    /// Builds the firmware if need be and switches a device on.
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

    /// Switches on a machine of one's own making.
    ///
    /// # Errors
    /// [`DeviceError::Emulator`].
    pub fn on(machine: &Machine<'_>) -> Result<Self, DeviceError> {
        Self::watched(machine, &[])
    }

    /// A machine with a time limit of its own.
    ///
    /// # Errors
    /// [`DeviceError::Emulator`].
    pub fn on_for(machine: &Machine<'_>, time_limit: Duration) -> Result<Self, DeviceError> {
        Self::over(Emulator::start(machine, time_limit)?, machine.clock)
    }

    /// A machine with further arguments for QEMU.
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

    /// The machine and the client apart, for a test that switches one off under the other.
    pub fn into_parts(self) -> (Emulator, Client) {
        (self.emulator, self.client)
    }

    /// The machine.
    pub fn emulator(&self) -> &Emulator {
        &self.emulator
    }

    /// The client.
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

    /// Sends bytes as they are.
    ///
    /// # Errors
    /// [`DeviceError::Link`].
    pub fn send_bytes(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let sent = self.client.send_bytes(bytes);
        sent.map_err(|error| self.failed(error))
    }

    /// The next intact answer and its sequence number, or `None` when none comes in time.
    ///
    /// # Errors
    /// [`DeviceError::Link`].
    pub fn receive(&mut self) -> Result<Option<(u16, Response)>, DeviceError> {
        let received = self.client.receive();
        received.map_err(|error| self.failed(error))
    }

    /// The frame of a request, its final zero included, under the next sequence number.
    pub fn frame(&mut self, request: &Request<'_>) -> (u16, Vec<u8>) {
        self.client.frame(request)
    }

    /// Asks, and asks again when the answer does not come.
    ///
    /// # Errors
    /// [`DeviceError`]; a refusal is an answer.
    pub fn request(&mut self, request: &Request<'_>) -> Result<Response, DeviceError> {
        let answered = self.client.request(request);
        answered.map_err(|error| self.failed(error))
    }

    /// Who the device is.
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
    /// [`DeviceError`]; after [`DeviceError::Refused`] the active model is what it was.
    pub fn load(&mut self, blob: &[u8]) -> Result<Identity, DeviceError> {
        let loaded = self
            .allow(blob)
            .and_then(|()| self.client.install(blob, &mut |_| ()));
        loaded
            .map(|(_, identity)| identity)
            .map_err(|error| self.failed(error))
    }

    /// Allows any model, whatever time it takes.
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

    /// The same for a model that takes longer than is allowed: most tests ask for bits.
    fn allow(&mut self, blob: &[u8]) -> Result<(), ClientError> {
        let mut model = Box::new(Model400::new());
        let size = model.load(blob).ok().and_then(|()| model.size());
        let instructions = size.map_or(0, |size| size.command_bound());
        if instructions <= self.client.identify()?.cycle.max_instructions {
            return Ok(());
        }
        self.allow_any_time()
    }

    /// T_gp(q, m)·f(q).
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn evaluate(&mut self, query: &Query) -> Result<Evaluation, DeviceError> {
        let evaluation = self.client.evaluate(query);
        evaluation.map_err(|error| self.failed(error))
    }

    /// The corrected command.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn correct(&mut self, query: &Query) -> Result<Corrected, DeviceError> {
        let corrected = self.client.correct(query);
        corrected.map_err(|error| self.failed(error))
    }

    /// The command of a cycle, corrected without a step.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn command(&mut self, query: &Query) -> Result<Commanded, DeviceError> {
        let commanded = self.client.command(query);
        commanded.map_err(|error| self.failed(error))
    }

    /// [`Device::evaluate`] with intermediate results.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn trace(&mut self, query: &Query) -> Result<Trace, DeviceError> {
        let trace = self.client.trace(query);
        trace.map_err(|error| self.failed(error))
    }

    /// What the device has counted.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn statistics(&mut self) -> Result<Statistics, DeviceError> {
        let statistics = self.client.statistics();
        statistics.map_err(|error| self.failed(error))
    }
}
