//! `trainer plan`.

mod constraint_failure;
mod document;
mod touch;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use clap::Args;
use nalgebra::Vector3;

use crate::cli::args::{Gravity, RobotArgs, gravity, heading};
use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_not_filled_in, check_outputs, json_text, write_outputs};
use crate::cli::terminal::interrupt::cancellable_by_caller;
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::progress;
use crate::robot_programs::{Language, program};
use constraint_failure::too_tight;
use document::{Forecast, PlanJson, document};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::model::Method;
use poegp_calibration::numeric::statistics::extremes;
use poegp_calibration::planning::candidates::Candidates;
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::planning::forecast::ARMS;
use poegp_calibration::planning::links::{RADIUS_SHARE, RadiusSource};
use poegp_calibration::planning::sister::Sister;
use poegp_calibration::planning::table::to_csv;
use poegp_calibration::planning::touches::Goal;
use poegp_calibration::planning::{self, CHOICE, FEW, Planner, Strategy, Task};
use poegp_calibration::simulation::{ORIENTATION_NOISE_RAD, POSITION_NOISE_M};

/// Default number of poses in a plan.
const USUAL_COUNT: u32 = 100;

/// Next step for an arm that a language does not move.
const NO_PROGRAM: &str =
    "leave this option out and use the CSV plan of --out, which has a column for every joint";

/// `trainer plan`.
#[derive(Debug, Args)]
#[command(
    after_help = "In every pose the links stay clear of each other and of the base, and above the plane on which the robot is \
    mounted. A link is a capsule: a straight line between two joints, with a radius. The command does not check cables, the \
    load or the motion between poses: try every program slowly first.\n\n\
    Examples:\n  \
    trainer plan --robot abb-irb4400-serial --count 50 --payloads 0,5,10 --out plan.csv --rapid plan.mod\n  \
    trainer plan --robot ur10 --constraints cell.toml --count 100 --test-poses 15 --test-out check.csv --out plan.csv \
    --urscript plan.script\n  \
    trainer plan --robot ur10 --touch socket=600,100,300 --touch socket=400,-300,300 --count 40 --out touches.csv \
    --features-out touches.toml"
)]
pub struct Plan {
    #[command(flatten)]
    robot: RobotArgs,
    /// Number of poses for the calibration (default 100; with --touch 20 for each feature).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=2000))]
    count: Option<u32>,
    /// Payloads in kg, separated by commas; the plan has one block of poses for each.
    #[arg(long, value_name = "KG,KG", value_delimiter = ',')]
    payloads: Vec<f64>,
    /// Number of additional random poses, for `evaluate`.
    #[arg(long, value_name = "K", default_value_t = 0, requires = "test_out", value_parser = clap::value_parser!(u32).range(0..=500))]
    test_poses: u32,
    /// File for the additional random poses; do not calibrate with them.
    #[arg(long, value_name = "FILE", requires = "test_poses")]
    test_out: Option<PathBuf>,
    /// The plan as CSV, in the columns of a measurement file without the measurements.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Write the plan's statistics and the forecast as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Constraints of the robot cell: joint ranges, floor, workspace, keep-out boxes, the instrument's line of sight (TOML).
    #[arg(long, help_heading = heading::CHOICE, value_name = "FILE")]
    constraints: Option<PathBuf>,
    /// Choose the poses from which the model predicts all others best (default up to 60 poses).
    #[arg(long, help_heading = heading::CHOICE, conflicts_with = "space_filling")]
    v_optimal: bool,
    /// Choose poses as far apart as possible (default for more than 60 poses).
    #[arg(long, help_heading = heading::CHOICE)]
    space_filling: bool,
    /// Model of a calibrated robot of the same type, whose error sizes a V-optimal plan expects.
    #[arg(long, help_heading = heading::CHOICE, value_name = "MODEL.blob", conflicts_with = "space_filling")]
    prior: Option<PathBuf>,
    /// Gravity in the base frame in m/s², for robots on a wall or a ceiling (default: 0,0,-9.81).
    #[arg(long, help_heading = heading::CHOICE, value_name = "X,Y,Z", default_value = "0,0,-9.81", hide_default_value = true, allow_hyphen_values = true, value_parser = gravity)]
    gravity: Gravity,
    /// Seed of the random numbers; the same seed gives the same plan.
    #[arg(long, help_heading = heading::CHOICE, default_value_t = 1)]
    seed: u64,
    /// Plan touches of a feature: socket=X,Y,Z, plane=X,Y,Z or wire=X,Y,Z, its approximate position in mm in
    /// the base frame, plane=X,Y,Z,NX,NY,NZ with the normal of a plane that is not level; may be repeated. The tip is the [target] of --constraints.
    #[arg(long, help_heading = heading::TOUCHES, value_name = "KIND=X,Y,Z", value_parser = touch::goal, conflicts_with_all = [
        "payloads", "test_poses", "v_optimal", "space_filling", "prior", "gravity", "forecast", "no_forecast", "rapid", "krl", "urscript",
        "fanuc"
    ])]
    pub touch: Vec<Goal>,
    /// Write the description of the touched features, to be completed (TOML).
    #[arg(long, help_heading = heading::TOUCHES, value_name = "FILE", requires = "touch")]
    features_out: Option<PathBuf>,
    /// Numbers of poses for which the forecast simulates the error, in addition to the plan.
    #[arg(long, help_heading = heading::FORECAST, value_name = "N,N", value_delimiter = ',', default_value = "25,50,75,100,150,200,300", value_parser = forecast_count)]
    forecast: Vec<usize>,
    /// Skip the forecast, which takes about three minutes of processor time, shared by all cores.
    #[arg(long, help_heading = heading::FORECAST, conflicts_with = "forecast")]
    no_forecast: bool,
    /// The plan as a program for ABB (.mod).
    #[arg(long, help_heading = heading::PROGRAMS, value_name = "FILE")]
    rapid: Option<PathBuf>,
    /// The plan as a program for KUKA (.src).
    #[arg(long, help_heading = heading::PROGRAMS, value_name = "FILE")]
    krl: Option<PathBuf>,
    /// The plan as a program for Universal Robots (.script).
    #[arg(long, help_heading = heading::PROGRAMS, value_name = "FILE")]
    urscript: Option<PathBuf>,
    /// The plan as a program listing for Fanuc (.ls).
    #[arg(long, help_heading = heading::PROGRAMS, value_name = "FILE")]
    fanuc: Option<PathBuf>,
}

pub fn run(a: &Plan) -> Result<(), Failure> {
    match a.touch.is_empty() {
        true => of_poses(a),
        false => touch::run(&touch::Asked {
            robot: &a.robot,
            goals: &a.touch,
            count: a.count,
            constraints: a.constraints.as_deref(),
            seed: a.seed,
            out: &a.out,
            features_out: a.features_out.as_deref(),
            json: a.json.as_deref(),
        }),
    }
}

/// Plans poses for a tracker, writes the outputs and prints the result.
fn of_poses(a: &Plan) -> Result<(), Failure> {
    let programs = [&a.rapid, &a.krl, &a.urscript, &a.fanuc];
    let mut outputs = vec![
        (Some(a.out.as_path()), Kind::FilledIn),
        (a.test_out.as_deref(), Kind::FilledIn),
        (a.json.as_deref(), Kind::Json),
    ];
    outputs.extend(programs.iter().map(|p| (p.as_deref(), Kind::FilledIn)));
    let mut inputs = vec![Path::new(&a.robot.robot)];
    inputs.extend(a.constraints.as_deref());
    inputs.extend(a.prior.as_deref());
    let outputs = check_outputs(&outputs, &inputs)?;
    let planned = planned(a, check_not_filled_in)?;
    let json = json_text(&planned.document)?;
    let mut files = planned.outputs();
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    let report = Printer::for_outputs(&outputs);
    print(report, a, &planned);
    report.written(&outputs);
    Ok(())
}

/// A plan of poses, before anything is written.
pub struct Planned<'a> {
    pub plan: planning::Plan,
    pub document: PlanJson,
    /// Paths and texts of the tables and robot programs; the first is the table of `--out`.
    pub files: Vec<(&'a Path, String)>,
    /// Notes about the choice.
    pub notes: Vec<String>,
    /// Sentence about the bodies that the arm must not touch.
    bodies: String,
}

impl Planned<'_> {
    fn outputs(&self) -> Vec<(&Path, &[u8])> {
        outputs(&self.files)
    }
}

fn outputs<'a>(files: &'a [(&'a Path, String)]) -> Vec<(&'a Path, &'a [u8])> {
    let files = files.iter();
    files.map(|(path, text)| (*path, text.as_bytes())).collect()
}

/// Plans poses for a tracker. `check` gets the files before the forecast begins, which takes minutes. The flag of a caller that
/// embeds this program cancels it.
///
/// # Errors
/// Those of `check`, and [`Failure`] about the inputs.
pub fn planned(
    a: &Plan,
    check: impl FnOnce(&[(&Path, &[u8])]) -> Result<(), Failure>,
) -> Result<Planned<'_>, Failure> {
    cancellable_by_caller(|cancel| planned_until(a, check, cancel))?
}

fn planned_until<'a>(
    a: &'a Plan,
    check: impl FnOnce(&[(&Path, &[u8])]) -> Result<(), Failure>,
    cancel: &AtomicBool,
) -> Result<Planned<'a>, Failure> {
    let payloads = payloads(&a.payloads)?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let (count, checks) = (
        a.count.unwrap_or(USUAL_COUNT) as usize,
        a.test_poses as usize,
    );
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
    let sister = match &a.prior {
        Some(path) => Some(sister(path, &arm, asked.unwrap_or(Strategy::usual(count)))?),
        None => None,
    };
    let planner = Planner::new(Task {
        robot: &arm.robot,
        nominal: &arm.nominal,
        constraints: &constraints,
        payloads: &payloads,
        gravity: Vector3::from(a.gravity.0),
        noise: (POSITION_NOISE_M, ORIENTATION_NOISE_RAD),
        sister: sister.as_ref(),
        seed: a.seed,
        cancel,
    });
    let spinner = progress::spinner("choosing poses");
    let plan = planner.plan(count, checks, asked.unwrap_or(Strategy::usual(count)));
    spinner.finish_and_clear();
    let plan = plan.map_err(|e| too_tight(&constraints, &arm.robot, &e))?;
    let written = [
        Language::Rapid,
        Language::Krl,
        Language::UrScript,
        Language::Fanuc,
    ]
    .into_iter()
    .zip([&a.rapid, &a.krl, &a.urscript, &a.fanuc])
    .filter_map(|(language, path)| path.as_deref().map(|path| (language, path)))
    .map(|(language, path)| {
        let name = path
            .file_stem()
            .map_or("plan".into(), |s| s.to_string_lossy());
        let text = program(language, &name, &arm.robot, &plan).map_err(|e| {
            InputError::new(path, e.to_string(), "a robot that fits").with_help(NO_PROGRAM)
        })?;
        Ok((path, text))
    })
    .collect::<Result<Vec<_>, InputError>>()?;
    let mut files = vec![(a.out.as_path(), to_csv(&arm.robot, &plan, false))];
    let checks = |path| (path, to_csv(&arm.robot, &plan, true));
    files.extend(a.test_out.as_deref().map(checks));
    files.extend(written);
    check(&outputs(&files))?;
    let forecast = (!a.no_forecast).then(|| forecast(&planner, &a.forecast, count, asked));
    let document = document(
        a.seed,
        &arm,
        &plan,
        &planner,
        &constraints,
        sister.as_ref(),
        forecast,
    );
    Ok(Planned {
        bodies: capsules(&document, &constraints),
        notes: notes(&document, &plan, &constraints, planner.candidates()),
        plan,
        document,
        files,
    })
}

/// Returns the notes about what limits a plan.
fn notes(
    d: &PlanJson,
    plan: &planning::Plan,
    constraints: &Constraints,
    candidates: &Candidates,
) -> Vec<String> {
    let mut out = Vec::new();
    if candidates.joints.len() < CHOICE * plan.poses.len() {
        out.push(format!(
            "only {} configurations are allowed, so the plan takes a large part of them; {}",
            candidates.joints.len(),
            constraint_failure::releases(constraints, &candidates.refusals)
        ));
    }
    if d.payloads_kg.len() <= 1 {
        out.push(
            "one payload does not determine the effect of others; --payloads 0,5,10 spreads the poses over three"
                .to_owned(),
        );
    }
    out
}

fn forecast_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count @ 1..=1000) => Ok(count),
        _ => Err("expected a number of poses from 1 to 1000".to_owned()),
    }
}

/// Checks payloads in kg, sorts them and removes duplicates.
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

/// Reads the model of `--prior`, which must be of the same type of robot.
fn sister(path: &Path, arm: &Arm, strategy: Strategy) -> Result<Sister, Failure> {
    if strategy != Strategy::VOptimal {
        return Err(Failure::Usage(format!(
            "--prior {}: found a space-filling plan, which needs no prior, expected --v-optimal or --count {FEW} or less",
            path.display()
        )));
    }
    let model = BlobModel::read(path)?;
    Sister::new(&model, &arm.robot).map_err(|error| {
        let joints = arm.robot.joints.len();
        let expected = format!(
            "a model of the same type of robot as \"{}\", with {joints} joints",
            arm.robot.name
        );
        InputError::new(path, error.to_string(), expected)
            .with_help(
                "plan with the description that the model was calibrated with, or without --prior",
            )
            .into()
    })
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

/// Describes the bodies that the arm must not touch, and the source of its links' radius.
fn capsules(d: &PlanJson, constraints: &Constraints) -> String {
    let radii = &d.links.radii_mm;
    let (thinnest, thickest) = extremes(radii.iter().copied());
    let range = if thinnest < thickest {
        format!("{thinnest:.0} to {thickest:.0} mm")
    } else {
        format!("{thickest:.0} mm")
    };
    let from = match constraints.links.source() {
        RadiusSource::Constraints => "from the constraints".to_owned(),
        RadiusSource::Description => "from the robot description".to_owned(),
        RadiusSource::Reach => format!(
            "{:.0} % of the {:.0} mm from joint 2 to the flange",
            100.0 * RADIUS_SHARE,
            1e3 * constraints.links.reach()
        ),
    };
    let floor = match d.floor_mm {
        Some(height) => format!("they stay above z = {height} mm of the base frame"),
        None => "there is no floor".to_owned(),
    };
    format!("Links are capsules with a radius of {range} ({from}); {floor}.")
}

fn print(report: Printer, a: &Plan, planned: &Planned<'_>) {
    let (d, plan) = (&planned.document, &planned.plan);
    let mut line = format!("Planned {} {} poses", d.poses, d.strategy);
    if d.test_poses > 0 {
        line += &format!(" and {} test poses", d.test_poses);
    }
    match d.payloads_kg.len() {
        0 => line += ", no payload stated",
        1 => line += &format!(", all with {} kg", d.payloads_kg[0]),
        n => line += &format!(" in {n} blocks, one for each payload"),
    }
    report.line(format_args!("{line} (seed {}).", a.seed));
    if let (Some(path), Some(prior)) = (&a.prior, &d.prior) {
        let deflections = match prior.elastic {
            true => format!("deflections and {} waves of its joints", prior.waves),
            false => "usual deflections, because the model has none".to_owned(),
        };
        report.line(format_args!(
            "  Expected errors are those of {}: frames {:.2} mm and {:.2} mrad off nominal, {deflections}.",
            path.display(),
            prior.frames_mm,
            prior.frames_mrad
        ));
    }
    report.line(format_args!("  {}", planned.bodies));
    let removed: Vec<String> = d
        .configurations
        .removed
        .iter()
        .map(|r| format!("{} {}", r.constraint, r.configurations))
        .collect();
    report.line(format_args!(
        "  {} random configurations, {} allowed; forbidden by {}.",
        d.configurations.drawn,
        d.configurations.allowed,
        removed.join(", ")
    ));
    planned.notes.iter().for_each(note);
    report.line(format_args!(
        "  The slowest joint moves {:.0} times through its range, {:.2} ranges per move.",
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
        "\nExpected error at poses that were not measured, mean / 95th percentile in mm, from {} simulated arms of each kind:\n\
         this robot with frames off by a millimetre, compliant joints, and noise of {} mm and {} mrad per axis, which\n\
         every number includes. Wild arms also have errors of gears and links that no formula describes.",
        ARMS, forecast.position_noise_mm, forecast.orientation_noise_mrad
    ));
    report.table(&["  poses", "chosen", "regular arm", "wild arm"], &rows);
    report.line(format_args!(
        "Your robot differs: only its own measurements show its error. (Simulated in {:.0} s.)\n",
        forecast.seconds
    ));
}
