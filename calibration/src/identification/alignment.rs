//! Fits base and tools on the nominal arm, robustly and fast enough for some hundred readings of a file.
//!
//! The model is M = X F Y with measured poses M, flanges F, base X and tools Y. The rotations start from the singular
//! vectors of Σ M_ij F_ab (9×9) and from 24 rotated tools, and alternate between X and Y. The translations follow from one
//! linear fit. Gauss–Newton steps with weights against outliers refine both.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::identification::frame_fit::indistinct_shifts;
use crate::measurement::observation::Observation;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::rotation::{aligned, nearest_rotation};
use crate::numeric::rotation::{rotated, turn};
use crate::numeric::statistics::{median, quantile};
use crate::numeric::svd::Svd;

/// Length in m that weighs as much as a radian.
pub const LEVER: f64 = 1.0 / 3.0;

/// One row of a file according to a reading.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Nominal `base_from_flange`.
    pub flange: Pose<f64>,
    /// Observed `instrument_from_target`.
    pub seen: Observation,
    /// Index of the tool that carried the target.
    pub tool: usize,
}

/// The base and tools that best fit some rows.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// `instrument_from_base`.
    pub base: Pose<f64>,
    /// `flange_from_target` of each tool.
    pub tools: Vec<Pose<f64>>,
    /// Median position residual in m.
    pub position: f64,
    /// Median rotation residual in rad; 0 for position-only rows.
    pub rotation: f64,
}

impl Alignment {
    /// Returns the predicted `instrument_from_target` of a row.
    fn predicted(&self, row: &Row) -> Pose<f64> {
        self.base * row.flange * self.tools[row.tool]
    }

    /// Position residual in m and rotation residual in rad of a row; a row with a tool that was not fitted is nowhere near.
    pub fn residual(&self, row: &Row) -> (f64, f64) {
        if row.tool >= self.tools.len() {
            return (f64::INFINITY, std::f64::consts::PI);
        }
        let predicted = self.predicted(row);
        let position = (row.seen.position() - predicted.translation).norm();
        let rotation = row
            .seen
            .pose()
            .map_or(0.0, |pose| angle(&pose.rotation, &predicted.rotation));
        (position, rotation)
    }

    fn with_medians(mut self, rows: &[Row]) -> Self {
        let residuals: Vec<(f64, f64)> = rows.iter().map(|row| self.residual(row)).collect();
        let whole = residuals
            .iter()
            .zip(rows)
            .filter(|(_, row)| row.seen.has_orientation());
        self.rotation = median(whole.map(|(r, _)| r.1).collect());
        self.position = median(residuals.iter().map(|r| r.0).collect());
        self
    }

    /// Returns the share of rows within `position` (m) and `rotation` (rad).
    pub fn share_within(&self, rows: &[Row], position: f64, rotation: f64) -> f64 {
        let within = |row: &&Row| {
            let (p, r) = self.residual(row);
            p < position && r < rotation
        };
        rows.iter().filter(within).count() as f64 / rows.len().max(1) as f64
    }

    /// Returns the bound that `share` of the residuals are within: positions in units of `metres`, plus radians times
    /// [`LEVER`].
    pub fn length_of_most(&self, rows: &[Row], share: f64, metres: f64) -> f64 {
        let (positions, rotations): (Vec<f64>, Vec<f64>) =
            rows.iter().map(|row| self.residual(row)).unzip();
        quantile(positions, share) / metres + LEVER * quantile(rotations, share)
    }

    /// Returns the median residuals as one length, in m.
    pub fn length(&self) -> f64 {
        self.position + LEVER * self.rotation
    }
}

/// Returns the angle between two rotations, in rad.
fn angle(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    // |A − B|² = 4 (1 − cos θ); the half angle keeps small angles exact.
    2.0 * libm::asin(((a - b).norm() / 8.0_f64.sqrt()).min(1.0))
}

/// Improves a fit for rows that differ a little from its own.
pub fn realign(start: Alignment, rows: &[Row]) -> Alignment {
    refined(start.with_medians(rows), rows, STEPS)
}

/// Number of Gauss–Newton steps of a final fit.
const STEPS: usize = 12;
/// Angle in rad below which orientations count as equal.
const TURNED: f64 = 0.2;
/// Number of random subsets of rows, and rows per subset, for files in which some rows are far off.
const SUBSETS: usize = 16;
const OF_SUBSET: usize = 10;
/// Weight of a shift that is held, as a multiple of that of all rows.
const HELD: f64 = 0.1;
/// Number of starts that are refined.
const REFINED: usize = 4;

/// Fits base and tools to `rows`, refined from the best starts.
pub fn align(rows: &[Row]) -> Alignment {
    let tools = tool_count(rows);
    let mut starts = starts(rows, tools, true);
    starts.truncate(REFINED);
    let fits = starts.into_iter().map(|s| refined(s, rows, STEPS));
    fits.min_by(|a, b| a.length().total_cmp(&b.length()))
        .expect("there is always a start")
}

/// Same as [`align`], but also starts from small subsets of rows, drawn in a fixed sequence, for files in which some rows
/// are far off.
pub fn align_with_outliers(rows: &[Row], start: Alignment) -> Alignment {
    let tools = start.tools.len();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut best = start;
    for _ in 0..SUBSETS {
        let mut part: Vec<Row> = (0..OF_SUBSET)
            .map(|_| rows[random.random_range(0..rows.len())])
            .collect();
        // Every subset contains every tool.
        part.extend((0..tools).filter_map(|t| rows.iter().find(|r| r.tool == t)));
        let Some(fit) = starts(&part, tools, true).into_iter().next() else {
            continue;
        };
        let fit = refined(refined(fit, &part, STEPS).with_medians(rows), rows, STEPS);
        if fit.length() < best.length() {
            best = fit;
        }
    }
    best
}

/// Fits base and tools to `rows` roughly, from the best start only: to rank readings.
pub fn rough(rows: &[Row]) -> Alignment {
    let tools = tool_count(rows);
    let best = starts(rows, tools, false).into_iter().next();
    refined(best.expect("there is always a start"), rows, 2)
}

fn tool_count(rows: &[Row]) -> usize {
    rows.iter().map(|r| r.tool + 1).max().unwrap_or(1)
}

/// Returns starts, best first. They come from the orientations if these vary and one tool has three of them; `thorough` tries
/// the positions as well.
fn starts(rows: &[Row], tools: usize, thorough: bool) -> Vec<Alignment> {
    let largest = (0..tools)
        .max_by_key(|t| rows.iter().filter(|r| r.tool == *t).count())
        .unwrap_or(0);
    let whole: Vec<(Matrix3<f64>, Matrix3<f64>)> = rows
        .iter()
        .filter(|r| r.tool == largest)
        .filter_map(|r| Some((r.seen.pose()?.rotation, r.flange.rotation)))
        .collect();
    let mut bases: Vec<Matrix3<f64>> = Vec::new();
    if whole.len() >= 3 {
        for base in rotations(&whole) {
            if bases.iter().all(|other| angle(other, &base) > 0.05) {
                bases.push(base);
            }
        }
    }
    let mut out: Vec<Alignment> = bases.iter().map(|base| linear(rows, tools, base)).collect();
    let turns = whole.iter().any(|(m, _)| angle(m, &whole[0].0) > TURNED);
    if thorough || !turns || out.is_empty() {
        out.extend(position_starts(rows, tools));
    }
    out.sort_by(|a, b| a.length().total_cmp(&b.length()));
    out
}

/// Returns candidate rotations of the base.
fn rotations(whole: &[(Matrix3<f64>, Matrix3<f64>)]) -> Vec<Matrix3<f64>> {
    // t[ij][ab] = Σ M_ij F_ab.
    let mut t = [[0.0; 9]; 9];
    for (m, f) in whole {
        for (ij, row) in t.iter_mut().enumerate() {
            let left = m[(ij / 3, ij % 3)];
            for (ab, sum) in row.iter_mut().enumerate() {
                *sum += left * f[(ab / 3, ab % 3)];
            }
        }
    }
    // Σ M Yᵀ Fᵀ, and Σ (X F)ᵀ M.
    let base_of = |y: &Matrix3<f64>| {
        let mut sum = Matrix3::zeros();
        for (ij, row) in t.iter().enumerate() {
            let (i, j) = (ij / 3, ij % 3);
            for (ab, value) in row.iter().enumerate() {
                sum[(i, ab / 3)] += value * y[(ab % 3, j)];
            }
        }
        nearest_rotation(&sum)
    };
    let tool_of = |x: &Matrix3<f64>| {
        let mut sum = Matrix3::zeros();
        for (ij, row) in t.iter().enumerate() {
            let (i, j) = (ij / 3, ij % 3);
            for (ab, value) in row.iter().enumerate() {
                sum[(ab % 3, j)] += value * x[(i, ab / 3)];
            }
        }
        nearest_rotation(&sum)
    };
    let k = Mat::from_fn(9, 9, |ia, bj| {
        t[3 * (ia / 3) + bj % 3][3 * (ia % 3) + bj / 3]
    });
    let mut tools = cube_rotations();
    if let Some(svd) = Svd::new(&k) {
        for column in 0..2 {
            let y = Matrix3::from_fn(|b, j| svd.v[(3 * b + j, column)]);
            tools.push(nearest_rotation(&y));
            tools.push(nearest_rotation(&-y));
        }
    }
    tools
        .iter()
        .map(|tool| {
            let mut base = base_of(tool);
            for _ in 0..3 {
                base = base_of(&tool_of(&base));
            }
            base
        })
        .collect()
}

/// Holds the shifts of each tool that cannot be distinguished from one of the base. `first` is the index of a tool's
/// translation.
fn hold(normal: &mut Mat<f64>, rows: &[Row], first: impl Fn(usize) -> usize) {
    for tool in 0..tool_count(rows) {
        let of_tool = rows.iter().filter(|row| row.tool == tool);
        let (_, shifts) = indistinct_shifts(of_tool.map(|row| row.flange.rotation));
        for shift in shifts {
            for i in 0..3 {
                for j in 0..3 {
                    let weight = HELD * rows.len() as f64;
                    normal[(first(tool) + i, first(tool) + j)] += weight * shift[i] * shift[j];
                }
            }
        }
    }
}

/// Computes the rotations of the tools from that of the base, then the translations by a linear fit.
fn linear(rows: &[Row], tools: usize, base: &Matrix3<f64>) -> Alignment {
    let mut turn = vec![Matrix3::zeros(); tools];
    for row in rows {
        if let Some(pose) = row.seen.pose() {
            turn[row.tool] += (base * row.flange.rotation).transpose() * pose.rotation;
        }
    }
    // Positions alone do not show how their target is turned.
    let turn = turn.iter().map(|sum| match *sum == Matrix3::zeros() {
        true => Matrix3::identity(),
        false => nearest_rotation(sum),
    });
    let turn: Vec<Matrix3<f64>> = turn.collect();
    let size = 3 + 3 * tools;
    let mut normal = Mat::<f64>::zeros(size, size);
    let mut right = Mat::<f64>::zeros(size, 1);
    for row in rows {
        let turned = base * row.flange.rotation;
        let rest = row.seen.position() - base * row.flange.translation;
        let first = 3 + 3 * row.tool;
        for i in 0..3 {
            let entries = [
                (i, 1.0),
                (first, turned[(i, 0)]),
                (first + 1, turned[(i, 1)]),
                (first + 2, turned[(i, 2)]),
            ];
            for (p, x) in entries {
                right[(p, 0)] += x * rest[i];
                for (q, y) in entries {
                    normal[(p, q)] += x * y;
                }
            }
        }
    }
    for i in 0..size {
        normal[(i, i)] += 1e-9 * rows.len() as f64;
    }
    hold(&mut normal, rows, |tool| 3 + 3 * tool);
    let x: Vec<f64> = match Factor::new(normal, 1) {
        Ok(factor) => {
            let x = factor.solve(&right);
            (0..size).map(|i| x[(i, 0)]).collect()
        }
        Err(_) => vec![0.0; size],
    };
    let vector = |first: usize| Vector3::new(x[first], x[first + 1], x[first + 2]);
    Alignment {
        base: Pose {
            rotation: *base,
            translation: vector(0),
        },
        tools: (0..tools)
            .map(|t| Pose {
                rotation: turn[t],
                translation: vector(3 + 3 * t),
            })
            .collect(),
        position: 0.0,
        rotation: 0.0,
    }
    .with_medians(rows)
}

/// Returns starts from positions alone: for several positions of the target on the flange, the base that takes it to where
/// it was seen.
fn position_starts(rows: &[Row], tools: usize) -> Vec<Alignment> {
    let seen: Vec<Vector3<f64>> = rows.iter().map(|r| r.seen.position()).collect();
    let mut offsets = vec![Vector3::zeros()];
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        offsets.extend([axis * 0.15, axis * -0.15]);
    }
    let start = |offset: Vector3<f64>| {
        let mut targets = vec![offset; tools];
        let mut out = None;
        for _ in 0..4 {
            let from: Vec<Vector3<f64>> = rows
                .iter()
                .map(|r| r.flange.transform_point(&targets[r.tool]))
                .collect();
            let base = aligned(&from, &seen);
            let fit = linear(rows, tools, &base.rotation);
            targets = fit.tools.iter().map(|t| t.translation).collect();
            out = Some(fit);
        }
        out
    };
    offsets.into_iter().filter_map(start).collect()
}

/// Refines a fit by Gauss–Newton steps with Cauchy weights.
fn refined(start: Alignment, rows: &[Row], steps: usize) -> Alignment {
    let mut best = start;
    let tools = best.tools.len();
    let size = 6 + 6 * tools;
    for _ in 0..steps {
        // The residuals of a mirrored or foreign file are decimetres: the floor only prevents a division by zero for exact
        // data.
        let width = 2.0 * best.length().max(1e-7);
        let mut normal = Mat::<f64>::zeros(size, size);
        let mut right = Mat::<f64>::zeros(size, 1);
        for row in rows {
            let predicted = best.predicted(row);
            let turned = best.base.rotation * row.flange.rotation;
            let position = row.seen.position() - predicted.translation;
            let turn = row.seen.pose().map(|pose| {
                let rest = pose.rotation * predicted.rotation.transpose();
                rotated(rest).log().angular * LEVER
            });
            let square = position.norm_squared() + turn.map_or(0.0, |t| t.norm_squared());
            let weight = 1.0 / (1.0 + square / (width * width));
            let first = 6 + 6 * row.tool;
            let mut add = |columns: &[(usize, Vector3<f64>)], error: &Vector3<f64>| {
                for (p, x) in columns {
                    right[(*p, 0)] += weight * x.dot(error);
                    for (q, y) in columns {
                        normal[(*p, *q)] += weight * x.dot(y);
                    }
                }
            };
            let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
            let lever = predicted.translation - best.base.translation;
            let mut columns = [(0, Vector3::zeros()); 9];
            for (i, axis) in axes.iter().enumerate() {
                columns[i] = (i, *axis);
                columns[3 + i] = (3 + i, axis.cross(&lever));
                columns[6 + i] = (first + i, turned.column(i).into_owned());
            }
            add(&columns, &position);
            if let Some(turn) = turn {
                let mut columns = [(0, Vector3::zeros()); 6];
                for (i, axis) in axes.iter().enumerate() {
                    columns[i] = (3 + i, axis * LEVER);
                    columns[3 + i] = (first + 3 + i, turned.column(i) * LEVER);
                }
                add(&columns, &turn);
            }
        }
        for i in 0..size {
            normal[(i, i)] += 1e-9 * rows.len() as f64;
        }
        hold(&mut normal, rows, |tool| 6 + 6 * tool);
        let Ok(factor) = Factor::new(normal, 1) else {
            break;
        };
        let x = factor.solve(&right);
        let vector =
            |first: usize| Vector3::new(x[(first, 0)], x[(first + 1, 0)], x[(first + 2, 0)]);
        let mut next = best.clone();
        next.base.translation += vector(0);
        next.base.rotation = turn(vector(3)).rotation * best.base.rotation;
        for (t, tool) in next.tools.iter_mut().enumerate() {
            tool.translation += vector(6 + 6 * t);
            tool.rotation = turn(vector(9 + 6 * t)).rotation * tool.rotation;
        }
        let next = next.with_medians(rows);
        let gain = best.length() - next.length();
        let settled = gain.abs() < 1e-4 * best.length();
        // A robust fit passes worse medians on its way: a step may lose a tenth.
        if gain > -0.1 * best.length() {
            best = next;
        }
        if settled || gain <= -0.1 * best.length() {
            break;
        }
    }
    best
}

/// Returns the 24 rotations that map a cube to itself.
fn cube_rotations() -> Vec<Matrix3<f64>> {
    let mut out = Vec::with_capacity(24);
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    for first in 0..3 {
        for second in (0..3).filter(|second| *second != first) {
            for (a, b) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                let (x, y) = (axes[first] * a, axes[second] * b);
                out.push(Matrix3::from_columns(&[x, y, x.cross(&y)]));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cube_has_24_different_rotations() {
        let all = cube_rotations();
        for (i, a) in all.iter().enumerate() {
            assert!((a.determinant() - 1.0).abs() < 1e-12);
            assert!(all[..i].iter().all(|b| (a - b).norm() > 0.5));
        }
        assert_eq!(all.len(), 24);
    }
}
