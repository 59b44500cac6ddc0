//! Numbers that are refused: in another unit than their column states, or not following the tip.

use crate::measurement::touch::tests::rejected::{refused, with_field};
use crate::measurement::touch::tests::{parse, simulated};
use crate::simulation::touches::TouchKind;

#[test]
fn gravity_that_is_no_unit_vector() {
    let (csv, toml) = simulated(TouchKind::Level, 1, 6);
    refused(
        &with_field(&csv, 1, "gz", "1.7"),
        &toml,
        &[
            "touches.csv:4: column 2 (gx): found a direction of gravity of length",
            "within 0.01 of 1",
        ],
    );
}

#[test]
fn a_reading_in_a_unit_of_no_column_is_not_ignored() {
    let (csv, toml) = simulated(TouchKind::Plane, 3, 12);
    refused(
        &with_field(&csv, 3, "value_um", "120"),
        &toml,
        &["(value_um): found the column \"value_um\", expected the column value_mm"],
    );
}

#[test]
fn a_payload_in_grams() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    refused(
        &with_field(&csv, 1, "payload_kg", "8000"),
        &toml,
        &["touches.csv:4:", "a payload of 8000 kg", "grams"],
    );
}

#[test]
fn a_wire_that_reads_the_same_in_every_row() {
    let (csv, toml) = simulated(TouchKind::Wire, 1, 6);
    let header: Vec<&str> = csv.lines().nth(1).unwrap().split(',').collect();
    let index = header.iter().position(|name| *name == "value_mm").unwrap();
    let first = csv.lines().nth(2).unwrap().split(',').nth(index).unwrap();
    let mut stuck = csv.clone();
    for number in 0..csv.lines().count() - 2 {
        stuck = with_field(&stuck, number, "value_mm", first);
    }
    refused(
        &stuck,
        &toml,
        &["touches.csv:3:", "mm in every row", "follow the tip"],
    );
}

#[test]
fn metres_under_a_name_in_millimetres() {
    let (csv, toml) = simulated(TouchKind::Wire, 1, 6);
    let mut metres = csv.clone();
    let header: Vec<&str> = csv.lines().nth(1).unwrap().split(',').collect();
    let index = header.iter().position(|name| *name == "value_mm").unwrap();
    for (number, line) in csv.lines().skip(2).enumerate() {
        let value: f64 = line.split(',').nth(index).unwrap().parse().unwrap();
        metres = with_field(&metres, number, "value_mm", &(value / 1e3).to_string());
    }
    refused(
        &metres,
        &toml,
        &[
            "touches.csv:3:",
            "no reading above",
            "of \"wire/0\"",
            "value_mm or value_m",
        ],
    );
    let named = metres.replace("value_mm", "value_m");
    assert!(parse(&named, &toml).is_ok(), "the same in metres");
    let mut inches = csv.clone();
    for (number, line) in csv.lines().skip(2).enumerate() {
        let value: f64 = line.split(',').nth(index).unwrap().parse().unwrap();
        inches = with_field(&inches, number, "value_mm", &(value / 25.4).to_string());
    }
    refused(
        &inches,
        &toml,
        &["touches.csv:3:", "times the distances of the nominal arm"],
    );
    let (csv, toml) = simulated(TouchKind::Sphere, 1, 6);
    refused(
        &csv,
        &toml.replace("radius_mm = 50", "radius_mm = 0.05"),
        &["(radius_mm): found 0.05 mm", "are these metres?"],
    );
}
