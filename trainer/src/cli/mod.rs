//! The command line: one file or folder for each command, with its arguments.
//!
//! Exit codes: 0 done, 1 a quality bound was not met, a signature does not match or an output could not be written, 2 usage,
//! input or device error, 3 data refused, 130 stopped by Ctrl-C. Errors are printed once, here.

mod args;
mod bridge;
mod calibrate;
mod check;
mod compare;
mod completions;
mod correct;
mod demo;
mod device;
pub mod embedded;
mod evaluate;
mod examination;
mod export;
mod failure;
mod import;
mod input;
mod inputs;
mod inspect;
mod instrument_drift;
mod keys;
mod measure;
mod output;
mod plan;
mod signed_document;
mod simulate;
mod terminal;
mod tolerance;
mod touches;

use std::ffi::OsString;
use std::io::Write;
use std::num::NonZeroUsize;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::cli::args::heading;
use crate::cli::bridge::Bridge;
use crate::cli::calibrate::args::Calibrate;
use crate::cli::check::Check;
use crate::cli::compare::Compare;
use crate::cli::completions::{Completions, EXIT_CODES, Manual};
use crate::cli::correct::Correct;
use crate::cli::demo::Demo;
use crate::cli::device::args::Device;
use crate::cli::evaluate::Evaluate;
use crate::cli::export::Export;
use crate::cli::failure::Failure;
use crate::cli::import::Import;
use crate::cli::inspect::Inspect;
use crate::cli::keys::{Keys, Sign, Verify};
use crate::cli::measure::Measure;
use crate::cli::plan::Plan;
use crate::cli::simulate::Simulate;
use crate::cli::touches::are_touches;

/// Calibrate a robot from tracker measurements, and write the model that the controller evaluates.
#[derive(Debug, Parser)]
#[command(name = "trainer", version, max_term_width = 100)]
#[command(after_help = "Examples:\n  \
    trainer demo\n  \
    trainer calibrate --robot abb-irb120 train.csv --out arm.blob --report report.html\n  \
    trainer calibrate project.toml\n  \
    trainer COMMAND --help   (each command has its own examples)\n\n\
    NO_COLOR and TERM=dumb are respected. SOURCE_DATE_EPOCH sets the date in a blob and in manual pages.")]
pub struct Arguments {
    /// Print errors and warnings only. Output files and `--json -` are still written.
    #[arg(long, short, global = true, help_heading = heading::GENERAL)]
    pub quiet: bool,
    /// Compute on at most N threads (default: one for each core). No result depends on it.
    #[arg(long, global = true, value_name = "N", help_heading = heading::GENERAL)]
    pub threads: Option<NonZeroUsize>,
    /// Command.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Choose the poses to measure; write them as CSV and as robot programs.
    Plan(Plan),
    /// Measure row by row: ask for the most useful row next, store each row, stop when the error is small
    /// enough.
    Measure(Measure),
    /// Simulate a robot with payloads, measured by a laser tracker.
    Simulate(Simulate),
    /// Calibrate a robot and write the model (`.blob`).
    Calibrate(Box<Calibrate>),
    /// Evaluate a blob on measurements that it was not trained on.
    Evaluate(Evaluate),
    /// Compare calibration methods by cross-validation or on test sets.
    Compare(Compare),
    /// Check from a few new measurements whether a calibration still holds (exit code 0) or not (1).
    Check(Check),
    /// Correct robot programs, or a file of joint targets as the device does.
    Correct(Correct),
    /// Correct a robot while it runs its program, over the network.
    Bridge(Bridge),
    /// Show the contents of a blob.
    Inspect(Inspect),
    /// Write the calibrated robot for other programs: URDF, UR driver, tables, C header.
    Export(Export),
    /// Convert measurement files from other software.
    Import(Import),
    /// Make keys that sign models.
    Keys(Keys),
    /// Sign a blob, a report or its JSON.
    Sign(Sign),
    /// Verify the signature of a blob, as the device does, or of a report: exit code 0 if this key signed it, 1 if not.
    Verify(Verify),
    /// Reproduce the paper's simulation: simulate, calibrate, compare, write a blob, read it back.
    Demo(Demo),
    /// Use a co-processor: upload a model, check it, monitor it, emulate it.
    Device(Device),
    /// Print a script that completes commands and options in a shell.
    Completions(Completions),
    /// Write the manual pages, one for each command.
    Manual(Manual),
}

/// Runs the program and returns its exit code.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    terminal::interrupt::install();
    let arguments = match parse(&arguments.into_iter().collect::<Vec<_>>()) {
        Ok(arguments) => arguments,
        Err(error) if error.use_stderr() => {
            let _ = error.print();
            return ExitCode::from(2);
        }
        Err(help) => {
            let printed = help.print().and_then(|()| std::io::stdout().flush());
            return ended(printed.map_err(terminal::print::lost_stdout));
        }
    };
    if arguments.quiet {
        terminal::print::be_quiet();
    }
    let _limit = (arguments.threads).map(poegp_calibration::progress::limit_threads);
    if let Err(failure) = inputs::source_date() {
        return ended(Err(failure));
    }
    let result = match arguments.command {
        Command::Plan(a) => plan::run(&a),
        Command::Measure(a) => measure::run(&a),
        Command::Simulate(a) => simulate::run(&a),
        Command::Calibrate(a) => calibrate::run(&a),
        Command::Evaluate(a) if are_touches(&a.test, a.features.as_deref()) => {
            touches::evaluate::run(&a)
        }
        Command::Evaluate(a) => evaluate::run(&a),
        Command::Compare(a) if are_touches(&a.train, a.features.as_deref()) => {
            touches::compare::run(&a)
        }
        Command::Compare(a) => compare::run(&a),
        Command::Correct(a) => correct::run(&a),
        Command::Bridge(a) => bridge::run(&a),
        Command::Check(a) if are_touches(&a.measurements, a.features.as_deref()) => {
            check::touches::run(&a)
        }
        Command::Check(a) => check::run(&a),
        Command::Inspect(a) => inspect::run(&a),
        Command::Export(a) => export::run(&a),
        Command::Import(a) => import::run(&a),
        Command::Keys(a) => keys::keys(&a),
        Command::Sign(a) if signed_document::is_document(&a.file) => signed_document::sign(&a),
        Command::Sign(a) => keys::sign(&a),
        Command::Verify(a) if signed_document::is_document(&a.file) => signed_document::verify(&a),
        Command::Verify(a) => keys::verify(&a),
        Command::Demo(a) => demo::run(&a),
        Command::Device(a) => device::run(&a),
        Command::Completions(a) => completions::completions(&a, command()),
        Command::Manual(a) => completions::manual(&a, command()),
    };
    ended(result.and_then(|()| terminal::print::finish()))
}

/// Prints the failure of a command, if there is one, and returns the exit code.
fn ended(result: Result<(), Failure>) -> ExitCode {
    let Err(failure) = result else {
        return ExitCode::SUCCESS;
    };
    let text = match &failure {
        Failure::Input(error) => format!("error: {}", terminal::snippet::render(error)),
        Failure::Cancelled(_) => format!("\n{failure}"),
        _ => format!("error: {failure}"),
    };
    let _ = writeln!(std::io::stderr(), "{text}");
    failure.exit_code()
}

/// Creates the command line with its help texts.
fn command() -> clap::Command {
    // An option refuses `-1` by itself, with the values that it expects: it is no unknown option.
    fn with_negative_numbers(arg: clap::Arg) -> clap::Arg {
        match arg.get_action().takes_values() {
            true => arg.allow_negative_numbers(true),
            false => arg,
        }
    }
    fn with_exit_codes(command: clap::Command) -> clap::Command {
        let help = match command.get_after_help() {
            Some(help) => format!("{help}\n\n{EXIT_CODES}"),
            None => EXIT_CODES.to_owned(),
        };
        command
            .after_help(help)
            .mut_args(with_negative_numbers)
            .mut_subcommands(with_exit_codes)
    }
    with_exit_codes(Arguments::command())
}

/// Returns the text of `docs/reference/commands.md`.
pub fn command_reference() -> String {
    completions::command_reference(command())
}

/// Parses a command line.
fn parse(arguments: &[OsString]) -> Result<Arguments, clap::Error> {
    Arguments::from_arg_matches(&command().try_get_matches_from(arguments)?)
}
