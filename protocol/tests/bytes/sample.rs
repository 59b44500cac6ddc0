//! The arm of the listings in `tests/data/blob-listings.txt`: a revolute and a prismatic joint, two inducing points.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{
    Blob, Correction, CorrectionLimit, Elastic, FrameSource, Gauge, Geometry, Host, Joint,
    JointKernel, Provenance, Ranges, Ripple, Robot, TaskSpace, Transform, Units, Variance,
};
use poegp_protocol::cause::Causes;

/// The page with the bytes of one example.
pub const BLOB_FORMAT: &str = include_str!("../../../docs/reference/blob-format.md");

/// The bytes of all examples, in pieces.
pub const LISTINGS: &str = include_str!("../../../tests/data/blob-listings.txt");

/// Returns rows of inducing points: three scaled inputs and six weights each.
pub fn rows() -> Vec<u8> {
    let powers = [9, 10, 11, 13, 13, 14].map(|exponent| 1.0 / (1_u32 << exponent) as f32);
    let signs = [1.0, -1.0, 1.0, 1.0, -1.0, 1.0];
    let weight = |c: usize| powers[c] * signs[c];
    let first = [0.0, 0.125, 0.0].into_iter().chain((0..6).map(weight));
    let second = [0.5, 0.0625, 1.25]
        .into_iter()
        .chain((0..6).map(|c| -weight(c)));
    first.chain(second).flat_map(f32::to_le_bytes).collect()
}

/// Returns the arm.
pub fn blob(rows: &[u8]) -> Blob<'_> {
    let constants = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0].map(|factor| factor / 1_024.0);
    let mut affine = constants.map(|constant| [constant, 0.0, 0.0, 0.0]);
    affine[0][3] = -1.0 / 8_192.0;
    Blob {
        robot: Robot {
            name: "ARM",
            serial_number: "7",
            joints: [
                Joint {
                    kind: JointKind::Revolute,
                    limits: Some((-2.5, 2.5)),
                },
                Joint {
                    kind: JointKind::Prismatic,
                    limits: None,
                },
            ]
            .into_iter()
            .collect(),
            coupling: [1.0, 0.0, -1.0, 1.0].into_iter().collect(),
        },
        units: Units::SI,
        ranges: Ranges {
            joints: [(-2.0, 2.0), (0.0, 0.5)].into_iter().collect(),
            payload_kg: Some((0.0, 10.0)),
        },
        geometry: Geometry {
            calibrated: frames(0.507_812_5).into_iter().collect(),
            nominal: frames(0.5).into_iter().collect(),
        },
        correction: Correction::TaskSpace(TaskSpace {
            limit: CorrectionLimit {
                position_m: 0.015_625,
                angle_rad: 0.007_812_5,
            },
            hyperparameters: [[1.0, 0.5, 0.25, 0.0625, 0.015_625]].into_iter().collect(),
            output_scale: [1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4],
            input_scale: [0.5, 0.5, 0.125].into_iter().collect(),
            rates: None,
            affine: affine.map(|values| values.into_iter().collect()),
            rows,
            centre: heapless::Vec::new(),
            landmarks: 0,
            landmark_rows: &[],
        }),
        variance: None,
        warnings: Causes::NONE,
        host: HOST.get_or_init(|| {
            let mut buffer = [0; 512];
            host().encode(&mut buffer).expect("room").to_vec()
        }),
    }
}

static HOST: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();

/// Returns the section for the host of all examples.
pub fn host() -> Host<'static> {
    Host {
        provenance: Provenance {
            method: "paper",
            trainer_version: "0.1.0",
            date: "2026-11-20",
            data_sha256: core::array::from_fn(|index| index as u8),
            training_poses: 300,
        },
        gauge: Gauge {
            instrument_from_base: along([1.0, 2.0, 3.0]),
            flange_from_target: along([0.0, 0.0, 0.0625]),
            base: FrameSource::Grid,
            tool: FrameSource::Stated,
            ranges: [(-1.5, 1.5); 2].into_iter().collect(),
            payload_kg: Some(2.5),
        },
        tools: heapless::Vec::new(),
        accepted: Causes::NONE,
    }
}

/// Returns one landmark of the folded example: z = (1/2, 1/4, 1/2), ½ k − 1¼ k².
pub fn task_space_landmark() -> Vec<u8> {
    let landmark = [0.5, 0.25, 0.5, -0.5625, 0.0, 0.0, 0.0, 0.0];
    let single = [0.5, 0.0, 0.0, 0.0];
    let mut pairs = [0.0; 16];
    pairs[0] = -1.25;
    let words = landmark.into_iter().chain(single).chain(pairs);
    words.flat_map(|word: f32| word.to_le_bytes()).collect()
}

/// Returns the example with its rows as folded ones, and a landmark.
pub fn folded_blob<'a>(rows: &'a [u8], landmark: &'a [u8]) -> Blob<'a> {
    let mut out = blob(rows);
    if let Correction::TaskSpace(task) = &mut out.correction {
        task.centre = [0.5, 0.25, 8.0].into_iter().collect();
        task.landmarks = 1;
        task.landmark_rows = landmark;
    }
    out
}

/// Returns the inducing points of the elastic example: the kernel of joint 1 depends on both joints, that of joint 2 on
/// joint 2 alone.
pub fn elastic_rows() -> Vec<u8> {
    let first = [0.0, 1.0, 0.25, 0.0, 1.0 / 8_192.0];
    let second = [0.25, 0.0, -1.0 / 16_384.0, 0.5, 0.0, 1.0 / 16_384.0];
    let words = first.into_iter().chain(second);
    words.flat_map(|word: f32| word.to_le_bytes()).collect()
}

/// Own-joint curves of one order: 2^-15 rad of sin q and 2^-16 rad of cos q for joint 1, nothing for the prismatic joint.
const CURVES: [u8; 16] = [0, 0, 0, 0x38, 0, 0, 0x80, 0x37, 0, 0, 0, 0, 0, 0, 0, 0];

/// Returns the same arm with an elastic correction.
pub fn elastic_blob(rows: &[u8]) -> Blob<'_> {
    let kernel = |rates: [f32; 2]| JointKernel {
        rates: rates.into_iter().collect(),
        payload_rate: 0.031_25,
        amplitude: 1.0,
        payload_amplitude: 0.015_625,
    };
    let small = 1.0 / 1_048_576.0;
    Blob {
        correction: Correction::Elastic(Elastic {
            limit: CorrectionLimit {
                position_m: 0.015_625,
                angle_rad: 0.007_812_5,
            },
            gravity: [0.0, 0.0, -9.8125],
            links: [[small, 0.0, 0.0], [0.0, small, 0.0], [-small, 0.0, 0.0]]
                .into_iter()
                .collect(),
            payload: [[small, 0.0, 0.0, 0.0], [0.0, small, 0.0, 0.0]]
                .into_iter()
                .collect(),
            ripple: [Ripple {
                joint: 0,
                cycles: 100.0,
                sin: 16.0 * small,
                cos: 0.0,
            }]
            .into_iter()
            .collect(),
            kernels: [kernel([1.0, 0.5]), kernel([0.0, 2.0])]
                .into_iter()
                .collect(),
            group_payloads_kg: [0.0, 10.0].into_iter().collect(),
            sets: [[1, 0], [1, 1]]
                .into_iter()
                .map(|points| points.into_iter().collect())
                .collect(),
            rows,
            curves: &CURVES,
        }),
        ..blob(&[])
    }
}

/// Returns a landmark of the variance example: q = (0, 0.25 m), 10 kg, and the single word of its factor.
pub fn landmark() -> Vec<u8> {
    let words = [0.0, 1.0, 0.25, -0.031_25, 10.0, 0.5];
    words.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// Returns the elastic arm with a variance.
pub fn variance_blob<'a>(rows: &'a [u8], landmark: &'a [u8]) -> Blob<'a> {
    let small = 1.0 / 1_073_741_824.0;
    Blob {
        variance: Some(Variance {
            floor_m2: small,
            noise_m2: 0.5 * small,
            gain: 0.375,
            rates: [1.0, 0.5].into_iter().collect(),
            payload_rate: 0.031_25,
            landmarks: 1,
            rows: landmark,
        }),
        ..elastic_blob(rows)
    }
}

/// Returns the three fixed frames of the chain, the first at height `z`.
fn frames(z: f32) -> [Transform<f32>; 3] {
    let mut quarter_turn = [0.0; 12];
    (quarter_turn[0], quarter_turn[6], quarter_turn[9]) = (1.0, -1.0, 1.0);
    quarter_turn[3] = 0.25;
    [along([0.0, 0.0, z]), quarter_turn, along([0.0, 0.0, 0.125])]
}

/// Returns a translation.
fn along<N: Copy + From<f32>>([x, y, z]: [N; 3]) -> Transform<N> {
    let (i, o) = (N::from(1.0), N::from(0.0));
    [i, o, o, x, o, i, o, y, o, o, i, z]
}
