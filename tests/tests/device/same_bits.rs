//! Host and device compute the same bits, stage by stage, for every kind of model and every input.

use std::collections::HashSet;

use poegp_protocol::blob;
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::{Model, words_for};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection, odd_queries};
use poegp_tests::stages::{self, Host, Stages};

use crate::device;

/// Compares `count` queries of `sample` and the odd queries. Returns how many were within the trained ranges.
fn compare(sample: Sample, count: usize) -> usize {
    let bytes = sample.blob();
    let host = Host::load(&bytes).unwrap();
    let mut device = device();
    device.load(&bytes).unwrap();
    let mut trusted = 0;
    for query in sample.queries(count).into_iter().chain(odd_queries()) {
        let here = host.stages(&query);
        let trace = device.trace(&query).unwrap();
        if let Some(difference) = here.difference(&Stages::from(&trace)) {
            panic!("{sample:?} {query:?}: host and device differ in {difference}");
        }
        assert_eq!(
            host.trust_line(&query),
            stages::trust_line(&trace.evaluation),
            "{sample:?} {query:?}: trust and standard deviation"
        );
        assert!(!here.has_non_finite_answer(), "{sample:?} {query:?}");
        trusted += usize::from(here.status() == Status::OK.bits());
    }
    trusted
}

#[test]
fn shared_hyperparameters() {
    let trusted = compare(Sample::plain(10, SampleCorrection::Shared(300)), 1_000);
    assert!(trusted > 100, "only {trusted} queries were ordinary");
}

/// The standard deviation by eq. 7, with every number of landmarks that ends a loop differently, and with none.
#[test]
fn standard_deviation_in_task_space() {
    for (landmarks, correction) in [
        (1, SampleCorrection::Shared(30)),
        (2, SampleCorrection::Folded(1)),
        (3, SampleCorrection::Folded(40)),
        (4, SampleCorrection::Folded(40)),
        (48, SampleCorrection::Folded(300)),
    ] {
        let sample = Sample {
            landmarks,
            ..Sample::plain(16, correction)
        };
        compare(sample, 200);
        let host = Host::load(&sample.blob()).unwrap();
        let sigmas: HashSet<String> = sample
            .queries(200)
            .iter()
            .map(|query| host.trust_line(query))
            .collect();
        assert!(sigmas.len() > 100, "{} different", sigmas.len());
    }
}

#[test]
fn hyperparameters_per_output() {
    compare(Sample::plain(11, SampleCorrection::PerOutput(300)), 1_000);
}

#[test]
fn chain_alone() {
    compare(Sample::plain(12, SampleCorrection::None), 300);
}

#[test]
fn coupled_joints() {
    let sample = Sample {
        coupled: true,
        ..Sample::plain(13, SampleCorrection::Shared(40))
    };
    compare(sample, 300);
}

#[test]
fn sliding_joint() {
    let sample = Sample {
        sliding: 1,
        ..Sample::plain(14, SampleCorrection::PerOutput(40))
    };
    compare(sample, 300);
}

fn elastic(seed: u64, elastic: Elastic) -> Sample {
    Sample::plain(seed, SampleCorrection::Elastic(elastic))
}

#[test]
fn elastic_arm() {
    let trusted = compare(elastic(16, Elastic::PLAIN), 1_000);
    assert!(trusted > 100, "only {trusted} queries were ordinary");
}

#[test]
fn elastic_with_a_standard_deviation() {
    for (joints, coupled) in [(5, false), (6, true), (7, false)] {
        let sample = Sample {
            joints,
            coupled,
            ..elastic(23, Elastic::WITH_STD)
        };
        compare(sample, 300);
    }
}

#[test]
fn elastic_arms_of_five_and_seven_joints() {
    for joints in [5, 7] {
        let sample = Sample {
            joints,
            ..elastic(18, Elastic::PLAIN)
        };
        compare(sample, 150);
    }
}

/// Uses the loop for any kind of joint.
#[test]
fn elastic_arm_with_a_sliding_joint() {
    let sample = Sample {
        joints: 5,
        sliding: 1,
        ..elastic(19, Elastic::PLAIN)
    };
    compare(sample, 150);
}

/// Uses the loop for every number of joints that a kernel may depend on, and the loop for any kind of joint.
#[test]
fn elastic_arms_whose_kernels_look_at_any_number_of_joints() {
    for (joints, looks_at, prismatic) in [
        (6, 6, false),
        (6, 2, false),
        (7, 7, false),
        (7, 5, false),
        (5, 3, false),
        (5, 4, true),
    ] {
        let kind = Elastic {
            looks_at,
            ..Elastic::PLAIN
        };
        let sample = Sample {
            joints,
            sliding: usize::from(prismatic),
            ..elastic(25, kind)
        };
        compare(sample, 100);
    }
}

#[test]
fn elastic_arm_with_coupled_joints() {
    let sample = Sample {
        coupled: true,
        ..elastic(20, Elastic::PLAIN)
    };
    compare(sample, 300);
}

#[test]
fn elastic_without_process_or_ripple() {
    let bare = Elastic {
        points: 0,
        groups: 0,
        ripple: 0,
        curve_orders: 0,
        steep: false,
        landmarks: 0,
        upright: true,
        looks_at: 1,
    };
    compare(elastic(21, bare), 100);
}

/// The loss of f32 in a position: one blob in both number types on the host.
#[test]
fn f32_is_within_a_micrometre_of_f64() {
    for (joints, coupled, kind) in [
        (6, false, Elastic::PLAIN),
        (7, false, Elastic::PLAIN),
        (5, false, Elastic::PLAIN),
        (6, true, Elastic::PLAIN),
        (7, true, Elastic::WITH_STD),
    ] {
        let sample = Sample {
            joints,
            coupled,
            ..elastic(22, kind)
        };
        let bytes = sample.blob();
        let blob = blob::decode(&bytes).unwrap();
        let (mut single, mut double) = (
            Box::new(Model::<f32, { words_for(300) }>::new()),
            Box::new(Model::<f64, { words_for(300) }>::new()),
        );
        single.load_decoded(&blob).unwrap();
        double.load_decoded(&blob).unwrap();
        let (mut sum, mut worst, mut count) = (0.0, 0.0_f64, 0);
        for query in sample.queries(400) {
            let wide: Vec<f64> = query.joints.iter().copied().map(f64::from).collect();
            let here = single.evaluate(&query.joints, query.payload_kg);
            let there = double.evaluate(&wide, f64::from(query.payload_kg));
            assert_eq!(here.status, there.status, "{query:?}");
            if here.status.is_ok() {
                let off = here.pose.translation.map(f64::from) - there.pose.translation;
                let off = off.iter().map(|x| x * x).sum::<f64>().sqrt();
                (sum, worst, count) = (sum + off, worst.max(off), count + 1);
                assert_eq!((here.trust, there.trust), (1.0, 1.0));
                if let (Some(single), Some(double)) = (here.position_sigma, there.position_sigma) {
                    let off = f64::from(single) / double - 1.0;
                    assert!(off.abs() < 1e-4, "sigma {single} instead of {double}");
                }
                assert_eq!(here.position_sigma.is_some(), kind.landmarks > 0);
            }
        }
        let mean = 1e6 * sum / f64::from(count);
        println!(
            "{joints} joints, {kind:?}: mean {mean:.3}, most {:.3} um",
            1e6 * worst
        );
        assert!(count > 50 && worst < 1e-6, "{count} {worst:e}");
        assert!(mean < 0.5, "{mean}");
    }
}

#[test]
fn evaluation_and_trace_are_one_computation() {
    let sample = Sample::plain(15, SampleCorrection::Shared(30));
    let mut device = device();
    device.load(&sample.blob()).unwrap();
    for query in sample.queries(50) {
        let mut traced = device.trace(&query).unwrap().evaluation;
        let evaluation = device.evaluate(&query).unwrap();
        traced.ticks = evaluation.ticks;
        assert_eq!(format!("{traced:?}"), format!("{evaluation:?}"));
        assert_eq!(
            traced.pose.map(f32::to_bits),
            evaluation.pose.map(f32::to_bits)
        );
    }
}
