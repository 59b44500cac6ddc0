//! Arms that others measured. The data are theirs and not part of this repository: the environment variable
//! `POEGP_MEASURED_DATA` names a folder that has them.

use std::path::Path;

use poegp_trainer::calibration::{Method, Options};

use crate::{arm, compare, samples, say};

const FOLDER: &str = "POEGP_MEASURED_DATA";
const FOLDS: usize = 5;

/// A model with the largest mean position error in mm that it may have.
struct Bound {
    method: Method,
    weighted: bool,
    mean_mm: f64,
    /// Of the worst fold.
    fold_mm: f64,
}

impl Bound {
    const fn new(method: Method, weighted: bool, mean_mm: f64) -> Self {
        Self {
            method,
            weighted,
            mean_mm,
            fold_mm: f64::INFINITY,
        }
    }
}

/// Cross-validates on `file` where it can be had, and says so where not.
fn check(file: &str, robot: &str, bounds: &[Bound]) {
    let Some(folder) = std::env::var_os(FOLDER) else {
        say(format_args!("{file}: not run: {FOLDER} is not set"));
        return;
    };
    let arm = arm(robot);
    let train = samples(&Path::new(&folder).join(file), &arm.0);
    say(format_args!(
        "{file}: {} poses, {FOLDS} folds, mean position error in mm",
        train.len()
    ));
    let mut failed = Vec::new();
    for bound in bounds {
        let options = Options {
            weighted: bound.weighted,
            ..Options::new(bound.method)
        };
        let found = compare(&arm, &train, &[], FOLDS, &options);
        let errors = found.cross_validation.unwrap();
        let folds: Vec<f64> = errors.folds.iter().map(|f| f.position_mm.mean).collect();
        let (mean, worst) = (
            errors.all.position_mm.mean,
            folds.iter().copied().fold(0.0, f64::max),
        );
        let flag = if bound.weighted { " --weighted" } else { "" };
        let name = format!("{}{flag}", found.model);
        say(format_args!(
            "  {name:20} {mean:.4} (at most {:.3}), folds {folds:.3?}",
            bound.mean_mm
        ));
        if mean > bound.mean_mm || worst > bound.fold_mm {
            failed.push(name);
        }
    }
    assert!(failed.is_empty(), "{file}: {failed:?}");
}

#[test]
fn an_irb_120_and_a_laser_tracker() {
    let bounds = [
        Bound::new(Method::Poe, false, 0.65),
        Bound::new(Method::Poe, true, 0.207),
        Bound::new(Method::PoeGp, false, 0.115),
    ];
    check("abb_irb120_faro_700.csv", "abb-irb120", &bounds);
}

#[test]
fn an_iiwa_with_seven_joints() {
    let bounds = [
        Bound::new(Method::Poe, true, 0.68),
        Bound {
            fold_mm: 2.0,
            ..Bound::new(Method::Poe, false, 1.6)
        },
    ];
    check("kuka_iiwa7_304.csv", "kuka-iiwa7", &bounds);
}
