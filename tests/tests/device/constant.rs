//! The time of an answer does not depend on the query, for poses and commands of every kind of model.

use poegp_protocol::link::Query;
use poegp_runtime::guard::status::Status;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::Host;

const QUERIES: usize = 1_000;

const SHAPES: [(&str, SampleCorrection); 5] = [
    ("chain alone", SampleCorrection::None),
    ("paper, shared, 300", SampleCorrection::Shared(300)),
    ("paper, per output, 300", SampleCorrection::PerOutput(300)),
    ("elastic", SampleCorrection::Elastic(Elastic::PLAIN)),
    (
        "elastic with a standard deviation",
        SampleCorrection::Elastic(Elastic::WITH_STD),
    ),
];

/// Returns the fewest and most instructions of `ask` over all queries.
fn range(
    device: &mut Device,
    queries: &[Query],
    ask: impl Fn(&mut Device, &Query) -> u32,
) -> (f64, f64) {
    let tick_hz = device.identify().unwrap().tick_hz;
    let counts = queries
        .iter()
        .map(|query| instructions(ask(device, query), tick_hz));
    counts.fold((f64::INFINITY, 0.0), |(least, most), count| {
        (count.min(least), count.max(most))
    })
}

/// Queries within and beyond the trained ranges, with and without a limited correction: the largest count is at most 1 %
/// above the smallest.
#[test]
fn a_thousand_inputs_take_the_same_time() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("instructions over {QUERIES} inputs, Cortex-M4F, six joints, fewest and most:");
    let mut beyond = Vec::new();
    for (name, correction) in SHAPES {
        let sample = Sample::plain(35, correction);
        let blob = sample.blob();
        device.load(&blob).unwrap();
        let queries = sample.queries(QUERIES);
        // The queries are mixed: some are outside the trained ranges, and not all corrections are limited.
        let host = Host::load(&blob).unwrap();
        let with = |status: Status| {
            let has =
                |query: &&Query| Status::from_bits(host.stages(query).status()).contains(status);
            queries.iter().filter(has).count()
        };
        let outside = with(Status::OUTSIDE_JOINT_RANGE);
        let bounded = with(Status::CORRECTION_LIMITED);
        assert!((100..500).contains(&outside), "{name}: {outside}");
        assert!(bounded < QUERIES, "{name}: {bounded}");
        for (what, (least, most)) in [
            (
                "pose",
                range(&mut device, &queries, |device, query| {
                    device.evaluate(query).unwrap().ticks
                }),
            ),
            (
                "command",
                range(&mut device, &queries, |device, query| {
                    device.correct(query).unwrap().ticks
                }),
            ),
        ] {
            let spread = 100.0 * (most / least - 1.0);
            println!(
                "| {name} | {what} | {least:.0} | {most:.0} | {spread:.2} % | {outside} outside, {bounded} bounded |"
            );
            if most > 1.01 * least {
                beyond.push(format!("{name}, {what}: {least:.0} to {most:.0}"));
            }
        }
    }
    assert!(beyond.is_empty(), "{beyond:#?}");
}
