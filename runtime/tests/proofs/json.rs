//! Reads the reference vectors of `tests/data/vectors`.

use serde_json::Value;

/// Parses a file of vectors.
pub fn parse(text: &str) -> Value {
    serde_json::from_str(text).expect("a JSON file")
}

/// Returns all numbers in `value`, nested lists flattened in order.
pub fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        Value::Number(number) => vec![number.as_f64().expect("a number")],
        other => panic!("neither list nor number: {other}"),
    }
}

/// Returns `value` as an array of exactly N numbers.
pub fn array<const N: usize>(value: &Value) -> [f64; N] {
    let numbers = numbers(value);
    numbers.try_into().expect("so many numbers")
}

/// Returns the items of a list.
pub fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

/// Returns the first three rows of a 4×4 (or 3×4) matrix.
pub fn pose_rows(value: &Value) -> [f64; 12] {
    let numbers = numbers(value);
    core::array::from_fn(|index| numbers[index])
}

/// Returns max |a − b|.
pub fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let differences = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    // `f64::max` would ignore a NaN.
    differences.fold(0.0, |largest, d| if d <= largest { largest } else { d })
}
