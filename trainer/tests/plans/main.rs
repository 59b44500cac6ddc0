//! x
use poegp_trainer::calibration::frames::Sample;
use poegp_trainer::calibration::noise::{InstrumentNoise, Scales};
use poegp_trainer::calibration::{Method, Options};
use poegp_trainer::export::{Origin, calibrate_for_device, nominal_chain};
use poegp_trainer::plan::design::*;
use poegp_trainer::robot::{LoadOptions, Robot};
use poegp_trainer::samples::ToolName;
use poegp_trainer::simulate::*;
use poegp_trainer::statistics::*;
use nalgebra::Vector3;
use rand::*;
use rand_chacha::ChaCha8Rng;
use poegp_runtime::se3::Pose;

fn origin() -> Origin {
    Origin { serial_number: String::new(), date: "2026-11-20".into(), data_sha256: [0; 32], tools: vec![ToolName::default()] }
}
fn sample(p: &SimulatedPose, truth: bool) -> Sample {
    Sample { joints: p.joints.clone(), serial: p.joints.clone(), payload_kg: Some(p.payload_kg), measured: if truth {p.truth} else {p.measured}, tool: 0, position_only: false, stated: InstrumentNoise::UNKNOWN }
}
const PAY: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];

#[test]
fn study() {
    let seeds: u64 = std::env::var("SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(2);
    let pool_n: usize = std::env::var("POOL").ok().and_then(|s| s.parse().ok()).unwrap_or(500);
    let kinds = std::env::var("KINDS").unwrap_or("random,v,d,dp,vp,mm,lhs".into());
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let nominal = nominal_chain(&robot).unwrap();
    let mut frames = nominal.frames().to_vec();
    let n = nominal.kinds().len();
    frames[n] = frames[n] * Pose::from_quaternion(1.0, &Vector3::zeros(), Vector3::new(0.07, 0.0, 0.1));
    let chain = poegp_runtime::poe::Poe::new(nominal.kinds(), &frames).unwrap();

    let counts: Vec<usize> = std::env::var("COUNTS").unwrap_or("30,50".into()).split(',').map(|c| c.parse().unwrap()).collect();
    let scen = std::env::var("SCEN").unwrap_or("pw".into());
    for scenario in [Scenario::Paper, Scenario::Wild] {
        if !scen.contains(if scenario == Scenario::Paper {'p'} else {'w'}) { continue; }
        for kind in kinds.split(',') {
            let one = |seed: u64| -> Vec<f64> {
                let mut row = vec![];
                let mut sim = Simulator::new(&robot, scenario, &PAY, seed);
                let train_random = sim.measure(*counts.iter().max().unwrap());
                let tests = sim.measure(300); let test: Vec<Sample> = tests.iter().map(|p| sample(p, false)).collect(); let truths: Vec<Sample> = tests.iter().map(|p| sample(p, true)).collect();
                let ranges = sim.ranges().to_vec();
                let mut random = ChaCha8Rng::seed_from_u64(seed + 1000);
                let mut draw = |k: usize| { let joints: Vec<f64> = ranges.iter().map(|(a, b)| a + (b - a) * random.random::<f64>()).collect();
                    Sample { serial: joints.clone(), joints, payload_kg: Some(PAY[k % 5]), measured: Pose::identity(), tool: 0, position_only: false, stated: InstrumentNoise::UNKNOWN } };
                let mut pool: Vec<Sample> = (0..pool_n).map(&mut draw).collect(); pool.sort_by(|a, b| a.payload_kg.unwrap().total_cmp(&b.payload_kg.unwrap())); let pidx = |i: usize| i / (pool_n / 5);
                
                for &count in &counts {
                    let mut sd = 0.0;
                    let pick: Vec<usize> = match kind {
                        "random" => vec![],
                        k if k.starts_with("mm") => {
                            // mm:weight:quota:angular
                            let o: Vec<f64> = k.split(':').skip(1).map(|x| x.parse().unwrap()).collect();
                            let (w, quota, mode) = (o[0], o[1] > 0.0, o[2]);
                            let f = |s: &Sample| -> Vec<f64> { s.joints.iter().zip(&ranges).flat_map(|(q, (a, b))| if mode == 0.0 { vec![(q - a) / (b - a)] } else { vec![q.sin(), q.cos()] }).chain([s.payload_kg.unwrap() / 7.5 * w]).collect() };
                            let fs: Vec<Vec<f64>> = pool.iter().map(f).collect();
                            let d = |a: &Vec<f64>, b: &Vec<f64>| a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>();
                            let mut near = vec![f64::MAX; fs.len()];
                            let mut left: Vec<usize> = vec![if quota {count / 5} else {count}; 5];
                            let mut out: Vec<usize> = vec![];
                            while out.len() < count {
                                let i = (0..pool.len()).filter(|i| left[pidx(*i)] > 0).max_by(|i, j| near[*i].total_cmp(&near[*j])).unwrap();
                                left[pidx(i)] -= 1;
                                for k in 0..fs.len() { near[k] = near[k].min(d(&fs[i], &fs[k])); }
                                out.push(i);
                            }
                            out
                        }
                        k => {
                            let o: Vec<&str> = k.split(':').collect();
                            let design = Design::new(&chain, None, Vector3::new(0., 0., -9.81), &pool, Scales::uniform(30e-6, 50e-6));
                            let start: Vec<usize> = (0..count).map(|k| (k % 5) * (pool_n / 5) + k / 5).collect();
                            let out = design.exchange(&start, if o[0] == "D" { Criterion::Parameters } else { Criterion::Prediction }, o[1].parse().unwrap());
                            sd = 30e-3 * design.variance(&out).sqrt();
                            out
                        }
                    };
                    let train: Vec<Sample> = if kind == "random" { train_random[..count].iter().map(|p| sample(p, false)).collect() }
                        else { pick.iter().map(|i| sample(&sim.measure_at(&pool[*i].joints, pool[*i].payload_kg.unwrap()), false)).collect() };
                    let found = calibrate_for_device(&nominal, &robot, &train, &Options::new(Method::Elastic), &origin()).unwrap();
                    let mut o2 = Options::new(Method::Elastic); o2.elastic.processes = false;
                    let found2 = calibrate_for_device(&nominal, &robot, &train, &o2, &origin()).unwrap();
                    row.push(ErrorSummary::new(&found.blob.errors(&test)).position_mm.mean);
                    row.push(ErrorSummary::new(&found.blob.errors(&truths)).position_mm.mean);
                    row.push(ErrorSummary::new(&found2.blob.errors(&truths)).position_mm.mean);
                    row.push(sd);
                }
                row
            };
            let rows: Vec<Vec<f64>> = std::thread::scope(|scope| {
                let half = |first: u64| { let one = &one; scope.spawn(move || (first..=seeds).step_by(2).map(one).collect::<Vec<_>>()) };
                let h = [half(1), half(2)];
                h.into_iter().flat_map(|h| h.join().unwrap()).collect()
            });
            let k = rows[0].len();
            let mean: Vec<String> = (0..k).map(|c| { let m = rows.iter().map(|r| r[c]).sum::<f64>() / rows.len() as f64; let v = rows.iter().map(|r| (r[c]-m).powi(2)).sum::<f64>() / rows.len() as f64 / (rows.len() as f64 - 1.0); format!("{:.4}({:.0})", m, v.sqrt() * 1e4) }).collect();
            eprintln!("{scenario:?} {kind:8} {}", mean.chunks(4).map(|c| format!("[meas {} truth {} par {} sd {}]", c[0], c[1], c[2], c[3])).collect::<Vec<_>>().join(" "));
        }
    }
}
