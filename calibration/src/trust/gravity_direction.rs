//! Finds gravity that points elsewhere than stated: an arm on a wall, or tilted.
//!
//! The deflections by a mass at the target along two directions across the stated one are added to the geometry. Where they
//! explain much, the geometry is fitted again with gravity along other directions, and the best of them is named.

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::elastic::gravity::GravityRegressors;
use poegp_runtime::kinematics::coupling::PerJoint;

use crate::identification::alignment::Alignment;
use crate::measurement::sample::BaseSample;
use crate::trust::added_terms::AddedTerms;
use crate::trust::change_points::needed;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::payloads::Lift;
use crate::trust::readings::Data;
use crate::trust::wording::length;

/// Share of χ² that gravity across the stated direction must explain, beyond what it explains of noise, to be tried.
const EXPLAINED: f64 = 0.2;
/// Ratios of the scatter with another direction to that with the stated one, below which it is named and refused.
const LEFT: (f64, f64) = (0.7, 0.4);
/// Angles in rad by which a direction is improved, one after the other.
const TURNS: [f64; 4] = [0.5, 0.2, 0.08, 0.03];
/// Most turns by one of them.
const STEPS: usize = 3;
/// Cosine above which a direction is that of an axis.
const ALONG: f64 = 0.995;

/// Returns another direction of gravity that explains more than the one of `geometry`, in m/s², and the finding that says so.
pub fn examine(
    data: &Data<'_>,
    geometry: &Geometry,
    alignment: &Alignment,
) -> Option<(Vector3<f64>, Finding)> {
    let stated = geometry.state.gravity.gravity;
    let size = stated.norm();
    if !geometry.terms().0 || size <= 0.0 || !is_suspected(geometry, stated) {
        return None;
    }
    let scatter = |g: &Geometry| g.scales.position * g.noise_factor();
    let with = |towards: Vector3<f64>| -> f64 {
        let fit = Geometry::fit(data, alignment, Priors::Made, size * towards);
        fit.as_ref().map_or(f64::INFINITY, scatter)
    };
    let (first, second) = across(stated);
    let mut best = (scatter(geometry), stated / size);
    let mut improve = |tried: &[Vector3<f64>]| {
        let tried = tried.iter().map(|towards| (with(*towards), *towards));
        let found = tried.min_by(|a, b| a.0.total_cmp(&b.0));
        best = found.filter(|found| found.0 < best.0).unwrap_or(best);
        best.1
    };
    improve(&[first, -first, second, -second]);
    for angle in TURNS {
        for _ in 0..STEPS {
            let at = improve(&[]);
            let (first, second) = across(at);
            let turned = |by: Vector3<f64>| (at + by * libm::tan(angle)).normalize();
            if improve(&[first, -first, second, -second].map(turned)) == at {
                break;
            }
        }
    }
    let (left, mut towards) = best;
    let ratio = left / scatter(geometry);
    if ratio > LEFT.0 {
        return None;
    }
    // The terms of gravity have either sign, so that its reverse leaves as little.
    let fit = Geometry::fit(data, alignment, Priors::Made, size * towards)?;
    if Lift::of(&fit).map_or_else(|| !yields(&fit), |of| of.lift > 0.0) {
        towards = -towards;
    }
    let (name, option) = named(towards);
    let text = format!(
        "gravity looks as if it pointed along {name} of the base: that would leave {} of scatter instead of {}; if the arm is \
         mounted so, give --gravity {option}",
        length(left),
        length(scatter(geometry))
    );
    let tier = Tier::refused_if(ratio < LEFT.1);
    let finding = Finding::new(Cause::Payload, tier, text, ratio, LEFT.0);
    Some((size * towards, finding))
}

/// Returns the name of a direction, an axis or its components, and what --gravity takes for it, in m/s².
fn named(towards: Vector3<f64>) -> (String, String) {
    let axis = towards.iamax();
    if towards[axis].abs() > ALONG {
        let mut components = ["0", "0", "0"];
        let (sign, g) = match towards[axis] > 0.0 {
            true => ("+", "9.81"),
            false => ("-", "-9.81"),
        };
        components[axis] = g;
        return (
            format!("{sign}{}", ["x", "y", "z"][axis]),
            components.join(","),
        );
    }
    let components = towards.map(|of| format!("{:.1}", 9.81 * of));
    let all = components.as_slice();
    (format!("({})", all.join(", ")), all.join(","))
}

/// Returns two directions across this one and across each other.
fn across(direction: Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    let direction = direction.normalize();
    let first = (axis - direction * direction.dot(&axis)).normalize();
    (first, direction.cross(&first))
}

/// Returns for each sample the torques about all joints by 1 kg at the target.
fn torques(geometry: &Geometry, gravity: Vector3<f64>) -> Vec<PerJoint<f64>> {
    let state = &geometry.state;
    let of = |sample: &BaseSample| {
        let chain = state.chain(sample.tool);
        let motions = chain.motions(&sample.serial_joints);
        let (frames, target) = chain.joint_frames_with(&motions);
        let at = GravityRegressors::new(state.kinds(), &frames, &target, &gravity);
        let mut out = [0.0; MAX_JOINTS];
        for (c, torque) in out.iter_mut().enumerate().take(state.layout.joints) {
            *torque = at.payload(c).0;
        }
        out
    };
    geometry.samples.iter().map(of).collect()
}

/// Returns whether the joints of a fit yield to the torques of gravity: with its reverse, they turn against them.
fn yields(geometry: &Geometry) -> bool {
    let state = &geometry.state;
    let torques = torques(geometry, state.gravity.gravity);
    let turned = geometry.samples.iter().map(|sample| {
        let chain = state.chain(sample.tool);
        let motions = chain.motions(&sample.serial_joints);
        let (frames, target) = chain.joint_frames_with(&motions);
        let gravity = &state.gravity;
        let at = GravityRegressors::new(state.kinds(), &frames, &target, &gravity.gravity);
        gravity.deflection(&at, sample.payload_kg.unwrap_or(0.0))
    });
    let turned: Vec<PerJoint<f64>> = turned.collect();
    let count = turned.len() as f64;
    let of = |joint: usize| {
        let mean = turned.iter().map(|t| t[joint]).sum::<f64>() / count;
        let rows = turned.iter().zip(&torques).zip(&geometry.samples);
        rows.map(|((turned, torque), sample)| {
            (turned[joint] - mean) * torque[joint] * (1.0 + sample.payload_kg.unwrap_or(0.0))
        })
        .sum::<f64>()
    };
    (0..state.layout.joints).map(of).sum::<f64>() > 0.0
}

/// Returns whether deflections by gravity across the stated direction explain much of χ².
fn is_suspected(geometry: &Geometry, stated: Vector3<f64>) -> bool {
    let joints = geometry.state.layout.joints;
    let (first, second) = across(stated);
    let (first, second) = (torques(geometry, first), torques(geometry, second));
    let torque = |k: usize, of: usize| match of < joints {
        true => first[k][of],
        false => second[k][of - joints],
    };
    let loads = |k: usize| [1.0, geometry.samples[k].payload_kg.unwrap_or(0.0)];
    let is_loaded = (0..geometry.samples.len()).any(|k| loads(k)[1] > 0.0);
    let terms = 2 * joints * if is_loaded { 2 } else { 1 };
    let rows = 0..geometry.samples.len();
    let sums = AddedTerms::over(geometry, terms, rows.clone(), |k, row, term| {
        let of = term % (2 * joints);
        let load = loads(k)[term / (2 * joints)];
        load * torque(k, of) * geometry.linear.jacobian[(row, of % joints)]
    });
    let Some(optimum) = sums.optimum(geometry) else {
        return false;
    };
    let drop: f64 = optimum.drops.iter().sum();
    let chance = terms as f64 / geometry.equations() as f64;
    let share = drop / geometry.chi_squared(rows);
    drop / geometry.noise_factor().powi(2) > needed(geometry)
        && share > chance + EXPLAINED * (1.0 - chance)
}
