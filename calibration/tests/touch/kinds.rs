//! Every kind of touch on simulated arms: which calibrations are accepted, and how much they improve the arm.
//!
//! `cargo test --release -p poegp-calibration --test touch -- kinds --ignored --nocapture` prints the table of
//! docs/guide/without-a-tracker.md.

use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;

use crate::sets::mean_mm;
use crate::trial::{simulated, trial};

/// Simulated arms for each cell of the table.
const SEEDS: u64 = 10;
/// What is touched, as `simulate --touch` names it.
const ROWS: [&[(&str, usize)]; 10] = [
    &[("socket", 1)],
    &[("socket", 2)],
    &[("socket", 4)],
    &[("wire", 1)],
    &[("socket", 2), ("wire", 1)],
    &[("camera", 1)],
    &[("ballbar", 4)],
    &[("plane", 3)],
    &[("sphere", 4)],
    &[("level", 1)],
];

/// How much a calibration improves an arm.
struct Worth {
    is_refused: bool,
    /// Mean errors over the poses of the truth, of the nominal arm and as calibrated, mm.
    drawn: f64,
    calibrated: f64,
    /// What the calibration states: left-out touches, calibrated over nominal; the probability that the arm got worse.
    stated: [f64; 2],
}

/// Simulates, calibrates and scores. Returns `None` if the reader refuses the touches.
fn worth(robot: &Robot, tasks: &[(&str, usize)], count: usize, seed: u64) -> Option<Worth> {
    let (set, truth) = simulated(robot, Scenario::Paper, tasks, count, seed)?;
    let of = trial(robot, &set, &truth);
    let summary = &of.found.summary;
    Some(Worth {
        stated: [summary.left_out_ratio, summary.worse_probability],
        is_refused: of.found.findings.is_refused(),
        drawn: mean_mm(&of.drawn),
        calibrated: mean_mm(&of.calibrated),
    })
}

fn robot() -> Robot {
    Robot::load("abb-irb120", &LoadOptions::default()).unwrap()
}

/// Twenty touches of two sockets at a known distance reduce the nominal model's error to less than a fifth.
#[test]
fn two_sockets_calibrate_an_arm() {
    let found = worth(&robot(), &[("socket", 2)], 20, 1).unwrap();
    assert!(!found.is_refused);
    assert!(found.calibrated < 0.2 * found.drawn);
}

/// Prints the table of docs/guide/without-a-tracker.md. Of the accepted calibrations at most one in twenty is worse than the
/// nominal model, and none by more than 20 %.
#[test]
#[ignore = "half a minute in release; its command is in the head of this file"]
fn kinds_on_simulated_arms() {
    let robot = robot();
    let (mut accepted, mut worse, mut worst) = (0, 0, 0.0_f64);
    println!("| touched | nominal | 8 touches | 20 | 80 |\n|---|---|---|---|---|");
    for row in ROWS {
        let names: Vec<String> = row.iter().map(|(n, k)| format!("{n} × {k}")).collect();
        let mut drawn = 0.0;
        let mut cells = Vec::new();
        for count in [8, 20, 80] {
            let all: Vec<Worth> = (1..=SEEDS)
                .filter_map(|seed| worth(&robot, row, count, seed))
                .collect();
            let kept: Vec<&Worth> = all.iter().filter(|w| !w.is_refused).collect();
            for w in &kept {
                let ratio = w.calibrated / w.drawn;
                (accepted, worst) = (accepted + 1, worst.max(ratio));
                if ratio > 1.0 {
                    worse += 1;
                    let [left_out, probability] = w.stated;
                    let found = format!("{ratio:.2} times the nominal model's error");
                    let stated = format!("left out {left_out:.2}, probability {probability:.3}");
                    eprintln!("{}, {count}: {found}; {stated}", names.join(", "));
                }
            }
            if !all.is_empty() {
                drawn = all.iter().map(|w| w.drawn).sum::<f64>() / all.len() as f64;
            }
            let mean = kept.iter().map(|w| w.calibrated).sum::<f64>() / kept.len().max(1) as f64;
            cells.push(match (all.len(), kept.len()) {
                (0, _) => "–".to_owned(),
                (_, 0) => "refused".to_owned(),
                (n, k) if n == k => format!("{mean:.2}"),
                (n, k) => format!("{mean:.2}, {} of {n} refused", n - k),
            });
        }
        println!(
            "| {} | {drawn:.2} | {} |",
            names.join(", "),
            cells.join(" | ")
        );
    }
    println!(
        "{accepted} accepted, of them {worse} worse than the nominal model, the worst {worst:.2} times its error"
    );
    assert!(worst < 1.2, "{worst:.2} times the nominal model's error");
    assert!(20 * worse <= accepted);
}
