//! The arguments of `trainer compare`.

use std::path::PathBuf;

use clap::Args;

use crate::cli::args::{FitArgs, RobotArgs, heading, method};
use crate::cli::examination::AcceptArgs;
use crate::cli::tolerance::ToleranceArgs;
use poegp_calibration::model::Method;

/// `trainer compare`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  trainer compare --robot abb-irb120 train.csv --test test1.csv --test test2.csv --folds 5\n  \
    trainer compare --robot abb-irb120 touches.csv --blob before.blob --blob after.blob"
)]
pub struct Compare {
    /// Measurements for training and cross-validation; with --blob, touches.
    pub train: PathBuf,
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Methods, separated by commas (default: all that the data allow).
    #[arg(long, value_name = "METHOD", value_delimiter = ',', value_parser = method())]
    pub methods: Vec<Method>,
    /// Models to compare on touches, without training; may be repeated.
    #[arg(long = "blob", value_name = "FILE")]
    pub blobs: Vec<PathBuf>,
    /// Held-out measurements; may be repeated.
    #[arg(long = "test", value_name = "FILE")]
    pub tests: Vec<PathBuf>,
    /// Number of folds of the cross-validation; 0 for none (default: 10).
    #[arg(long, value_name = "N")]
    pub folds: Option<usize>,
    /// Seed of the division into folds (default: 1).
    #[arg(long, value_name = "SEED")]
    pub seed: Option<u64>,
    /// Write an HTML report with errors and plots of the test sets, otherwise of the folds, or of the
    /// touches.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write the result as JSON (`-`: standard output).
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
    #[command(flatten)]
    pub fit: FitArgs,
    #[command(flatten, next_help_heading = heading::TOLERANCE)]
    pub tolerance: ToleranceArgs,
}

impl Compare {
    pub fn folds(&self) -> usize {
        self.folds.unwrap_or(10)
    }

    pub fn seed(&self) -> u64 {
        self.seed.unwrap_or(1)
    }
}
