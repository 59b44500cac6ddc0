//! `trainer export`.

mod region;

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, json_text, summary_text, write_texts};
use crate::cli::terminal::print::{Printer, is_stdout};
use crate::export::calibrated_chain::COUPLING;
use crate::export::describe::{
    accuracy, describe, distance_json, region as describe_region, target_of,
};
use crate::export::urdf::{Changes, NEW_LINK, changes, minimal};
use crate::export::{
    CalibratedChain, Table, c_header, csv, dh, joint_zeros, mjcf, poe, universal_robots as ur,
    urdf_patch as urdf_text,
};
use poegp_calibration::blob::commander::pose_distance;
use poegp_calibration::blob::joint_offsets::JointOffsets;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::predicted_poses::PredictedPoses;
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::robot::{LoadOptions, Robot, urdf};

/// `trainer export`.
#[derive(Debug, Args)]
#[command(
    after_help = "Give at least one output. Each holds the calibrated chain of the blob, to a nanometre (the floats of a C \
    header: to tenths of a micrometre). The command names what a file cannot hold (gravity, ripple, Gaussian processes). If \
    the model has some of these, the chain is the one whose poses are closest to the model's over a region and its payloads. \
    Each file states how far the chain and the nominal model are from the calibrated model. A chain that is no closer \
    than the nominal model is not written, and the exit code is 1. Only the C header holds the whole model.\n\n\
    Examples:\n  trainer export arm.blob --urdf nominal.urdf --out calibrated.urdf --payload-kg 5\n  \
    trainer export arm.blob --mjcf arm.xml --region 15@0,-20,30,0,45,0\n  \
    trainer export arm.blob --dh arm-dh.toml --poe arm-poe.json --c-header arm.h"
)]
pub struct Export {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Write the calibrated URDF: the file of --urdf with corrected transforms, or links and joints alone.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Nominal URDF that the robot was calibrated with.
    #[arg(long, value_name = "FILE", requires = "out")]
    pub urdf: Option<PathBuf>,
    /// URDF link at which the chain begins, the same as in the calibration (default: the root).
    #[arg(long, value_name = "LINK", requires = "urdf")]
    pub base: Option<String>,
    /// URDF link at which the chain ends, the same as in the calibration (default: the only leaf, or tool0, flange, ee_link).
    #[arg(long, value_name = "LINK", requires = "urdf")]
    pub tip: Option<String>,
    /// Add a link of this name to the URDF at the measured target, fixed to the tip.
    #[arg(long, value_name = "LINK", requires = "out")]
    pub target_link: Option<String>,
    /// Write the kinematics file of the Universal Robots ROS driver (.yaml), or the same numbers as .csv.
    #[arg(long, value_name = "FILE")]
    pub ur_kinematics: Option<PathBuf>,
    /// Write a model for MuJoCo (MJCF): bodies and joints, the flange and the target as sites.
    #[arg(long, value_name = "FILE")]
    pub mjcf: Option<PathBuf>,
    /// Write a Denavit-Hartenberg table, distal, Hayati's for parallel axes (.toml, which --robot reads, .json or .csv).
    #[arg(long, value_name = "FILE")]
    pub dh: Option<PathBuf>,
    /// Write a Denavit-Hartenberg table, proximal (modified, Craig's), in the same three formats.
    #[arg(long, value_name = "FILE")]
    pub mdh: Option<PathBuf>,
    /// Write offsets of the joints between the first and the last, with base and tool (.toml or .json).
    #[arg(long, value_name = "FILE")]
    pub joint_offsets: Option<PathBuf>,
    /// Write a table of frames (.toml, which --robot reads, .json or .csv).
    #[arg(long, value_name = "FILE")]
    pub poe: Option<PathBuf>,
    /// Write a C header with the bytes of the blob and the frames of the chain.
    #[arg(long, value_name = "FILE")]
    pub c_header: Option<PathBuf>,
    /// Fit the chain near some poses: DEGREES@q1,…,qn around one pose in degrees (mm along prismatic joints),
    /// a CSV file of poses (within 2 degrees), or DEGREES@CSV. Default: the trained ranges.
    #[arg(long, value_name = "POSES", allow_hyphen_values = true)]
    pub region: Option<String>,
    /// Fit the chain for one trained payload in kg (default: those of the region's file, else all that were trained).
    #[arg(long, value_name = "KG")]
    pub payload_kg: Option<f32>,
    /// Write file names, distance from the model and omitted effects as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Export) -> Result<(), Failure> {
    exported(a).map(|_| ())
}

/// Writes the exported files, and returns the JSON document that `--json` writes.
pub fn exported(a: &Export) -> Result<String, Failure> {
    let (outputs, has_chain) = outputs(a)?;
    let report = Printer::for_outputs(&outputs);
    let loaded = BlobModel::read(&a.blob)?;
    let region = region::region(&loaded, a.region.as_deref(), a.payload_kg)?;
    let predicted = PredictedPoses::new(&loaded, region);
    let mut chain = CalibratedChain::nearest(&loaded, &predicted);
    if has_chain {
        nearer_than_the_nominal("the chain", &chain.distance.chain, &chain)?;
    }

    let mut said = Vec::new();
    let mut files = chain_files(a, &loaded, &mut chain, &mut said)?;
    let zeros = match &a.joint_offsets {
        Some(path) => Some((path.as_path(), joint_zeros_of(&predicted, &chain)?)),
        None => None,
    };
    if let Some((path, zeros)) = &zeros {
        let text = match format_of(path, false)? {
            Format::Toml => joint_zeros::to_toml(&chain, zeros),
            Format::Json | Format::Csv => json_text(&joint_zeros::to_json(&chain, zeros))?,
        };
        files.push((path, text));
    }
    let names: Vec<&Path> = files.iter().map(|(path, _)| *path).collect();
    let has_links = a.out.is_some() || a.mjcf.is_some();
    let mut left_out = chain.not_carried.clone();
    left_out.extend(
        (has_links && chain.coupling.is_some()).then(|| format!("in URDF and MJCF {COUPLING}")),
    );
    let has_new_links = a.mjcf.is_some() || (a.out.is_some() && a.urdf.is_none());
    let limits = chain.limits_left_out().filter(|_| has_new_links);
    left_out.extend(limits.map(|limits| format!("in URDF and MJCF {limits}")));
    let mut summary = json!({
        "robot": chain.name,
        "files": names,
        "remarks": said,
        "not_carried": left_out,
        "other_tools": chain.other_tools,
        "distance": match &zeros {
            Some((_, zeros)) => joint_zeros::distances(&chain, zeros),
            None => distance_json(&chain),
        },
    });
    if let Some(fit) = &chain.fit {
        summary["fit"] = json!({
            "payload_kg": summary["distance"]["payload_kg"],
            "before": fit.before,
            "after": fit.after,
        });
    }
    let summary = summary_text(summary)?;
    let texts = files
        .iter()
        .map(|(path, text)| (Some(*path), Some(text.as_str())));
    let mut texts: Vec<_> = texts.collect();
    texts.push((a.json.as_deref(), Some(&summary)));
    write_texts(&texts)?;

    for path in names.iter().filter(|path| !is_stdout(path)) {
        report.line(format_args!("Wrote {}", path.display()));
    }
    if has_chain || zeros.is_none() {
        print_accuracy(report, "Chain", accuracy(&chain));
    }
    if let Some((_, zeros)) = &zeros {
        print_accuracy(report, "Offsets", joint_zeros::accuracy(&chain, zeros));
        said.extend(joint_zeros::moves(&chain, zeros));
    }
    for line in said {
        report.line(format_args!("  {line}"));
    }
    if !left_out.is_empty() && has_chain {
        print_left_out(report, &left_out, a.c_header.is_some());
    }
    for line in target_of(&chain) {
        report.line(format_args!("  {line}"));
    }
    Ok(summary)
}

/// Returns the paths of all outputs, and whether one of them is a whole chain. Refuses to write nothing, or over an input.
fn outputs(a: &Export) -> Result<(Vec<Option<&Path>>, bool), Failure> {
    let of_the_chain = [
        (a.out.as_deref(), Kind::Urdf),
        (a.mjcf.as_deref(), Kind::Mjcf),
        (a.ur_kinematics.as_deref(), Kind::UrKinematics),
        (a.dh.as_deref(), Kind::Dh),
        (a.mdh.as_deref(), Kind::ModifiedDh),
        (a.poe.as_deref(), Kind::Poe),
    ];
    let others = [
        (a.joint_offsets.as_deref(), Kind::JointOffsets),
        (a.c_header.as_deref(), Kind::CHeader),
    ];
    let mut outputs = [&of_the_chain[..], &others].concat();
    if outputs.iter().all(|(path, _)| path.is_none()) {
        return Err(Failure::Usage(
            "nothing to write: give --out, --mjcf, --ur-kinematics, --dh, --mdh, --poe, --joint-offsets or --c-header \
             a file\nhelp: `trainer export --help` describes them"
                .to_owned(),
        ));
    }
    let mut inputs = vec![a.blob.as_path()];
    inputs.extend(a.urdf.as_deref());
    inputs.extend(a.region.as_deref().map(region::file));
    outputs.push((a.json.as_deref(), Kind::Json));
    let outputs = check_outputs(&outputs, &inputs)?;
    let has_chain = of_the_chain.iter().any(|(path, _)| path.is_some());
    Ok((outputs, has_chain))
}

/// Returns the texts of all files of the chain, each with its path. `said` gains what the user should know of them, and a
/// nominal URDF names the joints of the chain.
fn chain_files<'a>(
    a: &'a Export,
    loaded: &BlobModel,
    chain: &mut CalibratedChain,
    said: &mut Vec<String>,
) -> Result<Vec<(&'a Path, String)>, Failure> {
    let mut files: Vec<(&Path, String)> = Vec::new();
    if let Some(path) = &a.out {
        let text = match &a.urdf {
            Some(nominal) => corrected_urdf(a, nominal, chain, said)?,
            None => {
                let link = a.target_link.as_deref();
                minimal(chain, link).map_err(|bad| {
                    let (asked, found) = (link.unwrap_or_default(), bad.found);
                    Failure::Usage(format!(
                        "--target-link {asked:?}: found {found}, expected {NEW_LINK}"
                    ))
                })?
            }
        };
        files.push((path, text));
    }
    if let Some(path) = &a.ur_kinematics {
        files.push((path, ur_kinematics(a, path, chain, said)?));
    }
    files.extend(a.mjcf.as_deref().map(|path| (path, mjcf::text(chain))));
    for (path, table) in [
        (&a.dh, dh::table as fn(&_) -> _),
        (&a.mdh, dh::modified_table),
        (&a.poe, poe::table),
    ] {
        if let Some(path) = path {
            let table: Table = table(chain);
            let text = match format_of(path, true)? {
                Format::Toml => table.to_toml(chain),
                Format::Json => json_text(&table.to_json(chain))?,
                Format::Csv => csv::table(chain, &table),
            };
            files.push((path, text));
        }
    }
    if let Some(path) = &a.c_header {
        let stem = path
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        files.push((path, c_header::text(loaded, chain, &stem)));
    }
    Ok(files)
}

/// Prints what a chain of frames cannot hold.
fn print_left_out(report: Printer, left_out: &[String], has_c_header: bool) {
    report.line(format_args!(
        "Not in these files, which hold a chain of frames only{}: {}",
        if has_c_header {
            " (the C header has the whole model)"
        } else {
            ""
        },
        left_out.join("; ")
    ));
}

fn print_accuracy(report: Printer, what: &str, lines: Vec<String>) {
    for (i, line) in lines.iter().enumerate() {
        match i {
            0 => report.line(format_args!("{what}: {line}")),
            _ => report.line(format_args!("  {line}")),
        }
    }
}

/// Refuses a chain that is no nearer to the model than the nominal model.
fn nearer_than_the_nominal(
    what: &str,
    error: &ErrorSummary,
    chain: &CalibratedChain,
) -> Result<(), Failure> {
    let (own, nominal) = (
        error.position_mm.mean,
        chain.distance.nominal.position_mm.mean,
    );
    if own < nominal {
        return Ok(());
    }
    let whole = chain.distance.chain.position_mm.mean;
    let help = match whole < nominal {
        true => format!("a file of the whole chain, such as --dh, is {whole:.3} mm from the model"),
        false => "use the nominal model; `trainer inspect` shows base and tool".to_owned(),
    };
    Err(Failure::Quality(format!(
        "nothing written: {what} would be {own:.3} mm from the model on average, no nearer than the {nominal:.3} mm \
        of the nominal model with the model's base and tool, over {}\n\
         help: {help}",
        describe_region(&chain.distance.region, &chain.joints)
    )))
}

fn joint_zeros_of(
    predicted: &PredictedPoses,
    chain: &CalibratedChain,
) -> Result<JointOffsets, Failure> {
    let zeros = JointOffsets::new(
        predicted,
        &chain.nominal_arm(),
        &chain.flange_from_target,
        chain.coupling.as_deref(),
    );
    nearer_than_the_nominal("the nominal model with joint offsets", &zeros.error, chain)?;
    Ok(zeros)
}

/// Writes the calibrated transforms into the nominal URDF; the names of its joints are used in all other files, too.
fn corrected_urdf(
    a: &Export,
    nominal: &Path,
    chain: &mut CalibratedChain,
    said: &mut Vec<String>,
) -> Result<String, Failure> {
    let options = LoadOptions {
        base: a.base.clone(),
        tip: a.tip.clone(),
    };
    let spec = nominal.to_string_lossy();
    let is_urdf = nominal
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("urdf") || e.eq_ignore_ascii_case("xml"));
    if !is_urdf {
        let found = "a name that does not end with .urdf or .xml";
        return Err(InputError::new(nominal, found, "a URDF file")
            .with_help("leave --urdf out to write a URDF of links and joints alone")
            .into());
    }
    let robot = Robot::load(&spec, &options)?;
    match chain.distance_to(&robot) {
        Some((_, _, true)) => {}
        Some((apart, turned, false)) => {
            let found = format!(
                "a chain whose flange is up to {:.3} mm and {:.3} mrad from that of the nominal robot of the blob, {}",
                1e3 * apart,
                1e3 * turned,
                chain.name
            );
            return Err(InputError::new(nominal, found, "the robot that was calibrated")
                .with_help(
                    "give the URDF of the calibration, with the same --base and --tip; to use another description of \
                     the arm, calibrate with it",
                )
                .into());
        }
        None => {
            let found = format!(
                "{}, or joints of another kind",
                counted(robot.joints.len(), "moving joint")
            );
            let expected = format!("the {} joints of {}", chain.joints.len(), chain.name);
            return Err(InputError::new(nominal, found, expected).into());
        }
    }
    chain.joints = robot.joints;
    let bytes = std::fs::read(nominal)
        .map_err(|error| InputError::unreadable(nominal, &error, "a URDF file"))?;
    let text = String::from_utf8_lossy(&bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let joints = urdf::joints_of_chain(nominal, text, &options)?;
    let changes = changes(chain, &joints, a.target_link.as_deref());
    let out = urdf_text::rewritten(nominal, text, chain, &changes)?;
    said.extend(describe_changes(&changes));
    Ok(out)
}

fn describe_changes(changes: &Changes) -> Vec<String> {
    let mut out: Vec<String> = changes
        .corrected
        .iter()
        .map(|c| {
            let (apart, turned) = pose_distance(&c.before, &c.after);
            format!(
                "joint {}: moved by {:.3} mm and {:.3} mrad",
                c.joint,
                1e3 * apart,
                1e3 * turned
            )
        })
        .collect();
    out.extend(
        changes
            .added
            .iter()
            .map(|new| format!("link {}: added to {}", new.link, new.parent)),
    );
    out
}

fn ur_kinematics(
    a: &Export,
    path: &Path,
    chain: &CalibratedChain,
    said: &mut Vec<String>,
) -> Result<String, Failure> {
    let kinematics = ur::UrKinematics::of(chain).map_err(|error| {
        InputError::new(
            &a.blob,
            error.to_string(),
            "an arm of Universal Robots' layout, from base or base_link to tool0",
        )
        .with_help("only their driver reads this file; --out, --dh and --poe are for all arms")
    })?;
    said.push(format!(
        "TCP to be set, tool0 to target: {}",
        describe(&kinematics.tool0_from_target)
    ));
    let (apart, turned) = pose_distance(
        &poegp_runtime::math::se3::Pose::identity(),
        &kinematics.tool0_from_flange,
    );
    said.push(format!(
        "tool0 is {:.4} mm and {:.4} mrad from the calibrated flange: the driver's six frames end on the last axis",
        1e3 * apart,
        1e3 * turned
    ));
    if kinematics.base_is_base_link {
        said.push(
            "the blob's base is base_link; the file begins at base_link_inertia, turned by 180° about z".to_owned(),
        );
    }
    Ok(match path.extension().and_then(|e| e.to_str()) {
        Some(e) if e.eq_ignore_ascii_case("csv") => csv::universal_robots(chain, &kinematics),
        Some(e) if ["yaml", "yml"].iter().any(|y| e.eq_ignore_ascii_case(y)) => {
            kinematics.to_yaml(chain)
        }
        _ if is_stdout(path) => kinematics.to_yaml(chain),
        _ => {
            let expected = "a name that ends with .yaml, .yml or .csv, or - for YAML";
            return Err(unknown_format(path, expected));
        }
    })
}

/// Returns the error for a file name that does not say which format to write.
fn unknown_format(path: &Path, expected: impl Into<String>) -> Failure {
    InputError::new(path, "a file name without a known format", expected).into()
}

/// The format of an exported table.
enum Format {
    Toml,
    Json,
    Csv,
}

/// Returns the format that a file name asks for; `.csv` is allowed only for tables with rows.
fn format_of(path: &Path, has_rows: bool) -> Result<Format, Failure> {
    match path.extension().and_then(|e| e.to_str()) {
        Some("toml") => Ok(Format::Toml),
        Some("json") => Ok(Format::Json),
        Some("csv") if has_rows => Ok(Format::Csv),
        _ if is_stdout(path) => Ok(Format::Json),
        _ => {
            let csv = if has_rows {
                ", .json or .csv"
            } else {
                " or .json"
            };
            let expected = format!("a name that ends with .toml{csv}, or - for JSON");
            Err(unknown_format(path, expected))
        }
    }
}
