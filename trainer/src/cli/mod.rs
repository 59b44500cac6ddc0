//! The command line: what was typed (`arguments`) becomes what is done (one file for each command).
//!
//! Exit codes: 0 done, 1 a quality bound was not met or a signature does not fit, 2 usage or input error, 130 stopped by
//! Ctrl-C. Errors are printed once, here.

mod arguments;
mod calibrate;
mod cell;
mod check;
mod check_page;
mod check_words;
mod compare;
mod completions;
mod correct;
mod demo;
mod device;
mod drift;
mod elastic_facts;
mod evaluate;
mod export;
mod import;
mod inspect;
mod interrupt;
mod page;
mod plan;
mod pointer;
mod progress;
mod report;
mod signing;
mod simulate;
mod table;

pub use completions::command_reference;

use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::model::load_error::LoadError;

use crate::cli::arguments::{Arguments, Command};
use crate::cli::report::is_stdout;
use crate::device::error::ClientError;
use poegp_calibration::blob::predict::{BlobError, HOST_SUPPORT};
use poegp_calibration::blob::write::{DeviceError, ExportError, Provenance};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::robot::Robot;

/// Everything that ends a command early.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// The user's data or arguments.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The command line itself.
    #[error("{0}")]
    Usage(String),
    /// A device, or the link to it.
    #[error(transparent)]
    Device(#[from] ClientError),
    /// A quality bound was not met; nothing was written.
    #[error("{0}")]
    Quality(String),
    /// A signature does not fit.
    #[error("{0}")]
    Refused(String),
}

impl Failure {
    fn exit_code(&self) -> ExitCode {
        match self {
            Self::Quality(_) | Self::Refused(_) => ExitCode::from(1),
            _ => ExitCode::from(2),
        }
    }
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::SinglePrecisionLossTooLarge(_) => {
                Self::Quality(format!("{error}\nhelp: nothing was written"))
            }
            ExportError::Unusable(BlobError::Load(LoadError::Bound)) => Self::Usage(format!(
                "{error}\nhelp: the poses are a metre or half a radian from what the robot should do: is it this robot, with \
                 these joints (as the controller counts them, or serial), and this order of columns?"
            )),
            _ => Self::Usage(error.to_string()),
        }
    }
}

/// Runs the program and returns its exit code.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    interrupt::install();
    let expanded = match cell::expanded(arguments.into_iter().collect()) {
        Ok(expanded) => expanded,
        Err(failure) => return failed(&failure),
    };
    let mut arguments = match typed(&expanded.words) {
        Ok(arguments) => arguments,
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    if arguments.quiet {
        report::be_quiet();
    }
    expanded.notes.iter().for_each(report::remark);
    if let Command::Calibrate(a) = &mut arguments.command {
        expanded.complete(a);
    }
    let result = match arguments.command {
        Command::Plan(a) => plan::run(&a),
        Command::Simulate(a) => simulate::run(&a),
        Command::Calibrate(a) => calibrate::run(&a),
        Command::Evaluate(a) => evaluate::run(&a),
        Command::Compare(a) => compare::run(&a),
        Command::Correct(a) => correct::run(&a),
        Command::Check(a) => check::run(&a),
        Command::Inspect(a) => inspect::run(&a),
        Command::Export(a) => export::run(&a),
        Command::Import(a) => import::run(&a),
        Command::Keys(a) => signing::keys(&a),
        Command::Sign(a) => signing::sign(&a),
        Command::Verify(a) => signing::verify(&a),
        Command::Demo(a) => demo::run(&a),
        Command::Device(a) => device::run(&a),
        Command::Completions(a) => completions::completions(&a),
        Command::Manual(a) => completions::manual(&a),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failed(&failure),
    }
}

/// Says why, and gives the exit code.
fn failed(failure: &Failure) -> ExitCode {
    match failure {
        Failure::Input(error) => eprintln!("error: {}", pointer::told(error)),
        _ => eprintln!("error: {failure}"),
    }
    failure.exit_code()
}

/// What every help ends with.
const EXIT_CODES: &str = "Exit codes: 0 done, 1 a quality bound was not met or a signature does not fit, 2 usage or input \
    error, 130 stopped by Ctrl-C (no file is left half-written).";

/// The command line with its help.
fn command() -> clap::Command {
    fn with_exit_codes(command: clap::Command) -> clap::Command {
        let help = match command.get_after_help() {
            Some(help) => format!("{help}\n\n{EXIT_CODES}"),
            None => EXIT_CODES.to_owned(),
        };
        command.after_help(help).mut_subcommands(with_exit_codes)
    }
    with_exit_codes(Arguments::command())
}

/// What was typed.
fn typed(words: &[OsString]) -> Result<Arguments, clap::Error> {
    Arguments::from_arg_matches(&command().try_get_matches_from(words)?)
}

/// A robot with its chain.
struct Arm {
    robot: Robot,
    nominal: Poe<f64>,
}

impl Arm {
    fn load(a: &arguments::RobotArguments) -> Result<Self, Failure> {
        let options = poegp_calibration::robot::LoadOptions {
            base: a.base.clone(),
            tip: a.tip.clone(),
        };
        let robot = Robot::load(&a.robot, &options)?;
        let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
        Ok(Self { robot, nominal })
    }

    /// Reads and checks a measurement file for this arm; notes go to standard error. New tools are added to `tools`.
    fn read(
        &self,
        path: &Path,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<SampleFile, Failure> {
        read_samples(path, &self.robot, tools, correction)
    }
}

/// A measurement file of `robot`; notes go to standard error.
fn read_samples(
    path: &Path,
    robot: &Robot,
    tools: &mut Vec<ToolName>,
    correction: DriftCorrection,
) -> Result<SampleFile, Failure> {
    let file = SampleFile::read(path, robot, tools, correction)?;
    for note in &file.notes {
        crate::cli::report::remark(format_args!("{}: {note}", path.display()));
    }
    Ok(file)
}

/// Refuses a file with too few poses before any work, as an error of the file.
fn enough_poses(
    path: &Path,
    found: usize,
    equations: usize,
    method: Method,
    joints: usize,
) -> Result<(), Failure> {
    let parameters = method.parameters(joints);
    let needed = (6 * method.min_poses(joints)).div_ceil(equations);
    if found >= needed {
        return Ok(());
    }
    Err(InputError::new(
        path,
        format!("{found} poses"),
        format!(
            "at least {needed} for `{}`: {parameters} unknowns, {} equations a pose",
            method.name(),
            if equations == 6 { "six" } else { "three" }
        ),
    )
    .with_help("measure more poses, or choose a model with fewer parameters")
    .into())
}

/// What the command line says of the instrument; where it says nothing, what the rows of the file state counts.
fn instrument_noise(
    position_sigma_mm: Option<f64>,
    orientation_sigma_mrad: Option<f64>,
) -> Result<InstrumentNoise, Failure> {
    let given = |name: &str, value: Option<f64>| match value {
        Some(x) if !(x > 0.0 && x.is_finite()) => Err(Failure::Usage(format!(
            "{name} {x}: expected a number above 0"
        ))),
        _ => Ok(value.map(|x| 1e-3 * x)),
    };
    Ok(InstrumentNoise {
        position: given("--position-sigma-mm", position_sigma_mm)?,
        orientation: given("--orientation-sigma-mrad", orientation_sigma_mrad)?,
    })
}

/// Equations that a pose gives: six, or three when only positions were measured.
fn equations(samples: &[InstrumentSample]) -> usize {
    if samples.iter().all(|s| !s.observation.has_orientation()) {
        3
    } else {
        6
    }
}

/// A calibration error as one of the file.
fn calibration_failure(path: &Path, error: &CalibrationError) -> Failure {
    match error {
        CalibrationError::OneToolOnly { method } => InputError::new(
            path,
            "several sessions or targets, or positions alone",
            format!("whole poses of one tool for `{method}`"),
        )
        .with_help("use --model elastic, poe or base-tool for such data")
        .into(),
        CalibrationError::NoPayload => InputError::new(
            path,
            "no payload_kg column",
            "one: `poe-gp-load` learns the effect of the payload",
        )
        .with_help("use --model poe-gp for data without payloads")
        .into(),
        _ => InputError::new(path, error.to_string(), "data that can be fitted").into(),
    }
}

/// A failed calibration or export as an error of the file it came from.
fn device_failure(path: &Path, error: DeviceError) -> Failure {
    match error {
        DeviceError::Calibration(error) => calibration_failure(path, &error),
        DeviceError::Export(ExportError::TooManyPoints { found }) => InputError::new(
            path,
            format!("{found} poses"),
            format!("at most {HOST_SUPPORT}: every pose is a point of the Gaussian process"),
        )
        .into(),
        DeviceError::Export(error) => error.into(),
    }
}

/// The origin of a calibration: today, or the day that SOURCE_DATE_EPOCH names, for reproducible builds.
fn origin(data_sha256: [u8; 32], serial_number: &str, tools: Vec<ToolName>) -> Provenance {
    let seconds = std::env::var("SOURCE_DATE_EPOCH")
        .ok()
        .and_then(|s| s.parse().ok());
    let now = seconds
        .and_then(|s| time::OffsetDateTime::from_unix_timestamp(s).ok())
        .unwrap_or_else(time::OffsetDateTime::now_utc);
    Provenance {
        serial_number: serial_number.to_owned(),
        date: now.date().to_string(),
        data_sha256,
        tools,
    }
}

/// A JSON document as text.
fn json_text(document: &impl serde::Serialize) -> Result<String, Failure> {
    let text = serde_json::to_string_pretty(document).map_err(|e| Failure::Usage(e.to_string()))?;
    Ok(text + "\n")
}

/// Writes the facts of a command as JSON where they were asked for, with the version of the program.
fn write_facts(path: Option<&Path>, facts: serde_json::Value) -> Result<(), Failure> {
    match path {
        Some(path) => write_outputs(&[(path, facts_text(facts)?.as_bytes())]),
        None => Ok(()),
    }
}

/// The facts of a command as a JSON document, with the version of the program.
fn facts_text(mut facts: serde_json::Value) -> Result<String, Failure> {
    facts["version"] = env!("CARGO_PKG_VERSION").into();
    json_text(&facts)
}

/// Writes all outputs of a command or none; `-` is standard output.
fn write_outputs(outputs: &[(&Path, &[u8])]) -> Result<(), Failure> {
    let (stdout, files): (Vec<_>, Vec<_>) = outputs.iter().partition(|(path, _)| is_stdout(path));
    crate::output::write_all(&files)?;
    for (_, bytes) in stdout {
        let mut out = std::io::stdout();
        out.write_all(bytes)
            .and_then(|()| out.flush())
            .map_err(|error| {
                InputError::new(
                    "<standard output>",
                    format!("a place that cannot be written ({error})"),
                    "a reader of the JSON document",
                )
            })?;
    }
    Ok(())
}

/// Refuses outputs that cannot be written, that are one file, or that would overwrite an input, before the work.
fn check_outputs(outputs: &[Option<&Path>], inputs: &[&Path]) -> Result<(), Failure> {
    let outputs: Vec<&Path> = outputs.iter().flatten().copied().collect();
    for (i, path) in outputs.iter().enumerate() {
        if outputs[..i].contains(path) {
            let found = "two outputs in one file";
            return Err(InputError::new(path, found, "a file for each output").into());
        }
        if is_stdout(path) {
            continue;
        }
        crate::output::check(path)?;
        let place = std::fs::canonicalize(path);
        if place.is_ok_and(|place| {
            inputs
                .iter()
                .any(|input| std::fs::canonicalize(input).is_ok_and(|input| input == place))
        }) {
            let found = "an input of this command";
            return Err(InputError::new(path, found, "another file for the output").into());
        }
    }
    Ok(())
}

/// The last part of a path, for tables.
fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |n| n.to_string_lossy().into_owned(),
    )
}
