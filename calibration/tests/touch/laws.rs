//! Laws of the fit on simulated touches: how a change of the readings or of what is stated must change the model.

use nalgebra::Vector3;
use poegp_calibration::identification::touch::fit::TouchProblem;
use poegp_calibration::identification::touch::unseen::Direction;
use poegp_calibration::measurement::touch::{FeatureKind, Reading, TouchRow, TouchSet};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::touches::class_of;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_calibration::validation::conformity::{Conformity, Tolerances, Verdict};
use poegp_protocol::cause::Cause;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::sets::{Truth, mean_mm};
use crate::trial::{Trial, simulated, task, trial};

fn robot() -> Robot {
    Robot::load("abb-irb120", &LoadOptions::default()).unwrap()
}

fn touched(tasks: &[(&str, usize)], count: usize, seed: u64) -> (TouchSet, Truth) {
    simulated(&robot(), Scenario::Paper, tasks, count, seed).unwrap()
}

fn problem(set: &TouchSet) -> TouchProblem<'_> {
    let robot = robot();
    let gravity = Vector3::from(Config::default().gravity_m_s2);
    let (chain, class) = (robot.chain().unwrap(), class_of(&robot, set));
    TouchProblem::new(set, &chain, robot.coupling, gravity, class)
}

fn score((set, truth): &(TouchSet, Truth)) -> (f64, Trial) {
    let of = trial(&robot(), set, truth);
    (mean_mm(&of.calibrated), of)
}

/// Three readings of a wire that are 5 mm wrong are listed as outliers and hardly change the result.
#[test]
fn outliers_are_listed() {
    let mut data = touched(&[("wire", 1)], 80, 21);
    let (clean, none) = score(&data);
    assert!(none.found.summary.outliers.is_empty());
    let mut lines = Vec::new();
    for k in [7, 33, 61] {
        let row = &mut data.0.rows[k];
        lines.push(row.line);
        if let Reading::Anchor { value, .. } = &mut row.reading {
            *value += 5e-3;
        }
    }
    let (with, found) = score(&data);
    let listed: Vec<usize> = found
        .found
        .summary
        .outliers
        .iter()
        .map(|o| o.line)
        .collect();
    assert_eq!(listed, lines);
    assert!(
        (with / clean - 1.0).abs() < 0.2,
        "{clean:.4} → {with:.4} mm"
    );
}

/// Without the known distance between two sockets the size is not determined, and the expected error is larger.
#[test]
fn a_known_distance_shows_the_size() {
    let mut data = touched(&[("socket", 2)], 40, 22);
    let says = |of: &Trial| {
        of.found
            .summary
            .unseen
            .iter()
            .any(|u| u.direction == Direction::Size)
    };
    let (_, with) = score(&data);
    // Where a distance is stated, but hardly known, none is asked for as if it were missing.
    let mut vague = data.clone();
    vague.0.distances.iter_mut().for_each(|d| d.sigma = 20e-3);
    let (_, vague) = score(&vague);
    let texts =
        |of: &Trial| -> String { of.found.summary.unseen.iter().map(|u| &*u.text).collect() };
    assert!(says(&vague) && texts(&vague).contains("The lengths in these touches hardly show"));
    data.0.distances.clear();
    let (_, without) = score(&data);
    assert!(!says(&with) && says(&without));
    assert!(texts(&without).contains("unknown points cannot show the arm's size"));
    let [a, b] = [&with, &without].map(|of| of.found.summary.after.mean_mm);
    assert!(b > 1.1 * a, "{a:.3} with the distance, {b:.3} without");
}

/// What the touches leave to the class of the arm is no evidence for a tolerance, unless it hardly matters for it.
#[test]
fn a_verdict_does_not_rest_on_the_class() {
    let mut data = touched(&[("socket", 2)], 40, 22);
    let verdict = |of: &Trial, tolerance_mm: f64| {
        let tolerances = Tolerances {
            position_mm: Some(tolerance_mm),
            ..Tolerances::default()
        };
        let summary = &of.found.summary;
        let found = Conformity::of_touches(&of.known.exceeded, &tolerances, |tolerance| {
            summary.left_to_class(tolerance)
        });
        (found.verdict.unwrap(), found.withheld)
    };
    let (_, with) = score(&data);
    let met = Conformity::of_touches(&with.known.exceeded, &Tolerances::default(), |_| None);
    let met = met.position.met;
    assert_eq!(verdict(&with, 1.01 * met), (Verdict::Conforms, None));
    data.0.distances.clear();
    let (_, without) = score(&data);
    let met = Conformity::of_touches(&without.known.exceeded, &Tolerances::default(), |_| None);
    let met = met.position.met;
    let (undecided, withheld) = verdict(&without, 1.01 * met);
    assert_eq!(undecided, Verdict::Undecided);
    assert!(withheld.unwrap().contains("cannot show the arm's size"));
    assert_eq!(verdict(&without, 0.99 * met), (Verdict::Undecided, None));
    assert_eq!(verdict(&without, 30.0 * met), (Verdict::Conforms, None));
    // Without a tolerance, none is said to be met.
    let tolerances = Tolerances::default();
    let found = Conformity::of_touches(&without.known.exceeded, &tolerances, |tolerance| {
        without.found.summary.left_to_class(tolerance)
    });
    assert!(found.verdict.is_none() && found.withheld.is_some());
    // An arm that is far outside its class: nothing is left to it, whatever was touched.
    let mut outside = with.found.summary.clone();
    outside.beyond_class = Some(2.2);
    assert!(
        outside
            .left_to_class(30.0 * met)
            .unwrap()
            .contains("2.2 times")
    );
}

/// A level whose columns are exchanged is named, and one that is only noisy is not.
#[test]
fn a_level_with_exchanged_columns_is_named() {
    let right = touched(&[("socket", 2), ("level", 1)], 40, 35);
    let mut wrong = right.clone();
    for row in &mut wrong.0.rows {
        if let Reading::Level { gravity, .. } = &mut row.reading {
            *gravity = Vector3::new(gravity.y, gravity.x, gravity.z);
        }
    }
    let [right, wrong] = [right, wrong].map(|data| score(&data).1);
    let named = |of: &Trial| {
        let mut all = of.found.findings.0.iter();
        all.any(|f| f.cause == Cause::Noise && f.text.contains("gx, gy and gz are exchanged"))
    };
    assert!(!named(&right), "{:#?}", right.found.findings);
    assert!(named(&wrong), "{:#?}", wrong.found.findings);
    assert_eq!(wrong.found.summary.play_mm, right.found.summary.play_mm);
}

/// Touches that scatter ten times as much as they declare: the fit finds the additional noise τ, and its statements hold.
#[test]
fn noise_beyond_what_is_stated_is_found() {
    let mut data = touched(&[("socket", 2)], 80, 23);
    for feature in &mut data.0.features {
        feature.sigma = 5e-6;
    }
    let (_, of) = score(&data);
    let noise = &of.found.summary.noise[0];
    assert!((noise.stated - 0.005).abs() < 1e-6);
    assert!(
        (0.035..0.07).contains(&noise.beyond),
        "{:.3} mm",
        noise.beyond
    );
    assert!(of.components_within() >= 0.85);
    // The standard deviation of a pose combines parameters and τ.
    assert!(1e3 * of.known.tau >= noise.beyond);
    let least = of
        .known
        .deviations()
        .iter()
        .map(|sd| sd.min())
        .fold(1.0, f64::min);
    assert!(1e3 * least >= noise.beyond);
}

/// Two images of a board that nothing else determines cannot be predicted from each other. They do not outvote the touches of two
/// sockets.
#[test]
fn two_images_do_not_outvote_many_touches() {
    for seed in 61..64 {
        let (mut set, truth) = touched(&[("socket", 2), ("camera", 1)], 160, seed);
        let is_image = |row: &TouchRow| matches!(row.reading, Reading::Board { .. });
        let of_images = set.rows.iter().filter(|row| is_image(row));
        let mut images: Vec<Vec<f64>> = of_images.map(|row| row.joints.clone()).collect();
        images.dedup();
        images.truncate(2);
        let mut touches = 0;
        set.rows.retain(|row| {
            touches += usize::from(!is_image(row));
            images.contains(&row.joints) || !is_image(row) && touches % 4 == 0
        });
        let mut alone = set.clone();
        alone.rows.retain(|row| !is_image(row));
        let [alone, both] = [alone, set].map(|set| trial(&robot(), &set, &truth));
        let [alone, both] = [alone, both].map(|of| of.found.summary.left_out_ratio);
        println!("left-out ratio {alone:.2} of the touches alone, {both:.2} with two images");
        assert!(both < alone + 0.1);
    }
}

/// All corners of an image see what the joints miss in its pose: 0.2 mrad in each joint, another one in every image, are found
/// as such, and neither the corners nor the arm pay for them.
#[test]
fn corners_of_an_image_share_the_errors_of_the_joints() {
    const MISSED: f64 = 2e-4;
    const ARMS: u64 = 4;
    let (mut within, mut stated, mut found) = (0.0, 0.0, 0.0);
    for seed in 51..51 + ARMS {
        let (mut set, truth) = touched(&[("camera", 1)], 160, seed);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for image in set.rows.chunk_by_mut(|a, b| a.joints == b.joints) {
            for joint in 0..image[0].joints.len() {
                let missed: f64 = StandardNormal.sample(&mut random);
                for row in &mut *image {
                    row.joints[joint] += MISSED * missed;
                    row.serial_joints[joint] += MISSED * missed;
                }
            }
        }
        let of = trial(&robot(), &set, &truth);
        let scatter = of.found.fit.joint_scatter;
        let problem = problem(&set);
        let left_out = of.found.fit.left_out(&problem).unwrap();
        let sigmas = left_out.iter().flat_map(|l| &l.sigmas);
        let sigmas = (sigmas.map(|s| s * s).sum::<f64>() / set.rows.len() as f64).sqrt();
        println!(
            "arm {seed}: {:.3} mm, stated {:.3}, components within {:.2}, scatter of the joints {:.2} mrad, of the tip {:.2} mm, \
             corners beyond {:.2} px, left out {sigmas:.2} standard deviations",
            mean_mm(&of.calibrated),
            of.known.after.mean_mm,
            of.components_within(),
            1e3 * scatter,
            1e3 * of.known.tau,
            of.found.summary.noise[0].beyond
        );
        // The joints' levers are 0.1 to 0.7 m.
        assert!((0.05..0.4).contains(&(1e3 * of.known.tau)));
        assert!((0.8..1.2).contains(&sigmas), "{sigmas:.3}");
        assert!((0.7..1.4).contains(&(scatter / MISSED)), "{scatter:e}");
        assert!(of.found.summary.noise[0].beyond < 0.1);
        within += of.components_within() / ARMS as f64;
        stated += of.known.after.mean_mm;
        found += mean_mm(&of.calibrated);
    }
    assert!(within >= 0.85, "{within:.2}");
    // What is stated includes these errors, which the truth does not have.
    assert!(
        (1.0..2.0).contains(&(stated / found)),
        "{stated:.3} {found:.3}"
    );
    assert!(found / (ARMS as f64) < 0.2, "{found:.3}");
}

/// Rows that declare a noise of 20 mm are weighted by it: errors of 8 mm in every fourth row hardly change the result.
#[test]
fn a_row_counts_by_its_variance() {
    let mut data = touched(&[("wire", 1)], 80, 24);
    let (clean, _) = score(&data);
    for row in data.0.rows.iter_mut().step_by(4) {
        row.declared_noise.position = Some(20e-3);
        if let Reading::Anchor { value, .. } = &mut row.reading {
            *value += if row.line % 8 == 0 { 8e-3 } else { -8e-3 };
        }
    }
    let (with, found) = score(&data);
    assert!(found.found.summary.outliers.is_empty());
    assert!(with < 1.6 * clean, "{clean:.4} → {with:.4} mm");
}

/// Planes that bulge by 1 mm at 200 mm from their middle: with the form as a term of its own the arm is nearer to the truth.
#[test]
fn a_bulge_is_form_where_it_is_stated() {
    let (mut flat, mut form) = (0.0, 0.0);
    for seed in 31..35 {
        let mut data = touched(&[("plane", 3)], 240, seed);
        let robot = robot();
        let chain = robot.chain().unwrap();
        let tip = data.0.tips[0].position;
        let on_plane = |row: &TouchRow| {
            let at = chain.forward(&row.serial_joints).transform_point(&tip);
            let across = [[at.x, at.y], [at.y, at.z], [at.x, at.z]];
            across[row.reading.feature().unwrap()]
        };
        let mut middles = [[0.0; 2]; 3];
        for row in &data.0.rows {
            let own = &mut middles[row.reading.feature().unwrap()];
            (0..2).for_each(|i| own[i] += on_plane(row)[i] / 80.0);
        }
        for row in &mut data.0.rows {
            let at = on_plane(row);
            if let Reading::Plane { feature, value } = &mut row.reading {
                let from = (0..2).map(|i| (at[i] - middles[*feature][i]).powi(2));
                *value += 1e-3 * from.sum::<f64>() / 0.2_f64.powi(2);
            }
        }
        let mut stated = |sigma: f64| {
            for feature in &mut data.0.features {
                feature.kind = FeatureKind::Plane { flatness: sigma };
            }
            score(&data).0
        };
        flat += stated(0.0);
        form += stated(0.3e-3);
    }
    println!(
        "planes that bulge: {:.3} mm without the term, {:.3} with it",
        flat / 4.0,
        form / 4.0
    );
    assert!(form < 0.95 * flat);
}

/// However far an arm is from its nominal model, the evidence changes the scales of its class by at most a factor of two.
#[test]
fn scales_move_by_a_factor_of_two() {
    let mut data = touched(&[("socket", 4)], 80, 25);
    let prior = data.0.prior.as_mut().unwrap();
    prior.length *= 0.1;
    prior.tilt *= 0.1;
    prior.joint_zero *= 0.1;
    let (_, of) = score(&data);
    let [stated, found] = of.found.summary.class;
    for (stated, found) in stated.into_iter().zip(found) {
        assert!(found > 1.5 * stated && found <= 2.0 * stated + 1e-12);
    }
    assert!(of.found.summary.beyond_class.unwrap() > 3.0);
}

/// Gravity is in the axes of the base, wherever the base hangs, and the model contains the stated gravity.
#[test]
fn gravity_is_that_of_the_base() {
    use poegp_calibration::model::config::Config;
    use poegp_calibration::model::gauge::GaugeChoice;
    use poegp_calibration::model::touches::calibrate_touches;
    let (set, truth) = touched(&[("socket", 2)], 40, 26);
    let robot = robot();
    let predicted = |gravity| {
        let config = Config {
            gravity_m_s2: gravity,
            ..Config::default()
        };
        let found = calibrate_touches(&robot, &set, &config, &GaugeChoice::default()).unwrap();
        let state = |(q, m, _): &(Vec<f64>, Option<f64>, _)| crate::sets::state(&robot, q, *m);
        let tips = truth
            .iter()
            .map(|t| found.calibration.predict(&state(t)).translation);
        tips.collect::<Vec<_>>()
    };
    let (down, none) = (predicted([0.0, 0.0, -9.81]), predicted([0.0, 0.0, -1e-6]));
    let apart = down
        .iter()
        .zip(&none)
        .map(|(a, b)| (a - b).norm())
        .sum::<f64>();
    assert!(1e3 * apart / down.len() as f64 > 0.005);
}

/// The left-out errors of 20 readings of a wire are as large as the errors of 60 readings that the fit has not seen.
#[test]
fn what_is_left_out_misses_as_what_is_new() {
    let (mut left_out, mut new, mut kept) = (0.0, 0.0, 0.0);
    let robot = robot();
    let mean = |all: &[f64]| 1e3 * all.iter().map(|x| x.abs()).sum::<f64>() / all.len() as f64;
    for seed in 41..47 {
        let (whole, truth) = touched(&[("wire", 1)], 80, seed);
        let few = TouchSet {
            rows: whole.rows.iter().step_by(4).cloned().collect(),
            ..whole.clone()
        };
        let of = trial(&robot, &few, &truth);
        let problem = problem(&whole);
        let all = of.found.fit.residuals(&problem);
        let some = |own: bool| -> Vec<f64> {
            let rows = all.iter().enumerate().filter(|(k, _)| (k % 4 == 0) == own);
            rows.map(|(_, jet)| jet.residual[0]).collect()
        };
        left_out += of.found.summary.left_out[1];
        new += mean(&some(false));
        kept += mean(&some(true));
    }
    println!(
        "20 readings of six arms miss by {kept:.3}, left out by {left_out:.3}, 60 others by {new:.3} mm in sum"
    );
    assert!(kept < 0.5 * new);
    assert!((0.6..1.7).contains(&(left_out / new)));
}

/// A row that is pasted ten times is one touch: the model and what it states are those of the file without the copies.
#[test]
fn a_pasted_row_is_one_touch() {
    use poegp_calibration::simulation::Simulator;

    let mut simulator = Simulator::new(&robot(), Scenario::Paper, &[1.0], 24);
    let (touches, _) = simulator
        .touch(&robot(), &[task(&("wire", 1))], 40, 0, "simulated")
        .unwrap();
    let parse = |csv: &str| {
        let csv = ("touches.csv".as_ref(), csv.as_bytes());
        let toml = ("touches.toml".as_ref(), touches.toml.as_bytes());
        TouchSet::parse(csv, toml, &robot()).unwrap()
    };
    let once = parse(&touches.csv);
    let row = touches.csv.lines().last().unwrap();
    let ten = parse(&(touches.csv.clone() + &format!("{row}\n").repeat(10)));
    assert_eq!(ten.rows, once.rows);
    assert!(
        ten.notes.iter().any(
            |note| note.starts_with("left out, identical to an earlier row")
                && note.contains("10 rows")
        ),
        "{:?}",
        ten.notes
    );
}

/// One zero that is 1° off is found beside a class of 1 mrad: it is named, the error is that of the same arm without it, and
/// what is stated holds. Without it, no zero is named.
#[test]
fn one_lost_zero_is_found_and_does_not_spread() {
    let by = 1_f64.to_radians();
    for seed in [41, 42, 43] {
        let clean = touched(&[("socket", 2)], 40, seed);
        let mut lost = clean.clone();
        for row in &mut lost.0.rows {
            row.joints[1] -= by;
            row.serial_joints[1] -= by;
        }
        lost.1.iter_mut().for_each(|(q, _, _)| q[1] -= by);
        let named = |of: &Trial| -> Vec<String> {
            let all = of.found.findings.0.iter();
            let own = all.filter(|f| f.cause == Cause::Frames && f.text.starts_with("the zero"));
            own.map(|f| f.text.clone()).collect()
        };
        let ((before, without), (after, with)) = (score(&clean), score(&lost));
        assert_eq!(named(&without), [""; 0]);
        let texts = named(&with);
        assert!(
            texts.len() == 1 && texts[0].contains("the zero of joint 2 is"),
            "{texts:?}"
        );
        println!("seed {seed}: {before:.3} mm, {after:.3} mm with the lost zero");
        assert!(after < 1.6 * before + 0.1, "{before:.3} → {after:.3} mm");
        let stated = with.found.summary.after.mean_mm;
        assert!(after < 1.6 * stated, "{after:.3} mm, stated {stated:.3}");
    }
}

/// Plates that bulge more than is stated are named, and the stated error is larger than that of flat ones.
#[test]
fn plates_that_bulge_are_named() {
    let flat = touched(&[("plane", 3)], 80, 34);
    let mut bulging = flat.clone();
    for row in &mut bulging.0.rows {
        let turn: f64 = row.joints.iter().take(3).sum();
        if let Reading::Plane { value, .. } = &mut row.reading {
            *value += 0.4e-3 * libm::sin(3.0 * turn);
        }
    }
    let [(_, flat), (_, bulging)] = [&flat, &bulging].map(score);
    let named = |of: &Trial| {
        let mut all = of.found.findings.0.iter();
        all.any(|f| f.cause == Cause::Noise && f.text.contains("plates are not as flat"))
    };
    assert!(!named(&flat), "{:#?}", flat.found.findings);
    assert!(named(&bulging), "{:#?}", bulging.found.findings);
    let [a, b] = [&flat, &bulging].map(|of| of.found.summary.after.mean_mm);
    assert!(b > 1.2 * a, "{a:.3} mm flat, {b:.3} mm bulging");
}
