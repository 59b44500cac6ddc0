//! A measurement file as text columns, so that a mistake can change it as a faulty exporter would.

use std::f64::consts::PI;
use std::fmt::Write as _;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

/// The header and the rows of a measurement file.
#[derive(Clone, PartialEq)]
pub struct Table {
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Reads CSV text without quotation marks.
    pub fn parse(text: &str) -> Self {
        let mut lines = text
            .lines()
            .filter(|l| !l.starts_with('#') && !l.trim().is_empty())
            .map(|l| l.split(',').map(|c| c.trim().to_owned()).collect());
        let header = lines.next().expect("a header row");
        Self {
            header,
            rows: lines.collect(),
        }
    }

    /// Returns the file as CSV text: the header is line 1, row `i` is line `i + 2`.
    pub fn text(&self) -> String {
        let mut out = self.header.join(",");
        for row in &self.rows {
            let _ = write!(out, "\n{}", row.join(","));
        }
        out.push('\n');
        out
    }

    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Returns the column with that name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.header.iter().position(|h| h == name)
    }

    /// Returns the columns of the joints, base first.
    pub fn joints(&self) -> Vec<usize> {
        let is_joint = |h: &String| {
            let number = h.strip_prefix('q').and_then(|h| h.split('_').next());
            number.is_some_and(|n| n.parse::<usize>().is_ok())
        };
        (0..self.header.len())
            .filter(|c| is_joint(&self.header[*c]))
            .collect()
    }

    /// Returns the columns of the position.
    pub fn position(&self) -> [usize; 3] {
        ["x_", "y_", "z_"].map(|axis| {
            let found = self.header.iter().position(|h| h.starts_with(axis));
            found.expect("a position")
        })
    }

    /// Returns the columns of the quaternion, w first.
    pub fn orientation(&self) -> Option<[usize; 4]> {
        let columns = ["qw", "qx", "qy", "qz"].map(|name| self.column(name));
        Some([columns[0]?, columns[1]?, columns[2]?, columns[3]?])
    }

    pub fn number(&self, row: usize, column: usize) -> f64 {
        let text = &self.rows[row][column];
        text.parse()
            .unwrap_or_else(|_| panic!("a number in {} of row {row}: {text}", self.header[column]))
    }

    pub fn numbers(&self, column: usize) -> Vec<f64> {
        (0..self.len()).map(|r| self.number(r, column)).collect()
    }

    /// Returns the largest number of decimals of any field of the column.
    pub fn decimals(&self, column: usize) -> usize {
        let of = |text: &str| {
            let (digits, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
            let behind = digits.split_once('.').map_or(0, |(_, d)| d.len()) as i64;
            (behind - exponent.parse::<i64>().unwrap_or(0)).max(0) as usize
        };
        self.rows.iter().map(|r| of(&r[column])).max().unwrap_or(0)
    }

    /// Writes a number with `decimals` decimals into a field.
    pub fn write(&mut self, row: usize, column: usize, value: f64, decimals: usize) {
        self.rows[row][column] = format!("{value:.decimals$}");
    }

    /// Changes the numbers of a column in `rows`.
    pub fn map_rows(
        &mut self,
        column: usize,
        rows: impl IntoIterator<Item = usize>,
        mut change: impl FnMut(usize, f64) -> f64,
    ) {
        let decimals = self.decimals(column);
        for row in rows {
            let value = change(row, self.number(row, column));
            self.write(row, column, value, decimals);
        }
    }

    /// Changes the numbers of a column.
    pub fn map(&mut self, column: usize, change: impl FnMut(usize, f64) -> f64) {
        self.map_rows(column, 0..self.len(), change);
    }

    /// Multiplies a column by a factor and keeps its significant digits, as another unit under the old name would.
    pub fn scale(&mut self, column: usize, factor: f64) {
        let more = -libm::log10(factor.abs()).round();
        let decimals = (self.decimals(column) as f64 + more).max(0.0) as usize;
        for row in 0..self.len() {
            let value = factor * self.number(row, column);
            self.write(row, column, value, decimals);
        }
    }

    /// Exchanges the fields of two columns but not their names.
    pub fn swap(&mut self, a: usize, b: usize) {
        for row in &mut self.rows {
            row.swap(a, b);
        }
    }

    /// Adds a column with one value.
    pub fn add_column(&mut self, name: &str, value: &str) {
        self.header.push(name.to_owned());
        for row in &mut self.rows {
            row.push(value.to_owned());
        }
    }

    pub fn remove_columns(&mut self, names: &[&str]) {
        let kept: Vec<bool> = self
            .header
            .iter()
            .map(|h| !names.contains(&h.as_str()))
            .collect();
        for fields in std::iter::once(&mut self.header).chain(&mut self.rows) {
            let mut kept = kept.iter();
            fields.retain(|_| kept.next().is_some_and(|k| *k));
        }
    }

    /// Drops the orientations.
    pub fn positions_only(&mut self) {
        self.remove_columns(&["qw", "qx", "qy", "qz"]);
    }

    /// Returns the table of some rows, in their order.
    pub fn subset(&self, rows: &[usize]) -> Self {
        Self {
            header: self.header.clone(),
            rows: rows.iter().map(|r| self.rows[*r].clone()).collect(),
        }
    }

    /// Returns the joints of a row in rad; all joints of these sets are revolute.
    pub fn joints_rad(&self, row: usize) -> Vec<f64> {
        let radians = |c: &usize| {
            let value = self.number(row, *c);
            if self.header[*c].ends_with("_deg") {
                value * PI / 180.0
            } else {
                value
            }
        };
        self.joints().iter().map(radians).collect()
    }

    /// Returns the measured pose of a row, with its position in the unit of the file.
    pub fn pose(&self, row: usize) -> Pose<f64> {
        let position = self.position().map(|c| self.number(row, c));
        let [w, x, y, z] = self
            .orientation()
            .expect("an orientation")
            .map(|c| self.number(row, c));
        Pose::from_quaternion(w, &Vector3::new(x, y, z), Vector3::from(position))
    }

    /// Changes the poses of `rows`; each quaternion keeps its sign.
    pub fn map_poses(
        &mut self,
        rows: impl IntoIterator<Item = usize>,
        mut change: impl FnMut(usize, Pose<f64>) -> Pose<f64>,
    ) {
        let columns = self.pose_columns();
        let decimals = columns.map(|c| self.decimals(c));
        for row in rows {
            let pose = change(row, self.pose(row));
            let (w, v) = pose.quaternion();
            let new = [w, v[0], v[1], v[2]];
            let old = [3, 4, 5, 6].map(|i| self.number(row, columns[i]));
            let sign: f64 = new.iter().zip(&old).map(|(a, b)| a * b).sum();
            let t = pose.translation;
            let [w, x, y, z] = new.map(|c| c * if sign < 0.0 { -1.0 } else { 1.0 });
            for (i, value) in [t[0], t[1], t[2], w, x, y, z].into_iter().enumerate() {
                self.write(row, columns[i], value, decimals[i]);
            }
        }
    }

    /// Changes all poses.
    pub fn map_all_poses(&mut self, change: impl FnMut(usize, Pose<f64>) -> Pose<f64>) {
        self.map_poses(0..self.len(), change);
    }

    /// Returns the columns of position and quaternion.
    pub fn pose_columns(&self) -> [usize; 7] {
        let [x, y, z] = self.position();
        let [w, a, b, c] = self.orientation().expect("an orientation");
        [x, y, z, w, a, b, c]
    }

    /// Gives row `i` the pose of row `from(i)`.
    pub fn take_poses(&mut self, from: impl Fn(usize) -> usize) {
        self.take(&self.pose_columns(), from);
    }

    /// Gives row `i` the fields of row `from(i)`.
    pub fn take(&mut self, columns: &[usize], from: impl Fn(usize) -> usize) {
        let old = self.rows.clone();
        for (i, row) in self.rows.iter_mut().enumerate() {
            for c in columns {
                row[*c].clone_from(&old[from(i)][*c]);
            }
        }
    }
}
