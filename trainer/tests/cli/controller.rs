//! The numbers for the controller's engineer: standard deviations by drawn frames, signed residuals by hand, one document, page and
//! file.

use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Instrument, InstrumentSample, Sample, ToolName};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::validation::next_steps::Knowledge;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_trainer::export::CalibratedChain;
use poegp_trainer::export::dh::{deviations, numbers, rows_beside_drawing, wrapped};
use poegp_trainer::report::controller::ControllerSummary;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::export::{calibrated, chain};

/// A normal number, by the sum of twelve even ones.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// Standard deviations of DH rows from a covariance of frames, beside those of rows of drawn frames.
#[test]
fn deviations_of_dh_rows_are_those_of_drawn_frames() {
    for robot in ["abb-irb120", "ur5"] {
        let folder = calibrated(robot, "poe");
        let chain = chain(&folder);
        let size = 6 * chain.frames.len();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // 10 µm and 10 µrad of every number, and strongly correlated.
        let root = Mat::from_fn(size, size, |_, _| {
            1e-5 / (size as f64).sqrt() * normal(&mut random)
        });
        let stated = deviations(&chain, &(&root * root.transpose()));
        let (_, rows) = rows_beside_drawing(&chain);
        let mut squares = vec![[0.0; 5]; rows.len()];
        const DRAWS: usize = 4000;
        for _ in 0..DRAWS {
            let drawn = &root * Mat::from_fn(size, 1, |_, _| normal(&mut random));
            let other = moved(&chain, |k| drawn[(k, 0)]);
            let (_, others) = rows_beside_drawing(&other);
            for ((square, row), moved) in squares.iter_mut().zip(&rows).zip(&others) {
                for i in 0..5 {
                    square[i] += wrapped(numbers(moved)[i] - numbers(row)[i]).powi(2);
                }
            }
        }
        for (joint, (stated, square)) in stated.iter().zip(&squares).enumerate() {
            for i in 0..5 {
                let found = (square[i] / DRAWS as f64).sqrt();
                eprintln!(
                    "{robot} joint {joint} number {i}: stated {:.3e}, found {found:.3e}",
                    stated[i]
                );
                assert!(
                    (stated[i] - found).abs() < 0.05 * found + 1e-9,
                    "{robot}, joint {joint}, number {i}: {:.3e} and {found:.3e}",
                    stated[i]
                );
            }
        }
    }
}

/// `chain` with its frames moved from the left, six numbers each.
fn moved(chain: &CalibratedChain, step: impl Fn(usize) -> f64) -> CalibratedChain {
    let mut out = chain.clone();
    for (i, frame) in out.frames.iter_mut().enumerate() {
        let twist = std::array::from_fn(|k| step(6 * i + k));
        *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
    }
    out
}

/// A rigid arm is measured again and again, each time with fresh noise, and calibrated: the scatter of the DH rows and joint zeros that
/// the blobs have is what one calibration states.
#[test]
fn deviations_are_those_of_repeated_calibrations() {
    const REPEATED: u64 = 60;
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    let drawing = robot.chain().unwrap();
    let truth = {
        let mut frames = drawing.frames().to_vec();
        for (i, frame) in frames.iter_mut().enumerate() {
            let twist = std::array::from_fn(|k| 4e-4 * (1.7 * (6 * i + k) as f64).sin());
            *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
        }
        Poe::new(drawing.kinds(), &frames).unwrap()
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
            // Zero by convention. Flange and base take what the rows cannot.
            assert!(found < 1e-9, "{name}: {found:.1e}");
            continue;
        }
        eprintln!("{name}: stated {stated:.5}, found {found:.5}");
        // Sixty values have a standard deviation that is known to 9 %.
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
