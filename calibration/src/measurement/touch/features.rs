//! Reads the TOML file that describes what was touched.
//!
//! `docs/reference/touch-file.md` documents every key. Lengths are in millimetres and small angles in milliradians: the unit
//! is part of the key, and unknown keys are refused.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use poegp_runtime::math::se3::{Pose, Twist};
use toml::Spanned;

use crate::input_error::{InputError, number};
use crate::measurement::table::quoted;
use crate::measurement::touch::set::{Board, Camera, Feature, FeatureKind, KnownDistance, Mount};
use crate::measurement::touch::tables::{
    CameraTable, DistanceTable, FeatureTable, File, KIND_NAMES,
};
use crate::robot::ClassPrior;
use crate::robot::toml_source::Numbers;
use crate::robot::toml_source::TomlSource;

/// Name of the file in messages.
pub(super) const WHOLE: &str = "a description of touched features in TOML";
/// Supported version of the format.
const VERSION: i64 = 1;
/// List of the kinds, for messages.
const KINDS: &str = "\"point\", \"plane\", \"sphere\", \"anchor\", \"level\" or \"board\"";

/// Default noise of one component of a touch, in m.
const TOUCH_SIGMA: f64 = 0.05e-3;
/// Default noise of a level, in rad.
const LEVEL_SIGMA: f64 = 0.05e-3;
/// Default noise of a corner in an image, in pixels.
const PIXEL_SIGMA: f64 = 0.2;
/// Default standard deviation of a tip about its nominal position, in m.
const TIP_SIGMA: f64 = 5e-3;
/// Default standard deviation of the position of an anchor or a camera, as measured with a tape, in m.
const TAPE_SIGMA: f64 = 20e-3;
/// Default standard deviation of the rotation of a level or a camera about the nominal one, in rad.
const MOUNTING_SIGMA: f64 = 50e-3;
/// Default standard deviation of the zero of a wire, in m.
const ZERO_SIGMA: f64 = 1e-3;
/// Default standard deviation of a radius or a distance, in m.
const LENGTH_SIGMA: f64 = 0.02e-3;
/// Shortest radius or distance that calibrates an arm, in m: smaller numbers are metres in a key of millimetres.
const SHORTEST: f64 = 1e-3;
/// Smallest number of corners that determines the pose of a board.
const LEAST_CORNERS: usize = 4;

/// The content of the file.
pub(super) struct Description {
    pub path: PathBuf,
    pub features: Vec<Feature>,
    pub targets: Vec<NominalTip>,
    pub distances: Vec<KnownDistance>,
    pub prior: Option<ClassPrior>,
    pub camera: Option<Camera>,
}

/// A `[[target]]` table.
pub(super) struct NominalTip {
    pub name: String,
    pub position: Vector3<f64>,
    pub sigma: f64,
}

/// Parses the text of a file; `path` is for messages.
pub(super) fn parse(path: &Path, text: &str) -> Result<Description, InputError> {
    let source = Source(TomlSource { file: path, text });
    let file: File = toml::from_str(text).map_err(|error| source.0.refused(&error, WHOLE))?;
    if *file.version.get_ref() != VERSION {
        let found = file.version.get_ref().to_string();
        let expected = format!("{VERSION}, the version of this format");
        return Err(source
            .0
            .error(file.version.span(), "version", found, expected));
    }
    let touch_sigma = match &file.noise {
        Some(noise) => source.above_zero("touch_mm", &noise.touch_mm, 1e-3)?,
        None => TOUCH_SIGMA,
    };
    let mut features: Vec<Feature> = Vec::with_capacity(file.feature.len());
    for table in &file.feature {
        let feature = source.feature(table, touch_sigma)?;
        if features.iter().any(|other| other.name == feature.name) {
            let found = format!("a second feature named {}", quoted(&feature.name));
            let expected = "a name of its own for every feature";
            return Err(source
                .0
                .error(table.get_ref().name.span(), "name", found, expected));
        }
        features.push(feature);
    }
    if features.is_empty() {
        return Err(InputError::new(
            path,
            "no [[feature]]",
            "a [[feature]] table for everything that was touched",
        ));
    }
    let mut targets: Vec<NominalTip> = Vec::with_capacity(file.target.len());
    for table in &file.target {
        let table = table.get_ref();
        let name = source.name(&table.name)?;
        if targets.iter().any(|other| other.name == name) {
            let found = format!("a second target named {}", quoted(&name));
            let expected = "a name of its own for every target";
            return Err(source.0.error(table.name.span(), "name", found, expected));
        }
        targets.push(NominalTip {
            name,
            position: source.vector("tip_mm", &table.tip_mm, 1e-3)?,
            sigma: source.sigma("sigma_mm", &table.sigma_mm, 1e-3, TIP_SIGMA)?,
        });
    }
    let distances = file
        .distance
        .iter()
        .map(|table| source.distance(table, &features))
        .collect::<Result<_, _>>()?;
    let prior = match &file.prior {
        Some(prior) => Some(ClassPrior {
            length: source.above_zero("length_mm", &prior.length_mm, 1e-3)?,
            tilt: source.above_zero("tilt_mrad", &prior.tilt_mrad, 1e-3)?,
            joint_zero: source.above_zero("joint_zero_mrad", &prior.joint_zero_mrad, 1e-3)?,
        }),
        None => None,
    };
    let camera = match &file.camera {
        Some(camera) => Some(source.camera(camera.get_ref())?),
        None => None,
    };
    let board = features
        .iter()
        .position(|f| matches!(f.kind, FeatureKind::Board(_)));
    match (board, &file.camera) {
        (Some(board), None) => {
            let span = file.feature[board].get_ref().kind.span();
            let expected = "a table [camera] beside a feature of kind \"board\"";
            Err(source
                .0
                .error(span, "kind", "a board without [camera]", expected))
        }
        (None, Some(camera)) => {
            let expected = "a feature of kind \"board\" beside [camera]";
            Err(source.0.error(
                camera.span(),
                "camera",
                "[camera] without a board",
                expected,
            ))
        }
        _ => Ok(Description {
            path: path.to_path_buf(),
            features,
            targets,
            distances,
            prior,
            camera,
        }),
    }
}

/// Reader of values and creator of their refusals.
struct Source<'a>(TomlSource<'a>);

impl Source<'_> {
    fn name(&self, name: &Spanned<String>) -> Result<String, InputError> {
        match name.get_ref().trim() {
            "" => Err(self.0.error(name.span(), "name", "an empty name", "a name")),
            trimmed => Ok(trimmed.to_owned()),
        }
    }

    fn refuse<T>(
        &self,
        key: &str,
        value: &Spanned<T>,
        found: impl Into<String>,
        expected: &str,
    ) -> InputError {
        self.0.error(value.span(), key, found, expected)
    }

    /// Reads a number above 0, times `unit`.
    fn above_zero(&self, key: &str, value: &Spanned<f64>, unit: f64) -> Result<f64, InputError> {
        let given = *value.get_ref();
        if given > 0.0 && given.is_finite() {
            return Ok(given * unit);
        }
        Err(self.refuse(key, value, number(given), "a number above 0"))
    }

    /// Reads a standard deviation above 0; `usual` if none is given.
    fn sigma(
        &self,
        key: &str,
        value: &Option<Spanned<f64>>,
        unit: f64,
        usual: f64,
    ) -> Result<f64, InputError> {
        match value {
            Some(value) => self.above_zero(key, value, unit),
            None => Ok(usual),
        }
    }

    /// Reads the size of an error: 0 or more, and 0 if none is given.
    fn form(&self, key: &str, value: &Option<Spanned<f64>>, unit: f64) -> Result<f64, InputError> {
        let Some(value) = value else { return Ok(0.0) };
        let given = *value.get_ref();
        if given >= 0.0 && given.is_finite() {
            return Ok(given * unit);
        }
        Err(self.refuse(key, value, number(given), "a number of 0 or more"))
    }

    /// Reads a length of at least a millimetre.
    fn length(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let length = self.above_zero(key, value, 1e-3)?;
        if length >= SHORTEST {
            return Ok(length);
        }
        let found = format!("{} mm", value.get_ref());
        let error = self.refuse(key, value, found, "a length of 1 mm or more");
        Err(error.with_help("are these metres? The key is in millimetres"))
    }

    fn vector(
        &self,
        key: &str,
        value: &Spanned<Numbers<3>>,
        unit: f64,
    ) -> Result<Vector3<f64>, InputError> {
        match value.get_ref().iter().find(|number| !number.is_finite()) {
            Some(bad) => Err(self.refuse(key, value, number(*bad), "finite numbers")),
            None => Ok(Vector3::from(value.get_ref().0) * unit),
        }
    }

    fn feature(
        &self,
        table: &Spanned<FeatureTable>,
        touch_sigma: f64,
    ) -> Result<Feature, InputError> {
        let t = table.get_ref();
        self.only_keys_of_kind(t)?;
        let touch = || self.sigma("sigma_mm", &t.sigma_mm, 1e-3, touch_sigma);
        let ppm = || self.form("scale_sigma_ppm", &t.scale_sigma_ppm, 1e-6);
        let (kind, sigma) = match t.kind.get_ref().as_str() {
            "point" => {
                let seat = self.form("seat_mm", &t.seat_mm, 1e-3)?;
                (FeatureKind::Point { seat }, touch()?)
            }
            "plane" => {
                let flatness = self.form("flatness_mm", &t.flatness_mm, 1e-3)?;
                (FeatureKind::Plane { flatness }, touch()?)
            }
            "sphere" => {
                let radius = t.radius_mm.as_ref();
                if let (None, Some(sigma)) = (radius, &t.radius_sigma_mm) {
                    let found = "radius_sigma_mm without radius_mm";
                    return Err(self.refuse("radius_sigma_mm", sigma, found, "both, or neither"));
                }
                let kind = FeatureKind::Sphere {
                    radius: radius.map(|r| self.length("radius_mm", r)).transpose()?,
                    radius_sigma: self.sigma(
                        "radius_sigma_mm",
                        &t.radius_sigma_mm,
                        1e-3,
                        LENGTH_SIGMA,
                    )?,
                    roundness: self.form("roundness_mm", &t.roundness_mm, 1e-3)?,
                };
                (kind, touch()?)
            }
            "anchor" => {
                let position = t.position_mm.as_ref();
                if let (None, Some(sigma)) = (position, &t.position_sigma_mm) {
                    let found = "position_sigma_mm without position_mm";
                    return Err(self.refuse("position_sigma_mm", sigma, found, "both, or neither"));
                }
                let position = position.map(|p| self.vector("position_mm", p, 1e-3));
                let sigma = &t.position_sigma_mm;
                let zero = &t.zero_sigma_mm;
                let kind = FeatureKind::Anchor {
                    position: position.transpose()?,
                    position_sigma: self.sigma("position_sigma_mm", sigma, 1e-3, TAPE_SIGMA)?,
                    zero_sigma: match zero {
                        Some(_) => self.form("zero_sigma_mm", zero, 1e-3)?,
                        None => ZERO_SIGMA,
                    },
                    scale_sigma: ppm()?,
                };
                (kind, touch()?)
            }
            "level" => {
                let rotation = t.rotation_vector_rad.as_ref();
                let rotation = rotation.map(|r| self.vector("rotation_vector_rad", r, 1.0));
                let sigma = &t.rotation_sigma_mrad;
                let kind = FeatureKind::Level {
                    rotation: rotation.transpose()?.unwrap_or_else(Vector3::zeros),
                    rotation_sigma: self.sigma(
                        "rotation_sigma_mrad",
                        sigma,
                        1e-3,
                        MOUNTING_SIGMA,
                    )?,
                };
                (
                    kind,
                    self.sigma("sigma_mrad", &t.sigma_mrad, 1e-3, LEVEL_SIGMA)?,
                )
            }
            "board" => {
                let board = Board {
                    corners: self.corners(table)?,
                    scale_sigma: ppm()?,
                };
                let sigma = self.sigma("sigma_px", &t.sigma_px, 1.0, PIXEL_SIGMA)?;
                (FeatureKind::Board(board), sigma)
            }
            other => return Err(self.refuse("kind", &t.kind, quoted(other), KINDS)),
        };
        Ok(Feature {
            name: self.name(&t.name)?,
            line: self.0.line_and_column(table.span().start).0,
            kind,
            sigma,
        })
    }

    /// Refuses a key that has no meaning for the feature's kind: its value would be ignored.
    fn only_keys_of_kind(&self, t: &FeatureTable) -> Result<(), InputError> {
        let kind = t.kind.get_ref().as_str();
        if !KIND_NAMES.contains(&kind) {
            return Err(self.refuse("kind", &t.kind, quoted(kind), KINDS));
        }
        for (key, kinds, span) in t.keys() {
            if let Some(span) = span
                && !kinds.contains(&kind)
            {
                let found = format!("{key} of a feature of kind \"{kind}\"");
                let expected = format!("this key for {} only", kinds.join(", "));
                return Err(self.0.error(span, key, found, expected));
            }
        }
        Ok(())
    }

    /// Reads the corners of a board: those of a grid, with index x·count_of_y + y, or each by itself.
    fn corners(&self, table: &Spanned<FeatureTable>) -> Result<Vec<Vector3<f64>>, InputError> {
        let t = table.get_ref();
        let grid = (&t.corners_x_mm, &t.corners_y_mm, &t.corners_mm);
        let (corners, span, key) = match grid {
            (Some(x), Some(y), None) => {
                let corner = |x: &f64, y: &f64| Vector3::new(*x, *y, 0.0) * 1e-3;
                let column = |x| y.get_ref().iter().map(move |y| corner(x, y));
                let corners: Vec<_> = x.get_ref().iter().flat_map(column).collect();
                (corners, x.span(), "corners_x_mm")
            }
            (None, None, Some(all)) => {
                let corner = |c: &Numbers<3>| Vector3::from(c.0) * 1e-3;
                let corners = all.get_ref().iter().map(corner).collect();
                (corners, all.span(), "corners_mm")
            }
            _ => {
                let expected = "corners_x_mm and corners_y_mm of a grid, or corners_mm";
                let found = format!("no corners of board {}", quoted(t.name.get_ref()));
                return Err(self.refuse("name", &t.name, found, expected));
            }
        };
        let finite = corners.iter().all(|c| c.iter().all(|x| x.is_finite()));
        let farthest = corners.iter().fold(0.0_f64, |far, c| far.max(c.amax()));
        let found = if !finite {
            "a number that is not finite".to_owned()
        } else if corners.len() < LEAST_CORNERS {
            format!("{} corners", corners.len())
        } else if on_a_line(&corners) {
            "corners that are all on one line".to_owned()
        } else if farthest < SHORTEST {
            format!("corners within {} mm", farthest * 1e3)
        } else {
            return Ok(corners);
        };
        let expected = "four corners or more that are not on one line, in millimetres";
        Err(self.0.error(span, key, found, expected))
    }

    fn distance(
        &self,
        table: &Spanned<DistanceTable>,
        features: &[Feature],
    ) -> Result<KnownDistance, InputError> {
        let t = table.get_ref();
        let mut between = [0; 2];
        for (index, name) in between.iter_mut().zip(t.between.get_ref().iter()) {
            let found = quoted(name.get_ref());
            let feature = features
                .iter()
                .position(|f| f.name == name.get_ref().trim());
            let Some(feature) = feature else {
                return Err(self.refuse("between", name, found, "the name of a [[feature]]"));
            };
            let kind = &features[feature].kind;
            if !matches!(kind, FeatureKind::Point { .. } | FeatureKind::Sphere { .. }) {
                let found = format!("{found}, of kind \"{}\"", kind.name());
                let expected = "a point, or a sphere for its centre";
                return Err(self.refuse("between", name, found, expected));
            }
            *index = feature;
        }
        if between[0] == between[1] {
            let found = format!("{} twice", quoted(&features[between[0]].name));
            return Err(self.refuse("between", &t.between, found, "two different features"));
        }
        Ok(KnownDistance {
            between,
            distance: self.length("mm", &t.mm)?,
            sigma: self.sigma("sigma_mm", &t.sigma_mm, 1e-3, LENGTH_SIGMA)?,
            line: self.0.line_and_column(table.span().start).0,
        })
    }

    fn camera(&self, t: &CameraTable) -> Result<Camera, InputError> {
        if let Some(bad) = t
            .focal_px
            .get_ref()
            .iter()
            .find(|f| !(f.is_finite() && **f > 0.0))
        {
            let expected = "focal lengths above 0 in pixels";
            return Err(self.refuse("focal_px", &t.focal_px, number(*bad), expected));
        }
        if let Some(bad) = t.centre_px.get_ref().iter().find(|c| !c.is_finite()) {
            return Err(self.refuse("centre_px", &t.centre_px, number(*bad), "finite numbers"));
        }
        let mount = match t.mount.as_ref().map(|m| (m, m.get_ref().as_str())) {
            None | Some((_, "flange")) => Mount::Flange,
            Some((_, "fixed")) => Mount::Fixed,
            Some((mount, other)) => {
                let expected = "\"flange\" or \"fixed\"";
                return Err(self.refuse("mount", mount, quoted(other), expected));
            }
        };
        let turn = Twist {
            linear: Vector3::zeros(),
            angular: self.vector("rotation_vector_rad", &t.rotation_vector_rad, 1.0)?,
        };
        let position = &t.position_sigma_mm;
        let rotation = &t.rotation_sigma_mrad;
        Ok(Camera {
            focal: t.focal_px.get_ref().0,
            centre: t.centre_px.get_ref().0,
            intrinsics_sigma: self.form("intrinsics_sigma_px", &t.intrinsics_sigma_px, 1.0)?,
            mount,
            camera_from_mount: Pose {
                rotation: Pose::exp(&turn).rotation,
                translation: self.vector("position_mm", &t.position_mm, 1e-3)?,
            },
            position_sigma: self.sigma("position_sigma_mm", position, 1e-3, TAPE_SIGMA)?,
            rotation_sigma: self.sigma("rotation_sigma_mrad", rotation, 1e-3, MOUNTING_SIGMA)?,
        })
    }
}

/// Returns whether all points are on one line, within a thousandth of their extent.
pub(super) fn on_a_line(points: &[Vector3<f64>]) -> bool {
    let Some(first) = points.first() else {
        return true;
    };
    let from_first = || points.iter().map(|p| p - first);
    let Some(longest) = from_first().max_by(|a, b| a.norm().total_cmp(&b.norm())) else {
        return true;
    };
    let length = longest.norm();
    from_first().all(|p| p.cross(&longest).norm() <= 1e-3 * length * length)
}
