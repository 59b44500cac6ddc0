//! The models of a soak, with the answers of each.

use poegp_protocol::blob;
use poegp_protocol::link::Query;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::{CommandBits, Host};

/// A model and its answers.
pub struct Known {
    /// Its blob.
    pub bytes: Vec<u8>,
    /// CRC by which the device names it.
    pub crc: u32,
    /// The corrected command of each query.
    pub answers: Vec<CommandBits>,
    /// Number of its answers that have arrived.
    pub seen: usize,
}

/// Returns three models of different kinds.
pub fn models(queries: &[Query]) -> Vec<Known> {
    let small = |elastic: Elastic| Elastic {
        points: 12,
        groups: 3,
        ..elastic
    };
    let corrections = [
        SampleCorrection::Elastic(small(Elastic::PLAIN)),
        SampleCorrection::Elastic(small(Elastic::WITH_STD)),
        SampleCorrection::Shared(20),
    ];
    let known = corrections.into_iter().zip(80..).map(|(correction, seed)| {
        let bytes = Sample::plain(seed, correction).blob();
        let host = Host::load(&bytes).unwrap();
        Known {
            crc: blob::stored_crc(&bytes).unwrap(),
            answers: queries.iter().map(|query| host.command(query)).collect(),
            bytes,
            seen: 0,
        }
    });
    known.collect()
}
