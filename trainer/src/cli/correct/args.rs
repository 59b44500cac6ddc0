//! The arguments of `trainer correct`.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::args::heading;
use crate::cli::failure::Failure;
use crate::robot_programs::correction::engine::Direction;

/// `trainer correct`.
#[derive(Debug, Args)]
#[command(
    after_help = "In a robot program, the command changes the numbers of targets and nothing else. The controller \
    then moves the real \
    tool to the poses that the program was written for. Tools and frames come from the program, from the files of --with or \
    from --frames. Targets are corrected completely, also near singularities, unless a joint would move by more than 0.1 rad \
    (or 0.1 m). The command lists each target that it cannot correct, or only in part, and ends with exit code 1. It writes a \
    record, OUT.poegp.json, beside the program.\n\n\
    Correct targets that were computed. Targets, tools and frames that were taught on the arm contain its error already.\n\n\
    In a CSV file of joint targets, it changes the joint columns and adds five: position_error_um and \
    rotation_error_urad (the remaining error, according to the model), applied (the share of the error that is \
    corrected, 0 to 1), status (ok, or the reason) \
    and trust (1 within the trained ranges, falling to 0 far outside). It corrects each row alone, as the device does before \
    its filter. Near a singularity it corrects a row in part, so that the correction changes smoothly from row to row.\n\n\
    Examples:\n  trainer correct arm.blob program.csv --payload-kg 2.5 --out corrected.csv\n  \
    trainer correct arm.blob weld.mod --payload-from-program --out corrected.mod"
)]
pub struct Correct {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Robot programs that belong together (ABB RAPID .mod, URScript .script, Fanuc .ls, KUKA .src
    /// and .dat, INFORM .jbi, VAL3 .dtx), a table of poses (CSV: x_mm … and qw … or rx_rad …, optionally tool, base,
    /// payload_kg, seed_q1_deg … or seed_q1_mm of a slide), or joint targets (CSV: q1_deg …, optionally payload_kg). Other columns are kept.
    #[arg(value_name = "PROGRAM", required = true)]
    pub programs: Vec<PathBuf>,
    /// Payload of all targets in kg, for a file without payload_kg.
    #[arg(long, value_name = "KG")]
    pub payload_kg: Option<f64>,
    /// Write the corrected targets (`-`: standard output); for several programs, a folder.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Write the summary as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Take the payload of each tool from the program.
    #[arg(long, conflicts_with = "payload_kg", help_heading = heading::PROGRAMS)]
    pub payload_from_program: bool,
    /// Tools and frames that the program does not define, and pulses per degree of INFORM joints (TOML).
    #[arg(long, value_name = "FILE", help_heading = heading::PROGRAMS)]
    pub frames: Option<PathBuf>,
    /// Further files of the program, read for tools and frames and not corrected.
    #[arg(long, value_name = "FILE", help_heading = heading::PROGRAMS)]
    pub with: Vec<PathBuf>,
    /// Insert targets on straight lines where the tool would leave the line by more than this, in mm (RAPID MoveL, KRL LIN,
    /// URScript movel).
    #[arg(long, value_name = "TOL_MM", conflicts_with = "inverse", help_heading = heading::PROGRAMS)]
    pub split: Option<f64>,
    /// Restore a corrected program to the nominal arm.
    #[arg(long, conflicts_with = "taught", help_heading = heading::PROGRAMS)]
    pub inverse: bool,
    /// Convert targets that were taught on this arm into the poses that its real tool had there. A taught target is not to
    /// be corrected: it already contains the arm's error.
    #[arg(long, conflicts_with = "split", help_heading = heading::PROGRAMS)]
    pub taught: bool,
    /// Print what the command would do, without writing the program or its record.
    #[arg(long, help_heading = heading::PROGRAMS)]
    pub dry_run: bool,
    /// Write an HTML report: every target before and after, and the remaining errors.
    #[arg(long, value_name = "FILE", help_heading = heading::PROGRAMS)]
    pub report: Option<PathBuf>,
}

impl Correct {
    /// Returns the direction of the conversion, and the participle that describes it.
    pub fn direction(&self) -> (Direction, &'static str) {
        match (self.inverse, self.taught) {
            (true, _) => (Direction::Inverse, "restored"),
            (_, true) => (Direction::Inverse, "converted"),
            _ => (Direction::Correct, "corrected"),
        }
    }
}

/// Returns the error for a table with payloads and --payload-kg.
pub fn two_payloads(table: &Path) -> Failure {
    Failure::Usage(format!(
        "found --payload-kg and the column payload_kg of {}, expected one of them",
        table.display()
    ))
}
