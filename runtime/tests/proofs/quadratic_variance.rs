//! The predictive variance of the paper's process: against the formula, and as laws for every model and input.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, TaskSpace};
use poegp_protocol::limits::{MAX_TASK_SPACE_LANDMARKS, OUTPUTS};
use poegp_runtime::gp::quadratic_variance::{BLOCK, landmark_words, variance_words};
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::Model;
use poegp_runtime::model::load_error::LoadError;
use proptest::prelude::*;

use crate::arm::{Arm, scattered};
use crate::seeded::config;

/// Capacity for the most landmarks of the longest arm.
const WORDS: usize = 4_096;

/// θ₀, θ₁, θ₂, θ₃ and the noise.
const HYPERPARAMETERS: [f32; 5] = [1.5, 0.3, 0.0, 0.0, 0.2];
const SCALES: [f32; OUTPUTS] = [1e-3, 2e-3, 1.5e-3, 4e-4, 2e-4, 3e-4];

/// The exponent rate of each output when outputs have their own kernels.
const RATES: [f32; OUTPUTS] = [1.0, 0.5, 0.25, 0.8, 0.1, 0.6];

/// Returns the hyperparameters of each output, with its own kernel or with a shared one.
fn hyperparameters(own: bool) -> Vec<[f32; 5]> {
    let of = |c: usize| {
        let [signal, rest @ .., noise] = HYPERPARAMETERS;
        let [a, b, d] = rest;
        [signal * (1.0 + c as f32), a, b, d, noise * (7.0 - c as f32)]
    };
    match own {
        true => (0..OUTPUTS).map(of).collect(),
        false => vec![HYPERPARAMETERS],
    }
}

/// A variance: the inputs of the landmarks, b, and the lower triangle of B.
struct Sample {
    inputs: Vec<Vec<f32>>,
    single: Vec<f32>,
    pairs: Vec<Vec<f32>>,
}

impl Sample {
    fn new(inputs: usize, landmarks: usize) -> Self {
        let mut next = scattered(31 * inputs as u32 + landmarks as u32);
        let size = 2.0 / landmarks.max(1) as f32;
        Self {
            inputs: (0..landmarks)
                .map(|_| (0..inputs).map(|_| next()).collect())
                .collect(),
            single: (0..landmarks).map(|_| size * next()).collect(),
            pairs: (0..landmarks)
                .map(|i| (0..=i).map(|_| size * next()).collect())
                .collect(),
        }
    }

    /// Returns the bytes as a blob stores them.
    fn rows(&self) -> Vec<u8> {
        let mut words: Vec<f32> = Vec::new();
        for input in &self.inputs {
            let mut landmark = input.clone();
            landmark.push(-input.iter().map(|z| z * z).sum::<f32>());
            landmark.resize(landmark_words(input.len()), 0.0);
            words.extend(landmark);
        }
        let blocks = self.inputs.len().div_ceil(BLOCK);
        let single = |i: usize| self.single.get(i).copied().unwrap_or(0.0);
        let pair = |i: usize, j: usize| {
            let row = self.pairs.get(i);
            row.and_then(|row| row.get(j)).copied().unwrap_or(0.0)
        };
        for block in 0..blocks {
            let four = BLOCK * block..BLOCK * (block + 1);
            words.extend(four.clone().map(single));
            for other in (0..=block).map(|other| BLOCK * other) {
                for j in other..other + BLOCK {
                    words.extend(four.clone().map(|i| pair(i, j)));
                }
            }
        }
        words.into_iter().flat_map(f32::to_le_bytes).collect()
    }

    /// Returns u at z, computed with natural exponentials.
    fn unexplained(&self, z: &[f64]) -> f64 {
        let kernel = |input: &Vec<f32>| {
            let square: f64 = input
                .iter()
                .zip(z)
                .map(|(a, b)| (f64::from(*a) - b) * (f64::from(*a) - b))
                .sum();
            libm::exp(-core::f64::consts::LN_2 * square)
        };
        let k: Vec<f64> = self.inputs.iter().map(kernel).collect();
        let mut u = 1.0;
        for i in 0..k.len() {
            u += k[i] * f64::from(self.single[i]);
            for j in 0..=i {
                u += k[i] * k[j] * f64::from(self.pairs[i][j]);
            }
        }
        u.clamp(0.0, 1.0)
    }
}

fn process<'a, 'b>(blob: &'b mut Blob<'a>) -> &'b mut TaskSpace<'a> {
    match &mut blob.correction {
        Correction::TaskSpace(process) => process,
        _ => panic!("another correction"),
    }
}

/// Returns the blob of `arm` with this many landmarks.
fn with_landmarks<'a>(arm: &'a mut Arm, landmarks: usize, rows: &'a [u8]) -> Blob<'a> {
    let mut blob = arm.blob();
    let process = process(&mut blob);
    process.hyperparameters = [HYPERPARAMETERS].into_iter().collect();
    process.output_scale = SCALES;
    process.landmarks = landmarks as u8;
    process.landmark_rows = rows;
    blob
}

fn loaded<T: Scalar>(blob: &Blob<'_>) -> Result<Box<Model<T, WORDS>>, LoadError> {
    let mut model = Box::new(Model::new());
    model.load_decoded(blob).map(|()| model)
}

/// Counts of landmarks that end a block in different ways.
fn counts() -> impl Strategy<Value = usize> {
    prop_oneof![1_usize..=9, Just(MAX_TASK_SPACE_LANDMARKS)]
}

proptest! {
    #![proptest_config(config(92, 1_000))]

    /// ⅓ (Σ V_v + Σ |e_i × p|² V_ω) with V = s² (θ₀ u + σ_n²) of each output and the twist carried to the target. With kernels
    /// per output, the landmarks' kernel has the mean rate, weighted by s² θ₀.
    #[test]
    fn sigma_is_the_formula(
        joints in 1_usize..=8,
        landmarks in counts(),
        own: bool,
        q in prop::array::uniform8(-2.0..2.0_f64),
        m in 0.0..10.0_f64,
    ) {
        let mut arm = Arm::sound(joints, 3);
        arm.task().rates = own.then_some(RATES);
        let sample = Sample::new(joints + 1, landmarks);
        let rows = sample.rows();
        let scale = f64::from(arm.task().input_scale[0]);
        let kinds: Vec<JointKind> = arm.joints.iter().map(|j| j.kind).collect();
        let frames: Vec<Pose<f64>> = arm.calibrated.iter().map(|f| Pose::<f32>::from_rows(f).cast()).collect();
        let poe = poegp_runtime::kinematics::poe::Poe::new(&kinds, &frames).unwrap();
        let mut blob = with_landmarks(&mut arm, landmarks, &rows);
        process(&mut blob).hyperparameters = hyperparameters(own).into_iter().collect();
        let found = loaded::<f64>(&blob).unwrap().evaluate(&q[..joints], m).position_sigma.unwrap();
        let p = poe.forward(&q[..joints]).translation;
        let outputs = hyperparameters(own).into_iter().cycle().zip(SCALES).zip(RATES);
        let (mut prior, mut weighted) = (0.0, 0.0);
        for (([signal, ..], s), rate) in outputs.clone().take(OUTPUTS) {
            let own = f64::from(s) * f64::from(s) * f64::from(signal);
            prior += own;
            weighted += own * f64::from(rate);
        }
        let scale = scale * if own { libm::sqrt(weighted / prior) } else { 1.0 };
        let z: Vec<f64> = q[..joints].iter().chain(&[m]).map(|x| scale * x).collect();
        let unexplained = sample.unexplained(&z);
        let mut square = 0.0;
        for (c, (([signal, .., noise], s), _)) in outputs.take(OUTPUTS).enumerate() {
            let mut moved = nalgebra::Vector3::zeros();
            moved[c % 3] = f64::from(s);
            let moved = if c < 3 { moved } else { moved.cross(&p) };
            square += moved.norm_squared() * (f64::from(signal) * unexplained + f64::from(noise));
        }
        let expected = libm::sqrt(square / 3.0).min(1.0);
        prop_assert!((found / expected - 1.0).abs() < 1e-6, "{found:e} {expected:e}");
        // f32 agrees to four digits.
        let narrow = q.map(|x| x as f32);
        let single = loaded::<f32>(&blob).unwrap().evaluate(&narrow[..joints], m as f32);
        let single = f64::from(single.position_sigma.unwrap());
        prop_assert!((single / expected - 1.0).abs() < 2e-4, "{single:e} {expected:e}");
    }

    /// The landmarks change only σ: pose, correction, status, trust and corrected command keep their bits.
    #[test]
    fn a_variance_changes_sigma_alone(
        joints in 4_usize..=8,
        landmarks in counts(),
        folded: bool,
        q in prop::array::uniform8(-3.0_f32..3.0),
        m in 0.0_f32..12.0,
    ) {
        let mut arm = Arm::sound(joints, 5);
        if folded && joints < 8 {
            arm.task().centre = vec![0.0; joints + 1];
        }
        let rows = Sample::new(joints + 1, landmarks).rows();
        let without = arm.model::<f32>();
        let with = loaded::<f32>(&with_landmarks(&mut arm, landmarks, &rows)).unwrap();
        let (a, b) = (without.evaluate(&q[..joints], m), with.evaluate(&q[..joints], m));
        prop_assert_eq!((a.pose, a.correction, a.status, a.trust), (b.pose, b.correction, b.status, b.trust));
        prop_assert_eq!((a.position_sigma, b.position_sigma.is_some()), (None, true));
        let (a, b) = (without.correct(&q[..joints], m), with.correct(&q[..joints], m));
        prop_assert_eq!(a, b);
        prop_assert_eq!(with.inducing_points(), without.inducing_points());
    }

    /// σ is between 0 and a metre, for every input and every blob that loads.
    #[test]
    fn sigma_is_bounded(
        joints in 1_usize..=8,
        landmarks in counts(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u32>().prop_map(f32::from_bits)), 0..4),
        (signal, noise, scale) in (prop::sample::select(vec![0.0_f32, 1.0, 1e6]), prop::sample::select(vec![0.0_f32, 1e6]), prop::sample::select(vec![0.0_f32, 1.0, 1e6])),
        q in prop::array::uniform8(prop_oneof![-3.0_f32..3.0, -4_096.0_f32..4_096.0]),
        m in prop_oneof![0.0_f32..10.0, 0.0_f32..1e5],
    ) {
        let mut arm = Arm::sound(joints, 3);
        let mut rows = Sample::new(joints + 1, landmarks).rows();
        let words = rows.len() / 4;
        for (index, value) in changes {
            let at = 4 * index.index(words);
            rows[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        let mut blob = with_landmarks(&mut arm, landmarks, &rows);
        let process = process(&mut blob);
        process.hyperparameters = [[signal, 0.3, 0.0, 0.0, noise]].into_iter().collect();
        process.output_scale = [scale; OUTPUTS];
        if let Ok(model) = loaded::<f32>(&blob) {
            let sigma = model.evaluate(&q[..joints], m).position_sigma;
            prop_assert!(sigma.is_none_or(|sigma| (0.0..=1.0).contains(&sigma)), "{sigma:?}");
        }
    }
}

/// Far from all landmarks σ is the prior's; at a landmark that explains everything it is the noise.
#[test]
fn sigma_goes_from_the_noise_to_the_prior() {
    let mut arm = Arm::sound(6, 3);
    let sample = Sample {
        inputs: vec![vec![0.25; 7]],
        single: vec![0.0],
        pairs: vec![vec![-1.0]],
    };
    let rows = sample.rows();
    let mut blob = with_landmarks(&mut arm, 1, &rows);
    process(&mut blob).output_scale = [1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0];
    let model = loaded::<f32>(&blob).unwrap();
    let sigma = |x: f32| model.evaluate(&[x; 6], x).position_sigma.unwrap();
    let expected = |variance: f32| 1e-3 * libm::sqrtf(variance);
    assert!((sigma(0.5) / expected(0.2) - 1.0).abs() < 1e-6);
    assert!((sigma(10.0) / expected(1.7) - 1.0).abs() < 1e-6);
    assert!(sigma(0.6) > sigma(0.5) && sigma(0.7) > sigma(0.6));
    let bad = model.evaluate(&[f32::NAN; 6], 0.5);
    assert_eq!(bad.position_sigma, None);
    let bad = model.evaluate(&[0.5; 6], -1.0);
    assert_eq!(bad.position_sigma, None);
}

#[test]
fn what_is_no_variance_is_refused() {
    let sample = Sample::new(7, 5);
    let rows = sample.rows();
    assert_eq!(rows.len(), 4 * variance_words(7, 5));
    let refused = |change: &dyn Fn(&mut TaskSpace<'_>)| {
        let mut arm = Arm::sound(6, 3);
        let mut blob = with_landmarks(&mut arm, 5, &rows);
        change(process(&mut blob));
        loaded::<f32>(&blob).err()
    };
    assert_eq!(refused(&|_| ()), None);
    let variance = Some(LoadError::Variance);
    for landmarks in [0, 1, 4, 6, MAX_TASK_SPACE_LANDMARKS as u8 + 1] {
        assert_eq!(refused(&|process| process.landmarks = landmarks), variance);
    }
    let per_output = |process: &mut TaskSpace<'_>| {
        process.hyperparameters = [HYPERPARAMETERS; OUTPUTS].into_iter().collect();
    };
    assert_eq!(refused(&per_output), variance);
    // Six kernels with the hyperparameters of only one.
    assert_eq!(refused(&|process| process.rates = Some(RATES)), variance);
    assert_eq!(
        refused(&|process| process.hyperparameters.clear()),
        variance
    );
    for value in [f32::NAN, f32::INFINITY, -1.0, 1.1e6] {
        assert_eq!(
            refused(&|process| process.output_scale[4] = value),
            variance
        );
        assert_eq!(
            refused(&|process| process.hyperparameters[0][4] = value),
            variance
        );
    }
    for (word, value, is_good) in [
        (0, 0.3, false),
        (0, 201.0, false),
        (7, 0.5, false),
        (7, -300.0, false),
        (60, 9e5, true),
        (60, -1.1e6, false),
        (60, f32::NAN, false),
    ] {
        let mut changed = rows.clone();
        changed[4 * word..4 * word + 4].copy_from_slice(&f32::to_le_bytes(value));
        let mut arm = Arm::sound(6, 3);
        let found = loaded::<f32>(&with_landmarks(&mut arm, 5, &changed)).err();
        assert_eq!(found.is_none(), is_good, "{word} {value}");
    }
    // One word more than the capacity.
    const NEEDED: usize = variance_words(7, 5);
    let mut arm = Arm::sound(6, 3);
    let mut small = Model::<f32, { 3 * 13 + NEEDED - 1 }>::new();
    let refused = small.load_decoded(&with_landmarks(&mut arm, 5, &rows));
    let (needed, capacity) = (NEEDED as u32, NEEDED as u32 - 1);
    assert_eq!(
        refused,
        Err(LoadError::InducingPointsTooLarge { needed, capacity })
    );
}
