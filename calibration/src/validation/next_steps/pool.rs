//! Poses that could be measured next.
//!
//! The poses form a Latin hypercube: each joint's range, and the payloads in their order, are divided into as many parts as
//! there are poses, and each part has one pose. So a third of a range holds a third of the poses, and these are spread over
//! all other joints.

use poegp_protocol::JointKind;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::measurement::observation::Observation;
use crate::measurement::sample::InstrumentSample;
use crate::robot::Robot;
use crate::validation::next_steps::step::Range;
use crate::validation::work_volume::like;

/// Number of parts that a range is divided into for the proposals.
const PARTS: usize = 3;

/// Poses to choose the next measurements from.
#[derive(Clone, Debug)]
pub struct Pool {
    /// Number of poses of one proposal; the pool has [`PARTS`] times as many.
    pub count: usize,
    /// All poses of the pool. Those of the first even part are whole poses; the others have an orientation only if the rows
    /// have one.
    pub poses: Vec<InstrumentSample>,
    /// Number of equations that measuring each pose would give.
    pub equations: Vec<usize>,
    ranges: Vec<(f64, f64)>,
    /// For each joint's range and for the payloads, the part that each pose is in: an index below the number of poses.
    strata: Vec<Vec<usize>>,
    /// Payloads of all rows in ascending order, kg; empty if only one payload occurs.
    payloads: Vec<f64>,
}

impl Pool {
    /// Draws a pool within `ranges`, with `count` poses for each proposal; everything else is as in measured rows.
    pub fn new(
        ranges: &[(f64, f64)],
        robot: &Robot,
        samples: &[InstrumentSample],
        count: usize,
    ) -> Self {
        let all = PARTS * count;
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut strata: Vec<Vec<usize>> = vec![(0..all).collect(); ranges.len() + 1];
        strata
            .iter_mut()
            .for_each(|order| order.shuffle(&mut random));
        let mut payloads: Vec<f64> = samples.iter().filter_map(|s| s.payload_kg).collect();
        payloads.sort_by(f64::total_cmp);
        let differ = payloads.len() == samples.len() && payloads.first() != payloads.last();
        if !differ {
            payloads.clear();
        }
        let (mut poses, mut equations) = (Vec::with_capacity(all), Vec::with_capacity(all));
        for k in 0..all {
            let at = |(range, order): (&(f64, f64), &Vec<usize>)| {
                let share = (order[k] as f64 + random.random::<f64>()) / all as f64;
                range.0 + (range.1 - range.0) * share
            };
            let joints: Vec<f64> = ranges.iter().zip(&strata).map(at).collect();
            let row = &samples[random.random_range(0..samples.len())];
            let mut pose = like(row, robot, joints);
            if differ {
                pose.payload_kg = Some(payloads[strata[ranges.len()][k] * payloads.len() / all]);
            }
            equations.push(row.observation.equations());
            if !row.observation.has_orientation() && k % PARTS != 0 {
                pose.observation = Observation::Position(nalgebra::Vector3::zeros());
            }
            poses.push(pose);
        }
        Self {
            count,
            poses,
            equations,
            ranges: ranges.to_vec(),
            strata,
            payloads,
        }
    }

    /// Returns the indices of the poses in [`PARTS`] parts, each spread evenly over the ranges.
    pub fn even(&self) -> [Vec<usize>; PARTS] {
        std::array::from_fn(|part| (part..self.poses.len()).step_by(PARTS).collect())
    }

    /// Returns the lowest and the highest third of each joint's range and of the payloads, with the indices of the poses in
    /// it.
    pub fn regions(&self, robot: &Robot) -> Vec<(Range, Vec<usize>)> {
        let mut out = Vec::new();
        for (dimension, strata) in self.strata.iter().enumerate() {
            for part in [0, PARTS - 1] {
                let range = match self.ranges.get(dimension) {
                    Some(range) => self.joint(robot, dimension, *range, part),
                    None if self.payloads.is_empty() => continue,
                    None => self.payload(part),
                };
                let within = part * self.count..(part + 1) * self.count;
                let poses = (0..self.poses.len()).filter(|k| within.contains(&strata[*k]));
                out.push((range, poses.collect()));
            }
        }
        out
    }

    fn joint(&self, robot: &Robot, joint: usize, (least, most): (f64, f64), part: usize) -> Range {
        let border = |k: usize| least + (most - least) * k as f64 / PARTS as f64;
        let (from, to) = shown(robot, joint, (border(part), border(part + 1)));
        Range::Joint {
            joint: joint + 1,
            from,
            to,
        }
    }

    fn payload(&self, part: usize) -> Range {
        let at = |k: usize| {
            self.payloads
                [(k * self.payloads.len() / (PARTS * self.count)).min(self.payloads.len() - 1)]
        };
        Range::PayloadKg {
            from: at(part * self.count),
            to: at((part + 1) * self.count - 1),
        }
    }
}

/// Returns a range of a joint in degrees or mm as it is displayed: rounded to a whole unit, or to a hundredth for a narrow
/// range.
pub fn shown(robot: &Robot, joint: usize, (from, to): (f64, f64)) -> (f64, f64) {
    let unit = match robot.joints[joint].kind {
        JointKind::Revolute => 180.0 / std::f64::consts::PI,
        JointKind::Prismatic => 1e3,
    };
    let digits = if unit * (to - from) < 10.0 {
        100.0
    } else {
        1.0
    };
    // Adding 0.0 avoids "-0".
    let rounded = |x: f64| (digits * unit * x).round() / digits + 0.0;
    (rounded(from), rounded(to))
}
