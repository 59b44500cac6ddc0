//! The instructions of an evaluation and of a corrected command, part by part, and the cost of loading a blob.
//!
//! ```sh
//! cargo test --release -p poegp-tests --test device -- --nocapture parts
//! ```

use poegp_protocol::link::{MAX_CHUNK, Request};
use poegp_tests::device::Device;
use poegp_tests::emulator::instructions;
use poegp_tests::execution::Recorder;
use poegp_tests::firmware_build::firmware;
use poegp_tests::parts::Parts;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

/// The models in the table.
const SHAPES: [(&str, SampleCorrection); 4] = [
    ("paper, 300", SampleCorrection::Folded(300)),
    ("paper per output, 300", SampleCorrection::PerOutput(300)),
    ("elastic, 200", SampleCorrection::Elastic(Elastic::PLAIN)),
    (
        "elastic with std, 200",
        SampleCorrection::Elastic(Elastic::WITH_STD),
    ),
];

/// Returns one column: the instructions of a pose or of a command by part, and the value of the device's own counter.
fn column(
    device: &mut Device,
    recorder: &mut Recorder,
    correction: SampleCorrection,
    command: bool,
) -> (Parts, f64) {
    let sample = Sample::plain(36, correction);
    let tick_hz = device.load(&sample.blob()).unwrap().tick_hz;
    let query = &sample.queries(1)[0];
    let mut ticks = 0;
    let executed = recorder
        .record(|| {
            ticks = if command {
                device.correct(query).unwrap().ticks
            } else {
                device.evaluate(query).unwrap().ticks
            };
        })
        .unwrap_or_else(|error| panic!("{error}"));
    let function = if command { "correct" } else { "evaluate" };
    let parts = Parts::of(
        &executed,
        &firmware().unwrap().elf,
        &["f32", "Compiled", function],
    )
    .unwrap_or_else(|error| panic!("{error}"));
    (parts, instructions(ticks, tick_hz))
}

/// The parts add up to the whole, which agrees with the device's own counter.
#[test]
fn the_parts_of_an_evaluation() {
    let (mut device, mut recorder) = Recorder::start().unwrap_or_else(|error| panic!("{error}"));
    let mut columns = Vec::new();
    for (name, correction) in SHAPES {
        for command in [false, true] {
            let (parts, counted) = column(&mut device, &mut recorder, correction, command);
            let what = if command { "command" } else { "pose" };
            columns.push((format!("{name}, {what}"), parts, counted));
        }
    }
    let mut names: Vec<String> = Vec::new();
    for (_, parts, _) in &columns {
        for (name, _) in &parts.counts {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
    }
    let largest = |name: &str| columns.iter().map(|(_, parts, _)| parts.count(name)).max();
    names.sort_by_key(|name| std::cmp::Reverse(largest(name)));
    println!("instructions of each part, Cortex-M4F, six joints:");
    let heads: Vec<&str> = columns.iter().map(|(name, _, _)| &**name).collect();
    println!("| | {} |", heads.join(" | "));
    println!("|---|{}", "---|".repeat(columns.len()));
    for name in &names {
        let cells = columns.iter().map(|(_, parts, _)| match parts.count(name) {
            0 => "–".to_owned(),
            count => count.to_string(),
        });
        println!("| {name} | {} |", cells.collect::<Vec<_>>().join(" | "));
    }
    let cells = columns
        .iter()
        .map(|(_, parts, _)| parts.whole().to_string());
    println!("| **whole** | {} |", cells.collect::<Vec<_>>().join(" | "));
    let cells = columns
        .iter()
        .map(|(_, _, counted)| format!("{counted:.0}"));
    println!(
        "| by the device's counter | {} |",
        cells.collect::<Vec<_>>().join(" | ")
    );
    for (name, parts, counted) in &columns {
        // The counter also includes the caller of the function, which copies its answer.
        let beside = counted - parts.whole() as f64;
        assert!(
            (-20.0..=0.02 * counted + 300.0).contains(&beside),
            "{name}: {} of {counted}",
            parts.whole()
        );
    }
}

/// Returns the instructions of [`ModelSlot::load_unverified`](poegp_runtime::service), instructions of the whole request
/// that verifies an uploaded blob, and the length of the blob.
fn load(device: &mut Device, recorder: &mut Recorder, correction: SampleCorrection) -> [usize; 3] {
    let blob = Sample::plain(37, correction).blob();
    device.allow_any_time().unwrap();
    device.client().begin_upload(&blob).unwrap();
    for (index, bytes) in blob.chunks(MAX_CHUNK).enumerate() {
        let offset = (MAX_CHUNK * index) as u32;
        let piece = Request::UploadChunk { offset, bytes };
        device.request(&piece).unwrap();
    }
    let executed = recorder
        .record(|| {
            device.client().verify_upload().unwrap();
        })
        .unwrap_or_else(|error| panic!("{error}"));
    let loading = Parts::of(
        &executed,
        &firmware().unwrap().elf,
        &["ModelSlot", "load_blob"],
    )
    .unwrap_or_else(|error| panic!("{error}"));
    [loading.whole(), executed.len(), blob.len()]
}

/// Loading computes the checksum, decodes the blob, checks every number and takes over the model. It costs at most 40
/// instructions a byte. The whole request also computes the checksum of the transfer and reads journals and key in flash,
/// whose cost does not depend on the blob: each further byte costs at most 40 instructions as well.
#[test]
fn the_parts_of_loading() {
    let (mut device, mut recorder) = Recorder::start().unwrap_or_else(|error| panic!("{error}"));
    println!("instructions of loading a blob without a signature, Cortex-M4F:");
    println!("| | bytes | loading | each byte | whole request | each byte more |");
    println!("|---|---|---|---|---|---|");
    let mut beyond = Vec::new();
    for (name, small, large) in [
        (
            "paper",
            SampleCorrection::Shared(100),
            SampleCorrection::Shared(300),
        ),
        (
            "paper per output",
            SampleCorrection::PerOutput(100),
            SampleCorrection::PerOutput(300),
        ),
        (
            "elastic",
            with_points(50),
            SampleCorrection::Elastic(Elastic::PLAIN),
        ),
    ] {
        let [_, before, short] = load(&mut device, &mut recorder, small);
        let [loading, whole, bytes] = load(&mut device, &mut recorder, large);
        let each = loading as f64 / bytes as f64;
        let more = (whole - before) as f64 / (bytes - short) as f64;
        println!("| {name} | {bytes} | {loading} | {each:.1} | {whole} | {more:.1} |");
        if each > 40.0 || more > 40.0 {
            beyond.push(format!("{name}: {each:.1}, {more:.1}"));
        }
    }
    assert!(beyond.is_empty(), "{beyond:?}");
}

fn with_points(points: usize) -> SampleCorrection {
    SampleCorrection::Elastic(Elastic {
        points,
        ..Elastic::PLAIN
    })
}
