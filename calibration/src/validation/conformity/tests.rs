//! Laws of the error, its uncertainty and the verdict.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::budget::{Evaluation, Source};
use super::*;
use crate::measurement::instrument_drift::DriftReport;
use crate::measurement::noise::InstrumentNoise;
use crate::numeric::statistics::PoseError;
use crate::validation::conformity::error_quantile::DECLARED_NOISE_UNCERTAINTY;

/// Held-out poses with these residuals of position in mm, and a rotation of a tenth of that in mrad.
fn poses(residuals: &[[f64; 3]], sigma_mm: Option<f64>) -> Vec<HeldOutPose> {
    let pose = |r: &[f64; 3]| {
        let norm = r.iter().map(|x| x * x).sum::<f64>().sqrt();
        HeldOutPose {
            error: PoseError {
                position_mm: norm,
                orientation_mrad: Some(0.1 * norm),
            },
            position: [0.0; 3],
            residual: core::array::from_fn(|i| if i < 3 { 1e-3 * r[i] } else { 1e-4 * r[i - 3] }),
            sigma: None,
            noise: InstrumentNoise {
                position: sigma_mm.map(|x| 1e-3 * x),
                orientation: sigma_mm.map(|x| 1e-4 * x),
            },
        }
    };
    residuals.iter().map(pose).collect()
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// Residuals whose size differs from pose to pose, as those of an arm, with noise.
fn drawn(count: usize, noise: f64, random: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
    (0..count)
        .map(|_| {
            let size = 0.1 * libm::exp(0.6 * normal(random));
            core::array::from_fn(|_| size * normal(random) + noise * normal(random))
        })
        .collect()
}

fn found(residuals: &[[f64; 3]], sigma: Option<f64>, tolerance: Option<f64>) -> Conformity {
    let tolerances = Tolerances {
        position_mm: tolerance,
        ..Tolerances::default()
    };
    Conformity::new(&poses(residuals, sigma), &Knowledge::default(), &tolerances).unwrap()
}

/// SciPy on finer grids with Gauss–Hermite quadrature of 61 nodes, and Student's table.
#[test]
fn quantiles_are_those_of_others() {
    let errors = [
        0.11, 0.32, 0.07, 0.25, 0.18, 0.41, 0.09, 0.14, 0.22, 0.30, 0.05, 0.16,
    ];
    let residuals = errors.map(|e| [e, 0.0, 0.0]);
    for (sigma, error, uncertainty) in [
        (None, 0.447_720, 0.165_957),
        (Some(0.03), 0.457_759, 0.196_913),
    ] {
        let position = found(&residuals, sigma, None).position;
        let model = &position.budget[2];
        assert_eq!(model.source, Source::Model);
        assert!((position.error / error - 1.0_f64).abs() < 0.01);
        assert!((model.standard_uncertainty.unwrap() / uncertainty - 1.0).abs() < 0.05);
    }
    for (freedom, coverage, factor) in [
        (Some(2.0), 0.95, 4.302_652_73),
        (Some(10.0), 0.95, 2.228_138_85),
        (Some(10.0), 0.99, 3.169_272_67),
        (Some(200.0), 0.95, 1.971_896_22),
        (Some(2000.0), 0.95, 1.961_150_82),
        (None, 0.95, 1.959_963_98),
    ] {
        assert!(
            (student(freedom, coverage) - factor).abs() < 1e-6,
            "{freedom:?}"
        );
    }
}

/// Errors that are smaller than the noise that the file declares keep it: it is declared wrongly.
#[test]
fn a_noise_that_the_errors_contradict_is_not_removed() {
    let residuals = drawn(60, 0.0, &mut ChaCha8Rng::seed_from_u64(9));
    let plain = found(&residuals, None, None).position;
    let contradicted = found(&residuals, Some(0.5), None).position;
    assert_eq!(contradicted.error, plain.error);
    // Also of errors that have a third of it.
    let residuals = drawn(100, 0.2, &mut ChaCha8Rng::seed_from_u64(14));
    let plain = found(&residuals, None, None).position;
    let contradicted = found(&residuals, Some(0.6), None).position;
    assert_eq!(contradicted.error, plain.error);
    // A true one is.
    let residuals = drawn(400, 0.1, &mut ChaCha8Rng::seed_from_u64(10));
    let plain = found(&residuals, None, None).position;
    let small = found(&residuals, Some(0.1), None).position;
    assert!(small.error < 0.98 * plain.error);
}

/// A file declares three times the noise. It is removed up to what the fit found, so that E + U remains above the arm's own
/// quantile; a fit that finds nearly the declared noise changes nothing.
#[test]
fn a_declared_noise_that_the_fit_contradicts_is_not_removed() {
    let (noise, arm, draws) = (0.02, 0.025, 60);
    let mut wrong = [0; 2];
    // 0.95 quantile of the length of three normal components.
    let truth = arm * 2.795;
    for seed in 0..draws {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let all: Vec<[f64; 3]> = (0..60)
            .map(|_| {
                core::array::from_fn(|_| arm * normal(&mut random) + noise * normal(&mut random))
            })
            .collect();
        let poses = poses(&all, Some(3.0 * noise));
        for (count, fitted) in wrong.iter_mut().zip([Some(1.05 * noise), None]) {
            let knowledge = Knowledge {
                fitted_noise: [fitted, None],
                ..Knowledge::default()
            };
            let found = Conformity::new(&poses, &knowledge, &Tolerances::default()).unwrap();
            *count += u64::from(found.position.met < truth);
        }
    }
    println!("E + U below the truth: {wrong:?} of {draws}");
    assert!(wrong[0] <= draws / 20 && wrong[1] > draws / 2, "{wrong:?}");
    let residuals = drawn(60, 0.02, &mut ChaCha8Rng::seed_from_u64(3));
    let poses = poses(&residuals, Some(0.02));
    let of = |fitted| {
        let knowledge = Knowledge {
            fitted_noise: [fitted, fitted],
            ..Knowledge::default()
        };
        Conformity::new(&poses, &knowledge, &Tolerances::default()).unwrap()
    };
    let [alone, near] = [None, Some(0.016)].map(of);
    assert_eq!(alone.position.met, near.position.met);
}

#[test]
fn the_budget_adds_up() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let residuals = drawn(50, 0.03, &mut random);
    let knowledge = Knowledge {
        instrument: [Some(0.01), None],
        ..Knowledge::default()
    };
    let poses = poses(&residuals, Some(0.03));
    let conformity = Conformity::new(&poses, &knowledge, &Tolerances::default()).unwrap();
    for found in [
        &conformity.position,
        conformity.orientation.as_ref().unwrap(),
    ] {
        let squares = |c: &Contribution| c.standard_uncertainty.unwrap_or(0.0).powi(2);
        let sum: f64 = found.budget.iter().map(squares).sum();
        assert!((sum.sqrt() - found.combined).abs() < 1e-15);
        let shares: f64 = found.budget.iter().map(|c| c.share).sum();
        assert!((shares - 1.0).abs() < 1e-12);
        assert_eq!(found.expanded, found.coverage_factor * found.combined);
        assert_eq!(found.met, found.error + found.expanded);
    }
    let row = |source: Source| {
        let rows = &conformity.position.budget;
        rows.iter().find(|c| c.source == source).unwrap()
    };
    assert!(row(Source::Instrument).standard_uncertainty.unwrap() > 0.01);
    assert_eq!(row(Source::BaseAndTool).standard_uncertainty, Some(0.0));
    assert_eq!(row(Source::Model).evaluation, Evaluation::A);
    assert_eq!(row(Source::Drift).standard_uncertainty, None);
    assert_eq!(row(Source::Repeatability).standard_uncertainty, Some(0.0));
}

/// A motion of 3 and 4 µm along two axes is one of 5 µm; removed, what the reference points leave remains.
#[test]
fn the_drift_of_the_instrument_has_its_row() {
    let report = DriftReport {
        points: 3,
        misses: 0,
        missed_lines: Vec::new(),
        outliers: 0,
        outlier_lines: Vec::new(),
        poses_without: 0,
        motion: "rigid",
        window_poses: [None; 3],
        std_um: [1.0; 3],
        moved_mm: 5e-3,
        max_um: [3.0, 0.0, 4.0],
        max_urad: 60.0,
        left_out_um: [3.0, 1.0],
    };
    let residuals = drawn(50, 0.0, &mut ChaCha8Rng::seed_from_u64(4));
    let uncertainty = |is_removed| {
        let knowledge = Knowledge {
            drift: Some((&report, is_removed)),
            ..Knowledge::default()
        };
        let poses = poses(&residuals, None);
        let conformity = Conformity::new(&poses, &knowledge, &Tolerances::default()).unwrap();
        let row = |found: &Characteristic| {
            let mut rows = found.budget.iter();
            let row = rows.find(|c| c.source == Source::Drift).unwrap();
            row.standard_uncertainty.unwrap()
        };
        [
            row(&conformity.position),
            row(conformity.orientation.as_ref().unwrap()),
        ]
    };
    // Half the width of a rectangle over √3.
    let [position, rotation] = uncertainty(false);
    assert!((position - 0.002_886_751).abs() < 1e-9, "{position}");
    assert!((rotation - 0.034_641_016).abs() < 1e-9, "{rotation}");
    let [position, rotation] = uncertainty(true);
    assert!((position - 0.001).abs() < 1e-12, "{position}");
    assert_eq!(rotation, 0.0);
}

/// ISO 14253-1: the guard band is U on both sides of the tolerance.
#[test]
fn the_verdict_has_a_guard_band() {
    let residuals = drawn(60, 0.0, &mut ChaCha8Rng::seed_from_u64(5));
    let free = found(&residuals, None, None);
    assert_eq!((free.verdict, free.position.verdict), (None, None));
    let Characteristic {
        error, expanded, ..
    } = free.position;
    assert!(expanded > 0.05 * error && expanded < error);
    let verdict = |tolerance: f64| found(&residuals, None, Some(tolerance)).verdict.unwrap();
    assert_eq!(verdict(error + 1.001 * expanded), Verdict::Conforms);
    assert_eq!(verdict(error + 0.999 * expanded), Verdict::Undecided);
    assert_eq!(verdict(error - 0.999 * expanded), Verdict::Undecided);
    assert_eq!(verdict(error - 1.001 * expanded), Verdict::DoesNotConform);
}

/// Measuring a pose again says nothing of other poses.
#[test]
fn a_repeated_pose_counts_once() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let once = drawn(30, 0.0, &mut random);
    let (mut again, mut repeats) = (Vec::new(), Vec::new());
    for (i, truth) in once.iter().enumerate() {
        for _ in 0..25 {
            again.push(core::array::from_fn(|a| {
                truth[a] + 0.03 * normal(&mut random)
            }));
            repeats.push(i);
        }
    }
    let knowledge = Knowledge {
        repeats: &repeats,
        ..Knowledge::default()
    };
    let again = poses(&again, Some(0.03));
    let again = Conformity::new(&again, &knowledge, &Tolerances::default()).unwrap();
    let once = found(&once, None, None);
    let (again, once) = (again.position, once.position);
    assert_eq!(again.poses, 30);
    assert!((again.error / once.error - 1.0).abs() < 0.02);
    assert!((again.expanded / once.expanded - 1.0).abs() < 0.1);
}

/// The arm's repeatability is an error of the arm, also of poses that were measured many times: E is the same as of poses that
/// were measured once. Without a stated noise, nothing is removed.
#[test]
fn repeatability_is_an_error_of_the_arm() {
    let mut random = ChaCha8Rng::seed_from_u64(15);
    let mut visit = |at: &[f64; 3]| at.map(|x| x + 0.124 * normal(&mut random));
    let at = drawn(60, 0.0, &mut ChaCha8Rng::seed_from_u64(16));
    let once: Vec<[f64; 3]> = at.iter().map(&mut visit).collect();
    let (mut again, mut repeats) = (once.clone(), (0..60).collect::<Vec<usize>>());
    for (i, at) in at.iter().enumerate().take(20) {
        again.extend((0..30).map(|_| visit(at)));
        repeats.extend([i; 30]);
    }
    let knowledge = Knowledge {
        repeats: &repeats,
        ..Knowledge::default()
    };
    for sigma in [None, Some(0.03)] {
        let of_once = found(&once, sigma, None).position;
        let again = poses(&again, sigma);
        let again = Conformity::new(&again, &knowledge, &Tolerances::default());
        let again = again.unwrap().position;
        println!(
            "{sigma:?}: {:.4} once, {:.4} again",
            of_once.error, again.error
        );
        assert!((again.error - of_once.error).abs() < 0.15 * of_once.error);
    }
    // A stated noise is no larger than the scatter of repeats.
    let overstated = poses(&again, Some(0.3));
    let overstated = Conformity::new(&overstated, &knowledge, &Tolerances::default()).unwrap();
    let instrument = &overstated.position.budget[0];
    assert_eq!(instrument.degrees_of_freedom, Some(3.0 * 30.0 * 20.0));
}

#[test]
fn few_poses_say_nothing() {
    let few = poses(&[[0.1, 0.0, 0.0]; LEAST_POSES - 1], None);
    let tolerances = Tolerances::default();
    assert_eq!(
        Conformity::new(&few, &Knowledge::default(), &tolerances),
        None
    );
}

/// Residuals of a known distribution.
type Draw = fn(&mut ChaCha8Rng) -> [f64; 3];

const TWO_KINDS: &str = "two kinds";

/// Distributions unlike each other: that of the family, one with errors of one size, one where a pose of eight is four
/// times as far off, and one along a line.
const DISTRIBUTIONS: [(&str, Draw); 4] = [
    ("family", |random| drawn(1, 0.0, random)[0]),
    ("bounded", |random| {
        let direction: [f64; 3] = core::array::from_fn(|_| normal(random));
        let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        let size = 0.1 * (1.0 + 0.3 * normal(random).clamp(-2.0, 2.0));
        direction.map(|x| size * x / length)
    }),
    (TWO_KINDS, |random| {
        let size = if normal(random) > 1.15 { 0.2 } else { 0.05 };
        core::array::from_fn(|_| size * normal(random))
    }),
    ("line", |random| [0.1 * normal(random), 0.0, 0.0]),
];

/// Poses of known distributions: E ± U covers the true 95 % quantile, and "conforms" is seldom wrong. Of two kinds of
/// poses that are far apart, symmetric limits about a skewed estimate miss more than of the others.
#[test]
fn the_expanded_uncertainty_covers() {
    const RUNS: usize = 60;
    let mut random = ChaCha8Rng::seed_from_u64(11);
    for (name, draw) in DISTRIBUTIONS {
        let norm = |r: [f64; 3]| r.iter().map(|x| x * x).sum::<f64>().sqrt();
        let mut all: Vec<f64> = (0..100_000).map(|_| norm(draw(&mut random))).collect();
        all.sort_by(f64::total_cmp);
        let truth = all[95_000];
        for (count, sigma) in [(40, 0.0), (100, 0.05)] {
            let (mut covered, mut wrong) = (0, 0);
            for _ in 0..RUNS {
                let noisy = |_| {
                    let residual = draw(&mut random);
                    residual.map(|x| x + sigma * normal(&mut random))
                };
                let residuals: Vec<[f64; 3]> = (0..count).map(noisy).collect();
                let position = found(&residuals, Some(sigma), None).position;
                covered += usize::from((position.error - truth).abs() <= position.expanded);
                // The tolerance that the arm just misses.
                wrong += usize::from(position.met < truth);
            }
            let share = |count: usize| count as f64 / RUNS as f64;
            println!(
                "{name}, {count} poses, noise {sigma} mm: covered {:.3}, wrongly conforms {:.3}",
                share(covered),
                share(wrong)
            );
            let missed = if name == TWO_KINDS { 0.2 } else { 0.14 };
            assert!(
                share(covered) >= 1.0 - missed,
                "{name}, {count}: {}",
                share(covered)
            );
            assert!(share(wrong) <= missed, "{name}, {count}: {}", share(wrong));
        }
    }
}

/// A declared noise that is wrong by what the budget states of it, of arms that are better than their noise.
#[test]
fn the_uncertainty_of_a_declared_noise_covers() {
    const RUNS: usize = 40;
    let mut random = ChaCha8Rng::seed_from_u64(13);
    let norm = |r: &[f64; 3]| r.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut all: Vec<f64> = drawn(100_000, 0.0, &mut random).iter().map(norm).collect();
    all.sort_by(f64::total_cmp);
    let truth = all[95_000];
    for (count, sigma) in [(40, 0.2), (100, 0.4)] {
        let (mut covered, mut wrong) = (0, 0);
        for _ in 0..RUNS {
            let residuals = drawn(count, sigma, &mut random);
            let wrong_by = 1.0 + DECLARED_NOISE_UNCERTAINTY * normal(&mut random);
            let position = found(&residuals, Some(sigma / wrong_by), None).position;
            covered += usize::from((position.error - truth).abs() <= position.expanded);
            wrong += usize::from(position.met < truth);
        }
        println!(
            "{count} poses, noise {sigma} mm: {covered} of {RUNS} covered, {wrong} wrongly conform"
        );
        assert!(covered >= RUNS * 8 / 10, "{covered}");
        assert!(wrong <= RUNS * 2 / 10, "{wrong}");
    }
}

/// With many poses, E is their percentile, and U falls with the root of their number.
#[test]
fn many_poses_speak_for_themselves() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let (_, draw) = DISTRIBUTIONS[2];
    let all: Vec<[f64; 3]> = (0..4_000).map(|_| draw(&mut random)).collect();
    let mut before = None;
    for count in [1_000, 4_000] {
        let poses = &all[..count];
        let norm = |r: &[f64; 3]| r.iter().map(|x| x * x).sum::<f64>().sqrt();
        let mut norms: Vec<f64> = poses.iter().map(norm).collect();
        norms.sort_by(f64::total_cmp);
        let percentile = norms[count * 95 / 100];
        let position = found(poses, None, None).position;
        println!(
            "{count} poses: {percentile:.4} mm, found {:.4} ± {:.4} mm",
            position.error, position.expanded
        );
        assert!((position.error / percentile - 1.0).abs() < 0.01);
        if let Some(before) = before {
            let ratio: f64 = before / position.expanded;
            assert!((1.6..2.6).contains(&ratio), "{ratio}");
        }
        before = Some(position.expanded);
    }
}
