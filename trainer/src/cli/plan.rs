//! `trainer plan`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::args::{Gravity, RobotArgs, gravity};
use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::Printer;
use crate::cli::terminal::progress;
use crate::robot_programs::{Language, program};
use poegp_calibration::input_error::InputError;
use poegp_calibration::model::Method;
use poegp_calibration::planning::candidates::Candidates;
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::planning::forecast::{ARMS, COUNTS, Row};
use poegp_calibration::planning::table::to_csv;
use poegp_calibration::planning::{self, CHOICE, Planner, Strategy, Task, TooTight};
use poegp_calibration::simulation::{ORIENTATION_NOISE_RAD, POSITION_NOISE_M};

/// `trainer plan`.
#[derive(Debug, Args)]
#[command(
    after_help = "A plan knows where target, flange and joints are while the arm stands still. It does not know the links, cables \
    and the ways between poses: try every program slowly first.\n\n\
    Examples:\n  \
    trainer plan --robot abb-irb4400-serial --count 50 --payloads 0,5,10 --out plan.csv --rapid plan.mod\n  \
    trainer plan --robot ur10 --constraints cell.toml --count 100 --test-poses 15 --test-out check.csv --out plan.csv \
    --urscript plan.script"
)]
pub struct Plan {
    #[command(flatten)]
    robot: RobotArgs,
    /// Number of poses for the calibration.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=2000))]
    count: u32,
    /// Payloads in kg, separated by commas; the plan has one block of poses for each.
    #[arg(long, value_name = "KG,KG", value_delimiter = ',')]
    payloads: Vec<f64>,
    /// Constraints of the robot cell: joint ranges, workspace, keep-out boxes, the instrument's line of sight (TOML).
    #[arg(long, value_name = "FILE")]
    constraints: Option<PathBuf>,
    /// Number of additional random poses, for `evaluate`.
    #[arg(long, value_name = "K", default_value_t = 0, requires = "test_out", value_parser = clap::value_parser!(u32).range(0..=500))]
    test_poses: u32,
    /// File for the additional random poses; do not calibrate with them.
    #[arg(long, value_name = "FILE", requires = "test_poses")]
    test_out: Option<PathBuf>,
    /// Choose the poses from which the model predicts all others best (default up to 60 poses).
    #[arg(long, conflicts_with = "space_filling")]
    v_optimal: bool,
    /// Choose poses as far apart as possible (default for more than 60 poses).
    #[arg(long)]
    space_filling: bool,
    /// Seed of the random numbers; the same seed gives the same plan.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Gravity in the base frame in m/s², for robots on a wall or a ceiling.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,-9.81", allow_hyphen_values = true, value_parser = gravity)]
    gravity: Gravity,
    /// Numbers of poses whose worth is simulated beside that of the plan.
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_values_t = COUNTS, value_parser = forecast_count)]
    forecast: Vec<usize>,
    /// Leave that simulation out; with the default numbers it takes half a minute on two cores.
    #[arg(long, conflicts_with = "forecast")]
    no_forecast: bool,
    /// The plan as CSV, in the columns of a measurement file without the measurements.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// The plan as a program for ABB (.mod).
    #[arg(long, value_name = "FILE")]
    rapid: Option<PathBuf>,
    /// The plan as a program for KUKA (.src).
    #[arg(long, value_name = "FILE")]
    krl: Option<PathBuf>,
    /// The plan as a program for Universal Robots (.script).
    #[arg(long, value_name = "FILE")]
    urscript: Option<PathBuf>,
    /// The plan as a program listing for Fanuc (.ls).
    #[arg(long, value_name = "FILE")]
    fanuc: Option<PathBuf>,
    /// Write the plan's statistics and the forecast as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Serialize)]
struct PlanJson {
    version: &'static str,
    robot: String,
    poses: usize,
    test_poses: usize,
    strategy: &'static str,
    payloads_kg: Vec<f64>,
    seed: u64,
    configurations: Configurations,
    travel: f64,
    forecast: Option<Forecast>,
}

#[derive(Serialize)]
struct Configurations {
    drawn: usize,
    allowed: usize,
    removed: Vec<Removed>,
}

#[derive(Serialize)]
struct Removed {
    constraint: String,
    configurations: usize,
}

#[derive(Serialize)]
struct Forecast {
    position_noise_mm: f64,
    orientation_noise_mrad: f64,
    seconds: f64,
    rows: Vec<Row>,
}

pub fn run(a: &Plan) -> Result<(), Failure> {
    let programs = [&a.rapid, &a.krl, &a.urscript, &a.fanuc];
    let mut outputs = vec![
        Some(a.out.as_path()),
        a.test_out.as_deref(),
        a.json.as_deref(),
    ];
    outputs.extend(programs.iter().map(|p| p.as_deref()));
    let mut inputs = vec![Path::new(&a.robot.robot)];
    inputs.extend(a.constraints.as_deref());
    check_outputs(&outputs, &inputs)?;
    let payloads = payloads(&a.payloads)?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let (count, checks) = (a.count as usize, a.test_poses as usize);
    enough(count, arm.robot.joints.len())?;
    let constraints = match &a.constraints {
        Some(path) => Constraints::read(path, &arm.robot)?,
        None => Constraints::none(&arm.robot)?,
    };
    let asked = match (a.v_optimal, a.space_filling) {
        (true, _) => Some(Strategy::VOptimal),
        (_, true) => Some(Strategy::SpaceFilling),
        _ => None,
    };
    let planner = Planner::new(Task {
        robot: &arm.robot,
        nominal: &arm.nominal,
        constraints: &constraints,
        payloads: &payloads,
        gravity: Vector3::from(a.gravity.0),
        noise: (POSITION_NOISE_M, ORIENTATION_NOISE_RAD),
        seed: a.seed,
    });
    let spinner = progress::spinner("choosing poses");
    let plan = planner.plan(count, checks, asked.unwrap_or(Strategy::usual(count)));
    spinner.finish_and_clear();
    let plan = plan.map_err(|e| too_tight(&constraints, &e))?;
    let written = [
        Language::Rapid,
        Language::Krl,
        Language::UrScript,
        Language::Fanuc,
    ]
    .into_iter()
    .zip(programs)
    .filter_map(|(language, path)| path.as_deref().map(|path| (language, path)))
    .map(|(language, path)| {
        let name = path
            .file_stem()
            .map_or("plan".into(), |s| s.to_string_lossy());
        let text = program(language, &name, &arm.robot, &plan)
            .map_err(|e| InputError::new(path, e.to_string(), "a robot that fits"))?;
        Ok((path, text))
    })
    .collect::<Result<Vec<_>, InputError>>()?;
    let forecast = (!a.no_forecast).then(|| forecast(&planner, &a.forecast, count, asked));
    let document = document(a, &arm, &plan, &planner, &constraints, forecast);
    let json = json_text(&document)?;
    let csv = to_csv(&arm.robot, &plan, false);
    let check_csv = to_csv(&arm.robot, &plan, true);
    let mut files = vec![(a.out.as_path(), csv.as_bytes())];
    files.extend(
        a.test_out
            .as_deref()
            .map(|path| (path, check_csv.as_bytes())),
    );
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    files.extend(written.iter().map(|(path, text)| (*path, text.as_bytes())));
    write_outputs(&files)?;
    let report = Printer::for_outputs(&outputs);
    print(report, a, &document, &plan, planner.candidates());
    for (path, _) in files {
        if path != Path::new("-") {
            report.line(format_args!("Wrote {}.", path.display()));
        }
    }
    Ok(())
}

fn forecast_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count @ 1..=1000) => Ok(count),
        _ => Err("expected a number of poses, to 1000".to_owned()),
    }
}

/// Payloads in kg, sorted, each once.
fn payloads(given: &[f64]) -> Result<Vec<f64>, Failure> {
    let mut out = given.to_vec();
    if let Some(bad) = out.iter().find(|kg| !(**kg >= 0.0 && kg.is_finite())) {
        return Err(Failure::Usage(format!(
            "--payloads {bad}: expected kilograms, 0 or more"
        )));
    }
    out.sort_by(f64::total_cmp);
    if let Some(twice) = out.windows(2).find(|w| w[0] == w[1]) {
        return Err(Failure::Usage(format!(
            "--payloads {}: given twice, expected every payload once",
            twice[0]
        )));
    }
    let most = poegp_protocol::limits::MAX_GROUPS;
    if out.len() > most {
        return Err(Failure::Usage(format!(
            "--payloads: found {}, expected at most {most}",
            out.len()
        )));
    }
    Ok(out)
}

fn enough(count: usize, joints: usize) -> Result<(), Failure> {
    let needed = Method::Elastic.min_poses(joints);
    let parameters = Method::Elastic.parameters(joints);
    if count >= needed {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "--count {count}: expected at least {needed} poses: a calibration of this arm has {parameters} unknowns, and a \
         pose gives six equations\nhelp: plan 30 or more, so that the noise can be estimated"
    )))
}

/// Too few configurations, as an error of the rule that took away most.
fn too_tight(constraints: &Constraints, error: &TooTight) -> Failure {
    let found = format!(
        "{} of {} random configurations allowed",
        error.allowed, error.drawn
    );
    let expected = format!("at least {} to plan with", error.needed);
    let file = constraints.file.clone().unwrap_or_default();
    let worst = (0..constraints.rules.len()).max_by_key(|i| error.removed[*i]);
    let Some(worst) = worst else {
        return InputError::new("<joint ranges>", found, expected).into();
    };
    let taken: Vec<String> = constraints
        .rules
        .iter()
        .zip(&error.removed)
        .map(|(rule, removed)| format!("{} took away {removed}", rule.name()))
        .collect();
    let rule = &constraints.rules[worst];
    InputError::new(file, found, expected)
        .at_line(rule.line)
        .at_column(1, rule.name())
        .with_help(format!(
            "{}; widen what takes most, or narrow the joint ranges to where the rest is allowed",
            taken.join(", ")
        ))
        .into()
}

fn forecast(
    planner: &Planner,
    counts: &[usize],
    planned: usize,
    asked: Option<Strategy>,
) -> Forecast {
    let begun = Instant::now();
    let counts = planner.forecast_counts(counts.iter().copied().chain([planned]));
    let bar = progress::bar(Planner::forecast_steps(&counts), "simulating");
    let rows = planner.forecast(&counts, asked, &|| bar.inc(1));
    bar.finish_and_clear();
    Forecast {
        position_noise_mm: (1e6 * POSITION_NOISE_M).round() / 1e3,
        orientation_noise_mrad: (1e6 * ORIENTATION_NOISE_RAD).round() / 1e3,
        seconds: (10.0 * begun.elapsed().as_secs_f64()).round() / 10.0,
        rows,
    }
}

fn document(
    a: &Plan,
    arm: &Arm,
    plan: &planning::Plan,
    planner: &Planner,
    constraints: &Constraints,
    forecast: Option<Forecast>,
) -> PlanJson {
    let candidates = planner.candidates();
    let removed = constraints.rules.iter().zip(&candidates.removed);
    let checks = plan.poses.iter().filter(|p| p.check).count();
    let mut payloads_kg: Vec<f64> = plan.poses.iter().filter_map(|p| p.payload_kg).collect();
    payloads_kg.dedup();
    PlanJson {
        version: env!("CARGO_PKG_VERSION"),
        robot: arm.robot.name.clone(),
        poses: plan.poses.len() - checks,
        test_poses: checks,
        strategy: plan.strategy.name(),
        payloads_kg,
        seed: a.seed,
        configurations: Configurations {
            drawn: candidates.drawn,
            allowed: candidates.joints.len(),
            removed: removed
                .map(|(rule, removed)| Removed {
                    constraint: rule.name(),
                    configurations: *removed,
                })
                .collect(),
        },
        travel: plan.travel,
        forecast,
    }
}

fn print(report: Printer, a: &Plan, d: &PlanJson, plan: &planning::Plan, candidates: &Candidates) {
    let mut line = format!("Planned {} {} poses", d.poses, d.strategy);
    if d.test_poses > 0 {
        line += &format!(" and {} to test with", d.test_poses);
    }
    match d.payloads_kg.len() {
        0 => line += ", no payload stated",
        1 => line += &format!(", all with {} kg", d.payloads_kg[0]),
        n => line += &format!(" in {n} blocks, one for each payload"),
    }
    report.line(format_args!("{line} (seed {}).", a.seed));
    if !d.configurations.removed.is_empty() {
        let removed: Vec<String> = d
            .configurations
            .removed
            .iter()
            .map(|r| format!("{} {}", r.constraint, r.configurations))
            .collect();
        report.line(format_args!(
            "  {} random configurations, {} allowed; taken away by {}.",
            d.configurations.drawn,
            d.configurations.allowed,
            removed.join(", ")
        ));
    }
    if candidates.joints.len() < CHOICE * plan.poses.len() {
        crate::cli::terminal::print::note(format_args!(
            "only {} configurations are allowed: the plan takes a large part of them, wherever they are",
            candidates.joints.len()
        ));
    }
    if d.payloads_kg.len() == 1 || d.payloads_kg.is_empty() {
        crate::cli::terminal::print::note(format_args!(
            "one payload does not determine the effect of others; --payloads 0,5,10 spreads the poses over three"
        ));
    }
    report.line(format_args!(
        "  The slowest joint moves {:.0} times through its range, {:.2} ranges a move.",
        d.travel,
        d.travel / (plan.poses.len().max(2) - 1) as f64
    ));
    if let Some(forecast) = &d.forecast {
        print_forecast(report, forecast, d.poses);
    }
}

fn print_forecast(report: Printer, forecast: &Forecast, planned: usize) {
    let field = |mean: Option<f64>, p95: Option<f64>| match (mean, p95) {
        (Some(mean), Some(p95)) => format!("{mean:.3} / {p95:.3}"),
        _ => "–".to_owned(),
    };
    let rows: Vec<Vec<String>> = forecast
        .rows
        .iter()
        .map(|r| {
            vec![
                format!("{} {}", if r.poses == planned { "*" } else { " " }, r.poses),
                r.strategy.to_owned(),
                field(r.paper_mm, r.paper_p95_mm),
                field(r.wild_mm, r.wild_p95_mm),
            ]
        })
        .collect();
    report.line(format_args!(
        "\nExpected error at poses that were not measured, mean / 95th percentile in mm, for arms like the simulated ones:\n\
         {} arms each with this robot's joints and frames off by a millimetre, compliant joints, noise of {} mm and\n\
         {} mrad per axis, which is part of every number; wild ones also with gears and links that no formula describes.",
        ARMS, forecast.position_noise_mm, forecast.orientation_noise_mrad
    ));
    report.table(&["  poses", "chosen", "regular arm", "wild arm"], &rows);
    report.line(format_args!(
        "Your robot differs: only its own measurements can show its error. (Simulated in {:.0} s.)\n",
        forecast.seconds
    ));
}
