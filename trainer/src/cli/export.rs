//! `trainer export`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::failure::Failure;
use crate::cli::output::{check_outputs, json_text, summary_text, write_outputs};
use crate::cli::terminal::print::{Printer, is_stdout};
use crate::export::urdf::{Changes, changes, minimal};
use crate::export::{
    CalibratedChain, Table, c_header, describe_fit, dh, gauge, poe, universal_robots as ur,
    urdf_patch as urdf_text,
};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::robot::{LoadOptions, Robot, urdf};

/// `trainer export`.
#[derive(Debug, Args)]
#[command(
    after_help = "Give at least one output. Each is the calibrated chain of the blob, to a nanometre; what a file cannot \
    hold (gravity, ripple, Gaussian processes) is said. Of a model that has some of these, the chain is the one whose poses \
    are nearest to the model's over the trained ranges; what it leaves is printed. Only the C header has the whole model.\n\n\
    Example: trainer export arm.blob --urdf nominal.urdf --out calibrated.urdf\n\
    Example: trainer export arm.blob --dh arm-dh.toml --poe arm-poe.json --c-header arm.h"
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
    /// Write the kinematics file of the Universal Robots ROS driver (YAML).
    #[arg(long, value_name = "FILE")]
    pub ur_kinematics: Option<PathBuf>,
    /// Write a Denavit-Hartenberg table, distal, Hayati's for parallel axes (.toml, which --robot reads, or .json).
    #[arg(long, value_name = "FILE")]
    pub dh: Option<PathBuf>,
    /// Write a table of frames (.toml, which --robot reads, or .json).
    #[arg(long, value_name = "FILE")]
    pub poe: Option<PathBuf>,
    /// Write a C header with the bytes of the blob and the frames of the chain.
    #[arg(long, value_name = "FILE")]
    pub c_header: Option<PathBuf>,
    /// Fit the chain for one trained payload in kg (default: all of them, from the lightest to the heaviest).
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    pub payload_kg: Option<f32>,
    /// Write the names of the files, what the chain leaves and the omitted effects as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Export) -> Result<(), Failure> {
    let outputs = [&a.out, &a.ur_kinematics, &a.dh, &a.poe, &a.c_header].map(|o| o.as_deref());
    if outputs.iter().all(Option::is_none) {
        return Err(Failure::Usage(
            "nothing to write: give --out, --ur-kinematics, --dh, --poe or --c-header a file\n\
             help: `trainer export --help` says what they are"
                .to_owned(),
        ));
    }
    let mut inputs = vec![a.blob.as_path()];
    inputs.extend(a.urdf.as_deref());
    let all = [&outputs[..], &[a.json.as_deref()]].concat();
    check_outputs(&all, &inputs)?;
    let report = Printer::for_outputs(&all);
    let loaded = BlobModel::read(&a.blob)?;
    let mut chain = match a.payload_kg {
        None => CalibratedChain::of(&loaded),
        Some(kg) => CalibratedChain::for_payloads(&loaded, trained_payload(&loaded, kg)?),
    };

    let mut said = Vec::new();
    let mut files: Vec<(&Path, String)> = Vec::new();
    if let Some(path) = &a.out {
        let text = match &a.urdf {
            Some(nominal) => corrected_urdf(a, nominal, &mut chain, &mut said)?,
            None => minimal(&chain, a.target_link.as_deref()),
        };
        files.push((path, text));
    }
    if let Some(path) = &a.ur_kinematics {
        files.push((path, ur_kinematics(a, &chain, &mut said)?));
    }
    for (path, table) in [(&a.dh, dh::table as fn(&_) -> _), (&a.poe, poe::table)] {
        if let Some(path) = path {
            files.push((path, table_text(path, &table(&chain), &chain)?));
        }
    }
    if let Some(path) = &a.c_header {
        let stem = path
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        files.push((path, c_header::text(&loaded, &chain, &stem)));
    }
    let names: Vec<&Path> = files.iter().map(|(path, _)| *path).collect();
    let mut summary = json!({
        "robot": chain.name,
        "files": names,
        "remarks": said,
        "not_carried": chain.not_carried,
        "other_tools": chain.other_tools,
    });
    if let Some(fit) = &chain.fit {
        let (light, heavy) = fit.payload_kg;
        summary["fit"] = json!({
            "payload_kg": loaded.blob().ranges.payload_kg.map(|_| [light, heavy]),
            "before": fit.before,
            "after": fit.after,
        });
    }
    let summary = summary_text(summary)?;
    let mut bytes: Vec<(&Path, &[u8])> = files
        .iter()
        .map(|(path, text)| (*path, text.as_bytes()))
        .collect();
    bytes.extend(a.json.as_deref().map(|path| (path, summary.as_bytes())));
    write_outputs(&bytes)?;

    for (path, _) in files.iter().filter(|(path, _)| !is_stdout(path)) {
        report.line(format_args!("Wrote {}", path.display()));
    }
    if let Some(fit) = &chain.fit {
        report.line(format_args!("Chain: {}", describe_fit(fit)));
    }
    for line in said {
        report.line(format_args!("  {line}"));
    }
    if !chain.not_carried.is_empty() && files.iter().any(|(path, _)| Some(*path) != outputs[4]) {
        report.line(format_args!(
            "Not in these files, which hold a chain of frames only{}: {}",
            if a.c_header.is_some() {
                " (the C header has the whole model)"
            } else {
                ""
            },
            chain.not_carried.join("; ")
        ));
    }
    if !chain.other_tools.is_empty() {
        report.line(format_args!(
            "The target is that of the first tool; not that of {}",
            chain.other_tools.join(", ")
        ));
    }
    Ok(())
}

/// A payload for which the chain can be fitted: one that was trained.
fn trained_payload(loaded: &BlobModel, kg: f32) -> Result<(f32, f32), Failure> {
    match loaded.blob().ranges.payload_kg {
        Some((light, heavy)) if (light..=heavy).contains(&kg) => Ok((kg, kg)),
        Some((light, heavy)) => Err(Failure::Usage(format!(
            "--payload-kg {kg}: {light} to {heavy} kg were trained"
        ))),
        None => Err(Failure::Usage(format!(
            "--payload-kg {kg}: the model does not depend on the payload"
        ))),
    }
}

/// The nominal file with the calibrated transforms; its names of the joints go to all other files, too.
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
                    "give the URDF of the calibration, with the same --base and --tip; for another \
                     description of the arm calibrate again with it",
                )
                .into());
        }
        None => {
            let found = format!("{} moving joints, or of another kind", robot.joints.len());
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
            let (apart, turned) = gauge::distance(&c.before, &c.after);
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
    let describe = crate::export::describe;
    said.push(format!(
        "TCP to be set, tool0 to target: {}",
        describe(&kinematics.tool0_from_target)
    ));
    let (apart, turned) = gauge::distance(
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
    Ok(kinematics.to_yaml(chain))
}

/// A table in the format that the name of its file asks for.
fn table_text(path: &Path, table: &Table, chain: &CalibratedChain) -> Result<String, Failure> {
    match path.extension().and_then(|e| e.to_str()) {
        Some("toml") => Ok(table.to_toml(chain)),
        Some("json") => json_text(&table.to_json(chain)),
        _ if is_stdout(path) => json_text(&table.to_json(chain)),
        _ => Err(InputError::new(
            path,
            "a name that says no format",
            "a name that ends with .toml or .json, or - for JSON",
        )
        .into()),
    }
}
