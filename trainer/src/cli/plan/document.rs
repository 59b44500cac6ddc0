//! The JSON document that `trainer plan --json` writes.

use serde::Serialize;

use crate::cli::inputs::Arm;
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::planning::forecast::Row;
use poegp_calibration::planning::links::RadiusSource;
use poegp_calibration::planning::sister::Sister;
use poegp_calibration::planning::{self, Planner};

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct PlanJson {
    pub version: &'static str,
    pub robot: String,
    pub poses: usize,
    pub test_poses: usize,
    pub strategy: &'static str,
    pub payloads_kg: Vec<f64>,
    pub seed: u64,
    pub configurations: Configurations,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorJson>,
    pub links: Links,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub floor_mm: Option<f64>,
    pub travel: f64,
    pub forecast: Option<Forecast>,
}

/// Standard deviations from the model of `--prior`. Those of deflections are the usual ones unless the model is elastic.
#[derive(Serialize)]
pub struct PriorJson {
    pub elastic: bool,
    pub frames_mm: f64,
    pub frames_mrad: f64,
    links_urad_s2_per_m: f64,
    pub payload_urad_per_n: f64,
    pub waves: usize,
}

/// The capsules that represent the arm's links.
#[derive(Serialize)]
pub struct Links {
    /// Radii of the links from the base to the target, mm.
    pub radii_mm: Vec<f64>,
    pub radius_from: &'static str,
}

#[derive(Serialize)]
pub struct Configurations {
    pub drawn: usize,
    pub allowed: usize,
    pub removed: Vec<Removed>,
}

#[derive(Serialize)]
pub struct Removed {
    pub constraint: String,
    /// Number of configurations that this constraint forbids.
    pub configurations: usize,
    /// Number of configurations that only this constraint forbids.
    pub alone: usize,
}

#[derive(Serialize)]
pub struct Forecast {
    pub position_noise_mm: f64,
    pub orientation_noise_mrad: f64,
    pub seconds: f64,
    pub rows: Vec<Row>,
}

pub fn document(
    seed: u64,
    arm: &Arm,
    plan: &planning::Plan,
    planner: &Planner,
    constraints: &Constraints,
    sister: Option<&Sister>,
    forecast: Option<Forecast>,
) -> PlanJson {
    let candidates = planner.candidates();
    let refusals = &candidates.refusals;
    let millimetres = |metres: f64| (1e6 * metres).round() / 1e3;
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
        seed,
        configurations: Configurations {
            drawn: candidates.drawn,
            allowed: candidates.joints.len(),
            removed: (0..)
                .zip(&constraints.rules)
                .map(|(i, rule)| Removed {
                    constraint: rule.name(),
                    configurations: refusals.forbidden_by(i),
                    alone: refusals.freed_by(&[i]),
                })
                .collect(),
        },
        prior: sister.map(|sister| {
            let prior = &sister.prior;
            PriorJson {
                elastic: sister.is_elastic,
                frames_mm: millimetres(prior.frames.0),
                frames_mrad: millimetres(prior.frames.1),
                links_urad_s2_per_m: millimetres(1e3 * prior.links),
                payload_urad_per_n: millimetres(1e3 * prior.payload),
                waves: prior.waves.len(),
            }
        }),
        links: Links {
            radii_mm: constraints
                .links
                .radii()
                .iter()
                .map(|r| millimetres(*r))
                .collect(),
            radius_from: match constraints.links.source() {
                RadiusSource::Constraints => "constraints",
                RadiusSource::Description => "description",
                RadiusSource::Reach => "reach",
            },
        },
        floor_mm: constraints.floor().map(millimetres),
        travel: plan.travel,
        forecast,
    }
}
