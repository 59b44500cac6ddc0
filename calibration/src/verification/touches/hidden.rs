//! How far the smallest change that touches show moves the tip all over the work volume: what a check by touches may miss.
//!
//! Touches are compared with features and tips that are fitted to them, so the part of a displacement that a moved base or
//! another tip would make is not counted.

use crate::identification::parametric::state::ROWS;
use crate::identification::touch::volume::{WorkVolume, registered};
use crate::measurement::observation::Observation;
use crate::measurement::sample::{BaseSample, Instrument, InstrumentSample, Sample};
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::verification::estimate::LINEAR;
use crate::verification::hypotheses::{Part, hypotheses};
use crate::verification::result::Sensitivity;
use crate::verification::touches::rows::ArmAtTouches;

/// Sets [`Sensitivity::moves_mm`] of every joint.
pub(super) fn set_moves(found: &mut [Sensitivity], arm: &ArmAtTouches, volume: &WorkVolume) {
    let state = &arm.arm.state;
    let chain = state.chain(0);
    let pose = |of: &BaseSample| state.pose(&chain, of, &state.parametric_deflection(&chain, of));
    let poses: Vec<_> = volume.states.iter().map(pose).collect();
    let sample = |of: &BaseSample| {
        let (joints, serial_joints) = (of.joints.clone(), of.serial_joints.clone());
        let observation = Observation::Pose(pose(of));
        Sample {
            payload_kg: of.payload_kg,
            ..Sample::new(joints, serial_joints, observation, Instrument)
        }
    };
    let samples: Vec<InstrumentSample> = volume.states.iter().map(sample).collect();
    let at = arm.arm.linearise(&samples, arm.scales);
    let all = hypotheses(&arm.arm, &at, &samples, None);
    let gauge = registered(&poses);
    for s in found {
        let own = all.iter().find(|h| h.part == s.part);
        let Some(hypothesis) = own.filter(|_| matches!(s.part, Part::Joint(_))) else {
            continue;
        };
        let change = match (s.smallest, hypothesis.turns) {
            (Some(deg), true) => deg.to_radians(),
            (Some(mm), false) => 1e-3 * mm,
            (None, _) => LINEAR,
        };
        let unit = change * arm.scales.position;
        let moved = Mat::from_fn(3 * samples.len(), 1, |row, _| {
            unit * hypothesis.effect[(ROWS * (row / 3) + row % 3, 0)]
        });
        let left = &moved - product(&gauge, &product(Transposed(&gauge), &moved));
        let length = |k: usize| {
            let squares = (3 * k..3 * k + 3).map(|row| left[(row, 0)] * left[(row, 0)]);
            squares.sum::<f64>().sqrt()
        };
        let sum: f64 = (0..samples.len()).map(length).sum();
        s.moves_mm = Some(1e3 * sum / samples.len() as f64);
    }
}
