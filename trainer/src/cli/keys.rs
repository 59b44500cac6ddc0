//! `trainer keys new`, `trainer sign` and `trainer verify`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use poegp_protocol::blob::envelope;
use poegp_runtime::model::signature;
use poegp_runtime::model::signature::SignatureError;
use serde_json::json;

use crate::cli::failure::Failure;
use crate::cli::output;
use crate::cli::output::kind::{Kind, check_kind};
use crate::cli::output::transaction::Readers;
use crate::cli::output::{check_outputs, summary_text, write_summary, write_with_blob};
use crate::cli::terminal::print::{Printer, warning};
use crate::cli::terminal::warnings;
use crate::signing::{PublicKey, SecretKey, id_text};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;

/// `trainer keys`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer keys new --out cell7")]
pub struct Keys {
    /// Command.
    #[command(subcommand)]
    pub command: KeysCommand,
}

/// The commands of `trainer keys`.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Create a pair of keys, without overwriting files.
    New(NewKeys),
}

/// `trainer keys new`.
#[derive(Debug, Args)]
#[command(
    after_help = "Keep NAME.key secret; provision the device with NAME.pub.\n\n\
    Example: trainer keys new --out cell7"
)]
pub struct NewKeys {
    /// Write NAME.key, the secret key, readable by its owner only, and NAME.pub, the public key.
    #[arg(long, value_name = "NAME")]
    pub out: PathBuf,
    /// Write the key id and the file names as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// `trainer sign`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  trainer sign arm.blob --key cell7.key\n  \
    trainer sign arm.blob --key cell7.key --out signed.blob\n  \
    trainer sign report.html --key cell7.key   (writes report.html.sig)")]
pub struct Sign {
    /// Blob to sign, or a report (.html) or its JSON (.json), whose signature is FILE.sig. An existing
    /// signature is replaced.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Secret key.
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// Revision of the model; a device accepts none lower than its own (default: the time in seconds).
    #[arg(long, value_name = "N")]
    pub revision: Option<u32>,
    /// Write the signed blob, or the signature of a report, to this file (default: replace the blob; FILE.sig).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write the result as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// `trainer verify`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  trainer verify arm.blob --public-key cell7.pub\n  \
    trainer verify report.html --public-key cell7.pub   (reads report.html.sig)"
)]
pub struct Verify {
    /// Blob to verify, or a report (.html) or its JSON (.json) with its signature in FILE.sig.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Public key.
    #[arg(long, value_name = "FILE")]
    pub public_key: PathBuf,
    /// Write the verdict as JSON, also for a wrong signature (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn keys(a: &Keys) -> Result<(), Failure> {
    let KeysCommand::New(new) = &a.command;
    let (secret, public) = (with_suffix(&new.out, ".key"), with_suffix(&new.out, ".pub"));
    for path in [&secret, &public] {
        output::check_new(path)?;
        if new.json.as_ref() == Some(path) {
            let found = "two outputs in one file";
            return Err(InputError::new(path, found, "a file for each output").into());
        }
    }
    check_outputs(&[(new.json.as_deref(), Kind::Json)], &[])?;
    let key = SecretKey::generate()
        .map_err(|e| Failure::Usage(format!("no randomness for a key: {e}")))?;
    let summary = summary_text(
        json!({ "key": id_text(&key.public().id()), "secret_key_file": secret, "public_key_file": public }),
    )?;
    let json = new.json.as_deref().map(|path| (path, summary.as_bytes()));
    output::write_with_new(
        &[
            (&secret, key.to_text().as_bytes(), Readers::Owner),
            (&public, key.public().to_text().as_bytes(), Readers::All),
        ],
        json.as_slice(),
    )?;
    let report = Printer::for_outputs(&[new.json.as_deref()]);
    report.line(format_args!("key {}", id_text(&key.public().id())));
    report.line(format_args!(
        "  {}: secret key, signs models and reports; keep it where nobody else can read it",
        secret.display()
    ));
    report.line(format_args!(
        "  {}: public key, verifies them; provision the device with it",
        public.display()
    ));
    Ok(())
}

pub fn sign(a: &Sign) -> Result<(), Failure> {
    let out = a.out.as_ref().unwrap_or(&a.file);
    check_outputs(&[(a.json.as_deref(), Kind::Json)], &[&a.file, &a.key, out])?;
    if a.json.as_ref() == Some(out) {
        let found = "two outputs in one file";
        return Err(InputError::new(out, found, "a file for each output").into());
    }
    output::check(out)?;
    if let (Ok(canonical_out), Ok(key)) =
        (std::fs::canonicalize(out), std::fs::canonicalize(&a.key))
        && canonical_out == key
    {
        let expected = "another file for the signed blob";
        return Err(InputError::new(out, "the key", expected).into());
    }
    check_kind(out, Kind::Model)?;
    let there = std::fs::read(out).unwrap_or_default();
    let key = read_secret_key(&a.key)?;
    let loaded = BlobModel::read(&a.file)?;
    let revision = match a.revision {
        Some(revision) => revision,
        None => revision_of_now()?,
    };
    let signed = key.sign(loaded.bytes(), revision).map_err(|e| {
        let expected = "a model blob written by `trainer calibrate`";
        InputError::new(&a.file, e.to_string(), expected)
    })?;
    let trailer = envelope::open(loaded.bytes()).ok().and_then(|e| e.trailer);
    // A device compares the revision with the last one that it has seen, whichever file it came from.
    let there = envelope::open(&there).ok().and_then(|old| old.trailer);
    let there = there.map(|old| old.revision);
    let highest = trailer.as_ref().map(|old| old.revision).max(there);
    let warned = warnings_of_signing(out, &loaded, revision, highest);
    warned.iter().for_each(warnings::add);
    let replaced = trailer.as_ref().map(|trailer| id_text(&trailer.key_id));
    let summary = summary_text(json!({
        "file": out,
        "bytes": signed.len(),
        "key": id_text(&key.public().id()),
        "revision": revision,
        "replaced_key": replaced,
    }))?;
    write_with_blob((out, &signed), &[(a.json.as_deref(), Some(&summary))])?;
    let before = trailer.map_or_else(String::new, |old| {
        let (key, old_key) = (id_text(&key.public().id()), id_text(&old.key_id));
        let whose = match old_key == key {
            true => "the signature of the same key".to_owned(),
            false => format!("the signature of key {old_key}"),
        };
        format!(", in place of {whose} as revision {}", old.revision)
    });
    warned.iter().for_each(warning);
    Printer::for_outputs(&[a.json.as_deref()]).line(format_args!(
        "{}: signed by key {} as revision {revision}{before}",
        out.display(),
        id_text(&key.public().id())
    ));
    Ok(())
}

/// Returns the warnings about a model that is signed with a revision; `highest` is the highest one of the signatures that it
/// replaces.
fn warnings_of_signing(
    out: &Path,
    loaded: &BlobModel,
    revision: u32,
    highest: Option<u32>,
) -> Vec<String> {
    let (out, robot) = (out.display(), &loaded.blob().robot);
    let lower = highest.filter(|old| revision < *old).map(|old| {
        format!(
            "{out}: revision {revision} is lower than revision {old} of the signature that it replaces; a device that has \
             had revision {old} or a later one refuses this model"
        )
    });
    let unnumbered = robot.serial_number.is_empty().then(|| {
        format!(
            "{out}: the model states no serial number, so a device takes it for the model of any {}; calibrate with \
             --serial-number",
            robot.name
        )
    });
    lower.into_iter().chain(unnumbered).collect()
}

/// Returns a revision that grows every second, whatever SOURCE_DATE_EPOCH says: models of the same revision replace each other
/// in any order. In 2106 the time exceeds 32 bits.
fn revision_of_now() -> Result<u32, Failure> {
    let seconds = time::OffsetDateTime::now_utc().unix_timestamp();
    u32::try_from(seconds).map_err(|_| {
        Failure::Usage(format!(
            "the time, {seconds} s, cannot be a revision\nhelp: state one with --revision"
        ))
    })
}

/// Reads a secret key; a note goes to standard error if other users can read the file.
pub fn read_secret_key(path: &Path) -> Result<SecretKey, Failure> {
    let key = SecretKey::read(path)?;
    note_when_others_read(path);
    Ok(key)
}

pub fn verify(a: &Verify) -> Result<(), Failure> {
    check_outputs(
        &[(a.json.as_deref(), Kind::Json)],
        &[&a.file, &a.public_key],
    )?;
    let key = PublicKey::read(&a.public_key)?;
    let expected = "a model blob written by `trainer sign`";
    let bytes =
        std::fs::read(&a.file).map_err(|e| InputError::unreadable(&a.file, &e, expected))?;
    let id = id_text(&key.id());
    let verdict = |outcome: Result<u32, String>| json!({ "file": a.file, "key": id, "verified": outcome.is_ok(), "revision": outcome.as_ref().ok(), "why": outcome.as_ref().err() });
    let refused = |why: &dyn std::fmt::Display| match write_summary(
        a.json.as_deref(),
        verdict(Err(why.to_string())),
    ) {
        Ok(()) => Failure::Refused(format!(
            "{}: not verified by key {id}: {why}",
            a.file.display()
        )),
        Err(failure) => failure,
    };
    let revision = match (
        signature::verify(&bytes, key.bytes()),
        envelope::open(&bytes),
    ) {
        (Ok(revision), _) => revision,
        (Err(SignatureError::Malformed), Err(error)) => return Err(refused(&error)),
        (Err(error), _) => return Err(refused(&error)),
    };
    write_summary(a.json.as_deref(), verdict(Ok(revision)))?;
    Printer::for_outputs(&[a.json.as_deref()]).line(format_args!(
        "{}: valid signature of key {id}, revision {revision}",
        a.file.display()
    ));
    Ok(())
}

/// Appends `suffix` to the name of `path`, which may contain dots of its own.
pub fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

/// Prints a note if other users can read a key: a copied key has the permissions of an ordinary file.
fn note_when_others_read(path: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(path).map(|there| there.permissions().mode());
        if mode.is_ok_and(|mode| mode & 0o077 != 0) {
            let path = path.display();
            crate::cli::terminal::print::note(format_args!(
                "{path}: others can read this secret key; `chmod 600 {path}` prevents it"
            ));
        }
    }
    #[cfg(not(unix))]
    let _ = path;
}
