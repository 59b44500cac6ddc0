//! Inputs made of valid ones by a few changes, as a fuzzer makes them; the same for the same random numbers.

use rand::{Rng, RngExt};

/// Bytes made from one of `seeds` by a few changes, as a fuzzer makes them: bits flipped, bytes replaced by telling ones,
/// parts taken out, doubled, or brought in from another seed.
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
