//! The cost of one evaluation, in instructions that repeat exactly (QEMU `-icount`, Cortex-M4F). These are not cycles.

use poegp_protocol::link::Query;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::record::assert_recorded;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

/// Returns the instructions of each evaluation.
fn costs(device: &mut Device, queries: &[Query]) -> Vec<f64> {
    let tick_hz = device.identify().unwrap().tick_hz;
    let ticks = queries
        .iter()
        .map(|query| device.evaluate(query).unwrap().ticks);
    ticks.map(|ticks| instructions(ticks, tick_hz)).collect()
}

/// Returns the mean instructions of one evaluation; the count must not depend on the query.
fn cost(device: &mut Device, sample: Sample) -> f64 {
    device.load(&sample.blob()).unwrap();
    // Only queries within the trained ranges: three of four.
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
    let no_model = costs(
        &mut device,
        &Sample::plain(30, SampleCorrection::None).queries(1),
    )[0];
    let chain = cost(&mut device, Sample::plain(30, SampleCorrection::None));
    let shared = cost(
        &mut device,
        Sample::plain(30, SampleCorrection::Folded(300)),
    );
    let wide = cost(
        &mut device,
        Sample::plain(30, SampleCorrection::Shared(300)),
    );
    let per_output = cost(
        &mut device,
        Sample::plain(30, SampleCorrection::PerOutput(300)),
    );
    println!("instructions of one evaluation, Cortex-M4F, 6 joints, 7 inputs, 6 outputs:");
    println!("  no model                  {no_model:8.0}");
    println!("  chain alone               {chain:8.0}");
    println!("  300 points, shared        {shared:8.0}");
    println!("  300 points, wide points   {wide:8.0}");
    println!("  300 points, per output    {per_output:8.0}");
    assert!(no_model <= 200.0, "{no_model}");
    assert!(chain <= 3_000.0, "{chain}");
    assert!(shared <= 15_500.0, "{shared}");
    assert!(wide <= 25_000.0, "{wide}");
    assert!(per_output <= 70_000.0, "{per_output}");
    assert_recorded("one evaluation, chain alone", chain);
    assert_recorded("one evaluation, paper, 300 points", shared);
    assert_recorded(
        "one evaluation, paper, 300 points, wide inducing points",
        wide,
    );
    assert_recorded(
        "one evaluation, paper, 300 points, hyperparameters per output",
        per_output,
    );
}

/// The limits for an elastic model with 200 inducing points and four ripple terms.
#[test]
fn instructions_of_elastic_models() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("instructions of one compensated pose, Cortex-M4F, 6 joints:");
    for (name, elastic, limit) in [
        ("elastic, 200 points", Elastic::PLAIN, 13_500.0),
        (
            "elastic, 200 points, standard deviation",
            Elastic::WITH_STD,
            17_200.0,
        ),
    ] {
        let count = cost(
            &mut device,
            Sample::plain(31, SampleCorrection::Elastic(elastic)),
        );
        println!("  {name:<40}  {count:8.0}");
        assert!(count <= limit, "{name}: {count}");
        assert_recorded(&format!("one evaluation, {name}"), count);
    }
}

/// The cost of a standard deviation in addition to the pose.
#[test]
fn instructions_of_a_standard_deviation() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("instructions beside those of the model, Cortex-M4F:");
    let mut beyond = Vec::new();
    for (joints, sliding, coupled) in [(6, 0, false), (7, 0, false), (5, 0, false), (5, 1, true)] {
        for landmarks in [4, 12, 16] {
            let mut with = |landmarks| {
                let elastic = Elastic {
                    landmarks,
                    ..Elastic::PLAIN
                };
                let sample = Sample {
                    joints,
                    sliding,
                    coupled,
                    ..Sample::plain(34, SampleCorrection::Elastic(elastic))
                };
                cost(&mut device, sample)
            };
            let count = with(landmarks) - with(0);
            println!(
                "  {joints} joints, {sliding} sliding, coupled: {coupled}, {landmarks} landmarks: {count:.0}"
            );
            if count > 5_500.0 {
                beyond.push(count);
            }
        }
    }
    assert!(beyond.is_empty(), "{beyond:?}");
}

/// Returns the instructions of one evaluation and of one corrected command.
fn pose_and_command(device: &mut Device, sample: Sample) -> [f64; 2] {
    let pose = cost(device, sample);
    let tick_hz = device.identify().unwrap().tick_hz;
    let commands = sample.queries(28).into_iter();
    let ticks = commands.map(|query| device.correct(&query).unwrap().ticks);
    [pose, instructions(ticks.max().unwrap(), tick_hz)]
}

/// A parallelogram costs only its one coupling element, and a prismatic joint costs at most a fifth more than a revolute one.
#[test]
fn coupled_and_sliding_joints_cost_little() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("| model | joints | pose | command |");
    println!("|---|---|---|---|");
    let mut beyond = Vec::new();
    for (name, correction) in [
        ("chain alone", SampleCorrection::None),
        ("paper, 100 points", SampleCorrection::Folded(100)),
        (
            "elastic, standard deviation",
            SampleCorrection::Elastic(Elastic::WITH_STD),
        ),
        (
            "elastic, own-joint curves",
            SampleCorrection::Elastic(Elastic::WITH_CURVES),
        ),
    ] {
        let mut of = |kind: &str, coupled, prismatic| {
            let counts = pose_and_command(
                &mut device,
                Sample {
                    coupled,
                    sliding: usize::from(prismatic),
                    ..Sample::plain(31, correction)
                },
            );
            println!("| {name} | {kind} | {:.0} | {:.0} |", counts[0], counts[1]);
            counts
        };
        let plain = of("revolute", false, false);
        let coupled = of("a parallelogram", true, false);
        let sliding = of("one sliding", false, true);
        for i in 0..2 {
            if coupled[i] - plain[i] > 800.0 || sliding[i] > 1.2 * plain[i] {
                beyond.push((name, plain[i], coupled[i], sliding[i]));
            }
        }
    }
    assert!(beyond.is_empty(), "{beyond:?}");
}

/// The cost of the paper's eq. 7 in addition to a command of its model.
#[test]
fn the_papers_standard_deviation_costs_two_fifths_of_a_command() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("instructions of the standard deviation beside those of a command, Cortex-M4F:");
    for (points, landmarks) in [(100, 48), (100, 24), (300, 48)] {
        let sample = Sample::plain(31, SampleCorrection::Folded(points));
        let [pose, command] = pose_and_command(&mut device, sample);
        let with = Sample {
            landmarks,
            ..sample
        };
        let more = cost(&mut device, with) - pose;
        let share = more / command;
        println!("  {points} points, {landmarks} landmarks: {more:.0} of {command:.0}, {share:.3}");
        assert!(share <= 0.40, "{share}");
        if (points, landmarks) == (100, 48) {
            assert_recorded("standard deviation, paper, 100 points, in addition", more);
        }
    }
}
