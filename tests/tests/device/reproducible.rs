//! The image does not depend on the folder in which it was built.

use std::fs;
use std::path::Path;

use poegp_tests::firmware_build::{Board, firmware, firmware_from, firmware_of};
use poegp_tests::image::Image;
use poegp_tests::workspace;
use sha2::{Digest, Sha256};

/// The parts of the workspace that a build of the firmware needs.
const SOURCES: [&str; 10] = [
    "Cargo.toml",
    "Cargo.lock",
    "memory.x",
    "protocol",
    "runtime",
    "calibration",
    "trainer",
    "firmware",
    "tests/Cargo.toml",
    "tests/bits",
];

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            if entry.file_name() != "target" {
                copy(&entry.path(), &to.join(entry.file_name()));
            }
        }
    } else {
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(from, to).unwrap();
    }
}

fn hash(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns whether `bytes` contain `needle`.
fn contains(bytes: &[u8], needle: &str) -> bool {
    !needle.is_empty()
        && bytes
            .windows(needle.len())
            .any(|window| window == needle.as_bytes())
}

/// Compares the whole files: loaded bytes, symbols, texts of the log, and debug information.
#[test]
fn two_folders_give_one_image() {
    let here = firmware().unwrap_or_else(|error| panic!("{error}"));
    let elsewhere = tempfile::tempdir().unwrap();
    let source = elsewhere.path().join("a copy").join("of the sources");
    for part in SOURCES {
        copy(&workspace().join(part), &source.join(part));
    }
    // The workspace's member `tests` needs a library; this one is empty.
    fs::create_dir_all(source.join("tests/src")).unwrap();
    fs::write(source.join("tests/src/lib.rs"), "//! Not here.\n").unwrap();
    let there = firmware_from(&source, &elsewhere.path().join("build"), Board::default())
        .unwrap_or_else(|error| panic!("{error}"));
    let (one, other) = (fs::read(&here.elf).unwrap(), fs::read(&there.elf).unwrap());
    println!(
        "image of {}: SHA-256 of the ELF file {} and {}",
        here.toolchain,
        hash(&one),
        hash(&other)
    );
    let images = [&here.elf, &there.elf].map(|elf| Image::read(elf).unwrap().crc);
    assert_eq!(images[0], images[1], "the loaded bytes differ");
    assert_eq!(hash(&one), hash(&other));
    let folder = source.to_string_lossy();
    assert!(!contains(&other, &folder), "{folder} is in the image");
}

/// The flags that rename folders reach the compiler for every target.
#[test]
fn no_image_names_a_folder_of_this_machine() {
    for board in Board::ALL {
        let image = firmware_of(board).unwrap_or_else(|error| panic!("{error}"));
        let bytes = fs::read(&image.elf).unwrap();
        let folder = workspace().to_string_lossy();
        assert!(
            !contains(&bytes, &folder),
            "{folder} is in the image of {}",
            board.name()
        );
    }
}
