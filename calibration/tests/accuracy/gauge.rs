//! Two calibrations of one arm must lead to nearly the same commands. The pairs are draws of simulated arms and thirds of
//! measured poses.

use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::calibrate_in_gauge;
use poegp_calibration::measurement;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::gauge::{GaugeChoice, GaugeFrame};
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_calibration::validation::command_change::CommandChange;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::Pose;

use crate::measured::{FARO, folder};
use crate::{arm, origin, say, seeds};

const PAYLOADS_KG: [f64; 4] = [1.0, 2.5, 5.0, 7.5];
/// Poses in a draw.
const DRAW: usize = 150;
/// Largest mean distance between the commands of two calibrations of a simulated arm, mm.
const SIMULATED_MM: f64 = 0.06;
/// The same distance is at least this large where base and tool are fitted to the measured poses. The grid mends that.
const OF_POSES_MM: f64 = 0.2;

fn frame(pose: Pose<f64>, source: FrameSource) -> Option<GaugeFrame> {
    Some(GaugeFrame { pose, source })
}

/// The models in each of the compared gauges: fitted over the grid, kept from the first draw, fitted to the measured poses.
#[derive(Default)]
struct Gauges {
    grid: Vec<BlobModel>,
    kept: Vec<BlobModel>,
    of_poses: Vec<BlobModel>,
}

impl Gauges {
    /// Fits a model to each draw and states it in each gauge.
    fn new(robot: &Robot, draws: &[Vec<InstrumentSample>]) -> Self {
        let config = Config::new(Method::Elastic);
        let context = FitContext::default();
        let mut kept = None;
        let mut out = Self::default();
        for draw in draws {
            let over_grid = GaugeChoice::default();
            let of_poses = GaugeChoice::MEASURED_POSES;
            let fitted = calibrate_in_gauge(robot, draw, &config, &of_poses, &origin(1), &context);
            let fitted = fitted.unwrap();
            out.of_poses.push(fitted.blob);
            let mut calibration = fitted.calibration.in_gauge(robot, &over_grid).unwrap();
            let gauge = calibration.gauge.clone();
            let kept = kept.get_or_insert(GaugeChoice {
                over_grid: false,
                grid: Some(gauge.grid),
                base: frame(gauge.base.pose, FrameSource::Previous),
                tool: frame(gauge.tool.pose, FrameSource::Previous),
            });
            for (choice, into) in [(&over_grid, &mut out.grid), (&*kept, &mut out.kept)] {
                let stated = calibration.in_gauge(robot, choice).unwrap();
                let stored = stated.into_blob(robot, draw, &origin(1), &context).unwrap();
                calibration = stored.calibration;
                into.push(stored.blob);
            }
        }
        out
    }
}

/// Returns the mean distance over all pairs of models, mm.
fn of_pairs(of: &[BlobModel], distance: impl Fn(&BlobModel, &BlobModel) -> f64) -> f64 {
    let mut all = Vec::new();
    for (i, a) in of.iter().enumerate() {
        all.extend(of[..i].iter().map(|b| distance(b, a)));
    }
    all.iter().sum::<f64>() / all.len() as f64
}

#[test]
fn commands_of_two_calibrations_of_a_simulated_arm() {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    for seed in 1..=seeds(1) {
        let mut simulator = Simulator::new(&robot, Scenario::Nonlinear, &PAYLOADS_KG, seed);
        let draws: Vec<Vec<InstrumentSample>> = (0..3)
            .map(|_| {
                let csv = to_csv(&robot, &simulator.measure(DRAW), false, "draw");
                let set = measurement::parse("draw", csv.as_bytes()).unwrap();
                samples(&set, &robot, &mut Vec::new()).unwrap()
            })
            .collect();
        let wanted = simulator.measure(300);
        // Where the true arm goes when a model corrects its commands.
        let goes = |model: &BlobModel| -> Vec<Pose<f64>> {
            let mut true_arm = simulator.clone();
            let stands = |pose: &poegp_calibration::simulation::SimulatedPose| {
                let q: Vec<f32> = pose.joints.iter().map(|q| *q as f32).collect();
                let command = model.model().correct(&q, pose.payload_kg as f32).joints;
                let command: Vec<f64> = command[..q.len()].iter().map(|q| f64::from(*q)).collect();
                true_arm.stands_at(&command, pose.payload_kg)
            };
            wanted.iter().map(stands).collect()
        };
        let distance = |a: &BlobModel, b: &BlobModel| {
            let pairs = goes(a).into_iter().zip(goes(b));
            let all: Vec<f64> = pairs
                .map(|(a, b)| 1e3 * (a.translation - b.translation).norm())
                .collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        let gauges = Gauges::new(&robot, &draws);
        let [grid, kept, of_poses] =
            [&gauges.grid, &gauges.kept, &gauges.of_poses].map(|models| of_pairs(models, distance));
        say(format_args!(
            "commands of two calibrations, simulated arm {seed}: grid {grid:.3} mm, kept gauge {kept:.3} (at most \
             {SIMULATED_MM}); gauge of the measured poses {of_poses:.3} (above {OF_POSES_MM})"
        ));
        assert!(grid <= SIMULATED_MM && kept <= SIMULATED_MM);
        assert!(of_poses > OF_POSES_MM);
    }
}

#[test]
fn commands_of_two_calibrations_of_the_irb_120() {
    let what = "commands of two calibrations of the IRB 120";
    let Some(folder) = folder(what) else { return };
    let (robot, _) = arm("abb-irb120");
    let all = crate::samples(&folder.join(FARO), &robot);
    let third = |k: usize| all.iter().skip(k).step_by(3).cloned().collect();
    let thirds: Vec<Vec<InstrumentSample>> = (0..3).map(third).collect();
    let distance = |a: &BlobModel, b: &BlobModel| {
        let wanted = all.iter().map(|s| (s.joints.clone(), s.payload_kg));
        CommandChange::new(a, b, wanted).unwrap().position_mm.mean
    };
    let gauges = Gauges::new(&robot, &thirds);
    let [grid, kept, of_poses] =
        [&gauges.grid, &gauges.kept, &gauges.of_poses].map(|models| of_pairs(models, distance));
    say(format_args!(
        "{what}, disjoint thirds: grid {grid:.3} mm (at most 0.09), kept gauge {kept:.3} (at most 0.07); gauge of the \
         measured poses {of_poses:.3}"
    ));
    assert!(grid <= 0.09 && kept <= 0.07);
}
