//! Checks the tables of a map that join points or files to poses.

use toml::Spanned;

use crate::import::column_map::{ColumnName, FileJoin, Join, JoinBy, Map, Points, Reflectors};
use crate::import::rigid::spans_a_plane;
use poegp_calibration::input_error::{InputError, counted, number};

impl Map {
    pub(super) fn check_points(&self, points: &Points) -> Result<(), InputError> {
        self.count(&points.columns, "points.columns", &[3])?;
        if let (Some(target), Some(_)) = (&points.target, &points.split) {
            let found = "points.target beside points.split";
            return Err(self.error(target.span(), "points.target", found, "one of them"));
        }
        if points.join == Join::Name && self.joints.name.is_none() {
            return Err(InputError::new(
                &self.path,
                "points.join = \"name\" without joints.name",
                "joints.name, the column of the joints' file that has the pose's name",
            ));
        }
        if let (Join::Order, Some(name)) = (points.join, &self.joints.name) {
            let found = "joints.name, and points.join = \"order\"";
            return Err(self.error(
                name.span(),
                "joints.name",
                found,
                "join = \"name\", or no name",
            ));
        }
        if self.target.is_some() {
            return Err(InputError::new(
                &self.path,
                "[target] beside [points]",
                "points.target or points.split for the names of targets",
            ));
        }
        self.check_residual(&points.max_residual_mm, "points.max_residual_mm")?;
        let Some(targets) = &points.targets else {
            return Ok(());
        };
        let span = targets.span();
        if points.targets_unit.is_none() {
            return Err(self.error(
                span,
                "points.targets",
                "no points.targets_unit",
                "\"mm\" or \"m\"",
            ));
        }
        if points.target.is_none() && points.split.is_none() {
            let found = "targets, and no points.target or points.split";
            return Err(self.error(
                span,
                "points.targets",
                found,
                "where the name of the target is",
            ));
        }
        let locations: Vec<[f64; 3]> = targets.get_ref().values().map(|at| at.0).collect();
        if locations.iter().flatten().any(|x| !x.is_finite()) {
            return Err(self.error(
                span,
                "points.targets",
                "a number that is not finite",
                "finite numbers",
            ));
        }
        if !spans_a_plane(&locations) {
            let found = format!("{} targets on one line", locations.len());
            let expected = "three targets or more that are not on one line";
            return Err(self
                .error(span, "points.targets", found, expected)
                .with_help(
                    "leave targets out: every point is then a position without orientation",
                ));
        }
        Ok(())
    }

    /// Checks that a join has the keys that it needs and no others.
    pub(super) fn check_join(&self, join: &FileJoin) -> Result<(), InputError> {
        for (key, column) in [("join.poses", &join.poses), ("join.joints", &join.joints)] {
            match (join.by, column) {
                (JoinBy::Order, Some(column)) => {
                    let expected = "no column beside by = \"order\", or by = \"index\" or \"time\"";
                    return Err(self.error(column.span(), key, "a column", expected));
                }
                (JoinBy::Index | JoinBy::Time, None) => {
                    let found = format!("no {key}");
                    let expected = "poses and joints, the column of each file that [join] compares";
                    return Err(InputError::new(&self.path, found, expected));
                }
                _ => {}
            }
        }
        let is_time = join.by == JoinBy::Time;
        if let Some(time) = self.time.as_ref().filter(|_| is_time) {
            let found = "[time] beside [join] by time";
            let expected = "one of them: the column join.poses is the time of the rows, too";
            return Err(self.error(time.column.span(), "time.column", found, expected));
        }
        if !is_time
            && (join.poses_unit.is_some()
                || join.joints_unit.is_some()
                || join.tolerance_s.is_some())
        {
            let found = "a unit or a tolerance in [join] that is not by time";
            return Err(InputError::new(
                &self.path,
                found,
                "by = \"time\", or neither",
            ));
        }
        match &join.tolerance_s {
            None if is_time => Err(InputError::new(
                &self.path,
                "no join.tolerance_s",
                "the largest time between a pose and its joints, in seconds",
            )),
            Some(tolerance) if !(tolerance.get_ref().is_finite() && *tolerance.get_ref() > 0.0) => {
                let found = number(*tolerance.get_ref());
                Err(self.error(
                    tolerance.span(),
                    "join.tolerance_s",
                    found,
                    "a number above 0",
                ))
            }
            _ => Ok(()),
        }
    }

    /// Checks that the reflectors of a row can give a pose.
    pub(super) fn check_reflectors(&self, how: &Reflectors) -> Result<(), InputError> {
        let locations: Vec<[f64; 3]> = how.at.get_ref().iter().map(|at| at.0).collect();
        if how.columns.get_ref().len() != locations.len() {
            let found = counted(locations.len(), "place");
            let expected = format!("{}, as reflectors.columns has", how.columns.get_ref().len());
            return Err(self.error(how.at.span(), "reflectors.at", found, expected));
        }
        if let Some(names) = how.columns.get_ref().iter().find(|names| names.len() != 3) {
            let found = format!("{} of a reflector", counted(names.len(), "column"));
            let expected = "its x, y and z";
            return Err(self.error(how.columns.span(), "reflectors.columns", found, expected));
        }
        if locations.iter().flatten().any(|x| !x.is_finite()) || !spans_a_plane(&locations) {
            let found = format!("{} on one line", counted(locations.len(), "reflector"));
            let expected = "three reflectors or more that are not on one line";
            return Err(self.error(how.at.span(), "reflectors.at", found, expected));
        }
        self.check_residual(&how.max_residual_mm, "reflectors.max_residual_mm")
    }

    fn check_residual(&self, limit: &Option<Spanned<f64>>, key: &str) -> Result<(), InputError> {
        match limit {
            Some(limit) if limit.get_ref().is_nan() || *limit.get_ref() <= 0.0 => {
                let found = number(*limit.get_ref());
                Err(self.error(limit.span(), key, found, "a number above 0"))
            }
            _ => Ok(()),
        }
    }

    pub(super) fn count(
        &self,
        columns: &Spanned<Vec<ColumnName>>,
        key: &str,
        counts: &[usize],
    ) -> Result<(), InputError> {
        let found = columns.get_ref().len();
        if counts.contains(&found) {
            return Ok(());
        }
        let counts: Vec<String> = counts.iter().map(usize::to_string).collect();
        let expected = format!("{} columns", counts.join(" or "));
        Err(self.error(columns.span(), key, counted(found, "column"), expected))
    }
}
