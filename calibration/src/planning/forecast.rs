//! What a plan should be worth, before anyone measures.
//!
//! The forecast simulates arms with the kinematics of this robot and errors like those of the simulator's scenarios. They
//! are measured at planned poses, calibrated as `trainer calibrate` does by default, and tested on random allowed
//! configurations against simulated measurements, whose noise is part of every error. This shows what a number of poses is
//! worth for an arm like the simulated ones: their errors have the sizes of an ABB IRB 4400 (`simulate/`), and a real arm
//! has errors of its own.

use std::sync::Mutex;
use std::sync::atomic::Ordering;

use serde::Serialize;

use crate::blob::write::{Provenance, calibrate_to_blob};
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Instrument, InstrumentSample, Sample, ToolName};
use crate::model::Method;
use crate::model::config::Config;
use crate::numeric::statistics::ErrorSummary;
use crate::planning::{PlannedPose, Planner, Strategy};
use crate::progress::{FitContext, limit_threads, thread_limit, threads};
use crate::simulation::{Scenario, SimulatedPose, Simulator};

/// Number of simulated arms of each kind.
pub const ARMS: u64 = 2;
/// Number of configurations that each arm is tested on.
const TESTS: usize = 150;
/// Kinds of arms: one with errors that the model has formulas for, and one with errors that it has none for.
pub const SCENARIOS: [Scenario; 2] = [Scenario::Paper, Scenario::Nonlinear];

/// Forecast for one number of poses.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Number of poses for the calibration.
    pub poses: usize,
    /// Name of the strategy by which they were chosen.
    pub strategy: &'static str,
    /// Mean position error in mm over all arms of the first kind; absent if a calibration failed.
    pub paper_mm: Option<f64>,
    /// 95th percentile of the position error in mm, as the mean over these arms.
    pub paper_p95_mm: Option<f64>,
    /// Mean position error in mm over all arms of the second kind.
    pub wild_mm: Option<f64>,
    /// 95th percentile of the position error in mm, as the mean over the arms of the second kind.
    pub wild_p95_mm: Option<f64>,
}

/// Converts a simulated measurement into a sample in the instrument's frame.
pub fn sample(
    robot: &crate::robot::Robot,
    pose: &SimulatedPose,
    payload_kg: Option<f64>,
) -> InstrumentSample {
    Sample {
        payload_kg,
        ..Sample::new(
            pose.joints.clone(),
            robot.serial_joints(&pose.joints),
            Observation::Pose(pose.measured),
            Instrument,
        )
    }
}

impl Planner<'_> {
    /// Returns the numbers of poses, sorted, that the robot cell and the model allow.
    pub fn forecast_counts(&self, counts: impl Iterator<Item = usize>) -> Vec<usize> {
        let fewest = Method::Elastic.min_poses(self.task.robot.joints.len());
        let mut counts: Vec<usize> = counts.collect();
        counts.sort_unstable();
        counts.dedup();
        counts.retain(|n| (fewest..=self.candidates.joints.len()).contains(n));
        counts
    }

    /// Returns the number of calibrations of a forecast for these numbers of poses.
    pub fn forecast_steps(counts: &[usize]) -> usize {
        counts.len() * SCENARIOS.len() * ARMS as usize
    }

    /// Computes the forecast. `strategy` is the one that was asked for, or `None` for the usual one; `progress` is called
    /// after every calibration.
    pub fn forecast(
        &self,
        counts: &[usize],
        strategy: Option<Strategy>,
        progress: &(dyn Fn() + Sync),
    ) -> Vec<Row> {
        let test = self.random_poses(TESTS);
        let plans: Vec<(Strategy, Vec<PlannedPose>)> = counts
            .iter()
            .map(|count| {
                let strategy = strategy.unwrap_or(Strategy::usual(*count));
                let plan = self.plan(*count, 0, strategy).map(|p| p.poses);
                (strategy, plan.unwrap_or_default())
            })
            .collect();
        // The longest calibrations start first, so that no thread is left with one at the end.
        let jobs: Vec<(usize, usize, u64)> = (0..plans.len())
            .rev()
            .flat_map(|p| {
                (0..SCENARIOS.len()).flat_map(move |s| (1..=ARMS).map(move |arm| (p, s, arm)))
            })
            .collect();
        let next = Mutex::new(jobs.iter());
        let errors = Mutex::new(vec![vec![Vec::new(); SCENARIOS.len()]; plans.len()]);
        let limit = thread_limit();
        std::thread::scope(|scope| {
            for _ in 0..threads().min(jobs.len()) {
                scope.spawn(|| {
                    let _limit = limit_threads(limit);
                    while let Some((p, s, arm)) = take(&next) {
                        if self.task.cancel.load(Ordering::Relaxed) {
                            break;
                        }
                        let found = self.error_of(&plans[p].1, &test, SCENARIOS[s], arm);
                        if let Ok(mut errors) = errors.lock() {
                            errors[p][s].push((arm, found));
                        }
                        progress();
                    }
                });
            }
        });
        let errors = errors.into_inner().unwrap_or_default();
        let mut rows = Vec::with_capacity(plans.len());
        for ((count, (strategy, _)), mut by_scenario) in counts.iter().zip(&plans).zip(errors) {
            let mut mean = |s: usize, of: fn(&ErrorSummary) -> f64| -> Option<f64> {
                let found = &mut by_scenario[s];
                // The errors are sorted by arm, so that sums do not depend on which thread was first.
                found.sort_by_key(|(arm, _)| *arm);
                let values: Option<Vec<f64>> =
                    found.iter().map(|(_, e)| e.as_ref().map(of)).collect();
                values.map(|v| v.iter().sum::<f64>() / v.len() as f64)
            };
            rows.push(Row {
                poses: *count,
                strategy: strategy.name(),
                paper_mm: mean(0, |e| e.position_mm.mean),
                paper_p95_mm: mean(0, |e| e.position_mm.p95),
                wild_mm: mean(1, |e| e.position_mm.mean),
                wild_p95_mm: mean(1, |e| e.position_mm.p95),
            });
        }
        rows
    }

    /// Returns the errors of one simulated arm that was calibrated with planned poses; `None` if that failed.
    fn error_of(
        &self,
        planned: &[PlannedPose],
        test: &[PlannedPose],
        scenario: Scenario,
        arm: u64,
    ) -> Option<ErrorSummary> {
        let task = &self.task;
        let seed = task.seed.wrapping_add(arm);
        let mut simulator = Simulator::new(task.robot, scenario, task.payloads, seed);
        let mut measure = |poses: &[PlannedPose]| -> Vec<InstrumentSample> {
            poses
                .iter()
                .map(|p| {
                    let measured = simulator.measure_at(&p.joints, p.payload_kg.unwrap_or(0.0));
                    sample(task.robot, &measured, p.payload_kg)
                })
                .collect()
        };
        let (train, test) = (measure(planned), measure(test));
        let origin = Provenance {
            tools: vec![ToolName::default()],
            ..Provenance::default()
        };
        let options = Config::new(Method::Elastic);
        let found = calibrate_to_blob(
            task.robot,
            &train,
            &options,
            &origin,
            &FitContext::new(&(), task.cancel),
        );
        Some(ErrorSummary::new(&found.ok()?.blob.errors(&test)))
    }
}

/// Returns the next job; the lock is released before the job begins.
fn take(next: &Mutex<std::slice::Iter<'_, (usize, usize, u64)>>) -> Option<(usize, usize, u64)> {
    next.lock().ok()?.next().copied()
}
