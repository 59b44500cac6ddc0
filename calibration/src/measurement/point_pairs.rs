//! Points measured in two frames: they carry a base from one station of the instrument to the next, or state where it is.

use std::path::Path;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::column_names::Unit;
use crate::measurement::columns::Column;
use crate::measurement::noise::NoiseScales;
use crate::measurement::rows::Row;
use crate::measurement::table::{MEASURED_POSE, Table};
use crate::numeric::rotation::{aligned, centroid};

/// Standard uncertainty of one coordinate if the file states none, in m: that of a laser tracker.
const USUAL_SIGMA: f64 = NoiseScales::TRACKER.position;
/// Number of standard deviations beyond which a point counts as moved.
const MOST_SIGMAS: f64 = 3.0;
/// Smallest number of points: three determine a frame, a fourth reveals one that moved.
const FEWEST: usize = 3;
/// Ratio of the second-longest to the longest extent below which points count as lying on a line.
const SPREAD: f64 = 1e-2;

/// Points measured in two frames.
#[derive(Clone, Debug, PartialEq)]
pub struct PointPairs {
    /// Line of each point in the file and its coordinates in both frames, in m.
    points: Vec<(usize, Vector3<f64>, Vector3<f64>)>,
    /// Standard uncertainty of a coordinate, in m.
    sigma: f64,
}

/// The transform between the two frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// The transform `second_from_first`.
    pub pose: Pose<f64>,
    /// Number of points.
    pub points: usize,
    /// RMS distance between the two positions of a point after the transform, in m.
    pub rms: f64,
}

impl PointPairs {
    /// Reads a file with columns `{first}_x_mm` … and `{second}_x_mm` … (also `_m`), and the optional column `sigma_mm`.
    ///
    /// # Errors
    /// Returns an [`InputError`] with file, line and column.
    pub fn read(path: &Path, first: &str, second: &str) -> Result<Self, InputError> {
        let bytes = std::fs::read(path)
            .map_err(|error| InputError::unreadable(path, &error, "a file of points (CSV)"))?;
        Self::parse(path, &bytes, first, second)
    }

    /// Same as [`PointPairs::read`], for the bytes of a file; `path` is for messages.
    ///
    /// # Errors
    /// Those of [`PointPairs::read`].
    pub fn parse(path: &Path, bytes: &[u8], first: &str, second: &str) -> Result<Self, InputError> {
        let table = Table::parse(path, bytes, MEASURED_POSE)?;
        let of = |prefix: &str| -> Result<Vec<Column>, InputError> {
            ["x", "y", "z"]
                .iter()
                .map(|axis| column(path, &table, &format!("{prefix}_{axis}")))
                .collect()
        };
        let (from, to) = (of(first)?, of(second)?);
        let sigma = column(path, &table, "sigma").ok();
        let (mut points, mut sigmas) = (Vec::new(), Vec::new());
        for (line, fields) in &table.rows {
            let row = Row {
                file: path,
                line: *line,
                fields,
            };
            let point = |columns: &[Column]| -> Result<Vector3<f64>, InputError> {
                let at = |i: usize| row.number(&columns[i]);
                Ok(Vector3::new(at(0)?, at(1)?, at(2)?))
            };
            points.push((*line, point(&from)?, point(&to)?));
            if let Some(sigma) = &sigma {
                sigmas.push(row.sigma(sigma)?);
            }
        }
        if points.len() < FEWEST {
            return Err(InputError::new(
                path,
                format!("{} points", points.len()),
                format!("at least {FEWEST}, better four or more"),
            ));
        }
        let first: Vec<Vector3<f64>> = points.iter().map(|(_, first, _)| *first).collect();
        if are_on_a_line(&first) {
            return Err(InputError::new(
                path,
                "points on a line",
                "points that are not on one line: a line leaves a rotation undetermined",
            ));
        }
        let sigma = sigmas
            .iter()
            .copied()
            .reduce(f64::max)
            .unwrap_or(USUAL_SIGMA);
        Ok(Self { points, sigma })
    }

    /// Returns the transform that takes the points of the first frame to those of the second, by least squares.
    ///
    /// # Errors
    /// Returns an [`InputError`] that names the point that was moved.
    pub fn registration(&self, path: &Path) -> Result<Registration, InputError> {
        let first: Vec<Vector3<f64>> = self.points.iter().map(|(_, first, _)| *first).collect();
        let second: Vec<Vector3<f64>> = self.points.iter().map(|(.., second)| *second).collect();
        let pose = aligned(&first, &second);
        let off: Vec<f64> = first
            .iter()
            .zip(&second)
            .map(|(a, b)| (pose.transform_point(a) - b).norm())
            .collect();
        // The difference of two measured points has twice the variance of one, in each of three coordinates.
        let limit = MOST_SIGMAS * self.sigma * 6.0_f64.sqrt();
        let worst = (0..off.len()).max_by(|a, b| off[*a].total_cmp(&off[*b]));
        if let Some(worst) = worst.filter(|worst| off[*worst] > limit) {
            return Err(InputError::new(
                path,
                format!(
                    "a point whose two positions are {:.3} mm apart after the best fit of all {}",
                    1e3 * off[worst],
                    off.len()
                ),
                format!(
                    "at most {:.3} mm, {MOST_SIGMAS} standard deviations of {:.3} mm for each coordinate",
                    1e3 * limit,
                    1e3 * self.sigma
                ),
            )
            .at_line(self.points[worst].0)
            .with_help("a point was moved or confused with another one: measure it again or remove it"));
        }
        let squares: f64 = off.iter().map(|d| d * d).sum();
        Ok(Registration {
            pose,
            points: off.len(),
            rms: (squares / off.len() as f64).sqrt(),
        })
    }
}

/// Finds the column of a length by its name without the unit.
fn column(path: &Path, table: &Table, name: &str) -> Result<Column, InputError> {
    for (unit, ending) in [(Unit::Millimetre, "mm"), (Unit::Metre, "m")] {
        let name = format!("{name}_{ending}");
        if let Some(index) = table.header.iter().position(|found| found == name) {
            return Ok(Column { index, name, unit });
        }
    }
    let found: Vec<&str> = table.header.iter().collect();
    Err(InputError::new(
        path,
        format!("the columns {}", found.join(", ")),
        format!("a column {name}_mm or {name}_m"),
    )
    .at_line(table.header_line))
}

/// Returns whether the points lie on a line or coincide.
fn are_on_a_line(points: &[Vector3<f64>]) -> bool {
    let mean = centroid(points);
    let spread = points
        .iter()
        .fold(nalgebra::Matrix3::zeros(), |sum, point| {
            sum + (point - mean) * (point - mean).transpose()
        });
    let mut extents: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
    extents.sort_by(f64::total_cmp);
    extents[1].max(0.0).sqrt() <= SPREAD * extents[2].max(0.0).sqrt()
}
