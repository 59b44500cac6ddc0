//! `trainer device`: commands that need more than one request have a file of their own.

pub mod args;
mod emulate;
pub mod flash;
mod monitor;
pub mod show;
pub mod stream;

use poegp_protocol::link::CycleSettings;
use serde_json::json;

use crate::cli::device::args::{
    Bypass, Cycle, Device, DeviceCommand, Info, Provision, Restart, Rollback, Stop, Switch,
};
use crate::cli::failure::Failure;
use crate::signing::{PublicKey, id_text};

pub fn run(a: &Device) -> Result<(), Failure> {
    match &a.command {
        DeviceCommand::Info(a) => info(a),
        DeviceCommand::Flash(a) => flash::run(a),
        DeviceCommand::Evaluate(a) => stream::evaluate(a),
        DeviceCommand::Correct(a) => stream::correct(a),
        DeviceCommand::Bypass(a) => bypass(a),
        DeviceCommand::Rollback(a) => roll_back(a),
        DeviceCommand::Statistics(a) => statistics(a),
        DeviceCommand::Monitor(a) => monitor::run(a),
        DeviceCommand::Restart(a) => restart(a),
        DeviceCommand::Stop(a) => stop(a),
        DeviceCommand::Provision(a) => provision(a),
        DeviceCommand::Cycle(a) => cycle(a),
        DeviceCommand::Emulate(a) => emulate::run(a),
    }
}

fn info(a: &Info) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (client, identity) = a.common.link.connect()?;
    let mut summary = show::identity_json(&identity);
    summary["port"] = client.port().into();
    show::identity(a.common.report(summary)?, &identity);
    Ok(())
}

fn bypass(a: &Bypass) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (mut client, _) = a.authority.connect(&a.common.link)?;
    let identity = client.set_bypass(a.switch == Switch::On)?;
    let report = a.common.report(show::identity_json(&identity))?;
    report.line(if identity.bypass {
        "The bypass is on: commands come back unchanged.".to_owned()
    } else {
        format!("The bypass is off. Running: {}.", show::active(&identity))
    });
    Ok(())
}

fn roll_back(a: &Rollback) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (mut client, before) = a.authority.connect(&a.common.link)?;
    let Some(left) = before.model else {
        return Err(Failure::Usage(
            "the device runs no model, so there is none to roll back\nhelp: upload one with `trainer device flash`"
                .to_owned(),
        ));
    };
    let after = client.roll_back(left.blob_crc)?;
    let report = a.common.report(show::identity_json(&after))?;
    report.line(format_args!("Left    {}", show::model(&left)));
    report.line(format_args!(
        "Runs    {}, also after a restart",
        show::active(&after)
    ));
    Ok(())
}

fn statistics(a: &args::Statistics) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (mut client, identity) = a.common.link.connect()?;
    let statistics = client.statistics()?;
    let counters = show::statistics_json(&statistics, identity.tick_hz);
    let report = a.common.report(json!({ "statistics": counters }))?;
    show::statistics(report, &statistics, identity.tick_hz);
    Ok(())
}

fn restart(a: &Restart) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (mut client, _) = a.authority.connect(&a.common.link)?;
    let identity = client.restart()?;
    let report = a.common.report(show::identity_json(&identity))?;
    report.line(format_args!(
        "Restarted. Running: {}.",
        show::active(&identity)
    ));
    Ok(())
}

fn stop(a: &Stop) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (mut client, identity) = a.authority.connect(&a.common.link)?;
    client.stand_down()?;
    let report = a.common.report(show::identity_json(&identity))?;
    report.line("The device expects no more commands until the next one comes.");
    Ok(())
}

fn provision(a: &Provision) -> Result<(), Failure> {
    a.common.check(&[&a.key])?;
    let key = PublicKey::read(&a.key)?;
    let (mut client, _) = a.common.link.connect()?;
    client.provision(key.bytes())?;
    let summary = json!({ "key": id_text(&key.id()), "port": client.port() });
    let report = a.common.report(summary)?;
    report.line(format_args!(
        "From now on, the device accepts only models signed by key {}.",
        id_text(&key.id())
    ));
    Ok(())
}

fn cycle(a: &Cycle) -> Result<(), Failure> {
    a.common.check(&[])?;
    let (mut client, mut identity) = a.authority.connect(&a.common.link)?;
    let there = identity.cycle;
    let asked = CycleSettings {
        period_us: a.period_us.unwrap_or(there.period_us),
        rate: a.rate.unwrap_or(there.rate),
        acceleration: a.acceleration.unwrap_or(there.acceleration),
        blend_s: a.blend.unwrap_or(there.blend_s),
        max_instructions: a.max_instructions.unwrap_or(there.max_instructions),
    };
    let changes = a.period_us.is_some()
        || a.rate.is_some()
        || a.acceleration.is_some()
        || a.blend.is_some()
        || a.max_instructions.is_some();
    if changes {
        identity = client.provision_cycle(&asked)?;
    }
    let report = a.common.report(show::cycle_json(&identity.cycle))?;
    let kept = if changes {
        ", also after a restart"
    } else {
        ""
    };
    report.line(format_args!(
        "The cycle: {}{kept}.",
        show::cycle(&identity.cycle)
    ));
    Ok(())
}
