//! Simulates readings without a touch: draw-wires, levels and cameras.

use std::fmt::Write as _;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;
use rand::RngExt;

use super::{OutOfReach, TIP_ERROR, TOUCH_NOISE, Touching, milli};
use crate::numeric::rotation::turn;
use crate::robot::settle::Surface;
use crate::simulation::true_arm::normal_vector;

/// Standard deviation of an anchor measured with a tape, and of the zero of its wire, in m.
const TAPE_ERROR: f64 = 20e-3;
const ZERO_ERROR: f64 = 1e-3;
/// Standard deviation of the rotation of a sensor at the flange, and noise of a level, in rad.
const MOUNTING_ERROR: f64 = 20e-3;
const LEVEL_NOISE: f64 = 0.05e-3;
/// Focal length, half the image size, and noise, in pixels.
const FOCAL: f64 = 1500.0;
const HALF_IMAGE: [f64; 2] = [960.0, 600.0];
const PIXEL_NOISE: f64 = 0.1;
/// Distance from the camera to the board, in m.
const VIEW: f64 = 0.45;
/// Distance between adjacent corners of a board, in m, and the number of corners along x and y.
const CORNER_STEP: f64 = 0.05;
const CORNERS: [usize; 2] = [5, 4];

/// A draw-wire: where its anchor truly is, and by how much its readings are too small, in m.
#[derive(Clone, Copy)]
pub(super) struct Wire {
    pub at: Vector3<f64>,
    pub zero: f64,
}

impl Touching<'_> {
    pub(super) fn wires(&mut self, names: &[String], count: usize) {
        let distance = 1.2 * self.robot.reach();
        let mut anchors = Vec::new();
        for (k, name) in names.iter().enumerate() {
            // The first anchor is in front and to the right, each further one a third of a turn on.
            let turn = -0.6 + std::f64::consts::TAU / 3.0 * k as f64;
            let at = Vector3::new(distance * libm::cos(turn), distance * libm::sin(turn), 0.03);
            let zero = ZERO_ERROR * self.normal();
            let stated = at + normal_vector(TAPE_ERROR, self.random());
            self.describe_wire(name, stated, [TAPE_ERROR, ZERO_ERROR]);
            anchors.push((name, Wire { at, zero }));
        }
        for _ in 0..count / names.len() {
            let joints = self.joints(1.0);
            for (name, wire) in &anchors {
                self.read_wire(name, wire, &joints);
            }
        }
    }

    /// Describes a draw-wire by its stated anchor in m and the standard deviations of anchor and zero.
    pub(super) fn describe_wire(&mut self, name: &str, stated: Vector3<f64>, sigma: [f64; 2]) {
        let stated = 1e3 * stated;
        let [position_sigma, zero_sigma] = sigma.map(milli);
        let _ = write!(
            self.toml,
            "\n[[feature]]\nname = \"{name}\"\nkind = \"anchor\"\nposition_mm = [{:.1}, {:.1}, {:.1}]\n\
             position_sigma_mm = {position_sigma}\nzero_sigma_mm = {zero_sigma}\n",
            stated.x, stated.y, stated.z
        );
    }

    /// Reads a draw-wire at these joints.
    pub(super) fn read_wire(&mut self, name: &str, wire: &Wire, joints: &[f64]) {
        let value = (self.tip_at(joints) - wire.at).norm() - wire.zero;
        let value = value + TOUCH_NOISE * self.normal();
        self.row(name, &format!(",{:.4},,,,,", 1e3 * value), joints);
    }

    /// Draws a small unknown rotation.
    fn turn(&mut self) -> Pose<f64> {
        turn(normal_vector(MOUNTING_ERROR, self.random()))
    }

    pub(super) fn level(&mut self, name: &str, count: usize) {
        let _ = write!(
            self.toml,
            "\n[[feature]]\nname = \"{name}\"\nkind = \"level\"\nrotation_sigma_mrad = {}\nsigma_mrad = {}\n",
            milli(MOUNTING_ERROR),
            milli(LEVEL_NOISE)
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

    pub(super) fn camera(&mut self, name: &str, images: usize) -> Result<(), OutOfReach> {
        // The camera is beside the flange and looks in its direction.
        let nominal = Vector3::new(0.03, -0.05, -0.03);
        let camera_from_flange = Pose {
            translation: nominal + normal_vector(0.5 * TIP_ERROR, self.random()),
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
            let [x, y, z] = [nominal.x, nominal.y, nominal.z].map(milli);
            let _ = write!(
                self.toml,
                "\n[camera]\nfocal_px = [{FOCAL}, {FOCAL}]\ncentre_px = [{u}, {v}]\n\
                 position_mm = [{x}, {y}, {z}]\nposition_sigma_mm = {}\nrotation_vector_rad = [0, 0, 0]\n\
                 rotation_sigma_mrad = {}\n",
                milli(TIP_ERROR),
                milli(MOUNTING_ERROR)
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
            // Corners seen at a grazing angle give the least information: at most 60 degrees from the board's normal.
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
                let reading = format!("{corner},,,,,{u:.4},{v:.4}");
                self.row_at_once(name, &reading, &joints);
            }
            let _: f64 = self.random().random();
        }
        Ok(())
    }
}
