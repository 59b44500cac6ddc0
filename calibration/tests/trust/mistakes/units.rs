//! Wrong units under unchanged column names: positions, joints, uncertainties, payloads.

use std::collections::BTreeSet;

use poegp_calibration::trust::Cause::{NoFit, Noise, Payload, Unit};
use rand::RngExt;
use rand::seq::SliceRandom;

use crate::mistakes::List;
use crate::table::Table;

/// Multiplies the positions by a factor without renaming the columns.
fn scale_positions(table: &mut Table, factor: f64) {
    for column in table.position() {
        table.scale(column, factor);
    }
}

fn rename(table: &mut Table, column: usize, from: &str, to: &str) {
    let name = table.header[column].strip_suffix(from).expect("the unit");
    table.header[column] = format!("{name}{to}");
}

pub fn add(list: &mut List) {
    for (name, factor) in [
        ("unit: metres under _mm", 1e-3),
        ("unit: inches under _mm", 1.0 / 25.4),
        ("unit: centimetres under _mm", 0.1),
        ("unit: feet under _mm", 1.0 / 304.8),
        ("unit: micrometres under _mm", 1e3),
    ] {
        let hides = factor < 1.0 && list.good.turns_about_a_point();
        list.add(name, &[Unit], move |t, _| scale_positions(t, factor))
            .unseen(
                hides,
                "all joints that move turn about a point: a target elsewhere fits any scale",
            );
    }
    list.add("unit: millimetres under _m", &[Unit], |t, _| {
        for column in t.position() {
            rename(t, column, "_mm", "_m");
        }
    });
    list.add(
        "unit: one position column in metres",
        &[Unit, NoFit],
        |t, r| {
            let column = t.position()[r.random_range(0..3)];
            t.scale(column, 1e-3);
        },
    );
    list.add(
        "unit: one axis of the instrument 1 % long",
        &[Unit],
        |t, r| {
            let column = t.position()[r.random_range(0..3)];
            t.scale(column, 1.01);
        },
    )
    .unless_absorbed();
    list.add("unit: joints in rad under _deg", &[Unit], |t, _| {
        for column in t.joints() {
            t.scale(column, 1f64.to_radians());
        }
    });
    for (name, factor) in [("gon", 400.0 / 360.0), ("turns", 1.0 / 360.0)] {
        let right = [Unit, NoFit];
        list.add(
            format!("unit: joints in {name} under _deg"),
            &right,
            move |t, _| {
                for column in t.joints() {
                    t.scale(column, factor);
                }
            },
        );
    }
    list.add("unit: joints in deg under _rad", &[Unit], |t, _| {
        for column in t.joints() {
            rename(t, column, "_deg", "_rad");
        }
    });
    let moving = list.good.moving();
    list.add("unit: one joint in rad under _deg", &[Unit], move |t, r| {
        let joint = moving[r.random_range(0..moving.len())];
        t.scale(t.joints()[joint], 1f64.to_radians());
    })
    .unless_absorbed();
    add_sigma(list);
    add_payload(list);
}

fn add_sigma(list: &mut List) {
    let scatter = list.good.scatter_mm;
    for (name, factor) in [
        ("noise: sigma a thousand times too large", 1e3),
        ("noise: sigma a thousand times too small", 1e-3),
    ] {
        list.add(name, &[Noise], move |t, _| {
            if let Some(column) = t.column("sigma_mm") {
                t.scale(column, factor);
            } else {
                t.add_column("sigma_mm", &format!("{:.6}", factor * scatter));
            }
        });
    }
}

/// Returns the distinct payloads of a table.
fn payloads(table: &Table, column: usize) -> Vec<f64> {
    let once: BTreeSet<u64> = table.numbers(column).iter().map(|p| p.to_bits()).collect();
    once.into_iter().map(f64::from_bits).collect()
}

fn add_payload(list: &mut List) {
    let Some(column) = list.good.table.column("payload_kg") else {
        return;
    };
    let carried = payloads(&list.good.table, column);
    let few = carried.len() < 3;
    let reach = list.good.reach();
    let set = move |t: &mut Table, change: &mut dyn FnMut(usize, f64) -> f64| {
        for row in 0..t.len() {
            let value = change(row, t.number(row, column));
            t.rows[row][column] = format!("{}", (1e4 * value).round() / 1e4);
        }
    };
    list.add("payload: grams under _kg", &[Payload, Unit], move |t, _| {
        set(t, &mut |_, p| 1e3 * p);
    });
    list.add(
        "payload: more than such an arm carries",
        &[Payload, Unit],
        move |t, _| {
            let most = carried_most(t, column);
            set(t, &mut |_, p| p * 100.0 * reach.powi(3) / most);
        },
    );
    list.add("payload: negative", &[Payload], move |t, r| {
        let row = r.random_range(0..t.len());
        t.rows[row][column] = "-1".to_owned();
    });
    list.add("payload: all in lb", &[Payload, Unit], move |t, _| {
        set(t, &mut |_, p| 2.20462 * p);
    })
    .unseen(true, "only mass times compliance shows");
    list.add("payload: one of several in lb", &[Payload], move |t, r| {
        let carried = payloads(t, column);
        let heavy = &carried[carried.len() / 2..];
        let one = heavy[r.random_range(0..heavy.len())];
        set(t, &mut |_, p| if p == one { 2.20462 * p } else { p });
    })
    .unseen(
        few,
        "two payloads have one difference: only mass times compliance shows",
    )
    .unless_small();
    let ends = [carried[0], carried[carried.len() - 1]];
    list.add("payload: labels exchanged", &[Payload], move |t, _| {
        set(t, &mut |_, p| ends[0] + ends[1] - p);
    })
    .unless_small()
    .only_warns = false;
    list.add("payload: gravity reversed", &[Payload], |_, _| {})
        .unseen(ends[0] == ends[1], "one payload")
        .upside_down()
        .only_warns = false;
    list.add("payload: in another order", &[Payload], move |t, r| {
        let mut order = t.numbers(column);
        order.shuffle(r);
        set(t, &mut |row, _| order[row]);
    })
    .unless_small();
    list.add(
        "payload: one stated where several were carried",
        &[Payload],
        move |t, _| {
            let first = t.number(0, column);
            set(t, &mut |_, _| first);
        },
    )
    .unless_small();
}

fn carried_most(table: &Table, column: usize) -> f64 {
    table.numbers(column).into_iter().fold(0.0, f64::max)
}
