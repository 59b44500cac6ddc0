//! Touches after reading, in SI units.

use std::path::PathBuf;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::measurement::observation::{InstrumentNoise, Observation};
use crate::measurement::sample::ToolName;
use crate::measurement::set::JointColumn;
use crate::robot::ClassPrior;

/// A touch file and its features. Every feature has at least one row, and every index is valid.
#[derive(Clone, Debug)]
pub struct TouchSet {
    /// Path of the CSV file, as given by the caller.
    pub path: PathBuf,
    /// Path of the TOML file.
    pub features_path: PathBuf,
    /// Number of the column `feature` in the CSV file, from 1.
    pub feature_column: usize,
    /// Columns of the joints, base first.
    pub joint_columns: Vec<JointColumn>,
    /// Rows in file order.
    pub rows: Vec<TouchRow>,
    /// Features in the order of the TOML file.
    pub features: Vec<Feature>,
    /// Tips of the rows, which refer to them by index: one for each session and target.
    pub tips: Vec<Tip>,
    /// Measured distances between features.
    pub distances: Vec<KnownDistance>,
    /// How far an arm of this class is from its nominal model, if the file states it.
    pub prior: Option<ClassPrior>,
    /// The camera; present if there is a board.
    pub camera: Option<Camera>,
    /// Notes of the reader for its user.
    pub notes: Vec<String>,
    /// SHA-256 of the bytes of the CSV file, then of the TOML file.
    pub sha256: [[u8; 32]; 2],
}

/// One row: a single reading, taken while the arm stood still.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchRow {
    /// Line in the CSV file, from 1.
    pub line: usize,
    /// The controller's joint values, in rad or m, base first.
    pub joints: Vec<f64>,
    /// Joint values of the serial chain, C q.
    pub serial_joints: Vec<f64>,
    /// Payload: mass at the flange in kg, if known.
    pub payload_kg: Option<f64>,
    /// Index into [`TouchSet::tips`].
    pub tip: usize,
    /// The reading.
    pub reading: Reading,
    /// Noise that the file declares for this row alone: `position` for a touch, `orientation` for a level.
    pub declared_noise: InstrumentNoise,
}

/// The reading of a row. `feature` is an index into [`TouchSet::features`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// Pose or position of the target from a tracker: instrument_from_target.
    Tracker(Observation),
    /// Touch of a point by the tip.
    Point {
        /// Index of the point.
        feature: usize,
    },
    /// Touch of a plane by the tip, or its distance above the plane.
    Plane {
        /// Index of the plane.
        feature: usize,
        /// Reading of a dial gauge along the plane's normal, in m; 0 if the tip touches the plane.
        value: f64,
    },
    /// Distance of the tip from the centre of a sphere.
    Sphere {
        /// Index of the sphere.
        feature: usize,
        /// Distance from the centre minus the radius, in m; 0 if the tip touches the sphere.
        value: f64,
    },
    /// Distance read on a wire or on a ballbar with a scale.
    Anchor {
        /// Index of the anchor.
        feature: usize,
        /// The reading, in m.
        value: f64,
    },
    /// Direction of gravity from an inclinometer at the flange.
    Level {
        /// Index of the sensor.
        feature: usize,
        /// Direction of gravity in the sensor's frame, a unit vector.
        gravity: Vector3<f64>,
    },
    /// Corner of a board in a camera image.
    Board {
        /// Index of the board.
        feature: usize,
        /// Index into [`Board::corners`].
        corner: usize,
        /// Horizontal image coordinate of the corner in pixels, to the right.
        u: f64,
        /// Vertical image coordinate of the corner in pixels, downwards.
        v: f64,
    },
}

impl Reading {
    /// Returns the index of the feature; `None` for a tracker's row.
    pub fn feature(&self) -> Option<usize> {
        match *self {
            Self::Tracker(_) => None,
            Self::Point { feature }
            | Self::Plane { feature, .. }
            | Self::Sphere { feature, .. }
            | Self::Anchor { feature, .. }
            | Self::Level { feature, .. }
            | Self::Board { feature, .. } => Some(feature),
        }
    }

    /// Returns the number of scalar equations that the row gives.
    pub fn equations(&self) -> usize {
        match self {
            Self::Tracker(observation) => observation.equations(),
            Self::Point { .. } => 3,
            Self::Plane { .. } | Self::Sphere { .. } | Self::Anchor { .. } => 1,
            Self::Level { .. } | Self::Board { .. } => 2,
        }
    }
}

/// Something that was touched or observed.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    /// Name of the feature in both files.
    pub name: String,
    /// Line of the feature's `[[feature]]` table in the TOML file, from 1.
    pub line: usize,
    /// Kind of the feature.
    pub kind: FeatureKind,
    /// Standard deviation of one component of a row's reading: in m, for a level in rad, for a board in pixels.
    pub sigma: f64,
}

/// The kind of a feature and what is known about it. Standard deviations are of one component, 0 if there is no such error.
#[derive(Clone, Debug, PartialEq)]
pub enum FeatureKind {
    /// A fixed point at an unknown position.
    Point {
        /// Standard deviation of the seat from touch to touch, beyond the noise, in m.
        seat: f64,
    },
    /// A fixed plane at an unknown position.
    Plane {
        /// Standard deviation of the plane's deviation from flatness, in m.
        flatness: f64,
    },
    /// A sphere about a fixed centre at an unknown position: a ball that is touched, or a bar of fixed length.
    Sphere {
        /// Distance from the centre of the sphere to the centre of the tip, in m; `None` if unknown.
        radius: Option<f64>,
        /// Standard deviation of `radius`, in m.
        radius_sigma: f64,
        /// Standard deviation of the sphere's deviation from roundness, in m.
        roundness: f64,
    },
    /// Fixed end of a draw-wire or of a ballbar with a scale.
    Anchor {
        /// Position of the anchor in the base frame, in m; `None` if unknown.
        position: Option<Vector3<f64>>,
        /// Standard deviation of one component of `position`, in m.
        position_sigma: f64,
        /// Standard deviation of the constant by which readings are too small, in m.
        zero_sigma: f64,
        /// Standard deviation of the share by which readings are too small, relative to the reading.
        scale_sigma: f64,
    },
    /// An inclinometer at the flange.
    Level {
        /// Nominal sensor_from_flange, as a rotation vector in rad.
        rotation: Vector3<f64>,
        /// Standard deviation of one component of the sensor's true rotation about `rotation`, in rad.
        rotation_sigma: f64,
    },
    /// A board of corners that a camera sees.
    Board(Board),
}

impl FeatureKind {
    /// Returns the name of the kind in the TOML file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Point { .. } => "point",
            Self::Plane { .. } => "plane",
            Self::Sphere { .. } => "sphere",
            Self::Anchor { .. } => "anchor",
            Self::Level { .. } => "level",
            Self::Board(_) => "board",
        }
    }
}

/// A board of corners at an unknown pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Positions of the corners in the board's frame, in m.
    pub corners: Vec<Vector3<f64>>,
    /// Relative standard deviation of the board's size.
    pub scale_sigma: f64,
}

/// The camera: a pinhole without distortion. It looks along its z axis; u grows along its x axis and v along its y axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Focal lengths for u and v, in pixels.
    pub focal: [f64; 2],
    /// Image of the optical axis, u and v in pixels.
    pub centre: [f64; 2],
    /// Standard deviation of each focal length and of each component of the centre, in pixels; 0 if they are known.
    pub intrinsics_sigma: f64,
    /// What the camera is mounted on.
    pub mount: Mount,
    /// Nominal pose of the camera: camera_from_flange for a camera at the flange, camera_from_base for a fixed one.
    pub camera_from_mount: Pose<f64>,
    /// Standard deviation of one component of the camera's true position about `camera_from_mount`, in m.
    pub position_sigma: f64,
    /// Standard deviation of one component of the camera's true rotation about `camera_from_mount`, in rad.
    pub rotation_sigma: f64,
}

/// What a camera is mounted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mount {
    /// On the flange: the camera moves with it, and the board is fixed.
    Flange,
    /// Fixed: the board is at the flange.
    Fixed,
}

/// Position of a tip at the flange.
#[derive(Clone, Debug, PartialEq)]
pub struct Tip {
    /// Session and target of the tip's rows.
    pub name: ToolName,
    /// Nominal position in the flange frame, in m.
    pub position: Vector3<f64>,
    /// Standard deviation of one component of the true position about `position`, in m.
    pub sigma: f64,
}

/// A known distance between two points or the centres of two spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownDistance {
    /// The two features, as indices into [`TouchSet::features`].
    pub between: [usize; 2],
    /// The distance, in m.
    pub distance: f64,
    /// Standard deviation of `distance`, in m.
    pub sigma: f64,
    /// Line of the `[[distance]]` table in the TOML file, from 1.
    pub line: usize,
}

impl TouchSet {
    /// Returns the standard deviation of one component of a touch's reading: that of the row if declared, else that of its
    /// feature. In m; for a level in rad, for a board in pixels. `None` for a tracker's row.
    pub fn sigma(&self, row: &TouchRow) -> Option<f64> {
        let feature = &self.features[row.reading.feature()?];
        let own = match feature.kind {
            FeatureKind::Level { .. } => row.declared_noise.orientation,
            FeatureKind::Board(_) => None,
            _ => row.declared_noise.position,
        };
        Some(own.unwrap_or(feature.sigma))
    }
}
