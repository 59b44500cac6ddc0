//! The committed bits. Host in debug, host in release and the device each meet the same file, and so each other.
//!
//! `POEGP_BLESS=1` writes the files anew. They change when the arithmetic changes, and only then.

use std::{env, fs};

use poegp_protocol::link::Query;
use poegp_tests::sample::{Sample, Support, odd_queries};
use poegp_tests::stages::{Host, Stages};
use poegp_tests::workspace;

use crate::device;

/// Name of the files, and what is in them.
const CASES: [(&str, Sample); 2] = [
    ("shared", Sample::plain(20, Support::Shared(24))),
    (
        "per_output",
        Sample {
            coupled: true,
            ..Sample::plain(21, Support::PerOutput(24))
        },
    ),
];

fn queries(sample: &Sample) -> Vec<Query> {
    sample
        .queries(80)
        .into_iter()
        .chain(odd_queries())
        .collect()
}

fn text(name: &str, stages: &mut dyn FnMut(&Query) -> Stages, queries: &[Query]) -> String {
    let head = format!(
        "# Bits of {name}.blob, written by POEGP_BLESS=1 cargo test -p poegp-tests --test device golden\n\
         # joints payload | sin_cos | kernel_hash | mean | chain | correction | pose | status\n"
    );
    let lines = queries.iter().map(|query| stages(query).line(query) + "\n");
    std::iter::once(head).chain(lines).collect()
}

fn assert_same_lines(name: &str, found: &str, expected: &str) {
    for (number, (found, expected)) in found.lines().zip(expected.lines()).enumerate() {
        assert_eq!(found, expected, "{name}_bits.txt, line {}", number + 1);
    }
    assert_eq!(found.lines().count(), expected.lines().count());
}

#[test]
fn host_computes_the_committed_bits() {
    let directory = workspace().join("tests/data");
    for (name, sample) in CASES {
        let blob = directory.join(format!("golden_{name}.blob"));
        let bits = directory.join(format!("golden_{name}_bits.txt"));
        let host = Host::load(&sample.blob()).unwrap();
        let found = text(
            &format!("golden_{name}"),
            &mut |query| host.stages(query),
            &queries(&sample),
        );
        if env::var_os("POEGP_BLESS").is_some() {
            fs::write(&blob, sample.blob()).unwrap();
            fs::write(&bits, &found).unwrap();
        }
        assert!(
            fs::read(&blob).unwrap() == sample.blob(),
            "the blob of {name} is not the committed one"
        );
        assert_same_lines(name, &found, &fs::read_to_string(&bits).unwrap());
    }
}

#[test]
fn device_computes_the_committed_bits() {
    let mut device = device();
    let directory = workspace().join("tests/data");
    for (name, sample) in CASES {
        device
            .load(&fs::read(directory.join(format!("golden_{name}.blob"))).unwrap())
            .unwrap();
        let found = text(
            &format!("golden_{name}"),
            &mut |query| Stages::from(&device.trace(query).unwrap()),
            &queries(&sample),
        );
        let expected = fs::read_to_string(directory.join(format!("golden_{name}_bits.txt")));
        assert_same_lines(name, &found, &expected.unwrap());
    }
}
