//! Descriptions of a device: lines for people, and JSON for other programs.

use poegp_protocol::link::{
    CycleSettings, Identity, Key, ModelIdentity, StartReason, Statistics, StoredModel,
};
use serde_json::{Value, json};

use crate::cli::terminal::print::Printer;
use crate::signing::id_text;

/// Describes a model in one line.
pub fn model(model: &ModelIdentity) -> String {
    let serial = match model.serial_number.as_str() {
        "" => String::new(),
        number => format!(" ({number})"),
    };
    let warnings: Vec<&str> = model.warnings.iter().map(|c| c.name()).collect();
    let warnings = if warnings.is_empty() {
        String::new()
    } else {
        format!("; warnings: {}", warnings.join(", "))
    };
    let revision = match model.revision {
        Some(revision) => format!(", signed as revision {revision}"),
        None => String::new(),
    };
    format!(
        "{:08x}, {}{serial}: {} joints, {} inducing points, at most {} instructions{revision}{warnings}",
        model.blob_crc, model.robot, model.joints, model.inducing_points, model.instructions
    )
}

/// Describes the active model in one line.
pub fn active(identity: &Identity) -> String {
    identity
        .model
        .as_ref()
        .map_or_else(|| "no model: commands are not corrected".to_owned(), model)
}

/// Describes the settings of the cycle in one line.
pub fn cycle(settings: &CycleSettings) -> String {
    format!(
        "a command every {} us, of at most {} instructions; corrections change with at most {} rad/s and {} rad/s2, \
         and switch on or off in {} s",
        settings.period_us,
        settings.max_instructions,
        settings.rate,
        settings.acceleration,
        settings.blend_s
    )
}

pub fn cycle_json(settings: &CycleSettings) -> Value {
    // Going through text keeps the digits of the f32 and adds none.
    let number = |value: f32| value.to_string().parse::<f64>().unwrap_or(f64::NAN);
    json!({
        "period_us": settings.period_us,
        "rate_rad_per_s": number(settings.rate),
        "acceleration_rad_per_s2": number(settings.acceleration),
        "blend_s": number(settings.blend_s),
        "max_instructions": settings.max_instructions,
    })
}

pub fn model_json(model: &ModelIdentity) -> Value {
    json!({
        "robot": model.robot.as_str(),
        "serial_number": model.serial_number.as_str(),
        "crc": format!("{:08x}", model.blob_crc),
        "joints": model.joints,
        "inducing_points": model.inducing_points,
        "instructions": model.instructions,
        "revision": model.revision,
        "warnings": model.warnings.iter().map(|c| c.name()).collect::<Vec<_>>(),
    })
}

/// Returns the model in a slot as JSON.
pub fn stored_json(stored: &StoredModel) -> Value {
    json!({
        "slot": stored.slot,
        "runs_after_start": stored.first,
        "bytes": stored.length,
        "file_crc": format!("{:08x}", stored.crc),
    })
}

/// Describes why a device started, as a continuation of "started".
pub fn start(reason: StartReason) -> String {
    match reason {
        StartReason::PowerOn => "when the power came on".to_owned(),
        StartReason::Requested => "because a restart was requested".to_owned(),
        StartReason::Cycles => {
            "by the watchdog: expected cyclic requests did not come or were not answered".to_owned()
        }
        StartReason::Background => {
            "by the watchdog: the background of the firmware hung; please report this".to_owned()
        }
        StartReason::Panic { line } => format!(
            "after a panic of the firmware in line {line} of a source file; please report this"
        ),
        StartReason::Fault { address } => {
            format!("after a fault of the processor at address {address:08x}; please report this")
        }
        StartReason::Unexplained => {
            "by the watchdog because the whole firmware hung, or by the reset line".to_owned()
        }
    }
}

fn start_json(reason: StartReason) -> Value {
    match reason {
        StartReason::PowerOn => json!({ "reason": "power-on" }),
        StartReason::Requested => json!({ "reason": "requested" }),
        StartReason::Cycles => json!({ "reason": "cycles" }),
        StartReason::Background => json!({ "reason": "background" }),
        StartReason::Panic { line } => json!({ "reason": "panic", "line": line }),
        StartReason::Fault { address } => {
            json!({ "reason": "fault", "address": format!("{address:08x}") })
        }
        StartReason::Unexplained => json!({ "reason": "unexplained" }),
    }
}

pub fn identity_json(identity: &Identity) -> Value {
    json!({
        "board": identity.board.as_str(),
        "firmware_version": identity.firmware_version.as_str(),
        "protocol_version": identity.protocol_version,
        "image_crc": format!("{:08x}", identity.image_crc),
        "capacity_bytes": identity.capacity_bytes,
        "capacity_words": identity.capacity_words,
        "tick_hz": identity.tick_hz,
        "deadline_ticks": identity.deadline_ticks,
        "key": match &identity.key {
            Key::None => serde_json::Value::Null,
            Key::Provisioned(key) => id_text(key).into(),
            Key::Unusable => "unusable".into(),
        },
        "bypass": identity.bypass,
        "cycle": cycle_json(&identity.cycle),
        "model": identity.model.as_ref().map(model_json),
        "pending": identity.pending,
        "slots": identity.slots.iter().map(|slot| slot.as_ref().map(stored_json)).collect::<Vec<_>>(),
        "slot_writes": identity.slot_writes,
        "start": start_json(identity.start),
    })
}

/// Converts ticks of a clock with `tick_hz` to milliseconds.
pub fn milliseconds(ticks: u32, tick_hz: u32) -> f64 {
    1e3 * f64::from(ticks) / f64::from(tick_hz)
}

/// Prints the identity of a device.
pub fn identity(report: Printer, identity: &Identity) {
    report.line(format_args!(
        "{}: firmware {} (image {:08x}), link protocol {}",
        identity.board, identity.firmware_version, identity.image_crc, identity.protocol_version
    ));
    report.line(format_args!("  started   {}", start(identity.start)));
    report.line(format_args!("  runs      {}", active(identity)));
    if identity.pending {
        report.line("            as soon as the correction by the previous model is withdrawn");
    }
    let bypass = if identity.bypass {
        "on: commands come back unchanged"
    } else {
        "off"
    };
    report.line(format_args!("  bypass    {bypass}"));
    report.line(format_args!("  cycle     {}", cycle(&identity.cycle)));
    for (number, slot) in identity.slots.iter().enumerate() {
        let text = slot.as_ref().map_or("empty".to_owned(), |stored| {
            let first = if stored.first {
                ", runs after the next start"
            } else {
                ""
            };
            format!(
                "{} bytes, file CRC {:08x}{first}",
                stored.length, stored.crc
            )
        });
        report.line(format_args!("  slot {number}    {text}"));
    }
    report.line(format_args!(
        "  wear      slots written {} times",
        identity.slot_writes
    ));
    let key = match &identity.key {
        Key::None => "none: every intact model is accepted".to_owned(),
        Key::Provisioned(key) => format!("{}: only models signed by it are accepted", id_text(key)),
        Key::Unusable => {
            "damaged or half written: no model is accepted; provision it again".to_owned()
        }
    };
    report.line(format_args!("  key       {key}"));
    report.line(format_args!(
        "  room      a model of {} bytes, {} of them inducing points",
        identity.capacity_bytes,
        4 * u64::from(identity.capacity_words)
    ));
    report.line(format_args!(
        "  deadline  {:.2} ms",
        milliseconds(identity.deadline_ticks, identity.tick_hz)
    ));
}

/// Returns the counters in order, each with its JSON name, its value and its meaning.
pub fn counters(s: &Statistics) -> [(&'static str, u32, &'static str); 20] {
    [
        ("cycles", s.cycles, "cyclic requests answered"),
        (
            "flagged",
            s.flagged,
            "of these with a status that is not ok",
        ),
        (
            "limited",
            s.limited,
            "of these with a correction scaled back to its bound",
        ),
        ("uncorrected", s.uncorrected, "commands answered unchanged"),
        (
            "missed_deadlines",
            s.missed_deadlines,
            "answers ready after the deadline",
        ),
        ("max_ticks", s.max_ticks, "most ticks of one computation"),
        (
            "max_latency_ticks",
            s.max_latency_ticks,
            "most ticks from the last byte to the answer",
        ),
        ("jumps", s.jumps, "cyclic commands that jumped"),
        ("gaps", s.gaps, "cyclic commands after a gap"),
        (
            "repeats",
            s.repeats,
            "cyclic commands that were repeated or too early",
        ),
        (
            "bad_commands",
            s.bad_commands,
            "cyclic commands that were invalid",
        ),
        (
            "model_steps",
            s.model_steps,
            "steps of the model that the filter has absorbed",
        ),
        ("frames", s.frames, "frames that arrived whole"),
        (
            "bad_frames",
            s.bad_frames,
            "frames damaged, too long or unreadable",
        ),
        (
            "lost_bytes",
            s.lost_bytes,
            "bytes lost because they were not read in time",
        ),
        ("refused", s.refused, "requests refused"),
        ("activations", s.activations, "models that became active"),
        ("restarts", s.restarts, "starts without a power failure"),
        ("lost_logs", s.lost_logs, "log messages dropped"),
        ("stack_bytes", s.stack_bytes, "deepest use of the stack"),
    ]
}

pub fn statistics_json(statistics: &Statistics, tick_hz: u32) -> Value {
    let mut out = serde_json::Map::new();
    for (name, value, _) in counters(statistics) {
        out.insert(name.to_owned(), value.into());
    }
    out.insert("tick_hz".to_owned(), tick_hz.into());
    out.into()
}

/// Prints the counters of a device.
pub fn statistics(report: Printer, statistics: &Statistics, tick_hz: u32) {
    for (name, value, meaning) in counters(statistics) {
        let time = if name.ends_with("_ticks") {
            format!(" ({:.3} ms)", milliseconds(value, tick_hz))
        } else {
            String::new()
        };
        report.line(format_args!("  {value:>10}  {meaning}{time}"));
    }
}
