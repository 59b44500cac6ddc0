//! Initial estimates: where features are, roughly, on the nominal arm. The fit starts from these.

use nalgebra::{Matrix3, Vector2, Vector3};
use poegp_runtime::math::se3::Pose;

use crate::identification::touch::form::Form;
use crate::identification::touch::scene::across;
use crate::identification::touch::scene::{Figure, in_plane};
use crate::measurement::touch::{Board, Camera, FeatureKind, Mount, Reading, TouchRow, TouchSet};
use crate::numeric::matrix::Mat;
use crate::numeric::rotation::nearest_rotation;
use crate::numeric::rotation::{centroid, turn};

/// Estimates the figure of a feature from the poses of its rows: base_from_tip, or base_from_flange for levels and
/// boards.
pub fn figure(
    set: &TouchSet,
    feature: usize,
    rows: &[(&TouchRow, Pose<f64>)],
    gravity: &Vector3<f64>,
) -> Figure {
    let points: Vec<Vector3<f64>> = rows.iter().map(|(_, tip)| tip.translation).collect();
    let values: Vec<f64> = rows.iter().map(|(row, _)| value(&row.reading)).collect();
    match &set.features[feature].kind {
        FeatureKind::Point { seat } => Figure::Point {
            centre: centroid(&points),
            seat: (*seat > 0.0).then(|| {
                let form = Form::directions();
                let count = 3 * form.count();
                (form, vec![0.0; count])
            }),
        },
        FeatureKind::Plane { flatness } => {
            let (normal, offset) = plane(&points, &values);
            let origin = centroid(&points);
            let axes = axes_of(&normal);
            let form = || {
                let at: Vec<Vector2<f64>> =
                    points.iter().map(|p| in_plane(&axes, &origin, p)).collect();
                let form = Form::grid(&at);
                let count = form.count();
                (form, vec![0.0; count])
            };
            Figure::Plane {
                origin,
                axes,
                offset: offset - normal.dot(&origin),
                flatness: (*flatness > 0.0).then(form),
            }
        }
        FeatureKind::Sphere {
            radius, roundness, ..
        } => {
            let (centre, found) = sphere(&points, &values, *radius);
            Figure::Sphere {
                centre,
                radius: radius.unwrap_or(found),
                roundness: (*roundness > 0.0).then(|| {
                    let form = Form::directions();
                    let count = form.count();
                    (form, vec![0.0; count])
                }),
            }
        }
        FeatureKind::Anchor { position, .. } => Figure::Anchor {
            position: position.unwrap_or_else(|| sphere(&points, &values, Some(0.0)).0),
            zero: 0.0,
            scale: 0.0,
        },
        FeatureKind::Level { rotation, .. } => Figure::Level {
            sensor_from_flange: turn(*rotation).rotation,
            gravity: gravity.normalize(),
        },
        FeatureKind::Board(board) => Figure::Board {
            pose: set.camera.map_or(Pose::identity(), |camera| {
                board_pose(board, &camera, rows).unwrap_or(Pose::identity())
            }),
            scale: 0.0,
        },
    }
}

fn value(reading: &Reading) -> f64 {
    match reading {
        Reading::Plane { value, .. }
        | Reading::Sphere { value, .. }
        | Reading::Anchor { value, .. } => *value,
        _ => 0.0,
    }
}

/// Returns two directions perpendicular to a normal, and the normal, as columns.
fn axes_of(normal: &Vector3<f64>) -> Matrix3<f64> {
    let (a, b) = across(normal);
    Matrix3::from_columns(&[a, b, *normal])
}

/// Returns n and d of the least-squares plane n·x = d + value.
fn plane(points: &[Vector3<f64>], values: &[f64]) -> (Vector3<f64>, f64) {
    let middle = centroid(points);
    let mut scatter = Matrix3::zeros();
    let mut along = Vector3::zeros();
    let mean_value = values.iter().sum::<f64>() / values.len().max(1) as f64;
    for (point, value) in points.iter().zip(values) {
        let from = point - middle;
        scatter += from * from.transpose();
        along += from * (value - mean_value);
    }
    let eigen = scatter.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let flat = eigen.eigenvectors.column(least).into_owned();
    let spread = eigen.eigenvalues[least].max(0.0) / points.len().max(1) as f64;
    let heights = values.iter().map(|v| (v - mean_value).powi(2)).sum::<f64>();
    // With a dial gauge that travels, the heights show which way the plane faces.
    let normal = if heights / points.len().max(1) as f64 > 0.25 * spread && heights > 0.0 {
        let ridge = Matrix3::identity() * (1e-9 * scatter.trace());
        let solved = (scatter + ridge).try_inverse().map(|i| i * along);
        match solved {
            Some(n) if n.norm() > 0.5 => n.normalize(),
            _ => flat,
        }
    } else {
        flat
    };
    (normal, normal.dot(&middle) - mean_value)
}

/// Returns centre and radius of |x − c| = r + value by linear least squares; a known radius is not fitted.
fn sphere(points: &[Vector3<f64>], values: &[f64], known: Option<f64>) -> (Vector3<f64>, f64) {
    let middle = centroid(points);
    // |x|² − value² = 2 c·x + 2 r value + k with k = r² − |c|².
    let travels = values.iter().any(|v| *v != 0.0) && known.is_none_or(|r| r == 0.0);
    let mut a = Mat::zeros(points.len(), 5);
    let mut b = Mat::zeros(points.len(), 1);
    for (i, (point, value)) in points.iter().zip(values).enumerate() {
        let from = point - middle;
        for k in 0..3 {
            a[(i, k)] = 2.0 * from[k];
        }
        a[(i, 3)] = 1.0;
        a[(i, 4)] = if travels && known.is_none() {
            2.0 * value
        } else {
            0.0
        };
        b[(i, 0)] = from.norm_squared() - value * value;
    }
    let scale = a.norm_squared() / points.len().max(1) as f64;
    let mut normal = a.transpose() * &a;
    for i in 0..5 {
        normal[(i, i)] += 1e-10 * scale.max(1e-12);
    }
    let right = a.transpose() * b;
    let Some(x) = normal.cholesky().map(|c| c.solve(&right)) else {
        return (middle, known.unwrap_or(0.0));
    };
    let off = Vector3::new(x[(0, 0)], x[(1, 0)], x[(2, 0)]);
    let centre = middle + off;
    let distances = points
        .iter()
        .zip(values)
        .map(|(p, v)| (p - centre).norm() - v);
    let radius = distances.sum::<f64>() / points.len().max(1) as f64;
    (centre, radius)
}

/// A corner of a board, m, and its image, pixels.
type SeenCorner = (Vector3<f64>, [f64; 2]);

/// Largest number of images from which the pose of a board is tried.
const TRIED: usize = 12;

/// Returns base_from_board (flange_from_board for a fixed camera) of a plane board, from the image whose pose explains
/// the other images best.
fn board_pose(
    board: &Board,
    camera: &Camera,
    rows: &[(&TouchRow, Pose<f64>)],
) -> Option<Pose<f64>> {
    let mut images: Vec<(Pose<f64>, Vec<SeenCorner>)> = Vec::new();
    for (row, flange) in rows {
        let Reading::Board { corner, u, v, .. } = row.reading else {
            continue;
        };
        let seen = (board.corners[corner], [u, v]);
        match images.iter_mut().find(|(pose, _)| pose == flange) {
            Some((_, corners)) => corners.push(seen),
            None => images.push((*flange, vec![seen])),
        }
    }
    images.sort_by_key(|(_, corners)| std::cmp::Reverse(corners.len()));
    let camera_from_mount = camera.camera_from_mount;
    let of = |flange: &Pose<f64>, camera_from_board: &Pose<f64>| match camera.mount {
        Mount::Flange => *flange * camera_from_mount.inverse() * *camera_from_board,
        Mount::Fixed => flange.inverse() * camera_from_mount.inverse() * *camera_from_board,
    };
    let seen_by_camera = |flange: &Pose<f64>, board: &Pose<f64>| match camera.mount {
        Mount::Flange => camera_from_mount * flange.inverse() * *board,
        Mount::Fixed => camera_from_mount * *flange * *board,
    };
    let cost = |pose: &Pose<f64>| -> f64 {
        let mut errors: Vec<f64> = Vec::new();
        for (flange, corners) in &images {
            let at = seen_by_camera(flange, pose);
            for (corner, image) in corners {
                let p = at.transform_point(corner);
                let depth = p[2].max(1e-3);
                let du = camera.focal[0] * p[0] / depth + camera.centre[0] - image[0];
                let dv = camera.focal[1] * p[1] / depth + camera.centre[1] - image[1];
                errors.push(libm::hypot(du, dv));
            }
        }
        errors.sort_by(f64::total_cmp);
        errors
            .get(errors.len() / 2)
            .copied()
            .unwrap_or(f64::INFINITY)
    };
    let poses = images.iter().take(TRIED).filter_map(|(flange, corners)| {
        let camera_from_board = homography_pose(camera, corners)?;
        Some(of(flange, &camera_from_board))
    });
    let mut poses: Vec<(f64, Pose<f64>)> = poses.map(|pose| (cost(&pose), pose)).collect();
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    poses.first().map(|(_, pose)| *pose)
}

/// Returns camera_from_board from one image of a plane board (Zhang 2000): the homography by the direct linear transform,
/// then the rotation nearest to its columns. Returns `None` for fewer than four corners or a board that is not plane.
fn homography_pose(camera: &Camera, corners: &[SeenCorner]) -> Option<Pose<f64>> {
    if corners.len() < 4 || corners.iter().any(|(p, _)| p[2].abs() > 1e-6) {
        return None;
    }
    let size = corners.iter().map(|(p, _)| p.norm()).fold(1e-6, f64::max);
    let mut a = Mat::zeros(9, 9);
    for (p, image) in corners {
        let x = (image[0] - camera.centre[0]) / camera.focal[0];
        let y = (image[1] - camera.centre[1]) / camera.focal[1];
        let w = [p[0] / size, p[1] / size, 1.0];
        let mut rows = [[0.0; 9]; 2];
        for i in 0..3 {
            rows[0][i] = w[i];
            rows[0][6 + i] = -x * w[i];
            rows[1][3 + i] = w[i];
            rows[1][6 + i] = -y * w[i];
        }
        for row in rows {
            for i in 0..9 {
                for j in 0..9 {
                    a[(i, j)] += row[i] * row[j];
                }
            }
        }
    }
    let eigen = a.symmetric_eigen();
    let h = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    let column = |i: usize| Vector3::new(h[i], h[3 + i], h[6 + i]);
    let (mut first, mut second, mut third) = (column(0) / size, column(1) / size, column(2));
    let scale = 0.5 * (first.norm() + second.norm());
    if scale <= 0.0 {
        return None;
    }
    // Choose the sign that puts the board in front of the camera.
    let scale = if third[2] < 0.0 { -scale } else { scale };
    first /= scale;
    second /= scale;
    third /= scale;
    let rotation = nearest_rotation(&Matrix3::from_columns(&[
        first,
        second,
        first.cross(&second),
    ]));
    Some(Pose {
        rotation,
        translation: third,
    })
}
