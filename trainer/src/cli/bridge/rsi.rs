//! `trainer bridge rsi`.

use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::thread;

use clap::{Args, ValueEnum};
use poegp_calibration::blob::commander::Commander;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_protocol::JointKind;
use poegp_runtime::model::MAX_PAYLOAD_KG;
use serde_json::{Value, json};

use crate::bridge::AXES;
use crate::bridge::corrector::{Corrector, Settings};
use crate::bridge::message::Setpoint;
use crate::bridge::rsi::Rsi;
use crate::bridge::server::{Report, serve};
use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, write_summary};
use crate::cli::terminal::interrupt::stoppable;
use crate::cli::terminal::print::{Printer, note, warning};
use crate::robot_programs::correction::engine::NO_PAYLOAD_TERMS;

/// `trainer bridge rsi`.
#[derive(Debug, Args)]
#[command(
    after_help = "The correction begins at zero. Ctrl-C withdraws it smoothly while packets come, and the command \
    ends with exit code 0. A \
    second Ctrl-C ends it at once (130), and the controller keeps the last correction. The correction is held for packets \
    that cannot be used, and withdrawn while more than half of the packets are lost.\n\n\
    The limits of the RSI configuration on the controller stay in force. Start in T1. The guide \"Correct a robot \
    while it moves\" (docs/guide/live-correction.md) has the files that the controller needs.\n\n\
    Example: trainer bridge rsi arm.blob --listen 192.168.1.10:59152 --payload-kg 5"
)]
pub struct RsiArgs {
    /// Model (`.blob`) of an arm with six revolute joints, which are the controller's A1 to A6.
    pub blob: PathBuf,
    /// Address of this computer in the controller's network, and UDP port; port 0 selects a free one.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: SocketAddr,
    /// Payload in kg; needed if the model depends on it.
    #[arg(long, value_name = "KG")]
    pub payload_kg: Option<f64>,
    /// Element of the controller's packets with the axis values to correct.
    #[arg(long, value_name = "ELEMENT", default_value = "ASPos")]
    pub setpoint: Element,
    /// Largest correction of an axis in degrees.
    #[arg(long, value_name = "DEG", default_value = "1", value_parser = limit)]
    pub limit_deg: f64,
    /// Largest change of an axis' correction from one answer to the next in degrees.
    #[arg(long, value_name = "DEG", default_value = "0.05", value_parser = ramp)]
    pub ramp_deg_per_cycle: f64,
    /// Withdraw the correction and end after N cycles, as after Ctrl-C.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub cycles: Option<u64>,
    /// Write the statistics as JSON at the end (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// An element of the controller's packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Element {
    /// Axis setpoints, without a correction.
    #[value(name = "ASPos")]
    AsPos,
    /// Actual axis values; the correction of the previous cycle is subtracted.
    #[value(name = "AIPos")]
    AiPos,
}

fn degrees(text: &str, least: f64, most: f64) -> Result<f64, String> {
    match text.parse() {
        Ok(x) if (least..=most).contains(&x) => Ok(x),
        _ => Err(format!("expected degrees, {least} to {most}")),
    }
}

fn limit(text: &str) -> Result<f64, String> {
    degrees(text, 0.01, 5.0)
}

fn ramp(text: &str) -> Result<f64, String> {
    degrees(text, 0.0001, 0.5)
}

pub fn run(a: &RsiArgs) -> Result<(), Failure> {
    let outputs = [(a.json.as_deref(), Kind::Json)];
    let outputs = check_outputs(&outputs, &[&a.blob])?;
    let loaded = BlobModel::read(&a.blob)?;
    check_axes(&a.blob, &loaded)?;
    let payload_kg = payload(a, &loaded)?;
    let expected = "a model blob written by `trainer calibrate`";
    let commander = Commander::new(&loaded)
        .map_err(|error| InputError::new(&a.blob, error.to_string(), expected))?;
    let setpoint = match a.setpoint {
        Element::AsPos => Setpoint::Commanded,
        Element::AiPos => Setpoint::Actual,
    };
    let settings = Settings {
        payload_kg,
        setpoint,
        limit_deg: a.limit_deg,
        ramp_deg: a.ramp_deg_per_cycle,
    };
    let mut rsi = Rsi::new(Corrector::new(commander, settings), setpoint);
    let cannot = |error: std::io::Error| {
        Failure::Usage(format!(
            "cannot listen on {}: {error}\nhelp: give an address of this computer and a free UDP port",
            a.listen
        ))
    };
    let socket = UdpSocket::bind(a.listen).map_err(cannot)?;
    let address = socket.local_addr().map_err(cannot)?;
    let printer = Printer::for_outputs(&outputs);
    let (sender, reports) = sync_channel::<Report>(1);
    let printing = thread::spawn(move || {
        for report in reports {
            printer.line(line(&report));
        }
    });
    let served = stoppable(|stop| {
        introduce(printer, a, &loaded, payload_kg, address);
        serve(&socket, &mut rsi, a.cycles, stop, &sender)
    });
    drop(sender);
    // The printing thread ends when the sender is dropped.
    let _ = printing.join();
    let report = served.map_err(|error| Failure::Usage(format!("{address}: {error}")))?;
    summarize(printer, &report);
    let document = document(&loaded, &settings, address, &report);
    write_summary(a.json.as_deref(), document)
}

/// Refuses robots other than arms with six revolute joints: RSI reports and corrects A1 to A6.
fn check_axes(path: &Path, loaded: &BlobModel) -> Result<(), Failure> {
    let joints = &loaded.blob().robot.joints;
    let sliding = (joints.iter())
        .filter(|joint| joint.kind == JointKind::Prismatic)
        .count();
    if joints.len() == AXES && sliding == 0 {
        return Ok(());
    }
    let found = match sliding {
        0 => format!("an arm with {} joints", joints.len()),
        _ => format!(
            "an arm with {} joints, of which {sliding} are prismatic",
            joints.len()
        ),
    };
    let expected = "six revolute joints: RSI corrects the axes A1 to A6";
    Err(InputError::new(path, found, expected).into())
}

fn payload(a: &RsiArgs, loaded: &BlobModel) -> Result<f64, Failure> {
    match (a.payload_kg, loaded.blob().ranges.payload_kg) {
        (Some(kg), _) if !(0.0..=f64::from(MAX_PAYLOAD_KG)).contains(&kg) => Err(Failure::Usage(
            format!("--payload-kg {kg}: expected kilograms, 0 to {MAX_PAYLOAD_KG}"),
        )),
        (None, Some((light, heavy))) => Err(InputError::new(
            &a.blob,
            format!("a model that depends on the payload ({light} to {heavy} kg were trained)"),
            "--payload-kg KG, the payload that the arm carries",
        )
        .into()),
        (given, _) => Ok(given.unwrap_or(0.0)),
    }
}

fn introduce(
    printer: Printer,
    a: &RsiArgs,
    loaded: &BlobModel,
    payload_kg: f64,
    address: SocketAddr,
) {
    if let (Some(_), None) = (a.payload_kg, loaded.blob().ranges.payload_kg) {
        note(format_args!(
            "--payload-kg changes nothing: {NO_PAYLOAD_TERMS}"
        ));
    }
    if let Some((light, heavy)) = loaded.blob().ranges.payload_kg
        && !(f64::from(light)..=f64::from(heavy)).contains(&payload_kg)
    {
        warning(format_args!(
            "{payload_kg} kg is outside the trained payloads, {light} to {heavy} kg: the correction is extrapolated"
        ));
    }
    let robot = &loaded.blob().robot;
    let serial = match robot.serial_number {
        "" => String::new(),
        number => format!(", serial number {number}"),
    };
    let method = loaded.host().provenance.method;
    printer.line(format_args!("robot     {}{serial}", robot.name));
    printer.line(format_args!(
        "model     {}, {method}, payload {payload_kg} kg",
        a.blob.display()
    ));
    printer.line(format_args!(
        "axes      A1 to A6 are the joints 1 to 6 of the model, {} in degrees",
        match a.setpoint {
            Element::AsPos => "ASPos",
            Element::AiPos => "AIPos",
        }
    ));
    printer.line(format_args!(
        "limits    {}° for each axis, {}° in one cycle",
        a.limit_deg, a.ramp_deg_per_cycle
    ));
    printer.line(format_args!("listens   {address}, until Ctrl-C"));
}

/// Formats the status line that is printed while the bridge runs.
fn line(report: &Report) -> String {
    let counts = &report.counts;
    let cpu = report.cpu_us.map_or(String::new(), |cpu| {
        format!(", CPU {:.1} us (p99 {:.1} us)", cpu.p50, cpu.p99)
    });
    format!(
        "{} cycles, {} lost, {} late, {} duplicates, {} garbage, {} refused; correction {:.4}°{cpu}",
        counts.cycles,
        counts.lost,
        counts.late,
        counts.duplicates,
        counts.garbage,
        counts.refused,
        report.applied_deg
    )
}

fn summarize(printer: Printer, report: &Report) {
    let counts = &report.counts;
    let rows = [
        ("datagrams", counts.received, ""),
        ("cycles answered", counts.cycles, ""),
        ("sessions", counts.sessions, ""),
        (
            "duplicates",
            counts.duplicates,
            "repeats; the newest packet is answered again",
        ),
        (
            "late",
            counts.late,
            "no answer: the controller no longer waits",
        ),
        ("lost", counts.lost, "cycles without a packet"),
        (
            "garbage",
            counts.garbage,
            "no packet of a session: no answer",
        ),
        ("foreign", counts.foreign, "from another address: no answer"),
        (
            "refused",
            counts.refused,
            "axes missing or no numbers: correction held",
        ),
        ("limited", counts.limited, "an axis at --limit-deg"),
        ("slowed", counts.slowed, "an axis at --ramp-deg-per-cycle"),
        ("outside", counts.outside, "outside the trained ranges"),
        (
            "in part",
            counts.partly,
            "near a singularity, or at a bound of the model",
        ),
        (
            "withdrawn",
            counts.withdrawn,
            "more than half of the packets lost",
        ),
    ];
    let rows: Vec<Vec<String>> = rows
        .iter()
        .filter(|(name, count, _)| *count > 0 || *name == "cycles answered")
        .map(|(name, count, what)| vec![(*name).to_owned(), count.to_string(), (*what).to_owned()])
        .collect();
    printer.table(&["packets and cycles", "number", ""], &rows);
    if let Some(ms) = report.cycle_ms {
        printer.line(format_args!("The controller's cycle is {ms} ms."));
    }
    printer.line(format_args!(
        "The largest correction of an axis was {:.4}°.",
        counts.largest_deg
    ));
    if let Some(cpu) = report.cpu_us {
        printer.line(format_args!(
            "A cycle took {:.1} us of CPU time on average, {:.1} us in the median, {:.1} us at the 99th percentile.",
            cpu.mean, cpu.p50, cpu.p99
        ));
    }
    if report.applied_deg > 0.0 {
        note(format_args!(
            "packets with axes ended before the correction was withdrawn: the last answer had {:.4}°",
            report.applied_deg
        ));
    }
}

fn document(
    loaded: &BlobModel,
    settings: &Settings,
    address: SocketAddr,
    report: &Report,
) -> Value {
    let robot = &loaded.blob().robot;
    let counts = &report.counts;
    let mut document = json!({
        "robot": robot.name,
        "serial_number": robot.serial_number,
        "method": loaded.host().provenance.method,
        "address": address.to_string(),
        "setpoint": settings.setpoint.element(),
        "payload_kg": settings.payload_kg,
        "limit_deg": settings.limit_deg,
        "ramp_deg": settings.ramp_deg,
        "cycle_ms": report.cycle_ms,
        "received": counts.received,
        "cycles": counts.cycles,
        "sessions": counts.sessions,
        "duplicates": counts.duplicates,
        "late": counts.late,
        "lost": counts.lost,
        "garbage": counts.garbage,
        "foreign": counts.foreign,
        "refused": counts.refused,
        "limited": counts.limited,
        "slowed": counts.slowed,
        "outside": counts.outside,
        "partly_corrected": counts.partly,
        "withdrawn": counts.withdrawn,
        "largest_deg": counts.largest_deg,
        "applied_deg": report.applied_deg,
    });
    if let Some(cpu) = report.cpu_us {
        document["cpu_us"] = json!({"mean": cpu.mean, "p50": cpu.p50, "p99": cpu.p99});
    }
    document
}
