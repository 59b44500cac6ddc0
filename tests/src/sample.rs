//! Synthetic arms: plausible chains with random corrections, from a seed.
//!
//! The chain is that of a six-axis arm of 2 m reach (frames similar to those of an ABB IRB 4400, modified
//! Denavit–Hartenberg), with calibrated frames that differ by a few millimetres. The correction has random inducing points
//! and weights, so that every bit of the arithmetic is exercised without a calibration.

use std::f64::consts::{FRAC_PI_2, PI};

use poegp_protocol::JointKind;
use poegp_protocol::blob::{
    self, Blob, Correction, CorrectionLimit, FrameSource, Gauge, Geometry, Host, Joint, Provenance,
    Ranges, Robot, TaskSpace, Transform, Units,
};
use poegp_protocol::cause::{Cause, Causes};
use poegp_protocol::limits::{MAX_FRAMES, MAX_INPUTS, MAX_JOINTS, OUTPUTS};
use poegp_protocol::link::Query;
use poegp_runtime::elastic::position_variance::landmark_words;
use poegp_runtime::gp::quadratic_posterior as posterior;
use poegp_runtime::gp::quadratic_posterior::MeanHeader;
use poegp_runtime::gp::quadratic_variance::{self, variance_words};
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_runtime::model::cost::ModelSize;
use poegp_runtime::model::{Model, words_for};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

mod elastic;

pub use elastic::Elastic;

/// Number of joints of the usual arm, and of every arm with a task-space correction.
pub const JOINTS: usize = 6;
/// Number of inputs of the task-space correction: the joints and the payload.
pub const INPUTS: usize = JOINTS + 1;
/// Number of joints of the longest sample arm.
const MAX_SAMPLE_JOINTS: usize = MAX_JOINTS;

/// Lengths of the texts in a sample's blob: robot name, serial number, model, trainer version, date.
pub const TEXTS: [usize; 5] = [15, 9, 6, 5, 10];

/// Returns the warnings in the blobs of samples.
pub fn warnings() -> Causes {
    [Cause::Still, Cause::Unit].into_iter().collect()
}

/// The description of a sample arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Seed of all random numbers.
    pub seed: u64,
    /// The correction.
    pub correction: SampleCorrection,
    /// Number of joints, one to eight; at least three if a joint slides or is coupled.
    pub joints: usize,
    /// Whether q3 of the serial chain is q3 − q2 of the controller, as in a parallelogram arm.
    pub coupled: bool,
    /// Number of joints that slide instead of turning: joints 3, 1 and 2 first, then 4, 5, ….
    pub sliding: usize,
    /// Number of variance landmarks of a task-space correction; 0 for none.
    pub landmarks: usize,
}

/// The correction of a sample arm, with its number of inducing points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleCorrection {
    /// No correction.
    None,
    /// A task-space correction with one set of hyperparameters, in the difference form.
    Shared(usize),
    /// The same mean as [`SampleCorrection::Shared`], in the folded form.
    Folded(usize),
    /// A task-space correction with hyperparameters for each output.
    PerOutput(usize),
    /// An elastic correction, in joint space.
    Elastic(Elastic),
}

impl Sample {
    /// Creates a six-axis arm with revolute joints and no coupling.
    pub const fn plain(seed: u64, correction: SampleCorrection) -> Self {
        Self {
            seed,
            correction,
            joints: JOINTS,
            coupled: false,
            sliding: 0,
            landmarks: 0,
        }
    }

    fn generator(&self, stream: u64) -> ChaCha8Rng {
        let mut generator = ChaCha8Rng::seed_from_u64(self.seed);
        generator.set_stream(stream);
        generator
    }

    /// Returns the trained range of a joint, in rad or m.
    fn range(&self, joint: usize) -> (f32, f32) {
        if self.kind(joint) == JointKind::Prismatic {
            return (0.0, 0.8);
        }
        [
            (-2.5, 2.5),
            (-1.2, 1.5),
            (-1.0, 1.1),
            (-3.0, 3.0),
            (-1.9, 1.9),
            (-3.1, 3.1),
            (-3.1, 3.1),
            (-2.0, 2.0),
        ][joint]
    }

    fn kind(&self, joint: usize) -> JointKind {
        let order = [2, 0, 1, 3, 4, 5, 6, 7];
        if order[..self.sliding].contains(&joint) {
            JointKind::Prismatic
        } else {
            JointKind::Revolute
        }
    }

    /// Returns the number of inducing points.
    pub fn points(&self) -> usize {
        match self.correction {
            SampleCorrection::None => 0,
            SampleCorrection::Shared(points)
            | SampleCorrection::Folded(points)
            | SampleCorrection::PerOutput(points) => points,
            SampleCorrection::Elastic(elastic) => elastic.points,
        }
    }

    /// Returns the number of bytes of the rows of inducing points.
    fn row_bytes(&self) -> usize {
        4 * match self.correction {
            SampleCorrection::Elastic(elastic) => elastic.row_words(self.joints),
            _ => posterior::row_words(self.joints + 1) * self.points(),
        }
    }

    /// Returns the number of bytes of the landmarks.
    fn landmark_bytes(&self) -> usize {
        match self.correction {
            SampleCorrection::Elastic(elastic) => (0..elastic.landmarks)
                .map(|index| 4 * landmark_words(self.joints, index))
                .sum(),
            _ => 4 * variance_words(self.joints + 1, self.landmarks),
        }
    }

    /// Creates the blob of the arm.
    ///
    /// # Panics
    /// With more inducing points than a blob can describe.
    pub fn blob(&self) -> Vec<u8> {
        let mut generator = self.generator(0);
        let nominal = nominal_frames(self.joints);
        let calibrated: Vec<_> = nominal
            .iter()
            .map(|frame| *frame * Pose::exp(&error(&mut generator)))
            .collect();
        let (mut rows, mut landmarks) = (Vec::new(), Vec::new());
        let curves = match self.correction {
            SampleCorrection::Elastic(elastic) => elastic.curves(self, &mut self.generator(3)),
            _ => Vec::new(),
        };
        let correction = match self.correction {
            SampleCorrection::None => Correction::None,
            SampleCorrection::Shared(count) | SampleCorrection::Folded(count) => {
                let process = self.task_space(&mut generator, count, true, &mut rows);
                Correction::TaskSpace(self.with_variance(process, &mut landmarks))
            }
            SampleCorrection::PerOutput(count) => {
                Correction::TaskSpace(self.task_space(&mut generator, count, false, &mut rows))
            }
            SampleCorrection::Elastic(elastic) => {
                elastic.correction(self, &mut generator, &mut rows, &curves)
            }
        };
        let mut elastic_landmarks = Vec::new();
        let mut host_bytes = [0; 512];
        let host = Host {
            provenance: Provenance {
                method: "sample",
                trainer_version: "0.0.0",
                date: "2026-11-20",
                data_sha256: [0x5a; 32],
                training_poses: self.points() as u32,
            },
            gauge: Gauge {
                instrument_from_base: Pose::<f64>::exp(&Twist::from_array(&[
                    1.5, -2.5, 0.4, 0.0, 0.0, 0.7,
                ]))
                .to_rows(),
                flange_from_target: Pose::<f64>::identity().to_rows(),
                base: FrameSource::Grid,
                tool: FrameSource::Grid,
                ranges: (0..self.joints).map(|_| (-1.5, 1.5)).collect(),
                payload_kg: Some(1.0),
            },
            tools: heapless::Vec::new(),
            accepted: Causes::NONE,
        };
        let blob = Blob {
            robot: Robot {
                name: "Sample IRB 4400",
                serial_number: "4400-0001",
                joints: (0..self.joints)
                    .map(|joint| Joint {
                        kind: self.kind(joint),
                        limits: Some(self.range(joint)),
                    })
                    .collect(),
                coupling: if self.coupled {
                    (0..self.joints * self.joints)
                        .map(|index| match (index / self.joints, index % self.joints) {
                            (row, column) if row == column => 1.0,
                            (2, 1) => -1.0,
                            _ => 0.0,
                        })
                        .collect()
                } else {
                    heapless::Vec::new()
                },
            },
            units: Units::SI,
            ranges: Ranges {
                joints: (0..self.joints).map(|joint| self.range(joint)).collect(),
                payload_kg: Some(PAYLOAD_KG),
            },
            geometry: Geometry {
                calibrated: on_wire(&calibrated),
                nominal: on_wire(&nominal),
            },
            correction,
            warnings: warnings(),
            host: host.encode(&mut host_bytes).expect("room"),
            variance: match self.correction {
                SampleCorrection::Elastic(elastic) => {
                    elastic.variance(self, &mut self.generator(2), &mut elastic_landmarks)
                }
                _ => None,
            },
        };
        let rows = self.row_bytes() + self.landmark_bytes() + curves.len();
        let room = blob::HEADER_LENGTH + blob::MAX_LENGTH_WITHOUT_ROWS + rows;
        let mut buffer = vec![0; room];
        blob::encode(&blob, &mut buffer)
            .expect("MAX_LENGTH_WITHOUT_ROWS covers everything but the rows")
            .to_vec()
    }

    /// Returns the sizes of the arm's model.
    ///
    /// # Panics
    /// When the blob is not a usable model.
    pub fn size(&self) -> ModelSize {
        size_of(&self.blob())
    }

    /// Creates a task-space correction with `count` inducing points and writes the bytes of their rows to `rows`.
    fn task_space<'a>(
        &self,
        generator: &mut ChaCha8Rng,
        count: usize,
        shared: bool,
        rows: &'a mut Vec<u8>,
    ) -> TaskSpace<'a> {
        let inputs = self.joints + 1;
        let input_scale: heapless::Vec<f32, _> = (0..inputs)
            .map(|d| {
                if d == self.joints {
                    0.05
                } else {
                    posterior::input_scale(generator.random_range(0.3..1.2))
                }
            })
            .collect();
        for _ in 0..count {
            for (d, scale) in input_scale.iter().enumerate() {
                let (lower, upper) = if d == self.joints {
                    PAYLOAD_KG
                } else {
                    self.range(d)
                };
                let u = generator.random_range(lower..upper) * scale;
                rows.extend(u.to_le_bytes());
            }
            for output in 0..OUTPUTS {
                // Millimetres and milliradians, so that the sum sometimes exceeds the correction limit.
                let size: f32 = if output < 3 { 2e-3 } else { 1e-3 };
                rows.extend(generator.random_range(-size..size).to_le_bytes());
            }
        }
        let centre = if matches!(self.correction, SampleCorrection::Folded(_)) {
            fold(&input_scale, rows)
        } else {
            heapless::Vec::new()
        };
        TaskSpace {
            limit: CorrectionLimit {
                position_m: 5e-3,
                angle_rad: 5e-3,
            },
            hyperparameters: [[1.0; 5]; OUTPUTS]
                .into_iter()
                .take(if shared { 1 } else { 6 })
                .collect(),
            output_scale: [1.0; OUTPUTS],
            input_scale,
            rates: (!shared).then(|| std::array::from_fn(|_| generator.random_range(0.2..1.0))),
            affine: std::array::from_fn(|_| {
                (0..=inputs)
                    .map(|_| generator.random_range(-1e-4_f32..1e-4))
                    .collect()
            }),
            rows,
            centre,
            landmarks: 0,
            landmark_rows: &[],
        }
    }

    /// Adds the variance landmarks to a task-space correction and writes their bytes to `rows`.
    fn with_variance<'a>(&self, process: TaskSpace<'a>, rows: &'a mut Vec<u8>) -> TaskSpace<'a> {
        let mut generator = self.generator(2);
        let inputs = self.joints + 1;
        for _ in 0..self.landmarks {
            let mut words = vec![0.0_f32; quadratic_variance::landmark_words(inputs)];
            words[..inputs].fill_with(|| generator.random_range(-1.0..1.0));
            words[inputs] = -words.iter().map(|z| z * z).sum::<f32>();
            rows.extend(words.into_iter().flat_map(f32::to_le_bytes));
        }
        while rows.len() < 4 * variance_words(inputs, self.landmarks) {
            // The kernels between poses that are drawn like this are small.
            rows.extend(generator.random_range(-6.0_f32..4.0).to_le_bytes());
        }
        TaskSpace {
            output_scale: std::array::from_fn(|_| generator.random_range(1e-4..1e-3)),
            landmarks: self.landmarks as u8,
            landmark_rows: rows,
            ..process
        }
    }

    /// Returns `count` queries: three of four within the trained ranges, the rest beyond them.
    pub fn queries(&self, count: usize) -> Vec<Query> {
        let mut generator = self.generator(1);
        (0..count)
            .map(|index| {
                let stretch = if index % 4 == 3 { 2.5 } else { 1.0 };
                let mut value = |(lower, upper): (f32, f32)| {
                    stretch * (lower + generator.random_range(0.0..1.0_f32) * (upper - lower))
                };
                Query {
                    joints: (0..self.joints)
                        .map(|joint| value(self.range(joint)))
                        .collect(),
                    payload_kg: value(PAYLOAD_KG),
                }
            })
            .collect()
    }
}

/// Returns the sizes of the model in a blob.
///
/// # Panics
/// When the blob is not a usable model.
pub fn size_of(blob: &[u8]) -> ModelSize {
    let mut model = Box::new(Model::<f32, { words_for(600) }>::new());
    model.load(blob).unwrap_or_else(|error| panic!("{error}"));
    model.size().expect("it was loaded")
}

/// Converts the mean in `rows` to the folded form and returns its centre.
fn fold(input_scale: &[f32], rows: &mut [u8]) -> heapless::Vec<f32, MAX_INPUTS> {
    let words = rows.as_chunks::<4>().0.iter();
    let mut values: Vec<f64> = words
        .map(|word| f64::from(f32::from_le_bytes(*word)))
        .collect();
    let mut header = MeanHeader::<f64>::zero(input_scale.len());
    for (slot, scale) in header.input_scale.iter_mut().zip(input_scale) {
        *slot = f64::from(*scale);
    }
    assert!(
        header.fold(&mut values),
        "the inducing points are too far apart"
    );
    for (word, value) in rows.as_chunks_mut::<4>().0.iter_mut().zip(values) {
        *word = (value as f32).to_le_bytes();
    }
    let centre = header.centre.unwrap_or_default();
    centre
        .iter()
        .take(input_scale.len())
        .map(|c| *c as f32)
        .collect()
}

/// Lightest and heaviest payload, in kg.
const PAYLOAD_KG: (f32, f32) = (0.0, 45.0);

/// Returns invalid and extreme queries.
pub fn odd_queries() -> Vec<Query> {
    let usual = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6];
    let with = |joint: usize, value: f32| {
        let mut joints = usual;
        joints[joint] = value;
        query(&joints, 10.0)
    };
    vec![
        with(0, f32::NAN),
        with(1, f32::INFINITY),
        with(2, f32::NEG_INFINITY),
        with(3, 1e30),
        with(4, -1e30),
        with(5, 4096.0),
        with(5, 4096.5),
        with(0, f32::MIN_POSITIVE),
        with(0, f32::from_bits(1)),
        with(0, -0.0),
        query(&usual, f32::NAN),
        query(&usual, f32::INFINITY),
        query(&usual, -1.0),
        query(&usual, 1e30),
        query(&usual, 100_000.0),
        query(&usual, -0.0),
        query(&[0.0; JOINTS], 0.0),
        query(&usual[..5], 0.0),
        query(&[], 0.0),
        query(&[0.0; 8], 0.0),
    ]
}

fn query(joints: &[f32], payload_kg: f32) -> Query {
    Query {
        joints: joints.iter().copied().collect(),
        payload_kg,
    }
}

/// Returns `parent_from_joint` of the nominal chain with `joints` joints, and its tool: rotation about x, then translation
/// along x and z.
fn nominal_frames(joints: usize) -> Vec<Pose<f64>> {
    let chain: [(f64, f64, f64); MAX_SAMPLE_JOINTS] = [
        (0.0, 0.0, 0.68),
        (-FRAC_PI_2, 0.2, 0.0),
        (0.0, 0.89, 0.0),
        (-FRAC_PI_2, 0.15, 0.88),
        (FRAC_PI_2, 0.0, 0.0),
        (-FRAC_PI_2, 0.0, 0.14),
        (FRAC_PI_2, 0.05, 0.1),
        (-FRAC_PI_2, 0.1, 0.05),
    ];
    let tool = (PI / 6.0, 0.1, 0.2);
    let frames = chain.into_iter().take(joints).chain([tool]);
    frames
        .map(|(turn, along_x, along_z)| {
            Pose::exp(&Twist::from_array(&[0.0, 0.0, 0.0, turn, 0.0, 0.0]))
                * Pose::exp(&Twist::from_array(&[along_x, 0.0, along_z, 0.0, 0.0, 0.0]))
        })
        .collect()
}

/// Returns a random twist of up to two millimetres and milliradians in each component.
fn error(generator: &mut ChaCha8Rng) -> Twist<f64> {
    Twist::from_array(&std::array::from_fn(|_| {
        generator.random_range(-2e-3..2e-3)
    }))
}

fn on_wire(frames: &[Pose<f64>]) -> heapless::Vec<Transform<f32>, MAX_FRAMES> {
    frames.iter().map(|frame| frame.cast().to_rows()).collect()
}
