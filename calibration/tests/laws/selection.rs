//! Recomputes the choice of a model from the held-out errors of its candidates.

use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::validation::model_selection::{Candidate, Choice, candidates, select_model};
use poegp_protocol::cause::Cause;

use crate::{origin, sets, task};

/// The standard error of a mean is s/√n over the differences pose by pose. The simplest candidate within one standard error
/// of the best is chosen.
#[test]
fn the_simplest_within_one_standard_error_is_chosen() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(50);
    let origin = origin(vec![ToolName::default()]);
    let task = task(&robot, &samples, &[], 5, &origin);
    let named = [
        ("base and tool", Method::BaseTool),
        ("chain", Method::Poe),
        ("chain again", Method::Poe),
    ];
    let candidates = named.map(|(name, method)| Candidate {
        name,
        config: Config::new(method),
    });
    let choice = select_model(&task, &candidates, &mut || ()).unwrap();
    let errors: Vec<Vec<f64>> = candidates
        .iter()
        .map(|c| task.held_out(&c.config, &mut || ()).unwrap())
        .map(|errors| errors.iter().map(|e| e.position_mm).collect())
        .collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let best = if mean(&errors[0]) < mean(&errors[1]) {
        0
    } else {
        1
    };
    let mut simplest = None;
    for (i, row) in choice.table.iter().enumerate() {
        let behind: Vec<f64> = errors[i]
            .iter()
            .zip(&errors[best])
            .map(|(a, b)| a - b)
            .collect();
        let n = behind.len() as f64;
        // Var = (E d² − E² d) n/(n − 1).
        let squares: Vec<f64> = behind.iter().map(|d| d * d).collect();
        let variance = (mean(&squares) - mean(&behind).powi(2)) * n / (n - 1.0);
        let standard_error = variance.max(0.0).sqrt() / n.sqrt();
        assert!((row.behind_best_mm - mean(&behind)).abs() < 1e-9, "{row:?}");
        assert!(
            (row.standard_error_mm - standard_error).abs() < 1e-6,
            "{row:?}, not {standard_error}"
        );
        if simplest.is_none() && mean(&behind) <= standard_error {
            simplest = Some(i);
        }
    }
    let chosen: Vec<usize> = (0..3).filter(|i| choice.table[*i].chosen).collect();
    assert_eq!(chosen, [simplest.unwrap()]);
    assert_eq!(
        simplest,
        Some(1),
        "the chain is the simplest that suffices, and it is chosen once"
    );
}

/// A file that has every row five times has no more information than the file itself: selection counts the same poses and
/// computes the same differences and standard errors.
#[test]
fn copies_of_all_rows_choose_as_the_rows_do() {
    let (robot, _) = sets::arm();
    let mut once = sets::simulated(&robot, "train");
    once.truncate(20);
    let origin = origin(vec![ToolName::default()]);
    let base = Config {
        outliers: OutlierPolicy::Keep,
        ..Config::default()
    };
    let chosen = |rows: &[InstrumentSample]| {
        let models = candidates(rows, &robot, &base);
        select_model(
            &task(&robot, rows, &[], 5, &origin),
            &models[..2],
            &mut || (),
        )
        .unwrap()
    };
    let (one, five) = (chosen(&once), chosen(&vec![once.clone(); 5].concat()));
    assert_eq!((one.poses, one.held_out), (20, 20));
    assert_eq!((five.poses, five.held_out), (20, 100));
    assert!(one.table[0].standard_error_mm > 0.01, "{:?}", one.table);
    for (one, five) in one.table.iter().zip(&five.table) {
        assert!((one.behind_best_mm - five.behind_best_mm).abs() < 1e-3);
        let ratio = five.standard_error_mm / one.standard_error_mm;
        assert!(
            one.standard_error_mm == 0.0 || (ratio - 1.0).abs() < 0.01,
            "{ratio}"
        );
    }
    let causes = |choice: &Choice| {
        let lines: Vec<usize> = (0..choice.held_out).collect();
        choice
            .findings(&lines)
            .iter()
            .map(|f| f.cause)
            .collect::<Vec<_>>()
    };
    assert_eq!(causes(&one), causes(&five));
    assert!(causes(&five).contains(&Cause::Model));
}
