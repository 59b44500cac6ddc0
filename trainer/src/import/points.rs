//! Lists of points as Leica's programs and SpatialAnalyzer write them, with the joints in another file.
//!
//! Points that belong to one pose are grouped by their names. Where the map has the positions of the targets on the tool,
//! three or more points give the whole pose: the rigid motion that maps those positions to the points, in least squares.
//! Otherwise every point is a measurement of a position.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use nalgebra::Vector3;

use crate::import::beside::Beside;
use crate::import::column_map::{Incomplete, Join, LengthUnit, Map, Points};
use crate::import::columns::{
    columns, joint_columns, joint_values, one, optional, twice_or_unused,
};
use crate::import::join::indexed;
use crate::import::origin::{Origin, Origins, ReadRows, joint_origins};
use crate::import::poses::left_out_note;
use crate::import::rigid::{Fit, MAX_RESIDUAL_MM, fitted};
use crate::import::text::{Line, Table};
use crate::import::units::shared_unit;
use crate::import::value::RowValues;
use crate::import::write::{Row, XYZ};
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::robot::toml_source::Numbers;

const LEAVE_OUT: &str =
    "incomplete = \"leave-out\" in the map leaves such poses out and lists them";

/// One measured point, in millimetres.
struct Point<'a> {
    line: &'a Line,
    target: String,
    location: Vector3<f64>,
}

/// The points of a pose, in the order of the file.
struct Group<'a> {
    pose: String,
    points: Vec<Point<'a>>,
}

/// Returns the rows from a file of points and a file of joints, and the notes for the user.
pub fn rows(points: &Table, joints: &Table, map: &Map) -> Result<ReadRows, InputError> {
    let Some(how) = &map.points else {
        return Ok((Vec::new(), Vec::new(), HashMap::new()));
    };
    let mut notes = Vec::new();
    let mut left_out = Vec::new();
    let groups = groups(points, map, how, &mut notes, &mut left_out)?;

    let joint_indices = joint_columns(map, joints)?;
    let mut beside = Beside::find(map, joints, joints)?;
    let name = optional(map, joints, map.joints.name.as_ref(), "joints.name")?;
    let mut used: Vec<usize> = joint_indices.iter().map(|joint| joint.0).collect();
    used.extend(beside.columns());
    used.extend(beside.payload_column());
    used.extend(name);
    notes.extend(twice_or_unused(map, joints, &used)?);

    let found = joined(&points.path, &groups, joints, map, how, name, &mut left_out)?;
    let mut out = Vec::new();
    let mut worst = (0.0_f64, 0, String::new());
    for (group, line) in groups.iter().zip(found) {
        let Some(line) = line else { continue };
        let fields = RowValues::new(joints, line);
        let mut needed = joint_indices.iter().map(|joint| joint.0);
        if map.incomplete == Incomplete::LeaveOut
            && (needed.any(|column| fields.is_missing(column))
                || beside
                    .payload_column()
                    .is_some_and(|c| fields.is_missing(c))
                || beside.is_incomplete(&fields))
        {
            left_out.extend(group.points.iter().map(|p| p.line.number.to_string()));
            left_out.push(fields.location());
            continue;
        }
        let mut row = Row {
            line: group.points[0].line.number,
            joints_line: Some(line.number),
            joints: joint_values(&fields, &joint_indices)?,
            ..Row::default()
        };
        beside.read(&fields, &fields, &mut row)?;
        let Some(targets) = &how.targets else {
            for point in &group.points {
                let mut row = row.clone();
                row.line = point.line.number;
                row.position_mm = point.location;
                row.target =
                    (how.target.is_some() || how.split.is_some()).then(|| point.target.clone());
                out.push(row);
            }
            continue;
        };
        let locations = in_millimetres(targets.get_ref(), how.targets_unit);
        match fit_of(points, group, &locations, how)? {
            Some((fit, line)) => {
                if fit.residual > worst.0 {
                    worst = (fit.residual, line, group.pose.clone());
                }
                row.position_mm = fit.translation;
                row.orientation = Some(fit.rotation);
                out.push(row);
            }
            None if map.incomplete == Incomplete::LeaveOut => {
                left_out.extend(group.points.iter().map(|p| p.line.number.to_string()));
            }
            None => {
                let names: Vec<&str> = group.points.iter().map(|p| p.target.as_str()).collect();
                let found = format!(
                    "pose {:?} with the targets {}",
                    group.pose,
                    names.join(", ")
                );
                return Err(InputError::new(
                    &points.path,
                    found,
                    "three targets or more that are not on one line",
                )
                .at_line(group.points[0].line.number)
                .with_help(LEAVE_OUT));
            }
        }
    }
    if worst.1 > 0 {
        notes.push(format!(
            "points of one pose fit the targets within {:.4} mm (pose {:?}, line {})",
            worst.0, worst.2, worst.1
        ));
    }
    notes.extend(left_out_note(&left_out));
    if out.is_empty() {
        return Err(InputError::new(
            &points.path,
            "no pose with joints and points",
            "at least one",
        ));
    }
    let of_joints = |column| Origin::new(joints, true, column);
    let mut origins = beside.origins(of_joints, of_joints);
    origins.extend(joint_origins(&joint_indices, of_joints));
    origins.extend(origins_of_points(points, map, how)?);
    Ok((out, notes, origins))
}

/// Returns the origins of target and position, where every point is a measurement; otherwise none.
fn origins_of_points(table: &Table, map: &Map, how: &Points) -> Result<Origins, InputError> {
    if how.targets.is_some() {
        return Ok(Origins::new());
    }
    let of_points = |column| Origin::new(table, false, column);
    let xyz: [usize; 3] = columns(map, table, &how.columns, "points.columns")?;
    let target = optional(map, table, how.target.as_ref(), "points.target")?;
    let name = one(map, table, &how.name, "points.name")?;
    let xyz = XYZ.map(str::to_owned).into_iter().zip(xyz.map(of_points));
    let mut out: Origins = xyz.collect();
    out.insert("target".to_owned(), of_points(target.unwrap_or(name)));
    Ok(out)
}

fn groups<'a>(
    table: &'a Table,
    map: &Map,
    how: &Points,
    notes: &mut Vec<String>,
    left_out: &mut Vec<String>,
) -> Result<Vec<Group<'a>>, InputError> {
    let name = one(map, table, &how.name, "points.name")?;
    let target = optional(map, table, how.target.as_ref(), "points.target")?;
    let xyz: [usize; 3] = columns(map, table, &how.columns, "points.columns")?;
    let unit = shared_unit(map, table, &xyz, how.unit, "points.unit")?;
    let mut used = vec![name];
    used.extend(target);
    used.extend(xyz);
    notes.extend(twice_or_unused(map, table, &used)?);
    let mut out: Vec<Group<'a>> = Vec::new();
    let mut index: BTreeMap<String, usize> = BTreeMap::new();
    for line in &table.rows {
        let fields = RowValues::new(table, line);
        let mut names = std::iter::once(name).chain(target);
        if map.incomplete == Incomplete::LeaveOut && names.any(|column| fields.is_missing(column)) {
            left_out.push(line.number.to_string());
            continue;
        }
        let text = fields.label(name)?;
        let (pose, target) = match (target, &how.split) {
            (Some(column), _) => (text, fields.label(column)?),
            (None, Some(split)) => match text.rsplit_once(split.get_ref().as_str()) {
                Some((pose, target)) if !pose.is_empty() && !target.is_empty() => {
                    (pose.to_owned(), target.to_owned())
                }
                _ => {
                    let expected =
                        format!("pose and target with {:?} between them", split.get_ref());
                    return Err(fields.error(name, format!("{text:?}"), expected));
                }
            },
            (None, None) => (text, String::new()),
        };
        let is_missing = xyz.iter().any(|column| fields.is_missing(*column));
        let mut location = Vector3::zeros();
        if !(is_missing && map.incomplete == Incomplete::LeaveOut) {
            for (x, column) in location.iter_mut().zip(xyz) {
                *x = fields.millimetres(column, unit)?;
            }
        }
        if location == Vector3::zeros() {
            if map.incomplete == Incomplete::LeaveOut {
                left_out.push(line.number.to_string());
                continue;
            }
            return Err(fields
                .error(xyz[0], "the point 0 0 0", "a measured point")
                .with_help("an instrument writes 0 0 0 where it missed; incomplete = \"leave-out\" in the map leaves such points out and lists them"));
        }
        if let Some(targets) = &how.targets
            && !targets.get_ref().contains_key(&target)
        {
            let known: Vec<String> = targets.get_ref().keys().map(|k| format!("{k:?}")).collect();
            let expected = format!("one of points.targets of the map: {}", known.join(", "));
            return Err(fields.error(name, format!("the target {target:?}"), expected));
        }
        let at = *index.entry(pose.clone()).or_insert_with(|| {
            out.push(Group {
                pose,
                points: Vec::new(),
            });
            out.len() - 1
        });
        let group = &mut out[at];
        if let Some(other) = group.points.iter().find(|p| p.target == target) {
            let found = format!(
                "target {target:?} of pose {:?} again, first on line {}",
                group.pose, other.line.number
            );
            return Err(fields.error(name, found, "every point of a pose once"));
        }
        group.points.push(Point {
            line,
            target,
            location,
        });
    }
    Ok(out)
}

/// Returns the row of joints of every pose; `None` where the pose is left out.
fn joined<'a>(
    points: &Path,
    groups: &[Group<'_>],
    joints: &'a Table,
    map: &Map,
    how: &Points,
    name: Option<usize>,
    left_out: &mut Vec<String>,
) -> Result<Vec<Option<&'a Line>>, InputError> {
    if how.join == Join::Order {
        if groups.len() != joints.rows.len() {
            let found = format!(
                "{} of joints for {} of points",
                counted(joints.rows.len(), "row"),
                counted(groups.len(), "pose")
            );
            return Err(
                InputError::new(&joints.path, found, "as many, to be joined by order")
                    .with_help("give the poses names and use join = \"name\""),
            );
        }
        return Ok(joints.rows.iter().map(Some).collect());
    }
    let column = name.unwrap_or(0);
    let (mut by_name, unnamed) = indexed(map, joints, column, ("pose ", "pose"))?;
    left_out.extend(unnamed);
    let mut out = Vec::new();
    for group in groups {
        let line = by_name.remove(group.pose.as_str());
        if line.is_none() {
            let first = &group.points[0];
            if map.incomplete == Incomplete::Refuse {
                let found = format!(
                    "pose {:?}, which has no joints in {}",
                    group.pose,
                    joints.path.display()
                );
                return Err(InputError::new(points, found, "a pose of both files")
                    .at_line(first.line.number)
                    .with_help(LEAVE_OUT));
            }
            left_out.extend(group.points.iter().map(|p| p.line.number.to_string()));
        }
        out.push(line);
    }
    if let Some((pose, line)) = by_name.first_key_value() {
        if map.incomplete == Incomplete::Refuse {
            let found = format!("pose {pose:?}, which has no points");
            return Err(InputError::new(&joints.path, found, "a pose of both files")
                .at_line(line.number)
                .with_help(LEAVE_OUT));
        }
        let rows = by_name.values().map(|line| RowValues::new(joints, line));
        left_out.extend(rows.map(|row| row.location()));
    }
    Ok(out)
}

/// Fits `instrument_from_tool` to the points of a pose. Returns the fit and the line of the point with the largest
/// residual; `None` when the points do not span a plane.
fn fit_of(
    table: &Table,
    group: &Group<'_>,
    locations: &BTreeMap<&str, Vector3<f64>>,
    how: &Points,
) -> Result<Option<(Fit, usize)>, InputError> {
    let known = |point: &Point<'_>| {
        let location = *locations.get(point.target.as_str())?;
        Some(((point.location, location), point.line.number))
    };
    let (pairs, lines): (Vec<_>, Vec<usize>) = group.points.iter().filter_map(known).unzip();
    let Some(fit) = fitted(&pairs) else {
        return Ok(None);
    };
    let line = lines[fit.worst];
    let limit = how
        .max_residual_mm
        .as_ref()
        .map_or(MAX_RESIDUAL_MM, |limit| *limit.get_ref());
    if fit.residual > limit {
        let found = format!(
            "points of pose {:?} that fit the targets only to {:.3} mm, this one worst",
            group.pose, fit.residual
        );
        return Err(InputError::new(
            &table.path,
            found,
            format!("points within {limit} mm of the targets"),
        )
        .at_line(line)
        .with_help(
            "are names of points exchanged, or is points.targets that of another tool? \
                        points.max_residual_mm is the limit",
        ));
    }
    Ok(Some((fit, line)))
}

fn in_millimetres(
    targets: &BTreeMap<String, Numbers<3>>,
    unit: Option<LengthUnit>,
) -> BTreeMap<&str, Vector3<f64>> {
    let factor = unit.map_or(1.0, LengthUnit::in_mm);
    targets
        .iter()
        .map(|(name, t)| (name.as_str(), factor * Vector3::from(t.0)))
        .collect()
}
