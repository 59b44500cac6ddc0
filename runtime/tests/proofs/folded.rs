//! The folded form of the paper's mean, compared with the difference form: the same function, and hardly less exact in `f32`.

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};
use poegp_runtime::gp::quadratic_posterior::{
    FOLDED_RADIUS, FOLDED_REACH, MAX_SCALED_INPUT, MeanHeader, row_words,
};

use crate::arm::scattered;

/// Returns a mean of `points` points in the difference form. The points fill a box of half-width `half` in scaled units,
/// about a centre away from zero.
fn mean(inputs: usize, points: usize, half: f32) -> (MeanHeader<f64>, Vec<f64>) {
    let mut next = scattered(100 * inputs as u32 + points as u32);
    let mut header = MeanHeader::zero(inputs);
    header.input_scale[..inputs].fill(0.625);
    for output in &mut header.affine {
        output[..=inputs].fill_with(|| f64::from(next() * 1e-4));
    }
    let mut rows = Vec::new();
    for _ in 0..points {
        rows.extend((0..inputs).map(|d| 0.25 * d as f64 + f64::from(half * next())));
        rows.extend((0..OUTPUTS).map(|_| f64::from(next() * 1e-2)));
    }
    (header, rows)
}

/// Returns queries in a box that is wider by the factor `stretch`.
fn queries(inputs: usize, half: f32, stretch: f32) -> impl Iterator<Item = [f64; MAX_INPUTS]> {
    let mut next = scattered(inputs as u32 + 7);
    (0..400).map(move |_| {
        let mut x = [0.0; MAX_INPUTS];
        for (d, slot) in x.iter_mut().enumerate().take(inputs) {
            // Rounded to `f32`, so that both number types get the same query.
            let value = (0.25 * d as f32 + stretch * half * next()) / 0.625;
            *slot = f64::from(value);
        }
        x
    })
}

/// Returns Σ |weight| of each output.
fn weights(inputs: usize, rows: &[f64]) -> [f64; OUTPUTS] {
    let mut out = [0.0; OUTPUTS];
    for row in rows.chunks_exact(row_words(inputs)) {
        for (sum, weight) in out.iter_mut().zip(&row[inputs..]) {
            *sum += weight.abs();
        }
    }
    out
}

fn single(header: &MeanHeader<f64>, rows: &[f64]) -> (MeanHeader<f32>, Vec<f32>) {
    let header = MeanHeader {
        inputs: header.inputs,
        input_scale: header.input_scale.map(|x| x as f32),
        rates: None,
        centre: header.centre.map(|centre| centre.map(|x| x as f32)),
        affine: header.affine.map(|output| output.map(|x| x as f32)),
    };
    (header, rows.iter().map(|x| *x as f32).collect())
}

#[test]
fn both_forms_are_one_function() {
    for inputs in 5..=8 {
        for (half, stretch) in [(0.4, 1.0), (0.9, 1.0), (1.6, 1.0), (1.6, 4.0)] {
            let (header, rows) = mean(inputs, 60, half);
            let (mut folded, mut folded_rows) = (header, rows.clone());
            assert!(folded.fold(&mut folded_rows), "{inputs} {half}");
            let size = weights(inputs, &rows);
            let mut worst = 0.0_f64;
            for x in queries(inputs, half, stretch) {
                let (a, b) = (header.mean(&rows, &x), folded.mean(&folded_rows, &x));
                for c in 0..OUTPUTS {
                    worst = worst.max((a[c] - b[c]).abs() / size[c]);
                }
            }
            // The largest kernel value that the folded form drops.
            let reach = FOLDED_REACH - FOLDED_RADIUS;
            let bound = if stretch > 1.0 {
                libm::exp2(-reach * reach)
            } else {
                1e-14
            };
            println!("{inputs} inputs, half-width {half}, queries x {stretch}: {worst:.1e}");
            assert!(worst <= bound, "{inputs} {half} {stretch}: {worst:e}");
        }
    }
}

/// RMS errors for queries within and beyond the inducing points, against the difference form in `f64`, as shares of Σ |weight|.
#[test]
fn single_precision_loses_little_by_folding() {
    for inputs in 5..=8 {
        for half in [0.3_f32, 0.6, 1.0, 1.6] {
            let (header, rows) = mean(inputs, 60, half);
            let (mut folded, mut folded_rows) = (header, rows.clone());
            assert!(folded.fold(&mut folded_rows));
            let size = weights(inputs, &rows);
            let (difference, difference_rows) = single(&header, &rows);
            let (folded, folded_rows) = single(&folded, &folded_rows);
            let mut squares = [0.0, 0.0];
            for x in queries(inputs, half, 1.2) {
                let truth = header.mean(&rows, &x);
                let x32 = x.map(|value| value as f32);
                let found = [
                    difference.mean(&difference_rows, &x32),
                    folded.mean(&folded_rows, &x32),
                ];
                for (square, found) in squares.iter_mut().zip(found) {
                    for c in 0..OUTPUTS {
                        let error = (f64::from(found[c]) - truth[c]) / size[c];
                        *square += error * error;
                    }
                }
            }
            let [a, b] = squares.map(|square| libm::sqrt(square / (400.0 * OUTPUTS as f64)));
            println!("{inputs} inputs, half-width {half}: differences {a:.1e}, folded {b:.1e}");
            assert!(b <= 1.5 * a + 1e-9, "{inputs} {half}: {b:e} for {a:e}");
        }
    }
}

#[test]
fn what_does_not_fold_is_left_as_it_is() {
    let unchanged = |mut header: MeanHeader<f64>, rows: &[f64], why: &str| {
        let mut after = rows.to_vec();
        assert!(!header.fold(&mut after), "{why}");
        assert!(header.centre.is_none() && after == rows, "{why}");
    };
    let (header, rows) = mean(7, 40, 3.0);
    unchanged(header, &rows, "inducing points too far apart");
    for inputs in [1, 4, 9] {
        let (header, rows) = mean(inputs, 40, 0.5);
        unchanged(header, &rows, "no loop for so many inputs");
    }
    let (mut header, rows) = mean(6, 40, 0.5);
    header.rates = Some([0.5; OUTPUTS]);
    unchanged(header, &rows, "rates of each output");
    let (mut header, rows) = mean(6, 40, 0.5);
    header.input_scale = [0.0; MAX_INPUTS];
    unchanged(header, &rows, "no lengthscale");
    let (header, mut rows) = mean(6, 40, 0.5);
    rows[8] = 1e3;
    unchanged(header, &rows, "a weight beyond reason");
}

#[test]
fn a_mean_without_inducing_points_is_its_affine_part() {
    let (mut header, _) = mean(7, 0, 1.0);
    let x = queries(7, 1.0, 1.0).next().unwrap();
    let before = header.mean(&[], &x);
    assert!(header.fold(&mut []));
    assert_eq!(header.mean(&[], &x), before);
}

/// Points fold up to the radius, less a thousandth of its square: rounding to `f32` must not make a folded mean too wide.
#[test]
fn inducing_points_fold_up_to_the_radius() {
    for (squared, folds) in [(24.9, true), (25.01, false)] {
        let mut header: MeanHeader<f64> = MeanHeader::zero(6);
        header.input_scale[..6].fill(1.0);
        let mut rows = [0.0; 2 * row_words(6)];
        let place = libm::sqrt(squared);
        (rows[0], rows[row_words(6)]) = (place, -place);
        assert_eq!(header.fold(&mut rows), folds, "{squared}");
    }
}

/// What folds in `f64` is still within the radius after rounding to `f32`, as the loader sees it.
#[test]
fn what_folds_stays_within_the_radius_in_single_precision() {
    let mut next = scattered(5);
    let mut folded = 0;
    for _ in 0..2_000 {
        let mut header: MeanHeader<f64> = MeanHeader::zero(6);
        header.input_scale[..6].fill(1.0);
        let direction: [f64; 6] = core::array::from_fn(|_| f64::from(next()));
        let length = libm::sqrt(direction.iter().map(|x| x * x).sum());
        // From a thousandth below the radius to the radius.
        let place = FOLDED_RADIUS * (1.0 - 5e-4 * f64::from(1.0 + next()));
        let mut rows = [0.0; 2 * row_words(6)];
        for (d, x) in direction.iter().enumerate() {
            rows[d] = x / length * place;
            rows[row_words(6) + d] = -rows[d];
        }
        if header.fold(&mut rows) {
            folded += 1;
            let (_, rows) = single(&header, &rows);
            let squared: f32 = rows[..6].iter().map(|x| x * x).sum();
            assert!(
                squared <= (FOLDED_RADIUS * FOLDED_RADIUS) as f32,
                "{squared}"
            );
        }
    }
    assert!((500..1_900).contains(&folded), "{folded}");
}

/// However far a query is, the sum over the inducing points is zero and not NaN.
#[test]
fn far_away_the_affine_part_is_left() {
    for inputs in [3, 5, 6, 7, 8] {
        let (header, rows) = mean(inputs, 30, 0.5);
        let (narrow, narrow_rows) = single(&header, &rows);
        for far in [1e6, -1e6, 1e30, -1e30, 3e38] {
            for d in 0..inputs {
                let mut x = [0.0; MAX_INPUTS];
                x[d] = far;
                assert_eq!(header.mean(&rows, &x), header.mean(&[], &x), "{far} {d}");
                let x = x.map(|value| value as f32);
                let found = narrow.mean(&narrow_rows, &x);
                assert_eq!(found, narrow.mean(&[], &x), "{far} {d}");
            }
        }
    }
}

/// The difference form limits scaled inputs to ±200, where every kernel that a fit can give is zero. Rates near zero make the
/// limit visible, and nothing is multiplied by infinity.
#[test]
fn scaled_inputs_are_held() {
    let (mut header, rows) = mean(6, 30, 0.5);
    header.rates = Some([0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3]);
    let flat = |x: &[f64; MAX_INPUTS]| {
        let mut flat = header;
        flat.affine = [[0.0; MAX_INPUTS + 1]; OUTPUTS];
        flat.mean(&rows, x)
    };
    let (narrow, narrow_rows) = single(&header, &rows);
    let narrow = MeanHeader {
        rates: header.rates.map(|rates| rates.map(|rate| rate as f32)),
        ..narrow
    };
    for sign in [1.0, -1.0] {
        let mut at = [0.1; MAX_INPUTS];
        at[2] = sign * MAX_SCALED_INPUT / 0.625;
        let mut inside = at;
        inside[2] *= 0.99;
        assert_ne!(flat(&at), flat(&inside));
        for far in [1.01, 2.0, 1e30] {
            let mut beyond = at;
            beyond[2] *= far;
            assert_eq!(flat(&at), flat(&beyond), "{sign} {far}");
            let found = narrow.mean(&narrow_rows, &beyond.map(|value| value as f32));
            assert!(found.iter().all(|value| value.is_finite()), "{found:?}");
        }
    }
}
