//! Compares the committed bits with this crate built alone, without the features that other crates enable.
//!
//! The `tests` package writes and describes the files, and compares the device with them too.

use poegp_protocol::blob;
use poegp_runtime::model::Model;
use poegp_runtime::trace::Stages;

/// Capacity on the smallest machine that must compute these bits (`tests/bits`, 16 kB of RAM).
const WORDS: usize = 512;

/// Returns the groups of hexadecimal words in one line.
fn groups(line: &str) -> Vec<Vec<u32>> {
    let words = |group: &str| {
        group
            .split_whitespace()
            .map(|word| u32::from_str_radix(word, 16).unwrap())
            .collect()
    };
    line.split('|').map(words).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn assert_bits(name: &'static str, bytes: &[u8], text: &str) {
    let of_this = |text: &'static str| {
        let lines = text.lines();
        lines.filter_map(move |line| line.strip_prefix(name)?.strip_prefix(' '))
    };
    let mut trust = of_this(include_str!("../../tests/data/golden_trust.txt"));
    let mut commands = of_this(include_str!("../../tests/data/golden_commands.txt"));
    let mut model = Box::new(Model::<f32, WORDS>::new());
    model.load_decoded(&blob::decode(bytes).unwrap()).unwrap();
    let mut compared = 0;
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let expected = groups(line);
        let asked: Vec<f32> = expected[0].iter().copied().map(f32::from_bits).collect();
        let (payload_kg, joints) = asked.split_last().unwrap();
        let mut stages = Stages::new();
        let result = model.evaluate_in_stages(joints, *payload_kg, &mut stages);
        let pairs = stages.motions().iter().flatten().copied();
        let found = [
            ("sin_cos", bits(&pairs.collect::<Vec<f32>>())),
            ("mean", bits(&stages.mean[..6])),
            ("chain", bits(&stages.chain.to_rows())),
            ("correction", bits(&result.correction.to_array())),
            ("pose", bits(&result.pose.to_rows())),
            ("status", vec![u32::from(result.status.bits())]),
        ];
        for ((stage, found), expected) in found.iter().zip(&expected[1..]) {
            assert_eq!(found, expected, "{stage} of {asked:?}");
        }
        assert_eq!(expected.len(), found.len() + 1);
        let sigma = result
            .position_sigma
            .map_or("-".to_owned(), |s| format!("{:08x}", s.to_bits()));
        let found = format!("{:08x} {sigma}", result.trust.to_bits());
        assert_eq!(Some(found.as_str()), trust.next(), "trust of {asked:?}");
        let corrected = model.correct(joints, *payload_kg);
        let found = [
            bits(&corrected.joints[..joints.len()]),
            bits(&[corrected.position_error]),
            vec![u32::from(corrected.status.bits())],
        ];
        let expected = commands.next().map(groups);
        assert_eq!(
            Some(found.as_slice()),
            expected.as_deref(),
            "command of {asked:?}"
        );
        compared += 1;
    }
    assert_eq!(compared, 100);
}

#[test]
fn shared_hyperparameters() {
    assert_bits(
        "shared",
        include_bytes!("../../tests/data/golden_shared.blob"),
        include_str!("../../tests/data/golden_shared_bits.txt"),
    );
}

#[test]
fn shared_hyperparameters_folded() {
    assert_bits(
        "folded",
        include_bytes!("../../tests/data/golden_folded.blob"),
        include_str!("../../tests/data/golden_folded_bits.txt"),
    );
}

#[test]
fn hyperparameters_per_output_and_coupled_joints() {
    assert_bits(
        "per_output",
        include_bytes!("../../tests/data/golden_per_output.blob"),
        include_str!("../../tests/data/golden_per_output_bits.txt"),
    );
}

#[test]
fn elastic_with_coupled_joints() {
    assert_bits(
        "elastic",
        include_bytes!("../../tests/data/golden_elastic.blob"),
        include_str!("../../tests/data/golden_elastic_bits.txt"),
    );
}

#[test]
fn elastic_with_a_standard_deviation_a_slide_and_coupled_joints() {
    assert_bits(
        "elastic_std",
        include_bytes!("../../tests/data/golden_elastic_std.blob"),
        include_str!("../../tests/data/golden_elastic_std_bits.txt"),
    );
}
