//! Files that commands read: robots and measurements.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use poegp_protocol::blob::Blob;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::cli::args::ChainArgs;
use crate::cli::examination::{Examined, explained};
use crate::cli::failure::{Failure, calibration_failure};
use crate::cli::input::Input;
use crate::cli::terminal::print::{note, warning};
use poegp_calibration::blob::fitted_frames::{FrameError, FramesToFit};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::Provenance;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::instrument_drift::{Drift, DriftReport};
use poegp_calibration::measurement::long::{LongFile, is_long};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::measurement::{Measurement, MeasurementSet};
use poegp_calibration::model::{CalibrationError, Method};
use poegp_calibration::numeric::parallel::in_order;
use poegp_calibration::progress::threads;
use poegp_calibration::robot::{Joint, LoadOptions, Robot};
use poegp_calibration::trust::{Cause, Finding};
use poegp_calibration::validation::cross_validation::TestSet;

/// What to do about measurements in other frames than the calibration's.
pub const FRAMES_HELP: &str = "if the instrument was moved give --fit-base, if the target was remounted or the calibration \
    had positions alone --fit-tool";

/// A robot with its chain.
pub struct Arm {
    pub robot: Robot,
    pub nominal: Poe<f64>,
}

impl Arm {
    pub fn load(description: &str, chain: &ChainArgs) -> Result<Self, Failure> {
        let options = LoadOptions {
            base: chain.base.clone(),
            tip: chain.tip.clone(),
        };
        let robot = Robot::load(description, &options)?;
        let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
        Ok(Self { robot, nominal })
    }

    /// Reads and checks a measurement file for this robot; notes go to standard error. New tools are added to `tools`.
    pub fn read(
        &self,
        path: &Path,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<SampleFile, Failure> {
        read_samples(&Input::file(path), &self.robot, tools, correction)
    }

    /// As [`Arm::read`], for measurements that need not be in a file.
    pub fn read_input(
        &self,
        input: &Input<'_>,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<SampleFile, Failure> {
        read_samples(input, &self.robot, tools, correction)
    }
}

/// A measurement file of `robot`; notes go to standard error.
fn read_samples(
    input: &Input<'_>,
    robot: &Robot,
    tools: &mut Vec<ToolName>,
    correction: DriftCorrection,
) -> Result<SampleFile, Failure> {
    let path = input.path;
    let file = match input.bytes {
        Some(bytes) => SampleFile::parse(path, bytes, robot, tools, correction),
        None => SampleFile::read(path, robot, tools, correction),
    };
    let file = file.map_err(|error| explained(input, robot, error))?;
    for text in &file.notes {
        note(format_args!("{}: {text}", path.display()));
    }
    Ok(file)
}

/// Refuses a file with too few different poses or too many rows before any work, as an error of the file.
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
            true => format!("{poses} poses"),
            false => format!("{poses} different poses in {rows} rows"),
        },
        format!(
            "at least {needed} for `{}`: {parameters} unknowns, {} equations a pose",
            method.name(),
            if equations == 6 { "six" } else { "three" }
        ),
    )
    .with_help("measure more poses, or choose a method with fewer parameters")
    .into())
}

/// Equations that a pose gives: six, or three when only positions were measured.
pub fn equations(samples: &[InstrumentSample]) -> usize {
    if samples.iter().all(|s| !s.observation.has_orientation()) {
        3
    } else {
        6
    }
}

/// The origin of a calibration: today, or the day that SOURCE_DATE_EPOCH names, for reproducible builds.
pub fn origin(data_sha256: [u8; 32], serial_number: &str, tools: Vec<ToolName>) -> Provenance {
    Provenance {
        serial_number: serial_number.to_owned(),
        date: now().date().to_string(),
        data_sha256,
        tools,
        ..Provenance::default()
    }
}

const TRAINING_DATA: &str = "the training data";

/// Whether a model was calibrated with the file that has this hash.
pub fn is_training_data(loaded: &BlobModel, sha256: [u8; 32]) -> bool {
    loaded.host().provenance.data_sha256 == sha256
}

/// Refuses the file that a model was calibrated with: `expected` is what a command needs instead.
///
/// # Errors
/// [`InputError`].
pub fn fresh(
    loaded: &BlobModel,
    path: &Path,
    sha256: [u8; 32],
    expected: &str,
) -> Result<(), InputError> {
    match is_training_data(loaded, sha256) {
        true => Err(InputError::new(path, TRAINING_DATA, expected)
            .with_help("the model was fitted to these rows, so they cannot show that it is wrong")),
        false => Ok(()),
    }
}

/// Says that errors are of the rows that `model` was fitted to.
pub fn warn_of_training_data(path: &Path, model: impl Display) {
    warning(format_args!(
        "{}: {model} was calibrated with these rows: its errors elsewhere are larger",
        path.display()
    ));
}

/// The time, or the one of SOURCE_DATE_EPOCH.
pub fn now() -> time::OffsetDateTime {
    let seconds = std::env::var("SOURCE_DATE_EPOCH")
        .ok()
        .and_then(|s| s.parse().ok());
    seconds
        .and_then(|s| time::OffsetDateTime::from_unix_timestamp(s).ok())
        .unwrap_or_else(time::OffsetDateTime::now_utc)
}

/// The last part of a path, for tables.
pub fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |n| n.to_string_lossy().into_owned(),
    )
}

/// A measurement file as the arm of a blob sees it.
pub struct TestData {
    pub set: MeasurementSet,
    pub samples: Vec<InstrumentSample>,
    /// First the tools of the blob, then those that only the file has.
    pub names: Vec<ToolName>,
    /// The drift that was removed from the samples.
    pub drift: Option<DriftReport>,
    /// A file of which `set` and `samples` are some rows only.
    long: Option<LongFile>,
}

/// Reads and checks measurements for the robot of a blob; notes go to standard error.
pub fn read(
    loaded: &BlobModel,
    input: &Input<'_>,
    correction: DriftCorrection,
) -> Result<TestData, Failure> {
    let robot = robot_of(loaded.blob());
    let mut names = tools_of(loaded);
    let file = read_samples(input, &robot, &mut names, correction)?;
    complete(loaded, input.path, names, (None, file))
}

/// As [`read`], but of a long file some rows only; [`TestData::each_chunk`] shows all. The drift of the instrument is a matter
/// of all rows, so that with its correction every file is held.
pub fn read_long(
    loaded: &BlobModel,
    path: &Path,
    correction: DriftCorrection,
) -> Result<TestData, Failure> {
    if !matches!(correction, DriftCorrection::None) || !is_long(path) {
        return read(loaded, &Input::file(path), correction);
    }
    let robot = robot_of(loaded.blob());
    let mut names = tools_of(loaded);
    let (long, file) = LongFile::read(path, &robot, &mut names)?;
    for text in &file.notes {
        note(format_args!("{}: {text}", path.display()));
    }
    complete(loaded, path, names, (Some(long), file))
}

fn tools_of(loaded: &BlobModel) -> Vec<ToolName> {
    let tools = loaded.tools().iter();
    tools.map(|(name, _)| name.clone()).collect()
}

fn complete(
    loaded: &BlobModel,
    path: &Path,
    names: Vec<ToolName>,
    (long, file): (Option<LongFile>, SampleFile),
) -> Result<TestData, Failure> {
    let blob = loaded.blob();
    let SampleFile {
        set,
        samples,
        drift,
        ..
    } = file;
    if blob.ranges.payload_kg.is_some() && !set.has_payload() {
        return Err(InputError::new(
            path,
            "no payload_kg column",
            "a payload_kg column, because the model depends on the payload",
        )
        .into());
    }
    Ok(TestData {
        set,
        samples,
        names,
        drift: drift.map(|drift| drift.report),
        long,
    })
}

/// Rows of a file that is held which are looked at together.
const HELD_CHUNK: usize = 1024;

impl TestData {
    /// Shows all rows of the file, in chunks, to `work` on all cores, and what it made of them to `take` in their order.
    ///
    /// # Errors
    /// Those of `take`, and [`InputError`] for a long file that has changed.
    pub fn each_chunk<O: Send>(
        &self,
        robot: &Robot,
        work: impl Fn(&[Measurement], &[InstrumentSample]) -> O + Sync,
        take: impl FnMut(O) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        if let Some(long) = &self.long {
            return long.each_chunk(robot, &self.names, work, take);
        }
        let rows = self.set.measurements.chunks(HELD_CHUNK);
        let mut chunks = rows.zip(self.samples.chunks(HELD_CHUNK));
        in_order(
            threads(),
            || Ok(chunks.next()),
            |(rows, samples)| work(rows, samples),
            take,
        )
    }

    /// The warnings about its rows as measurements of `robot`.
    ///
    /// # Errors
    /// [`Failure::Data`] when they are of another one.
    pub fn examined(
        &self,
        path: &Path,
        json: Option<&Path>,
        accept: &[Cause],
        robot: &Robot,
    ) -> Result<Vec<Finding>, Failure> {
        let (set, samples) = (&self.set, self.samples.as_slice());
        Examined {
            path,
            robot,
            set,
            samples,
            json,
            accept,
        }
        .for_judging()
    }

    /// The frames of its tools, where the frames that `which` names are fitted to its measurements.
    pub fn frames(
        &self,
        loaded: &BlobModel,
        path: &Path,
        which: FramesToFit,
    ) -> Result<Vec<Pose<f64>>, Failure> {
        let known = loaded.tools();
        // One tool on both sides: the same, unless the file says otherwise.
        let is_the_only_one = known.is_empty() && self.names.len() == 1;
        match self.names.get(known.len()) {
            Some(name) if !(which.tools || is_the_only_one) => Err(InputError::new(
                path,
                format!("{name}, which was mounted after the calibration"),
                "a tool that the blob knows",
            )
            .with_help(
                "give --fit-tool to fit its frame to these measurements first, or --fit-tool ROWS to some of its rows, which are then not compared",
            )
            .into()),
            new => {
                if which.tools && new.is_none() && !is_the_only_one {
                    note(format_args!(
                        "{}: the blob knows all tools, so --fit-tool fits none; give a remounted target a session of its own",
                        path.display()
                    ));
                }
                let mut tools: Vec<Pose<f64>> = known.iter().map(|(_, pose)| *pose).collect();
                tools.resize_with(self.names.len(), Pose::identity);
                Ok(tools)
            }
        }
    }
}

/// Which frames were fitted; `left_out` rows were not compared.
pub fn fitted_frames(
    loaded: &BlobModel,
    base: bool,
    tool: bool,
    left_out: usize,
) -> Option<String> {
    let why = match loaded.knows_instrument() {
        true => "",
        false => {
            "This model was calibrated by touches, which do not show where the instrument stands. "
        }
    };
    let what = match (base, tool) {
        (false, false) => return None,
        (true, false) => "The base frame was",
        (false, true) => "The tool frames were",
        (true, true) => "Base and tool frames were",
    };
    Some(match left_out {
        0 => format!(
            "{why}{what} fitted to these measurements, which flatters the errors a little and hides any drift of theirs."
        ),
        rows => format!(
            "{why}{what} fitted to {rows} other rows, which are not compared; any drift of theirs is hidden."
        ),
    })
}

/// Frames that cannot be fitted, as an error of the file.
pub fn frame_failure(path: &Path, names: &[ToolName], error: FrameError) -> Failure {
    match error {
        FrameError::NothingLeft { tool, rows, wanted } => InputError::new(
            path,
            match names.get(tool) {
                Some(name) => format!("{rows} rows of {name}"),
                None => format!("{rows} rows"),
            },
            format!(
                "more than the {wanted} that frames are fitted to: some must be left to compare"
            ),
        ),
        FrameError::TooFew {
            poses,
            numbers,
            needed,
        } => InputError::new(
            path,
            format!("{poses} different poses"),
            format!(
                "at least {needed}, because {numbers} numbers of the frames are fitted to them"
            ),
        ),
        FrameError::Undetermined => InputError::new(
            path,
            error.to_string(),
            "poses with different positions and orientations",
        )
        .with_help("fit to more rows, or to rows whose joints differ more"),
    }
    .into()
}

/// The arm of a blob as far as a measurement file is checked against it.
pub fn robot_of(blob: &Blob<'_>) -> Robot {
    let joint = |(i, joint): (usize, &poegp_protocol::blob::Joint)| Joint {
        name: format!("q{}", i + 1),
        kind: joint.kind,
        limits: joint
            .limits
            .map(|(lower, upper)| (f64::from(lower), f64::from(upper))),
        gear_lines: Vec::new(),
        link_radius: None,
    };
    Robot {
        name: blob.robot.name.to_owned(),
        joints: blob.robot.joints.iter().enumerate().map(joint).collect(),
        parent_from_joint: blob
            .geometry
            .nominal
            .iter()
            .map(|f| Pose::<f32>::from_rows(f).cast())
            .collect(),
        coupling: (!blob.robot.coupling.is_empty()).then(|| {
            let rows = blob.robot.coupling.chunks(blob.robot.joints.len());
            rows.map(|row| row.iter().map(|c| f64::from(*c)).collect())
                .collect()
        }),
        link_radius: None,
        prior: None,
    }
}

/// A test file of the same arm, whose tools have to be among the first `trained_tools`.
pub fn read_test(
    arm: &Arm,
    path: &Path,
    train: &MeasurementSet,
    tools: &mut Vec<ToolName>,
    trained_tools: usize,
    correction: DriftCorrection,
) -> Result<SampleFile, Failure> {
    let file = arm.read(path, tools, correction)?;
    if file.set.sha256 == train.sha256 {
        return Err(InputError::new(path, TRAINING_DATA, "held-out poses").into());
    }
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

/// Test files, with the drift taken out when the training data have it taken out.
pub struct Tests {
    /// As they were read.
    pub files: Vec<MeasurementSet>,
    /// As they are predicted.
    pub sets: Vec<TestSet>,
}

impl Tests {
    /// Reads them all; the training file itself is refused.
    pub fn read(
        arm: &Arm,
        paths: &[PathBuf],
        train: &MeasurementSet,
        tools: &[ToolName],
        drift: Option<&Drift>,
    ) -> Result<Self, Failure> {
        let (mut files, mut sets) = (Vec::new(), Vec::new());
        let mut names = tools.to_vec();
        for path in paths {
            let correction = drift.map_or(DriftCorrection::None, DriftCorrection::RelativeTo);
            let SampleFile { set, samples, .. } =
                read_test(arm, path, train, &mut names, tools.len(), correction)?;
            let name = file_name(path);
            files.push(set);
            sets.push(TestSet { name, samples });
        }
        Ok(Self { files, sets })
    }
}
