//! temporary
use nalgebra::Vector3;
use poegp_calibration::identification::touch::fit::*;
use poegp_calibration::measurement::observation::InstrumentNoise;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::measurement::touch::*;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_runtime::math::se3::{Pose, Twist};
use std::path::Path;

pub fn read(path: &Path, robot: &Robot) -> TouchSet {
    let mut set = TouchSet::read(path, None, robot).unwrap_or_else(|e| panic!("{e}"));
    if let Ok(px) = std::env::var("PX") {
        for f in &mut set.features {
            if matches!(f.kind, FeatureKind::Board(_)) {
                f.sigma *= px.parse::<f64>().unwrap();
            }
        }
    }
    set
}

fn truth(path: &Path, n: usize) -> Vec<(Vec<f64>, Vector3<f64>)> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .filter(|l| !l.starts_with('#') && !l.starts_with('q'))
        .map(|l| {
            let c: Vec<f64> = l.split(',').map(|x| x.parse().unwrap()).collect();
            (c[..n].iter().map(|d| d.to_radians()).collect(), {
                let m = c.len();
                Vector3::new(c[m - 3], c[m - 2], c[m - 1]) * 1e-3
            })
        })
        .collect()
}

fn cover(
    predict: &dyn Fn(&[f64]) -> Pose<f64>,
    truth: &[(Vec<f64>, Vector3<f64>)],
    dev: &[Vector3<f64>],
) -> f64 {
    let e = errors(predict, truth);
    let mut n = 0;
    for (e, d) in e.iter().zip(dev) {
        for i in 0..3 {
            if e[i].abs() < 1.96 * d[i] {
                n += 1;
            }
        }
    }
    n as f64 / (3 * dev.len()) as f64
}
fn score(predict: &dyn Fn(&[f64]) -> Pose<f64>, truth: &[(Vec<f64>, Vector3<f64>)]) -> f64 {
    let e = errors(predict, truth);
    1e3 * e.iter().map(|e| e.norm()).sum::<f64>() / truth.len() as f64
}
/// mean position error after best registration of base and tip
fn errors(
    predict: &dyn Fn(&[f64]) -> Pose<f64>,
    truth: &[(Vec<f64>, Vector3<f64>)],
) -> Vec<Vector3<f64>> {
    let poses: Vec<Pose<f64>> = truth.iter().map(|(q, _)| predict(q)).collect();
    let mut x = Vector3::zeros(); // tip shift
    let mut b = Pose::identity();
    for _ in 0..20 {
        let mut h = nalgebra::DMatrix::<f64>::zeros(9, 9);
        let mut gr = nalgebra::DVector::<f64>::zeros(9);
        for (p, (_, t)) in poses.iter().zip(truth) {
            let pt = b.rotation * (p.rotation * x + p.translation);
            let r = pt + b.translation - t;
            let sk = -poegp_runtime::math::se3::skew(&pt);
            let rt = b.rotation * p.rotation;
            for i in 0..3 {
                let mut row = [0.0; 9];
                row[i] = 1.0;
                for k in 0..3 {
                    row[3 + k] = sk[(i, k)];
                    row[6 + k] = rt[(i, k)];
                }
                for a in 0..9 {
                    gr[a] += row[a] * r[i];
                    for c in 0..9 {
                        h[(a, c)] += row[a] * row[c];
                    }
                }
            }
        }
        for i in 0..9 {
            h[(i, i)] += 1e-9;
        }
        let s = -h.cholesky().unwrap().solve(&gr);
        let tw = Twist {
            linear: Vector3::zeros(),
            angular: Vector3::new(s[3], s[4], s[5]),
        };
        b.rotation = Pose::exp(&tw).rotation * b.rotation;
        b.translation += Vector3::new(s[0], s[1], s[2]);
        x += Vector3::new(s[6], s[7], s[8]);
    }
    poses
        .iter()
        .zip(truth)
        .map(|(p, (_, t))| (b.rotation * (p.rotation * x + p.translation) + b.translation - t))
        .collect()
}

fn main() {
    let dir = Path::new("/work/shared/data/touch");
    let models = Path::new("/work/shared/data/models");
    let filter = std::env::args().nth(1).unwrap_or_default();
    let orders: usize = std::env::args()
        .nth(2)
        .and_then(|s| s.parse().ok())
        .unwrap_or(0);
    for (arm, urdf) in [
        ("sim_irb120_s10", "abb_irb120_3_58.urdf"),
        ("sim_irb4400_s10", "abb_irb4400_60.urdf"),
    ] {
        let robot =
            Robot::load(models.join(urdf).to_str().unwrap(), &LoadOptions::default()).unwrap();
        let n = robot.joints.len();
        let truth = truth(&dir.join(format!("{arm}_truth.csv")), n);
        for kind in [
            "socket1",
            "socket2",
            "socket4",
            "plane3",
            "sphere4",
            "ballbar4",
            "wire1",
            "wireeach3",
            "camera1",
            "level",
        ] {
            let name = format!("{arm}_{kind}");
            if !name.contains(&filter) {
                continue;
            }
            let set = read(&dir.join(format!("{name}.csv")), &robot);
            let start = std::time::Instant::now();
            let class = set.prior.unwrap();
            let problem = TouchProblem::new(
                &set,
                &robot.chain().unwrap(),
                robot.coupling.clone(),
                Vector3::new(0., 0., -9.81),
                class,
            );
            let drawing = TouchFit::on_drawing(&problem, orders);
            let fit = TouchFit::new(&problem, &drawing);
            let time = start.elapsed().as_secs_f64();
            let payload = set.rows[0].payload_kg;
            let predict = |arm: &poegp_calibration::identification::touch::arm::TouchArm| {
                let arm = arm.clone();
                let robot = &robot;
                move |q: &[f64]| {
                    let mut s = poegp_calibration::measurement::sample::Sample::new(
                        q.to_vec(),
                        robot.serial_joints(q),
                        poegp_calibration::measurement::observation::Observation::Pose(
                            Pose::identity(),
                        ),
                        poegp_calibration::measurement::sample::Base,
                    );
                    s.payload_kg = payload;
                    arm.poses(&[s])[0]
                }
            };
            let before = score(&predict(&drawing.arm), &truth);
            let after = score(&predict(&fit.arm), &truth);
            let out = fit.weights.iter().filter(|w| **w == 0.0).count();
            let s = fit.scales;
            use poegp_calibration::identification::touch::{judge::*, unseen::*, volume::*};
            let volume = WorkVolume::new(&robot, &problem);
            if let Ok(f) = std::env::var("SHRINK") {
                let f: f64 = f.parse().unwrap();
                let mut g = fit.clone();
                g.tau = [0.0; 8];
                let mut set2 = set.clone();
                for x in &mut set2.features {
                    x.sigma *= f;
                }
                let mut p2 = problem.clone();
                p2.set = &set2;
                let k = Knowledge::new(&p2, &g, &volume).unwrap();
                println!("   shrunk: after {:.3}", k.after.mean_mm);
                for u in unseen(&p2, &g, &k) {
                    println!("      {:.2} {}", u.share, u.text);
                }
            }
            let known = Knowledge::new(&problem, &fit, &volume).unwrap();
            let verdict = Verdict::new(&problem, &drawing, &fit, &known).unwrap();
            let at = WorkVolume::of(&robot, truth.iter().map(|t| t.0.clone()), payload);
            let there = Knowledge::new(&problem, &fit, &at).unwrap();
            let cover = cover(&predict(&fit.arm), &truth, &there.deviations());
            println!(
                "    expected {:.3}/{:.3} -> {:.3}/{:.3}, at truth {:.3}; cover {:.2}; tau {:.3} LOO {:.2} ({:.3} -> {:.3} mm) {:?}",
                known.before.mean_mm,
                known.before.p95_mm,
                known.after.mean_mm,
                known.after.p95_mm,
                there.after.mean_mm,
                cover,
                known.tau * 1e3,
                verdict.left_out,
                verdict.errors.0 * 1e3,
                verdict.errors.1 * 1e3,
                verdict.play
            );
            for u in unseen(&problem, &fit, &known) {
                println!("      {:.2} {}", u.share, u.text);
            }
            println!(
                "    c {:.2}",
                beyond_class(&problem, &fit, &known).unwrap_or(0.0)
            );
            println!(
                "{name:28} {before:.3} -> {after:.3}  tau {:?} out {out} scales {:.2} {:.2} {:.2} links {:.1e} curve {:.1e}  {time:.2} s",
                fit.tau
                    .iter()
                    .filter(|t| **t < 0.5e-3 * 10.0)
                    .map(|t| (t * 1e6).round() / 1e3)
                    .collect::<Vec<_>>(),
                s.length * 1e3,
                s.tilt * 1e3,
                s.zero * 1e3,
                s.links,
                s.curve
            );
        }
    }

    if !filter.is_empty() && !filter.contains("mukca") {
        return;
    }
    for (name, urdf, place) in [
        ("panda_2", "franka_panda.urdf", "front_center"),
        ("panda_3", "franka_panda.urdf", "frontcenter"),
        ("panda_3_bis", "franka_panda.urdf", ""),
        ("kuka_14", "kuka_lbr_iiwa14.urdf", "front"),
    ] {
        let robot =
            Robot::load(models.join(urdf).to_str().unwrap(), &LoadOptions::default()).unwrap();
        let all = read(&dir.join(format!("{name}.csv")), &robot);
        let mut places: Vec<String> = all
            .features
            .iter()
            .map(|f| f.name.split('/').next().unwrap().to_string())
            .collect();
        places.dedup();
        let place = if place.is_empty() {
            places[0].clone()
        } else {
            place.to_string()
        };
        print!("{name:12} {place:14}");
        for each in [3usize, 5, 10, 20] {
            let (set, rest) = split(&all, &place, each);
            let class = set.prior.unwrap();
            let problem = TouchProblem::new(
                &set,
                &robot.chain().unwrap(),
                robot.coupling.clone(),
                Vector3::new(0., 0., -9.81),
                class,
            );
            let drawing = TouchFit::on_drawing(&problem, orders);
            let fit = TouchFit::new(&problem, &drawing);
            let out = fit.weights.iter().filter(|w| **w == 0.0).count();
            use poegp_calibration::identification::touch::{judge::*, volume::*};
            let volume = WorkVolume::new(&robot, &problem);
            let known = Knowledge::new(&problem, &fit, &volume).unwrap();
            let verdict = Verdict::new(&problem, &drawing, &fit, &known).unwrap();
            print!(
                "LOO {:.2} ({:.3} {:.3}) c {:.2} exp {:.2} {:.2}",
                verdict.left_out,
                verdict.errors.0 * 1e3,
                verdict.errors.1 * 1e3,
                beyond_class(&problem, &fit, &known).unwrap_or(0.0),
                known.before.mean_mm,
                known.after.mean_mm
            );
            print!(
                " {:2}: {:.3} -> {:.3} (tau {:.3}, out {out}, o {:.1} k {:.0e})",
                2 * each,
                spread(&drawing.arm, &all, &rest),
                spread(&fit.arm, &all, &rest),
                fit.tau[0] * 1e3,
                fit.scales.zero * 1e3,
                fit.scales.links
            );
        }
        println!();
    }
}

fn split(all: &TouchSet, place: &str, each: usize) -> (TouchSet, Vec<usize>) {
    let mut set = all.clone();
    let of = |f: usize| all.features[f].name.split('/').next().unwrap() == place;
    let feats: Vec<usize> = (0..all.features.len()).filter(|f| of(*f)).collect();
    set.features = feats.iter().map(|f| all.features[*f].clone()).collect();
    set.distances = all
        .distances
        .iter()
        .filter(|d| d.between.iter().all(|b| of(*b)))
        .map(|d| KnownDistance {
            between: d
                .between
                .map(|b| feats.iter().position(|f| *f == b).unwrap()),
            ..*d
        })
        .collect();
    set.rows.clear();
    for (i, f) in feats.iter().enumerate() {
        let rows: Vec<&TouchRow> = all
            .rows
            .iter()
            .filter(|r| r.reading.feature() == Some(*f))
            .collect();
        for k in 0..each {
            let m = rows.len();
            let at = match std::env::var("SEL").unwrap_or_default().as_str() {
                "b" => (k as f64 * (m - 1) as f64 / (each - 1) as f64).round() as usize,
                "a" => k * (m - 1) / (each - 1),
                "c" => k * m / each,
                "d" => (2 * k + 1) * m / (2 * each),
                _ => (2 * k + 1) * m / (2 * each),
            };
            let mut row = rows[at].clone();
            row.reading = Reading::Point { feature: i };
            set.rows.push(row);
        }
    }
    let rest = (0..all.rows.len())
        .filter(|r| !of(all.rows[*r].reading.feature().unwrap()))
        .collect();
    (set, rest)
}

fn spread(
    arm: &poegp_calibration::identification::touch::arm::TouchArm,
    all: &TouchSet,
    rows: &[usize],
) -> f64 {
    use poegp_calibration::measurement::{observation::Observation, sample::*};
    let states: Vec<BaseSample> = rows
        .iter()
        .map(|r| {
            Sample::new(
                all.rows[*r].joints.clone(),
                all.rows[*r].serial_joints.clone(),
                Observation::Pose(Pose::identity()),
                Base,
            )
        })
        .collect();
    let poses = arm.poses(&states);
    let mut sum = 0.0;
    for f in 0..all.features.len() {
        let pts: Vec<Vector3<f64>> = rows
            .iter()
            .zip(&poses)
            .filter(|(r, _)| all.rows[**r].reading.feature() == Some(f))
            .map(|(_, p)| p.translation)
            .collect();
        if pts.is_empty() {
            continue;
        }
        let mean = pts.iter().sum::<Vector3<f64>>() / pts.len() as f64;
        sum += pts.iter().map(|p| (p - mean).norm()).sum::<f64>();
    }
    1e3 * sum / rows.len() as f64
}
