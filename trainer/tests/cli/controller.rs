//! The numbers for the controller's engineer: standard deviations against drawn frames, signed errors against a computation by
//! hand, and the same numbers in document, page and file.

use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Instrument, InstrumentSample, Sample, ToolName};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::numeric::statistics::PoseError;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::validation::held_out::HeldOutPose;
use poegp_calibration::validation::next_steps::Knowledge;
use poegp_calibration::validation::signed_residuals::{Row, SignedResiduals, weights};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_trainer::export::CalibratedChain;
use poegp_trainer::export::dh::{deviations, numbers, rows_beside_nominal, wrapped};
use poegp_trainer::report::controller::ControllerSummary;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use serde_json::Value;

use crate::export::{calibrated, chain};
use crate::program::{Folder, SERIAL, simulated};

/// Returns an approximately normal number: the sum of twelve uniform ones.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// Standard deviations of DH rows from a covariance of frames agree with the scatter of rows from drawn frames.
#[test]
fn deviations_of_dh_rows_are_those_of_drawn_frames() {
    for robot in ["abb-irb120", "ur5"] {
        let folder = calibrated(robot, "poe");
        let chain = chain(&folder);
        let size = 6 * chain.frames.len();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // 10 µm and 10 µrad for every number, strongly correlated.
        let root = Mat::from_fn(size, size, |_, _| {
            1e-5 / (size as f64).sqrt() * normal(&mut random)
        });
        let stated = deviations(&chain, &(&root * root.transpose()));
        let (_, rows) = rows_beside_nominal(&chain);
        let mut squares = vec![[0.0; 5]; rows.len()];
        const DRAWS: usize = 4000;
        for _ in 0..DRAWS {
            let drawn = &root * Mat::from_fn(size, 1, |_, _| normal(&mut random));
            let other = moved(&chain, |k| drawn[(k, 0)]);
            let (_, others) = rows_beside_nominal(&other);
            for ((square, row), moved) in squares.iter_mut().zip(&rows).zip(&others) {
                for (i, sum) in square.iter_mut().enumerate() {
                    *sum += wrapped(numbers(moved)[i] - numbers(row)[i]).powi(2);
                }
            }
        }
        for (joint, (stated, square)) in stated.iter().zip(&squares).enumerate() {
            for i in 0..5 {
                let found = (square[i] / DRAWS as f64).sqrt();
                assert!(
                    (stated[i] - found).abs() < 0.05 * found + 1e-9,
                    "{robot}, joint {joint}, number {i}: {:.3e} and {found:.3e}",
                    stated[i]
                );
            }
        }
    }
}

/// Returns `chain` with each frame multiplied from the left by a small motion of six numbers.
fn moved(chain: &CalibratedChain, step: impl Fn(usize) -> f64) -> CalibratedChain {
    let mut out = chain.clone();
    for (i, frame) in out.frames.iter_mut().enumerate() {
        let twist = std::array::from_fn(|k| step(6 * i + k));
        *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
    }
    out
}

/// A rigid arm is measured and calibrated 40 times with fresh noise. The scatter of DH rows and joint zeros over the blobs is
/// near the standard deviation that one calibration states.
#[test]
fn deviations_are_those_of_repeated_calibrations() {
    const REPEATED: u64 = 40;
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    let nominal_arm = robot.chain().unwrap();
    let truth = {
        let mut frames = nominal_arm.frames().to_vec();
        for (i, frame) in frames.iter_mut().enumerate() {
            let twist = std::array::from_fn(|k| 4e-4 * (1.7 * (6 * i + k) as f64).sin());
            *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
        }
        Poe::new(nominal_arm.kinds(), &frames).unwrap()
    };
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let joints: Vec<Vec<f64>> = (0..40)
        .map(|_| (0..6).map(|_| 2.4 * random.random::<f64>() - 1.2).collect())
        .collect();
    let calibrated = |seed: u64| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let measured = |q: &Vec<f64>| {
            let twist = std::array::from_fn(|_| 30e-6 * normal(&mut random));
            let mut pose = truth.forward(q);
            let noise = Pose::exp(&Twist::from_array(&twist));
            pose.translation += noise.translation;
            pose.rotation = noise.rotation * pose.rotation;
            Sample::new(q.clone(), q.clone(), Observation::Pose(pose), Instrument)
        };
        let samples: Vec<InstrumentSample> = joints.iter().map(measured).collect();
        let origin = Provenance {
            date: "2026-11-20".to_owned(),
            tools: vec![ToolName::default()],
            ..Provenance::default()
        };
        let config = Config {
            weighting: Weighting::Noise,
            ..Config::new(Method::Poe)
        };
        let context = FitContext::default();
        let found = calibrate_to_blob(&robot, &samples, &config, &origin, &context).unwrap();
        let knowledge = Knowledge::new(&found.calibration, &robot, &samples);
        ControllerSummary::new(&found.blob, &robot, knowledge.predictions(), None)
    };
    let numbers = |summary: &ControllerSummary| -> Vec<(String, f64, f64)> {
        let mut out = Vec::new();
        for row in &summary.dh {
            let beta = row.beta_deg.as_ref().map(|beta| ("beta", beta));
            let all = [
                ("a", &row.a_mm),
                ("d", &row.d_mm),
                ("alpha", &row.alpha_deg),
                ("theta", &row.theta_deg),
            ];
            for (name, n) in all.into_iter().chain(beta) {
                out.push((
                    format!("{} {name}", row.joint),
                    n.difference,
                    n.std.unwrap(),
                ));
            }
        }
        for zero in &summary.joint_zeros {
            out.push((
                format!("{} zero", zero.joint),
                zero.offset_deg.unwrap(),
                zero.std.unwrap_or(0.0),
            ));
        }
        out
    };
    let all: Vec<_> = (1..=REPEATED)
        .map(|seed| numbers(&calibrated(seed)))
        .collect();
    let mut logs = Vec::new();
    for (i, (name, _, stated)) in all[0].iter().enumerate() {
        let mean = all.iter().map(|one| one[i].1).sum::<f64>() / REPEATED as f64;
        let square = all.iter().map(|one| (one[i].1 - mean).powi(2)).sum::<f64>();
        let found = (square / (REPEATED - 1) as f64).sqrt();
        if *stated < 1e-9 {
            // Zero by convention: flange and base take what the rows cannot express.
            assert!(found < 1e-9, "{name}: {found:.1e}");
            continue;
        }
        eprintln!("{name}: stated {stated:.5}, found {found:.5}");
        // The standard deviation of forty values is known to 11 %.
        assert!(
            (0.65..1.5).contains(&(stated / found)),
            "{name}: {stated} {found}"
        );
        logs.push((stated / found).ln());
    }
    let ratio = (logs.iter().sum::<f64>() / logs.len() as f64).exp();
    eprintln!("{} numbers: stated over found {ratio:.3}", logs.len());
    assert!((0.9..1.12).contains(&ratio));
}

/// A joint zero that base and tool cannot absorb gives signed errors, measured less predicted.
#[test]
fn signed_errors_are_measured_less_predicted() {
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    let chain = robot.chain().unwrap();
    const OFFSET: f64 = 1e-3;
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let joints: Vec<Vec<f64>> = (0..30)
        .map(|_| (0..6).map(|_| 2.0 * random.random::<f64>() - 1.0).collect())
        .collect();
    let pose = |q: &Vec<f64>| {
        let predicted = chain.forward(q);
        let mut real = q.clone();
        real[2] += OFFSET;
        let measured = chain.forward(&real);
        let turned = Pose {
            translation: nalgebra::Vector3::zeros(),
            ..measured * predicted.inverse()
        }
        .log()
        .angular;
        let moved = measured.translation - predicted.translation;
        HeldOutPose {
            error: PoseError::between(&measured, &predicted),
            position: measured.translation.into(),
            residual: [
                moved[0], moved[1], moved[2], turned[0], turned[1], turned[2],
            ],
            sigma: None,
            noise: Default::default(),
        }
    };
    let poses: Vec<HeldOutPose> = joints.iter().map(pose).collect();
    let rows: Vec<Row> = joints.iter().map(Vec::as_slice).zip(&poses).collect();
    let found = SignedResiduals::new(&robot, &chain, &rows, &weights(&rows));
    // Joint 3 explains the whole error, at every pose.
    let [own, other] = [&found.joints[2], &found.joints[0]];
    assert!(
        (own.mean - 1e3 * OFFSET).abs() < 2e-3 && own.std < 2e-3,
        "{own:?}"
    );
    assert!(other.mean.abs() < 0.5 && other.std > 1e-3, "{other:?}");
    for axis in 0..3 {
        let values = poses.iter().map(|p| 1e3 * p.residual[axis]);
        let mean = values.sum::<f64>() / 30.0;
        assert!((found.axes_mm[axis].mean - mean).abs() < 1e-9);
    }
}

/// Document, page and file of one calibration have the same numbers as the exports.
#[test]
fn document_and_file_have_the_same_numbers() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    folder.write("test.csv", simulated("test1", 30));
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --test test.csv --out arm.blob --report report.html --json report.json \
         --controller-csv controller.csv"
    );
    folder.run(&line).ok();
    let document = folder.json("report.json");
    let controller = &document["controller"];
    let csv = folder.text("controller.csv");
    let mut lines = csv.lines();
    let header = "table,name,quantity,unit,before,after,difference,std_before,std_after";
    assert_eq!(lines.next(), Some(header));
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let row = |table: &str, name: &str, quantity: &str| {
        let found = rows.iter().find(|row| row[..3] == [table, name, quantity]);
        found.unwrap_or_else(|| panic!("{table} {name} {quantity}: {csv}"))
    };
    let same =
        |text: &str, value: &Value| assert_eq!(text.parse::<f64>().ok(), value.as_f64(), "{value}");
    for dh in controller["dh"].as_array().unwrap() {
        let name = dh["joint"].as_str().unwrap();
        for (quantity, key) in [
            ("a", "a_mm"),
            ("d", "d_mm"),
            ("alpha", "alpha_deg"),
            ("theta", "theta_deg"),
        ] {
            let row = row("dh", name, quantity);
            for (column, part) in [
                (4, "nominal"),
                (5, "calibrated"),
                (6, "difference"),
                (8, "std"),
            ] {
                same(row[column], &dh[key][part]);
            }
        }
    }
    let (before, after) = (
        &controller["residuals"]["before"],
        &controller["residuals"]["after"],
    );
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let row = row("axis", name, "residual");
        same(row[4], &before["axes_mm"][axis]["mean"]);
        same(row[8], &after["axes_mm"][axis]["std"]);
    }
    assert_eq!(rows.iter().filter(|row| row[0] == "joint").count(), 6);
    // The RMS error over all axes is between the mean and the maximum of the held-out errors.
    let square = |errors: &Value| -> f64 {
        let axes = errors["axes_mm"].as_array().unwrap().iter();
        axes.map(|s| s["mean"].as_f64().unwrap().powi(2) + s["std"].as_f64().unwrap().powi(2))
            .sum()
    };
    for (errors, which) in [(before, "nominal"), (after, "calibrated")] {
        let of = |key: &str| {
            document["held_out"][which]["position_mm"][key]
                .as_f64()
                .unwrap()
        };
        assert!(square(errors).sqrt() >= of("mean") && square(errors).sqrt() <= of("max"));
    }
    // The rows equal those of the exports.
    folder.run("export arm.blob --dh dh.json").ok();
    let dh = folder.json("dh.json");
    let near = |stated: &Value, exported: f64| {
        assert!(
            (stated.as_f64().unwrap() - exported).abs() < 1e-7,
            "{stated} {exported}"
        );
    };
    for joint in 0..6 {
        let row = &controller["dh"][joint];
        let exported = |key: &str| dh["joints"][joint][key].as_f64().unwrap();
        near(&row["a_mm"]["calibrated"], 1e3 * exported("a_m"));
        let theta = exported("theta_offset_rad").to_degrees();
        near(&row["theta_deg"]["calibrated"], theta);
    }
    folder
        .run("export arm.blob --joint-offsets zeros.json")
        .ok();
    let zeros = folder.json("zeros.json");
    let joints = zeros["joints"].as_array().unwrap().iter();
    for (own, exported) in controller["joint_zeros"]
        .as_array()
        .unwrap()
        .iter()
        .zip(joints)
    {
        let offset = exported["offset_rad"].as_f64().unwrap().to_degrees();
        near(&own["offset_deg"], offset);
        let name = own["joint"].as_str().unwrap();
        same(row("joint_zero", name, "offset")[6], &own["offset_deg"]);
    }
    near(
        &controller["distance"]["dh_mm"],
        dh["distance"]["chain"]["position_mm"]["mean"]
            .as_f64()
            .unwrap(),
    );
    let page = folder.text("report.html");
    for heading in ["What to do next", "For the controller's engineer"] {
        assert!(page.contains(heading), "{heading}");
    }
}

/// Joint zeros are no nearer than a nominal model that is true: the export refuses them, and document and file leave them out.
#[test]
fn zeros_of_the_nominal_model_are_left_out() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method base-tool --out arm.blob --json - --controller-csv controller.csv"
    );
    let document = folder.run(&line).ok().json();
    let refused = folder.run("export arm.blob --joint-offsets zeros.json");
    assert_eq!(refused.code, Some(1));
    assert_eq!(document["controller"]["joint_zeros"], serde_json::json!([]));
    assert!(!folder.text("controller.csv").contains("joint_zero"));
}

/// A calibration by touches has the rows for the controller, but no standard deviations and no signed errors.
#[test]
fn touches_have_rows() {
    let folder = Folder::new();
    folder
        .run("simulate --robot ur10 --touch socket2,plane1 --touches 30 --seed 5 --out t")
        .ok();
    folder
        .run("calibrate --robot ur10 t/touches.csv --out a.blob --report a.html --json a.json --controller-csv a.csv")
        .ok();
    let document = folder.json("a.json");
    assert_eq!(document["controller"]["dh"].as_array().unwrap().len(), 6);
    assert!(document["controller"]["residuals"].is_null());
    assert!(
        folder
            .text("a.html")
            .contains("Standard deviations are not known for this model.")
    );
    assert!(folder.text("a.csv").contains("\ndh,"));
}

/// A model without processes has standard deviations of its frames, and does not report noise as geometry.
#[test]
fn a_parametric_model_has_deviations() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 100));
    let line = "calibrate --robot abb-irb4400-serial train.csv --method parametric --out arm.blob";
    folder.run(&format!("{line} --json arm.json")).ok();
    let document = folder.json("arm.json");
    let dh = document["controller"]["dh"].as_array().unwrap();
    let std = |row: &Value| row["theta_deg"]["std"].as_f64();
    assert!(dh[1..5].iter().all(|row| std(row) > Some(0.0)), "{dh:?}");
    let why = document["next_steps"]["why"].as_str().unwrap();
    assert!(
        why.contains("the scatter of the rows about this `parametric` model"),
        "{why}"
    );
}
