//! Sessions and targets: each combination is a tool of its own, and no tool is used for another.

use std::path::Path;

use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::measurement;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName, samples};
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::model::{CalibrationError, Method, calibrate};
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::FitContext;
use poegp_calibration::validation::model_selection::{candidates, select_model};
use poegp_runtime::math::se3::{Pose, Twist};

use crate::{calibrated, origin, sets, task};

/// Rows have the same tool if and only if session and target are the same.
#[test]
fn a_tool_is_a_session_and_a_target() {
    let (robot, _) = sets::arm();
    let names = |i: usize| {
        (
            ["monday", "tuesday", "friday"][i % 3],
            ["left", "right"][i % 2],
        )
    };
    let mut csv =
        "session,target,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"
            .to_owned();
    for i in 0..24 {
        let (session, target) = names(i * i + i / 4);
        csv += &format!("{session},{target},{i},2,3,4,5,6,7,8,9,1,0,0,0\n");
    }
    let set = measurement::parse(Path::new("tools.csv"), csv.as_bytes()).unwrap();
    let mut tools = Vec::new();
    let rows = samples(&set, &robot, &mut tools).unwrap();
    for (i, a) in rows.iter().enumerate() {
        for (j, b) in rows.iter().enumerate() {
            let same = names(i * i + i / 4) == names(j * j + j / 4);
            assert_eq!(a.tool == b.tool, same, "rows {i} and {j}");
        }
        let (session, target) = names(i * i + i / 4);
        assert_eq!(
            (
                tools[a.tool].session.as_str(),
                tools[a.tool].target.as_str()
            ),
            (session, target)
        );
    }
}

/// Three tools decimetres apart are each predicted as well as base and tool alone predict this arm (2 mm in the mean). The
/// numbers of the tools do not matter.
#[test]
fn every_tool_is_predicted_by_its_own_frame() {
    let (robot, _) = sets::arm();
    let frame = |tool: usize| {
        let by = tool as f64;
        Pose::exp(&Twist::from_array(&[
            0.1 * by,
            -0.2 * by,
            0.15 * by,
            0.3 * by,
            -0.2 * by,
            0.4 * by,
        ]))
    };
    let mounted = |set: &str, poses: usize, order: [usize; 3]| {
        let mut rows = sets::simulated(&robot, set);
        rows.truncate(poses);
        for (i, row) in rows.iter_mut().enumerate() {
            let pose = row.observation.pose().unwrap() * frame(i % 3);
            row.observation = Observation::Pose(pose);
            row.tool = order[i % 3];
        }
        rows
    };
    let names = ["left", "right", "top"].map(|target| ToolName {
        session: String::new(),
        target: target.to_owned(),
    });
    let mut errors = Vec::new();
    for order in [[0, 1, 2], [2, 0, 1]] {
        let train = mounted("train", 90, order);
        let found = calibrate_to_blob(
            &robot,
            &train,
            &Config::new(Method::BaseTool),
            &origin(names.to_vec()),
            &FitContext::default(),
        )
        .unwrap();
        let of = found.blob.errors(&mounted("test1", 60, order));
        errors.push(of.iter().map(|e| e.position_mm).collect::<Vec<f64>>());
    }
    for tool in 0..3 {
        for errors in &errors {
            let own: Vec<f64> = errors.iter().skip(tool).step_by(3).copied().collect();
            let mean = own.iter().sum::<f64>() / own.len() as f64;
            assert!(mean < 4.0, "tool {tool}: {mean} mm");
        }
    }
    for (a, b) in errors[0].iter().zip(&errors[1]) {
        assert!(
            (a - b).abs() < 0.01,
            "{a} and {b} mm with the tools in another order"
        );
    }
}

/// The paper's method takes two tools: with every second pose measured through a tool mounted elsewhere, the predictions
/// are as good as with one tool.
#[test]
fn the_papers_process_takes_two_tools() {
    let (robot, _) = sets::arm();
    let mount = Pose::exp(&Twist::from_array(&[0.08, -0.05, 0.12, 0.4, -0.3, 0.9]));
    let halves = |set: &str, poses: usize, tools: usize| {
        let mut rows = sets::simulated(&robot, set);
        rows.truncate(poses);
        for row in rows.iter_mut().skip(1).step_by(2).filter(|_| tools == 2) {
            row.observation = Observation::Pose(row.observation.pose().unwrap() * mount);
            row.tool = 1;
        }
        rows
    };
    let names = |tools: usize| {
        let name = |i: usize| ToolName {
            session: format!("session {i}"),
            target: String::new(),
        };
        origin((0..tools).map(name).collect())
    };
    let config = Config {
        weighting: Weighting::Noise,
        ..Config::new(Method::PoeGpLoad)
    };
    let mean = |tools: usize| {
        let (context, train) = (FitContext::default(), halves("train", 120, tools));
        let found = calibrate_to_blob(&robot, &train, &config, &names(tools), &context).unwrap();
        let errors = found.blob.errors(&halves("test1", 100, tools));
        let mean = ErrorSummary::new(&errors).position_mm.mean;
        (mean, found.calibration)
    };
    let (one, _) = mean(1);
    let (two, calibration) = mean(2);
    assert!(two < 1.1 * one, "{two} mm, {one} with one tool");
    let off = (calibration.tools[1].inverse() * mount).log().to_array();
    assert!(off.iter().all(|x| x.abs() < 5e-4), "{off:?}");
}

/// A second session has one to four poses and is mounted 80 mm elsewhere. Every held-out row is predicted with its own tool.
/// A session that needs all of its rows has none held out, in the selection of a model too.
#[test]
fn a_small_session_is_predicted_by_its_own_tool_or_not_at_all() {
    const ROWS: usize = 40;
    let (robot, _) = sets::arm();
    let mount = Pose::exp(&Twist::from_array(&[0.04, -0.03, 0.06, 0.0, 0.5, 0.0]));
    let sessions = ["first", "second"].map(|session| ToolName {
        session: session.to_owned(),
        ..ToolName::default()
    });
    let origin = origin(sessions.to_vec());
    for small in 1..=4 {
        let mut rows = sets::simulated(&robot, "train");
        rows.truncate(ROWS + small);
        for row in &mut rows[ROWS..] {
            row.observation = Observation::Pose(row.observation.pose().unwrap() * mount);
            row.tool = 1;
        }
        let task = task(&robot, &rows, &[], 5, &origin);
        let held_out = task.folds().held_out();
        assert!((0..ROWS).all(|row| held_out.contains(&row)));
        for k in 0..5 {
            let (train, test) = task.folds().split(&rows, k);
            let of = |rows: &[InstrumentSample]| rows.iter().filter(|s| s.tool == 1).count();
            assert!(of(&test) == 0 || of(&train) >= 3, "{small} rows, fold {k}");
        }
        let found = task.run(&Config::new(Method::Poe), &mut || ()).unwrap();
        let found = found.cross_validation.unwrap();
        assert_eq!((&found.rows, found.all.poses), (&held_out, held_out.len()));
        let folds: usize = found.folds.iter().map(|fold| fold.poses).sum();
        assert_eq!(folds, held_out.len());
        // The nominal model is 2 mm wrong; a wrong tool would be 80 mm wrong.
        assert!(
            found.all.position_mm.max < 10.0,
            "{small} rows: {:?}",
            found.all
        );
        let models = candidates(&rows, &robot, &Config::default());
        let choice = select_model(&task, &models[..2], &mut || ()).unwrap();
        assert_eq!(choice.held_out, held_out.len());
    }
}

/// No other tool is used for an unknown one: the prediction is NaN, a session without a row is refused, and so is a
/// cross-validation of sessions that all need all of their rows.
#[test]
fn no_tool_stands_for_one_that_was_not_measured() {
    let (robot, _) = sets::arm();
    let mut rows = sets::simulated(&robot, "train");
    rows.truncate(12);
    let config = Config::new(Method::BaseTool);
    let found = calibrated(&robot, &rows, &config);
    let unknown = found.blob.predict_tool(&rows[0].joints, None, 1).pose;
    assert!(unknown.translation.iter().all(|x| x.is_nan()));
    for (i, row) in rows.iter_mut().enumerate() {
        row.tool = 2 * (i % 2);
    }
    let fit = |rows: &[InstrumentSample]| calibrate(&robot, rows, &config, &FitContext::default());
    assert!(matches!(
        fit(&rows),
        Err(CalibrationError::NoPoseOfTool { tool: 2 })
    ));
    for (i, row) in rows.iter_mut().enumerate() {
        row.tool = i / 3;
    }
    let origin = origin(vec![ToolName::default(); 4]);
    let held_out = task(&robot, &rows, &[], 5, &origin).held_out(&config, &mut || ());
    let error = held_out.unwrap_err().error.to_string();
    assert!(
        error.contains("too few different poses to hold one out"),
        "{error}"
    );
}
