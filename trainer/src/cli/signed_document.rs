//! `trainer sign` and `trainer verify` for a report or its JSON: the signature is in a separate file beside it.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::failure::Failure;
use crate::cli::keys::{Sign, Verify, read_secret_key, with_suffix};
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, summary_text, write_summary, write_texts};
use crate::cli::terminal::print::Printer;
use crate::signing::document;
use crate::signing::{PublicKey, id_text};
use poegp_calibration::input_error::InputError;

/// Whether a path names a report or its JSON; everything else is a blob.
pub fn is_document(path: &Path) -> bool {
    path.extension().is_some_and(|extension| {
        ["html", "htm", "json"]
            .iter()
            .any(|known| extension.eq_ignore_ascii_case(known))
    })
}

fn read(path: &Path) -> Result<Vec<u8>, InputError> {
    std::fs::read(path).map_err(|e| InputError::unreadable(path, &e, "a report or its JSON"))
}

pub fn sign(a: &Sign) -> Result<(), Failure> {
    if a.revision.is_some() {
        return Err(Failure::Usage(format!(
            "found --revision with {}, expected it with a blob: documents have no revisions",
            a.file.display()
        )));
    }
    let beside = with_suffix(&a.file, ".sig");
    let out: &PathBuf = a.out.as_ref().unwrap_or(&beside);
    check_outputs(
        &[
            (Some(out), Kind::Signature),
            (a.json.as_deref(), Kind::Json),
        ],
        &[&a.file, &a.key],
    )?;
    let key = read_secret_key(&a.key)?;
    let text = document::sign(&key, &read(&a.file)?);
    let id = id_text(&key.public().id());
    let summary = summary_text(json!({ "file": a.file, "signature_file": out, "key": id }))?;
    write_texts(&[
        (Some(out), Some(&text)),
        (a.json.as_deref(), Some(&summary)),
    ])?;
    Printer::for_outputs(&[a.json.as_deref()]).line(format_args!(
        "{}: signed by key {id}, see {}; pass on both files together",
        a.file.display(),
        out.display()
    ));
    Ok(())
}

pub fn verify(a: &Verify) -> Result<(), Failure> {
    let beside = with_suffix(&a.file, ".sig");
    check_outputs(
        &[(a.json.as_deref(), Kind::Json)],
        &[&a.file, &a.public_key, &beside],
    )?;
    let key = PublicKey::read(&a.public_key)?;
    let bytes = read(&a.file)?;
    let expected = "the signature that `trainer sign` writes beside the document";
    let text = std::fs::read_to_string(&beside)
        .map_err(|e| InputError::unreadable(&beside, &e, expected))?;
    let id = id_text(&key.id());
    let found = document::verify(&beside, &text, &bytes, &key)?;
    let why = found.as_ref().err().map(ToString::to_string);
    let verdict = json!({ "file": a.file, "key": id, "verified": found.is_ok(), "revision": null, "why": why });
    write_summary(a.json.as_deref(), verdict)?;
    match why {
        Some(why) => Err(Failure::Refused(format!(
            "{}: not verified by key {id}: {why}",
            a.file.display()
        ))),
        None => {
            Printer::for_outputs(&[a.json.as_deref()]).line(format_args!(
                "{}: valid signature of key {id}",
                a.file.display()
            ));
            Ok(())
        }
    }
}
