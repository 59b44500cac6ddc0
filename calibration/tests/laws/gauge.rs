//! The gauge: base and tool change with it, predictions do not, and the default gauge satisfies its definition.

use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::gauge::{GaugeChoice, GaugeFrame, GaugeGrid};
use poegp_calibration::model::{Calibration, Method, calibrate};
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::sets;

const OVER_GRID: GaugeChoice = GaugeChoice {
    over_grid: true,
    grid: None,
    base: None,
    tool: None,
};

/// Returns measurements of the simulated arm at 60 poses.
fn some(robot: &Robot) -> Vec<InstrumentSample> {
    let mut out = sets::simulated(robot, "train");
    out.truncate(60);
    out
}

fn fitted(robot: &Robot, samples: &[InstrumentSample], method: Method) -> Calibration {
    calibrate(robot, samples, &Config::new(method), &FitContext::default()).unwrap()
}

/// Returns a frame a few millimetres and milliradians from `pose`.
fn beside(pose: &Pose<f64>, sign: f64) -> GaugeFrame {
    let twist = Twist::from_array(&[1e-3, -2e-3, 3e-3, 2e-3, -1e-3, 3e-3].map(|x| sign * x));
    GaugeFrame {
        pose: *pose * Pose::exp(&twist),
        source: FrameSource::Stated,
    }
}

/// Returns the predicted target of each sample in the instrument's frame.
fn seen(model: &Calibration, samples: &[InstrumentSample]) -> Vec<Pose<f64>> {
    let base = model.base_and_tools.instrument_from_base;
    samples.iter().map(|s| base * model.predict(s)).collect()
}

/// Returns the largest distances between two lists of poses, m and rad.
fn apart(a: &[Pose<f64>], b: &[Pose<f64>]) -> (f64, f64) {
    let mut out = (0.0_f64, 0.0_f64);
    for (a, b) in a.iter().zip(b) {
        let between = a.inverse() * *b;
        out.0 = out.0.max(between.translation.norm());
        out.1 = out.1.max(between.log().angular.norm());
    }
    out
}

#[test]
fn a_model_says_the_same_in_every_gauge() {
    let (robot, _) = sets::arm();
    let samples = some(&robot);
    // PoeGp is only approximate: its twist keeps its components when the base frame turns.
    for (method, tolerance) in [
        (Method::BaseTool, 1e-12),
        (Method::Poe, 1e-9),
        (Method::Elastic, 1e-9),
        (Method::PoeGp, 2e-5),
    ] {
        let model = fitted(&robot, &samples, method);
        let before = seen(&model, &samples);
        let rms = model.constant_deviation;
        let own = &model.base_and_tools;
        let choice = GaugeChoice {
            base: Some(beside(&own.instrument_from_base, 1.0)),
            tool: Some(beside(&own.flange_from_targets[0], -1.0)),
            ..GaugeChoice::MEASURED_POSES
        };
        let moved = model.in_gauge(&robot, &choice).unwrap();
        let (m, rad) = apart(&before, &seen(&moved, &samples));
        assert!(
            m < tolerance && rad < tolerance,
            "{method:?}: {m:e} m, {rad:e} rad"
        );
        assert_eq!(moved.constant_deviation, rms);
        // The model has the stated base and tool; one pose of the nominal model shows it.
        let own = &moved.base_and_tools;
        assert_eq!(own.instrument_from_base, choice.base.unwrap().pose);
        assert_eq!(own.flange_from_targets[0], choice.tool.unwrap().pose);
        let flange = robot.chain().unwrap().forward(&samples[0].serial_joints);
        let target = flange * choice.tool.unwrap().pose;
        let drawn = moved.nominal.forward(&samples[0].serial_joints);
        assert!(apart(&[target], &[drawn]).0 < 1e-12);
    }
}

/// A blob predicts the same in every gauge, although gravity, which bends this loaded arm, is in the axes of the base.
#[test]
fn the_bytes_say_the_same_in_every_gauge() {
    let (robot, _) = sets::arm();
    let samples = some(&robot);
    let origin = crate::origin(vec![Default::default()]);
    let context = FitContext::default();
    let stored = |choice: &GaugeChoice| {
        let model = fitted(&robot, &samples, Method::Elastic);
        let model = model.in_gauge(&robot, choice).unwrap();
        model
            .into_blob(&robot, &samples, &origin, &context)
            .unwrap()
            .blob
    };
    let own = stored(&OVER_GRID);
    let tool = Pose::from_rows(&own.host().gauge.flange_from_target);
    let other = stored(&GaugeChoice {
        base: Some(beside(&own.instrument_from_base(), 1.0)),
        tool: Some(beside(&tool, 1.0)),
        ..GaugeChoice::MEASURED_POSES
    });
    for s in &samples {
        let (a, b) = (
            own.predict(&s.joints, s.payload_kg).pose,
            other.predict(&s.joints, s.payload_kg).pose,
        );
        assert!((a.translation - b.translation).norm() < 4e-6);
    }
    assert_eq!(other.host().gauge.base, FrameSource::Stated);
    assert_eq!(own.host().gauge.base, FrameSource::Grid);
}

/// The definition of the grid gauge: no other base and tool bring the nominal model nearer to the model over the grid.
#[test]
fn the_grid_has_the_nearest_nominal() {
    let (robot, nominal) = sets::arm();
    let samples = some(&robot);
    let model = fitted(&robot, &samples, Method::Elastic);
    let model = model.in_gauge(&robot, &OVER_GRID).unwrap();
    let grid = &model.gauge.grid;
    let last = nominal.kinds().len();
    let cost = |base: &Pose<f64>, tool: &Pose<f64>| -> f64 {
        let mut chain = nominal;
        chain.frames_mut()[0] = *base * nominal.frames()[0];
        chain.frames_mut()[last] = nominal.frames()[last] * *tool;
        let of = |joints: Vec<f64>| {
            let mut sample = samples[0].clone();
            sample.serial_joints = robot.serial_joints(&joints);
            sample.joints = joints;
            sample.payload_kg = grid.payload_kg;
            let between = model.predict(&sample).inverse() * chain.forward(&sample.serial_joints);
            let angle = 0.3 * between.log().angular.norm();
            between.translation.norm_squared() + angle * angle
        };
        grid.poses().map(of).sum()
    };
    let (base, tool) = (
        Pose::identity(),
        model.base_and_tools.flange_from_targets[0],
    );
    let best = cost(&base, &tool);
    for axis in 0..12 {
        for sign in [-2e-5, 2e-5] {
            let mut twist = [0.0; 6];
            twist[axis % 6] = sign;
            let by = Pose::exp(&Twist::from_array(&twist));
            let worse = match axis < 6 {
                true => cost(&by, &tool),
                false => cost(&base, &(by * tool)),
            };
            assert!(worse > best, "axis {axis}: {worse} for {best}");
        }
    }
}

/// A model with only base and tool fitted changes no command by a single bit, in the grid gauge too.
#[test]
fn base_and_tool_alone_correct_nothing() {
    let (robot, _) = sets::arm();
    let samples = some(&robot);
    let origin = crate::origin(vec![Default::default()]);
    let model = fitted(&robot, &samples, Method::BaseTool);
    let model = model.in_gauge(&robot, &OVER_GRID).unwrap();
    let found = model
        .into_blob(&robot, &samples, &origin, &FitContext::default())
        .unwrap();
    for s in &samples {
        let joints: Vec<f32> = s.joints.iter().map(|q| *q as f32).collect();
        let command = found.blob.model().correct(&joints, 0.0).joints;
        assert_eq!(command[..joints.len()], joints[..]);
    }
}

/// The grid ends at whole steps, does not depend on the draw of poses, and a single far pose does not stretch it.
#[test]
fn the_grid_hardly_follows_the_poses() {
    let (robot, _) = sets::arm();
    let all = sets::simulated(&robot, "train");
    let grid = GaugeGrid::new(&robot, &all);
    let step = 10_f64.to_radians();
    for (lower, upper) in &grid.ranges {
        for end in [lower, upper] {
            assert!((end / step - (end / step).round()).abs() < 1e-9);
        }
    }
    let lightest = all
        .iter()
        .filter_map(|s| s.payload_kg)
        .fold(f64::INFINITY, f64::min);
    assert_eq!(grid.payload_kg, Some(lightest));
    for side in [-1.0, 1.0] {
        let mut far = all.clone();
        for (joint, (lower, upper)) in far[0].joints.iter_mut().zip(&grid.ranges) {
            *joint = 0.5 * (lower + upper) + side * (upper - lower);
        }
        let stretched = GaugeGrid::new(&robot, &far).ranges;
        for ((a, b), (c, d)) in stretched.iter().zip(&grid.ranges) {
            let room = 0.2 * (d - c) + step;
            assert!(
                (a - c).abs() < room && (b - d).abs() < room,
                "{a} to {b} for {c} to {d}"
            );
        }
    }
    let first: Vec<Vec<f64>> = grid.poses().collect();
    assert_eq!(first.len(), 2_000);
    assert_eq!(first, grid.poses().collect::<Vec<_>>());
}

/// A frame far from the fitted one is refused as a gauge: it belongs to a moved instrument or a remounted target.
#[test]
fn frames_of_another_station_are_refused() {
    let (robot, _) = sets::arm();
    let samples = some(&robot);
    for (is_base, twist) in [
        (true, [0.011, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (true, [0.0, 0.0, 0.0, 0.0, 0.0, 0.011]),
        (false, [0.0, 0.0, 0.011, 0.0, 0.0, 0.0]),
        (false, [0.0, 0.0, 0.0, 0.011, 0.0, 0.0]),
    ] {
        let model = fitted(&robot, &samples, Method::Poe);
        let own = model.base_and_tools.clone();
        let by = Pose::exp(&Twist::from_array(&twist));
        let frame = |pose: Pose<f64>| GaugeFrame {
            pose: pose * by,
            source: FrameSource::Previous,
        };
        let choice = match is_base {
            true => GaugeChoice {
                base: Some(frame(own.instrument_from_base)),
                ..GaugeChoice::MEASURED_POSES
            },
            false => GaugeChoice {
                tool: Some(frame(own.flange_from_targets[0])),
                ..GaugeChoice::MEASURED_POSES
            },
        };
        let error = model.in_gauge(&robot, &choice).unwrap_err();
        assert_eq!(error.is_base, is_base);
        assert!(error.mm > 10.0 || error.mrad > 10.0, "{error}");
        let advice = ["mounted in another way", "instrument was moved"][usize::from(is_base)];
        assert!(error.remedy().contains(advice), "{error}");
    }
}
