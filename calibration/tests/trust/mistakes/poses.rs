//! Poses in a wrong frame, with a wrong handedness, or with orientations in another convention.

use nalgebra::{Matrix3, Rotation3, Vector3};
use poegp_calibration::trust::Cause::{
    self, Axes, Inverse, Mirror, NoFit, Orientation, Quaternion, Rows, Sign, Swap,
};
use poegp_runtime::math::se3::Pose;

use rand::seq::SliceRandom;

use crate::mistakes::{List, any_pose, direction, turn};
use crate::table::Table;

pub fn add(list: &mut List) {
    axes(list);
    if !list.good.positions_only() {
        quaternions(list);
    }
}

/// Writes the position columns `order` into x, y, z.
fn order_positions(table: &mut Table, order: [usize; 3]) {
    let columns = table.position();
    for row in &mut table.rows {
        let old = columns.map(|c| row[c].clone());
        for (axis, from) in order.into_iter().enumerate() {
            row[columns[axis]].clone_from(&old[from]);
        }
    }
}

fn axes(list: &mut List) {
    let right: &[Cause] = &[Axes, Mirror, Orientation];
    for (name, order) in [
        ("axes: x and y exchanged", [1, 0, 2]),
        ("axes: y and z exchanged", [0, 2, 1]),
    ] {
        list.add(name, right, move |t, _| order_positions(t, order));
    }
    let positions_only = list.good.positions_only();
    // Equivalent to another order of the quaternion's x, y, z with another base and tool.
    let right: &[Cause] = &[Axes, Quaternion, Orientation];
    list.add("axes: x, y, z rotated among themselves", right, |t, _| {
        order_positions(t, [1, 2, 0])
    })
    .unseen(positions_only, "a proper rotation of the instrument");
    for axis in 0..3 {
        let name = format!("axes: {} reversed", ["x", "y", "z"][axis]);
        list.add(name, &[Mirror, Axes, Sign, Orientation], move |t, _| {
            t.map(t.position()[axis], |_, v| -v);
        });
    }
    if positions_only {
        return;
    }
    list.add(
        "orientation: 1 deg in another frame than the positions",
        &[Orientation],
        |t, r| {
            let by = turn(direction(1.0_f64.to_radians(), r));
            t.map_all_poses(|_, p| Pose {
                rotation: by.rotation * p.rotation,
                ..p
            });
        },
    )
    .unless_absorbed();
    list.add(
        "mirror: a left-handed instrument",
        &[Mirror, Sign, Axes],
        |t, _| {
            let m = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
            t.map_all_poses(|_, p| Pose {
                rotation: m * p.rotation * m,
                translation: m * p.translation,
            });
        },
    )
    .unless_absorbed();
    list.add(
        "inverse: the instrument seen from the target",
        &[Inverse, Swap],
        |t, _| {
            t.map_all_poses(|_, p| p.inverse());
        },
    );
}

fn quaternions(list: &mut List) {
    list.add("quaternion: w last", &[Quaternion], |t, _| {
        let [w, x, y, z] = t.orientation().expect("orientations");
        for row in &mut t.rows {
            let old = [x, y, z, w].map(|c| row[c].clone());
            for (column, text) in [w, x, y, z].into_iter().zip(old) {
                row[column] = text;
            }
        }
    });
    list.add(
        "quaternion: w first under a header with w last",
        &[Quaternion],
        |t, _| {
            let [w, x, y, z] = t.orientation().expect("orientations");
            for row in &mut t.rows {
                let old = [z, w, x, y].map(|c| row[c].clone());
                for (column, text) in [w, x, y, z].into_iter().zip(old) {
                    row[column] = text;
                }
            }
        },
    );
    for component in 0..4 {
        let name = format!("quaternion: sign of {}", ["w", "x", "y", "z"][component]);
        list.add(name, &[Quaternion, Inverse, Orientation], move |t, _| {
            t.map(t.orientation().expect("orientations")[component], |_, v| -v);
        });
    }
    let right: &[Cause] = &[Orientation, Quaternion, NoFit, Axes];
    list.add(
        "orientation: in the robot's base, positions not",
        right,
        |t, r| {
            let base = any_pose(1.0, r).rotation;
            t.map_all_poses(|_, p| Pose {
                rotation: base * p.rotation,
                ..p
            });
        },
    );
    list.add(
        "orientation: of other rows",
        &[Orientation, Rows, NoFit],
        |t, r| {
            let mut order: Vec<usize> = (0..t.len()).collect();
            order.shuffle(r);
            let columns = t.orientation().expect("orientations");
            t.take(&columns, |i| order[i]);
        },
    );
    let rx = |a| Rotation3::from_axis_angle(&Vector3::x_axis(), a);
    let ry = |a| Rotation3::from_axis_angle(&Vector3::y_axis(), a);
    let rz = |a| Rotation3::from_axis_angle(&Vector3::z_axis(), a);
    let right: &[Cause] = &[Quaternion, Orientation, NoFit];
    let mut euler =
        |name: &str, compose: fn([Rotation3<f64>; 3]) -> Rotation3<f64>, factor: f64| {
            list.add(name, right, move |t, _| {
                t.map_all_poses(|_, p| {
                    let r = p.rotation;
                    // R = Rz(c) Ry(b) Rx(a).
                    let a = libm::atan2(r[(2, 1)], r[(2, 2)]);
                    let b = libm::asin((-r[(2, 0)]).clamp(-1.0, 1.0));
                    let c = libm::atan2(r[(1, 0)], r[(0, 0)]);
                    let turns = [rx(factor * a), ry(factor * b), rz(factor * c)];
                    Pose {
                        rotation: compose(turns).into_inner(),
                        ..p
                    }
                });
            });
        };
    euler(
        "quaternion: angles ZYX read as XYZ",
        |[x, y, z]| x * y * z,
        1.0,
    );
    euler(
        "quaternion: angles ZYX read as ZXY",
        |[x, y, z]| z * x * y,
        1.0,
    );
    euler(
        "quaternion: angles in rad read as deg",
        |[x, y, z]| z * y * x,
        1f64.to_radians(),
    );
}
