//! Host and device compute the same bits, stage by stage, for every kind of model and every input.

use poegp_runtime::status::Status;
use poegp_tests::sample::{Sample, Support, odd_queries};
use poegp_tests::stages::{Host, Stages};

use crate::device;

/// Compares `count` queries of `sample` and the odd ones; returns how many were within the trained ranges.
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
        assert!(!here.has_non_finite_answer(), "{sample:?} {query:?}");
        trusted += usize::from(here.status() == Status::OK.bits());
    }
    trusted
}

#[test]
fn shared_hyperparameters() {
    let trusted = compare(Sample::plain(10, Support::Shared(300)), 1_000);
    assert!(trusted > 100, "only {trusted} queries were ordinary");
}

#[test]
fn hyperparameters_per_output() {
    compare(Sample::plain(11, Support::PerOutput(300)), 1_000);
}

#[test]
fn chain_alone() {
    compare(Sample::plain(12, Support::None), 300);
}

#[test]
fn coupled_joints() {
    let sample = Sample {
        coupled: true,
        ..Sample::plain(13, Support::Shared(40))
    };
    compare(sample, 300);
}

#[test]
fn sliding_joint() {
    let sample = Sample {
        prismatic: true,
        ..Sample::plain(14, Support::PerOutput(40))
    };
    compare(sample, 300);
}

#[test]
fn evaluation_and_trace_are_one_computation() {
    let sample = Sample::plain(15, Support::Shared(30));
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
