//! The bound on the instructions of a cycle, tested with models of all shapes.

use std::fmt::Write;

use poegp_calibration::device_cost::blob_bytes;
use poegp_protocol::blob;
use poegp_protocol::link::{CycleSettings, Query, Refusal, Request, Response};
use poegp_runtime::model::Model400;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::firmware_build::{Toolchain, firmware};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection, TEXTS, size_of};
use poegp_tests::stages::{CommandBits, Host};
use poegp_trainer::device::error::ClientError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::device;

/// Returns a model of random shape that fits the device.
fn shape(generator: &mut ChaCha8Rng) -> Sample {
    let joints = generator.random_range(1..=8);
    let correction = match generator.random_range(0..10) {
        0 => SampleCorrection::None,
        kind @ 1..=3 => {
            // Rows of `joints + 7` words, of which 5 600 fit.
            let points = generator.random_range(1..=5_600 / (joints + 7));
            match kind {
                1 if (4..8).contains(&joints) => SampleCorrection::Folded(points),
                2 => SampleCorrection::PerOutput(points),
                _ => SampleCorrection::Shared(points),
            }
        }
        _ => SampleCorrection::Elastic(Elastic {
            points: [0, generator.random_range(1..=250)][generator.random_range(0..5).min(1)],
            groups: generator.random_range(1..=8),
            looks_at: generator.random_range(1..=8),
            ripple: generator.random_range(0..=8),
            upright: generator.random_bool(0.7),
            landmarks: 0,
            curve_orders: [0, generator.random_range(1..=64)][generator.random_range(0..2)],
            steep: generator.random_bool(0.15),
        }),
    };
    let correction = match correction {
        SampleCorrection::Elastic(elastic) if elastic.points > 0 && generator.random_bool(0.5) => {
            SampleCorrection::Elastic(Elastic {
                landmarks: generator.random_range(1..=16),
                ..elastic
            })
        }
        other => other,
    };
    let landmarks = match correction {
        SampleCorrection::Folded(_) | SampleCorrection::Shared(_) if generator.random_bool(0.6) => {
            generator.random_range(1..=48)
        }
        _ => 0,
    };
    Sample {
        landmarks,
        joints,
        coupled: joints >= 3 && generator.random_bool(0.3),
        sliding: if joints >= 3 && generator.random_bool(0.4) {
            generator.random_range(1..=joints)
        } else {
            0
        },
        ..Sample::plain(generator.random_range(1..1_000_000), correction)
    }
}

/// Returns the blob of a sample. A coupled sample gets up to three further coupling elements.
fn blob_of(sample: &Sample, generator: &mut ChaCha8Rng) -> Vec<u8> {
    let bytes = sample.blob();
    if !sample.coupled {
        return bytes;
    }
    let mut decoded = blob::decode(&bytes).unwrap();
    let n = sample.joints;
    for _ in 0..generator.random_range(0..=3) {
        let joint = generator.random_range(0..n - 1);
        let serial = generator.random_range(joint + 1..n);
        decoded.robot.coupling[n * serial + joint] = -0.5;
    }
    let mut buffer = vec![0; bytes.len() + 64];
    blob::encode(&decoded, &mut buffer).unwrap().to_vec()
}

/// Returns the largest numbers of instructions: of an evaluation, of a command, of a command with its frame, and of any of
/// command, evaluation and correction with its frame.
fn measured(sample: &Sample, blob: &[u8]) -> [f64; 4] {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    let tick_hz = device.load(blob).unwrap().tick_hz;
    // Zeros, round numbers and singular poses take other branches. A joint beyond the limits comes back unchanged, so both
    // frames contain its bytes; numbers with three zero bytes take longest.
    let special = [0.0, -0.0, 0.5, 1e-6, 1.570_796_4, -1.1, 0.1, 514.0, 2_048.0];
    let special = special.map(|value| Query {
        joints: (0..sample.joints).map(|_| value).collect(),
        payload_kg: value.max(0.0),
    });
    let queries: Vec<Query> = sample.queries(40).into_iter().chain(special).collect();
    let most = |ticks: Vec<u32>| instructions(ticks.into_iter().max().unwrap(), tick_hz);
    // Every query is sent twice, because the filter's first command is a special case.
    let twice = queries.iter().chain(&queries);
    let commands = twice.map(|q| device.command(q).unwrap().ticks);
    let command = most(commands.collect());
    let with_frame = most(vec![device.statistics().unwrap().max_latency_ticks]);
    let poses = queries.iter().map(|q| device.evaluate(q).unwrap().ticks);
    let pose = most(poses.collect());
    for query in &queries {
        device.correct(query).unwrap();
    }
    let any = most(vec![device.statistics().unwrap().max_latency_ticks]);
    [pose, command, with_frame, any]
}

/// Shapes that were not used to find the constants of the bound.
#[test]
fn no_model_takes_more_than_its_bound_and_none_much_less() {
    let mut generator = ChaCha8Rng::seed_from_u64(1_911);
    let mut shares: Vec<[f64; 3]> = Vec::new();
    // With another compiler's code the bound is only approximate.
    let (least, tolerance) = match firmware().unwrap().toolchain {
        Toolchain::Prebuilt { .. } => (0.95, 1.0),
        Toolchain::BuildStd { .. } => (0.85, 1.1),
    };
    println!("| pose | bound | command | bound | with its frames | bound | model |");
    println!("|---|---|---|---|---|---|---|");
    while shares.len() < 60 {
        let sample = shape(&mut generator);
        let blob = blob_of(&sample, &mut generator);
        // Some shapes do not fit the device.
        if Model400::new().load(&blob).is_err() {
            continue;
        }
        let size = size_of(&blob);
        if let (SampleCorrection::Elastic(_), false) = (sample.correction, sample.coupled) {
            // From 128 on, the number of training poses takes two bytes. A sample has as many poses as points.
            let longer = usize::from(sample.points() > 127);
            assert_eq!(blob_bytes(&size, TEXTS) + longer, blob.len(), "{sample:?}");
        }
        let [pose, command, with_frame, any] = measured(&sample, &blob);
        let bounds = [
            size.pose_bound(),
            size.computation_bound(),
            size.command_bound(),
        ];
        let bounds = bounds.map(f64::from);
        println!(
            "| {pose:.0} | {:.0} | {command:.0} | {:.0} | {with_frame:.0} | {:.0} | {sample:?} |",
            bounds[0], bounds[1], bounds[2]
        );
        assert!(
            any <= bounds[2] * tolerance,
            "another request takes {any} instructions: {sample:?}"
        );
        shares.push([
            pose / bounds[0],
            command / bounds[1],
            with_frame / bounds[2],
        ]);
    }
    for (index, what) in ["pose", "command", "command with its frames"]
        .into_iter()
        .enumerate()
    {
        let of = shares.iter().map(|share| share[index]);
        let (lowest, highest) = of.fold((f64::INFINITY, 0.0_f64), |(a, b), s| (a.min(s), b.max(s)));
        println!("{what}: {lowest:.3} to {highest:.3} of the bound");
        assert!(lowest >= least && highest <= tolerance, "{what}");
    }
}

/// Where the standard deviation costs more than a correction, an evaluation is the most expensive request.
#[test]
fn no_evaluation_takes_more_than_the_bound_of_a_command() {
    for (joints, points) in [(1, 1), (1, 20), (2, 1), (3, 1), (6, 1), (8, 1)] {
        let sample = Sample {
            joints,
            landmarks: 48,
            ..Sample::plain(193, SampleCorrection::Shared(points))
        };
        let blob = sample.blob();
        let (size, [pose, command, _, any]) = (size_of(&blob), measured(&sample, &blob));
        let bound = size.command_bound();
        println!("{joints} joints, {points} points: {pose:.0}, {command:.0}, {any:.0} of {bound}");
        assert!(any <= f64::from(bound), "{any} of {bound}");
    }
}

/// A process that depends on all eight joints uses the general loops, and the others use unrolled ones.
#[test]
fn processes_of_eight_joints_are_within_the_bound() {
    let correction = SampleCorrection::Elastic(Elastic {
        looks_at: 8,
        ..Elastic::PLAIN
    });
    let sample = Sample {
        joints: 8,
        ..Sample::plain(194, correction)
    };
    let blob = sample.blob();
    let (size, [pose, command, ..]) = (size_of(&blob), measured(&sample, &blob));
    let bounds = [size.pose_bound(), size.computation_bound()];
    println!("{pose:.0}, {command:.0} of {bounds:?}");
    for (found, bound) in [pose, command].into_iter().zip(bounds.map(f64::from)) {
        assert!(
            (0.95..=1.0).contains(&(found / bound)),
            "{found} of {bound}"
        );
    }
}

/// A model with one instruction too many is refused with both numbers, and the previous model continues.
#[test]
fn a_model_without_time_in_the_cycle_is_refused() {
    let of = |points| Sample::plain(192, SampleCorrection::Folded(points));
    let (small, large) = (of(60), of(100));
    let bound = |sample: &Sample| sample.size().command_bound();
    let mut device = device();
    device.load(&small.blob()).unwrap();
    let before = device.identify().unwrap();
    assert_eq!(
        before.model.as_ref().map(|model| model.instructions),
        Some(bound(&small))
    );
    let allow = |device: &mut Device, max_instructions| {
        let settings = CycleSettings {
            max_instructions,
            ..before.cycle
        };
        device.client().stand_down().unwrap();
        device.request(&Request::ProvisionCycle(settings)).unwrap()
    };
    let too_slow = |sample: &Sample, allowed| Refusal::TooSlow {
        instructions: bound(sample),
        allowed,
    };
    let allowed = bound(&large) * 100 / 101;
    assert!(matches!(allow(&mut device, allowed), Response::Identity(_)));
    // The model can be uploaded but not verified.
    let refused = device
        .client()
        .upload(&large.blob(), &mut |_| ())
        .unwrap_err();
    assert!(
        matches!(&refused, ClientError::Refused(refusal) if *refusal == too_slow(&large, allowed)),
        "{refused}"
    );
    let host = Host::load(&small.blob()).unwrap();
    let runs_on = |device: &mut Device| {
        for query in small.queries(3) {
            let answer = device.correct(&query).unwrap();
            assert_eq!(CommandBits::from(&answer), host.command(&query));
        }
    };
    runs_on(&mut device);
    // The provisioned time cannot be less than the running model needs.
    let less = bound(&small) - 1;
    assert_eq!(
        allow(&mut device, less),
        Response::Refused(too_slow(&small, less))
    );
    runs_on(&mut device);
    // With enough time the model is accepted.
    assert!(matches!(
        allow(&mut device, bound(&large)),
        Response::Identity(_)
    ));
    device.load(&large.blob()).unwrap();
    // The stored model needs less. The provisioned time survives a restart.
    let identity = device.client().restart().unwrap();
    assert_eq!(identity.cycle.max_instructions, bound(&large));
    assert_eq!(identity.model.unwrap().instructions, bound(&large));
}

#[test]
#[ignore = "prints the counts that the terms of the bound are fitted to"]
fn counts() {
    let shapes = std::env::var("POEGP_COST_SHAPES").map_or(300, |n| n.parse().unwrap());
    let seed = std::env::var("POEGP_COST_SEED").map_or(191, |n| n.parse().unwrap());
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    for _ in 0..shapes {
        let sample = shape(&mut generator);
        let blob = blob_of(&sample, &mut generator);
        if Model400::new().load(&blob).is_err() {
            continue;
        }
        let counts = size_of(&blob).counts();
        let found = measured(&sample, &blob);
        let mut line = String::new();
        for value in counts {
            write!(line, "{value},").unwrap();
        }
        println!(
            "DATA {line}{},{},{} # {sample:?}",
            found[0], found[1], found[2]
        );
    }
}
