//! Virtual draw-wires: a tracker's rows of a real arm, reduced to the distances from anchors, with 0.03 mm of noise.

use nalgebra::Vector3;
use poegp_calibration::identification::base_tools::fit_base_and_tools;
use poegp_calibration::measurement::samples::Samples;
use poegp_calibration::measurement::touch::{Reading, TouchRow, TouchSet};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::measured::calibrated;
use crate::sets::{errors, folder, mean_mm, robot, touches};

/// Number of draws that are averaged.
const DRAWS: u64 = 10;

/// For the anchors of each set: numbers of readings, each with the upper limit of the mean error in mm.
const ASKED: [(&str, [(usize, f64); 3]); 2] = [
    ("sim_irb120_s10_wire1", [(20, 0.35), (40, 0.28), (80, 0.15)]),
    (
        "sim_irb120_s10_wireeach3",
        [(20, 0.20), (40, 0.145), (80, 0.12)],
    ),
];

#[test]
fn virtual_wires_on_a_real_arm() {
    let (Some(touched), Some(real)) = (folder("touch"), folder("real")) else {
        return;
    };
    let robot = robot("abb_irb120_3_58.urdf").unwrap();
    let samples = Samples::read(real.join("abb_irb120_faro_700.csv"), &robot).unwrap();
    let drawn = fit_base_and_tools(&robot.chain().unwrap(), &samples);
    let base_from_instrument = drawn.instrument_from_base.inverse();
    let seen = |k: usize| base_from_instrument.transform_point(&samples[k].observation.position());
    let tip = drawn.flange_from_targets[0].translation;
    let mut missed = Vec::new();
    for (name, asked) in ASKED {
        let kinds = touches(&touched, name, &robot);
        for (count, limit) in asked {
            let mut sum = 0.0;
            for draw in 0..DRAWS {
                let mut random = ChaCha8Rng::seed_from_u64(draw);
                let mut order: Vec<usize> = (0..samples.len()).collect();
                order.shuffle(&mut random);
                let (train, test) = order.split_at(count);
                let mut set = wires(&kinds, &samples, &seen, train, &mut random);
                set.tips[0].position = tip.map(|x| (x * 1e3).round() * 1e-3);
                let found = calibrated(&robot, &set);
                let predict = |k: &usize| found.calibration.predict(&samples[*k]);
                let poses: Vec<_> = test.iter().map(predict).collect();
                let at: Vec<Vector3<f64>> = test.iter().map(|k| seen(*k)).collect();
                sum += mean_mm(&errors(&poses, &at));
            }
            let mean = sum / DRAWS as f64;
            println!("{name}, {count} poses: {mean:.3} mm (at most {limit})");
            if mean > limit {
                missed.push(format!("{name} {count}: {mean:.3}"));
            }
        }
    }
    assert_eq!(missed, [""; 0]);
}

/// Returns readings of the wires of `kinds` at some rows, whose positions are in the base frame.
fn wires(
    kinds: &TouchSet,
    samples: &Samples,
    seen: &dyn Fn(usize) -> Vector3<f64>,
    rows: &[usize],
    random: &mut ChaCha8Rng,
) -> TouchSet {
    use poegp_calibration::measurement::touch::FeatureKind;
    let mut set = kinds.clone();
    set.rows.clear();
    for feature in &mut set.features {
        feature.sigma = 30e-6;
    }
    let zeros: Vec<f64> = set
        .features
        .iter()
        .map(|_| {
            let drawn: f64 = StandardNormal.sample(random);
            1e-3 * drawn
        })
        .collect();
    for k in rows {
        let sample = &samples[*k];
        for (feature, zero) in zeros.iter().enumerate() {
            let FeatureKind::Anchor {
                position: Some(anchor),
                ..
            } = kinds.features[feature].kind
            else {
                continue;
            };
            let noise: f64 = StandardNormal.sample(random);
            let length = (seen(*k) - anchor).norm();
            set.rows.push(TouchRow {
                line: k + 2,
                joints: sample.joints.clone(),
                serial_joints: sample.serial_joints.clone(),
                payload_kg: None,
                tip: 0,
                reading: Reading::Anchor {
                    feature,
                    value: length + 30e-6 * noise - zero,
                },
                ..kinds.rows[0].clone()
            });
        }
    }
    set
}
