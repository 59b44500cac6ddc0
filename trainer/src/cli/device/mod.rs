//! `trainer device`: one file for each command that is more than a question and its answer.

pub mod arguments;
pub mod cyclic;
mod emulate;
pub mod flash;
mod monitor;
pub mod show;

use poegp_protocol::link::{CycleSettings, Identity};
use serde_json::json;

use crate::cli::device::arguments::{
    Bypass, Cycle, Device, DeviceCommand, Info, Link, Provision, Restart, Rollback, Switch,
};
use crate::cli::report::Report;
use crate::cli::{Failure, check_outputs, json_text, write_facts, write_outputs};
use crate::device::client::Client;
use crate::signing::{PublicKey, id_text};

pub fn run(a: &Device) -> Result<(), Failure> {
    match &a.command {
        DeviceCommand::Info(a) => info(a),
        DeviceCommand::Flash(a) => flash::run(a),
        DeviceCommand::Evaluate(a) => cyclic::evaluate(a),
        DeviceCommand::Correct(a) => cyclic::correct(a),
        DeviceCommand::Bypass(a) => bypass(a),
        DeviceCommand::Rollback(a) => roll_back(a),
        DeviceCommand::Statistics(a) => statistics(a),
        DeviceCommand::Monitor(a) => monitor::run(a),
        DeviceCommand::Restart(a) => restart(a),
        DeviceCommand::Provision(a) => provision(a),
        DeviceCommand::Cycle(a) => cycle(a),
        DeviceCommand::Emulate(a) => emulate::run(a),
    }
}

/// Opens the port and asks who is there.
fn connect(link: &Link) -> Result<(Client, Identity), Failure> {
    let mut client = Client::open(&link.address(), link.options())?;
    let identity = client.identify()?;
    Ok((client, identity))
}

fn info(a: &Info) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    let (client, identity) = connect(&a.link)?;
    if let Some(path) = &a.json {
        let mut document = show::identity_json(&identity);
        document["version"] = env!("CARGO_PKG_VERSION").into();
        document["port"] = client.port().into();
        write_outputs(&[(path, json_text(&document)?.as_bytes())])?;
    }
    show::identity(Report::beside(&[a.json.as_deref()]), &identity);
    Ok(())
}

fn bypass(a: &Bypass) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    let (mut client, _) = connect(&a.link)?;
    let identity = client.set_bypass(a.switch == Switch::On)?;
    write_facts(a.json.as_deref(), show::identity_json(&identity))?;
    Report::beside(&[a.json.as_deref()]).line(if identity.bypass {
        "The bypass is on: commands come back as they are.".to_owned()
    } else {
        format!("The bypass is off. Running: {}.", show::active(&identity))
    });
    Ok(())
}

fn roll_back(a: &Rollback) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    let (mut client, before) = connect(&a.link)?;
    let Some(left) = before.model else {
        return Err(Failure::Usage(
            "the device runs no model, so there is none to leave\nhelp: bring one onto it with `trainer device flash`"
                .to_owned(),
        ));
    };
    let after = client.roll_back(left.blob_crc)?;
    write_facts(a.json.as_deref(), show::identity_json(&after))?;
    let report = Report::beside(&[a.json.as_deref()]);
    report.line(format_args!("Left    {}", show::model(&left)));
    report.line(format_args!(
        "Runs    {}, also after a restart",
        show::active(&after)
    ));
    Ok(())
}

fn statistics(a: &arguments::Statistics) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    let (mut client, identity) = connect(&a.link)?;
    let statistics = client.statistics()?;
    if let Some(path) = &a.json {
        let document = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "statistics": show::statistics_json(&statistics, identity.tick_hz),
        });
        write_outputs(&[(path, json_text(&document)?.as_bytes())])?;
    }
    let report = Report::beside(&[a.json.as_deref()]);
    show::statistics(report, &statistics, identity.tick_hz);
    Ok(())
}

fn restart(a: &Restart) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    let (mut client, _) = connect(&a.link)?;
    let identity = client.restart()?;
    write_facts(a.json.as_deref(), show::identity_json(&identity))?;
    Report::beside(&[a.json.as_deref()]).line(format_args!(
        "Restarted. Running: {}.",
        show::active(&identity)
    ));
    Ok(())
}

fn provision(a: &Provision) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[&a.key])?;
    let key = PublicKey::read(&a.key)?;
    let (mut client, _) = connect(&a.link)?;
    client.provision(key.bytes())?;
    let facts = json!({ "key": id_text(&key.id()), "port": client.port() });
    write_facts(a.json.as_deref(), facts)?;
    Report::beside(&[a.json.as_deref()]).line(format_args!(
        "The device takes only models signed by key {} from now on.",
        id_text(&key.id())
    ));
    Ok(())
}

fn cycle(a: &Cycle) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    let (mut client, mut identity) = connect(&a.link)?;
    let there = identity.cycle;
    let asked = CycleSettings {
        period_us: a.period_us.unwrap_or(there.period_us),
        rate: a.rate.unwrap_or(there.rate),
        acceleration: a.acceleration.unwrap_or(there.acceleration),
        blend_s: a.blend.unwrap_or(there.blend_s),
    };
    let changes =
        a.period_us.is_some() || a.rate.is_some() || a.acceleration.is_some() || a.blend.is_some();
    if changes {
        identity = client.provision_cycle(&asked)?;
    }
    write_facts(a.json.as_deref(), show::cycle_json(&identity.cycle))?;
    let kept = if changes {
        ", also after a restart"
    } else {
        ""
    };
    Report::beside(&[a.json.as_deref()]).line(format_args!(
        "The cycle: {}{kept}.",
        show::cycle(&identity.cycle)
    ));
    Ok(())
}
