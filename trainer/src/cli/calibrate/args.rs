//! Arguments of `trainer calibrate`.

use std::path::PathBuf;

use clap::Parser;

use crate::cli::args::{ChainArgs, FitArgs, MethodChoice, heading, method_or_auto};
use crate::cli::calibrate::gauge::GaugeArgs;
use crate::cli::examination::AcceptArgs;
use crate::cli::tolerance::ToleranceArgs;

/// `trainer calibrate`.
#[derive(Debug, Parser)]
#[command(
    override_usage = "trainer calibrate [OPTIONS] --robot <ROBOT> --out <FILE> <TRAIN>\n       \
    trainer calibrate [OPTIONS] <PROJECT.toml>",
    after_help = "A project file (project.toml) holds robot, data with their checksums, configuration and outputs, with paths \
    relative to the file. `trainer calibrate project.toml` repeats the calibration, to the bit. Command-line options override \
    the project file; a note lists each override.\n\n\
    Examples:\n  \
    trainer calibrate --robot abb-irb120 train.csv --out arm.blob --report report.html\n  \
    trainer calibrate --robot abb-irb120 train.csv --out arm.blob --write-project project.toml\n  \
    trainer calibrate --robot abb-irb120 again.csv --out next.blob --keep-gauge arm.blob\n  \
    trainer calibrate project.toml\n  \
    trainer calibrate project.toml --out again.blob"
)]
pub struct Calibrate {
    /// Measurements to train on, or a project file (.toml).
    pub train: PathBuf,
    /// URDF file, TOML description, or built-in robot: abb-irb4400, abb-irb4400-serial, abb-irb120, kuka-iiwa7, ur5, ur10.
    #[arg(long)]
    pub robot: Option<String>,
    #[command(flatten)]
    pub chain: ChainArgs,
    /// Calibration method (default: auto).
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto())]
    pub method: Option<MethodChoice>,
    /// Blob to write.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Held-out measurements: the errors on them are reported; may be repeated.
    #[arg(long = "test", value_name = "FILE")]
    pub tests: Vec<PathBuf>,
    /// Write an HTML report: held-out errors, plots, parameters, provenance. Without --test it cross-validates, which takes
    /// about five more calibrations.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write the results as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Description of the touched features (TOML; default: NAME.toml beside NAME.csv).
    #[arg(long, value_name = "FILE", help_heading = heading::MEASUREMENTS)]
    pub features: Option<PathBuf>,
    /// Remove the instrument's drift from every pose, estimated from reference points (columns ref1_x_mm …).
    #[arg(long, help_heading = heading::MEASUREMENTS)]
    pub correct_drift: bool,
    #[command(flatten, next_help_heading = heading::MEASUREMENTS)]
    pub accepted: AcceptArgs,
    #[command(flatten, next_help_heading = heading::FRAMES)]
    pub gauge: GaugeArgs,
    #[command(flatten)]
    pub fit: FitArgs,
    /// Prior for a touch file: the --json files of touch calibrations of other arms of the same type. The
    /// gain is small.
    #[arg(long, value_name = "JSON", value_delimiter = ',', help_heading = heading::MODEL)]
    pub prior: Vec<PathBuf>,
    /// Upper limit on the instructions of one command on a Cortex-M4F, frames included; inducing points and lengthscales
    /// of the elastic model are chosen to fit.
    #[arg(long, value_name = "N", help_heading = heading::DEVICE)]
    pub max_instructions: Option<u64>,
    /// Upper limit on the size of the blob in bytes; the number of inducing points is reduced to fit.
    #[arg(long, value_name = "BYTES", help_heading = heading::DEVICE)]
    pub max_blob_bytes: Option<usize>,
    /// Upper limit on the displacement of the target by the correction (default: twice the largest in training).
    #[arg(long, value_name = "MM", help_heading = heading::DEVICE)]
    pub max_correction_mm: Option<f64>,
    /// Upper limit on the rotation of the target by the correction (default: twice the largest in training).
    #[arg(long, value_name = "MRAD", help_heading = heading::DEVICE)]
    pub max_correction_mrad: Option<f64>,
    #[command(flatten, next_help_heading = heading::TOLERANCE)]
    pub tolerance: ToleranceArgs,
    /// Serial number of the robot, kept in the blob.
    #[arg(long, help_heading = heading::RECORDS)]
    pub serial_number: Option<String>,
    /// Day of the calibration, kept in the blob (default: SOURCE_DATE_EPOCH, otherwise today).
    #[arg(long, value_name = "YYYY-MM-DD", value_parser = date, help_heading = heading::RECORDS)]
    pub date: Option<String>,
    /// Project file to write: `trainer calibrate FILE` repeats this calibration.
    #[arg(long, value_name = "FILE", help_heading = heading::RECORDS)]
    pub write_project: Option<PathBuf>,
    /// Write DH rows and joint zeros with standard deviations as CSV; with --report or --test also signed
    /// held-out errors.
    #[arg(long, value_name = "FILE", help_heading = heading::RECORDS)]
    pub controller_csv: Option<PathBuf>,
}

/// Parses a date of the calendar, YYYY-MM-DD.
pub fn date(text: &str) -> Result<String, String> {
    let numbers: Option<Vec<u16>> = text
        .split('-')
        .map(|part| part.parse::<u16>().ok())
        .collect();
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
