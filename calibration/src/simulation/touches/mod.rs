//! Touches of a simulated arm: sockets, planes, balls, ballbars, draw-wires, levels and boards, with their description.
//!
//! The operator moves the arm until its true tip is at the feature, up to the noise of a touch, and records the joints that
//! the controller shows. What the description states about tip, anchors and camera has errors of its stated σ.

mod planned;
mod sensors;
mod table;

use std::fmt::Write as _;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::robot::settle::{Settler, Surface};
use crate::robot::{Robot, in_file_units};
use crate::simulation::Simulator;
use crate::simulation::touches::table::Row;
use crate::simulation::true_arm::normal_vector;

/// Noise of one component of a touch, in m.
const TOUCH_NOISE: f64 = 0.05e-3;
/// The nominal tip, in m in the flange frame, and the standard deviation of its error.
const TIP: [f64; 3] = [0.02, 0.01, 0.15];
const TIP_ERROR: f64 = 1e-3;
/// Standard deviation of a known distance or radius, in m.
const LENGTH_NOISE: f64 = 0.015e-3;
/// Distance from the centre of a ball to the centre of the tip, in m.
const BALL: f64 = 50e-3;
/// Number of starts of one touch before it is given up.
const STARTS: usize = 500;

/// Kind of feature that is touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchKind {
    /// A ball in sockets; if there are several, the distances from the first are known.
    Socket,
    /// Planes that are perpendicular to each other.
    Plane,
    /// Balls whose centres are 50 mm from the centre of the tip.
    Sphere,
    /// A bar of fixed length about several centres.
    Ballbar,
    /// Draw-wires that are read at the same time.
    Wire,
    /// An inclinometer at the flange.
    Level,
    /// A camera at the flange that looks at a board.
    Camera,
}

/// The kinds, with their names in a command and in features.
pub const TOUCH_KINDS: [(&str, TouchKind); 7] = [
    ("socket", TouchKind::Socket),
    ("plane", TouchKind::Plane),
    ("sphere", TouchKind::Sphere),
    ("ballbar", TouchKind::Ballbar),
    ("wire", TouchKind::Wire),
    ("level", TouchKind::Level),
    ("camera", TouchKind::Camera),
];

/// A touch task: a kind of feature and the number of such features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TouchTask {
    /// Kind of the features.
    pub kind: TouchKind,
    /// Number of features, 1 to 9.
    pub features: usize,
}

/// Simulated touches and their description.
#[derive(Clone, Debug)]
pub struct SimulatedTouches {
    /// Content of the touch file.
    pub csv: String,
    /// Content of the feature file.
    pub toml: String,
    /// Number of rows in the touch file.
    pub rows: usize,
}

/// Converts to thousandths of the unit, without the digits that the multiplication leaves behind.
fn milli(x: f64) -> f64 {
    (1e9 * x).round() / 1e6
}

/// The error that the arm cannot reach a feature.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no way to \"{0}\" within the joint ranges")]
pub struct OutOfReach(pub String);

/// The arm with its tip, and what has been touched so far.
struct Touching<'a> {
    robot: &'a Robot,
    simulator: &'a mut Simulator,
    payload_kg: f64,
    ranges: Vec<(f64, f64)>,
    /// The true tip in the flange frame, in m.
    tip: Vector3<f64>,
    rows: Vec<Row>,
    toml: String,
}

impl Simulator {
    /// Touches features, `count` times for each task. The second result is a measurement file of the true tip at `truth`
    /// random poses, in the base frame and without noise.
    ///
    /// # Errors
    /// Returns [`OutOfReach`] if the arm cannot reach a feature from five hundred starts.
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
            toml: description_of_tip(comment, Vector3::from(TIP)),
        };
        for task in tasks {
            touching.task(*task, count)?;
        }
        Ok(touching.finished(truth, comment))
    }
}

fn description_of_tip(comment: &str, tip: Vector3<f64>) -> String {
    let [x, y, z] = [tip.x, tip.y, tip.z].map(milli);
    format!(
        "# {comment}\nversion = 1\n\n[noise]\ntouch_mm = {}\n\n[prior]\nlength_mm = 0.8\ntilt_mrad = 0.8\njoint_zero_mrad = 0.8\n\n\
         [[target]]\nname = \"tip\"\ntip_mm = [{x}, {y}, {z}]\nsigma_mm = {}\n",
        milli(TOUCH_NOISE),
        milli(TIP_ERROR)
    )
}

impl Touching<'_> {
    /// Returns both files and the file of the truth.
    fn finished(mut self, truth: usize, comment: &str) -> (SimulatedTouches, String) {
        let names = self.joint_names();
        let csv = table::csv(comment, &names, &self.rows);
        let touches = SimulatedTouches {
            csv,
            rows: self.rows.len(),
            toml: std::mem::take(&mut self.toml),
        };
        let truth = self.truth(truth, comment);
        (touches, truth)
    }

    /// Returns joints near `start` at which a point of the flange is truly on a surface.
    fn seated(&self, start: &[f64], point: Vector3<f64>, surface: Surface) -> Option<Vec<f64>> {
        let nominal = self.robot.chain().ok()?;
        let settler = Settler::new(self.robot, &nominal, point, &self.ranges);
        let position = |q: &[f64]| self.flange(q).transform_point(&point);
        settler.settle(start, surface, position)
    }

    fn random(&mut self) -> &mut ChaCha8Rng {
        &mut self.simulator.random
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(self.random())
    }

    /// Draws joints within a share of each range, about its middle.
    fn joints(&mut self, share: f64) -> Vec<f64> {
        let ranges = self.ranges.clone();
        let random = self.random();
        let joint = |(lower, upper): (f64, f64)| {
            let middle = 0.5 * (lower + upper);
            middle + share * (upper - lower) * (random.random::<f64>() - 0.5)
        };
        ranges.into_iter().map(joint).collect()
    }

    /// Returns the true flange at these joints, for the current state of the random numbers.
    fn flange(&self, joints: &[f64]) -> Pose<f64> {
        let mut moment = self.simulator.random.clone();
        self.simulator
            .arm
            .base_from_flange(joints, self.payload_kg, &mut moment)
    }

    fn tip_at(&self, joints: &[f64]) -> Vector3<f64> {
        self.flange(joints).transform_point(&self.tip)
    }

    /// Finds joints at which a point of the flange is truly on a surface and which `accept` accepts, from starts within a
    /// share of the ranges.
    fn reach(
        &mut self,
        name: &str,
        (point, surface): (Vector3<f64>, Surface),
        share: f64,
        accept: impl Fn(&Self, &[f64]) -> bool,
    ) -> Result<Vec<f64>, OutOfReach> {
        for _ in 0..STARTS {
            let start = self.joints(share);
            if let Some(joints) = self.seated(&start, point, surface)
                && accept(self, &joints)
            {
                return Ok(joints);
            }
        }
        Err(OutOfReach(name.to_owned()))
    }

    /// Adds a row and advances the random state of the arm.
    fn row(&mut self, feature: &str, reading: &str, joints: &[f64]) {
        let _: f64 = self.random().random();
        self.row_at_once(feature, reading, joints);
    }

    /// Adds a row without advancing the random state, so that it belongs to the same moment as the row before it.
    fn row_at_once(&mut self, feature: &str, reading: &str, joints: &[f64]) {
        let mut state = format!(",{}", self.payload_kg);
        for (joint, q) in self.robot.joints.iter().zip(joints) {
            let _ = write!(state, ",{:.8}", in_file_units(joint.kind, *q));
        }
        self.rows.push(Row {
            feature: feature.to_owned(),
            reading: reading.to_owned(),
            state,
        });
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

    /// Returns a point that the tip reaches in the middle of the ranges.
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
        let placed: Vec<(String, Vector3<f64>)> = names.iter().cloned().zip(points).collect();
        for (name, point) in &placed {
            for _ in 0..count / names.len() {
                let noise = normal_vector(TOUCH_NOISE, self.random());
                let goal = (self.tip, Surface::Point(point + noise));
                let joints = self.reach(name, goal, 1.0, |_, _| true)?;
                self.row(name, ",,,,,,", &joints);
            }
        }
        self.describe_sockets(&placed);
        Ok(())
    }

    /// Describes sockets and their distances from the first.
    fn describe_sockets(&mut self, placed: &[(String, Vector3<f64>)]) {
        for (name, _) in placed {
            let _ = write!(
                self.toml,
                "\n[[feature]]\nname = \"{name}\"\nkind = \"point\"\n"
            );
        }
        let Some(((first, from), others)) = placed.split_first() else {
            return;
        };
        for (name, point) in others {
            let measured = (point - from).norm() + LENGTH_NOISE * self.normal();
            let _ = write!(
                self.toml,
                "\n[[distance]]\nbetween = [\"{first}\", \"{name}\"]\nmm = {:.3}\nsigma_mm = {}\n",
                1e3 * measured,
                milli(LENGTH_NOISE)
            );
        }
    }

    fn describe_plane(&mut self, name: &str) {
        let _ = write!(
            self.toml,
            "\n[[feature]]\nname = \"{name}\"\nkind = \"plane\"\nflatness_mm = 0.01\n"
        );
    }

    fn planes(&mut self, names: &[String], count: usize) -> Result<(), OutOfReach> {
        let middle = self.somewhere();
        let extent = 0.3 * self.robot.reach();
        for (k, name) in names.iter().enumerate() {
            self.describe_plane(name);
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
                milli(radius),
                milli(LENGTH_NOISE)
            );
            let true_radius = radius + LENGTH_NOISE * self.normal();
            let centre = self.somewhere() - Vector3::z() * radius;
            let joints_to_centre = |me: &Self, q: &[f64]| {
                // A ball rests on something, so it cannot be touched from below.
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

    fn joint_names(&self) -> String {
        self.robot.file_columns().join(",")
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
