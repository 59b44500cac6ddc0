//! A whole evaluation and a whole corrected command in `f32`, compared with the same model in `f64`, over the trained ranges.
//!
//! Both models have the numbers of the same blob, which are exact in `f64`, so only the arithmetic differs. The trainer tests
//! what rounding a fitted model to `f32` adds (`calibration/tests/fidelity/single_precision.rs`), and `calibrate` refuses to
//! write a blob that loses too much.

use poegp_protocol::blob;
use poegp_runtime::model::{Model, words_for};

use crate::sweep::{Random, exhaustive};

/// Largest errors: of a pose in µm and µrad, and of the position at a corrected command in µm.
struct Allowed {
    name: &'static str,
    bytes: &'static [u8],
    position: f64,
    rotation: f64,
    command: f64,
}

macro_rules! model {
    ($name:literal, $position:literal, $rotation:literal, $command:literal) => {
        Allowed {
            name: $name,
            bytes: include_bytes!(concat!("../../../tests/data/golden_", $name, ".blob")),
            position: $position,
            rotation: $rotation,
            command: $command,
        }
    };
}

/// The golden models. Their arms reach 2 m, where an ulp is 0.12 to 0.24 µm. A corrected command of an elastic model may be off
/// by more than the 5 µm that the runtime states, in `f64` as well: the last step takes the deflection as constant, and these
/// random deflections change fast.
const MODELS: [Allowed; 7] = [
    model!("shared", 1.0, 0.4, 5.5),
    model!("folded", 1.0, 0.4, 5.5),
    model!("per_output", 1.0, 0.4, 5.5),
    model!("elastic", 1.0, 0.4, 5.0),
    model!("elastic_std", 1.0, 0.4, 5.0),
    model!("full_shared", 1.0, 0.4, 5.5),
    model!("full_elastic", 1.0, 0.4, 5.0),
];

type Loaded<T> = Box<Model<T, { words_for(300) }>>;

#[test]
fn poses_and_commands() {
    let count = if exhaustive() { 200_000 } else { 500 };
    for allowed in &MODELS {
        let blob = blob::decode(allowed.bytes).unwrap();
        let mut single: Loaded<f32> = Box::new(Model::new());
        let mut double: Loaded<f64> = Box::new(Model::new());
        single.load_decoded(&blob).unwrap();
        double.load_decoded(&blob).unwrap();
        let payload = blob.ranges.payload_kg.unwrap();
        let mut random = Random(11);
        let mut draw =
            |(lower, upper): (f32, f32)| random.between(f64::from(lower), f64::from(upper)) as f32;
        let (mut sum, mut position, mut rotation) = (0.0, 0.0_f64, 0.0_f64);
        let (mut command, mut command_of_double, mut corrected) = (0.0_f64, 0.0_f64, 0_u32);
        for _ in 0..count {
            let joints: Vec<f32> = blob.ranges.joints.iter().copied().map(&mut draw).collect();
            let payload_kg = draw(payload);
            let exact: Vec<f64> = joints.iter().copied().map(f64::from).collect();
            let here = single.evaluate(&joints, payload_kg);
            let truth = double.evaluate(&exact, f64::from(payload_kg));
            let difference = truth.pose.inverse() * here.pose.cast::<f64>();
            let distance = difference.translation.norm();
            assert!(distance.is_finite());
            sum += distance;
            position = position.max(distance);
            rotation = rotation.max(difference.log().angular.norm());
            // Compares where the `f64` arm goes with the corrected command of `f32`. The joints themselves may differ near a
            // singularity. The corrected command of `f64` shows the error of the method without that of the arithmetic.
            let wanted = double.nominal(&exact).unwrap().translation;
            let off = |corrected: &[f64]| {
                let stands = double.evaluate(corrected, f64::from(payload_kg)).pose;
                (stands.translation - wanted).norm()
            };
            let here = single.correct(&joints, payload_kg);
            if here.status.is_ok() {
                corrected += 1;
                let there = here.joints.iter().take(joints.len());
                command = command.max(off(&there.copied().map(f64::from).collect::<Vec<_>>()));
            }
            let here = double.correct(&exact, f64::from(payload_kg));
            if here.status.is_ok() {
                let there = here.joints.iter().take(joints.len());
                command_of_double = command_of_double.max(off(&there.copied().collect::<Vec<_>>()));
            }
        }
        println!(
            "{:<14} | {count} poses | position {:.3} µm in the mean, {:.3} at most | rotation {:.3} µrad at most | \
             {corrected} corrected commands stand {:.3} µm off at most, \
             those of f64 {:.3}",
            allowed.name,
            1e6 * sum / f64::from(count),
            1e6 * position,
            1e6 * rotation,
            1e6 * command,
            1e6 * command_of_double,
        );
        assert!(1e6 * position <= allowed.position, "{}", allowed.name);
        assert!(1e6 * rotation <= allowed.rotation, "{}", allowed.name);
        assert!(1e6 * command <= allowed.command, "{}", allowed.name);
    }
}
