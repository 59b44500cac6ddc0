//! Counters and CPU times of a bridge.

/// Width of a step in the histogram of CPU times, in ns, and below it the number of steps: up to 2 ms.
const STEP_NS: u64 = 100;
const STEPS: usize = 20_000;

/// Counters since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Received datagrams.
    pub received: u64,
    /// Answered cycles.
    pub cycles: u64,
    /// Sessions of the controller.
    pub sessions: u64,
    /// Packets whose time stamp had come before.
    pub duplicates: u64,
    /// Packets that came after their successor; they have no answer.
    pub late: u64,
    /// Cycles without a packet.
    pub lost: u64,
    /// Datagrams that are no packet, and packets of no session.
    pub garbage: u64,
    /// Datagrams from another address.
    pub foreign: u64,
    /// Cycles whose axes could not be used; the correction was held.
    pub refused: u64,
    /// Cycles in which an axis was at the limit of the correction.
    pub limited: u64,
    /// Cycles in which an axis was at the limit of its change.
    pub slowed: u64,
    /// Cycles whose axes or payload are outside the trained ranges.
    pub outside: u64,
    /// Cycles that were corrected in part, near a singularity.
    pub partly: u64,
    /// Cycles in which the correction was withdrawn, because too many packets were lost.
    pub withdrawn: u64,
    /// Largest correction of an axis, in degrees.
    pub largest_deg: f64,
}

/// CPU times of cycles.
#[derive(Clone, Debug)]
pub struct Times {
    steps: Vec<u32>,
    count: u64,
    sum_ns: u64,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            steps: vec![0; STEPS],
            count: 0,
            sum_ns: 0,
        }
    }
}

/// CPU times of cycles in µs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Mean CPU time.
    pub mean: f64,
    /// Median CPU time.
    pub p50: f64,
    /// 99th percentile of the CPU time.
    pub p99: f64,
}

impl Times {
    /// Adds the CPU time of one cycle.
    pub fn add(&mut self, nanoseconds: u64) {
        let step = (nanoseconds / STEP_NS).min(STEPS as u64 - 1);
        self.steps[step as usize] += 1;
        self.count += 1;
        self.sum_ns += nanoseconds;
    }

    /// Returns mean and percentiles; `None` before the first cycle. Percentiles are upper bounds, to 0.1 µs.
    pub fn spread(&self) -> Option<Spread> {
        let percentile = |percent: u64| {
            let wanted = (self.count * percent).div_ceil(100);
            let mut sum = 0;
            let at = self.steps.iter().position(|count| {
                sum += u64::from(*count);
                sum >= wanted
            });
            1e-3 * ((at.unwrap_or(STEPS) as u64 + 1) * STEP_NS) as f64
        };
        (self.count > 0).then(|| Spread {
            mean: 1e-3 * self.sum_ns as f64 / self.count as f64,
            p50: percentile(50),
            p99: percentile(99),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_a_hundred_times() {
        let mut times = Times::default();
        assert_eq!(times.spread(), None);
        for us in 1..=100_u64 {
            times.add(us * 1000 - 1);
        }
        let spread = times.spread().unwrap();
        assert!((spread.mean - 50.499).abs() < 1e-9, "{spread:?}");
        assert!((spread.p50 - 50.0).abs() < 1e-9 && (spread.p99 - 99.0).abs() < 1e-9);
        times.add(u64::MAX >> 8);
        assert!(times.spread().unwrap().p99 < 101.0);
    }
}
