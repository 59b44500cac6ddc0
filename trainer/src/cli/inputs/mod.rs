//! Input files of commands: robots and measurements.

mod known_rows;
mod of_blob;

use std::fmt::Display;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;

use crate::cli::args::ChainArgs;
use crate::cli::examination::{Examined, GRAVITY, explained};
use crate::cli::failure::{Failure, calibration_failure};
use crate::cli::input::Input;
use crate::cli::terminal::print::note;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::Provenance;
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::folds::known_configurations;
use poegp_calibration::measurement::instrument_drift::Drift;
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::trust::{Cause, Finding, Findings, Tier};
use poegp_calibration::validation::cross_validation::TestSet;

use known_rows::KnownRows;
pub use of_blob::{FRAMES_HELP, fitted_frames, frame_failure, read, read_long, robot_of};

/// A robot with its nominal chain, as it is mounted.
pub struct Arm {
    pub robot: Robot,
    pub nominal: Poe<f64>,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
}

impl Arm {
    /// Loads an arm that stands upright.
    pub fn load(description: &str, chain: &ChainArgs) -> Result<Self, Failure> {
        let options = LoadOptions {
            base: chain.base.clone(),
            tip: chain.tip.clone(),
        };
        let robot = Robot::load(description, &options)?;
        let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
        Ok(Self {
            robot,
            nominal,
            gravity: GRAVITY.into(),
        })
    }

    /// Reads and checks measurements of this robot; notes go to standard error. New tools are appended to `tools`.
    pub fn read(
        &self,
        input: &Input<'_>,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<SampleFile, Failure> {
        read_samples(input, (&self.robot, self.gravity), tools, correction)
    }
}

/// Reads and checks measurements of a robot, with gravity in its base frame; notes go to standard error.
fn read_samples(
    input: &Input<'_>,
    (robot, gravity): (&Robot, Vector3<f64>),
    tools: &mut Vec<ToolName>,
    correction: DriftCorrection,
) -> Result<SampleFile, Failure> {
    let path = input.path;
    let file = match input.bytes {
        Some(bytes) => SampleFile::parse(path, bytes, robot, tools, correction),
        None => SampleFile::read(path, robot, tools, correction),
    };
    let file = file.map_err(|error| explained(input, robot, gravity, error))?;
    for text in &file.notes {
        note(format_args!("{}: {text}", path.display()));
    }
    Ok(file)
}

/// Refuses a file with too few different poses or too many rows, before any fit begins, with an error about the file.
pub fn enough_poses(
    path: &Path,
    (poses, rows): (usize, usize),
    equations: usize,
    method: Method,
    joints: usize,
) -> Result<(), Failure> {
    if let Some(most) = method.max_poses().filter(|most| rows > *most) {
        let error = CalibrationError::TooManyPoses {
            found: rows,
            most,
            method: method.name(),
        };
        return Err(calibration_failure(path, &error));
    }
    let parameters = method.parameters(joints);
    let needed = (6 * method.min_poses(joints)).div_ceil(equations);
    if poses >= needed {
        return Ok(());
    }
    Err(InputError::new(
        path,
        match poses == rows {
            true => counted(poses, "pose"),
            false => format!("{} in {rows} rows", counted(poses, "different pose")),
        },
        format!(
            "at least {needed} for `{}`: {parameters} unknowns, {} equations per pose",
            method.name(),
            if equations == 6 { "six" } else { "three" }
        ),
    )
    .with_help("measure more poses, or choose a method with fewer parameters")
    .into())
}

/// Returns the number of equations that a pose gives: six, or three if only positions were measured.
pub fn equations(samples: &[InstrumentSample]) -> usize {
    if samples.iter().all(|s| !s.observation.has_orientation()) {
        3
    } else {
        6
    }
}

/// Creates the provenance of a calibration, dated today, or on the day of SOURCE_DATE_EPOCH for reproducible builds.
pub fn origin(data_sha256: [u8; 32], serial_number: &str, tools: Vec<ToolName>) -> Provenance {
    Provenance {
        serial_number: serial_number.to_owned(),
        date: now().date().to_string(),
        data_sha256,
        tools,
        ..Provenance::default()
    }
}

/// Whether a model was calibrated with the bytes of the file that has this hash.
pub fn is_training_data(loaded: &BlobModel, sha256: [u8; 32]) -> bool {
    loaded.host().provenance.data_sha256 == sha256
}

/// Refuses the file that a model was calibrated with; `expected` describes the file that the command needs instead.
pub fn fresh(
    loaded: &BlobModel,
    path: &Path,
    sha256: [u8; 32],
    expected: &str,
) -> Result<(), InputError> {
    match is_training_data(loaded, sha256) {
        true => Err(InputError::new(path, "the training data", expected)
            .with_help("the model was fitted to these rows, so they cannot show that it is wrong")),
        false => Ok(()),
    }
}

/// States that errors are those of rows that `model` was fitted to.
pub fn training_data_warning(path: &Path, model: impl Display) -> String {
    format!(
        "{}: {model} was calibrated with these rows: its errors elsewhere are larger",
        path.display()
    )
}

/// Returns the time of SOURCE_DATE_EPOCH if it is set, for reproducible builds.
///
/// # Errors
/// [`Failure::Usage`] if it is not a number of seconds since 1970.
pub fn source_date() -> Result<Option<time::OffsetDateTime>, Failure> {
    let Some(stated) = std::env::var_os("SOURCE_DATE_EPOCH") else {
        return Ok(None);
    };
    let seconds = stated.to_str().and_then(|s| s.parse::<u64>().ok());
    let date = seconds.and_then(|s| {
        let date = time::OffsetDateTime::from_unix_timestamp(s.try_into().ok()?).ok()?;
        (date.year() <= 9999).then_some(date)
    });
    match date {
        Some(date) => Ok(Some(date)),
        None => Err(Failure::Usage(format!(
            "SOURCE_DATE_EPOCH is {:?}, expected the seconds since 1970, as in 1764000000",
            stated.to_string_lossy()
        ))),
    }
}

/// Returns the current time, or that of SOURCE_DATE_EPOCH if it is set.
pub fn now() -> time::OffsetDateTime {
    let stated = source_date().ok().flatten();
    stated.unwrap_or_else(time::OffsetDateTime::now_utc)
}

/// Returns the last part of a path, for tables.
pub fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |n| n.to_string_lossy().into_owned(),
    )
}

/// Reads a test file of the same arm. Its rows must be new to `known`, its tools among the first `trained_tools`.
fn read_test(
    arm: &Arm,
    path: &Path,
    known: &mut KnownRows,
    tools: &mut Vec<ToolName>,
    trained_tools: usize,
    correction: DriftCorrection,
) -> Result<SampleFile, Failure> {
    let file = arm.read(&Input::file(path), tools, correction)?;
    known.add(&file.set)?;
    if let Some(unknown) = tools.get(trained_tools) {
        return Err(InputError::new(
            path,
            format!("{unknown}, which is not in the training data"),
            "tools of the training data",
        )
        .with_help("calibrate without this file, then fit the tool with `trainer evaluate --fit-tool ROWS`")
        .into());
    }
    Ok(file)
}

/// Test files; their drift is removed if it was removed from the training data.
pub struct Tests {
    /// The files as they were read.
    pub files: Vec<MeasurementSet>,
    /// The samples that are predicted.
    pub sets: Vec<TestSet>,
    /// For each row, file by file, whether the training data have its configuration: a model may have learnt its error.
    pub trained: Vec<bool>,
}

/// Share of trained poses in a test file above which it is warned of.
const TRAINED: f64 = 0.1;

impl Tests {
    /// Reads all test files, and refuses training rows among theirs.
    pub fn read(
        arm: &Arm,
        paths: &[PathBuf],
        train: &MeasurementSet,
        tools: &[ToolName],
        drift: Option<&Drift>,
    ) -> Result<Self, Failure> {
        let (mut files, mut sets) = (Vec::new(), Vec::new());
        let mut names = tools.to_vec();
        let mut known = KnownRows::new(train);
        for path in paths {
            let correction = drift.map_or(DriftCorrection::None, DriftCorrection::RelativeTo);
            let SampleFile { set, samples, .. } =
                read_test(arm, path, &mut known, &mut names, tools.len(), correction)?;
            let name = file_name(path);
            files.push(set);
            sets.push(TestSet { name, samples });
        }
        let joints = |set: &MeasurementSet| -> Vec<Vec<f64>> {
            set.measurements.iter().map(|m| m.joints.clone()).collect()
        };
        let (known, tested) = (joints(train), files.iter().flat_map(joints));
        let known: Vec<&[f64]> = known.iter().map(Vec::as_slice).collect();
        let tested: Vec<Vec<f64>> = tested.collect();
        let tested = tested.iter().map(Vec::as_slice);
        let trained = known_configurations(tested, &known, &arm.robot.kinds());
        Ok(Self {
            files,
            sets,
            trained,
        })
    }

    /// Examines whether the rows of each file, read from `paths`, are measurements of `arm`, and returns the warnings.
    ///
    /// # Errors
    /// [`Failure::Data`] if they are of another robot, or written in another way.
    pub fn examine(
        &self,
        arm: &Arm,
        paths: &[PathBuf],
        json: Option<&Path>,
        accept: &[Cause],
    ) -> Result<Vec<Finding>, Failure> {
        let mut warnings = Vec::new();
        let mut trained = self.trained.as_slice();
        for ((path, set), test) in paths.iter().zip(&self.files).zip(&self.sets) {
            let examined = Examined {
                path,
                robot: &arm.robot,
                set,
                samples: &test.samples,
                gravity: arm.gravity,
                json,
                accept,
            };
            warnings.extend(examined.for_judging()?);
            let (of_file, later) = trained.split_at(set.measurements.len());
            trained = later;
            warnings.extend(examined.settle(trained_poses(of_file))?);
        }
        Ok(warnings)
    }
}

/// Returns what is found of a test file whose rows were trained on where `trained` says so.
fn trained_poses(trained: &[bool]) -> Findings {
    let (count, all) = (trained.iter().filter(|is| **is).count(), trained.len());
    let share = count as f64 / all.max(1) as f64;
    let text = format!(
        "{count} of {all} rows repeat joints of the training data (within 0.1°): their errors are not those at other \
         poses, and a verdict leaves them out"
    );
    let tier = match share > TRAINED {
        true => Tier::Warning,
        false => Tier::Note,
    };
    let finding = (count > 0).then(|| Finding::new(Cause::Copies, tier, text, share, TRAINED));
    Findings(finding.into_iter().collect())
}
