//! `trainer inspect`.

use clap::Args;
use poegp_protocol::JointKind;
use poegp_protocol::blob::envelope::{self, Trailer};
use poegp_protocol::blob::{
    Blob, Correction, Elastic, FORMAT_VERSION, SetPoints, TaskSpace, stored_crc,
};
use poegp_runtime::guard::trust::Trust;
use poegp_runtime::math::se3::Pose;
use serde_json::{Value, json};
use std::path::PathBuf;

use crate::cli::calibrate::gauge::{source_name, sources};
use crate::cli::correct::record::sha256;
use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, json_text, write_texts};
use crate::cli::terminal::print::Printer;
use crate::signing::{id_text, unsigned};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::measurement::sample::ToolName;

/// `trainer inspect`.
#[derive(Debug, Args)]
#[command(after_help = "Example: trainer inspect arm.blob")]
pub struct Inspect {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Write the same as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Inspect) -> Result<(), Failure> {
    let output = check_outputs(&[(a.json.as_deref(), Kind::Json)], &[&a.blob])?;
    let loaded = BlobModel::read(&a.blob)?;
    let document = document(&loaded);
    let json = json_text(&document)?;
    write_texts(&[(a.json.as_deref(), Some(&json))])?;
    print(Printer::for_outputs(&output), &loaded, &document);
    Ok(())
}

fn document(loaded: &BlobModel) -> Value {
    let blob = loaded.blob();
    let host = loaded.host();
    let p = &host.provenance;
    let kind = |k: JointKind| {
        if k == JointKind::Revolute {
            "revolute"
        } else {
            "prismatic"
        }
    };
    let trust = Trust::<f32>::of(blob);
    let joints = blob.robot.joints.iter().zip(&blob.ranges.joints);
    let joints: Vec<Value> = joints
        .enumerate()
        .map(|(i, (joint, range))| {
            json!({"kind": kind(joint.kind), "limits": joint.limits, "trained": range, "half_trust_beyond": trust.half(i)})
        })
        .collect();
    let correction = match &blob.correction {
        Correction::None => Value::Null,
        Correction::Elastic(elastic) => json!({
            "kind": "elastic",
            "inducing_points": loaded.model().inducing_points(),
            "inducing_points_of_joints": points_of_joints(elastic),
            "gravity": elastic.gravity,
            "ripple": elastic.ripple.iter().map(|r| json!({
                "joint": r.joint + 1, "cycles_per_turn": r.cycles, "amplitude_urad": 1e6 * r.sin.hypot(r.cos)
            })).collect::<Vec<_>>(),
            "own_joint_curves": curves(elastic, blob.robot.joints.len()).map(|(orders, rms)| json!({
                "orders": orders, "rms_urad": rms
            })),
            "payload_groups_kg": elastic.group_payloads_kg,
            "correction_limit_mm": 1e3 * elastic.limit.position_m,
            "correction_limit_mrad": 1e3 * elastic.limit.angle_rad,
        }),
        Correction::TaskSpace(task) => json!({
            "kind": "task-space Gaussian process",
            "inputs": task.input_scale.len(),
            "inducing_points": loaded.model().inducing_points(),
            "hyperparameters": task.hyperparameters.iter().map(|h| json!({
                "theta": h[..4], "noise_variance": h[4]
            })).collect::<Vec<_>>(),
            "output_rms": task.output_scale,
            "correction_limit_mm": 1e3 * task.limit.position_m,
            "correction_limit_mrad": 1e3 * task.limit.angle_rad,
        }),
    };
    let size = loaded.model().size();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "format_version": FORMAT_VERSION,
        "bytes": loaded.bytes().len(),
        "unsigned_sha256": sha256(&unsigned(loaded.bytes())),
        "crc": format!("{:08x}", stored_crc(loaded.bytes()).unwrap_or(0)),
        "signed_by": trailer(loaded).map(|trailer| id_text(&trailer.key_id)),
        "revision": trailer(loaded).map(|trailer| trailer.revision),
        "robot": {"name": blob.robot.name, "serial_number": blob.robot.serial_number, "joints": joints,
                  "coupling": blob.robot.coupling.as_slice()},
        "units": {"angle": "rad", "length": "m", "mass": "kg"},
        "payload_kg": blob.ranges.payload_kg,
        "method": p.method,
        "training_poses": p.training_poses,
        "date": p.date,
        "trainer_version": p.trainer_version,
        "data_sha256": p.data_sha256.iter().map(|b| format!("{b:02x}")).collect::<String>(),
        "instrument_from_base": host.gauge.instrument_from_base,
        "flange_from_target": host.gauge.flange_from_target,
        "tools": tools(loaded).iter().map(|(name, pose)| json!({
            "session": name.session, "target": name.target, "flange_from_target": pose.to_rows()
        })).collect::<Vec<_>>(),
        "gauge": {"base": source_name(host.gauge.base), "tool": source_name(host.gauge.tool),
                  "grid_ranges": host.gauge.ranges.as_slice(), "grid_payload_kg": host.gauge.payload_kg},
        "warnings": blob.warnings.iter().map(|c| c.name()).collect::<Vec<_>>(),
        "accepted": host.accepted.iter().map(|c| c.name()).collect::<Vec<_>>(),
        "correction": correction,
        "predictive_std": predictive_std(blob),
        "instructions": {
            "evaluation": size.map_or(0, |size| size.pose_bound()),
            "command": size.map_or(0, |size| size.command_bound()),
        },
    })
}

/// Returns the tools that the blob names, with `flange_from_target` of each.
fn tools(loaded: &BlobModel) -> Vec<(&ToolName, Pose<f64>)> {
    let first = Pose::from_rows(&loaded.host().gauge.flange_from_target);
    let named = loaded.tools().iter();
    named
        .map(|(name, first_from_own)| (name, first * *first_from_own))
        .collect()
}

/// Returns the signature part of the blob, if it has one.
fn trailer(loaded: &BlobModel) -> Option<Trailer> {
    envelope::open(loaded.bytes()).ok()?.trailer
}

/// Describes the parts of the device's standard deviation as JSON; null if the blob contains none.
fn predictive_std(blob: &Blob<'_>) -> Value {
    let mm = |variance: f32| 1e3 * variance.sqrt();
    match (&blob.correction, &blob.variance) {
        (Correction::TaskSpace(task), _) if task.landmarks > 0 => json!({
            "kind": "quadratic form", "landmarks": task.landmarks, "bytes": task.landmark_rows.len()
        }),
        (_, Some(v)) if v.rates.is_empty() => {
            json!({"kind": "constant", "floor_mm": mm(v.floor_m2)})
        }
        (_, Some(v)) => json!({
            "kind": "joint processes", "landmarks": v.landmarks, "bytes": v.rows.len(), "floor_mm": mm(v.floor_m2),
            "noise_mm": mm(v.noise_m2)
        }),
        _ => Value::Null,
    }
}

/// Describes the parts of the device's standard deviation in a sentence.
fn predictive_std_line(blob: &Blob<'_>) -> String {
    let mm = |variance: f32| 1e3 * variance.sqrt();
    match (&blob.correction, &blob.variance) {
        (Correction::TaskSpace(task), _) if task.landmarks > 0 => {
            format!("standard deviation from {} landmarks", task.landmarks)
        }
        (_, Some(v)) if v.rates.is_empty() => {
            format!(
                "standard deviation {:.4} mm, the same for all poses",
                mm(v.floor_m2)
            )
        }
        (_, Some(v)) => format!(
            "standard deviation from {} landmarks: at least {:.4} mm, of which the noise of a measurement is {:.4} mm",
            v.landmarks,
            mm(v.floor_m2),
            mm(v.noise_m2)
        ),
        _ => "no standard deviation".to_owned(),
    }
}

fn print(report: Printer, loaded: &BlobModel, document: &Value) {
    let blob = loaded.blob();
    print_origin(report, loaded, document);
    match blob.ranges.payload_kg {
        Some((light, heavy)) if light == heavy => {
            report.line(format_args!("  trained with a payload of {light} kg"));
        }
        Some((light, heavy)) => {
            report.line(format_args!("  payload trained from {light} to {heavy} kg"));
        }
        None => {}
    }
    match &blob.correction {
        Correction::None => {}
        Correction::TaskSpace(task) => print_task_space(report, loaded, task),
        Correction::Elastic(elastic) => print_elastic(report, loaded, elastic),
    }
    report.line(format_args!("  {}", predictive_std_line(blob)));
    report.line("");
    print_joints(report, blob);
    print_frames(report, loaded);
    let gauge = &loaded.host().gauge;
    let (base, tool) = (source_name(gauge.base), source_name(gauge.tool));
    report.line(format_args!(
        "  base and tool: {}",
        sources(base, tool, gauge.payload_kg.map(f64::from))
    ));
}

/// Prints which arm the model is of, who made it from what, its cost on the device, its warnings and its signature.
fn print_origin(report: Printer, loaded: &BlobModel, document: &Value) {
    let blob = loaded.blob();
    let p = &loaded.host().provenance;
    let text = |key: &str| document[key].as_str().unwrap_or("").to_owned();
    let serial = match blob.robot.serial_number {
        "" => String::new(),
        number => format!(", serial number {number}"),
    };
    report.line(format_args!(
        "{}{serial}: model `{}`",
        blob.robot.name, p.method
    ));
    report.line(format_args!(
        "  {} bytes, format {}, CRC {}; calibrated {} by trainer {} on {} poses{}",
        loaded.bytes().len(),
        FORMAT_VERSION,
        text("crc"),
        text("date"),
        text("trainer_version"),
        p.training_poses,
        match loaded.knows_instrument() {
            true => "",
            false => ", by touches alone",
        }
    ));
    report.line(format_args!("  data SHA-256 {}", text("data_sha256")));
    if trailer(loaded).is_some() {
        report.line(format_args!(
            "  SHA-256 without the signature {}",
            text("unsigned_sha256")
        ));
    }
    let instructions = |what: &str| document["instructions"][what].as_u64().unwrap_or(0);
    report.line(format_args!(
        "  on a Cortex-M4F at most {} instructions for a pose and {} for a command, frames included: {:.2} ms at 168 \
         MHz and 1.75 cycles per instruction",
        instructions("evaluation"),
        instructions("command"),
        instructions("command") as f64 * 1.75 / 168e3
    ));
    for warning in blob.warnings.iter() {
        report.line(format_args!("  warning: {warning}"));
    }
    report.line(match trailer(loaded) {
        Some(trailer) => format!(
            "  signed by key {} as revision {} (not verified: `trainer verify`)",
            id_text(&trailer.key_id),
            trailer.revision
        ),
        None => "  not signed".to_owned(),
    });
}

/// Prints the sizes and hyperparameters of a task-space process.
fn print_task_space(report: Printer, loaded: &BlobModel, task: &TaskSpace<'_>) {
    report.line(format_args!(
        "  correction: Gaussian process of {} inputs, {} inducing points, limited to {:.3} mm and {:.3} mrad",
        task.input_scale.len(),
        loaded.model().inducing_points(),
        1e3 * task.limit.position_m,
        1e3 * task.limit.angle_rad
    ));
    for (i, h) in task.hyperparameters.iter().enumerate() {
        let which = if task.hyperparameters.len() == 1 {
            "all outputs".to_owned()
        } else {
            format!("output {}", i + 1)
        };
        report.line(format_args!(
            "    {which}: θ = {:.4e} {:.4e} {:.4e} {:.4e}, noise {:.4e}",
            h[0], h[1], h[2], h[3], h[4]
        ));
    }
}

/// Prints the parts of an elastic correction.
fn print_elastic(report: Printer, loaded: &BlobModel, elastic: &Elastic<'_>) {
    report.line(format_args!(
        "  correction: elastic joints, {} inducing points; what it adds to the calibrated chain is limited to {:.3} mm and {:.3} mrad",
        loaded.model().inducing_points(),
        1e3 * elastic.limit.position_m,
        1e3 * elastic.limit.angle_rad
    ));
    if !elastic.sets.is_empty() {
        let points = points_of_joints(elastic);
        let points: Vec<String> = points.iter().map(u32::to_string).collect();
        report.line(format_args!(
            "    inducing points of each joint: {}",
            points.join(", ")
        ));
    }
    if let Some((orders, rms)) = curves(elastic, loaded.blob().robot.joints.len()) {
        let rms: Vec<String> = rms.iter().map(|r| format!("{r:.0}")).collect();
        report.line(format_args!(
            "    own-joint curves of {orders} orders: {} µrad RMS over a turn",
            rms.join(", ")
        ));
    }
    for r in &elastic.ripple {
        let amplitude = 1e6 * r.sin.hypot(r.cos);
        report.line(format_args!(
            "    gear ripple of joint {}: {:.1} cycles per turn, {amplitude:.0} µrad",
            r.joint + 1,
            r.cycles
        ));
    }
}

/// Prints base and tools, each as a position with a quaternion.
fn print_frames(report: Printer, loaded: &BlobModel) {
    let gauge = &loaded.host().gauge;
    let mut frames = vec![
        (
            "instrument_from_base".to_owned(),
            Pose::from_rows(&gauge.instrument_from_base),
        ),
        (
            "flange_from_target".to_owned(),
            Pose::from_rows(&gauge.flange_from_target),
        ),
    ];
    let named = tools(loaded);
    if named.len() > 1 {
        frames.pop();
        let named = named.into_iter();
        frames.extend(named.map(|(name, pose)| (format!("flange_from_target of {name}"), pose)));
    }
    for (name, pose) in frames {
        let (w, v) = pose.quaternion();
        let t = 1e3 * pose.translation;
        report.line(format_args!(
            "  {name}: {:.3} {:.3} {:.3} mm, quaternion {w:.6} {:.6} {:.6} {:.6}",
            t[0], t[1], t[2], v[0], v[1], v[2]
        ));
    }
}

fn print_joints(report: Printer, blob: &Blob<'_>) {
    let trust = Trust::<f32>::of(blob);
    let mut rows = Vec::new();
    for (i, (joint, (lower, upper))) in blob
        .robot
        .joints
        .iter()
        .zip(&blob.ranges.joints)
        .enumerate()
    {
        let (unit, factor) = if joint.kind == JointKind::Revolute {
            ("deg", 180.0 / std::f32::consts::PI)
        } else {
            ("mm", 1e3)
        };
        let limits = joint.limits.map_or("none".to_owned(), |(a, b)| {
            format!("{:.1} … {:.1}", a * factor, b * factor)
        });
        let trained = format!("{:.2} … {:.2}", lower * factor, upper * factor);
        rows.push(vec![
            format!("q{}", i + 1),
            unit.to_owned(),
            limits,
            trained,
            format!("{:.1}", trust.half(i).unwrap_or(0.0) * factor),
        ]);
    }
    report.table(
        &["joint", "unit", "limits", "trained", "half trust beyond"],
        &rows,
    );
    report.line("");
}

/// Returns the number of orders of the own-joint curves, and the RMS of each joint's curve over a turn in µrad; `None`
/// without curves.
fn curves(elastic: &Elastic<'_>, joints: usize) -> Option<(usize, Vec<f32>)> {
    let amplitudes: Vec<f32> = elastic
        .curves
        .as_chunks::<4>()
        .0
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect();
    let each = amplitudes.len() / joints.max(1);
    let rms = |curve: &[f32]| 1e6 * (0.5 * curve.iter().map(|x| x * x).sum::<f32>()).sqrt();
    (each > 0).then(|| (each / 2, amplitudes.chunks_exact(each).map(rms).collect()))
}

/// Counts the inducing points of each joint.
fn points_of_joints(elastic: &Elastic<'_>) -> Vec<u32> {
    let sum = |points: &SetPoints| points.iter().map(|points| u32::from(*points)).sum();
    elastic.sets.iter().map(sum).collect()
}
