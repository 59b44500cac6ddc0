//! The committed bits: the host in debug and in release and the device must all give the bits of the same files.
//!
//! `POEGP_BLESS=1` rewrites the files. They change only when the arithmetic changes.

use std::path::PathBuf;
use std::sync::Once;
use std::{env, fs};

use poegp_protocol::link::Query;
use poegp_tests::device::Device;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection, odd_queries};
use poegp_tests::stages::{self, CommandBits, Host, Stages};
use poegp_tests::workspace;

use crate::device;

/// Names of the files, with the arms that they contain.
const CASES: [(&str, Sample); 8] = [
    ("shared", Sample::plain(20, SampleCorrection::Shared(24))),
    (
        "folded",
        Sample {
            landmarks: 6,
            ..Sample::plain(25, SampleCorrection::Folded(24))
        },
    ),
    (
        "per_output",
        Sample {
            coupled: true,
            ..Sample::plain(21, SampleCorrection::PerOutput(24))
        },
    ),
    (
        "elastic",
        Sample {
            coupled: true,
            ..Sample::plain(22, SampleCorrection::Elastic(small(Elastic::PLAIN)))
        },
    ),
    (
        "elastic_std",
        Sample {
            coupled: true,
            sliding: 1,
            ..Sample::plain(24, SampleCorrection::Elastic(small(Elastic::WITH_STD)))
        },
    ),
    (
        "elastic_curve",
        Sample {
            coupled: true,
            ..Sample::plain(28, SampleCorrection::Elastic(small(CURVE)))
        },
    ),
    // Of the usual size, with an odd number of points. The smallest machines of `tests/machines/run` leave these out.
    (
        "full_shared",
        Sample {
            landmarks: 14,
            ..Sample::plain(26, SampleCorrection::Shared(299))
        },
    ),
    (
        "full_elastic",
        Sample::plain(
            27,
            SampleCorrection::Elastic(Elastic {
                points: 201,
                ..Elastic::PLAIN
            }),
        ),
    ),
];

/// With landmarks after the curves.
const CURVE: Elastic = Elastic {
    curve_orders: 12,
    ..Elastic::WITH_STD
};

/// Returns an elastic correction with fewer points than payload groups, so that some groups are empty.
const fn small(elastic: Elastic) -> Elastic {
    Elastic {
        points: 24,
        // Upright and not upright.
        upright: elastic.landmarks > 0,
        ..elastic
    }
}

fn queries(sample: &Sample) -> Vec<Query> {
    sample
        .queries(if sample.points() > 100 { 20 } else { 80 })
        .into_iter()
        .chain(odd_queries())
        .collect()
}

fn text(name: &str, stages: &mut dyn FnMut(&Query) -> Stages, queries: &[Query]) -> String {
    let head = format!(
        "# Bits of golden_{name}.blob, written by POEGP_BLESS=1 cargo test -p poegp-tests --test device golden\n\
         # joints payload | sin_cos | mean | chain | correction | pose | status\n"
    );
    let lines = queries.iter().map(|query| stages(query).line(query) + "\n");
    std::iter::once(head).chain(lines).collect()
}

/// Returns the files of the committed blob and its bits; with `POEGP_BLESS` they are written first.
fn files(name: &str) -> (PathBuf, PathBuf) {
    static BLESSED: Once = Once::new();
    BLESSED.call_once(|| {
        if env::var_os("POEGP_BLESS").is_some() {
            for (name, sample) in CASES {
                let (blob, bits) = paths(name);
                fs::write(blob, sample.blob()).unwrap();
                fs::write(bits, on_host(name, &sample)).unwrap();
            }
            fs::write(trust_path(), trust_on_host()).unwrap();
            fs::write(commands_path(), commands_on_host()).unwrap();
        }
    });
    paths(name)
}

fn paths(name: &str) -> (PathBuf, PathBuf) {
    let directory = workspace().join("tests/data");
    (
        directory.join(format!("golden_{name}.blob")),
        directory.join(format!("golden_{name}_bits.txt")),
    )
}

fn on_host(name: &str, sample: &Sample) -> String {
    let host = Host::load(&sample.blob()).unwrap();
    text(name, &mut |query| host.stages(query), &queries(sample))
}

fn trust_path() -> PathBuf {
    workspace().join("tests/data/golden_trust.txt")
}

/// Returns the trust and standard deviation for every query of every case. `answer` gets the name of the case and the
/// query.
fn trust_text(answer: &mut dyn FnMut(&str, &Query) -> String) -> String {
    let mut out = "# Bits of trust and standard deviation for the queries of golden_*_bits.txt, in order; written like them.\n\
         # case trust sigma\n"
        .to_owned();
    for (name, sample) in CASES {
        for query in queries(&sample) {
            out += &format!("{name} {}\n", answer(name, &query));
        }
    }
    out
}

fn trust_on_host() -> String {
    let hosts = CASES.map(|(name, sample)| (name, Host::load(&sample.blob()).unwrap()));
    trust_text(&mut |name, query| {
        let (_, host) = hosts.iter().find(|(of, _)| *of == name).unwrap();
        host.trust_line(query)
    })
}

fn commands_path() -> PathBuf {
    workspace().join("tests/data/golden_commands.txt")
}

/// Returns the corrected commands for every query of every case.
fn commands_text(answer: &mut dyn FnMut(&str, &Query) -> CommandBits) -> String {
    let mut out = "# Bits of corrected commands for the queries of golden_*_bits.txt, in order; written like them.\n\
         # case joints | position error | status\n"
        .to_owned();
    for (name, sample) in CASES {
        for query in queries(&sample) {
            out += &format!("{name} {}\n", answer(name, &query).line());
        }
    }
    out
}

fn commands_on_host() -> String {
    let hosts = CASES.map(|(name, sample)| (name, Host::load(&sample.blob()).unwrap()));
    commands_text(&mut |name, query| {
        let (_, host) = hosts.iter().find(|(of, _)| *of == name).unwrap();
        host.command(query)
    })
}

fn assert_same_lines(name: &str, found: &str, expected: &str) {
    for (number, (found, expected)) in found.lines().zip(expected.lines()).enumerate() {
        assert_eq!(found, expected, "{name}, line {}", number + 1);
    }
    assert_eq!(found.lines().count(), expected.lines().count());
}

#[test]
fn host_computes_the_committed_bits() {
    for (name, sample) in CASES {
        let (blob, bits) = files(name);
        assert!(
            fs::read(blob).unwrap() == sample.blob(),
            "the blob of {name} is not the committed one"
        );
        let expected = fs::read_to_string(bits).unwrap();
        assert_same_lines(name, &on_host(name, &sample), &expected);
    }
}

#[test]
fn host_computes_the_committed_trust() {
    files("shared");
    let expected = fs::read_to_string(trust_path()).unwrap();
    assert_same_lines("golden_trust", &trust_on_host(), &expected);
}

#[test]
fn host_computes_the_committed_commands() {
    files("shared");
    let expected = fs::read_to_string(commands_path()).unwrap();
    assert_same_lines("golden_commands", &commands_on_host(), &expected);
}

/// Compares the bits of a board with the committed ones. `load` loads a model there.
pub fn compare_with_committed(device: &mut Device, load: &mut dyn FnMut(&mut Device, &[u8])) {
    for (name, sample) in CASES {
        let (blob, bits) = files(name);
        load(device, &fs::read(blob).unwrap());
        let mut on_device = |query: &Query| Stages::from(&device.trace(query).unwrap());
        let found = text(name, &mut on_device, &queries(&sample));
        assert_same_lines(name, &found, &fs::read_to_string(bits).unwrap());
    }
}

#[test]
fn device_computes_the_committed_bits() {
    compare_with_committed(&mut device(), &mut |device, blob| {
        device.load(blob).unwrap();
    });
}

#[test]
fn device_computes_the_committed_trust() {
    let mut device = device();
    let mut loaded = String::new();
    let found = trust_text(&mut |name, query| {
        if loaded != name {
            device.load(&fs::read(files(name).0).unwrap()).unwrap();
            name.clone_into(&mut loaded);
        }
        stages::trust_line(&device.evaluate(query).unwrap())
    });
    let expected = fs::read_to_string(trust_path()).unwrap();
    assert_same_lines("golden_trust", &found, &expected);
}

#[test]
fn device_computes_the_committed_commands() {
    let mut device = device();
    let mut loaded = String::new();
    let found = commands_text(&mut |name, query| {
        if loaded != name {
            device.load(&fs::read(files(name).0).unwrap()).unwrap();
            name.clone_into(&mut loaded);
        }
        CommandBits::from(&device.correct(query).unwrap())
    });
    let expected = fs::read_to_string(commands_path()).unwrap();
    assert_same_lines("golden_commands", &found, &expected);
}
