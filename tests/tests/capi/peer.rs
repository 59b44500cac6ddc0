//! `tests/peers/c`: the paper's process in C with newlib, compared with the runtime in one run.

use std::fs;

use poegp_protocol::blob::{self, Correction};
use poegp_runtime::guard::status::Status;
use poegp_tests::emulator::instructions;
use poegp_tests::sample::{INPUTS, Sample, SampleCorrection};
use poegp_tests::workspace;

use crate::c::{Machine, capi, compile, run_on_device};

const POINTS: usize = 300;
const TIMER_HZ: u32 = 25_000_000;

fn bytes(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// Returns the numbers of the blob in the peer's form: its kernel is e^(−|u|²), the runtime's 2^(−|u|²).
fn peer_model(blob: &[u8]) -> Vec<u8> {
    let decoded = blob::decode(blob).unwrap();
    let Correction::TaskSpace(task) = &decoded.correction else {
        panic!("not the paper's process");
    };
    let base = std::f32::consts::LN_2.sqrt();
    let mut peer = bytes(task.input_scale.iter().map(|scale| scale * base));
    peer.extend(bytes(task.affine.iter().flatten().copied()));
    for row in task.rows.chunks_exact(4 * (INPUTS + 6)) {
        let row = row
            .as_chunks::<4>()
            .0
            .iter()
            .copied()
            .map(f32::from_le_bytes);
        let scaled = row
            .enumerate()
            .map(|(index, value)| if index < INPUTS { value * base } else { value });
        peer.extend(bytes(scaled));
    }
    peer
}

#[test]
fn peer_in_c() {
    // The same mean in two forms; the peer has the difference form.
    let sample = Sample::plain(30, SampleCorrection::Folded(POINTS));
    let (blob, of_peer) = (
        sample.blob(),
        Sample::plain(30, SampleCorrection::Shared(POINTS)).blob(),
    );
    let directory = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let folder = directory.path();
    fs::write(folder.join("peer.bin"), peer_model(&of_peer)).unwrap();
    fs::write(folder.join("model.blob"), &blob).unwrap();
    let queries = sample.queries(24);
    let questions = queries
        .iter()
        .flat_map(|query| bytes(query.joints.iter().copied().chain([query.payload_kg])));
    fs::write(folder.join("questions.bin"), questions.collect::<Vec<_>>()).unwrap();
    let program = folder.join("bench");
    let source = workspace().join("tests/peers/c/bench.c");
    compile(
        Machine::Device,
        &source,
        &[&capi().join("examples"), folder],
        &program,
    );
    let said = run_on_device(&program, true);
    let (mut of_peer, mut of_ours, mut compared) = (0.0, 0.0, 0);
    for line in said.lines().filter_map(|line| line.strip_prefix("ticks ")) {
        let words: Vec<&str> = line.split(' ').collect();
        let count = |index: usize| instructions(words[index].parse().unwrap(), TIMER_HZ);
        of_peer += count(0) / queries.len() as f64;
        of_ours += count(1) / queries.len() as f64;
        let status = Status::from_bits(words[2].parse().unwrap());
        if status.contains(Status::CORRECTION_LIMITED) {
            continue;
        }
        compared += 1;
        let values = words[3..]
            .iter()
            .map(|word| f32::from_bits(u32::from_str_radix(word, 16).unwrap()));
        let values: Vec<f32> = values.collect();
        let (theirs, ours) = values.split_at(6);
        for (theirs, ours) in theirs.iter().zip(ours) {
            assert!(
                (theirs - ours).abs() <= 1e-7,
                "{theirs} {ours}: not the same process"
            );
        }
    }
    assert_eq!(said.matches("ticks ").count(), queries.len());
    assert!(
        compared > 0,
        "all answers were limited, so none was compared"
    );
    println!("paper's model, {POINTS} points, 7 inputs, 6 outputs, Cortex-M4F, instructions:");
    println!("  C with newlib's expf, process alone                   {of_peer:8.0}");
    println!("  poegp_evaluate, with chain, bounds, pose and checks   {of_ours:8.0}");
    println!(
        "  ratio                                                 {:8.2}",
        of_peer / of_ours
    );
    assert!(of_ours < of_peer, "{of_ours} {of_peer}");
}
