//! Touches of a simulated arm: sockets, planes, balls, ballbars, draw-wires, levels and boards, with their description.
//!
//! The operator leads the arm until its true tip is at the feature, but for the noise of a touch, and writes down the joints
//! that the controller shows. What the description states of tip, anchors and camera is off by its stated σ.

use std::fmt::Write as _;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::robot::Robot;
use crate::robot::settle::{Settler, Surface};
use crate::simulation::Simulator;
use crate::simulation::true_arm::normal_vector;

/// Noise of one component of a touch, m.
const TOUCH_NOISE: f64 = 0.05e-3;
/// The tip as drawn, m in the flange frame, and how far it is off.
const TIP: [f64; 3] = [0.02, 0.01, 0.15];
const TIP_ERROR: f64 = 1e-3;
/// How well a known distance or radius is known, m.
const LENGTH_NOISE: f64 = 0.015e-3;
/// How well an anchor is known by a tape, and the zero of its wire, m.
const TAPE_ERROR: f64 = 20e-3;
const ZERO_ERROR: f64 = 1e-3;
/// From the centre of a ball to that of the tip, m.
const BALL: f64 = 50e-3;
/// Rotation of a sensor at the flange, rad, and noise of a level.
const MOUNTING_ERROR: f64 = 20e-3;
const LEVEL_NOISE: f64 = 0.05e-3;
/// Focal length, half the image and noise, pixels.
const FOCAL: f64 = 1500.0;
const HALF_IMAGE: [f64; 2] = [960.0, 600.0];
const PIXEL_NOISE: f64 = 0.1;
/// From the camera to the board, m.
const VIEW: f64 = 0.45;
/// Distance between two corners of a board, m, and their numbers along x and y.
const CORNER_STEP: f64 = 0.05;
const CORNERS: [usize; 2] = [5, 4];
/// Starts of one touch before there is no hope.
const STARTS: usize = 500;

/// What is touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchKind {
    /// A ball in sockets; where there are several, the distances from the first are known.
    Socket,
    /// Planes that are square to each other.
    Plane,
    /// Balls of 50 mm.
    Sphere,
    /// A bar of fixed length, about several centres.
    Ballbar,
    /// Draw-wires, read at once.
    Wire,
    /// An inclinometer at the flange.
    Level,
    /// A camera at the flange that looks at a board.
    Camera,
}

/// The kinds with the names that they have in a command and as features.
pub const TOUCH_KINDS: [(&str, TouchKind); 7] = [
    ("socket", TouchKind::Socket),
    ("plane", TouchKind::Plane),
    ("sphere", TouchKind::Sphere),
    ("ballbar", TouchKind::Ballbar),
    ("wire", TouchKind::Wire),
    ("level", TouchKind::Level),
    ("camera", TouchKind::Camera),
];

/// What to touch: a kind and the number of such features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TouchTask {
    /// What.
    pub kind: TouchKind,
    /// How many of them, 1 to 9.
    pub features: usize,
}

/// Touches and their description.
#[derive(Clone, Debug)]
pub struct SimulatedTouches {
    /// The touch file.
    pub csv: String,
    /// The file of features.
    pub toml: String,
    /// Its rows.
    pub rows: usize,
}

/// A joint in the unit of files: degrees or millimetres.
fn in_file_units(kind: JointKind, joint: f64) -> f64 {
    match kind {
        JointKind::Revolute => joint.to_degrees(),
        JointKind::Prismatic => 1e3 * joint,
    }
}

/// An arm that finds no way to a feature.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no way to \"{0}\" within the joint ranges")]
pub struct OutOfReach(pub String);

/// The arm with its tip, and what was touched so far.
struct Touching<'a> {
    robot: &'a Robot,
    simulator: &'a mut Simulator,
    payload_kg: f64,
    ranges: Vec<(f64, f64)>,
    /// m, true.
    tip: Vector3<f64>,
    rows: Vec<String>,
    toml: String,
}

impl Simulator {
    /// Touches features, `count` times for each task; where the tip truly is at `truth` random poses comes second, as a
    /// measurement file in the base frame, without noise.
    ///
    /// # Errors
    /// [`OutOfReach`] where the arm cannot get to a feature from five hundred starts.
    pub fn touch(
        &mut self,
        robot: &Robot,
        tasks: &[TouchTask],
        count: usize,
        truth: usize,
        comment: &str,
    ) -> Result<(SimulatedTouches, String), OutOfReach> {
        let tip = Vector3::from(TIP) + normal_vector(TIP_ERROR, &mut self.random);
        let mut touching = Touching {
            robot,
            payload_kg: self.payloads.first().copied().unwrap_or(0.0),
            ranges: self.ranges.clone(),
            simulator: self,
            tip,
            rows: Vec::new(),
            toml: description_of_tip(comment),
        };
        for task in tasks {
            touching.task(*task, count)?;
        }
        let names = touching.joint_names();
        let header = "feature,corner,value_mm,gx,gy,gz,u_px,v_px,payload_kg";
        let csv = format!("# {comment}\n{header},{names}\n{}", touching.rows.concat());
        let touches = SimulatedTouches {
            csv,
            rows: touching.rows.len(),
            toml: std::mem::take(&mut touching.toml),
        };
        let truth = touching.truth(truth, comment);
        Ok((touches, truth))
    }
}

fn description_of_tip(comment: &str) -> String {
    let [x, y, z] = TIP.map(|x| 1e3 * x);
    format!(
        "# {comment}\nversion = 1\n\n[noise]\ntouch_mm = {}\n\n[prior]\nlength_mm = 0.8\ntilt_mrad = 0.8\njoint_zero_mrad = 0.8\n\n\
         [[target]]\nname = \"tip\"\ntip_mm = [{x}, {y}, {z}]\nsigma_mm = {}\n",
        1e3 * TOUCH_NOISE,
        1e3 * TIP_ERROR
    )
}

impl Touching<'_> {
    fn random(&mut self) -> &mut ChaCha8Rng {
        &mut self.simulator.random
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(self.random())
    }

    /// Random joints within a share of each range, about its middle.
    fn joints(&mut self, share: f64) -> Vec<f64> {
        let ranges = self.ranges.clone();
        let random = self.random();
        let joint = |(lower, upper): (f64, f64)| {
            let middle = 0.5 * (lower + upper);
            middle + share * (upper - lower) * (random.random::<f64>() - 0.5)
        };
        ranges.into_iter().map(joint).collect()
    }

    /// The true flange at these joints, at this moment.
    fn flange(&self, joints: &[f64]) -> Pose<f64> {
        let mut moment = self.simulator.random.clone();
        self.simulator
            .arm
            .base_from_flange(joints, self.payload_kg, &mut moment)
    }

    fn tip_at(&self, joints: &[f64]) -> Vector3<f64> {
        self.flange(joints).transform_point(&self.tip)
    }

    /// Joints at which a point of the flange is truly on a surface, from starts within a share of the ranges, such that
    /// `accept` says yes.
    fn reach(
        &mut self,
        name: &str,
        (point, surface): (Vector3<f64>, Surface),
        share: f64,
        accept: impl Fn(&Self, &[f64]) -> bool,
    ) -> Result<Vec<f64>, OutOfReach> {
        let nominal = self
            .robot
            .chain()
            .map_err(|_| OutOfReach(name.to_owned()))?;
        let ranges = self.ranges.clone();
        let settler = Settler::new(self.robot, &nominal, point, &ranges);
        for _ in 0..STARTS {
            let start = self.joints(share);
            let position = |q: &[f64]| self.flange(q).transform_point(&point);
            if let Some(joints) = settler.settle(&start, surface, position)
                && accept(self, &joints)
            {
                return Ok(joints);
            }
        }
        Err(OutOfReach(name.to_owned()))
    }

    /// A row, and another moment for the arm.
    fn row(&mut self, feature: &str, reading: &str, joints: &[f64]) {
        let _: f64 = self.random().random();
        let mut row = format!("{feature},{reading},{}", self.payload_kg);
        for (joint, q) in self.robot.joints.iter().zip(joints) {
            let _ = write!(row, ",{:.8}", in_file_units(joint.kind, *q));
        }
        row.push('\n');
        self.rows.push(row);
    }

    fn task(&mut self, task: TouchTask, count: usize) -> Result<(), OutOfReach> {
        let word = TOUCH_KINDS.iter().find(|(_, kind)| *kind == task.kind);
        let word = word.map_or("feature", |(word, _)| word);
        let names: Vec<String> = (0..task.features).map(|k| format!("{word}/{k}")).collect();
        match task.kind {
            TouchKind::Socket => self.sockets(&names, count),
            TouchKind::Plane => self.planes(&names, count),
            TouchKind::Sphere => self.spheres(&names, count, BALL),
            TouchKind::Ballbar => {
                let bar = (250.0 * self.robot.reach()).round() / 1e3;
                self.spheres(&names, count, bar)
            }
            TouchKind::Wire => {
                self.wires(&names, count);
                Ok(())
            }
            TouchKind::Level => {
                names
                    .iter()
                    .for_each(|name| self.level(name, count / names.len()));
                Ok(())
            }
            TouchKind::Camera => names
                .iter()
                .try_for_each(|name| self.camera(name, (count / 4 / task.features).max(4))),
        }
    }

    /// A point that the tip reaches in the middle of the ranges.
    fn somewhere(&mut self) -> Vector3<f64> {
        let joints = self.joints(0.5);
        self.tip_at(&joints)
    }

    fn sockets(&mut self, names: &[String], count: usize) -> Result<(), OutOfReach> {
        let mut points: Vec<Vector3<f64>> = Vec::new();
        let apart = 0.15 * self.robot.reach();
        for _ in names {
            let mut point = self.somewhere();
            for _ in 0..STARTS {
                if points.iter().all(|other| (other - point).norm() > apart) {
                    break;
                }
                point = self.somewhere();
            }
            points.push(point);
        }
        for (name, point) in names.iter().zip(&points) {
            let _ = write!(
                self.toml,
                "\n[[feature]]\nname = \"{name}\"\nkind = \"point\"\n"
            );
            for _ in 0..count / names.len() {
                let noise = normal_vector(TOUCH_NOISE, self.random());
                let goal = (self.tip, Surface::Point(point + noise));
                let joints = self.reach(name, goal, 1.0, |_, _| true)?;
                self.row(name, ",,,,,,", &joints);
            }
        }
        for (name, point) in names.iter().zip(&points).skip(1) {
            let measured = (point - points[0]).norm() + LENGTH_NOISE * self.normal();
            let _ = write!(
                self.toml,
                "\n[[distance]]\nbetween = [\"{}\", \"{name}\"]\nmm = {:.3}\nsigma_mm = {}\n",
                names[0],
                1e3 * measured,
                1e3 * LENGTH_NOISE
            );
        }
        Ok(())
    }

    fn planes(&mut self, names: &[String], count: usize) -> Result<(), OutOfReach> {
        let middle = self.somewhere();
        let extent = 0.3 * self.robot.reach();
        for (k, name) in names.iter().enumerate() {
            let _ = write!(
                self.toml,
                "\n[[feature]]\nname = \"{name}\"\nkind = \"plane\"\nflatness_mm = 0.01\n"
            );
            let normal = [Vector3::z(), Vector3::x(), Vector3::y()][k % 3];
            let distance = normal.dot(&middle) + 0.05 * (k / 3) as f64;
            for _ in 0..count / names.len() {
                let noise = TOUCH_NOISE * self.normal();
                let goal = (self.tip, Surface::Plane(normal, distance + noise));
                let near = |me: &Self, q: &[f64]| (me.tip_at(q) - middle).norm() < extent;
                let joints = self.reach(name, goal, 1.0, near)?;
                self.row(name, ",,,,,,", &joints);
            }
        }
        Ok(())
    }

    fn spheres(&mut self, names: &[String], count: usize, radius: f64) -> Result<(), OutOfReach> {
        for name in names {
            let _ = write!(
                self.toml,
                "\n[[feature]]\nname = \"{name}\"\nkind = \"sphere\"\nradius_mm = {}\nradius_sigma_mm = {}\n",
                1e3 * radius,
                1e3 * LENGTH_NOISE
            );
            let true_radius = radius + LENGTH_NOISE * self.normal();
            let centre = self.somewhere() - Vector3::z() * radius;
            let joints_to_centre = |me: &Self, q: &[f64]| {
                // A ball stands on something: nobody touches it from below.
                me.tip_at(q).z > centre.z
            };
            for _ in 0..count / names.len() {
                let noise = TOUCH_NOISE * self.normal();
                let goal = (self.tip, Surface::Sphere(centre, true_radius + noise));
                let joints = self.reach(name, goal, 1.0, joints_to_centre)?;
                self.row(name, ",,,,,,", &joints);
            }
        }
        Ok(())
    }

    fn wires(&mut self, names: &[String], count: usize) {
        let distance = 1.2 * self.robot.reach();
        let mut anchors = Vec::new();
        for (k, name) in names.iter().enumerate() {
            // The first in front and to the right, each further one a third of a turn on.
            let turn = -0.6 + std::f64::consts::TAU / 3.0 * k as f64;
            let at = Vector3::new(distance * libm::cos(turn), distance * libm::sin(turn), 0.03);
            let zero = ZERO_ERROR * self.normal();
            let stated = 1e3 * (at + normal_vector(TAPE_ERROR, self.random()));
            let _ = write!(
                self.toml,
                "\n[[feature]]\nname = \"{name}\"\nkind = \"anchor\"\nposition_mm = [{:.1}, {:.1}, {:.1}]\n\
                 position_sigma_mm = {}\nzero_sigma_mm = {}\n",
                stated.x,
                stated.y,
                stated.z,
                1e3 * TAPE_ERROR,
                1e3 * ZERO_ERROR
            );
            anchors.push((name, at, zero));
        }
        for _ in 0..count / names.len() {
            let joints = self.joints(1.0);
            for (name, at, zero) in &anchors {
                let value = (self.tip_at(&joints) - at).norm() - zero;
                let value = value + TOUCH_NOISE * self.normal();
                self.row(name, &format!(",{:.4},,,,,", 1e3 * value), &joints);
            }
        }
    }

    /// A small rotation that nobody knows.
    fn turn(&mut self) -> Pose<f64> {
        Pose::exp(&Twist {
            linear: Vector3::zeros(),
            angular: normal_vector(MOUNTING_ERROR, self.random()),
        })
    }

    fn level(&mut self, name: &str, count: usize) {
        let _ = write!(
            self.toml,
            "\n[[feature]]\nname = \"{name}\"\nkind = \"level\"\nrotation_sigma_mrad = {}\nsigma_mrad = {}\n",
            1e3 * MOUNTING_ERROR,
            1e3 * LEVEL_NOISE
        );
        let sensor_from_flange = self.turn();
        for _ in 0..count {
            let joints = self.joints(1.0);
            let rotation = self.flange(&joints).rotation.transpose();
            let gravity = sensor_from_flange.rotation * (rotation * -Vector3::z());
            let seen = (gravity + normal_vector(LEVEL_NOISE, self.random())).normalize();
            let reading = format!(",,{:.9},{:.9},{:.9},,", seen.x, seen.y, seen.z);
            self.row(name, &reading, &joints);
        }
    }

    fn camera(&mut self, name: &str, images: usize) -> Result<(), OutOfReach> {
        // The camera looks as the flange does, beside it.
        let drawn = Vector3::new(0.03, -0.05, -0.03);
        let camera_from_flange = Pose {
            translation: drawn + normal_vector(0.5 * TIP_ERROR, self.random()),
            ..self.turn()
        };
        let flange_from_camera = camera_from_flange.inverse();
        let first = self.joints(0.3);
        let board = self.flange(&first) * flange_from_camera;
        let base_from_board = Pose {
            translation: board.transform_point(&Vector3::new(0.0, 0.0, VIEW)),
            ..board
        };
        let [along_x, along_y] = CORNERS.map(|n| {
            let corner = |i| CORNER_STEP * (i as f64 - 0.5 * (n as f64 - 1.0));
            (0..n).map(corner).collect::<Vec<f64>>()
        });
        let corners: Vec<Vector3<f64>> = along_x
            .iter()
            .flat_map(|x| along_y.iter().map(|y| Vector3::new(*x, *y, 0.0)))
            .collect();
        let mm = |all: &[f64]| {
            let all: Vec<String> = all.iter().map(|x| format!("{:.1}", 1e3 * x)).collect();
            all.join(", ")
        };
        let _ = write!(
            self.toml,
            "\n[[feature]]\nname = \"{name}\"\nkind = \"board\"\ncorners_x_mm = [{}]\ncorners_y_mm = [{}]\n\
             sigma_px = {PIXEL_NOISE}\n",
            mm(&along_x),
            mm(&along_y)
        );
        if !self.toml.contains("[camera]") {
            let [u, v] = HALF_IMAGE;
            let [x, y, z] = [drawn.x, drawn.y, drawn.z].map(|x| 1e3 * x);
            let _ = write!(
                self.toml,
                "\n[camera]\nfocal_px = [{FOCAL}, {FOCAL}]\ncentre_px = [{u}, {v}]\n\
                 position_mm = [{x}, {y}, {z}]\nposition_sigma_mm = {}\nrotation_vector_rad = [0, 0, 0]\n\
                 rotation_sigma_mrad = {}\n",
                1e3 * TIP_ERROR,
                1e3 * MOUNTING_ERROR
            );
        }
        let image = |me: &Self, q: &[f64]| -> Option<Vec<[f64; 2]>> {
            let camera_from_board = camera_from_flange * me.flange(q).inverse() * base_from_board;
            let seen = |corner: &Vector3<f64>| {
                let at = camera_from_board.transform_point(corner);
                let pixel = [at.x, at.y].map(|x| FOCAL * x / at.z);
                let inside = pixel.iter().zip(HALF_IMAGE).all(|(p, half)| p.abs() < half);
                (at.z > 0.1 && inside)
                    .then_some([pixel[0] + HALF_IMAGE[0], pixel[1] + HALF_IMAGE[1]])
            };
            // Flat on, the corners tell least: at most 60 degrees.
            let towards = camera_from_board.rotation * Vector3::z();
            corners
                .iter()
                .map(seen)
                .collect::<Option<_>>()
                .filter(|_| towards.z > 0.5)
        };
        for _ in 0..images {
            let depth = VIEW + 0.1 * (self.random().random::<f64>() - 0.5);
            let looked_at = flange_from_camera.transform_point(&Vector3::new(0.0, 0.0, depth));
            let goal = (looked_at, Surface::Point(base_from_board.translation));
            let joints = self.reach(name, goal, 1.0, |me, q| image(me, q).is_some())?;
            let seen = image(self, &joints).unwrap_or_default();
            for (corner, [u, v]) in seen.into_iter().enumerate() {
                let [u, v] = [u, v].map(|x| x + PIXEL_NOISE * self.normal());
                let mut row = format!("{name},{corner},,,,,{u:.4},{v:.4},{}", self.payload_kg);
                for (joint, q) in self.robot.joints.iter().zip(&joints) {
                    let _ = write!(row, ",{:.8}", in_file_units(joint.kind, *q));
                }
                row.push('\n');
                self.rows.push(row);
            }
            let _: f64 = self.random().random();
        }
        Ok(())
    }

    fn joint_names(&self) -> String {
        let name = |(i, kind): (usize, JointKind)| match kind {
            JointKind::Revolute => format!("q{i}_deg"),
            JointKind::Prismatic => format!("q{i}_mm"),
        };
        let kinds = self.robot.joints.iter().map(|joint| joint.kind);
        let names: Vec<String> = (1..).zip(kinds).map(name).collect();
        names.join(",")
    }

    fn truth(&mut self, count: usize, comment: &str) -> String {
        let mut out = format!(
            "# {comment}; where the tip truly is in the base frame, without noise: for scoring only\npayload_kg,{},x_mm,y_mm,z_mm\n",
            self.joint_names()
        );
        for _ in 0..count {
            let joints = self.joints(1.0);
            let tip = self.tip_at(&joints);
            let _ = write!(out, "{}", self.payload_kg);
            for (joint, q) in self.robot.joints.iter().zip(&joints) {
                let _ = write!(out, ",{:.8}", in_file_units(joint.kind, *q));
            }
            let _ = writeln!(
                out,
                ",{:.6},{:.6},{:.6}",
                1e3 * tip.x,
                1e3 * tip.y,
                1e3 * tip.z
            );
        }
        out
    }
}
