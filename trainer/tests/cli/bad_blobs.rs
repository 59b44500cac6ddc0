//! Blobs that are none: refused by name, and nothing is written.

use poegp_protocol::blob::FORMAT_VERSION;

use crate::program::{Folder, SERIAL, simulated};

fn folder() -> (Folder, Vec<u8>) {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 20));
    let line = format!("calibrate --robot {SERIAL} train.csv --model poe-gp-load --out arm.blob");
    folder.run(&line).ok();
    let blob = folder.read("arm.blob");
    (folder, blob)
}

#[track_caller]
fn refused(folder: &Folder, bytes: &[u8], parts: &[&str]) {
    folder.write("bad.blob", bytes);
    let before = folder.names();
    for line in [
        "evaluate bad.blob train.csv --predictions new.csv --json new.json",
        "inspect bad.blob --json new.json",
        "inspect bad.blob --json -",
    ] {
        folder.run(line).refused(&["bad.blob: found ", "expected"]);
        folder.run(line).refused(parts);
        assert_eq!(folder.names(), before, "{line}");
    }
}

#[test]
fn truncated_damaged_or_of_another_kind() {
    let (folder, blob) = folder();
    folder.run("inspect arm.blob").ok();
    refused(&folder, b"", &["truncated", "0 bytes"]);
    refused(&folder, &blob[..10], &["truncated"]);
    refused(&folder, &blob[..blob.len() - 1], &["truncated"]);
    let longer = [blob.as_slice(), &[0]].concat();
    refused(&folder, &longer, &["where its header announces"]);
    for at in [100, blob.len() / 2, blob.len() - 1] {
        let mut damaged = blob.clone();
        damaged[at] ^= 1;
        refused(&folder, &damaged, &["damaged", "CRC"]);
    }
    let mut newer = blob.clone();
    newer[8..10].copy_from_slice(&(FORMAT_VERSION + 1).to_le_bytes());
    refused(
        &folder,
        &newer,
        &[
            &format!("version {}", FORMAT_VERSION + 1),
            "this version reads",
            "use the version of the trainer",
        ],
    );
    refused(
        &folder,
        simulated("train", 3).as_bytes(),
        &["not a model blob"],
    );
    folder
        .run("inspect none.blob")
        .refused(&["none.blob: found no such file", "expected a model blob"]);
    folder
        .run("evaluate none.blob train.csv")
        .refused(&["none.blob: found no such file"]);
}

#[test]
fn for_other_joints() {
    let (folder, _) = folder();
    folder
        .run("simulate --robot kuka-iiwa7 --poses 12 --test-sets 0 --out iiwa")
        .ok();
    folder
        .run("evaluate arm.blob iiwa/train.csv --predictions new.csv --json new.json")
        .refused(&[
            "train.csv:2: found 7 joint columns",
            &format!("expected 6, the joints of robot \"{SERIAL}\""),
        ]);
    assert!(!folder.path("new.csv").exists() && !folder.path("new.json").exists());
}
