//! The tables of the file of features, as they are written.

use serde::Deserialize;
use toml::Spanned;

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
    pub tip_mm: Spanned<[f64; 3]>,
    pub sigma_mm: Option<Spanned<f64>>,
}

/// The keys of all kinds: which of them belong is checked afterwards, so that the message can name the kind.
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
    pub position_mm: Option<Spanned<[f64; 3]>>,
    pub position_sigma_mm: Option<Spanned<f64>>,
    pub zero_sigma_mm: Option<Spanned<f64>>,
    pub scale_sigma_ppm: Option<Spanned<f64>>,
    pub rotation_vector_rad: Option<Spanned<[f64; 3]>>,
    pub rotation_sigma_mrad: Option<Spanned<f64>>,
    pub corners_x_mm: Option<Spanned<Vec<f64>>>,
    pub corners_y_mm: Option<Spanned<Vec<f64>>>,
    pub corners_mm: Option<Spanned<Vec<[f64; 3]>>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DistanceTable {
    pub between: Spanned<[Spanned<String>; 2]>,
    pub mm: Spanned<f64>,
    pub sigma_mm: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraTable {
    pub focal_px: Spanned<[f64; 2]>,
    pub centre_px: Spanned<[f64; 2]>,
    pub intrinsics_sigma_px: Option<Spanned<f64>>,
    pub mount: Option<Spanned<String>>,
    pub position_mm: Spanned<[f64; 3]>,
    pub position_sigma_mm: Option<Spanned<f64>>,
    pub rotation_vector_rad: Spanned<[f64; 3]>,
    pub rotation_sigma_mrad: Option<Spanned<f64>>,
}
