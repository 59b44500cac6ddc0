//! Mutated inputs: valid inputs with a few changes, as a fuzzer makes them, reproducible from the random numbers.

use rand::{Rng, RngExt};

/// Returns one of `seeds` with a few changes, as a fuzzer makes them: flipped bits, bytes replaced by interesting values,
/// and parts removed, doubled or inserted from another seed.
pub fn mutated(seeds: &[Vec<u8>], random: &mut impl Rng) -> Vec<u8> {
    const TELLING: [&[u8]; 16] = [
        b"\0",
        b"\xff",
        b"\x80",
        b"\x7f",
        b",",
        b"\n",
        b"\"",
        b"<",
        b">",
        b"nan",
        b"inf",
        b"-1e309",
        b"1e-320",
        b"[[",
        b"=",
        b"\xef\xbb\xbf",
    ];
    let mut bytes = seeds[random.random_range(0..seeds.len())].clone();
    for _ in 0..random.random_range(1..6) {
        let at = random.random_range(0..=bytes.len());
        let to = bytes.len().min(at + random.random_range(1..40));
        match random.random_range(0..6) {
            0 | 1 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            2 => drop(bytes.splice(
                at..to.min(at + 1),
                TELLING[random.random_range(0..16)].iter().copied(),
            )),
            3 => drop(bytes.drain(at..to)),
            4 => {
                let part = bytes[at..to].to_vec();
                drop(bytes.splice(at..at, part));
            }
            _ => {
                let other = &seeds[random.random_range(0..seeds.len())];
                let from = random.random_range(0..=other.len());
                let end = other.len().min(from + 60);
                drop(bytes.splice(at..to, other[from..end].iter().copied()));
            }
        }
    }
    bytes
}
