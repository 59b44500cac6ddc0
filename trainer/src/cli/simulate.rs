//! `trainer simulate`.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::args::RobotArgs;
use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::output::kind::Kind;
use crate::cli::output::{
    check_not_filled_in, check_outputs, make_folder, summary_text, write_outputs,
};
use crate::cli::terminal::print::Printer;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::{FeatureKind, TouchSet};
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::touches::{TOUCH_KINDS, TouchTask};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};

/// `trainer simulate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Writes train.csv and test1.csv … into DIR; the test sets also have the noiseless poses. With --touch it writes \
    touches.csv, their features touches.toml, and truth.csv, the true position of the tip at 300 other poses.\n\n\
    Examples:\n  trainer simulate --robot abb-irb4400-serial --poses 300 --payloads 1,2.5,3.5,5,7.5 --seed 1 --out cell\n  \
    trainer simulate --robot ur10 --touch socket2,wire1 --touches 40 --out touched"
)]
pub struct Simulate {
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Number of training poses.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub poses: u32,
    /// Number of test sets.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=100))]
    pub test_sets: u32,
    /// Number of poses in each test set.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub test_poses: u32,
    /// Payloads in kg; one is drawn at random for each pose. All touches have the first.
    #[arg(long, value_delimiter = ',', default_value = "1,2.5,3.5,5,7.5")]
    pub payloads: Vec<f64>,
    /// Errors of the simulated robot.
    #[arg(long, value_name = "SCENARIO", default_value = "paper", value_parser = scenario())]
    pub scenario: Scenario,
    /// Simulate touches instead of a tracker: socket, plane, sphere, ballbar, wire, level or camera, each
    /// followed by the number of such features, as in socket2. All rows are in one file.
    #[arg(long, value_name = "KIND,KIND", value_delimiter = ',', value_parser = touch_task, conflicts_with_all = ["poses", "test_sets", "test_poses"])]
    pub touch: Vec<TouchTask>,
    /// Touch what a plan of `plan --touch` lists, with NAME.toml beside NAME.csv.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["touch", "poses", "test_sets", "test_poses"])]
    pub touch_plan: Option<PathBuf>,
    /// Number of touches of each kind, spread over its features; a camera takes a quarter as many images.
    #[arg(long, value_name = "N", default_value_t = 80, requires = "touch", value_parser = clap::value_parser!(u32).range(4..=2000))]
    pub touches: u32,
    /// Seed of the random numbers.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder to write into; created if it does not exist (its parent must).
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write the names of the files as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Creates the parser of a scenario's name.
fn scenario() -> impl TypedValueParser<Value = Scenario> {
    const SCENARIOS: [(&str, Scenario, &str); 4] = [
        (
            "paper",
            Scenario::Paper,
            "Errors of the frames and joint compliance under gravity; joints within a working range",
        ),
        (
            "rich",
            Scenario::WithBacklash,
            "Also link bending, transmission error, backlash and repeatability",
        ),
        (
            "wild",
            Scenario::Nonlinear,
            "Also stiffening gears, a centre of mass for each payload and wrong payload masses",
        ),
        (
            "full",
            Scenario::PaperFullRange,
            "Like `paper`, over the full joint limits",
        ),
    ];
    PossibleValuesParser::new(
        SCENARIOS.map(|(name, _, about)| PossibleValue::new(name).help(about)),
    )
    .try_map(|name| {
        SCENARIOS
            .iter()
            .find(|s| s.0 == name)
            .map(|s| s.1)
            .ok_or("not a scenario")
    })
}

/// Parses a kind of feature with the number of such features, such as `socket2`.
fn touch_task(text: &str) -> Result<TouchTask, String> {
    let word = text.trim_end_matches(|c: char| c.is_ascii_digit());
    let kind = TOUCH_KINDS.iter().find(|(name, _)| *name == word);
    let features = match &text[word.len()..] {
        "" => Ok(1),
        number => number.parse(),
    };
    match (kind, features) {
        (Some((_, kind)), Ok(features @ 1..=9)) => Ok(TouchTask {
            kind: *kind,
            features,
        }),
        _ => {
            let names = TOUCH_KINDS.map(|(name, _)| name).join(", ");
            Err(format!("expected one of {names} and a number from 1 to 9"))
        }
    }
}

/// Number of poses in the file of true positions that accompanies touches.
const TRUTH_POSES: usize = 300;

/// Simulates the files of `--touch`.
fn touched_sets(
    a: &Simulate,
    robot: &Robot,
    simulator: &mut Simulator,
    comment: &str,
) -> Result<Vec<SimulatedSet>, Failure> {
    let (touches, truth) = match &a.touch_plan {
        Some(path) => {
            let plan = TouchSet::read_plan(path, robot)?;
            let simulated = |kind: &FeatureKind| {
                matches!(
                    kind,
                    FeatureKind::Point { .. }
                        | FeatureKind::Plane { .. }
                        | FeatureKind::Anchor {
                            position: Some(_),
                            ..
                        }
                )
            };
            let mut features = plan.features.iter();
            if let Some(feature) = features.find(|feature| !simulated(&feature.kind)) {
                let found = format!("{:?} of kind \"{}\"", feature.name, feature.kind.name());
                let expected = "\"point\", \"plane\" or \"anchor\" with a position: only these are simulated from a plan";
                let error = InputError::new(&plan.features_path, found, expected);
                return Err(error.at_line(feature.line).into());
            }
            let touched = simulator.touch_planned(robot, &plan, TRUTH_POSES, comment);
            touched.map_err(|error| {
                InputError::new(
                    path,
                    error.to_string(),
                    "features within reach of the planned joints",
                )
            })?
        }
        None => {
            let touched =
                simulator.touch(robot, &a.touch, a.touches as usize, TRUTH_POSES, comment);
            touched.map_err(|error| {
                Failure::Usage(format!(
                    "--touch: {error}\nhelp: another --seed puts it elsewhere; --scenario full uses all of the joint limits"
                ))
            })?
        }
    };
    let set = |name: &str, poses, csv| SimulatedSet {
        path: a.out.join(name),
        poses,
        csv,
    };
    Ok(vec![
        set("touches.csv", touches.rows, touches.csv),
        set(
            "touches.toml",
            touches.toml.matches("[[feature]]").count(),
            touches.toml,
        ),
        set("truth.csv", TRUTH_POSES, truth),
    ])
}

pub fn run(a: &Simulate) -> Result<(), Failure> {
    if let Some(bad) = a
        .payloads
        .iter()
        .find(|kg| !(**kg >= 0.0 && kg.is_finite()))
    {
        return Err(Failure::Usage(format!(
            "--payloads {bad}: expected kilograms, 0 or more"
        )));
    }
    let mut inputs = vec![Path::new(&a.robot.robot)];
    inputs.extend(a.touch_plan.as_deref());
    check_outputs(&[(a.json.as_deref(), Kind::Json)], &inputs)?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let _folder = make_folder(&a.out)?;
    let mut simulator = Simulator::new(&arm.robot, a.scenario, &a.payloads, a.seed);
    let comment = format!("simulated {} (seed {})", arm.robot.name, a.seed);
    let sets = match a.touch.is_empty() && a.touch_plan.is_none() {
        true => simulated_sets(
            &arm.robot,
            &mut simulator,
            a.poses as usize,
            (a.test_sets as usize, a.test_poses as usize),
            &a.out,
            &comment,
        ),
        false => touched_sets(a, &arm.robot, &mut simulator, &comment)?,
    };
    let what = |set: &SimulatedSet| match set.path.file_name().and_then(|name| name.to_str()) {
        Some("touches.csv") => "touches",
        Some("touches.toml") => "features",
        _ => "poses",
    };
    let written: Vec<_> = sets
        .iter()
        .map(|set| json!({ "file": set.path, what(set): set.poses }))
        .collect();
    let payloads = match a.touch.is_empty() && a.touch_plan.is_none() {
        true => a.payloads.as_slice(),
        false => &a.payloads[..a.payloads.len().min(1)],
    };
    let summary = summary_text(
        json!({ "robot": arm.robot.name, "seed": a.seed, "payloads_kg": payloads, "files": written }),
    )?;
    let files = sets
        .iter()
        .map(|set| (set.path.as_path(), set.csv.as_bytes()));
    let mut files: Vec<(&Path, &[u8])> = files.collect();
    check_not_filled_in(&files)?;
    files.extend(a.json.as_deref().map(|path| (path, summary.as_bytes())));
    write_outputs(&files)?;
    let report = Printer::for_outputs(&[a.json.as_deref()]);
    for set in &sets {
        report.line(format_args!(
            "Wrote {} ({} {}).",
            set.path.display(),
            set.poses,
            what(set)
        ));
    }
    Ok(())
}

/// One file of a simulation.
pub struct SimulatedSet {
    /// Path of the file.
    pub path: PathBuf,
    /// Number of rows.
    pub poses: usize,
    /// The whole text of the file.
    pub csv: String,
}

impl SimulatedSet {
    /// Returns path and text, to be written.
    pub fn output(&self) -> (Option<&Path>, Option<&str>) {
        (Some(&self.path), Some(&self.csv))
    }
}

/// Simulates `train.csv` and the test sets, to be written into `folder`.
pub fn simulated_sets(
    robot: &Robot,
    simulator: &mut Simulator,
    train: usize,
    (test_sets, test_poses): (usize, usize),
    folder: &Path,
    comment: &str,
) -> Vec<SimulatedSet> {
    let sizes = std::iter::once(train).chain(std::iter::repeat_n(test_poses, test_sets));
    let simulated = |(number, poses)| {
        let name = match number {
            0 => "train.csv".to_owned(),
            _ => format!("test{number}.csv"),
        };
        SimulatedSet {
            path: folder.join(name),
            poses,
            csv: to_csv(robot, &simulator.measure(poses), number > 0, comment),
        }
    };
    sizes.enumerate().map(simulated).collect()
}
