//! The arguments of `trainer correct`.

use std::path::PathBuf;

use clap::Args;

/// `trainer correct`.
#[derive(Debug, Args)]
#[command(
    after_help = "Of a robot program only the numbers of targets change. Its controller then brings the real tool where it believed \
    the nominal one to be. What cannot be corrected is left and named, with exit code 1. Tools and frames are those of the \
    program, of files of --with, or of --frames. A record OUT.poegp.json is written beside it.\n\n\
    Of a CSV file with joints only the joint columns change. Five columns are added: position_error_um \
    and rotation_error_urad (what stays by the model), applied (how much of the arm's error is corrected, 0 to 1), status (ok, \
    or why not), trust (1 within the trained ranges, towards 0 far from them). Each row is corrected on its own, as the device \
    does before its filter: beside a singularity only in part, so that neighbouring rows stay neighbours.\n\n\
    Examples:\n  trainer correct arm.blob program.csv --payload-kg 2.5 --out corrected.csv\n  \
    trainer correct arm.blob weld.mod --payload-from-program --out corrected.mod"
)]
pub struct Correct {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Robot programs that belong together (ABB RAPID .mod, URScript .script, Fanuc .ls, KUKA .src
    /// and .dat, INFORM .jbi, VAL3 .dtx), a table of poses (CSV: x_mm … and qw … or rx_rad …, optionally tool, base,
    /// payload_kg, seed_q1_deg …), or joint targets (CSV: q1_deg …, optionally payload_kg). Other columns are kept.
    #[arg(value_name = "PROGRAM", required = true)]
    pub programs: Vec<PathBuf>,
    /// Payload of all targets in kg, for a file without payload_kg.
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    pub payload_kg: Option<f64>,
    /// Take the payload of each tool from the program.
    #[arg(long, conflicts_with = "payload_kg")]
    pub payload_from_program: bool,
    /// Tools and frames that the program does not define, and pulses per degree of INFORM joints (TOML).
    #[arg(long, value_name = "FILE")]
    pub frames: Option<PathBuf>,
    /// Further files of the program, read for tools and frames and not corrected.
    #[arg(long, value_name = "FILE")]
    pub with: Vec<PathBuf>,
    /// Insert targets on straight lines of a program where the tool would leave the line by more than this,
    /// in mm (RAPID MoveL, KRL LIN, URScript movel).
    #[arg(long, value_name = "TOL_MM", conflicts_with = "inverse")]
    pub split: Option<f64>,
    /// Restore a corrected program to the nominal arm.
    #[arg(long)]
    pub inverse: bool,
    /// Write the corrected targets (`-`: standard output); of several programs, a folder.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Print what the command would do to a program, without writing it.
    #[arg(long)]
    pub dry_run: bool,
    /// Write an HTML report on a program: every target before and after, and the remaining errors.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write the summary as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}
