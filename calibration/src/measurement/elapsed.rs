//! How long after the start of its session each row was measured.

use serde::Serialize;

use crate::measurement::set::MeasurementSet;

/// Number of rows below which a sorted column is attributed to chance.
pub const LEAST_SORTED: usize = 8;

/// The unit of a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TimeUnit {
    /// Seconds: the file states the time of each row.
    Seconds,
    /// Rows: the file states no times, and its rows are in chronological order.
    Rows,
}

impl TimeUnit {
    /// Returns the unit as it is written after a number.
    pub fn name(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::Rows => "rows",
        }
    }
}

/// Time since the start of a session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elapsed {
    /// Time elapsed, in `unit`, ≥ 0.
    pub value: f64,
    /// Unit of `value`.
    pub unit: TimeUnit,
}

impl MeasurementSet {
    /// Returns the name of a column by which the rows are sorted, so that their order is not chronological. `None` if no
    /// column is sorted, if the file states the time of each row, or if it has too few rows.
    pub fn sorted_by(&self) -> Option<String> {
        let all = &self.measurements;
        if all.len() < LEAST_SORTED || all[0].time_s.is_some() {
            return None;
        }
        let joints = self.joint_columns.iter().enumerate().map(|(j, column)| {
            let values: Vec<f64> = all.iter().map(|m| m.joints[j]).collect();
            (column.name.clone(), values)
        });
        let positions = ["x", "y", "z"].into_iter().enumerate().map(|(axis, name)| {
            let values = all.iter().map(|m| m.position[axis]).collect();
            (name.to_owned(), values)
        });
        let is_sorted = |values: &[f64]| {
            values.windows(2).all(|w| w[0] < w[1]) || values.windows(2).all(|w| w[0] > w[1])
        };
        let sorted = joints
            .chain(positions)
            .find(|(_, values)| is_sorted(values));
        sorted.map(|(name, _)| name)
    }

    /// Returns the session index of each row; sessions are numbered in order of appearance.
    pub fn session_of_rows(&self) -> Vec<usize> {
        let mut names: Vec<Option<&str>> = Vec::new();
        let mut out = Vec::with_capacity(self.measurements.len());
        for m in &self.measurements {
            let name = m.session.as_deref();
            let known = names.iter().position(|n| *n == name);
            out.push(known.unwrap_or(names.len()));
            if known.is_none() {
                names.push(name);
            }
        }
        out
    }

    /// Returns the time of each row since the first row of its session; `None` for every row if the rows are not in
    /// chronological order.
    pub fn elapsed(&self) -> Vec<Option<Elapsed>> {
        if self.sorted_by().is_some() {
            return vec![None; self.measurements.len()];
        }
        let sessions = self.session_of_rows();
        let count = sessions.iter().max().map_or(0, |last| last + 1);
        let mut first = vec![f64::INFINITY; count];
        let mut rows = vec![0.0; count];
        for (m, session) in self.measurements.iter().zip(&sessions) {
            first[*session] = first[*session].min(m.time_s.unwrap_or(0.0));
        }
        let of = |(k, session): (usize, &usize)| match self.measurements[k].time_s {
            Some(time) => Elapsed {
                value: time - first[*session],
                unit: TimeUnit::Seconds,
            },
            None => {
                rows[*session] += 1.0;
                Elapsed {
                    value: rows[*session] - 1.0,
                    unit: TimeUnit::Rows,
                }
            }
        };
        sessions.iter().enumerate().map(of).map(Some).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::parse;

    fn elapsed(text: &str) -> Vec<Option<Elapsed>> {
        parse("rows.csv", text.as_bytes()).unwrap().elapsed()
    }

    #[test]
    fn rows_count_from_the_beginning_of_their_session() {
        let header = "q1_deg,x_mm,y_mm,z_mm,session";
        let text = format!("{header}\n1,2,3,4,a\n2,2,1,5,b\n3,2,2,4,a\n4,1,3,4,b\n5,2,3,4,a\n");
        let rows = |value: f64| {
            let unit = TimeUnit::Rows;
            Some(Elapsed { value, unit })
        };
        assert_eq!(elapsed(&text), [0.0, 0.0, 1.0, 1.0, 2.0].map(rows));
        let text = "q1_deg,x_mm,y_mm,z_mm,time_s\n1,2,3,4,107\n2,2,1,5,100\n3,2,2,4,103.5\n";
        let seconds = |value: f64| {
            let unit = TimeUnit::Seconds;
            Some(Elapsed { value, unit })
        };
        assert_eq!(elapsed(text), [7.0, 0.0, 3.5].map(seconds));
    }

    #[test]
    fn rows_that_are_sorted_have_no_moment() {
        let rows: Vec<String> = (0..9).map(|i| format!("{i},{},1,2", i * 37 % 11)).collect();
        let sorted = format!("q1_deg,x_mm,y_mm,z_mm\n{}\n", rows.join("\n"));
        assert_eq!(elapsed(&sorted), [None; 9]);
    }
}
