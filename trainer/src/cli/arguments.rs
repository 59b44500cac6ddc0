//! What can be typed.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::cli::cell::Project;
use crate::cli::check::Check;
use crate::cli::completions::{Completions, Manual};
use crate::cli::correct::Correct;
use crate::cli::device::arguments::Device;
use crate::cli::export::Export;
use crate::cli::import::Import;
use crate::cli::plan::PlanArguments;
use crate::cli::signing::{Keys, Sign, Verify};
use poegp_calibration::model::Method;

/// Calibrates robot arms from tracker measurements and writes the model that the controller evaluates.
#[derive(Debug, Parser)]
#[command(name = "trainer", version, about, max_term_width = 100)]
#[command(after_help = "Examples:\n  \
    trainer demo\n  \
    trainer calibrate --robot abb-irb120 train.csv --out arm.blob --report report.html\n  \
    trainer calibrate cell.toml\n  \
    trainer COMMAND --help   (each command has examples of its own)\n\n\
    NO_COLOR and TERM=dumb are respected. SOURCE_DATE_EPOCH sets the date that is kept in a blob.")]
pub struct Arguments {
    /// Say nothing but errors: no results for people, no notes, no progress. Files and `--json -` are written as ever.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Plan which poses to measure, as CSV and as programs of robot controllers.
    Plan(PlanArguments),
    /// Simulate a loaded arm measured by a laser tracker.
    Simulate(Simulate),
    /// Calibrate an arm and write the model blob.
    Calibrate(Calibrate),
    /// Evaluate a blob on measurements that it was not trained on.
    Evaluate(Evaluate),
    /// Compare calibration methods by cross-validation and on test sets.
    Compare(Compare),
    /// Check by a few fresh measurements whether a calibration still holds: exit code 0 if it does, 1 if not.
    Check(Check),
    /// Correct a file of joint targets as the device would.
    Correct(Correct),
    /// Show what is in a blob.
    Inspect(Inspect),
    /// Write the calibrated arm for other programs: URDF, UR driver, tables, C header.
    Export(Export),
    /// Bring measurements of other programs into the shape of the measurement file.
    Import(Import),
    /// Make keys that models are signed with.
    Keys(Keys),
    /// Sign a blob.
    Sign(Sign),
    /// Verify the signature of a blob as the device does: exit code 0 if it is by this key, 1 if not.
    Verify(Verify),
    /// Reproduce the paper's simulation from nothing: simulate, calibrate, compare, write a blob, read it back.
    Demo(Demo),
    /// Talk to a co-processor: bring a model onto it, check it, watch it, emulate it.
    Device(Device),
    /// Print a script that completes the commands and options of this program in a shell.
    Completions(Completions),
    /// Write the manual pages, one for each command.
    Manual(Manual),
}

/// Which robot.
#[derive(Debug, Args)]
pub struct RobotArguments {
    /// A URDF file, a TOML description, or a built-in robot: abb-irb4400, abb-irb4400-serial, abb-irb120, kuka-iiwa7,
    /// ur5, ur10.
    #[arg(long)]
    pub robot: String,
    /// URDF link where the chain begins (default: the root).
    #[arg(long, value_name = "LINK")]
    pub base: Option<String>,
    /// URDF link where the chain ends, the flange (default: the only leaf, or tool0, flange, ee_link).
    #[arg(long, value_name = "LINK")]
    pub tip: Option<String>,
}

/// How the paper's steps are done.
#[derive(Debug, Args)]
pub struct FitArguments {
    /// Hyperparameters of its own for each of the six outputs: more accurate, six exponentials on the device.
    #[arg(long)]
    pub per_output: bool,
    /// One set of length scales for all joints of the elastic model: a sixth of the exponentials, a little less accurate.
    #[arg(long)]
    pub tied: bool,
    /// Leave the standard deviation of the position out of a blob with --tied.
    #[arg(long)]
    pub no_device_sigma: bool,
    /// Support points of the elastic model on the device, or `all`.
    #[arg(long, value_name = "M", default_value = "100", value_parser = support)]
    pub support: Support,
    /// A support set of its own for each joint of the elastic model, at most so many functions in all (200 when no number is
    /// given): nearly the accuracy of --support 100 for less than half of its instructions.
    #[arg(long, value_name = "TOTAL", num_args = 0..=1, default_missing_value = "200",
        value_parser = clap::value_parser!(u32).range(1..=10_000), conflicts_with_all = ["tied", "support"])]
    pub support_per_output: Option<u32>,
    /// Gravity in the base frame in m/s², for arms on a wall or a ceiling.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,-9.81", allow_hyphen_values = true, value_parser = gravity)]
    pub gravity: Gravity,
    /// Standard deviation of one position component as the instrument's maker states it (default: sigma_mm of the file,
    /// else estimated).
    #[arg(long, value_name = "MM")]
    pub position_sigma_mm: Option<f64>,
    /// The same of one rotation component (default: sigma_mrad of the file, else estimated).
    #[arg(long, value_name = "MRAD")]
    pub orientation_sigma_mrad: Option<f64>,
    /// What the elastic model does with measurements that do not belong.
    #[arg(long, value_enum, default_value_t = Outliers::Report)]
    pub outliers: Outliers,
    /// Weight step 1 by the noise, rotation taken at the tool point, instead of the paper's unweighted least squares.
    #[arg(long)]
    pub weighted: bool,
}

/// Names of the methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "kebab-case")]
pub enum Model {
    /// Base and tool frames only.
    BaseTool,
    /// All frames of the chain (step 1 of the paper).
    Poe,
    /// The chain and a Gaussian process of the joints.
    PoeGp,
    /// The chain and a Gaussian process of joints and payload: the paper's method.
    PoeGpLoad,
    /// The chain, gravity terms, gear ripple and joint-space processes, solved together.
    Elastic,
}

impl From<Model> for Method {
    fn from(model: Model) -> Self {
        match model {
            Model::BaseTool => Self::BaseTool,
            Model::Poe => Self::Poe,
            Model::PoeGp => Self::PoeGp,
            Model::PoeGpLoad => Self::PoeGpLoad,
            Model::Elastic => Self::Elastic,
        }
    }
}

/// Names of the methods, and the choice by the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "kebab-case")]
pub enum ModelChoice {
    /// Base and tool frames only.
    BaseTool,
    /// All frames of the chain (step 1 of the paper).
    Poe,
    /// The chain and a Gaussian process of the joints.
    PoeGp,
    /// The chain and a Gaussian process of joints and payload: the paper's method.
    PoeGpLoad,
    /// The chain, gravity terms, gear ripple and joint-space processes, solved together.
    Elastic,
    /// The simplest of these that cross-validation of the training data cannot tell from the best.
    Auto,
}

impl ModelChoice {
    /// The method, unless the data are to choose.
    pub fn method(self) -> Option<Method> {
        match self {
            Self::BaseTool => Some(Method::BaseTool),
            Self::Poe => Some(Method::Poe),
            Self::PoeGp => Some(Method::PoeGp),
            Self::PoeGpLoad => Some(Method::PoeGpLoad),
            Self::Elastic => Some(Method::Elastic),
            Self::Auto => None,
        }
    }
}

/// `trainer simulate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Writes train.csv and test1.csv … into DIR; the tests also have the noiseless truth.\n\n\
    Example: trainer simulate --robot abb-irb4400-serial --poses 300 --payloads 1,2.5,3.5,5,7.5 --seed 1 --out cell"
)]
pub struct Simulate {
    #[command(flatten)]
    pub robot: RobotArguments,
    /// Training poses.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub poses: u32,
    /// Test sets.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=100))]
    pub test_sets: u32,
    /// Poses of each test set.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub test_poses: u32,
    /// Payloads in kg, drawn at random for each pose.
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 2.5, 3.5, 5.0, 7.5])]
    pub payloads: Vec<f64>,
    /// What is wrong with the arm.
    #[arg(long, value_enum, default_value_t = Scenario::Paper)]
    pub scenario: Scenario,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder to write into; created if it does not exist (its parent must).
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// What was written as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What is wrong with a simulated arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Scenario {
    /// Frames and joint compliance under gravity, as the paper simulates; joints within the cell.
    Paper,
    /// Also link bending, transmission error, backlash and repeatability.
    Rich,
    /// Also stiffening gears, a centre of mass for each payload and wrong payload masses.
    Wild,
    /// As `paper`, over the full joint limits.
    Full,
}

/// `trainer calibrate`.
#[derive(Debug, Args)]
#[command(
    override_usage = "trainer calibrate [OPTIONS] --robot <ROBOT> --out <FILE> <TRAIN>\n       \
    trainer calibrate [OPTIONS] <CELL.toml>",
    after_help = "A project file (cell.toml) holds robot, instrument, data with their checksums, model and outputs, with paths \
    relative to itself, so that the same calibration, to the bit, can be made again years later. Options of the command line \
    go before those of the file, and that is said. docs/guide/projects.md has its keys.\n\n\
    Examples:\n  \
    trainer calibrate --robot abb-irb120 train.csv --out arm.blob --report report.html\n  \
    trainer calibrate --robot abb-irb120 train.csv --out arm.blob --write-cell cell.toml\n  \
    trainer calibrate cell.toml\n  \
    trainer calibrate cell.toml --out again.blob"
)]
pub struct Calibrate {
    #[command(flatten)]
    pub robot: RobotArguments,
    /// Measurements to train on, or a project file (.toml) that names them and everything else.
    pub train: PathBuf,
    /// The project file that was given in their place.
    #[arg(skip)]
    pub project: Option<Project>,
    /// Project file to write: `trainer calibrate FILE` does the same again.
    #[arg(long, value_name = "FILE")]
    pub write_cell: Option<PathBuf>,
    /// Day of the calibration, kept in the blob (default: SOURCE_DATE_EPOCH, else today).
    #[arg(long, value_name = "YYYY-MM-DD", value_parser = date)]
    pub date: Option<String>,
    /// Calibration method.
    #[arg(long, value_enum, default_value_t = ModelChoice::Elastic)]
    pub model: ModelChoice,
    #[command(flatten)]
    pub fit: FitArguments,
    /// Most instructions of one evaluation on a Cortex-M4F: support points and length scales of the elastic model are
    /// chosen for it.
    #[arg(long, value_name = "N")]
    pub max_instructions: Option<u64>,
    /// Most bytes of the blob; likewise.
    #[arg(long, value_name = "BYTES")]
    pub max_flash_bytes: Option<usize>,
    /// Serial number of the arm, kept in the blob.
    #[arg(long, default_value = "")]
    pub serial_number: String,
    /// Largest displacement of the target by the correction (default: twice the largest in training).
    #[arg(long, value_name = "MM")]
    pub max_correction_mm: Option<f64>,
    /// Largest rotation by the correction (default: twice the largest in training).
    #[arg(long, value_name = "MRAD")]
    pub max_correction_mrad: Option<f64>,
    /// Take the instrument's drift out of every pose, from its reference points (columns ref1_x_mm …).
    #[arg(long)]
    pub correct_drift: bool,
    /// Blob to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Measurements that are held out: the errors on them are reported; may be repeated.
    #[arg(long = "test", value_name = "FILE")]
    pub tests: Vec<PathBuf>,
    /// A page with held-out errors, plots, parameters and provenance as HTML; without --test it cross-validates, which
    /// takes some five calibrations more.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Facts of the calibration as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// A day of the calendar.
fn date(text: &str) -> Result<String, String> {
    let numbers: Option<Vec<u16>> = text.split('-').map(|part| part.parse().ok()).collect();
    let day = match numbers.as_deref() {
        Some([year, month, day]) if text.len() == 10 => u8::try_from(*month)
            .ok()
            .and_then(|month| time::Month::try_from(month).ok())
            .zip(u8::try_from(*day).ok())
            .and_then(|(month, day)| {
                time::Date::from_calendar_date(i32::from(*year), month, day).ok()
            }),
        _ => None,
    };
    day.map(|day| day.to_string())
        .ok_or_else(|| "expected a day as 2026-11-20".to_owned())
}

/// `trainer evaluate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: trainer evaluate arm.blob test.csv --predictions predicted.csv --json -"
)]
pub struct Evaluate {
    /// The model.
    pub blob: PathBuf,
    /// Measurements that it was not trained on.
    pub test: PathBuf,
    /// Fit the frame of a tool that the blob does not know (a new session) to so many of its own rows, evenly spread;
    /// they are not scored.
    #[arg(long, value_name = "ROWS", value_parser = clap::value_parser!(u32).range(1..))]
    pub fit_tool: Option<u32>,
    /// Take the instrument's drift out of every pose, from its reference points (columns ref1_x_mm …).
    #[arg(long)]
    pub correct_drift: bool,
    /// One row per measurement, in order: x_mm,y_mm,z_mm,qw,qx,qy,qz,status of the predicted instrument_from_target.
    #[arg(long, value_name = "FILE")]
    pub predictions: Option<PathBuf>,
    /// Two more columns of the predictions: trust,sigma_mm, what the device says of its own answer (sigma_mm is empty when
    /// the blob does not know it).
    #[arg(long, requires = "predictions")]
    pub trust: bool,
    /// Errors as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// `trainer compare`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: trainer compare --robot abb-irb120 train.csv --test test1.csv --test test2.csv --folds 5"
)]
pub struct Compare {
    #[command(flatten)]
    pub robot: RobotArguments,
    /// Measurements to train on, and to cross-validate on.
    pub train: PathBuf,
    /// Measurements to test on; may be repeated.
    #[arg(long = "test", value_name = "FILE")]
    pub tests: Vec<PathBuf>,
    /// Methods (default: all that the data allow).
    #[arg(long, value_enum, value_delimiter = ',')]
    pub models: Vec<Model>,
    /// Folds of the cross-validation; 0 for none.
    #[arg(long, default_value_t = 10)]
    pub folds: usize,
    /// Seed of the draw of folds.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Take the instrument's drift out of every pose, from its reference points (columns ref1_x_mm …).
    #[arg(long)]
    pub correct_drift: bool,
    #[command(flatten)]
    pub fit: FitArguments,
    /// A page with the errors and plots of them as HTML: of the test sets, or of the folds when there are none.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Errors as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// `trainer inspect`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer inspect arm.blob")]
pub struct Inspect {
    /// The model.
    pub blob: PathBuf,
    /// The same as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// `trainer demo`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  trainer demo\n  trainer demo --seed 2 --out demo2")]
pub struct Demo {
    /// Seed of the simulated arm.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder to write into; created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Errors of all models and the names of the files as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Number of support points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Support(pub Option<usize>);

fn support(text: &str) -> Result<Support, String> {
    match text {
        "all" => Ok(Support(None)),
        _ => match text.parse::<usize>() {
            Ok(count) if count > 0 => Ok(Support(Some(count))),
            _ => Err("expected a number above 0, or `all`".to_owned()),
        },
    }
}

/// Gravity in the base frame, m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity(pub [f64; 3]);

/// Three numbers.
pub fn gravity(text: &str) -> Result<Gravity, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|x| x.trim().parse()).collect();
    let vector = numbers.ok().and_then(|v| <[f64; 3]>::try_from(v).ok());
    match vector {
        Some(g) if g.iter().all(|x| x.is_finite()) => Ok(Gravity(g)),
        _ => Err("expected three numbers in m/s², as 0,0,-9.81".to_owned()),
    }
}

/// What is done with outliers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Outliers {
    /// Report them and keep them.
    Report,
    /// Report them and leave them out.
    Reject,
}
