//! Describes an export in the command's output, in the comments of each file and in JSON.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::Pose;
use serde_json::{Value, json};

use crate::export::CalibratedChain;
use crate::export::calibrated_chain::Distance;
use poegp_calibration::blob::region::Region;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::robot::normal_form::roll_pitch_yaw;
use poegp_calibration::robot::{Joint, in_file_units};

/// Describes how near a chain is to the model, in lines.
pub fn accuracy(chain: &CalibratedChain) -> Vec<String> {
    let region = region(&chain.distance.region, &chain.joints);
    let first = match &chain.fit {
        Some(_) => format!("frames fitted to the poses of the whole model over {region}"),
        None => format!("the frames of the whole model, compared over {region}"),
    };
    let mut out = vec![first];
    out.extend(against_nominal(&chain.distance.chain, &chain.distance));
    out.extend(chain.fit.as_ref().map(|fit| {
        let of = distance(&fit.before);
        format!("of the frames inside the model: {of}")
    }));
    out
}

/// Describes distances from the model, beside those of the nominal model.
pub(super) fn against_nominal(error: &ErrorSummary, distance: &Distance) -> [String; 2] {
    let (own, nominal) = (self::distance(error), self::distance(&distance.nominal));
    [
        format!("{own}, at {} other poses", error.poses),
        format!("of the nominal model with the model's base and tool: {nominal}"),
    ]
}

/// Returns the lines at the beginning of an exported text that leaves these parts of the model out.
pub(super) fn comments(chain: &CalibratedChain, left_out: &[String]) -> Vec<String> {
    let mut out = chain.provenance.clone();
    out.extend(accuracy(chain));
    if !left_out.is_empty() {
        out.push(format!("not in this file: {}", left_out.join("; ")));
    }
    out.extend(target_of(chain));
    out
}

/// Says whose target a file has, if the model has several, and whether its orientation is known.
pub fn target_of(chain: &CalibratedChain) -> Vec<String> {
    let others = chain.other_tools.join(", ");
    let mut out = Vec::new();
    if !others.is_empty() {
        out.push(format!(
            "the target is that of the first tool; not that of {others}"
        ));
    }
    if chain.tool == FrameSource::Positions {
        out.push(
            "positions alone were measured: the orientation of the target is not known".to_owned(),
        );
    }
    out
}

/// Describes distances from the model.
pub fn distance(errors: &ErrorSummary) -> String {
    let mm = &errors.position_mm;
    format!(
        "distance {:.3} mm on average, 95 % within {:.3} mm, largest {:.3} mm",
        mm.mean, mm.p95, mm.max
    )
}

/// Describes a region of the arm with these joints.
pub fn region(region: &Region, joints: &[Joint]) -> String {
    let is_revolute = |joint: &Joint| joint.kind == JointKind::Revolute;
    let reach = |near: f64| match joints.iter().all(is_revolute) {
        true => format!("{near}°"),
        false => format!("{near}° or {near} mm"),
    };
    let about = match &region.near {
        None => "the trained joint ranges".to_owned(),
        Some(near) => match &near.poses[..] {
            [only] => format!(
                "joints within {} of {}",
                reach(near.reach),
                pose(only, joints)
            ),
            all => format!(
                "joints within {} of one of {} poses",
                reach(near.reach),
                all.len()
            ),
        },
    };
    let limited = region.limited.iter();
    let limited: Vec<String> = limited
        .map(|(i, range)| format!("joint {} to {}", i + 1, span(*range, joints[*i].kind)))
        .collect();
    let limited = match &limited[..] {
        [] => String::new(),
        all => format!(", limited to the trained ranges ({})", all.join(", ")),
    };
    let payload = match region.payload_kg {
        Some((light, heavy)) if light < heavy => format!(", payload {light} to {heavy} kg"),
        Some((only, _)) => format!(", payload {only} kg"),
        None => String::new(),
    };
    about + &limited + &payload
}

/// Formats a range of a joint in degrees or millimetres, as in `-30…45.5°`.
fn span((lower, upper): (f64, f64), kind: JointKind) -> String {
    let [lower, upper] = [lower, upper].map(|value| short(in_file_units(kind, value)));
    match kind {
        JointKind::Revolute => format!("{lower}…{upper}°"),
        JointKind::Prismatic => format!("{lower}…{upper} mm"),
    }
}

/// Formats joint values in degrees and millimetres.
fn pose(values: &[f64], joints: &[Joint]) -> String {
    let text = |(value, joint): (&f64, &Joint)| match joint.kind {
        JointKind::Revolute => format!("{}°", short(value.to_degrees())),
        JointKind::Prismatic => format!("{} mm", short(1e3 * value)),
    };
    let texts: Vec<String> = values.iter().zip(joints).map(text).collect();
    texts.join(" ")
}

/// Rounds a number to four decimals; it prints without trailing zeros.
fn short(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}

/// Returns the distances from the model as JSON.
pub fn distance_json(chain: &CalibratedChain) -> Value {
    let distance = &chain.distance;
    json!({
        "region": region(&distance.region, &chain.joints),
        "payload_kg": distance.region.payload_kg.map(|(light, heavy)| [light, heavy]),
        "chain": distance.chain,
        "nominal": distance.nominal,
    })
}

/// Describes a pose: position in millimetres; roll, pitch and yaw in degrees.
pub fn describe(pose: &Pose<f64>) -> String {
    let t: Vector3<f64> = 1e3 * pose.translation;
    let rpy = roll_pitch_yaw(&pose.rotation).map(f64::to_degrees);
    format!(
        "{:.4} {:.4} {:.4} mm, roll pitch yaw {:.5} {:.5} {:.5}°",
        t[0], t[1], t[2], rpy[0], rpy[1], rpy[2]
    )
}
