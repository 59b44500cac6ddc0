//! Files whose poses say less than their number, and rows that share where they are off.

use poegp_protocol::cause::Cause;

use super::{add, column, examined, table, table_of};
use crate::numeric::halton::halton;
use crate::robot::{LoadOptions, Robot};
use crate::simulation::{Scenario, SimulatedPose, Simulator, to_csv};

/// Rows that are off wherever a joint is in one range are the arm's: the joint and the range are named. The same rows off by
/// as much elsewhere are rows to measure again.
#[test]
fn a_damaged_range_of_a_joint_is_named() {
    let (header, all) = table();
    let q3 = column(&header, "q3_deg");
    let number = |row: &[String]| row[q3].parse::<f64>().unwrap();
    let damaged = |is_off: &dyn Fn(usize, &[String]) -> bool| {
        let mut rows = all[..150].to_vec();
        for (k, row) in rows.iter_mut().enumerate() {
            if is_off(k, row) {
                add(&mut row[q3], 0.3);
            }
        }
        let findings = examined(&header, &rows);
        let found = findings.0.into_iter().find(|f| f.cause == Cause::Outlier);
        found
            .unwrap_or_else(|| panic!("{:?}", examined(&header, &rows)))
            .text
    };
    let values: Vec<f64> = all[..150].iter().map(|row| number(row)).collect();
    let low = percentile_of(&values, 0.6);
    let range = low..low + 8.0;
    let text = damaged(&|_, row| range.contains(&number(row)));
    assert!(text.contains("all of them have joint 3 between"), "{text}");
    assert!(text.contains("the model does not hold there"), "{text}");
    let text = damaged(&|k, _| k % 15 == 4);
    assert!(!text.contains("between"), "{text}");
}

/// Rows near each other, on a grid or along a path are named; repeats and scattered rows are not.
#[test]
fn poses_that_say_less_than_their_number_are_named() {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let mut arm = Simulator::new(&robot, Scenario::Paper, &[1.0], 3);
    let ranges = arm.ranges().to_vec();
    let mut few = |share: &dyn Fn(usize, usize) -> f64, rows: usize| {
        let poses: Vec<SimulatedPose> = (0..rows)
            .map(|row| {
                let of = |(joint, (low, high)): (usize, &(f64, f64))| {
                    low + (high - low) * share(row, joint)
                };
                let joints: Vec<f64> = ranges.iter().enumerate().map(of).collect();
                arm.measure_at(&joints, 1.0)
            })
            .collect();
        let (header, rows) = table_of(&to_csv(&robot, &poses, false, "few"));
        let findings = examined(&header, &rows);
        let found = findings.0.into_iter().find(|f| f.cause == Cause::Few);
        found.map_or_else(String::new, |f| f.text)
    };
    let spread = |at: usize, joint: usize| halton(1 + at as u32, joint);
    let text = few(
        &|row, joint| spread(row % 20, joint) + 5e-3 * spread(row, joint),
        60,
    );
    assert!(
        text.contains("the 60 poses lie near each other at 20 stations"),
        "{text}"
    );
    let text = few(
        &|row, joint| ((37 * row + 11) / 4_usize.pow(joint as u32) % 4) as f64 / 3.0,
        60,
    );
    assert!(text.contains("on a grid (joints 1, 2, 3"), "{text}");
    // Values half a degree beside four, a grid of the first three joints only, and a rail.
    let jitter = |row, joint| 4e-3 * spread(row, joint);
    let near_four =
        |row: usize, joint: usize| ((37 * row + 11) / 4_usize.pow(joint as u32) % 4) as f64 / 3.0;
    let text = few(
        &|row, joint| 0.99 * near_four(row, joint) + jitter(row, joint),
        60,
    );
    assert!(
        text.contains("on a grid (joints 1, 2, 3, 4, 5, 6: near at most 4 values"),
        "{text}"
    );
    let first = |count: usize| {
        move |row: usize, joint: usize| match joint < count {
            true => near_four(row, joint),
            false => spread(row, joint),
        }
    };
    let text = few(&first(3), 60);
    assert!(text.contains("on a grid (joints 1, 2, 3: near"), "{text}");
    assert_eq!(few(&first(1), 60), "", "a rail");
    // Groups of eight poses, and five paths of twelve.
    let text = few(
        &|row, joint| 0.88 * spread(row % 8, joint) + 0.12 * spread(row, joint),
        64,
    );
    assert!(text.contains("in groups or along paths"), "{text}");
    let text = few(
        &|row, joint| {
            let along = (row / 5) as f64 / 11.0;
            (1.0 - along) * spread(row % 5, joint) + along * spread(row % 5 + 5, joint)
        },
        60,
    );
    assert!(text.contains("in groups or along paths"), "{text}");
    for poses in [20, 25, 40, 300] {
        for start in [0, 1_000, 20_000] {
            assert_eq!(
                few(&|row, joint| spread(start + row, joint), poses),
                "",
                "{poses} {start}"
            );
        }
    }
    assert_eq!(
        few(&|row, joint| spread(row % 20, joint), 60),
        "",
        "repeats"
    );
    assert_eq!(few(&spread, 60), "", "scattered");
}

fn percentile_of(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[(share * sorted.len() as f64) as usize]
}
