//! The tables of the feature file, as they are written.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use crate::robot::toml_source::{Exactly, Numbers};

/// The whole file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub version: Spanned<i64>,
    pub noise: Option<NoiseTable>,
    pub prior: Option<PriorTable>,
    #[serde(default)]
    pub target: Vec<Spanned<TargetTable>>,
    #[serde(default)]
    pub feature: Vec<Spanned<FeatureTable>>,
    #[serde(default)]
    pub distance: Vec<Spanned<DistanceTable>>,
    pub camera: Option<Spanned<CameraTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NoiseTable {
    pub touch_mm: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PriorTable {
    pub length_mm: Spanned<f64>,
    pub tilt_mrad: Spanned<f64>,
    pub joint_zero_mrad: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TargetTable {
    pub name: Spanned<String>,
    pub tip_mm: Spanned<Numbers<3>>,
    pub sigma_mm: Option<Spanned<f64>>,
}

/// The keys of all kinds. Which of them a kind may have is checked later, so that the message can name the kind.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FeatureTable {
    pub name: Spanned<String>,
    pub kind: Spanned<String>,
    pub sigma_mm: Option<Spanned<f64>>,
    pub sigma_mrad: Option<Spanned<f64>>,
    pub sigma_px: Option<Spanned<f64>>,
    pub seat_mm: Option<Spanned<f64>>,
    pub flatness_mm: Option<Spanned<f64>>,
    pub radius_mm: Option<Spanned<f64>>,
    pub radius_sigma_mm: Option<Spanned<f64>>,
    pub roundness_mm: Option<Spanned<f64>>,
    pub position_mm: Option<Spanned<Numbers<3>>>,
    pub position_sigma_mm: Option<Spanned<f64>>,
    pub zero_sigma_mm: Option<Spanned<f64>>,
    pub scale_sigma_ppm: Option<Spanned<f64>>,
    pub rotation_vector_rad: Option<Spanned<Numbers<3>>>,
    pub rotation_sigma_mrad: Option<Spanned<f64>>,
    pub corners_x_mm: Option<Spanned<Vec<f64>>>,
    pub corners_y_mm: Option<Spanned<Vec<f64>>>,
    pub corners_mm: Option<Spanned<Vec<Numbers<3>>>>,
}

/// Kinds that the tip touches; `KIND_NAMES` also has those that sensors see.
const TOUCHED: [&str; 4] = ["point", "plane", "sphere", "anchor"];
pub(super) const KIND_NAMES: [&str; 6] = ["point", "plane", "sphere", "anchor", "level", "board"];

/// A key, the kinds that it belongs to, and its position in the text if it is given.
type KeyOfKinds = (&'static str, &'static [&'static str], Option<Range<usize>>);

impl FeatureTable {
    /// Returns all keys except `name` and `kind`.
    pub(super) fn keys(&self) -> [KeyOfKinds; 17] {
        let span = |value: &Option<Spanned<f64>>| value.as_ref().map(Spanned::span);
        let vector = |value: &Option<Spanned<Numbers<3>>>| value.as_ref().map(Spanned::span);
        let list = |value: &Option<Spanned<Vec<f64>>>| value.as_ref().map(Spanned::span);
        let corners = self.corners_mm.as_ref().map(Spanned::span);
        [
            ("sigma_mm", &TOUCHED, span(&self.sigma_mm)),
            ("sigma_mrad", &["level"], span(&self.sigma_mrad)),
            ("sigma_px", &["board"], span(&self.sigma_px)),
            ("seat_mm", &["point"], span(&self.seat_mm)),
            ("flatness_mm", &["plane"], span(&self.flatness_mm)),
            ("radius_mm", &["sphere"], span(&self.radius_mm)),
            ("radius_sigma_mm", &["sphere"], span(&self.radius_sigma_mm)),
            ("roundness_mm", &["sphere"], span(&self.roundness_mm)),
            ("position_mm", &["anchor"], vector(&self.position_mm)),
            (
                "position_sigma_mm",
                &["anchor"],
                span(&self.position_sigma_mm),
            ),
            ("zero_sigma_mm", &["anchor"], span(&self.zero_sigma_mm)),
            (
                "scale_sigma_ppm",
                &["anchor", "board"],
                span(&self.scale_sigma_ppm),
            ),
            (
                "rotation_vector_rad",
                &["level"],
                vector(&self.rotation_vector_rad),
            ),
            (
                "rotation_sigma_mrad",
                &["level"],
                span(&self.rotation_sigma_mrad),
            ),
            ("corners_x_mm", &["board"], list(&self.corners_x_mm)),
            ("corners_y_mm", &["board"], list(&self.corners_y_mm)),
            ("corners_mm", &["board"], corners),
        ]
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DistanceTable {
    pub between: Spanned<Exactly<Spanned<String>, 2>>,
    pub mm: Spanned<f64>,
    pub sigma_mm: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraTable {
    pub focal_px: Spanned<Numbers<2>>,
    pub centre_px: Spanned<Numbers<2>>,
    pub intrinsics_sigma_px: Option<Spanned<f64>>,
    pub mount: Option<Spanned<String>>,
    pub position_mm: Spanned<Numbers<3>>,
    pub position_sigma_mm: Option<Spanned<f64>>,
    pub rotation_vector_rad: Spanned<Numbers<3>>,
    pub rotation_sigma_mrad: Option<Spanned<f64>>,
}
