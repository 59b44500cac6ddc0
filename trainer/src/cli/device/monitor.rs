//! `trainer device monitor`.

use std::io;
use std::path::Path;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::{Duration, Instant};

use poegp_protocol::link::{Identity, Statistics};
use serde_json::{Value, json};

use crate::cli::device::args::Monitor;
use crate::cli::device::show;
use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, write_summary};
use crate::cli::terminal::print::{Printer, is_quiet, is_stdout, to_stdout};
use crate::device::client::Client;
use crate::device::defmt_log::Decoder;
use crate::device::port;
use crate::device::port::Address;

/// Time between two reads of the statistics.
const INTERVAL: Duration = Duration::from_secs(1);
/// Number of lines between two headers.
const PAGE: usize = 20;
/// Timeout of reads from the log, which is silent most of the time.
const LOG_READ_LIMIT: Duration = Duration::from_secs(1);
const HEADER: &str = "     cycles       /s   missed  flagged  limited  uncorrected  worst ms  latency ms  bad frames  lost bytes";

pub fn run(a: &Monitor) -> Result<(), Failure> {
    check_outputs(
        &[(a.json.as_deref(), Kind::Json)],
        a.elf.as_deref().as_slice(),
    )?;
    let as_json = a.json.as_deref();
    if !a.once && as_json.is_some_and(|path| !is_stdout(path)) {
        return Err(Failure::Usage(
            "--json to a file: expected `-`, which a shell can redirect, or --once\nhelp: a file is written whole at the end, but \
             monitoring has no end"
                .to_owned(),
        ));
    }
    let (sender, log) = mpsc::channel();
    if let (Some(port), Some(elf)) = (&a.log, &a.elf) {
        follow_log(port, elf, sender.clone())?;
    }
    let (mut client, identity) = a.link.connect()?;
    if a.once {
        let statistics = client.statistics()?;
        write_summary(as_json, summary(&identity, &statistics))?;
        let report = Printer::for_outputs(&[as_json]);
        show::identity(report, &identity);
        report.line("");
        show::statistics(report, &statistics, identity.tick_hz);
        return Ok(());
    }
    // The sender is kept, so that the channel stays open after the log ends.
    let _sender = sender;
    watch(&mut client, identity, &log, as_json.is_some())
}

/// Creates the JSON document of identity and statistics.
fn summary(identity: &Identity, statistics: &Statistics) -> Value {
    json!({
        "model": identity.model.as_ref().map(show::model_json),
        "statistics": show::statistics_json(statistics, identity.tick_hz),
    })
}

/// Reads the log in a separate thread, which sends the decoded lines to `lines`.
fn follow_log(address: &Address, elf: &Path, lines: Sender<String>) -> Result<(), Failure> {
    let usage = |text: String| Failure::Usage(text);
    let mut decoder =
        Decoder::new(elf).map_err(|error| usage(format!("--elf {}: {error}", elf.display())))?;
    let mut stream = port::open(address).map_err(|error| {
        usage(format!(
            "{address} does not open: {error}\nhelp: {}",
            port::device_advice(address, &error)
        ))
    })?;
    let limited = stream.limit_reads(LOG_READ_LIMIT);
    limited.map_err(|error| usage(format!("{address}: {error}")))?;
    thread::spawn(move || {
        let mut buffer = [0; 256];
        // The first frame may be incomplete, because it began before this program.
        let mut is_first = true;
        loop {
            let line = |text: String| lines.send(text).is_ok();
            match stream.read(&mut buffer) {
                Ok(0) => break,
                Ok(length) => {
                    for decoded in decoder.push(&buffer[..length]) {
                        let goes_on = match decoded {
                            Ok(text) => line(text),
                            Err(_) if is_first => true,
                            Err(error) => line(format!("{error} (is --elf the image that runs?)")),
                        };
                        is_first = false;
                        if !goes_on {
                            return;
                        }
                    }
                }
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::WouldBlock
                            | io::ErrorKind::TimedOut
                            | io::ErrorKind::Interrupted
                    ) => {}
                Err(error) => {
                    line(format!("the log ended: {error}"));
                    return;
                }
            }
        }
        let _ = lines.send("the log ended".to_owned());
    });
    Ok(())
}

/// Prints until Ctrl-C, or until standard output cannot be written.
fn watch(
    client: &mut Client,
    mut identity: Identity,
    log: &Receiver<String>,
    as_json: bool,
) -> Result<(), Failure> {
    let mut before: Option<(Instant, Statistics)> = None;
    if !as_json {
        show::identity(Printer::for_outputs(&[]), &identity);
    }
    for number in 0_usize.. {
        let statistics = client.statistics()?;
        let now = Instant::now();
        // Another client may have changed the model or restarted the device.
        let restarted = before.is_some_and(|(_, s)| s.restarts != statistics.restarts);
        let changed = before.is_some_and(|(_, s)| s.activations != statistics.activations);
        if restarted || changed {
            identity = client.identify()?;
            if restarted && !as_json {
                say(&format!("started {}", show::start(identity.start)))?;
            }
            if !as_json {
                say(&format!("runs {}", show::active(&identity)))?;
            }
        }
        let rate = before.map_or(0.0, |(then, s)| {
            f64::from(statistics.cycles.saturating_sub(s.cycles)) / (now - then).as_secs_f64()
        });
        if !as_json && number % PAGE == 0 {
            say(HEADER)?;
        }
        let text = if as_json {
            let mut summary = summary(&identity, &statistics);
            summary["cycles_per_second"] = before.map(|_| rate).into();
            summary.to_string()
        } else {
            line(&statistics, rate, identity.tick_hz)
        };
        say(&text)?;
        before = Some((now, statistics));
        while let Ok(text) = log.recv_timeout(INTERVAL.saturating_sub(now.elapsed())) {
            let text = if as_json {
                json!({ "log": text }).to_string()
            } else {
                format!("log: {text}")
            };
            say(&text)?;
            // A log that is never silent must not hide the statistics.
            if now.elapsed() >= INTERVAL {
                break;
            }
        }
    }
    Ok(())
}

fn line(s: &Statistics, rate: f64, tick_hz: u32) -> String {
    format!(
        "{:>11} {rate:>8.0} {:>8} {:>8} {:>8} {:>12} {:>9.3} {:>11.3} {:>11} {:>11}",
        s.cycles,
        s.missed_deadlines,
        s.flagged,
        s.limited,
        s.uncorrected,
        show::milliseconds(s.max_ticks, tick_hz),
        show::milliseconds(s.max_latency_ticks, tick_hz),
        s.bad_frames,
        s.lost_bytes
    )
}

/// Prints a line; with `--quiet` only JSON lines.
fn say(text: &str) -> Result<(), Failure> {
    match is_quiet() && !text.starts_with('{') {
        true => Ok(()),
        false => to_stdout(format!("{text}\n").as_bytes()),
    }
}
