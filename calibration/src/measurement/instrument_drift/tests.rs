use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write as _;

use crate::measurement as measurements;
use crate::measurement::instrument_drift::*;
use crate::measurement::observation::Observation;
use crate::measurement::sample::Instrument;

const POSES: usize = 300;

/// A file whose target does not move: what is left of its positions after the correction is what was done wrong.
struct Simulated {
    text: String,
    /// Apparent motion at the target, metres.
    motion: Vec<Vector3<f64>>,
}

fn simulate(points: usize, rotate: f64, flaws: bool) -> Simulated {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let places = [
        [2400.0, 540.0, -560.0],
        [2900.0, 820.0, -557.0],
        [2770.0, -5.0, -562.0],
    ];
    let target = Vector3::new(2600.0, 200.0, -90.0);
    let mut text = String::from("q1_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz");
    for i in 1..=points {
        let _ = write!(text, ",ref{i}_x_mm,ref{i}_y_mm,ref{i}_z_mm");
    }
    text.push('\n');
    let mut motion = Vec::new();
    for k in 0..POSES {
        let time = k as f64 / POSES as f64;
        // A creep, and a step of 0.8 mm that is no outlier.
        let shift = Vector3::new(
            0.12 * time,
            0.05 * libm::sin(9.0 * time),
            if k > 170 { 0.8 } else { 0.0 },
        );
        let turn = Vector3::new(0.0, 0.0, rotate * libm::sin(5.0 * time));
        let seen = |p: Vector3<f64>| p + shift + turn.cross(&(p - Vector3::from(places[0])));
        motion.push(1e-3 * (seen(target) - target));
        let mut noise =
            || -> f64 { 0.003_f64 * Distribution::<f64>::sample(&StandardNormal, &mut random) };
        let t = seen(target);
        let _ = write!(text, "{},{},{},{},1,0,0,0", k % 90, t[0], t[1], t[2]);
        for (i, place) in places.iter().enumerate().take(points) {
            let mut p = seen(Vector3::from(*place));
            p += Vector3::new(noise(), noise(), noise());
            match (flaws, (k + 13 * i) % 50) {
                (true, 7) => text += ",0,0,0",
                (true, 31) => {
                    let _ = write!(text, ",{},{},{}", p[0] + 3.0, p[1], p[2] - 0.7);
                }
                _ => {
                    let _ = write!(text, ",{},{},{}", p[0], p[1], p[2]);
                }
            }
        }
        text.push('\n');
    }
    let _ = random.random::<f64>();
    Simulated { text, motion }
}

/// RMS per axis in µm of the target's positions before and after, about their means.
fn rms_um(s: &Simulated) -> (f64, f64, DriftReport) {
    let set = measurements::parse("drift.csv", s.text.as_bytes()).unwrap();
    let drift = Drift::estimate(&set).unwrap();
    let seen = set.measurements.iter().map(|m| {
        let joints = m.joints.clone();
        Sample::new(
            joints.clone(),
            joints,
            Observation::Position(m.position),
            Instrument,
        )
    });
    let seen: Vec<InstrumentSample> = seen.collect();
    let rms = |samples: &[InstrumentSample]| {
        let positions = || samples.iter().map(|s| s.observation.position());
        let mean = positions().sum::<Vector3<f64>>() / POSES as f64;
        let square: f64 = positions().map(|p| (p - mean).norm_squared()).sum();
        1e6 * (square / (3 * POSES) as f64).sqrt()
    };
    (rms(&seen), rms(&drift.correct(&seen)), drift.report)
}

#[test]
fn translation_with_misses_and_outliers() {
    for points in [1, 2, 3] {
        let (before, after, report) = rms_um(&simulate(points, 0.0, true));
        assert_eq!(report.points, points);
        assert_eq!(report.misses, 6 * points, "{report:?}");
        assert_eq!(report.outliers, 6 * points, "{report:?}");
        assert_eq!(report.outlier_lines.len(), 5);
        assert_eq!(report.motion, "translation");
        // The noise of a point is 3 µm; one point has to be smoothed across the step.
        assert!(before > 200.0, "{before}");
        let allowed = if points == 1 { 40.0 } else { 4.0 };
        assert!(
            after < allowed,
            "{points} points: {before} → {after}, {report:?}"
        );
        assert!(report.max_um[2] > 350.0, "{report:?}");
    }
}

/// An instrument that creeps straight on has moved by the whole way at the end, not by the distance from its mean place.
#[test]
fn a_creep_is_as_long_as_the_way_from_the_first_row() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut text = String::from("q1_deg,x_mm,y_mm,z_mm,ref1_x_mm,ref1_y_mm,ref1_z_mm\n");
    for k in 0..100 {
        let mut noise =
            || -> f64 { 0.002_f64 * Distribution::<f64>::sample(&StandardNormal, &mut random) };
        let way = f64::from(k) / 99.0;
        let [x, y, z] = [0.4, -0.2, 0.1].map(|end| end * way + noise());
        writeln!(
            text,
            "{k},{x},{y},{z},{},{},{}",
            500.0 + x,
            800.0 + y,
            z - 300.0
        )
        .unwrap();
    }
    let set = measurements::parse("creep.csv", text.as_bytes()).unwrap();
    let moved = Drift::estimate(&set).unwrap().report.moved_mm;
    let truth = (0.4_f64 * 0.4 + 0.2 * 0.2 + 0.1 * 0.1).sqrt();
    assert!(
        (moved / truth - 1.0).abs() < 0.05,
        "{moved} mm, not {truth}"
    );
}

#[test]
fn rotation_only_where_it_clearly_helps() {
    let (_, after, report) = rms_um(&simulate(3, 200e-6, true));
    assert_eq!(report.motion, "rigid", "{report:?}");
    assert!(after < 8.0, "{after} {report:?}");
    assert!((150.0..300.0).contains(&report.max_urad), "{report:?}");
    let (_, _, report) = rms_um(&simulate(2, 200e-6, true));
    assert_eq!(report.motion, "translation");
}

#[test]
fn an_instrument_that_stands_still_is_left_alone() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut text = String::from(
        "q1_deg,x_mm,y_mm,z_mm,ref1_x_mm,ref1_y_mm,ref1_z_mm,ref2_x_mm,ref2_y_mm,ref2_z_mm\n",
    );
    for k in 0..200 {
        let mut noise =
            || -> f64 { 0.02_f64 * Distribution::<f64>::sample(&StandardNormal, &mut random) };
        let _ = writeln!(
            text,
            "{k},1000,0,0,{},{},{},{},{},{}",
            900.0 + noise(),
            noise(),
            noise(),
            noise(),
            800.0 + noise(),
            noise()
        );
    }
    let set = measurements::parse("still.csv", text.as_bytes()).unwrap();
    let drift = Drift::estimate(&set).unwrap();
    let largest = drift.report.max_um.iter().fold(0.0_f64, |m, x| m.max(*x));
    assert!(largest < 10.0, "{:?}", drift.report);
    assert_eq!(drift.report.outliers, 0);
}

#[test]
fn poses_alone_never_change_the_correction() {
    let s = simulate(3, 0.0, true);
    let set = measurements::parse("drift.csv", s.text.as_bytes()).unwrap();
    let mut other = set.clone();
    for m in &mut other.measurements {
        m.position += Vector3::new(0.1, -0.2, 0.3);
    }
    let (a, b) = (
        Drift::estimate(&set).unwrap(),
        Drift::estimate(&other).unwrap(),
    );
    assert_eq!(a.seen_from_true, b.seen_from_true);
    // In the direction of the truth.
    let end = a.seen_from_true[POSES - 1].translation - a.seen_from_true[0].translation;
    assert!((end - (s.motion[POSES - 1] - s.motion[0])).norm() < 10e-6);
}

#[test]
fn refused() {
    let set = measurements::parse("none.csv", b"q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n").unwrap();
    let error = Drift::estimate(&set).unwrap_err().to_string();
    assert!(error.contains("no reference points"), "{error}");
    let header = "q1_deg,x_mm,y_mm,z_mm,ref1_x_mm,ref1_y_mm,ref1_z_mm\n";
    let missed = format!("{header}1,2,3,4,0,0,0\n2,3,4,5,0,0,0\n");
    let set = measurements::parse("missed.csv", missed.as_bytes()).unwrap();
    let error = Drift::estimate(&set).unwrap_err().to_string();
    assert!(error.contains("never measured"), "{error}");
    let at = |x: f64| {
        let text = format!("{header}1,2,3,4,{x},0,0\n2,3,4,5,{x},0,0\n");
        measurements::parse("at.csv", text.as_bytes()).unwrap()
    };
    let training = Drift::estimate(&at(100.0)).unwrap();
    assert!(Drift::estimate_as(&at(101.0), &training).is_ok());
    let error = Drift::estimate_as(&at(200.0), &training).unwrap_err();
    assert!(error.to_string().contains("100.0 mm"), "{error}");
}

#[test]
fn reference_points_in_metres_under_mm_are_refused() {
    let s = simulate(3, 0.0, false);
    let scaled = |factor: f64| {
        let mut lines = s.text.lines();
        let mut text = lines.next().unwrap().to_owned();
        for line in lines {
            let fields = line.split(',').enumerate().map(|(i, field)| match i {
                0..8 => field.to_owned(),
                _ => (factor * field.parse::<f64>().unwrap()).to_string(),
            });
            text += &format!("\n{}", fields.collect::<Vec<_>>().join(","));
        }
        let set = measurements::parse("test.csv", text.as_bytes()).unwrap();
        Drift::estimate(&set).err().map(|error| error.to_string())
    };
    assert_eq!(scaled(1.0), None);
    let error = scaled(1e-3).unwrap();
    assert!(error.contains("repeats within"), "{error}");
}
