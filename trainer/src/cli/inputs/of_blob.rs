//! Measurements of the robot of a blob.

use std::path::Path;

use nalgebra::Vector3;
use poegp_calibration::blob::fitted_frames::{FrameError, FramesToFit};
use poegp_calibration::blob::predict::{BlobModel, poses};
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::instrument_drift::DriftReport;
use poegp_calibration::measurement::long::{LongFile, is_long};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::measurement::{Measurement, MeasurementSet};
use poegp_calibration::numeric::parallel::in_order;
use poegp_calibration::progress::threads;
use poegp_calibration::robot::{Joint, Robot};
use poegp_calibration::trust::{Cause, Finding};
use poegp_protocol::blob::Correction;
use poegp_runtime::math::se3::Pose;

use crate::cli::examination::{Examined, GRAVITY};
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::read_samples;
use crate::cli::terminal::print::note;

/// Advice about measurements in other frames than the calibration's.
pub const FRAMES_HELP: &str = "give --fit-base if the instrument was moved; give --fit-tool if the target was \
                               remounted, or if the calibration had positions alone";

/// A measurement file, read for the arm of a blob.
pub struct TestData {
    pub set: MeasurementSet,
    pub samples: Vec<InstrumentSample>,
    /// Gravity in the base frame, m/s².
    gravity: Vector3<f64>,
    /// Names of the tools: those of the blob first, then those that only the file has.
    pub names: Vec<ToolName>,
    /// Drift that was removed from the samples.
    pub drift: Option<DriftReport>,
    /// The file itself, if it is long; then `set` and `samples` hold only some of its rows.
    long: Option<LongFile>,
}

/// Reads and checks measurements of a blob's robot; notes go to standard error.
pub fn read(
    loaded: &BlobModel,
    input: &Input<'_>,
    correction: DriftCorrection,
) -> Result<TestData, Failure> {
    let robot = robot_of(loaded);
    let mut names = tools_of(loaded);
    let file = read_samples(input, (&robot, gravity_of(loaded)), &mut names, correction)?;
    complete(loaded, input.path, names, (None, file))
}

/// Reads measurements as [`read`] does, but only some rows of a long file; [`TestData::each_chunk`] visits all. The drift of the
/// instrument depends on all rows, so that its correction needs the whole file in memory.
pub fn read_long(
    loaded: &BlobModel,
    input: &Input<'_>,
    correction: DriftCorrection,
) -> Result<TestData, Failure> {
    let path = input.path;
    let is_held = input.bytes.is_some() || !matches!(correction, DriftCorrection::None);
    if is_held || !is_long(path) {
        return read(loaded, input, correction);
    }
    let robot = robot_of(loaded);
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
        gravity: gravity_of(loaded),
        names,
        drift: drift.map(|drift| drift.report),
        long,
    })
}

/// Number of rows in a chunk of a file that is held in memory.
const HELD_CHUNK: usize = 1024;

impl TestData {
    /// Calls `work` with every chunk of rows, on all cores, and `take` with the results in the order of the rows.
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

    /// Examines whether the rows are measurements of `robot`, and returns the warnings.
    ///
    /// # Errors
    /// [`Failure::Data`] if they are of another robot.
    pub fn examined(
        &self,
        path: &Path,
        json: Option<&Path>,
        accept: &[Cause],
        robot: &Robot,
    ) -> Result<Vec<Finding>, Failure> {
        Examined {
            path,
            robot,
            set: &self.set,
            samples: &self.samples,
            gravity: self.gravity,
            json,
            accept,
        }
        .for_judging()
    }

    /// Returns the frames of the file's tools. Refuses a tool that the blob does not know, unless `which` has its frame
    /// fitted to the measurements.
    pub fn frames(
        &self,
        loaded: &BlobModel,
        path: &Path,
        which: FramesToFit,
    ) -> Result<Vec<Pose<f64>>, Failure> {
        let known = loaded.tools();
        // If blob and file both have a single tool, it is taken to be the same one.
        let is_the_only_one = known.is_empty() && self.names.len() == 1;
        match self.names.get(known.len()) {
            Some(name) if !(which.tools || is_the_only_one) => Err(InputError::new(
                path,
                format!("{name}, which was mounted after the calibration"),
                "a tool of the blob",
            )
            .with_help(
                "give --fit-tool to fit its frame to these measurements first, or --fit-tool ROWS to some of its rows, which are then not compared",
            )
            .into()),
            new => {
                if which.tools && new.is_none() && !is_the_only_one {
                    note(format_args!(
                        "{}: the blob contains all tools, so --fit-tool fits none; give a remounted target a session \
                        of its own",
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

/// Describes which frames were fitted; `left_out` is the number of rows that were not compared.
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
            "{why}{what} fitted to these measurements, which makes the errors look slightly smaller and hides any \
            drift of these \
             frames."
        ),
        rows => format!(
            "{why}{what} fitted to {rows} other rows, which are not compared; any drift of these frames is hidden."
        ),
    })
}

/// Converts the error about frames that cannot be fitted to an error about the file.
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
            counted(poses, "distinct pose"),
            format!("at least {needed} to fit the {numbers} numbers of the frames"),
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

/// Returns gravity in the base frame, m/s²; that of an upright arm if the model has none.
fn gravity_of(loaded: &BlobModel) -> Vector3<f64> {
    match &loaded.blob().correction {
        Correction::Elastic(elastic) => Vector3::from(elastic.gravity).cast(),
        _ => GRAVITY.into(),
    }
}

/// Returns the robot of a blob, with the parts that a measurement file is checked against.
pub fn robot_of(loaded: &BlobModel) -> Robot {
    let blob = loaded.blob();
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
        parent_from_joint: poses(&blob.geometry.nominal),
        coupling: loaded.coupling(),
        link_radius: None,
        prior: None,
    }
}
