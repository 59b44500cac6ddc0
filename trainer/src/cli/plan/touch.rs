//! `trainer plan --touch`: chooses the joints at which to touch sockets, plates and wires.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde_json::json;

use crate::cli::args::RobotArgs;
use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_not_filled_in, check_outputs, summary_text, write_outputs};
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use poegp_calibration::input_error::InputError;
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::planning::touches::{
    Goal, HardlyReached, TouchPlan, TouchPlanner, TouchTask, USUAL_CLASS, feature_names, to_csv,
    to_toml,
};

/// Default number of rows for each feature.
const USUAL_ROWS: usize = 20;

/// The options of a touch plan.
pub(super) struct Asked<'a> {
    pub robot: &'a RobotArgs,
    pub goals: &'a [Goal],
    pub count: Option<u32>,
    pub constraints: Option<&'a Path>,
    pub seed: u64,
    pub out: &'a Path,
    pub features_out: Option<&'a Path>,
    pub json: Option<&'a Path>,
}

/// Parses a feature, such as `socket=400,0,100` or `plane=400,0,50,0,0,1`.
pub(super) fn goal(text: &str) -> Result<Goal, String> {
    let expected = "expected socket=X,Y,Z, plane=X,Y,Z or wire=X,Y,Z in mm of the base frame; of a plane that is not level \
                    its normal after them, plane=X,Y,Z,NX,NY,NZ";
    let refused = || expected.to_owned();
    let (word, numbers) = text.split_once('=').ok_or_else(refused)?;
    let numbers: Vec<f64> = numbers
        .split(',')
        .map(|number| number.trim().parse::<f64>())
        .collect::<Result<_, _>>()
        .map_err(|_| refused())?;
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err(refused());
    }
    let vector = |of: &[f64]| Vector3::new(of[0], of[1], of[2]);
    match (word, numbers.as_slice()) {
        ("socket", at @ [_, _, _]) => Ok(Goal::Socket(vector(at) / 1e3)),
        ("wire", at @ [_, _, _]) => Ok(Goal::Wire(vector(at) / 1e3)),
        ("plane", at @ [_, _, _]) => Ok(Goal::Plate(vector(at) / 1e3, Vector3::z())),
        ("plane", [at @ .., x, y, z]) if at.len() == 3 => {
            let normal = Vector3::new(*x, *y, *z);
            match normal.norm() {
                length if length > 1e-9 => Ok(Goal::Plate(vector(at) / 1e3, normal / length)),
                _ => Err(refused()),
            }
        }
        _ => Err(refused()),
    }
}

/// Plans touches, writes the outputs and prints the result.
pub(super) fn run(a: &Asked<'_>) -> Result<(), Failure> {
    let outputs = [
        (Some(a.out), Kind::FilledIn),
        (a.features_out, Kind::FilledIn),
        (a.json, Kind::Json),
    ];
    let mut inputs = vec![Path::new(&a.robot.robot)];
    inputs.extend(a.constraints);
    let outputs = check_outputs(&outputs, &inputs)?;
    let goals = a.goals;
    let count = a
        .count
        .map_or(USUAL_ROWS * goals.len(), |count| count as usize);
    let least: usize = goals.iter().map(Goal::least_rows).max().unwrap_or(0) * goals.len();
    if count < least {
        return Err(Failure::Usage(format!(
            "--count {count}: expected at least {least} touches of {} feature{}: fewer do not show the arm's errors",
            goals.len(),
            if goals.len() == 1 { "" } else { "s" }
        )));
    }
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let constraints = match a.constraints {
        Some(path) => Constraints::read(path, &arm.robot)?,
        None => Constraints::none(&arm.robot)?,
    };
    let task = TouchTask {
        robot: &arm.robot,
        nominal: &arm.nominal,
        constraints: &constraints,
        class: USUAL_CLASS,
        seed: a.seed,
    };
    let spinner = progress::spinner("choosing touches");
    let plan = TouchPlanner::new(task, goals, count).map(|planner| planner.plan(count));
    spinner.finish_and_clear();
    let plan = plan.map_err(|error| hardly_reached(a, &constraints, &error))?;
    let tip = constraints.flange_from_target.translation;
    let csv = to_csv(&arm.robot, goals, &plan);
    let toml = to_toml(goals, &tip);
    let mm = |metres: f64| (1e6 * metres).round() / 1e3;
    let names = feature_names(goals);
    let json = summary_text(json!({
        "robot": arm.robot.name, "seed": a.seed, "touches": plan.touches.len(), "features": names,
        "nominal_mm": mm(plan.before), "expected_mm": mm(plan.expected), "random_mm": mm(plan.random)
    }))?;
    let mut files = vec![(a.out, csv.as_bytes())];
    files.extend(a.features_out.map(|path| (path, toml.as_bytes())));
    check_not_filled_in(&files)?;
    files.extend(a.json.map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    let report = Printer::for_outputs(&outputs);
    print(report, a.seed, &plan, &names, &tip);
    report.written(&outputs);
    Ok(())
}

/// Creates the error about a feature that the arm can hardly reach; it refers to the constraints.
fn hardly_reached(a: &Asked<'_>, constraints: &Constraints, error: &HardlyReached) -> Failure {
    let name = &feature_names(a.goals)[error.goal];
    let found = format!(
        "{} allowed ways to touch {name}, from {} random starts",
        error.allowed, error.starts
    );
    let expected = format!("at least {}", error.needed);
    let file = match &constraints.file {
        Some(file) => file.clone(),
        None => PathBuf::from("--touch"),
    };
    let rules: Vec<String> = constraints.rules.iter().map(|rule| rule.name()).collect();
    InputError::new(file, found, expected)
        .with_help(format!(
            "check that its position is in mm of the base frame and within reach, and that [target] of --constraints \
             has the tip; the joint ranges and {} limit the poses; near a table, link_radius_mm or floor = false may \
             be needed",
            rules.join(", ")
        ))
        .into()
}

fn print(report: Printer, seed: u64, plan: &TouchPlan, names: &[String], tip: &Vector3<f64>) {
    report.line(format_args!(
        "Planned {} touches of {} (seed {seed}), the tip {:.0}, {:.0}, {:.0} mm from the flange.",
        plan.touches.len(),
        names.join(", "),
        1e3 * tip.x,
        1e3 * tip.y,
        1e3 * tip.z
    ));
    report.line(format_args!(
        "  Expected error over the joint ranges: nominal {:.2} mm, after these touches {:.2} mm, after as many random ones {:.2} mm.",
        1e3 * plan.before,
        1e3 * plan.expected,
        1e3 * plan.random
    ));
    report.line(format_args!(
        "  Move the tip there by hand or slowly, as close to these joints as possible, and record the joints that the \
         controller then shows."
    ));
    note(format_args!(
        "the expected error assumes links 0.3 mm, axes 0.5 mrad and joint zeros 1 mrad off nominal; only touches show your arm"
    ));
}
