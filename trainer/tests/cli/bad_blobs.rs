//! Invalid blobs are refused with a reason, and nothing is written.

use poegp_protocol::blob::FORMAT_VERSION;

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

/// Returns a folder with train.csv, test1.csv and arm.blob; also returns the blob.
pub fn folder() -> (Folder, Vec<u8>) {
    let folder = Folder::prepared("bad_blobs", |folder| {
        folder.write("train.csv", simulated("train", 20));
        folder.write("test1.csv", simulated("test1", 5));
        let line =
            format!("calibrate --robot {SERIAL} train.csv --method poe-gp-load --out arm.blob");
        folder.run(&line).ok();
    });
    let blob = folder.read("arm.blob");
    (folder, blob)
}

#[track_caller]
fn refused(folder: &Folder, bytes: &[u8]) {
    folder.write("bad.blob", bytes);
    for line in [
        "evaluate bad.blob train.csv --predictions new.csv --json new.json",
        "inspect bad.blob --json new.json",
        "inspect bad.blob --json -",
    ] {
        folder.refuses(line);
    }
}

#[test]
fn truncated_damaged_or_of_another_kind() {
    let _texts = texts();
    let (folder, blob) = folder();
    folder.run("inspect arm.blob").ok();
    for length in [0, 10, blob.len() - 1] {
        refused(&folder, &blob[..length]);
    }
    refused(&folder, &[blob.as_slice(), &[0]].concat());
    for at in [100, blob.len() / 2, blob.len() - 1] {
        let mut damaged = blob.clone();
        damaged[at] ^= 1;
        refused(&folder, &damaged);
    }
    let mut newer = blob.clone();
    newer[8..10].copy_from_slice(&(FORMAT_VERSION + 1).to_le_bytes());
    refused(&folder, &newer);
    refused(&folder, simulated("train", 3).as_bytes());
    folder.refuses("inspect none.blob");
    folder.refuses("evaluate none.blob train.csv");
}

#[test]
fn for_other_joints() {
    let _texts = texts();
    let (folder, _) = folder();
    folder
        .run("simulate --robot kuka-iiwa7 --poses 12 --test-sets 0 --out iiwa")
        .ok();
    folder.refuses("evaluate arm.blob iiwa/train.csv --predictions new.csv --json new.json");
}
