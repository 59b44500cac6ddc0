//! What was touched or looked at, as it is being fitted: unknowns of every feature, of the camera and of the instrument.

use nalgebra::{Matrix3, Vector2, Vector3};
use poegp_runtime::math::se3::{Pose, Twist, skew};

use crate::identification::touch::form::Form;
use crate::identification::touch::jet::RowJet;
use crate::measurement::observation::Observation;
use crate::measurement::touch::{Board, Camera, Mount, Reading, TouchSet};

/// Nobody knows where: standard deviation of a position in m, of a direction or rotation in rad.
const ANYWHERE: f64 = 3.0;
/// Standard deviation of the direction of gravity in the base frame, rad: how level a base is set up.
const BASE_TILT: f64 = 3e-3;

/// A feature at its unknowns.
#[derive(Clone, Debug)]
pub enum Figure {
    /// `[c 3 | seat 3 a bump]`.
    Point {
        centre: Vector3<f64>,
        seat: Option<(Form, Vec<f64>)>,
    },
    /// `[two tilts | d | bumps]`.
    Plane {
        /// A point near the middle of the touches: what the plane turns about.
        origin: Vector3<f64>,
        /// Two directions in the plane and its normal, as columns.
        axes: Matrix3<f64>,
        /// Of the plane from the origin along the normal.
        offset: f64,
        flatness: Option<(Form, Vec<f64>)>,
    },
    /// `[c 3 | r | bumps]`.
    Sphere {
        centre: Vector3<f64>,
        radius: f64,
        roundness: Option<(Form, Vec<f64>)>,
    },
    /// `[a 3 | zero | scale]`.
    Anchor {
        position: Vector3<f64>,
        zero: f64,
        scale: f64,
    },
    /// `[S 3 | two tilts of gravity]`.
    Level {
        sensor_from_flange: Matrix3<f64>,
        gravity: Vector3<f64>,
    },
    /// `[W 6 | scale]`.
    Board {
        /// base_from_board; of a fixed camera flange_from_board.
        pose: Pose<f64>,
        scale: f64,
    },
}

/// Everything beside the arm.
#[derive(Clone, Debug)]
pub struct Scene {
    /// In the order of [`TouchSet::features`].
    pub figures: Vec<Figure>,
    /// Index of the first unknown of each feature.
    pub first: Vec<usize>,
    /// The camera: `[position 3 | rotation 3 | focal lengths 2 | centre 2]`, and its first unknown.
    pub camera: Option<(Camera, usize)>,
    /// instrument_from_base: `[position 3 | rotation 3]`, and its first unknown.
    pub instrument: Option<(Pose<f64>, usize)>,
    /// What the unknowns have changed by since they were known to `prior`.
    pub deviation: Vec<f64>,
    /// Standard deviation of every unknown.
    pub prior: Vec<f64>,
    /// Unknowns that rows or distances tie together, each with the range of its indices.
    pub groups: Vec<std::ops::Range<usize>>,
}

fn turned(rotation: &Matrix3<f64>, by: &Vector3<f64>) -> Matrix3<f64> {
    let twist = Twist {
        linear: Vector3::zeros(),
        angular: *by,
    };
    Pose::exp(&twist).rotation * rotation
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
    /// Standard deviations of its unknowns.
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

/// Two directions across a unit vector. They hardly change with it.
fn across(v: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let least = v.iamin();
    let mut unit = Vector3::zeros();
    unit[least] = 1.0;
    let a = v.cross(&unit).normalize();
    (a, v.cross(&a))
}

impl Scene {
    /// From figures where they begin. `ties` are pairs of features that share a row's pose or a distance.
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

    /// Index of the group of a row.
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

    /// The point of a feature that distances are measured from.
    pub fn centre(&self, feature: usize) -> Option<Vector3<f64>> {
        match &self.figures[feature] {
            Figure::Point { centre, .. } | Figure::Sphere { centre, .. } => Some(*centre),
            _ => None,
        }
    }

    /// A row at the pose base_from_tip of its tip; of levels and boards that of the flange.
    pub fn row(&self, set: &TouchSet, reading: &Reading, tip: &Pose<f64>) -> RowJet {
        let x = tip.translation;
        match *reading {
            Reading::Tracker(observation) => self.tracker(&observation, tip),
            Reading::Point { feature } => self.point(feature, tip),
            Reading::Plane { feature, value } => self.plane(feature, value, &x),
            Reading::Sphere { feature, value } => self.sphere(feature, value, &x),
            Reading::Anchor { feature, value } => self.anchor(feature, value, &x),
            Reading::Level { feature, gravity } => self.level(feature, &gravity, tip),
            Reading::Board {
                feature,
                corner,
                u,
                v,
            } => {
                let corner = match &set.features[feature].kind {
                    crate::measurement::touch::FeatureKind::Board(board) => board.corners[corner],
                    _ => Vector3::zeros(),
                };
                self.board(feature, &corner, [u, v], tip)
            }
        }
    }

    fn point(&self, feature: usize, tip: &Pose<f64>) -> RowJet {
        let mut out = RowJet::new(3);
        let Figure::Point { centre, seat } = &self.figures[feature] else {
            return out;
        };
        let first = self.first[feature];
        let mut missed = tip.translation - centre;
        for i in 0..3 {
            out.tip[i][i] = 1.0;
            let mut column = [0.0; 3];
            column[i] = -1.0;
            out.push(first + i, &column);
        }
        if let Some((form, amplitudes)) = seat {
            // A ball lies in its socket as the tool is turned.
            let direction = tip.rotation.column(2).into_owned();
            for (k, weight) in form.weights(&direction).into_iter().enumerate() {
                for i in 0..3 {
                    missed[i] -= weight * amplitudes[3 * k + i];
                    let mut column = [0.0; 3];
                    column[i] = -weight;
                    out.push(first + 3 + 3 * k + i, &column);
                }
            }
        }
        out.residual[..3].copy_from_slice(missed.as_slice());
        out
    }

    fn plane(&self, feature: usize, value: f64, x: &Vector3<f64>) -> RowJet {
        let mut out = RowJet::new(1);
        let Figure::Plane {
            origin,
            axes,
            offset,
            flatness,
        } = &self.figures[feature]
        else {
            return out;
        };
        let first = self.first[feature];
        let from = x - origin;
        let local = axes.transpose() * from;
        out.residual[0] = local[2] - offset - value;
        out.tip[0][..3].copy_from_slice(axes.column(2).as_slice());
        // The normal turns towards the first and the second direction.
        out.push(first, &[local[0]]);
        out.push(first + 1, &[local[1]]);
        out.push(first + 2, &[-1.0]);
        if let Some((form, amplitudes)) = flatness {
            for (k, weight) in form.weights(&local).into_iter().enumerate() {
                out.residual[0] -= weight * amplitudes[k];
                out.push(first + 3 + k, &[-weight]);
            }
        }
        out
    }

    fn sphere(&self, feature: usize, value: f64, x: &Vector3<f64>) -> RowJet {
        let mut out = RowJet::new(1);
        let Figure::Sphere {
            centre,
            radius,
            roundness,
        } = &self.figures[feature]
        else {
            return out;
        };
        let first = self.first[feature];
        let (length, direction) = towards(&(x - centre));
        out.residual[0] = length - radius - value;
        out.tip[0][..3].copy_from_slice(direction.as_slice());
        for i in 0..3 {
            out.push(first + i, &[-direction[i]]);
        }
        out.push(first + 3, &[-1.0]);
        if let Some((form, amplitudes)) = roundness {
            for (k, weight) in form.weights(&direction).into_iter().enumerate() {
                out.residual[0] -= weight * amplitudes[k];
                out.push(first + 4 + k, &[-weight]);
            }
        }
        out
    }

    fn anchor(&self, feature: usize, value: f64, x: &Vector3<f64>) -> RowJet {
        let mut out = RowJet::new(1);
        let Figure::Anchor {
            position,
            zero,
            scale,
        } = &self.figures[feature]
        else {
            return out;
        };
        let first = self.first[feature];
        let (length, direction) = towards(&(x - position));
        out.residual[0] = length - (1.0 + scale) * value - zero;
        out.tip[0][..3].copy_from_slice(direction.as_slice());
        for i in 0..3 {
            out.push(first + i, &[-direction[i]]);
        }
        out.push(first + 3, &[-1.0]);
        out.push(first + 4, &[-value]);
        out
    }

    fn level(&self, feature: usize, read: &Vector3<f64>, flange: &Pose<f64>) -> RowJet {
        let mut out = RowJet::new(2);
        let Figure::Level {
            sensor_from_flange,
            gravity,
        } = &self.figures[feature]
        else {
            return out;
        };
        let first = self.first[feature];
        let sensor_from_base = sensor_from_flange * flange.rotation.transpose();
        let seen = sensor_from_base * gravity;
        let (a, b) = across(read);
        // d(Rᵀ g) = −Rᵀ (ω × g) = Rᵀ [g]× ω, and S turned by φ moves what it sees by φ × s.
        let by_tip = sensor_from_base * skew(gravity);
        let by_sensor = -skew(&seen);
        let (east, north) = across(gravity);
        for (i, direction) in [a, b].iter().enumerate() {
            out.residual[i] = direction.dot(&seen);
            let row = by_tip.transpose() * direction;
            out.tip[i][3..].copy_from_slice(row.as_slice());
        }
        let both = |v: Vector3<f64>| [a.dot(&v), b.dot(&v)];
        for i in 0..3 {
            out.push(first + i, &both(by_sensor.column(i).into_owned()));
        }
        out.push(first + 3, &both(sensor_from_base * east));
        out.push(first + 4, &both(sensor_from_base * north));
        out
    }

    fn board(
        &self,
        feature: usize,
        corner: &Vector3<f64>,
        image: [f64; 2],
        flange: &Pose<f64>,
    ) -> RowJet {
        let mut out = RowJet::new(2);
        let (Figure::Board { pose, scale }, Some((camera, of_camera))) =
            (&self.figures[feature], &self.camera)
        else {
            return out;
        };
        let first = self.first[feature];
        let on_board = corner * (1.0 + scale);
        let turned_corner = pose.rotation * on_board;
        let on_mount = turned_corner + pose.translation;
        let x = &camera.camera_from_mount;
        let (r, t) = (&flange.rotation, &flange.translation);
        // What the camera's mount sees of the corner, by the corner's own frame, and by a displacement and rotation of the flange.
        let (seen, by_point, by_tip) = match camera.mount {
            Mount::Flange => {
                let from = on_mount - t;
                let rt = r.transpose();
                (rt * from, rt, [-rt, rt * skew(&from)])
            }
            Mount::Fixed => {
                let from = r * on_mount;
                (from + t, *r, [Matrix3::identity(), -skew(&from)])
            }
        };
        let turned_seen = x.rotation * seen;
        let p = turned_seen + x.translation;
        let depth = p[2].max(1e-3);
        let [fx, fy] = camera.focal;
        let (px, py) = (p[0] / depth, p[1] / depth);
        out.residual[0] = fx * px + camera.centre[0] - image[0];
        out.residual[1] = fy * py + camera.centre[1] - image[1];
        let project = |d: &Vector3<f64>| {
            [
                fx / depth * (d[0] - px * d[2]),
                fy / depth * (d[1] - py * d[2]),
            ]
        };
        for (block, by_tip) in by_tip.iter().enumerate() {
            let at_camera = x.rotation * by_tip;
            for i in 0..3 {
                let column = project(&at_camera.column(i).into_owned());
                out.tip[0][3 * block + i] = column[0];
                out.tip[1][3 * block + i] = column[1];
            }
        }
        let by_mount = x.rotation * by_point;
        let by_turn = -(by_mount * skew(&turned_corner));
        for i in 0..3 {
            out.push(first + i, &project(&by_mount.column(i).into_owned()));
            out.push(first + 3 + i, &project(&by_turn.column(i).into_owned()));
        }
        out.push(first + 6, &project(&(by_mount * (pose.rotation * corner))));
        let own_turn = -skew(&turned_seen);
        for i in 0..3 {
            let mut unit = Vector3::zeros();
            unit[i] = 1.0;
            out.push(of_camera + i, &project(&unit));
            out.push(
                of_camera + 3 + i,
                &project(&own_turn.column(i).into_owned()),
            );
        }
        out.push(of_camera + 6, &[px, 0.0]);
        out.push(of_camera + 7, &[0.0, py]);
        out.push(of_camera + 8, &[1.0, 0.0]);
        out.push(of_camera + 9, &[0.0, 1.0]);
        out
    }

    fn tracker(&self, observation: &Observation, tip: &Pose<f64>) -> RowJet {
        let mut out = RowJet::new(observation.equations());
        let Some((instrument, first)) = &self.instrument else {
            return out;
        };
        let turned_tip = instrument.rotation * tip.translation;
        let seen = turned_tip + instrument.translation - observation.position();
        out.residual[..3].copy_from_slice(seen.as_slice());
        let whole = observation.pose();
        if let Some(pose) = &whole {
            let between = Pose {
                rotation: instrument.rotation * tip.rotation * pose.rotation.transpose(),
                translation: Vector3::zeros(),
            };
            let turn = between.log().angular;
            out.residual[3..].copy_from_slice(turn.as_slice());
        }
        let by_turn = -skew(&turned_tip);
        for i in 0..3 {
            for row in 0..3 {
                out.tip[row][i] = instrument.rotation[(row, i)];
                if whole.is_some() {
                    out.tip[3 + row][3 + i] = instrument.rotation[(row, i)];
                }
            }
            let mut column = [0.0; 6];
            column[i] = 1.0;
            out.push(first + i, &column);
            let mut column = [0.0; 6];
            column[..3].copy_from_slice(by_turn.column(i).as_slice());
            if whole.is_some() {
                column[3 + i] = 1.0;
            }
            out.push(first + 3 + i, &column);
        }
        out
    }
}

/// Length and direction of a vector.
fn towards(v: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let length = v.norm();
    (length, v / length.max(1e-9))
}

/// Where a point lies in the axes of a plane.
pub fn in_plane(axes: &Matrix3<f64>, origin: &Vector3<f64>, x: &Vector3<f64>) -> Vector2<f64> {
    (axes.transpose() * (x - origin)).xy()
}
