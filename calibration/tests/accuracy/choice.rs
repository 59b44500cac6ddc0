//! `select_model` chooses among the remaining candidates when some cannot be calibrated or exported.

use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::validation::cross_validation::Task;
use poegp_calibration::validation::model_selection::{Candidate, FOLDS, select_model};

use crate::{arm, origin, samples, simulated_path};

/// Returns a candidate that no device can run: its correction limit is above the largest that a device takes, a metre.
fn impossible(name: &'static str) -> Candidate {
    Candidate {
        name,
        config: Config {
            max_correction_mm: Some(5e3),
            ..Config::new(Method::PoeGp)
        },
    }
}

#[test]
fn what_no_device_can_run_is_left_out_of_the_choice_with_its_reason() {
    let (robot, _) = arm("abb-irb4400-serial");
    let train = samples(&simulated_path("paper_s0_train"), &robot);
    let origin = origin(1);
    let task = Task {
        robot: &robot,
        train: &train[..40],
        tests: &[],
        folds: FOLDS,
        seed: 1,
        origin: &origin,
        cancel: &NEVER,
        threads: threads(),
    };
    let possible = Candidate {
        name: "poe",
        config: Config::new(Method::Poe),
    };
    let candidates = [impossible("first"), possible, impossible("last")];
    let choice = select_model(&task, &candidates, &mut || {}).unwrap();
    assert_eq!(choice.config.method, Method::Poe);
    assert_eq!(choice.table.len(), 1);
    assert!(choice.table[0].chosen);
    let left_out: Vec<_> = choice.left_out.iter().map(|out| out.candidate).collect();
    assert_eq!(left_out, ["first", "last"]);
    for out in &choice.left_out {
        assert!(out.reason.contains("limit"), "{}", out.reason);
    }
    assert!(select_model(&task, &[impossible("only")], &mut || {}).is_err());
}
