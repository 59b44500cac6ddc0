//! What one evaluation costs, in instructions that repeat exactly (QEMU `-icount`, Cortex-M4F). Not cycles.

use poegp_protocol::link::Query;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::sample::{Elastic, Sample, Support};

/// Instructions of each evaluation.
fn costs(device: &mut Device, queries: &[Query]) -> Vec<f64> {
    let tick_hz = device.identify().unwrap().tick_hz;
    let ticks = queries
        .iter()
        .map(|query| device.evaluate(query).unwrap().ticks);
    ticks.map(|ticks| instructions(ticks, tick_hz)).collect()
}

/// Mean instructions of one evaluation, which must not depend on the query.
fn cost(device: &mut Device, sample: Sample) -> f64 {
    device.load(&sample.blob()).unwrap();
    // Within the trained ranges: three of four queries.
    let mut queries = sample.queries(28);
    let mut index = 0;
    queries.retain(|_| {
        index += 1;
        index % 4 != 0
    });
    let costs = costs(device, &queries);
    let mean = costs.iter().sum::<f64>() / costs.len() as f64;
    for cost in &costs {
        assert!(
            (cost - mean).abs() <= 0.01 * mean,
            "{sample:?}: {cost} instructions where {mean} are usual"
        );
    }
    mean
}

#[test]
fn instructions_of_one_evaluation() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    let no_model = costs(&mut device, &Sample::plain(30, Support::None).queries(1))[0];
    let chain = cost(&mut device, Sample::plain(30, Support::None));
    let shared = cost(&mut device, Sample::plain(30, Support::Shared(300)));
    let per_output = cost(&mut device, Sample::plain(30, Support::PerOutput(300)));
    println!("instructions of one evaluation, Cortex-M4F, 6 joints, 7 inputs, 6 outputs:");
    println!("  no model                  {no_model:8.0}");
    println!("  chain alone               {chain:8.0}");
    println!("  300 points, shared        {shared:8.0}");
    println!("  300 points, per output    {per_output:8.0}");
    assert!(no_model <= 200.0, "{no_model}");
    assert!(chain <= 3_000.0, "{chain}");
    assert!(shared <= 25_000.0, "{shared}");
    assert!(per_output <= 70_000.0, "{per_output}");
}

#[test]
fn instructions_of_elastic_models() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    for (name, elastic) in [("own", Elastic::OWN), ("tied", Elastic::TIED)] {
        for joints in 5..=7 {
            let sample = Sample {
                joints,
                ..Sample::plain(31, Support::Elastic(elastic))
            };
            for points in [0, 100] {
                let e = Elastic { points, ..elastic };
                let none = Elastic { ripple: 0, ..e };
                let s = |e| Sample {
                    correction: Support::Elastic(e),
                    ..sample
                };
                let a = cost(&mut device, s(e));
                let b = cost(&mut device, s(none));
                println!("{name} {joints} joints {points} points: {a:.0} / no ripple {b:.0}");
            }
        }
    }
}
