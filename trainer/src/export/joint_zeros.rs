//! Joint zeros, base and tool, for controllers that take no other frames.

use std::fmt::Write;

use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;
use serde_json::{Value, json};

use crate::export::CalibratedChain;
use crate::export::describe::{against_nominal, distance, distance_json, region, target_of};
use crate::export::format::{decimals, rounded};
use crate::export::tables::{origin, pose, quoted};
use poegp_calibration::blob::commander::pose_distance;
use poegp_calibration::blob::joint_offsets::JointOffsets;

/// Meaning of the numbers, for the comments of a file.
const MEANING: &str =
    "Where the controller shows q, the arm has the pose of the nominal model at q + offset.";

/// Describes what was fitted and how near it is to the model, in lines.
pub fn accuracy(chain: &CalibratedChain, zeros: &JointOffsets) -> Vec<String> {
    let region = region(&chain.distance.region, &chain.joints);
    let mut out = vec![format!(
        "joint zeros, base and tool fitted to the poses of the whole model over {region}"
    )];
    out.extend(against_nominal(&zeros.error, &chain.distance));
    for (what, errors) in [
        ("base and tool alone, fitted", &zeros.base_and_tool),
        ("the whole chain, fitted", &chain.distance.chain),
    ] {
        out.push(format!("of {what}: {}", distance(errors)));
    }
    out
}

/// Describes how far each joint zero, the base and the tool move, in lines.
pub fn moves(chain: &CalibratedChain, zeros: &JointOffsets) -> Vec<String> {
    let own = chain.joints.iter().zip(&zeros.offsets);
    let mut out: Vec<String> = own
        .map(|(joint, offset)| match joint.kind {
            JointKind::Revolute => format!("joint {}: {:.5}°", joint.name, offset.to_degrees()),
            JointKind::Prismatic => format!("joint {}: {:.4} mm", joint.name, 1e3 * offset),
        })
        .collect();
    let moved = |what: &str, from: &Pose<f64>, to: &Pose<f64>| {
        let (apart, turned) = pose_distance(from, to);
        format!(
            "{what}: moved by {:.3} mm and {:.3} mrad",
            1e3 * apart,
            1e3 * turned
        )
    };
    out.push(moved("base", &Pose::identity(), &zeros.base_from_nominal));
    out.push(moved(
        "tool",
        &chain.flange_from_target,
        &zeros.flange_from_target,
    ));
    out
}

/// Returns the file as TOML.
pub fn to_toml(chain: &CalibratedChain, zeros: &JointOffsets) -> String {
    let mut out = String::new();
    let lines = accuracy(chain, zeros).into_iter().chain(target_of(chain));
    for line in chain.provenance.iter().cloned().chain(lines) {
        let _ = writeln!(out, "# {line}");
    }
    let _ = writeln!(
        out,
        "# {MEANING} Metres and radians.\n\nname = {}",
        quoted(&chain.name)
    );
    for (joint, offset) in chain.joints.iter().zip(&zeros.offsets) {
        let _ = writeln!(
            out,
            "\n[[joint]]\nname = {}\n{} = {}",
            quoted(&joint.name),
            key(joint.kind),
            decimals(*offset)
        );
    }
    let _ = writeln!(
        out,
        "\n# The base and the target on the flange that belong to these zeros.\n[calibration]\n\
         flange_from_target = {}\ninstrument_from_base = {}\nbase_from_nominal = {}",
        origin(&zeros.flange_from_target),
        origin(&(chain.instrument_from_base * zeros.base_from_nominal)),
        origin(&zeros.base_from_nominal)
    );
    out
}

/// Returns joint zeros, base and tool as JSON.
pub fn to_json(chain: &CalibratedChain, zeros: &JointOffsets) -> Value {
    let joints = chain.joints.iter().zip(&zeros.offsets);
    let joints = joints.map(|(joint, offset)| {
        let mut out = json!({"name": joint.name});
        out[key(joint.kind)] = json!(rounded(*offset));
        out
    });
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "name": chain.name,
        "provenance": chain.provenance,
        "meaning": MEANING,
        "distance": distances(chain, zeros),
        "joints": joints.collect::<Vec<_>>(),
        "flange_from_target": pose(&zeros.flange_from_target),
        "instrument_from_base": pose(&(chain.instrument_from_base * zeros.base_from_nominal)),
        "base_from_nominal": pose(&zeros.base_from_nominal),
    })
}

/// Returns the distances from the model as JSON, beside those of the whole chain and of the nominal model.
pub fn distances(chain: &CalibratedChain, zeros: &JointOffsets) -> Value {
    let mut out = distance_json(chain);
    out["joint_offsets"] = json!(zeros.error);
    out["base_and_tool"] = json!(zeros.base_and_tool);
    out
}

fn key(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Revolute => "offset_rad",
        JointKind::Prismatic => "offset_m",
    }
}
