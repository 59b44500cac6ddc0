//! Values that are not measurements (computed, copied, held, clipped, rounded, missing), and rows that do not belong.

use poegp_calibration::trust::Cause::{
    self, Clip, Copies, Few, Mixed, Orientation, Outlier, Placeholder, Readout, Rounding, Stuck,
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::mistakes::{List, any_pose, direction, normal, shift, some, turn};
use crate::sets::Good;
use crate::table::Table;

pub fn add(list: &mut List) {
    readouts(list);
    copies(list);
    placeholders(list);
    clips(list);
    outliers(list);
    roundings(list);
    texts(list);
    let moving = list.good.moving().len();
    for rows in [6, 8] {
        list.add(format!("few: {rows} rows"), &[Few], move |t, r| {
            *t = t.subset(&some(t.len(), rows, r));
        })
        .unseen(6 * rows > 3 * (4 * moving + 6), "enough for so few joints");
    }
}

/// Returns the poses that the controller computes, with noise of `noise_um` per axis.
fn readout(good: &Good, noise_um: f64, random: &mut ChaCha8Rng) -> Table {
    let mut table = good.table.clone();
    let chain = good.robot.chain().expect("a chain");
    let (base, tool) = (any_pose(2.0, random), any_pose(0.1, random));
    table.map_all_poses(|row, _| {
        let joints = good.robot.serial_joints(&good.table.joints_rad(row));
        let mut pose = base * chain.forward(&joints) * tool;
        pose.rotation = turn(normal(noise_um * 2e-6, random)).rotation * pose.rotation;
        pose.translation = 1e3 * pose.translation + normal(noise_um * 1e-3, random);
        pose
    });
    table
}

fn readouts(list: &mut List) {
    list.add_of_set("readout: exact", &[Readout], |g, r| readout(g, 0.0, r));
    list.add_of_set("readout: rounded to three decimals", &[Readout], |g, r| {
        let mut table = readout(g, 0.0, r);
        for column in table.position() {
            for row in 0..table.len() {
                let value = table.number(row, column);
                table.write(row, column, value, 3);
            }
        }
        table
    });
    for um in [5.0, 20.0, 50.0] {
        list.add_of_set(
            format!("readout: with {um} um of noise"),
            &[Readout],
            move |g, r| readout(g, um, r),
        )
        .warns_if(um > 5.0);
    }
}

/// Draws a share of the rows, in order, never the first.
fn share_of(table: &Table, share: f64, random: &mut ChaCha8Rng) -> Vec<usize> {
    let count = ((share * table.len() as f64).round() as usize).max(1);
    some(table.len() - 1, count, random)
        .iter()
        .map(|r| r + 1)
        .collect()
}

fn copies(list: &mut List) {
    list.add("copies: one row fifty times", &[Copies], |t, r| {
        let row = t.rows[r.random_range(0..t.len())].clone();
        t.rows.extend(std::iter::repeat_n(row, 49));
    });
    list.add("copies: a fifth of the rows twice", &[Copies], |t, r| {
        let twice = share_of(t, 0.2, r);
        t.rows
            .extend(twice.iter().map(|i| t.rows[*i].clone()).collect::<Vec<_>>());
    });
    list.add(
        "copies: a fifth twice, with 2 um of jitter",
        &[Copies],
        |t, r| {
            let twice = share_of(t, 0.2, r);
            let first = t.len();
            t.rows
                .extend(twice.iter().map(|i| t.rows[*i].clone()).collect::<Vec<_>>());
            t.map_poses(first..t.len(), |_, p| shift(normal(2e-3, r)) * p);
        },
    );
    for held in [2, 10] {
        list.add(
            format!("stuck: the pose held for {held} rows"),
            &[Stuck],
            move |t, r| {
                let from = r.random_range(1..t.len() - held);
                t.take_poses(|i| {
                    if (from..from + held).contains(&i) {
                        from - 1
                    } else {
                        i
                    }
                });
            },
        );
    }
    let moving = list.good.moving();
    list.add(
        "stuck: one joint's previous value held for 10 rows",
        &[Stuck, Outlier],
        move |t, r| {
            let column = t.joints()[moving[r.random_range(0..moving.len())]];
            let values = t.numbers(column);
            let is_wrong = |from: usize| {
                let apart = |row: &f64| (row - values[from - 1]).abs() > 5.0;
                values[from..from + 10].iter().any(apart)
            };
            let starts: Vec<usize> = (1..t.len() - 10).filter(|f| is_wrong(*f)).collect();
            let from = starts[r.random_range(0..starts.len())];
            let held = t.rows[from - 1][column].clone();
            for row in from..from + 10 {
                t.rows[row][column].clone_from(&held);
            }
        },
    )
    .warns_if(true);
}

fn placeholders(list: &mut List) {
    for value in ["9999", "-9999", "1000000", "-99999.0"] {
        list.add(
            format!("placeholder: {value} for a missed position"),
            &[Placeholder],
            move |t, r| {
                for row in share_of(t, 0.03, r) {
                    for column in t.position() {
                        t.rows[row][column] = value.to_owned();
                    }
                }
            },
        );
    }
    list.add(
        "placeholder: 9999 for a missed z",
        &[Placeholder, Clip],
        |t, r| {
            for row in share_of(t, 0.03, r) {
                let z = t.position()[2];
                t.rows[row][z] = "9999".to_owned();
            }
        },
    );
    if list.good.positions_only() {
        return;
    }
    let right: &[Cause] = &[Placeholder, Orientation];
    list.add(
        "placeholder: identity for a missed orientation",
        right,
        |t, r| {
            let columns = t.orientation().expect("orientations");
            for row in share_of(t, 0.05, r) {
                for (column, value) in columns.into_iter().zip(["1", "0", "0", "0"]) {
                    t.rows[row][column] = value.to_owned();
                }
            }
        },
    );
    list.add(
        "placeholder: identity for every orientation",
        right,
        |t, _| {
            let columns = t.orientation().expect("orientations");
            for row in &mut t.rows {
                for (column, value) in columns.into_iter().zip(["1", "0", "0", "0"]) {
                    row[column] = value.to_owned();
                }
            }
        },
    );
    list.add(
        "stuck: the previous orientation held",
        &[Stuck, Placeholder, Outlier, Orientation],
        |t, r| {
            let columns = t.orientation().expect("orientations");
            for row in share_of(t, 0.05, r) {
                for column in columns {
                    t.rows[row][column] = t.rows[row - 1][column].clone();
                }
            }
        },
    )
    .warns_if(true);
}

/// Clips a column so that a tenth of its values are at the extreme.
fn clip(table: &mut Table, column: usize) {
    let mut values = table.numbers(column);
    values.sort_by(f64::total_cmp);
    let most = values[values.len() - 1 - values.len() / 10];
    table.map(column, |_, v| v.min(most));
}

fn clips(list: &mut List) {
    let moving = list.good.moving();
    list.add("clip: a joint column", &[Clip], move |t, r| {
        let joint = moving[r.random_range(0..moving.len())];
        clip(t, t.joints()[joint]);
    });
    list.add("clip: a position column", &[Clip], |t, r| {
        clip(t, t.position()[r.random_range(0..3)]);
    });
}

fn outliers(list: &mut List) {
    for percent in [1, 5, 9] {
        for mm in [3.0, 10.0, 100.0] {
            let name = format!("outlier: {percent} % of the rows by {mm} mm");
            list.add(name, &[Outlier], move |t, r| {
                let rows = share_of(t, f64::from(percent) / 100.0, r);
                t.map_poses(rows, |_, p| shift(direction(mm, r)) * p);
            });
        }
    }
    list.add(
        "outlier: a tenth on another reflector",
        &[Outlier, Mixed],
        |t, r| {
            let tool = shift(direction(60.0, r));
            let rows = share_of(t, 0.1, r);
            t.map_poses(rows, |_, p| p * tool);
        },
    );
}

fn roundings(list: &mut List) {
    let scatter = list.good.scatter_mm;
    for (mm, decimals) in [(0.1, 1), (1.0, 0)] {
        list.add(
            format!("rounding: positions to {mm} mm"),
            &[Rounding],
            move |t, _| {
                for column in t.position() {
                    for row in 0..t.len() {
                        let value = t.number(row, column);
                        t.write(row, column, value, decimals);
                    }
                }
            },
        )
        .unseen(mm / 12f64.sqrt() < 0.5 * scatter, "below the scatter");
    }
    for (degrees, decimals) in [(0.1, 1), (1.0, 0)] {
        list.add(
            format!("rounding: joints to {degrees} deg"),
            &[Rounding],
            move |t, _| {
                for column in t.joints() {
                    for row in 0..t.len() {
                        let value = t.number(row, column);
                        t.write(row, column, value, decimals);
                    }
                }
            },
        );
    }
}

/// Adds fields that are not numbers; the reader must name them.
fn texts(list: &mut List) {
    for (name, text) in [
        ("NaN", "NaN"),
        ("an empty field", ""),
        ("a decimal comma", "1,5"),
    ] {
        list.add(
            format!("text: {name} for a missed position"),
            &[Placeholder],
            move |t, r| {
                let (row, column) = (r.random_range(0..t.len()), t.position()[0]);
                t.rows[row][column] = text.to_owned();
            },
        );
    }
    list.add("text: the last row cut", &[Placeholder], |t, _| {
        let fields = t.position()[1];
        t.rows.last_mut().expect("rows").truncate(fields);
    });
}
