//! Joins the rows of a joints' file to the rows of a poses' file: by order, by an index, or by time.
//!
//! Every pose gets exactly one row of joints, and no row of joints belongs to two poses. Files that violate this are
//! refused, and the error names the lines.

use std::collections::BTreeMap;

use crate::import::column_map::{FileJoin, Incomplete, JoinBy, Map, TimeUnit};
use crate::import::columns::optional;
use crate::import::text::{Line, Table};
use crate::import::units::unit_of;
use crate::import::value::RowValues;
use poegp_calibration::input_error::{InputError, counted};

/// The rows of joints that belong to the poses.
pub struct Joined<'a> {
    /// For each row of poses, its row of joints; `None` where the pose is left out.
    pub lines: Vec<Option<&'a Line>>,
    /// Column of the poses' file by which the files were joined.
    pub pose_column: Option<usize>,
    /// Column of the joints' file by which the files were joined.
    pub joint_column: Option<usize>,
    /// Number of rows of joints that belong to no pose.
    pub unused: usize,
}

const LEAVE_OUT: &str = "incomplete = \"leave-out\" in the map leaves such rows out and lists them";

/// Joins two files, and adds the lines of the rows that it leaves out to `left_out`.
pub fn joined<'a>(
    map: &Map,
    how: &FileJoin,
    poses: &Table,
    joints: &'a Table,
    left_out: &mut Vec<String>,
) -> Result<Joined<'a>, InputError> {
    let pose_column = optional(map, poses, how.poses.as_ref(), "join.poses")?;
    let joint_column = optional(map, joints, how.joints.as_ref(), "join.joints")?;
    let lines = match (how.by, pose_column, joint_column) {
        (JoinBy::Index, Some(p), Some(j)) => by_index(map, (poses, p), (joints, j), left_out)?,
        (JoinBy::Time, Some(p), Some(j)) => by_time(map, how, (poses, p), (joints, j), left_out)?,
        // The map was checked: only the join by order is left.
        _ => by_order(poses, joints)?,
    };
    let used = lines.iter().flatten().count();
    Ok(Joined {
        lines,
        pose_column,
        joint_column,
        unused: joints.rows.len().saturating_sub(used),
    })
}

fn by_order<'a>(poses: &Table, joints: &'a Table) -> Result<Vec<Option<&'a Line>>, InputError> {
    let (there, wanted) = (joints.rows.len(), poses.rows.len());
    if there == wanted {
        return Ok(joints.rows.iter().map(Some).collect());
    }
    let path = poses.path.display();
    let found = format!(
        "{} of joints for {} of poses in {path}",
        counted(there, "row"),
        counted(wanted, "row")
    );
    // The first row without a partner, or the last one before the gap.
    let line = joints.rows.get(wanted).or(joints.rows.last());
    Err(
        InputError::new(&joints.path, found, "as many, to be joined by order")
            .at_line(line.map_or(1, |line| line.number))
            .with_help(
                "by = \"index\" or \"time\" in [join] of the map needs no equal numbers of rows",
            ),
    )
}

fn by_index<'a>(
    map: &Map,
    (poses, pose_column): (&Table, usize),
    (joints, joint_column): (&'a Table, usize),
    left_out: &mut Vec<String>,
) -> Result<Vec<Option<&'a Line>>, InputError> {
    let (mut unused, unnamed) = indexed(map, joints, joint_column, ("", "index"))?;
    indexed(map, poses, pose_column, ("", "index"))?;
    left_out.extend(unnamed);
    let mut out = Vec::new();
    for line in &poses.rows {
        let fields = RowValues::new(poses, line);
        let found = unused.remove(fields.text(pose_column));
        if found.is_none() {
            if map.incomplete == Incomplete::Refuse {
                let joints = joints.path.display();
                let found = format!(
                    "{:?}, which has no joints in {joints}",
                    fields.text(pose_column)
                );
                return Err(fields
                    .error(pose_column, found, "an index of both files")
                    .with_help(LEAVE_OUT));
            }
            left_out.push(line.number.to_string());
        }
        out.push(found);
    }
    if let Some(line) = unused.values().min_by_key(|line| line.number)
        && map.incomplete == Incomplete::Refuse
    {
        let fields = RowValues::new(joints, line);
        let poses = poses.path.display();
        let found = format!(
            "{:?}, which has no pose in {poses}",
            fields.text(joint_column)
        );
        return Err(fields
            .error(joint_column, found, "an index of both files")
            .with_help(LEAVE_OUT));
    }
    Ok(out)
}

/// The rows of a file by their index, and which rows the map leaves out because they have none.
type Indexed<'a> = (BTreeMap<&'a str, &'a Line>, Vec<String>);

/// Returns the rows of a file by their index, and refuses an index that occurs twice; `said` and `name` are how an error
/// names it.
pub fn indexed<'a>(
    map: &Map,
    table: &'a Table,
    column: usize,
    (said, name): (&str, &str),
) -> Result<Indexed<'a>, InputError> {
    let mut out: BTreeMap<&str, &Line> = BTreeMap::new();
    let mut unnamed = Vec::new();
    for line in &table.rows {
        let fields = RowValues::new(table, line);
        if map.incomplete == Incomplete::LeaveOut && fields.is_missing(column) {
            unnamed.push(fields.location());
            continue;
        }
        fields.label(column)?;
        if let Some(other) = out.insert(fields.text(column), line) {
            let found = format!(
                "{said}{:?} again, first on line {}",
                fields.text(column),
                other.number
            );
            return Err(fields.error(column, found, format!("every {name} once")));
        }
    }
    Ok((out, unnamed))
}

/// Returns the times of all rows in seconds, and whether they lack a time zone. `expected` says whether the rows of the
/// other file lack one. A row without a time has none if the map leaves such rows out.
fn times(
    map: &Map,
    (table, column): (&Table, usize),
    unit: TimeUnit,
    mut expected: Option<bool>,
) -> Result<(Vec<Option<f64>>, Option<bool>), InputError> {
    let mut out = Vec::new();
    for line in &table.rows {
        let fields = RowValues::new(table, line);
        if map.incomplete == Incomplete::LeaveOut && fields.is_missing(column) {
            out.push(None);
            continue;
        }
        let moment = fields.moment(column, unit)?;
        if *expected.get_or_insert(moment.is_local) != moment.is_local {
            let (found, wanted) = match moment.is_local {
                true => (
                    "a date and time without a time zone",
                    "one with a time zone",
                ),
                false => ("a time of a known clock", "one without a time zone"),
            };
            let found = format!("{found}, {:?}", fields.text(column));
            let wanted = format!("{wanted}, as the rows before, or those of the other file, have");
            return Err(fields.error(column, found, wanted));
        }
        out.push(Some(moment.seconds));
    }
    Ok((out, expected))
}

fn by_time<'a>(
    map: &Map,
    how: &FileJoin,
    (poses, pose_column): (&Table, usize),
    (joints, joint_column): (&'a Table, usize),
    left_out: &mut Vec<String>,
) -> Result<Vec<Option<&'a Line>>, InputError> {
    let tolerance = how.tolerance_s.as_ref().map_or(0.0, |t| *t.get_ref());
    let poses_unit = unit_of(map, poses, pose_column, how.poses_unit, "join.poses_unit")?;
    let (at, is_local) = times(map, (poses, pose_column), poses_unit, None)?;
    let unit = unit_of(
        map,
        joints,
        joint_column,
        how.joints_unit,
        "join.joints_unit",
    )?;
    let (times, _) = times(map, (joints, joint_column), unit, is_local)?;
    let mut ordered: Vec<(f64, &Line)> = Vec::new();
    for (time, line) in times.into_iter().zip(&joints.rows) {
        match time {
            Some(time) => ordered.push((time, line)),
            None => left_out.push(RowValues::new(joints, line).location()),
        }
    }
    ordered.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut taken: BTreeMap<usize, usize> = BTreeMap::new();
    let mut out = Vec::new();
    for (line, time) in poses.rows.iter().zip(at) {
        let fields = RowValues::new(poses, line);
        let Some(time) = time else {
            left_out.push(line.number.to_string());
            out.push(None);
            continue;
        };
        let path = joints.path.display();
        let first = ordered.partition_point(|(t, _)| *t < time - tolerance);
        let end = ordered.partition_point(|(t, _)| *t <= time + tolerance);
        match &ordered[first..end.max(first)] {
            [(_, only)] => {
                if let Some(other) = taken.insert(only.number, line.number) {
                    let found = format!(
                        "a pose within {tolerance} s of the joints on line {} of {path}, as the pose on line {other} is",
                        only.number
                    );
                    return Err(fields.error(
                        pose_column,
                        found,
                        "one pose for each row of joints",
                    ));
                }
                out.push(Some(*only));
            }
            [] if map.incomplete == Incomplete::LeaveOut => {
                left_out.push(line.number.to_string());
                out.push(None);
            }
            [] => {
                let beside = [first.checked_sub(1), Some(first)].into_iter().flatten();
                let nearest = beside
                    .filter_map(|i| ordered.get(i))
                    .min_by(|a, b| (a.0 - time).abs().total_cmp(&(b.0 - time).abs()));
                let found = nearest.map_or_else(String::new, |(t, line)| {
                    let apart = (t - time).abs();
                    format!(
                        "a pose {apart:.6} s from the nearest joints, on line {} of {path}",
                        line.number
                    )
                });
                let expected = format!("joints within {tolerance} s (join.tolerance_s)");
                return Err(fields
                    .error(pose_column, found, expected)
                    .with_help(LEAVE_OUT));
            }
            [(_, one), .., (_, last)] => {
                let found = format!(
                    "{} rows of joints within {tolerance} s of this pose, lines {} to {} of {path}",
                    end - first,
                    one.number.min(last.number),
                    one.number.max(last.number)
                );
                return Err(fields.error(pose_column, found, "exactly one").with_help(
                    "set join.tolerance_s below half of the time between two rows of joints",
                ));
            }
        }
    }
    Ok(out)
}
