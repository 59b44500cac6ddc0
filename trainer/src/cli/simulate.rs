//! `trainer simulate`.

use std::path::Path;

use serde_json::json;

use crate::cli::arguments;
use crate::cli::arguments::Simulate;
use crate::cli::report::Report;
use crate::cli::{Arm, Failure, check_outputs, write_facts};
use poegp_calibration::input_error::InputError;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};

impl From<arguments::Scenario> for Scenario {
    fn from(scenario: arguments::Scenario) -> Self {
        match scenario {
            arguments::Scenario::Paper => Self::Paper,
            arguments::Scenario::Rich => Self::WithBacklash,
            arguments::Scenario::Wild => Self::Nonlinear,
            arguments::Scenario::Full => Self::PaperFullRange,
        }
    }
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
    let arm = Arm::load(&a.robot)?;
    make_folder(&a.out)?;
    let mut simulator = Simulator::new(&arm.robot, a.scenario.into(), &a.payloads, a.seed);
    let files = write_sets(
        &arm.robot,
        &mut simulator,
        a.poses as usize,
        (a.test_sets as usize, a.test_poses as usize),
        &a.out,
        &format!("simulated {} (seed {})", arm.robot.name, a.seed),
    )?;
    let written: Vec<_> = files
        .iter()
        .map(|(file, poses)| json!({ "file": a.out.join(file), "poses": poses }))
        .collect();
    write_facts(
        a.json.as_deref(),
        json!({ "robot": arm.robot.name, "seed": a.seed, "payloads_kg": a.payloads, "files": written }),
    )?;
    let report = Report::beside(&[a.json.as_deref()]);
    for (file, poses) in files {
        report.line(format_args!(
            "Wrote {} ({poses} poses).",
            a.out.join(file).display()
        ));
    }
    Ok(())
}

/// Makes a folder if it is not there; its parent must be.
pub fn make_folder(path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return Ok(());
    }
    std::fs::create_dir(path).map_err(|error| {
        InputError::new(
            path,
            format!("a folder that cannot be made ({error})"),
            "a folder, or a new one in a folder that exists",
        )
    })?;
    Ok(())
}

/// Writes `train.csv` and the test sets; returns their names and sizes.
pub fn write_sets(
    robot: &Robot,
    simulator: &mut Simulator,
    train: usize,
    (test_sets, test_poses): (usize, usize),
    folder: &Path,
    comment: &str,
) -> Result<Vec<(String, usize)>, Failure> {
    let mut files = Vec::new();
    for (number, poses) in std::iter::once(train)
        .chain(std::iter::repeat_n(test_poses, test_sets))
        .enumerate()
    {
        let name = if number == 0 {
            "train.csv".to_owned()
        } else {
            format!("test{number}.csv")
        };
        let csv = to_csv(robot, &simulator.measure(poses), number > 0, comment);
        crate::output::write(&folder.join(&name), csv.as_bytes())?;
        files.push((name, poses));
    }
    Ok(files)
}
