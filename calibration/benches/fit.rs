//! How long the parts take, on one core of the workstation: `cargo bench -p poegp-calibration`.
//!
//! Times depend on the machine and are for comparing two versions on one; what the project promises are ratios and
//! instruction counts (`docs/evidence/performance.md`). Data: the first simulated set of `tests/data`, 300 poses, six joints, a
//! payload.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::identification::frame_fit::{ResidualFrame, residual_components};
use poegp_calibration::learning::elastic::fit::fit;
use poegp_calibration::learning::elastic::hyperparameter_objective::HyperparameterObjective;
use poegp_calibration::learning::elastic::likelihood::MarginalLikelihood;
use poegp_calibration::learning::elastic::options::{ElasticOptions, NominalArm};
use poegp_calibration::learning::elastic::solution::ElasticFit;
use poegp_calibration::learning::task_space::likelihood::{
    LikelihoodWorkspace, log_marginal_likelihood_in,
};
use poegp_calibration::learning::task_space::{Pairs, padded, scale_outputs};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::{
    BaseSample, InstrumentSample, in_base_frame, samples,
};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{Calibration, Method, calibrate};
use poegp_calibration::numeric::lbfgs::Objective;
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_runtime::gp::quadratic_posterior::MeanHeader;

/// The arm with its measurements, and models of it.
struct Bench {
    robot: Robot,
    samples: Vec<InstrumentSample>,
}

impl Bench {
    fn new() -> Self {
        let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../tests/data/simulated/irb4400_paper_s0_train.csv");
        let set = measurements::read(&path).unwrap();
        let samples = samples(&set, &robot, &mut Vec::new()).unwrap();
        Self { robot, samples }
    }

    fn calibrated(&self, method: Method) -> Calibration {
        calibrate(
            &self.robot,
            &self.samples,
            &Config::new(method),
            &FitContext::default(),
        )
        .unwrap()
    }

    fn blob(&self, method: Method) -> BlobModel {
        let origin = Provenance {
            date: "2026-11-20".to_owned(),
            ..Provenance::default()
        };
        let options = Config::new(method);
        calibrate_to_blob(
            &self.robot,
            &self.samples,
            &options,
            &origin,
            &FitContext::default(),
        )
        .unwrap()
        .blob
    }

    fn elastic(&self, poses: usize) -> (ElasticFit, Vec<BaseSample>) {
        let found = self.calibrated(Method::BaseTool);
        let chain = found.nominal;
        let tool = *chain.frames().last().unwrap();
        let mut part = in_base_frame(&self.samples, &found.base_and_tools.instrument_from_base);
        part.truncate(poses);
        let arm = NominalArm {
            chain,
            tools: vec![tool],
            coupling: None,
            gear_lines: Vec::new(),
        };
        let options = ElasticOptions::default();
        let found = fit(&arm, &part, &options, &FitContext::default()).unwrap();
        (found, part)
    }
}

fn kinematics(c: &mut Criterion) {
    let bench = Bench::new();
    let chain = bench.calibrated(Method::Poe).calibrated;
    let single = chain.cast::<f32>();
    let q = &bench.samples[7].serial_joints;
    let q32: Vec<f32> = q.iter().map(|x| *x as f32).collect();
    let mut group = c.benchmark_group("kinematics");
    group.bench_function("forward, f64", |b| b.iter(|| chain.forward(black_box(q))));
    group.bench_function("forward, f32", |b| {
        b.iter(|| single.forward(black_box(&q32)))
    });
    group.bench_function("identification Jacobian, f64", |b| {
        b.iter(|| chain.identification_jacobian(black_box(q)))
    });
    group.finish();
}

fn means(c: &mut Criterion) {
    let bench = Bench::new();
    let found = bench.calibrated(Method::PoeGpLoad);
    let task_space = found.correction.task_space().unwrap();
    let (header, rows) = &task_space.posterior_mean;
    let single = MeanHeader::<f32> {
        inputs: header.inputs,
        input_scale: header.input_scale.map(|x| x as f32),
        rates: header.rates.map(|rates| rates.map(|x| x as f32)),
        affine: header.affine.map(|output| output.map(|x| x as f32)),
        centre: None,
    };
    let rows32: Vec<f32> = rows.iter().map(|x| *x as f32).collect();
    let (mut folded, mut folded_rows) = (single, rows32.clone());
    assert!(folded.fold(&mut folded_rows));
    let sample = &bench.samples[7];
    let x = padded(&task_space.inputs(&sample.joints, sample.payload_kg));
    let x32 = x.map(|value| value as f32);
    let mut group = c.benchmark_group("mean of 300 points, 6 outputs");
    group.bench_function("f64", |b| b.iter(|| header.mean(rows, black_box(&x))));
    group.bench_function("f32", |b| b.iter(|| single.mean(&rows32, black_box(&x32))));
    group.bench_function("f32, folded", |b| {
        b.iter(|| folded.mean(&folded_rows, black_box(&x32)))
    });
    group.finish();
}

fn likelihood(c: &mut Criterion) {
    let bench = Bench::new();
    let found = bench.calibrated(Method::PoeGpLoad);
    let in_base = in_base_frame(&bench.samples, &found.base_and_tools.instrument_from_base);
    let residuals: Vec<_> = in_base
        .iter()
        .map(|s| {
            let chain = found.calibrated.forward(&s.serial_joints);
            residual_components(ResidualFrame::Space, &s.observation, &chain)
        })
        .collect();
    let gp = &found.correction.task_space().unwrap().gp;
    let (pairs, scaled) = (Pairs::new(&gp.inputs), scale_outputs(&residuals).1);
    let column = Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, 0)]);
    let mut workspace = LikelihoodWorkspace::new(scaled.nrows(), 1);
    let mut group = c.benchmark_group("likelihood and gradient, N = 300");
    for (name, outputs) in [("shared by 6 outputs", &scaled), ("one output", &column)] {
        group.bench_function(name, |b| {
            b.iter(|| {
                log_marginal_likelihood_in(&mut workspace, &pairs, outputs, gp.output(0)).unwrap()
            });
        });
    }
    group.finish();
}

fn elastic(c: &mut Criterion) {
    let bench = Bench::new();
    let (found, part) = bench.elastic(200);
    let linear = found.state.linearise(&part, found.scales);
    let similarities = found.inputs.similarities();
    let groups = found.state.layout.groups();
    let evidence = MarginalLikelihood {
        linear: &linear,
        groups: &groups,
        inputs: &found.inputs,
        similarities: &similarities,
        waves: &[],
        layout: found.layout,
        processes: true,
        threads: 2,
    };
    let search = HyperparameterObjective::new(&evidence);
    let mut group = c.benchmark_group("elastic, N = 200");
    group.sample_size(10);
    group.bench_function("likelihood and gradient", |b| {
        b.iter(|| search.value_and_gradient(black_box(&found.hyperparameters)))
    });
    group.finish();
}

fn batch(c: &mut Criterion) {
    let bench = Bench::new();
    let mut group = c.benchmark_group("predictions through the blob");
    group.throughput(Throughput::Elements(bench.samples.len() as u64));
    for method in [Method::PoeGpLoad, Method::Elastic] {
        let blob = bench.blob(method);
        group.bench_function(method.name(), |b| {
            b.iter(|| {
                for s in &bench.samples {
                    black_box(blob.predict(&s.joints, s.payload_kg));
                }
            });
        });
    }
    group.finish();
}

criterion_group!(parts, kinematics, means, likelihood, elastic, batch);
criterion_main!(parts);
