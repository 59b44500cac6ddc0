//! Evaluates a function at every `f32` of a range, or at some of them, on all processors.

use std::{env, thread};

/// The largest error of a sweep.
#[derive(Clone, Copy, Debug)]
pub struct Worst {
    /// In the unit of the sweep.
    pub error: f64,
    /// The argument of that error.
    pub at: f32,
    /// Number of arguments.
    pub count: u64,
}

impl Worst {
    /// Before the first argument.
    pub const NOTHING: Self = Self {
        error: 0.0,
        at: 0.0,
        count: 0,
    };

    /// Adds an argument. NaN counts as an infinite error.
    pub fn add(&mut self, error: f64, at: f32) {
        self.count += 1;
        let error = if error.is_nan() { f64::INFINITY } else { error };
        if error > self.error {
            (self.error, self.at) = (error, at);
        }
    }

    /// Takes the larger error of both and the sum of the counts.
    pub fn or(self, other: Self) -> Self {
        let worse = if other.error > self.error {
            other
        } else {
            self
        };
        Self {
            count: self.count + other.count,
            ..worse
        }
    }
}

/// Returns whether `POEGP_NUMERICS` asks for every number.
pub fn exhaustive() -> bool {
    match env::var("POEGP_NUMERICS").as_deref() {
        Ok("all") => true,
        Err(_) => false,
        Ok(other) => panic!("POEGP_NUMERICS is {other:?}; it can be `all`"),
    }
}

/// Finds the largest `error` between two numbers of one sign, the first nearer to zero: over every `f32`, or over one in 4 099
/// and the last.
pub fn sweep(from: f32, to: f32, error: impl Fn(f32) -> f64 + Sync) -> Worst {
    let (first, last) = (from.to_bits(), to.to_bits());
    assert!(first <= last && (first ^ last) >> 31 == 0, "{from} to {to}");
    let step = if exhaustive() { 1 } else { 4_099 };
    let part = |first: u32, last: u32| {
        let mut worst = Worst::NOTHING;
        for bits in (first..=last).step_by(step) {
            let x = f32::from_bits(bits);
            worst.add(error(x), x);
        }
        worst
    };
    let threads = thread::available_parallelism().map_or(1, usize::from) as u32;
    let share = (last - first) / threads + 1;
    let mut worst = thread::scope(|scope| {
        let parts: Vec<_> = (0..threads)
            .map(|index| {
                let start = first + index * share;
                let end = last.min(start + (share - 1));
                scope.spawn(move || part(start, end))
            })
            .collect();
        let found = parts.into_iter().map(|part| part.join().expect("no panic"));
        found.fold(Worst::NOTHING, Worst::or)
    });
    if step > 1 {
        worst.add(error(to), to);
    }
    worst
}

/// Sweeps a range on both sides of zero.
pub fn both_signs(from: f32, to: f32, error: impl Fn(f32) -> f64 + Sync) -> Worst {
    sweep(from, to, &error).or(sweep(-from, -to, &error))
}

/// Random numbers that are the same on every machine (SplitMix64).
pub struct Random(pub u64);

impl Random {
    /// Returns a number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Returns a number in [lower, upper).
    pub fn between(&mut self, lower: f64, upper: f64) -> f64 {
        lower + self.unit() * (upper - lower)
    }
}
