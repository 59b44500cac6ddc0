//! CPU time of a calibration by touches. The bounds are those of a release build.

use std::time::Instant;

use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;

use crate::measured::calibrated;
use crate::trial::simulated;

/// Largest CPU times in seconds: of 80 touches, and of 20 000 corners.
const TOUCHES: f64 = 2.0;
const CORNERS: f64 = 20.0;

/// Returns the CPU seconds of this thread as Linux counts them; elapsed time on other systems.
fn cpu_seconds(work: impl FnOnce()) -> f64 {
    let cpu = || {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    };
    let (start, clock) = (cpu(), Instant::now());
    work();
    match (start, cpu()) {
        (Some(start), Some(end)) => 1e-9 * (end - start),
        _ => clock.elapsed().as_secs_f64(),
    }
}

fn holds(what: &str, tasks: &[(&str, usize)], count: usize, rows: usize, most: f64) {
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    let (set, _) = simulated(&robot, Scenario::Paper, tasks, count, 4).unwrap();
    assert_eq!(set.rows.len(), rows);
    let seconds = cpu_seconds(|| drop(calibrated(&robot, &set)));
    println!("{what}, {rows} rows: {seconds:.2} CPU s (at most {most})");
    if cfg!(debug_assertions) {
        println!("NOT RUN: the bound is that of a release build");
    } else {
        assert!(seconds <= most, "{what}: {seconds:.2} CPU s");
    }
}

#[test]
fn eighty_touches_take_little_time() {
    holds("two sockets", &[("socket", 2)], 80, 80, TOUCHES);
    holds("three planes", &[("plane", 3)], 81, 81, TOUCHES);
}

#[test]
fn twenty_thousand_corners_take_little_time() {
    holds("a board", &[("camera", 1)], 4000, 20_000, CORNERS);
}
