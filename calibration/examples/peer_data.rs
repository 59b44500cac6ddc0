//! What `tests/peers/run` gives to the peers: the same residuals, the same folds, our errors on them. JSON on standard
//! output.
//!
//! ```text
//! peer_data process ROBOT FILE            residuals of step 2 in units of their RMS; our fit, its likelihood and CPU seconds
//! peer_data folds ROBOT FILE FOLDS N,N,…  for every fold and number of training poses: residuals, poses, our errors
//! peer_data processes ROBOT FILE          the same, and with hyperparameters of each output
//! peer_data inputs ROBOT FILE             inputs of every pose
//! peer_data predict BLOB FILE REPEATS     CPU seconds of predicting all poses of FILE, REPEATS times
//! ```
//!
//! Add `weighted` at the end for a step 1 weighted by the noise. An example and not a command: its shape follows the
//! peers, and may change with them.

use std::path::Path;

use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::identification::frame_fit::{ResidualFrame, residual_components};
use poegp_calibration::learning::task_space::fit::{
    HyperparameterSharing, SignalVarianceLimit, fit,
};
use poegp_calibration::learning::task_space::likelihood::log_marginal_likelihood;
use poegp_calibration::learning::task_space::{Pairs, TaskSpaceGp, input, scale_outputs};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::folds::Folds;
use poegp_calibration::measurement::sample::{
    BaseSample, InstrumentSample, ToolName, in_base_frame, samples,
};
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::model::{Calibration, Method, calibrate};
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_protocol::limits::OUTPUTS;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde_json::{Value, json};

type Answer = Result<Value, Box<dyn std::error::Error>>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words: Vec<String> = std::env::args().skip(1).collect();
    let weighted = words.last().is_some_and(|w| w == "weighted");
    if weighted {
        words.pop();
    }
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let answer = match words.as_slice() {
        ["process", robot, file] => process(&Data::read(robot, file)?, false, weighted)?,
        ["processes", robot, file] => process(&Data::read(robot, file)?, true, weighted)?,
        ["inputs", robot, file] => inputs(&Data::read(robot, file)?),
        ["folds", robot, file, folds, sizes] => {
            let sizes = sizes
                .split(',')
                .map(str::parse)
                .collect::<Result<Vec<usize>, _>>()?;
            all_folds(&Data::read(robot, file)?, folds.parse()?, &sizes, weighted)?
        }
        ["predict", blob, file, repeats] => predict(blob, file, repeats.parse()?)?,
        _ => return Err("see the first lines of calibration/examples/peer_data.rs".into()),
    };
    println!("{answer}");
    Ok(())
}

/// Measurements of one arm.
struct Data {
    robot: Robot,
    nominal: Poe<f64>,
    samples: Vec<InstrumentSample>,
}

impl Data {
    fn read(robot: &str, file: &str) -> Result<Self, Box<dyn std::error::Error>> {
        let robot = Robot::load(robot, &LoadOptions::default())?;
        let nominal = robot.chain()?;
        let set = measurements::read(Path::new(file))?;
        set.check(&robot)?;
        let samples = samples(&set, &robot, &mut Vec::new())?;
        Ok(Self {
            robot,
            nominal,
            samples,
        })
    }

    /// The paper's process for these data.
    fn method(&self) -> Method {
        if self.samples.iter().all(|s| s.payload_kg.is_some()) {
            Method::PoeGpLoad
        } else {
            Method::PoeGp
        }
    }
}

fn weighting(weighted: bool) -> Weighting {
    match weighted {
        true => Weighting::Noise,
        false => Weighting::None,
    }
}

/// What the process is given: inputs [q, m] and residual twists in m and rad.
fn training(
    found: &Calibration,
    samples: &[InstrumentSample],
    options: &Config,
) -> (Vec<Vec<f64>>, Vec<[f64; OUTPUTS]>) {
    let in_base = in_base_frame(samples, &found.base_and_tools.instrument_from_base);
    let twist = |s: &BaseSample| {
        let chain = found.calibrated.forward(&s.serial_joints);
        residual_components(ResidualFrame::Space, &s.observation, &chain)
    };
    (
        samples
            .iter()
            .map(|s| {
                input(
                    &s.joints,
                    s.payload_kg.filter(|_| options.method == Method::PoeGpLoad),
                )
            })
            .collect(),
        in_base.iter().map(twist).collect(),
    )
}

fn inputs(data: &Data) -> Value {
    let options = Config::new(data.method());
    let inputs = data.samples.iter();
    let inputs = inputs.map(|s| {
        input(
            &s.joints,
            s.payload_kg.filter(|_| options.method == Method::PoeGpLoad),
        )
    });
    json!({ "inputs": inputs.collect::<Vec<_>>() })
}

fn process(data: &Data, per_output: bool, weighted: bool) -> Answer {
    let options = Config {
        weighting: weighting(weighted),
        ..Config::new(data.method())
    };
    // Step 1 alone, with the gauge; then both ways of step 2 on the same residuals.
    let poe = Config {
        method: Method::Poe,
        ..options
    };
    let found = calibrate(&data.robot, &data.samples, &poe, &FitContext::default())?;
    let (inputs, residuals) = training(&found, &data.samples, &options);
    let (_, scaled) = scale_outputs(&residuals);
    let column = |c: usize| Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, c)]);
    // What scikit-learn's `fit` does, distances and posterior weights included.
    let fitted = |sharing| -> Result<(TaskSpaceGp, f64), Box<dyn std::error::Error>> {
        let start = cpu_seconds()?;
        let gp = fit(
            inputs.clone(),
            &residuals,
            sharing,
            &SignalVarianceLimit::HIGHEST,
            &FitContext::default().with_threads(1),
        )?;
        Ok((gp, cpu_seconds()? - start))
    };
    // The better of three: short runs are noisy.
    let best = |sharing| -> Result<(TaskSpaceGp, f64), Box<dyn std::error::Error>> {
        let (gp, mut seconds) = fitted(sharing)?;
        if inputs.len() < 500 {
            seconds = seconds.min(fitted(sharing)?.1).min(fitted(sharing)?.1);
        }
        Ok((gp, seconds))
    };
    let pairs = Pairs::new(&inputs);
    let described = |(gp, seconds): (TaskSpaceGp, f64)| -> Answer {
        let own = gp.hyperparameters.len() > 1;
        let mut processes = Vec::new();
        for (c, h) in gp.hyperparameters.iter().enumerate() {
            let y = if own { column(c) } else { scaled.clone() };
            let found = log_marginal_likelihood(&pairs, &y, h)?;
            processes.push(json!({
                "theta": h.to_array(),
                "log_likelihood": found.log_likelihood,
            }));
        }
        Ok(json!({ "cpu_seconds": seconds, "processes": processes }))
    };
    let shared = described(best(HyperparameterSharing::Shared)?)?;
    let own = if per_output {
        described(best(HyperparameterSharing::PerOutput)?)?
    } else {
        Value::Null
    };
    let outputs: Vec<Vec<f64>> = (0..scaled.nrows())
        .map(|i| (0..OUTPUTS).map(|c| scaled[(i, c)]).collect())
        .collect();
    Ok(json!({
        "inputs": inputs,
        "outputs": outputs,
        "shared": shared,
        "per_output": own,
    }))
}

fn all_folds(data: &Data, folds: usize, sizes: &[usize], weighted: bool) -> Answer {
    let drawn = Folds::draw(&data.samples, data.nominal.kinds(), folds, 1);
    let mut out = Vec::new();
    for held_out in 0..folds {
        let (all, test) = drawn.split(&data.samples, held_out);
        for size in sizes.iter().filter(|n| **n <= all.len()) {
            // Spread over the file: neighbours in it may be neighbours in time or place.
            let train: Vec<InstrumentSample> = (0..*size)
                .map(|i| all[i * all.len() / size].clone())
                .collect();
            out.push(one_fold(data, held_out, &train, &test, weighted)?);
        }
    }
    Ok(Value::Array(out))
}

fn one_fold(
    data: &Data,
    fold: usize,
    train: &[InstrumentSample],
    test: &[InstrumentSample],
    weighted: bool,
) -> Answer {
    let options = |method| Config {
        weighting: weighting(weighted),
        ..Config::new(method)
    };
    let origin = Provenance {
        date: "2026-11-20".to_owned(),
        tools: vec![ToolName::default()],
        ..Provenance::default()
    };
    let mut errors = serde_json::Map::new();
    let gp = options(data.method());
    let per_output = Config {
        hyperparameters: HyperparameterSharing::PerOutput,
        ..gp
    };
    for (name, options) in [
        ("poe", options(Method::Poe)),
        (
            "poe_weighted",
            Config {
                weighting: Weighting::Noise,
                ..options(Method::Poe)
            },
        ),
        ("gp", gp),
        ("gp_per_output", per_output),
        ("elastic", options(Method::Elastic)),
    ] {
        let made = calibrate_to_blob(
            &data.robot,
            train,
            &options,
            &origin,
            &FitContext::default().with_threads(1),
        )?;
        let summary = ErrorSummary::new(&made.blob.errors(test));
        errors.insert(name.to_owned(), json!(summary.position_mm.mean));
    }
    let poe = options(Method::Poe);
    let found = calibrate(&data.robot, train, &poe, &FitContext::default())?;
    let of = |samples: &[InstrumentSample]| {
        let (inputs, residuals) = training(&found, samples, &gp);
        let measured = in_base_frame(samples, &found.base_and_tools.instrument_from_base);
        let rows = |pose: Pose<f64>| pose.to_rows().to_vec();
        json!({
            "inputs": inputs,
            "residuals": residuals,
            "serial": samples.iter().map(|s| s.serial_joints.clone()).collect::<Vec<_>>(),
            "measured": measured.iter().map(|s| s.observation.pose().map(rows)).collect::<Vec<_>>(),
            "chain": samples.iter().map(|s| rows(found.calibrated.forward(&s.serial_joints))).collect::<Vec<_>>(),
            "nominal": samples.iter().map(|s| rows(found.nominal.forward(&s.serial_joints))).collect::<Vec<_>>(),
        })
    };
    Ok(json!({
        "fold": fold,
        "poses": train.len(),
        "errors_mm": errors,
        "frames": found.nominal.frames().iter().map(|f| f.to_rows().to_vec()).collect::<Vec<_>>(),
        "train": of(train),
        "test": of(test),
    }))
}

fn predict(blob: &str, file: &str, repeats: usize) -> Answer {
    let blob = BlobModel::read(Path::new(blob))?;
    let poses = measurements::read(Path::new(file))?.measurements;
    let (mut sum, mut count) = (0.0, 0_usize);
    let start = cpu_seconds()?;
    for _ in 0..repeats {
        for pose in &poses {
            sum += blob.predict(&pose.joints, pose.payload_kg).pose.translation[0];
            count += 1;
        }
    }
    let seconds = cpu_seconds()? - start;
    Ok(json!({ "poses": count, "cpu_seconds": seconds, "sum": sum }))
}

/// CPU time of this thread, as Linux counts it.
fn cpu_seconds() -> Result<f64, Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds: u64 = text
        .split_whitespace()
        .next()
        .ok_or("an empty schedstat")?
        .parse()?;
    Ok(1e-9 * nanoseconds as f64)
}
