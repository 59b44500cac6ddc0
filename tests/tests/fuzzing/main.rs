//! Readers under bytes that nobody wrote: seeded, the same in each run.
//!
//! `POEGP_FUZZ=1000000 cargo test --release -p poegp-tests --test fuzzing -- --nocapture` asks for more executions of
//! each target, and `POEGP_FUZZ_SEED` for other ones; docs/assurance.md has the record of a long run.

use std::env;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use poegp_protocol::frame::{MAX_FRAME, encode};
use poegp_protocol::link::{Query, Request, Response};
use poegp_tests::fuzzing;
use poegp_tests::workspace;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The number in a variable of the environment.
fn asked(variable: &str, otherwise: u64) -> u64 {
    env::var(variable).map_or(otherwise, |text| {
        text.parse()
            .unwrap_or_else(|_| panic!("{variable} is {text:?}; a number is expected"))
    })
}

/// Runs `target` with `executions` inputs made of `seeds`, and with the seeds themselves.
fn run(name: &str, executions: u64, seeds: &[Vec<u8>], target: fn(&[u8])) {
    let executions = asked("POEGP_FUZZ", executions);
    let seed = asked("POEGP_FUZZ_SEED", 7);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mutated = (0..executions).map(|_| fuzzing::mutated(seeds, &mut random));
    for (number, bytes) in seeds.iter().cloned().chain(mutated).enumerate() {
        if catch_unwind(AssertUnwindSafe(|| target(&bytes))).is_err() {
            let place = env::temp_dir().join(format!("poegp-fuzz-{name}-{seed}-{number}"));
            fs::write(&place, &bytes).unwrap();
            panic!(
                "{name}: input {number} breaks a law; it is in {}",
                place.display()
            );
        }
    }
    println!(
        "{name}: {executions} executions of seed {seed}, {} inputs to begin with",
        seeds.len()
    );
}

/// The files of a folder of the repository, by name; long ones cut behind a line, so that changes meet what matters.
fn files(folder: &str, extension: &str, longest: usize) -> Vec<Vec<u8>> {
    let mut paths: Vec<_> = fs::read_dir(workspace().join(folder))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|found| found == extension))
        .collect();
    paths.sort();
    let read = |path: &Path| {
        let mut bytes = fs::read(path).unwrap();
        if bytes.len() > longest {
            let end = bytes[..longest].iter().rposition(|byte| *byte == b'\n');
            bytes.truncate(end.map_or(longest, |at| at + 1));
        }
        bytes
    };
    let read: Vec<_> = paths.iter().map(|path| read(path)).collect();
    assert!(!read.is_empty(), "no .{extension} in {folder}");
    read
}

#[test]
fn blobs() {
    run(
        "blob",
        5_000,
        &files("tests/data", "blob", usize::MAX),
        fuzzing::blob,
    );
}

#[test]
fn frames() {
    let query = || Query {
        joints: [0.1, -0.7, 0.0].into_iter().collect(),
        payload_kg: 2.5,
    };
    let requests = [
        Request::Identify,
        Request::Evaluate(query()),
        Request::Correct(query()),
        Request::BeginUpload {
            length: 9_000,
            crc: 7,
        },
        Request::UploadPiece {
            offset: 256,
            bytes: &[0, 1, 2, 0xff],
        },
        Request::Provision {
            public_key: [9; 32],
        },
    ];
    let framed = |message: &dyn Fn(&mut [u8], &mut [u8]) -> Vec<u8>| {
        message(&mut [0; MAX_FRAME], &mut [0; MAX_FRAME])
    };
    let mut seeds: Vec<_> = requests
        .iter()
        .map(|request| framed(&|scratch, out| encode(1, request, scratch, out).unwrap().to_vec()))
        .collect();
    let response = Response::Uploading { received: 256 };
    seeds.push(framed(&|scratch, out| {
        encode(1, &response, scratch, out).unwrap().to_vec()
    }));
    run("frame", 200_000, &seeds, fuzzing::frame);
}

#[test]
fn measurement_files() {
    let mut seeds = files("tests/data/simulated", "csv", 2_000);
    seeds.extend(files("tests/data/import", "csv", 2_000));
    run("measurements", 10_000, &seeds, fuzzing::measurements);
}

#[test]
fn urdf_files() {
    let seeds = [
        files("tests/data/robots", "urdf", 20_000),
        files("tests/data/urdf", "urdf", 20_000),
    ];
    run("urdf", 3_000, &seeds.concat(), fuzzing::urdf);
}

#[test]
fn toml_files() {
    run(
        "toml",
        5_000,
        &files("trainer/robots", "toml", 20_000),
        fuzzing::toml,
    );
}

#[test]
fn report_pages() {
    let seeds = [
        "</title><script>alert(1)</script>",
        "\"><img src=x onerror=alert(1)>",
        "&lt;&amp;&#60;",
        "]]><!-- -->",
        "cell 7, left arm",
    ];
    let seeds: Vec<_> = seeds.iter().map(|text| text.as_bytes().to_vec()).collect();
    run("report", 5_000, &seeds, fuzzing::report);
}
