//! Wrong stated lengths: how often touches with them are refused, and how often correct ones are.
//!
//! `cargo test --release -p poegp-calibration --test touch -- lengths::many --ignored --nocapture` prints the table of
//! docs/evidence/touches.md.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use poegp_calibration::identification::touch::fit::{TouchFit, TouchProblem};
use poegp_calibration::identification::touch::lengths::{doubt, own, size};
use poegp_calibration::measurement::touch::{FeatureKind, Reading, TouchSet};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::touches::class_of;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_calibration::trust::Tier;
use poegp_protocol::cause::Cause;

use crate::measured::{SIMULATED, calibrated};
use crate::sets::{folder, robot, touches};
use crate::trial::simulated;

/// What is stated wrongly.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lie {
    None,
    /// The zero of joint 2 is 1 degree wrong; all stated lengths are right.
    Joint,
    /// All stated lengths are the true ones times this factor.
    Scale(f64),
    /// The first wire reads this much too long, or the first radius is a fifth of it too short, m.
    Zero(f64),
    /// The drawn tip is this far off, m.
    Tip(f64),
}

const LIES: [Lie; 7] = [
    Lie::None,
    Lie::Joint,
    Lie::Scale(1.01),
    Lie::Scale(0.99),
    Lie::Zero(20e-3),
    Lie::Zero(50e-3),
    Lie::Tip(50e-3),
];

impl Lie {
    /// Returns the touches with the wrong statement; `None` if they contain nothing that it concerns.
    fn told(self, set: &TouchSet, robot: &Robot) -> Option<TouchSet> {
        let mut out = set.clone();
        let mut is_told = !matches!(self, Self::Zero(_));
        let scale = if let Self::Scale(by) = self { by } else { 1.0 };
        out.distances.iter_mut().for_each(|d| d.distance *= scale);
        for (index, feature) in out.features.iter_mut().enumerate() {
            if let FeatureKind::Sphere {
                radius: Some(radius),
                ..
            } = &mut feature.kind
            {
                *radius *= scale;
                if let (Self::Zero(by), 0) = (self, index) {
                    *radius -= 0.2 * by;
                    is_told = true;
                }
            }
        }
        for row in &mut out.rows {
            if self == Self::Joint {
                row.joints[1] += 1_f64.to_radians();
                row.serial_joints = robot.serial_joints(&row.joints);
            }
            if let Reading::Anchor { feature, value } = &mut row.reading {
                *value *= scale;
                if let (Self::Zero(by), 0) = (self, *feature) {
                    *value += by;
                    is_told = true;
                }
            }
        }
        if let Self::Tip(by) = self {
            out.tips[0].position.x += by;
        }
        is_told.then_some(out)
    }
}

/// Counts by robot and lie: all sets, sets refused for a stated length, and sets refused for any reason.
type Rates = BTreeMap<(&'static str, usize), [usize; 3]>;

fn rates(
    kinds: &[&[(&str, usize)]],
    scenarios: &[Scenario],
    counts: &[usize],
    seeds: u64,
) -> Rates {
    let robots = [
        "abb-irb120",
        "ur5",
        "ur10",
        "kuka-iiwa7",
        "abb-irb4400-serial",
    ];
    let mut out = Rates::new();
    for name in robots {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        for (scenario, kinds) in scenarios
            .iter()
            .flat_map(|s| kinds.iter().map(move |k| (s, k)))
        {
            for (count, seed) in counts.iter().flat_map(|c| (1..=seeds).map(move |s| (c, s))) {
                let Some((set, _)) = simulated(&robot, *scenario, kinds, *count, 77_100 + seed)
                else {
                    continue;
                };
                for (index, lie) in LIES.iter().enumerate() {
                    let Some(set) = lie.told(&set, &robot) else {
                        continue;
                    };
                    let findings = calibrated(&robot, &set).findings;
                    let is_stated = |cause| matches!(cause, Cause::Frames | Cause::Noise);
                    let refused: Vec<_> = findings.of(Tier::Refused).collect();
                    let sums = out.entry((name, index)).or_default();
                    sums[0] += 1;
                    sums[1] += usize::from(refused.iter().any(|f| is_stated(f.cause)));
                    sums[2] += usize::from(!refused.is_empty());
                }
            }
        }
    }
    out
}

fn print(rates: &Rates) -> Vec<[usize; 3]> {
    println!(
        "| stated falsely | robot | sets | refused for it | refused at all |\n|---|---|---|---|---|"
    );
    let mut all = vec![[0; 3]; LIES.len()];
    for (index, lie) in LIES.iter().enumerate() {
        for ((robot, _), sums) in rates.iter().filter(|((_, of), _)| *of == index) {
            let [sets, stated, any] = sums;
            println!("| {lie:?} | {robot} | {sets} | {stated} | {any} |");
            (0..3).for_each(|i| all[index][i] += sums[i]);
        }
        let [sets, stated, any] = all[index];
        println!("| {lie:?} | all | {sets} | {stated} | {any} |");
    }
    all
}

/// One arm of each type: no correct set is refused for a stated length, and nearly all wrong ones are.
#[test]
fn false_lengths_are_refused_and_honest_ones_are_not() {
    let kinds: [&[(&str, usize)]; 2] = [&[("wire", 1)], &[("ballbar", 4)]];
    let all = print(&rates(&kinds, &[Scenario::Paper], &[40], 1));
    assert_eq!([all[0][1], all[1][1]], [0, 0], "honest sets are refused");
    // The last lie, the wrong tip, is not counted: it adds no noise, and the fit corrects it.
    for (lie, [sets, stated, _]) in LIES.iter().zip(&all).take(6).skip(2) {
        assert!(10 * stated >= 9 * sets, "{lie:?}: {stated} of {sets}");
    }
}

/// More kinds and numbers of touches, by arms with gear ripple and backlash.
#[test]
#[ignore = "ten minutes in release; its command is in the head of this file"]
fn many() {
    let kinds: [&[(&str, usize)]; 5] = [
        &[("wire", 1)],
        &[("wire", 3)],
        &[("socket", 4)],
        &[("ballbar", 4)],
        &[("sphere", 4)],
    ];
    let all = print(&rates(&kinds, &[Scenario::Nonlinear], &[20, 80], 1));
    let [sets, stated, _] = all[0];
    assert!(
        50 * stated <= sets,
        "{stated} of {sets} correct sets are refused"
    );
}

/// No stated length of the sets measured by others is refused.
#[test]
fn measured_sets_are_not_in_doubt() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let mut doubted = Vec::new();
    for (arm, description, kinds) in SIMULATED {
        let robot = robot(description).unwrap();
        let chain = robot.chain().unwrap();
        for (kind, _) in kinds {
            let name = format!("{arm}_{kind}");
            let set = touches(&folder, &name, &robot);
            let gravity = Vector3::from(Config::default().gravity_m_s2);
            let class = class_of(&robot, &set);
            let problem = TouchProblem::new(&set, &chain, robot.coupling.clone(), gravity, class);
            let nominal = TouchFit::on_nominal(&problem, 0);
            let fit = TouchFit::new(&problem, &nominal);
            let size = size(&problem, &nominal).map(|(size, _)| size.sigmas());
            let own = own(&problem).into_iter().flat_map(|(doubts, ..)| doubts);
            let own = own.map(|doubt| doubt.sigmas()).fold(0.0, f64::max);
            println!("{name}: the size by {size:.1?}, one length by {own:.1} standard deviations");
            doubted.extend(doubt(&problem, &nominal, &fit).map(|doubt| (name, doubt)));
        }
    }
    assert_eq!(doubted, []);
}
