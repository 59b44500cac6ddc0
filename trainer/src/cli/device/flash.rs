//! `trainer device flash`.

use poegp_protocol::blob::envelope;
use poegp_protocol::blob::{CRC, Correction, stored_crc};
use poegp_protocol::link::{Identity, Key, MAX_NAME, StoredModel};
use serde_json::json;

use crate::cli::device::args::Flash;
use crate::cli::device::show;
use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, write_summary};
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use crate::device::client::{Client, Options};
use crate::device::error::ClientError;
use crate::signing::id_text;
use poegp_calibration::blob::predict::BlobModel;

pub fn run(a: &Flash) -> Result<(), Failure> {
    let outputs = [(a.common.json.as_deref(), Kind::Json)];
    let outputs = check_outputs(&outputs, &[&a.blob])?;
    // A file that is not a model is refused before the port is opened.
    let loaded = BlobModel::read(&a.blob)?;
    let (mut client, before) = a.authority.connect(&a.common.link)?;
    let report = Printer::for_outputs(&outputs);
    let already = runs(&before, loaded.bytes());
    let (after, stored) = if let (Some(stored), false) = (already, a.force) {
        report.line(format_args!(
            "The device runs this model already, from slot {}; --force uploads it anyway.",
            stored.slot
        ));
        (before.clone(), stored)
    } else {
        if !a.force {
            check_room(&loaded, &before)?;
            check_time(&loaded, &before)?;
            check_signature(&loaded, &before)?;
        }
        if !a.replace_robot {
            check_robot(&loaded, &before)?;
        }
        client.set_options(Options {
            chunk_size: usize::from(a.chunk_size),
            replaces_robot: a.replace_robot,
            ..a.common.link.options()
        });
        let (stored, after) = bring(&mut client, loaded.bytes())?;
        report.line(format_args!("Before  {}", show::active(&before)));
        report.line(format_args!("Now     {}", show::active(&after)));
        report.line(format_args!(
            "Stored in slot {}: the device also runs it after the next start.",
            stored.slot
        ));
        (after, stored)
    };
    let summary = json!({
        "uploaded": a.force || already.is_none(),
        "before": before.model.as_ref().map(show::model_json),
        "now": after.model.as_ref().map(show::model_json),
        "stored": show::stored_json(&stored),
    });
    write_summary(a.common.json.as_deref(), summary)
}

/// Uploads a blob with a progress bar; the device verifies, stores and runs it.
pub fn bring(client: &mut Client, bytes: &[u8]) -> Result<(StoredModel, Identity), ClientError> {
    let bar = progress::transfer(bytes.len(), "uploading");
    let brought = client.install(bytes, &mut |sent| {
        bar.set_message(if sent == bytes.len() {
            "verifying and storing"
        } else {
            "uploading"
        });
        bar.set_position(sent as u64);
    });
    bar.finish_and_clear();
    brought
}

/// Returns the slot from which the device runs exactly this blob, now and after a restart.
fn runs(identity: &Identity, bytes: &[u8]) -> Option<StoredModel> {
    let active = identity.model.as_ref().map(|model| model.blob_crc);
    if active.is_none() || active != stored_crc(bytes) {
        return None;
    }
    let is_this = |slot: &StoredModel| slot.first && slot.crc == CRC.checksum(bytes);
    identity.slots.iter().flatten().copied().find(is_this)
}

fn check_room(loaded: &BlobModel, identity: &Identity) -> Result<(), Failure> {
    let rows = match &loaded.blob().correction {
        Correction::None => 0,
        Correction::TaskSpace(task) => task.rows.len(),
        Correction::Elastic(elastic) => elastic.rows.len(),
    };
    let room = 4 * identity.capacity_words as usize;
    let (found, capacity, what) = if rows > room {
        (rows, room, "of inducing points")
    } else {
        let capacity = identity.capacity_bytes as usize;
        (loaded.bytes().len(), capacity, "in all")
    };
    if found <= capacity {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "the model does not fit: {found} bytes {what}, and the device has room for {capacity}\nhelp: calibrate with \
         fewer inducing points (--inducing-points), or with fewer poses for the paper's methods; nothing was uploaded"
    )))
}

/// Refuses a model whose commands do not fit into the cycle.
fn check_time(loaded: &BlobModel, identity: &Identity) -> Result<(), Failure> {
    let size = loaded.model().size();
    let instructions = size.map_or(0, |size| size.command_bound());
    let allowed = identity.cycle.max_instructions;
    if instructions <= allowed {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "the model is too slow: a command with it may take {instructions} instructions, the device allows {allowed}\n\
         help: calibrate with --max-instructions {allowed}, or allow more if the controller's cycle leaves time for them \
         (`trainer device cycle --max-instructions`); nothing was uploaded"
    )))
}

/// Refuses a model of another robot than that of the active model. The device checks this, too.
fn check_robot(loaded: &BlobModel, identity: &Identity) -> Result<(), Failure> {
    let Some(active) = &identity.model else {
        return Ok(());
    };
    let robot = &loaded.blob().robot;
    // The device keeps only as much of a name as fits.
    let same = |name: &str, known: &str| {
        name.starts_with(known) && (name.len() == known.len() || known.len() + 3 >= MAX_NAME)
    };
    let is = |name: &str, serial_number: &str| match serial_number {
        "" => format!("{name} without a serial number"),
        number => format!("{name} ({number})"),
    };
    if same(robot.name, &active.robot) && same(robot.serial_number, &active.serial_number) {
        if robot.serial_number.is_empty() {
            note(format_args!(
                "the model and the one that the device runs state no serial number: whether both are of the same robot \
                 cannot be checked"
            ));
        }
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "the model is of {}, the device corrects {}\n\
         help: if the device has moved to that robot, use --replace-robot; nothing was uploaded",
        is(robot.name, robot.serial_number),
        is(&active.robot, &active.serial_number)
    )))
}

/// Refuses a model that is not signed by the device's key. Only the device verifies the signature itself.
fn check_signature(loaded: &BlobModel, identity: &Identity) -> Result<(), Failure> {
    let key = match identity.key {
        Key::None => return Ok(()),
        Key::Provisioned(key) => key,
        Key::Unusable => {
            return Err(Failure::Usage(
                "the device accepts no model: the page of its public key is damaged or half written\nhelp: `trainer \
                 device provision` may complete it; nothing was uploaded"
                    .to_owned(),
            ));
        }
    };
    let trailer = envelope::open(loaded.bytes())
        .ok()
        .and_then(|envelope| envelope.trailer);
    let found = match trailer {
        Some(trailer) if trailer.key_id == key => return Ok(()),
        Some(trailer) => format!("signed by key {}", id_text(&trailer.key_id)),
        None => "not signed".to_owned(),
    };
    Err(Failure::Usage(format!(
        "the model is {found}; the device accepts only models signed by key {}\nhelp: sign it with `trainer sign`; \
         nothing was uploaded",
        id_text(&key)
    )))
}
