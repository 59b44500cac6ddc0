//! Rows with the poses of other rows, and events during the measurement.

use nalgebra::Vector3;
use poegp_calibration::trust::Cause::{self, Drift, Lag, Mixed, NoFit, Rows, Step};
use rand::RngExt;
use rand::seq::SliceRandom;

use crate::mistakes::{List, direction, shift, turn};
use crate::table::Table;

/// A shift of less than this many scatters is not counted: it does little harm and cannot be seen.
const VISIBLE: f64 = 3.0;
/// Two clusters of poses are distinguishable from this many scatters on.
const MIXED: f64 = 6.0;
const SMALL: &str = "below three times the scatter of one component";

pub fn add(list: &mut List) {
    shuffles(list);
    steps(list);
    times(list);
    warm_up(list);
    lags(list);
}

fn shuffles(list: &mut List) {
    for by in 1..=3 {
        list.add(
            format!("rows: poses {by} rows late"),
            &[Rows],
            move |t, _| {
                let n = t.len();
                t.take_poses(|i| (i + n - by) % n);
            },
        );
        list.add(
            format!("rows: poses {by} rows early, cut"),
            &[Rows],
            move |t, _| {
                let n = t.len();
                t.take_poses(|i| (i + by) % n);
                t.rows.truncate(n - by);
            },
        );
    }
    let right: &[Cause] = &[Rows, NoFit, Mixed];
    list.add("rows: poses sorted by x", right, |t, _| {
        let x = t.numbers(t.position()[0]);
        let mut order: Vec<usize> = (0..t.len()).collect();
        order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
        t.take_poses(|i| order[i]);
    });
    list.add("rows: halves exchanged", right, |t, _| {
        let n = t.len();
        t.take_poses(|i| (i + n / 2) % n);
    });
    list.add("rows: poses shuffled", right, |t, r| {
        let mut order: Vec<usize> = (0..t.len()).collect();
        order.shuffle(r);
        t.take_poses(|i| order[i]);
    });
    list.add(
        "rows: one pose missing from the middle on",
        right,
        |t, r| {
            let n = t.len();
            let from = r.random_range(n / 4..3 * n / 4);
            t.take_poses(|i| if i < from { i } else { (i + 1).min(n - 1) });
            t.rows.truncate(n - 1);
        },
    );
}

/// Returns a random row in the middle half of a table.
fn middle(table: &Table, random: &mut impl RngExt) -> usize {
    random.random_range(table.len() / 4..3 * table.len() / 4)
}

fn steps(list: &mut List) {
    let scatter = list.good.scatter_mm;
    for mm in [1.0, 5.0, 200.0] {
        let right: &[Cause] = if mm > 100.0 {
            &[Mixed, Step]
        } else {
            &[Step, Mixed]
        };
        list.add(
            format!("step: instrument moved by {mm} mm"),
            right,
            move |t, r| {
                let from = middle(t, r);
                let base = shift(direction(mm, r));
                t.map_poses(from..t.len(), |_, p| base * p);
            },
        )
        .unseen(mm < VISIBLE * scatter, SMALL)
        .warns_if(mm < 3.0);
    }
    list.add(
        "step: instrument moved there and back",
        &[Step, Mixed],
        |t, r| {
            let base = shift(direction(5.0, r));
            let n = t.len();
            t.map_poses(n / 3..2 * n / 3, |_, p| base * p);
        },
    )
    .warns_if(true);
    list.add(
        "step: instrument tilted by 1 mrad",
        &[Step, Mixed],
        |t, r| {
            let from = middle(t, r);
            let base = turn(direction(1e-3, r));
            t.map_poses(from..t.len(), |_, p| base * p);
        },
    )
    .unseen(scatter > 0.2, SMALL)
    .warns_if(true);
    for mm in [2.0, 5.0] {
        list.add(
            format!("step: target slipped by {mm} mm"),
            &[Step, Mixed],
            move |t, r| {
                let from = middle(t, r);
                let tool = shift(direction(mm, r));
                t.map_poses(from..t.len(), |_, p| p * tool);
            },
        )
        .unseen(mm < VISIBLE * scatter, SMALL)
        .warns_if(mm < 3.0);
    }
    for mm in [1.0, 5.0] {
        for (what, of_base) in [("targets", false), ("places of the instrument", true)] {
            list.add(
                format!("mixed: two {what} by {mm} mm, row by row"),
                &[Mixed],
                move |t, r| {
                    let by = shift(direction(mm, r));
                    let rows: Vec<usize> = (0..t.len()).filter(|_| r.random()).collect();
                    t.map_poses(rows, |_, p| if of_base { by * p } else { p * by });
                },
            )
            .unseen(mm < MIXED * scatter, "below six times the scatter")
            .warns_if(mm < 3.0);
        }
    }
    let moving = list.good.moving();
    list.add(
        "mixed: zeros of all joints in two versions, row by row",
        &[Mixed],
        move |t, r| {
            let rows: Vec<usize> = (0..t.len()).filter(|_| r.random()).collect();
            for joint in &moving {
                let by = if r.random() { 0.3 } else { -0.3 };
                t.map_rows(t.joints()[*joint], rows.iter().copied(), |_, q| q + by);
            }
        },
    )
    .unless_absorbed();
    let mut moving = list.good.moving();
    if list.good.is_narrow() {
        // A knock of a wrist joint is absorbed by another tool.
        moving.truncate(3);
    }
    for degrees in [0.05, 0.2, 0.5] {
        let moving = moving.clone();
        list.add(
            format!("step: a joint knocked by {degrees} deg"),
            &[Step, Mixed],
            move |t, r| {
                let joint = moving[r.random_range(0..moving.len())];
                let from = middle(t, r);
                t.map_rows(t.joints()[joint], from..t.len(), |_, q| q + degrees);
            },
        )
        .unless_near()
        .warns_if(true);
    }
    for mm in [0.3, 1.0, 3.0] {
        let narrow = list.good.is_narrow() && mm < 1.0;
        list.add(
            format!("drift: creep of {mm} mm"),
            &[Drift, Step],
            move |t, r| {
                let way: Vector3<f64> = direction(mm, r);
                let n = t.len() as f64;
                t.map_all_poses(|row, p| shift(way * (row as f64 / n)) * p);
            },
        )
        .unseen(mm < VISIBLE * scatter, SMALL)
        .unseen(
            narrow,
            "the drift follows the order of the grid: joints deflect so",
        );
    }
}

/// Adds events that follow the time column instead of the order of the rows.
fn times(list: &mut List) {
    let with_time = |t: &mut Table| {
        t.add_column("time_s", "0");
        let time = t.header.len() - 1;
        for row in 0..t.len() {
            t.rows[row][time] = (20 * row).to_string();
        }
    };
    list.add(
        "step: instrument moved by 5 mm, in another order of rows",
        &[Step, Mixed],
        move |t, r| {
            with_time(t);
            let from = middle(t, r);
            let base = shift(direction(5.0, r));
            t.map_poses(from..t.len(), |_, p| base * p);
            t.rows.shuffle(r);
        },
    );
    list.add(
        "drift: creep of 3 mm, in another order of rows",
        &[Drift, Step],
        move |t, r| {
            with_time(t);
            let way = direction(3.0, r);
            let n = t.len() as f64;
            t.map_all_poses(|row, p| shift(way * (row as f64 / n)) * p);
            t.rows.shuffle(r);
        },
    );
}

/// Adds a drift that settles, as when an instrument or an arm warms up.
fn warm_up(list: &mut List) {
    let is_small = 2.0 < VISIBLE * list.good.scatter_mm;
    list.add("drift: warm-up of 2 mm", &[Drift, Step], |t, r| {
        let way: Vector3<f64> = direction(2.0, r);
        let n = t.len() as f64;
        t.map_all_poses(|row, p| shift(way * (1.0 - libm::exp(-5.0 * row as f64 / n))) * p);
    })
    .unseen(is_small, SMALL);
}

fn lags(list: &mut List) {
    for percent in [1.0, 3.0, 10.0, 20.0, 30.0] {
        list.add(
            format!("lag: joints {percent} % of the move late"),
            &[Lag],
            move |t, _| {
                let share = percent / 100.0;
                for column in t.joints() {
                    let old = t.numbers(column);
                    t.map_rows(column, 1..old.len(), |row, q| {
                        q + share * (old[row - 1] - q)
                    });
                }
            },
        )
        .unless_absorbed();
    }
    list.add("rows: positions filtered", &[Rows], |t, _| {
        for column in t.position() {
            let old = t.numbers(column);
            t.map_rows(column, 1..old.len() - 1, |row, x| {
                x + 0.005 * (old[row - 1] + old[row + 1] - 2.0 * x)
            });
        }
    })
    .unless_absorbed();
}
