//! Files with one pose in each row.

use nalgebra::Vector3;

use crate::import::beside::Beside;
use crate::import::column_map::{FileJoin, Incomplete, Map};
use crate::import::columns::{joint_columns, joint_values, twice_or_unused};
use crate::import::join::{Joined, joined};
use crate::import::origin::{Origin, ReadRows, joint_origins};
use crate::import::pose::{is_miss, pose_reader};
use crate::import::text::Table;
use crate::import::value::RowValues;
use crate::import::write::{Row, XYZ};
use poegp_calibration::input_error::{InputError, counted};

/// A larger deviation from a rotation is noted when it is removed.
const NOTED: f64 = 1e-6;

/// Returns the rows of a file, the notes for the user, and the columns of the rows. `join` is the file of joints, where they have a file of their
/// own, and how to join it.
pub fn rows(
    table: &Table,
    join: Option<(&Table, &FileJoin)>,
    map: &Map,
) -> Result<ReadRows, InputError> {
    let joint_table = join.map_or(table, |(joints, _)| joints);
    let joints = joint_columns(map, joint_table)?;
    let mut beside = Beside::find(map, table, joint_table)?;
    let pose = pose_reader(map, table)?;
    let mut beside_joints: Vec<usize> = joints.iter().map(|joint| joint.0).collect();
    beside_joints.extend(beside.payload_column());
    let (mut out, mut left_out, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    let joined = join
        .map(|(joints, how)| joined(map, how, table, joints, &mut left_out))
        .transpose()?;
    let mut used = pose.columns();
    used.extend(beside.columns());
    match &joined {
        Some(joined) => {
            used.extend(joined.pose_column);
            notes.extend(notes_on_joints(map, joint_table, &beside_joints, joined)?);
        }
        None => used.extend(&beside_joints),
    }
    notes.extend(twice_or_unused(map, table, &used)?);

    let mut worst = (0.0_f64, 0);
    let mut missed = Vec::new();
    for (i, line) in table.rows.iter().enumerate() {
        let fields = RowValues::new(table, line);
        let joint_line = match &joined {
            Some(joined) => match joined.lines[i] {
                Some(line) => line,
                None => continue,
            },
            None => line,
        };
        let joint_fields = RowValues::new(joint_table, joint_line);
        let mut needed = beside_joints.iter();
        if map.incomplete == Incomplete::LeaveOut
            && (is_miss(&fields, &pose)
                || beside.is_incomplete(&fields)
                || needed.any(|column| joint_fields.is_missing(*column)))
        {
            left_out.push(line.number.to_string());
            continue;
        }
        let mut row = Row {
            line: line.number,
            joints_line: joined.is_some().then_some(joint_line.number),
            joints: joint_values(&joint_fields, &joints)?,
            ..Row::default()
        };
        let (position, found, first) = pose.read(&fields)?;
        if pose.missed(&fields)? > 0 {
            missed.push(line.number.to_string());
        }
        if position == Vector3::zeros() {
            return Err(missed_target(&fields, first));
        }
        row.position_mm = position;
        if let Some(found) = found {
            if found.off > worst.0 {
                worst = (found.off, line.number);
            }
            row.orientation = Some(found.rotation);
        }
        beside.read(&fields, &joint_fields, &mut row)?;
        out.push(row);
    }
    if worst.0 > NOTED {
        notes.push(format!(
            "the orientations were normalised to rotations: they were off by up to {:.1e} (line {})",
            worst.0, worst.1
        ));
    }
    if !missed.is_empty() {
        let lines = missed.join(", ");
        notes.push(format!(
            "one reflector was missed, so the pose is that of the others: lines {lines}"
        ));
    }
    notes.extend(left_out_note(&left_out));
    if out.is_empty() {
        return Err(InputError::new(
            &table.path,
            "no row with a measurement",
            "at least one",
        ));
    }
    let of_joints = |column| Origin::new(joint_table, join.is_some(), column);
    let of_poses = |column| Origin::new(table, false, column);
    let mut columns = beside.origins(of_poses, of_joints);
    columns.extend(joint_origins(&joints, of_joints));
    columns.extend(pose.position().into_iter().flat_map(|position| {
        XYZ.map(str::to_owned)
            .into_iter()
            .zip(position.map(of_poses))
    }));
    Ok((out, notes, columns))
}

/// Returns the notes on a file of joints: columns that are used twice or not at all, and rows that belong to no pose.
fn notes_on_joints(
    map: &Map,
    table: &Table,
    columns: &[usize],
    joined: &Joined<'_>,
) -> Result<Vec<String>, InputError> {
    let mut used = columns.to_vec();
    used.extend(joined.joint_column);
    let mut notes = Vec::new();
    notes.extend(twice_or_unused(map, table, &used)?);
    if joined.unused > 0 {
        let path = table.path.display();
        let rows = match joined.unused {
            1 => "1 row of joints belongs".to_owned(),
            rows => format!("{rows} rows of joints belong"),
        };
        notes.push(format!("{path}: {rows} to no pose"));
    }
    Ok(notes)
}

/// Returns the error for a position of zeros, whose first column is `first`.
fn missed_target(fields: &RowValues<'_>, first: usize) -> InputError {
    fields
        .error(first, "the position 0 0 0", "a measured position")
        .with_help(
            "an instrument writes 0 0 0 where it missed the target; incomplete = \"leave-out\" in the map leaves \
             such rows out and lists them",
        )
}

/// Returns the note on rows that were left out at the map's request.
pub fn left_out_note(what: &[String]) -> Option<String> {
    (!what.is_empty()).then(|| {
        let rows = counted(what.len(), "row");
        format!(
            "left out, as the map asks: {rows} without a complete measurement (lines {})",
            what.join(", ")
        )
    })
}
