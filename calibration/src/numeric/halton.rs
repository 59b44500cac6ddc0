//! The Halton sequence: deterministic points that fill a cube evenly.

/// Bases of the sequence, one for each dimension.
const PRIMES: [u32; 9] = [2, 3, 5, 7, 11, 13, 17, 19, 23];

/// Returns coordinate `dimension` (from 0) of point `index` (from 1), in (0, 1): the digits of the index in a prime base,
/// mirrored at the decimal point (Halton 1960).
pub fn halton(index: u32, dimension: usize) -> f64 {
    let base = PRIMES[dimension % PRIMES.len()];
    let (mut rest, mut digit, mut out) = (index, 1.0, 0.0);
    while rest > 0 {
        digit /= f64::from(base);
        out += digit * f64::from(rest % base);
        rest /= base;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_points_are_those_of_the_book() {
        let line = |dimension| [1, 2, 3, 4, 5].map(|index| halton(index, dimension));
        assert_eq!(line(0), [0.5, 0.25, 0.75, 0.125, 0.625]);
        let thirds = [3.0, 6.0, 1.0, 4.0, 7.0].map(|ninths| ninths / 9.0);
        for (found, book) in line(1).iter().zip(thirds) {
            assert!((found - book).abs() < 1e-15);
        }
    }
}
