//! Keys and signatures: making, using and refusing them; secret keys are never shown.

use crate::program::{Folder, Outcome, SERIAL, simulated};
use crate::texts::texts;

/// Returns a folder with a blob and two pairs of keys.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 12));
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --serial-number 7 --out arm.blob"
    );
    folder.run(&line).ok();
    for name in ["ours", "theirs"] {
        folder.run(&format!("keys new --out {name}")).ok();
    }
    folder
}

/// Asserts exit code 1 with a reason.
#[track_caller]
fn not_verified(outcome: Outcome) {
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert_eq!(outcome.stdout, "");
    outcome.said();
}

fn key_id(folder: &Folder, name: &str) -> String {
    let text = folder.text(&format!("{name}.pub"));
    text.lines().nth(1).unwrap()[..16].to_owned()
}

#[test]
fn keys_are_made_once_and_never_shown() {
    let _texts = texts();
    let folder = Folder::new();
    let made = folder.run("keys new --out cell.7").ok();
    assert_eq!(folder.names(), ["cell.7.key", "cell.7.pub"]);
    let (secret, public) = (folder.text("cell.7.key"), folder.text("cell.7.pub"));
    for (text, title) in [
        (&secret, "poegp secret key, "),
        (&public, "poegp public key, "),
    ] {
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with(title) && lines.len() == 2, "{title}");
        assert_eq!(lines[1].len(), 64);
    }
    assert!(made.stdout.contains(&key_id(&folder, "cell.7")));
    let digits = secret.lines().nth(1).unwrap();
    for text in [&made.stdout, &made.stderr] {
        assert!(!text.contains(&digits[..8]), "a secret is shown");
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |name| folder.path(name).metadata().unwrap().permissions().mode() & 0o777;
        assert_eq!(mode("cell.7.key"), 0o600);
    }
    // Neither file is overwritten, and no half of a pair is made.
    folder.refuses("keys new --out cell.7");
    std::fs::remove_file(folder.path("cell.7.key")).unwrap();
    folder.refuses("keys new --out cell.7");
    folder.refuses("keys new --out no/folder");
}

#[test]
fn a_signed_blob_is_verified_and_read_as_before() {
    let _texts = texts();
    let folder = folder();
    folder
        .run("sign arm.blob --key ours.key --revision 5 --out signed.blob")
        .ok();
    let (plain, signed) = (folder.read("arm.blob"), folder.read("signed.blob"));
    assert_eq!(signed.len(), plain.len() + 80);
    let verified = folder.run("verify signed.blob --public-key ours.pub").ok();
    assert!(verified.stdout.contains(&key_id(&folder, "ours")));
    // Every other command reads the same model.
    for blob in ["arm", "signed"] {
        let line = format!("evaluate {blob}.blob train.csv --predictions {blob}.csv");
        folder.run(&line).ok();
    }
    assert_eq!(folder.read("arm.csv"), folder.read("signed.csv"));
    let facts = |blob: &str| {
        folder
            .run(&format!("inspect {blob}.blob --json -"))
            .ok()
            .json()
    };
    let (before, after) = (facts("arm"), facts("signed"));
    assert_eq!(before["signed_by"], serde_json::Value::Null);
    assert_eq!(after["signed_by"], key_id(&folder, "ours"));
    assert_eq!(before["correction"], after["correction"]);
    let text = |blob: &str| folder.run(&format!("inspect {blob}.blob")).ok().said();
    text("arm");
    assert!(
        text("signed")
            .stdout
            .contains(&format!("signed by key {}", key_id(&folder, "ours")))
    );
}

/// Signing in place, again, or by another key always leaves one signature, and the same key always makes the same one.
#[test]
fn signing_again_replaces_the_signature() {
    let _texts = texts();
    let folder = folder();
    folder.run("sign arm.blob --key ours.key --revision 5").ok();
    let once = folder.read("arm.blob");
    folder.run("sign arm.blob --key ours.key --revision 5").ok();
    assert_eq!(folder.read("arm.blob"), once);
    let replaced = folder
        .run("sign arm.blob --key theirs.key --revision 5")
        .ok()
        .stdout;
    let ours = key_id(&folder, "ours");
    assert!(replaced.contains(&format!("in place of the signature of key {ours}")));
    assert_eq!(folder.read("arm.blob").len(), once.len());
    folder.run("verify arm.blob --public-key theirs.pub").ok();
    not_verified(folder.run("verify arm.blob --public-key ours.pub"));
}

/// A device refuses a revision below its own, so signing with one is warned of; and a key does not replace itself.
#[test]
fn a_lower_revision_is_warned_of() {
    let folder = folder();
    let sign = |revision: u32| {
        let line = format!("sign arm.blob --key ours.key --revision {revision}");
        folder.run(&line).ok()
    };
    assert!(!sign(7).stdout.contains("in place of"));
    for (revision, before, is_lower) in [(7, 7, false), (8, 7, false), (1, 8, true)] {
        let outcome = sign(revision);
        let said = format!("in place of the signature of the same key as revision {before}");
        assert!(outcome.stdout.contains(&said), "{outcome:#?}");
        let warned = outcome.stderr.contains("is lower than revision 8");
        assert_eq!(warned, is_lower, "{outcome:#?}");
    }
    // Also where the file that is replaced is not the one that is signed.
    let sign = |revision: u32| {
        let line = format!("sign b.blob --key ours.key --revision {revision} --out signed.blob");
        folder.run(&line).ok().stderr
    };
    folder.write("b.blob", folder.read("arm.blob"));
    assert!(!sign(9).contains("is lower"));
    assert!(sign(5).contains("is lower than revision 9"));
}

/// A calibration is repeated without the signature, so it does not replace a signed model; the checksum that report and
/// project file state is that of the model without its signature.
#[test]
fn a_signed_model_is_not_replaced_by_an_unsigned_one() {
    let folder = folder();
    let line = format!("calibrate --robot {SERIAL} train.csv --method base-tool --out own.blob");
    let made = folder
        .run(&format!("{line} --write-project own.toml --json -"))
        .ok()
        .json();
    folder.run("sign own.blob --key ours.key --revision 5").ok();
    let signed = folder.read("own.blob");
    for line in [line.as_str(), "calibrate own.toml"] {
        let outcome = folder.run(line);
        assert_eq!(outcome.code, Some(2), "{outcome:#?}");
        assert!(
            outcome
                .stderr
                .contains("own.blob: found a model signed by key"),
            "{outcome:#?}"
        );
        assert_eq!(folder.read("own.blob"), signed);
    }
    let files = made["provenance"]["files"].as_array().unwrap().iter();
    let stated: Vec<&str> = files
        .filter(|file| file["role"] == "result")
        .map(|file| file["sha256"].as_str().unwrap())
        .collect();
    let inspected = folder.run("inspect own.blob --json -").ok().json();
    assert_eq!(stated, [inspected["unsigned_sha256"].as_str().unwrap()]);
    assert!(folder.text("own.toml").contains(stated[0]));
    let again = folder
        .run("calibrate own.toml --out again.blob --json -")
        .ok();
    assert_eq!(again.json()["repeats"], true);
    // The signature, too, is repeated.
    folder
        .run("sign again.blob --key ours.key --revision 5")
        .ok();
    assert_eq!(folder.read("again.blob"), signed);
}

#[test]
fn what_is_not_signed_by_the_key_is_not_verified() {
    let _texts = texts();
    let folder = folder();
    let verify = |blob: &str| folder.run(&format!("verify {blob} --public-key ours.pub"));
    not_verified(verify("arm.blob"));
    folder
        .run("sign arm.blob --key ours.key --revision 5 --out signed.blob")
        .ok();
    let signed = folder.read("signed.blob");
    for at in [
        0,
        9,
        10,
        13,
        17,
        100,
        signed.len() - 70,
        signed.len() - 40,
        signed.len() - 1,
    ] {
        let mut changed = signed.clone();
        changed[at] ^= 0x10;
        folder.write("changed.blob", changed);
        assert_eq!(verify("changed.blob").code, Some(1), "byte {at}");
    }
    not_verified(verify("train.csv"));
    // Bad input has another exit code.
    for line in [
        "none.blob --public-key ours.pub",
        "signed.blob --public-key none.pub",
        "signed.blob --public-key ours.key",
    ] {
        folder.refuses(format!("verify {line}"));
    }
}

#[test]
fn what_cannot_be_signed_or_written_is_refused() {
    let _texts = texts();
    let folder = folder();
    let mut damaged = folder.read("arm.blob");
    damaged[100] ^= 1;
    folder.write("damaged.blob", damaged);
    for line in [
        "damaged.blob --key ours.key",
        "none.blob --key ours.key",
        "arm.blob --key ours.pub",
        "arm.blob --key arm.blob",
        "arm.blob --key train.csv",
        "arm.blob --key ours.key --out ours.key",
        "arm.blob --key ours.key --out no/x.blob",
    ] {
        folder.refuses(format!("sign {line}"));
    }
}

#[cfg(unix)]
#[test]
fn a_secret_that_others_may_read_is_noted() {
    let _texts = texts();
    use std::os::unix::fs::PermissionsExt;
    let folder = folder();
    let quiet = folder.run("sign arm.blob --key ours.key --revision 5").ok();
    assert!(quiet.stderr.is_empty(), "{quiet:?}");
    let permissions = std::fs::Permissions::from_mode(0o644);
    std::fs::set_permissions(folder.path("ours.key"), permissions).unwrap();
    folder
        .run("sign arm.blob --key ours.key --revision 5")
        .ok()
        .said();
}

/// A device compares revisions: two models of one revision would replace each other in any order.
#[test]
fn a_revision_is_the_time_even_in_a_reproducible_build() {
    let _texts = texts();
    let folder = folder();
    let revision = || {
        let line = "sign arm.blob --key ours.key --out signed.blob --json -";
        folder.run(line).ok().json()["revision"].as_u64().unwrap()
    };
    assert!(revision() > 1_790_000_000);
    let public = folder.read("ours.pub");
    let line = "sign arm.blob --key ours.key --out ours.pub";
    folder.refuses(line);
    assert_eq!(folder.read("ours.pub"), public);
}

/// Names are shown on terminals and written into files of other programs.
#[test]
fn a_name_has_no_control_characters() {
    let folder = folder();
    let line = format!("calibrate --robot {SERIAL} train.csv --method base-tool --out own.blob");
    let outcome = folder.run(&format!("{line} --serial-number 7\u{1b}[31m"));
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
    assert!(
        outcome.stderr.contains("control characters"),
        "{outcome:#?}"
    );
}
