//! `trainer bridge`: live correction.

mod rsi;

use clap::{Args, Subcommand};

use crate::cli::bridge::rsi::RsiArgs;
use crate::cli::failure::Failure;

/// `trainer bridge`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: trainer bridge rsi arm.blob --listen 192.168.1.10:59152 --payload-kg 5"
)]
pub struct Bridge {
    /// Command.
    #[command(subcommand)]
    pub command: BridgeCommand,
}

/// The interfaces.
#[derive(Debug, Subcommand)]
pub enum BridgeCommand {
    /// Correct a KUKA robot live over RSI: answer the axis setpoints of every cycle with a correction.
    Rsi(RsiArgs),
}

pub fn run(a: &Bridge) -> Result<(), Failure> {
    match &a.command {
        BridgeCommand::Rsi(a) => rsi::run(a),
    }
}
