//! `trainer simulate`.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::path::Path;
use std::path::PathBuf;

use serde_json::json;

use crate::cli::args::RobotArgs;
use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::output::{check_outputs, make_folder, summary_text, write_outputs};
use crate::cli::terminal::print::Printer;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};

/// `trainer simulate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Writes train.csv and test1.csv … into DIR; the test sets also have the noiseless poses.\n\n\
    Example: trainer simulate --robot abb-irb4400-serial --poses 300 --payloads 1,2.5,3.5,5,7.5 --seed 1 --out cell"
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
    /// Payloads in kg; one is drawn at random for each pose.
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 2.5, 3.5, 5.0, 7.5])]
    pub payloads: Vec<f64>,
    /// Errors of the simulated robot.
    #[arg(long, value_name = "SCENARIO", default_value = "paper", value_parser = scenario())]
    pub scenario: Scenario,
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

/// Reads a scenario by its name.
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
    check_outputs(&[a.json.as_deref()], &[Path::new(&a.robot.robot)])?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let _folder = make_folder(&a.out)?;
    let mut simulator = Simulator::new(&arm.robot, a.scenario, &a.payloads, a.seed);
    let sets = simulated_sets(
        &arm.robot,
        &mut simulator,
        a.poses as usize,
        (a.test_sets as usize, a.test_poses as usize),
        &a.out,
        &format!("simulated {} (seed {})", arm.robot.name, a.seed),
    );
    let written: Vec<_> = sets
        .iter()
        .map(|set| json!({ "file": set.path, "poses": set.poses }))
        .collect();
    let summary = summary_text(
        json!({ "robot": arm.robot.name, "seed": a.seed, "payloads_kg": a.payloads, "files": written }),
    )?;
    let files = sets
        .iter()
        .map(|set| (set.path.as_path(), set.csv.as_bytes()));
    let mut files: Vec<(&Path, &[u8])> = files.collect();
    files.extend(a.json.as_deref().map(|path| (path, summary.as_bytes())));
    write_outputs(&files)?;
    let report = Printer::for_outputs(&[a.json.as_deref()]);
    for set in sets {
        report.line(format_args!(
            "Wrote {} ({} poses).",
            set.path.display(),
            set.poses
        ));
    }
    Ok(())
}

/// One file of a simulation.
pub struct SimulatedSet {
    /// Its path.
    pub path: PathBuf,
    /// Its rows.
    pub poses: usize,
    /// All of it.
    pub csv: String,
}

/// `train.csv` and the test sets, to be written into `folder`.
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
