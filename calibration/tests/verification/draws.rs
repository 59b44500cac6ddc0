//! The simulated null distribution against exact distributions of a single test; the numbers are from scipy (`f`, `t`, `ncf`).

use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::verification::columns::Columns;
use poegp_calibration::verification::drift_test::DriftTest;

/// Returns a test of one hypothesis with three orthonormal columns and ν = 100 residual degrees of freedom.
fn one_test(size: f64) -> DriftTest {
    let rows = 103;
    // 100 residuals of ±1 alternating, and three values of the hypothesis.
    let y = Mat::from_fn(rows, 1, |i, _| match i {
        0 => size,
        1 | 2 => 0.0,
        _ => 1.0 - 2.0 * (i % 2) as f64,
    });
    let effect: Columns = (0..3)
        .map(|j| (0..rows).map(|i| f64::from(u8::from(i == j))).collect())
        .collect();
    DriftTest::new(&y, &Vec::new(), &[effect], vec![0], 0)
}

#[test]
fn one_hypothesis_is_an_f_test() {
    let test = one_test(0.0);
    assert_eq!(test.freedom, 100);
    assert!((test.variance() - 1.0).abs() < 1e-12);
    assert!((test.critical(0.01) - 1.0).abs() < 1e-9);
    // t.ppf(0.975, 100)
    assert!(
        (test.reach() / 1.98397 - 1.0).abs() < 0.02,
        "{}",
        test.reach()
    );
    // The noncentrality λ at which ncf.sf(f.ppf(0.99, 3, 100), 3, 100, λ) is 0.9.
    let smallest = test.smallest(0, 0.01, 1.0).unwrap();
    assert!((smallest / 4.51439 - 1.0).abs() < 0.03, "{smallest}");
}

#[test]
fn p_values_are_those_of_f() {
    // 3 f.ppf(0.99, 3, 100) = 11.951, and 3 f.ppf(0.995, 3, 100) = 13.626.
    assert!(one_test(11.6_f64.sqrt()).choose(0.01, |_| true).is_empty());
    let found = one_test(12.4_f64.sqrt()).choose(0.01, |_| true);
    assert_eq!(found.len(), 1);
    let found = one_test(13.626_f64.sqrt()).choose(0.01, |_| true);
    assert!((found[0].p_value / 0.005 - 1.0).abs() < 0.3, "{found:?}");
}

/// A hypothesis that is free in any case is not found, and one that explains the same is named as looking the same.
#[test]
fn what_is_free_is_not_found_and_what_looks_the_same_is_said() {
    let rows = 60;
    let column =
        |at: usize| -> Vec<f64> { (0..rows).map(|i| f64::from(u8::from(i == at))).collect() };
    let y = Mat::from_fn(rows, 1, |i, _| match i {
        0 => 8.0,
        _ => 1.0 - 2.0 * (i % 2) as f64,
    });
    let effects = [vec![column(0)], vec![column(0), column(1)]];
    let free = DriftTest::new(&y, &vec![column(0)], &effects, vec![0, 1], 0);
    assert!(free.choose(0.01, |_| true).is_empty());
    let test = DriftTest::new(&y, &Vec::new(), &effects, vec![0, 1], 0);
    let found = test.choose(0.01, |_| true);
    assert_eq!((found.len(), found[0].hypothesis), (1, 0));
    assert!(test.explain(&[1], 0, 0.01));
    let (effect, own) = test.visible(0, 1);
    assert!((effect - 1.0).abs() < 1e-12 && own < 1e-12);
}

/// Two parts that have moved are named without the one that alone explains most of both.
#[test]
fn what_was_best_alone_is_dropped_beside_those_that_explain_it() {
    let rows = 60;
    let column = |of: [f64; 3]| -> Vec<f64> {
        (0..rows)
            .map(|i| of.get(i).copied().unwrap_or(0.0))
            .collect()
    };
    let y = Mat::from_fn(rows, 1, |i, _| match i {
        0 | 1 => 9.0,
        2 => 0.0,
        _ => 1.0 - 2.0 * (i % 2) as f64,
    });
    let effects = [
        vec![column([1.0, 1.0, 1.0])],
        vec![column([1.0, 0.0, 0.0])],
        vec![column([0.0, 1.0, 0.0])],
    ];
    let test = DriftTest::new(&y, &Vec::new(), &effects, vec![0, 1, 2], 0);
    let alone = DriftTest::new(&y, &Vec::new(), &effects[..1], vec![0], 0);
    assert_eq!(alone.choose(0.01, |_| true).len(), 1);
    let found = test.choose(0.01, |_| true);
    let named: Vec<usize> = found.iter().map(|c| c.hypothesis).collect();
    assert_eq!(named, [1, 2], "{found:?}");
    assert!(found.iter().all(|c| c.p_value < 0.01), "{found:?}");
}

/// Two parts that look almost alike explain nothing by large changes that cancel: what lies between their effects is no
/// change of both.
#[test]
fn parts_that_look_alike_do_not_move_against_each_other() {
    let rows = 60;
    let column = |of: [f64; 2]| -> Vec<f64> {
        (0..rows)
            .map(|i| of.get(i).copied().unwrap_or(0.0))
            .collect()
    };
    let y = Mat::from_fn(rows, 1, |i, _| match i {
        0 => 9.0,
        1 => 9.0,
        _ => 1.0 - 2.0 * (i % 2) as f64,
    });
    let found = |apart: f64| {
        let effects = [vec![column([1.0, 0.0])], vec![column([1.0, apart])]];
        let test = DriftTest::new(&y, &Vec::new(), &effects, vec![0, 1], 0);
        test.choose(0.01, |_| true).len()
    };
    assert_eq!((found(0.01), found(0.5)), (1, 2));
}
