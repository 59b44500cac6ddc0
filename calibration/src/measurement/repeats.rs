//! Repeats: rows with the same joints, tool and payload, which a fit counts as one measurement.
//!
//! What no model explains of a pose is in all measurements of it. As rows of their own, thirty repeats of five poses (as in
//! ISO 9283) show a noise as small as the arm's repeatability. Honest rows of other poses then pass for outliers, and the
//! model follows what is noise to it. A fit therefore gets the mean of the rows of a pose. Of n rows, it has the noise
//!
//! ```text
//! v + σ² / n,   σ: the scatter of rows about the mean of their pose,  v: what is common to them, fitted
//! ```
//!
//! σ is the noise that the rows declare, or else what the repeats show.
//!
//! A row far from its repeats is a mistake. It stays a measurement of its own, so that the fit finds it as an outlier.

use std::collections::HashMap;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;

use crate::measurement::elapsed::Elapsed;
use crate::measurement::folds::{is_same, same_within};
use crate::measurement::noise::{InstrumentNoise, NoiseScales};
use crate::measurement::observation::Observation;
use crate::measurement::sample::Sample;
use crate::numeric::rotation::turn;
use crate::numeric::statistics::median;

/// Distance of a row from the median of its repeats above which it is a mistake, in usual distances.
const MISTAKE: f64 = 10.0;

/// Number of rows beyond the first of their pose below which repeats do not show their scatter: a pose then has the noise of
/// one row.
const LEAST: usize = 10;

/// The rows of each pose, in the order of its first row, and their scatter.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeats {
    poses: Vec<Vec<usize>>,
    scatter: InstrumentNoise,
}

impl Repeats {
    /// Finds the repeats among `samples`. `predicted` has the pose of every sample by any model, in the samples' frame: joints
    /// that count as the same may still differ a little, and the model says by how much their poses then differ.
    pub fn of<F>(samples: &[Sample<F>], predicted: &[Pose<f64>], kinds: &[JointKind]) -> Self {
        let same = same_poses(samples, kinds);
        let displaced = |row: &usize| displacement(&samples[*row].observation, &predicted[*row]);
        let distances: Vec<Vec<[f64; 2]>> = same
            .iter()
            .map(|rows| distances_from_median(&rows.iter().map(displaced).collect::<Vec<_>>()))
            .collect();
        let repeated = || distances.iter().filter(|of| of.len() > 1).flatten();
        let least = [
            NoiseScales::TRACKER.position,
            NoiseScales::TRACKER.orientation,
        ];
        let limit: [f64; 2] = std::array::from_fn(|part| {
            let usual = median(repeated().map(|distance| distance[part]).collect());
            MISTAKE * usual.max(least[part])
        });
        let is_near = |distance: &[f64; 2]| distance.iter().zip(limit).all(|(d, most)| *d <= most);
        let mut poses = Vec::with_capacity(same.len());
        for (rows, distances) in same.iter().zip(&distances) {
            let (near, far): (Vec<_>, Vec<_>) =
                (rows.iter().zip(distances)).partition(|(_, distance)| is_near(distance));
            poses.extend(far.into_iter().map(|(row, _)| vec![*row]));
            poses.push(near.into_iter().map(|(row, _)| *row).collect());
        }
        poses.retain(|rows: &Vec<usize>| !rows.is_empty());
        poses.sort_unstable();
        let scatter = scatter(&poses, displaced, samples);
        Self { poses, scatter }
    }

    /// Returns the rows of pose `pose`.
    pub fn rows(&self, pose: usize) -> &[usize] {
        &self.poses[pose]
    }

    /// Returns the samples with the noise of one row, where they declare none and their repeats show it.
    pub fn with_scatter<F: Clone>(&self, samples: &[Sample<F>]) -> Vec<Sample<F>> {
        let with = |sample: &Sample<F>| Sample {
            declared_noise: sample.declared_noise.or(self.scatter),
            ..sample.clone()
        };
        samples.iter().map(with).collect()
    }

    /// Returns one sample for each pose: the mean of its rows, time included.
    pub fn means<F: Clone>(&self, samples: &[Sample<F>]) -> Vec<Sample<F>> {
        let mean = |rows: &Vec<usize>| {
            let own: Vec<Sample<F>> = rows.iter().map(|row| samples[*row].clone()).collect();
            mean(&own)
        };
        self.poses.iter().map(mean).collect()
    }
}

/// Returns the rows of each pose: rows with the tool, the payload and the kind of observation of its first row, and with the
/// same joints.
fn same_poses<F>(samples: &[Sample<F>], kinds: &[JointKind]) -> Vec<Vec<usize>> {
    let mut poses: Vec<Vec<usize>> = Vec::new();
    // Poses by the first joint, in steps as large as what counts as the same.
    let mut near: HashMap<i64, Vec<usize>> = HashMap::new();
    for (row, sample) in samples.iter().enumerate() {
        let step = (sample.joints[0] / same_within(kinds[0])).floor() as i64;
        let is_of = |pose: &&usize| {
            let first = &samples[poses[**pose][0]];
            first.tool == sample.tool
                && first.payload_kg == sample.payload_kg
                && first.observation.equations() == sample.observation.equations()
                && is_same(&first.joints, &sample.joints, kinds)
        };
        let mut candidates = (step - 1..=step + 1)
            .filter_map(|step| near.get(&step))
            .flatten();
        match candidates.find(is_of).copied() {
            Some(pose) => poses[pose].push(row),
            None => {
                near.entry(step).or_default().push(poses.len());
                poses.push(vec![row]);
            }
        }
    }
    poses
}

/// Returns the displacement and the rotation vector that lead from a prediction to an observation.
fn displacement(observation: &Observation, predicted: &Pose<f64>) -> [Vector3<f64>; 2] {
    let moved = observation.position() - predicted.translation;
    let turned = observation.pose().map(|pose| angular(predicted, &pose));
    [moved, turned.unwrap_or_default()]
}

/// Returns the rotation vector that leads from the orientation of one pose to that of another, along their common axes.
fn angular(from: &Pose<f64>, to: &Pose<f64>) -> Vector3<f64> {
    (*to * from.inverse()).log().angular
}

/// Returns the distances of displacements and of rotations from their medians.
fn distances_from_median(all: &[[Vector3<f64>; 2]]) -> Vec<[f64; 2]> {
    let middle = [0, 1].map(|part| {
        Vector3::from_fn(|axis, _| median(all.iter().map(|one| one[part][axis]).collect()))
    });
    let distance = |one: &[Vector3<f64>; 2]| [0, 1].map(|part| (one[part] - middle[part]).norm());
    all.iter().map(distance).collect()
}

/// Returns the standard deviation of rows about the mean of their pose, pooled over poses and components; unknown where there
/// are too few.
fn scatter<F>(
    poses: &[Vec<usize>],
    displaced: impl Fn(&usize) -> [Vector3<f64>; 2],
    samples: &[Sample<F>],
) -> InstrumentNoise {
    let of = |part: usize| {
        let has_part =
            |rows: &&Vec<usize>| part == 0 || samples[rows[0]].observation.has_orientation();
        let (mut squares, mut count) = (0.0, 0);
        for rows in poses.iter().filter(has_part) {
            let own: Vec<Vector3<f64>> = rows.iter().map(|row| displaced(row)[part]).collect();
            let mean = own.iter().sum::<Vector3<f64>>() / own.len() as f64;
            squares += own
                .iter()
                .map(|one| (one - mean).norm_squared())
                .sum::<f64>();
            count += own.len() - 1;
        }
        (count >= LEAST).then(|| (squares / (3 * count) as f64).sqrt())
    };
    InstrumentNoise {
        position: of(0),
        orientation: of(1),
    }
}

/// Returns the mean of samples of one pose.
fn mean<F: Clone>(samples: &[Sample<F>]) -> Sample<F> {
    let count = samples.len() as f64;
    let first = &samples[0];
    if samples.len() == 1 {
        return first.clone();
    }
    let noise = InstrumentNoise::rms_over(samples);
    let of_mean = |noise: Option<f64>| noise.map(|noise| noise / count.sqrt());
    let joints = |of: fn(&Sample<F>) -> &Vec<f64>| -> Vec<f64> {
        let sum = |joint: usize| samples.iter().map(|s| of(s)[joint]).sum::<f64>();
        (0..of(first).len())
            .map(|joint| sum(joint) / count)
            .collect()
    };
    let sum: Vector3<f64> = samples.iter().map(|s| s.observation.position()).sum();
    let position = sum / count;
    let orientation = first.observation.pose().map(|reference| {
        let poses = samples.iter().filter_map(|s| s.observation.pose());
        let turned: Vector3<f64> = poses.map(|pose| angular(&reference, &pose)).sum();
        (turn(turned / count) * reference).rotation
    });
    let elapsed: Option<Vec<Elapsed>> = samples.iter().map(|s| s.elapsed).collect();
    Sample {
        joints: joints(|s| &s.joints),
        serial_joints: joints(|s| &s.serial_joints),
        observation: match orientation {
            Some(rotation) => Observation::Pose(Pose {
                rotation,
                translation: position,
            }),
            None => Observation::Position(position),
        },
        declared_noise: InstrumentNoise {
            position: of_mean(noise.position),
            orientation: of_mean(noise.orientation),
        },
        elapsed: elapsed.map(|all| Elapsed {
            value: all.iter().map(|time| time.value).sum::<f64>() / count,
            unit: all[0].unit,
        }),
        ..first.clone()
    }
}
