//! Touches that were read, in SI units.

use std::path::PathBuf;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::measurement::observation::{InstrumentNoise, Observation};
use crate::measurement::sample::ToolName;
use crate::measurement::set::JointColumn;
use crate::robot::ClassPrior;

/// A touch file and its features. Every feature has a row, and every index is that of an entry.
#[derive(Clone, Debug)]
pub struct TouchSet {
    /// The CSV file, as it was given.
    pub path: PathBuf,
    /// The TOML file.
    pub features_path: PathBuf,
    /// Number of the column `feature` in the CSV file, from 1.
    pub feature_column: usize,
    /// The joints' columns, base first.
    pub joint_columns: Vec<JointColumn>,
    /// The rows in the order of the file.
    pub rows: Vec<TouchRow>,
    /// The features in the order of the TOML file.
    pub features: Vec<Feature>,
    /// The tips that the rows name by index: one for each session and target.
    pub tips: Vec<Tip>,
    /// Distances between features that somebody measured.
    pub distances: Vec<KnownDistance>,
    /// How far an arm of this class is from its drawing, where the file says so.
    pub prior: Option<ClassPrior>,
    /// The camera; there is one where there is a board.
    pub camera: Option<Camera>,
    /// What the reader noticed and its user should see.
    pub notes: Vec<String>,
    /// SHA-256 of the CSV file's bytes, then of the TOML file's.
    pub sha256: [[u8; 32]; 2],
}

/// One row: one reading while the arm stood still.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchRow {
    /// Line in the CSV file, from 1.
    pub line: usize,
    /// The controller's joints, rad or m, base first.
    pub joints: Vec<f64>,
    /// The joints of the serial chain, C q.
    pub serial_joints: Vec<f64>,
    /// Mass at the flange in kg, where it is known.
    pub payload_kg: Option<f64>,
    /// Index into [`TouchSet::tips`].
    pub tip: usize,
    /// What was read.
    pub reading: Reading,
    /// The noise that the file declares for this row alone: of a touch `position`, of a level `orientation`.
    pub declared_noise: InstrumentNoise,
}

/// What a row says. `feature` is an index into [`TouchSet::features`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// A tracker saw the target: instrument_from_target.
    Tracker(Observation),
    /// The tip is at the point.
    Point {
        /// Which point.
        feature: usize,
    },
    /// The tip is over the plane.
    Plane {
        /// Which plane.
        feature: usize,
        /// Reading of a dial gauge along the plane's normal, m; 0 where the tip touches it.
        value: f64,
    },
    /// The tip is at a distance from the centre.
    Sphere {
        /// Which sphere.
        feature: usize,
        /// What the distance is beyond the radius, m; 0 where the tip touches it.
        value: f64,
    },
    /// A wire or a ballbar with a scale reads a distance.
    Anchor {
        /// Which anchor.
        feature: usize,
        /// The reading, m.
        value: f64,
    },
    /// An inclinometer at the flange.
    Level {
        /// Which sensor.
        feature: usize,
        /// The direction of gravity in the sensor's frame, of length 1.
        gravity: Vector3<f64>,
    },
    /// The camera sees a corner of a board.
    Board {
        /// Which board.
        feature: usize,
        /// Index into [`Board::corners`].
        corner: usize,
        /// Image of the corner in pixels, right.
        u: f64,
        /// Image of the corner in pixels, down.
        v: f64,
    },
}

impl Reading {
    /// The feature; `None` for a tracker's row.
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

    /// The number of scalar equations that the row gives.
    pub fn equations(&self) -> usize {
        match self {
            Self::Tracker(observation) => observation.equations(),
            Self::Point { .. } => 3,
            Self::Plane { .. } | Self::Sphere { .. } | Self::Anchor { .. } => 1,
            Self::Level { .. } | Self::Board { .. } => 2,
        }
    }
}

/// Something that was touched, or looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    /// Its name in both files.
    pub name: String,
    /// Line of its `[[feature]]` table in the TOML file, from 1.
    pub line: usize,
    /// What it is.
    pub kind: FeatureKind,
    /// Standard deviation of one component of a row's reading: metres; of a level radians, of a board pixels.
    pub sigma: f64,
}

/// What a feature is, with what is known of it. Standard deviations are of one component, 0 where there is no such error.
#[derive(Clone, Debug, PartialEq)]
pub enum FeatureKind {
    /// A fixed point that nobody knows.
    Point {
        /// How far the seat may be from one touch to another, beyond the noise, m.
        seat: f64,
    },
    /// A fixed plane that nobody knows.
    Plane {
        /// How far it may bulge, m.
        flatness: f64,
    },
    /// A sphere about a fixed centre that nobody knows: a ball that is touched, or a bar of fixed length.
    Sphere {
        /// From its centre to the tip's, m; `None` where it is unknown.
        radius: Option<f64>,
        /// Standard deviation of `radius`, m.
        radius_sigma: f64,
        /// How far it may be from round, m.
        roundness: f64,
    },
    /// Where a draw-wire or a ballbar with a scale begins.
    Anchor {
        /// The anchor in the base frame, m; `None` where it is unknown.
        position: Option<Vector3<f64>>,
        /// Standard deviation of one component of `position`, m.
        position_sigma: f64,
        /// Standard deviation of what the reading is too small by, m.
        zero_sigma: f64,
        /// Standard deviation of what the reading is too small by, as a part of it.
        scale_sigma: f64,
    },
    /// An inclinometer at the flange.
    Level {
        /// sensor_from_flange as drawn, a rotation vector in rad.
        rotation: Vector3<f64>,
        /// Standard deviation of one component of the sensor's true rotation about that, rad.
        rotation_sigma: f64,
    },
    /// A board of corners that a camera sees.
    Board(Board),
}

impl FeatureKind {
    /// The word of the TOML file.
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

/// A board of corners. Where it is nobody knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// The corners in the board's frame, m.
    pub corners: Vec<Vector3<f64>>,
    /// Standard deviation of the board's size, as a part of it.
    pub scale_sigma: f64,
}

/// The camera: a pinhole without distortion. It looks along its z, u grows along its x and v along its y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Focal lengths in pixels, of u and v.
    pub focal: [f64; 2],
    /// The image of the optical axis in pixels, u and v.
    pub centre: [f64; 2],
    /// Standard deviation of each focal length and each component of the centre, pixels; 0 where they are known.
    pub intrinsics_sigma: f64,
    /// What it is mounted on.
    pub mount: Mount,
    /// Pose of the camera as drawn: camera_from_flange for a camera at the flange, camera_from_base for a fixed one.
    pub camera_from_mount: Pose<f64>,
    /// Standard deviation of one component of its true position about that, m.
    pub position_sigma: f64,
    /// Standard deviation of one component of its true rotation about that, rad.
    pub rotation_sigma: f64,
}

/// What a camera is mounted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mount {
    /// It turns with the flange, and the board stands.
    Flange,
    /// It stands, and the board is at the flange.
    Fixed,
}

/// Where a tip is at the flange.
#[derive(Clone, Debug, PartialEq)]
pub struct Tip {
    /// The session and the target of its rows.
    pub name: ToolName,
    /// In the flange frame as drawn, m.
    pub position: Vector3<f64>,
    /// Standard deviation of one component of its true position about that, m.
    pub sigma: f64,
}

/// A distance between two points, or the centres of two spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownDistance {
    /// Indices into [`TouchSet::features`].
    pub between: [usize; 2],
    /// m.
    pub distance: f64,
    /// Standard deviation, m.
    pub sigma: f64,
    /// Line of its `[[distance]]` table in the TOML file, from 1.
    pub line: usize,
}

impl TouchSet {
    /// Standard deviation of one component of a touch's reading: the row's own, else its feature's. Metres; of a level
    /// radians, of a board pixels. `None` for a tracker's row.
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
