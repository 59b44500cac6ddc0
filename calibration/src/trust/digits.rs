//! The digits in which positions are written.

use nalgebra::Vector3;

use crate::measurement::MeasurementSet;

/// Returns the step of the digits of values: the largest power of ten that divides all of them; 0 if they have more digits
/// than matter, or are all equal.
pub fn step(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let first = values.clone().next();
    if values.clone().all(|v| Some(v) == first) {
        return 0.0;
    }
    for exponent in (-6..=3).rev() {
        let step = 10.0_f64.powi(exponent);
        let divides = |v: f64| {
            let count = v / step;
            (count - count.round()).abs() < 1e-6
        };
        if values.clone().all(divides) {
            return step;
        }
    }
    0.0
}

/// Returns the position coordinates of all rows, in mm.
pub fn positions_mm(set: &MeasurementSet) -> impl Iterator<Item = f64> + Clone + '_ {
    set.measurements.iter().flat_map(|m| {
        let p: Vector3<f64> = m.position * 1e3;
        [p[0], p[1], p[2]]
    })
}
