//! The innermost loops in assembly and from portable source give the same bits; and the cost of each.
//!
//! Three images of the firmware answer the same queries: with loops for a Cortex-M4F, for a Cortex-M55, and from portable
//! source (feature `portable-kernels`).

use poegp_protocol::link::Query;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, Machine, instructions};
use poegp_tests::firmware_build::{Board, Variant, firmware_with};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection, odd_queries};
use poegp_tests::stages::{CommandBits, Host, Stages, trust_line};

use crate::golden::compare_with_committed;

/// In assembly for a Cortex-M4F, from portable source, and in assembly for a Cortex-M55.
const KERNELS: [(Board, Variant); 3] = [
    (Board::Mps2An386, Variant::Product),
    (Board::Mps2An386, Variant::PortableKernels),
    (Board::Mps3An547, Variant::Product),
];

fn start((board, kernels): (Board, Variant), clock: Clock) -> Device {
    let machine = Machine {
        board,
        elf: &firmware_with(board, kernels)
            .unwrap_or_else(|error| panic!("{error}"))
            .elf,
        clock,
        flash_image: None,
    };
    Device::on(&machine).unwrap()
}

fn all(clock: Clock) -> [Device; 3] {
    KERNELS.map(|kernels| start(kernels, clock))
}

fn compare(devices: &mut [Device; 3], sample: Sample, queries: &[Query]) {
    let bytes = sample.blob();
    let host = Host::load(&bytes).unwrap();
    for (device, kernels) in devices.iter_mut().zip(KERNELS) {
        device.load(&bytes).unwrap();
        for query in queries {
            let trace = device.trace(query).unwrap();
            if let Some(difference) = host.stages(query).difference(&Stages::from(&trace)) {
                panic!("{kernels:?}, {sample:?}, {query:?}: the host differs in {difference}");
            }
            assert_eq!(
                host.trust_line(query),
                trust_line(&trace.evaluation),
                "{kernels:?}, {sample:?}, {query:?}: trust and standard deviation"
            );
        }
        // No cycles come while the other devices answer, and the watchdog must not restart this one for that.
        device.client().stand_down().unwrap();
    }
}

#[test]
fn portable_kernels_give_the_committed_bits() {
    let mut device = start(KERNELS[1], Clock::Real);
    compare_with_committed(&mut device, &mut |device, blob| {
        device.load(blob).unwrap();
    });
}

#[test]
fn the_same_bits_for_a_thousand_queries() {
    let mut devices = all(Clock::Real);
    for (seed, correction) in [
        (40, SampleCorrection::Folded(300)),
        (41, SampleCorrection::Shared(300)),
        (42, SampleCorrection::Elastic(Elastic::PLAIN)),
        (43, SampleCorrection::Elastic(Elastic::WITH_STD)),
    ] {
        let sample = Sample::plain(seed, correction);
        let queries: Vec<Query> = sample
            .queries(1_000)
            .into_iter()
            .chain(odd_queries())
            .collect();
        compare(&mut devices, sample, &queries);
    }
}

/// The paper's folded mean on random rows, with every length of a row and numbers of rows around the loop's step.
#[test]
fn the_same_bits_for_every_shape_of_rows() {
    let mut devices = all(Clock::Real);
    let counts = [0, 1, 2, 3, 4, 31, 32, 33, 34, 65, 97];
    for (index, points) in counts.into_iter().enumerate() {
        for joints in [4, 5, 6, 7] {
            let seed = 50 + 10 * index as u64 + joints as u64;
            let sample = Sample {
                joints,
                ..Sample::plain(seed, SampleCorrection::Folded(points))
            };
            compare(&mut devices, sample, &sample.queries(4));
        }
    }
}

/// The standard deviation of the paper's process, with landmarks of both lengths and every remainder of the blocks of four.
#[test]
fn the_same_bits_for_every_shape_of_landmarks() {
    let mut devices = all(Clock::Real);
    for joints in [4, 6, 7] {
        for landmarks in [1, 2, 3, 4, 5, 7, 8, 10, 48] {
            let seed = 700 + (50 * joints + landmarks) as u64;
            let sample = Sample {
                joints,
                landmarks,
                ..Sample::plain(seed, SampleCorrection::Folded(5))
            };
            compare(&mut devices, sample, &sample.queries(8));
        }
    }
}

/// Sines and cosines in every quadrant, at and near multiples of π/4, of huge angles, zeros and denormal numbers, for every
/// number of joints.
#[test]
fn the_same_bits_for_every_angle() {
    let mut devices = all(Clock::Real);
    let mut angles = vec![0.0, -0.0, f32::MIN_POSITIVE, 4_096.0, -4_096.0];
    for bits in [1, 2, 0x0040_0000, 0x007f_ffff, 0x0080_0001, 0x1fff_ffff] {
        angles.extend([f32::from_bits(bits), -f32::from_bits(bits)]);
    }
    for eighth in (0..17).chain([1_000, 5_213]) {
        let angle = eighth as f32 * core::f32::consts::FRAC_PI_4;
        for beside in [angle.next_down(), angle, angle.next_up(), angle + 0.3] {
            angles.extend([beside, -beside]);
        }
    }
    for joints in 1..=7 {
        let sample = Sample {
            joints,
            ..Sample::plain(60 + joints as u64, SampleCorrection::None)
        };
        let queries: Vec<Query> = angles
            .windows(joints)
            .step_by(joints.min(3))
            .map(|joints| Query {
                joints: joints.iter().copied().collect(),
                payload_kg: 0.0,
            })
            .collect();
        compare(&mut devices, sample, &queries);
    }
}

/// Own-joint curves with orders that leave every remainder of the loops' step: poses, and commands, which use the slopes.
#[test]
fn the_same_bits_for_every_number_of_orders() {
    let mut devices = all(Clock::Real);
    for curve_orders in (1..=17).chain([63, 64]) {
        let correction = SampleCorrection::Elastic(Elastic {
            points: 6,
            groups: 1,
            ripple: 1,
            curve_orders,
            ..Elastic::PLAIN
        });
        let sample = Sample::plain(80 + curve_orders as u64, correction);
        let queries = sample.queries(3);
        compare(&mut devices, sample, &queries);
        let host = Host::load(&sample.blob()).unwrap();
        for (device, kernels) in devices.iter_mut().zip(KERNELS) {
            for query in &queries {
                let found = CommandBits::from(&device.correct(query).unwrap());
                assert_eq!(
                    host.command(query),
                    found,
                    "{kernels:?}, {curve_orders} orders, {query:?}"
                );
            }
            device.client().stand_down().unwrap();
        }
    }
}

/// Inducing points whose kernels depend on one or more joints, with zero, one, an odd and an even number in a payload
/// group.
#[test]
fn the_same_bits_for_every_shape_of_sets() {
    let mut devices = all(Clock::Real);
    for joints in [4, 5, 6, 7, 8] {
        for looks_at in 1..=joints {
            // Rows of a group: about 0 or 1, 1, 2, 3, 5 or 6.
            for (points, groups) in [
                (3, 2),
                (joints, 1),
                (2 * joints, 1),
                (6 * joints, 2),
                (joints * 11, 2),
            ] {
                let seed = 900 + (100 * joints + 10 * looks_at) as u64;
                let correction = SampleCorrection::Elastic(Elastic {
                    points,
                    groups,
                    ripple: 0,
                    looks_at,
                    ..Elastic::PLAIN
                });
                let sample = Sample {
                    joints,
                    ..Sample::plain(seed, correction)
                };
                compare(&mut devices, sample, &sample.queries(4));
            }
        }
    }
}

/// Returns the mean instructions for queries within the trained ranges.
fn cost(device: &mut Device, sample: Sample) -> f64 {
    device.load(&sample.blob()).unwrap();
    let tick_hz = device.identify().unwrap().tick_hz;
    let queries = sample.queries(9);
    let ticks = queries
        .iter()
        .map(|query| device.evaluate(query).unwrap().ticks);
    ticks.map(|ticks| instructions(ticks, tick_hz)).sum::<f64>() / queries.len() as f64
}

#[test]
fn instructions_of_all_kernels() {
    let mut devices = all(Clock::Counting);
    let elastic = |joints, elastic| Sample {
        joints,
        ..Sample::plain(31, SampleCorrection::Elastic(elastic))
    };
    // Limits of one whole evaluation: assembly, portable source, Cortex-M55.
    let cases = [
        (
            "paper, 300 points, folded",
            Sample::plain(30, SampleCorrection::Folded(300)),
            [15_000.0, 20_000.0, 6_000.0],
        ),
        (
            "paper, 300 points, differences",
            Sample::plain(30, SampleCorrection::Shared(300)),
            [25_000.0; 3],
        ),
        (
            "elastic, 200 points",
            elastic(6, Elastic::PLAIN),
            [14_000.0, 17_500.0, 8_400.0],
        ),
        (
            "five joints",
            elastic(5, Elastic::PLAIN),
            [f64::INFINITY; 3],
        ),
        (
            "seven joints",
            elastic(7, Elastic::PLAIN),
            [f64::INFINITY; 3],
        ),
    ];
    println!("instructions of one evaluation (limit):");
    println!("| model | Cortex-M4F | portable loops | Cortex-M55 |");
    println!("|---|---|---|---|");
    let mut beyond = Vec::new();
    for (name, sample, limits) in cases {
        let counts = [0, 1, 2].map(|index| cost(&mut devices[index], sample));
        let cells: Vec<String> = counts
            .iter()
            .zip(limits)
            .map(|(count, limit)| format!("{count:.0} ({limit:.0})"))
            .collect();
        println!("| {name} | {} |", cells.join(" | "));
        if counts
            .iter()
            .zip(limits)
            .any(|(count, limit)| *count > limit)
        {
            beyond.push((name, counts));
        }
        // Code without a loop in assembly costs the same, except for the resolution of the tick counter.
        let [assembly, portable, _] = counts;
        assert!(assembly <= portable + 10.0, "{name}: {assembly} {portable}");
    }
    assert!(beyond.is_empty(), "{beyond:?}");
}
