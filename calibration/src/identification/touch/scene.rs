//! The scene: unknowns of every feature that was touched or seen, of the camera and of the instrument, during a fit.

use nalgebra::{Matrix3, Vector2, Vector3};
use poegp_runtime::math::se3::Pose;

use crate::identification::touch::form::Form;
use crate::measurement::touch::{Board, Camera, Reading, TouchSet};
use crate::numeric::rotation::turn;

/// Prior standard deviation of an unknown pose: of a position in m, of a direction or rotation in rad.
const ANYWHERE: f64 = 3.0;
/// Standard deviation of the direction of gravity in the base frame, rad: how level a base is set up.
const BASE_TILT: f64 = 3e-3;

/// A feature with the current values of its unknowns, which each variant lists in order.
#[derive(Clone, Debug)]
pub enum Figure {
    /// `[c 3 | seat 3 a bump]`.
    Point {
        /// Centre in the base frame, in m.
        centre: Vector3<f64>,
        /// Form error of the seat, with the amplitudes of its bumps in m.
        seat: Option<(Form, Vec<f64>)>,
    },
    /// `[two tilts | d | bumps]`.
    Plane {
        /// A point near the middle of the touches about which the plane turns.
        origin: Vector3<f64>,
        /// Two directions in the plane and its normal, as columns.
        axes: Matrix3<f64>,
        /// Distance of the plane from `origin` along the normal, in m.
        offset: f64,
        /// Form error of the plane, with the amplitudes of its bumps in m.
        flatness: Option<(Form, Vec<f64>)>,
    },
    /// `[c 3 | r | bumps]`.
    Sphere {
        /// Centre in the base frame, in m.
        centre: Vector3<f64>,
        /// Distance between the centres of sphere and tip, in m.
        radius: f64,
        /// Form error of the sphere, with the amplitudes of its bumps in m.
        roundness: Option<(Form, Vec<f64>)>,
    },
    /// `[a 3 | zero | scale]`.
    Anchor {
        /// Position in the base frame, in m.
        position: Vector3<f64>,
        /// Amount by which the reading is too small, in m.
        zero: f64,
        /// Relative amount by which the reading is too small.
        scale: f64,
    },
    /// `[S 3 | two tilts of gravity]`.
    Level {
        /// Rotation S of the sensor.
        sensor_from_flange: Matrix3<f64>,
        /// Direction of gravity in the base frame.
        gravity: Vector3<f64>,
    },
    /// `[W 6 | scale]`.
    Board {
        /// base_from_board, or flange_from_board for a fixed camera.
        pose: Pose<f64>,
        /// Relative amount by which the board is larger than stated.
        scale: f64,
    },
}

/// Everything that is fitted besides the arm.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Figures of the features, in the order of [`TouchSet::features`].
    pub figures: Vec<Figure>,
    /// Index of the first unknown of each feature.
    pub first: Vec<usize>,
    /// The camera, `[position 3 | rotation 3 | focal lengths 2 | centre 2]`, and the index of its first unknown.
    pub camera: Option<(Camera, usize)>,
    /// instrument_from_base, `[position 3 | rotation 3]`, and the index of its first unknown.
    pub instrument: Option<(Pose<f64>, usize)>,
    /// Change of every unknown from the value to which `prior` applies.
    pub deviation: Vec<f64>,
    /// Prior standard deviation of every unknown.
    pub prior: Vec<f64>,
    /// Groups of unknowns that are coupled by rows or distances, each as a range of indices.
    pub groups: Vec<std::ops::Range<usize>>,
}

fn turned(rotation: &Matrix3<f64>, by: &Vector3<f64>) -> Matrix3<f64> {
    turn(*by).rotation * rotation
}

fn vector(step: &[f64]) -> Vector3<f64> {
    Vector3::new(step[0], step[1], step[2])
}

fn moved(pose: &Pose<f64>, step: &[f64]) -> Pose<f64> {
    Pose {
        rotation: turned(&pose.rotation, &vector(&step[3..])),
        translation: pose.translation + vector(step),
    }
}

impl Figure {
    /// Returns the prior standard deviations of the figure's unknowns.
    fn prior(&self, set: &TouchSet, feature: usize) -> Vec<f64> {
        use crate::measurement::touch::FeatureKind as Kind;
        let bumps = |form: &Option<(Form, Vec<f64>)>, sigma: f64| {
            vec![sigma; form.as_ref().map_or(0, |(_, a)| a.len())]
        };
        match (self, &set.features[feature].kind) {
            (Self::Point { seat, .. }, Kind::Point { seat: sigma }) => {
                [vec![ANYWHERE; 3], bumps(seat, *sigma)].concat()
            }
            (Self::Plane { flatness, .. }, Kind::Plane { flatness: sigma }) => {
                [vec![ANYWHERE; 3], bumps(flatness, *sigma)].concat()
            }
            (
                Self::Sphere { roundness, .. },
                Kind::Sphere {
                    radius,
                    radius_sigma,
                    roundness: sigma,
                },
            ) => {
                let radius = radius.map_or(ANYWHERE, |_| *radius_sigma);
                [vec![ANYWHERE; 3], vec![radius], bumps(roundness, *sigma)].concat()
            }
            (
                Self::Anchor { .. },
                Kind::Anchor {
                    position,
                    position_sigma,
                    zero_sigma,
                    scale_sigma,
                },
            ) => {
                let position = position.map_or(ANYWHERE, |_| *position_sigma);
                vec![position, position, position, *zero_sigma, *scale_sigma]
            }
            (Self::Level { .. }, Kind::Level { rotation_sigma, .. }) => {
                [vec![*rotation_sigma; 3], vec![BASE_TILT; 2]].concat()
            }
            (Self::Board { .. }, Kind::Board(Board { scale_sigma, .. })) => {
                [vec![ANYWHERE; 6], vec![*scale_sigma]].concat()
            }
            _ => unreachable!("a figure is made of its feature"),
        }
    }

    fn update(&mut self, step: &[f64]) {
        let form = |form: &mut Option<(Form, Vec<f64>)>, step: &[f64]| {
            if let Some((_, amplitudes)) = form {
                for (a, s) in amplitudes.iter_mut().zip(step) {
                    *a += s;
                }
            }
        };
        match self {
            Self::Point { centre, seat } => {
                *centre += vector(step);
                form(seat, &step[3..]);
            }
            Self::Plane {
                axes,
                offset,
                flatness,
                ..
            } => {
                let by = axes.column(1) * step[0] - axes.column(0) * step[1];
                *axes = turned(axes, &by);
                *offset += step[2];
                form(flatness, &step[3..]);
            }
            Self::Sphere {
                centre,
                radius,
                roundness,
            } => {
                *centre += vector(step);
                *radius += step[3];
                form(roundness, &step[4..]);
            }
            Self::Anchor {
                position,
                zero,
                scale,
            } => {
                *position += vector(step);
                *zero += step[3];
                *scale += step[4];
            }
            Self::Level {
                sensor_from_flange,
                gravity,
            } => {
                *sensor_from_flange = turned(sensor_from_flange, &vector(step));
                let (a, b) = across(gravity);
                *gravity = (*gravity + a * step[3] + b * step[4]).normalize();
            }
            Self::Board { pose, scale } => {
                *pose = moved(pose, step);
                *scale += step[6];
            }
        }
    }
}

/// Returns two directions perpendicular to a unit vector. They hardly change with it.
pub(super) fn across(v: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let least = v.iamin();
    let mut unit = Vector3::zeros();
    unit[least] = 1.0;
    let a = v.cross(&unit).normalize();
    (a, v.cross(&a))
}

impl Scene {
    /// Creates a scene from initial figures. Features that share a distance, and all boards (they share the camera), form
    /// one group.
    pub fn new(
        set: &TouchSet,
        figures: Vec<Figure>,
        camera: Option<Camera>,
        instrument: Option<Pose<f64>>,
    ) -> Self {
        let count = figures.len();
        let mut class: Vec<usize> = (0..count).collect();
        let mut tie = |a: usize, b: usize| {
            let (a, b) = (class[a], class[b]);
            for c in class.iter_mut().filter(|c| **c == b) {
                *c = a;
            }
        };
        for distance in &set.distances {
            tie(distance.between[0], distance.between[1]);
        }
        // The camera ties all boards together.
        let boards: Vec<usize> = (0..count)
            .filter(|i| matches!(figures[*i], Figure::Board { .. }))
            .collect();
        for pair in boards.windows(2) {
            tie(pair[0], pair[1]);
        }
        let mut out = Self {
            first: vec![0; count],
            camera: None,
            instrument: None,
            deviation: Vec::new(),
            prior: Vec::new(),
            groups: Vec::new(),
            figures,
        };
        for leader in 0..count {
            let start = out.prior.len();
            let members: Vec<usize> = (0..count).filter(|i| class[*i] == leader).collect();
            for feature in &members {
                out.first[*feature] = out.prior.len();
                let prior = out.figures[*feature].prior(set, *feature);
                out.prior.extend(prior);
            }
            if let Some(camera) = camera
                && members.iter().any(|i| boards.contains(i))
            {
                out.camera = Some((camera, out.prior.len()));
                out.prior.extend([camera.position_sigma; 3]);
                out.prior.extend([camera.rotation_sigma; 3]);
                out.prior.extend([camera.intrinsics_sigma; 4]);
            }
            if out.prior.len() > start {
                out.groups.push(start..out.prior.len());
            }
        }
        if let Some(pose) = instrument {
            let start = out.prior.len();
            out.instrument = Some((pose, start));
            out.prior.extend([ANYWHERE; 6]);
            out.groups.push(start..out.prior.len());
        }
        out.deviation = vec![0.0; out.prior.len()];
        out
    }

    /// Returns the index of the group that a row belongs to.
    pub fn group_of(&self, reading: &Reading) -> usize {
        let first = match reading.feature() {
            Some(feature) => self.first[feature],
            None => self.instrument.map_or(0, |(_, first)| first),
        };
        self.groups
            .iter()
            .position(|g| g.contains(&first))
            .unwrap_or(0)
    }

    /// Moves the unknowns by `step`.
    pub fn update(&mut self, step: &[f64]) {
        for (figure, first) in self.figures.iter_mut().zip(&self.first) {
            figure.update(&step[*first..]);
        }
        if let Some((camera, first)) = &mut self.camera {
            let step = &step[*first..];
            camera.camera_from_mount = moved(&camera.camera_from_mount, step);
            for i in 0..2 {
                camera.focal[i] += step[6 + i];
                camera.centre[i] += step[8 + i];
            }
        }
        if let Some((pose, first)) = &mut self.instrument {
            *pose = moved(pose, &step[*first..]);
        }
        for (d, s) in self.deviation.iter_mut().zip(step) {
            *d += s;
        }
    }

    /// Returns the point of a feature from which distances are measured; `None` if it has no centre.
    pub fn centre(&self, feature: usize) -> Option<Vector3<f64>> {
        match &self.figures[feature] {
            Figure::Point { centre, .. } | Figure::Sphere { centre, .. } => Some(*centre),
            _ => None,
        }
    }
}

/// Returns the coordinates of a point in the axes of a plane, in m.
pub fn in_plane(axes: &Matrix3<f64>, origin: &Vector3<f64>, x: &Vector3<f64>) -> Vector2<f64> {
    (axes.transpose() * (x - origin)).xy()
}
