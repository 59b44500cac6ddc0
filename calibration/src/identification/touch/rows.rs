//! The equations of every kind of row.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::{Pose, skew};

use crate::identification::touch::jet::RowJet;
use crate::identification::touch::scene::{Figure, Scene, across};
use crate::measurement::observation::Observation;
use crate::measurement::touch::{FeatureKind, Mount, Reading, TouchSet};
use crate::numeric::rotation::rotated;

impl Scene {
    /// Linearises a row at base_from_tip of its tip; for levels and boards, at base_from_flange.
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
                    FeatureKind::Board(board) => board.corners[corner],
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
            // How a ball lies in its socket depends on the orientation of the tool.
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
        // The first two unknowns turn the normal towards the first and the second direction.
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
        // The corner as seen from the camera's mount, with its derivatives by the corner and by displacement and rotation
        // of the flange.
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
            let between = instrument.rotation * tip.rotation * pose.rotation.transpose();
            let turn = rotated(between).log().angular;
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

/// Returns the length and the direction of a vector.
fn towards(v: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let length = v.norm();
    (length, v / length.max(1e-9))
}
