//! Variants of a good file that must not raise an alarm.

use poegp_runtime::math::se3::Pose;
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::mistakes::{any_pose, some};
use crate::sets::{Good, Orientations};
use crate::table::Table;

type Make = fn(&Good, &mut ChaCha8Rng) -> Table;

/// Sizes of random subsets.
pub const SIZES: [usize; 4] = [30, 50, 100, 300];

/// All variants except subsets.
pub const VARIANTS: [(&str, Make); 12] = [
    ("as it is", |g, _| g.table.clone()),
    ("rows shuffled", shuffled),
    ("rows shuffled, time stated", timed),
    ("one payload after the other", in_blocks),
    ("joints in rad", in_rad),
    ("positions in m", in_metres),
    ("quaternion signs", signs),
    ("one session", one_session),
    ("another instrument frame", moved),
    ("target elsewhere", target),
    ("zero of the first joint", first_zero),
    ("sigma stated", sigma),
];

/// Returns random rows in the order of the file.
pub fn subset(good: &Good, rows: usize, random: &mut ChaCha8Rng) -> Good {
    good.of_rows(&some(good.table.len(), rows, random))
}

fn shuffled(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    table.rows.shuffle(random);
    table
}

/// Sorts the rows by payload, as a plan does.
fn in_blocks(good: &Good, _: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    if let Some(column) = table.column("payload_kg") {
        let payload = |row: &Vec<String>| row[column].parse::<f64>().expect("a payload");
        table.rows.sort_by(|a, b| payload(a).total_cmp(&payload(b)));
    }
    table
}

fn timed(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    table.add_column("time_s", "0");
    let time = table.header.len() - 1;
    for (row, fields) in table.rows.iter_mut().enumerate() {
        fields[time] = format!("{:.1}", 17.5 * row as f64);
    }
    table.rows.shuffle(random);
    table
}

fn rename(table: &mut Table, column: usize, from: &str, to: &str) {
    if let Some(name) = table.header[column].strip_suffix(from) {
        table.header[column] = format!("{name}{to}");
    }
}

fn in_rad(good: &Good, _: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    for column in table.joints() {
        table.scale(column, 1f64.to_radians());
        rename(&mut table, column, "_deg", "_rad");
    }
    table
}

fn in_metres(good: &Good, _: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    for column in table.position() {
        table.scale(column, 1e-3);
        rename(&mut table, column, "_mm", "_m");
    }
    table
}

fn signs(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    let columns = table.orientation().expect("orientations");
    for row in 0..table.len() {
        if random.random::<bool>() {
            for column in columns {
                let text = &table.rows[row][column];
                let text = text
                    .strip_prefix('-')
                    .map_or(format!("-{text}"), str::to_owned);
                table.rows[row][column] = text;
            }
        }
    }
    table
}

fn one_session(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let table = &good.table;
    let Some(column) = table.column("session") else {
        return table.clone();
    };
    let session = table.rows[random.random_range(0..table.len())][column].clone();
    let rows: Vec<usize> = (0..table.len())
        .filter(|r| table.rows[*r][column] == session)
        .collect();
    table.subset(&rows)
}

fn moved(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    let base: Pose<f64> = any_pose(3000.0, random);
    table.map_all_poses(|_, p| base * p);
    if let Some(first) = table.column("ref1_x_mm") {
        let names: Vec<String> = table.header[first..].to_vec();
        table.remove_columns(&names.iter().map(String::as_str).collect::<Vec<_>>());
    }
    table
}

fn target(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    let tool = any_pose(150.0, random);
    // A displaced target would take on the errors of the nominal arm's orientations.
    if good.orientations != Orientations::Computed {
        table.map_all_poses(|_, p| p * tool);
    }
    table
}

fn first_zero(good: &Good, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    // The base absorbs the offset, which is within the margin of the limits.
    let degrees = random.random_range(-3.0..3.0);
    let first = table.joints()[0];
    table.map(first, |_, q| q + degrees);
    table
}

fn sigma(good: &Good, _: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    if table.column("sigma_mm").is_none() {
        table.add_column("sigma_mm", &format!("{:.4}", good.scatter_mm));
    }
    table
}
