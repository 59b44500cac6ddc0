//! A payload whose poses are predicted worse than all others: few rows carry it, or its mass is wrong.

use std::collections::BTreeSet;

use poegp_protocol::cause::Cause;

use crate::measurement::sample::InstrumentSample;
use crate::trust::{Finding, Tier};

/// Held-out rows of one payload that are predicted worse than those of all others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorstPayload {
    /// The payload in kg.
    pub payload_kg: f64,
    /// Number of its rows.
    pub rows: usize,
    /// Mean position error of its rows, and of all others, in mm.
    pub mean_mm: [f64; 2],
}

impl WorstPayload {
    /// Fewest rows of a payload that are judged.
    const LEAST_ROWS: usize = 3;
    /// Ratio of the means from which on the payload is named, and the smallest difference in mm that counts.
    const WORSE: (f64, f64) = (3.0, 0.05);

    /// Finds the payload with the worst of the held-out `errors` in mm, each of the sample beside it.
    pub(in crate::validation) fn find<'a>(
        rows: impl Iterator<Item = (&'a InstrumentSample, f64)>,
    ) -> Option<Self> {
        let loaded = rows.filter_map(|(s, error)| Some((s.payload_kg?.to_bits(), error)));
        let loaded: Vec<(u64, f64)> = loaded.collect();
        let payloads: BTreeSet<u64> = loaded.iter().map(|row| row.0).collect();
        let of = |payload: u64| {
            let (own, others): (Vec<_>, Vec<_>) = loaded.iter().partition(|row| row.0 == payload);
            let mean = |rows: &[(u64, f64)]| {
                rows.iter().map(|row| row.1).sum::<f64>() / rows.len().max(1) as f64
            };
            Self {
                payload_kg: f64::from_bits(payload),
                rows: own.len(),
                mean_mm: [mean(&own), mean(&others)],
            }
        };
        let is_worse = |w: &Self| {
            let [own, others] = w.mean_mm;
            w.rows >= Self::LEAST_ROWS
                && own > Self::WORSE.0 * others
                && own - others > Self::WORSE.1
                && others > 0.0
        };
        let worse = payloads.into_iter().map(of).filter(is_worse);
        worse.max_by(|a, b| a.mean_mm[0].total_cmp(&b.mean_mm[0]))
    }

    /// Returns the warning that names the payload.
    pub fn finding(&self) -> Finding {
        let [own, others] = self.mean_mm;
        let text = format!(
            "the {} rows with {} kg are off by {own:.3} mm on average when they are held out, all others by {others:.3} mm: the \
             expected error does not hold for this payload; measure more poses with it, and check payload_kg",
            self.rows, self.payload_kg
        );
        Finding::new(
            Cause::Payload,
            Tier::Warning,
            text,
            own / others,
            Self::WORSE.0,
        )
    }
}

#[cfg(test)]
mod tests {
    use poegp_runtime::math::se3::Pose;

    use super::*;
    use crate::measurement::observation::Observation;
    use crate::measurement::sample::{Instrument, Sample};

    fn found(rows: &[(f64, f64)]) -> Option<WorstPayload> {
        let sample = |payload: f64| Sample {
            payload_kg: Some(payload),
            ..Sample::new(
                vec![],
                vec![],
                Observation::Pose(Pose::identity()),
                Instrument,
            )
        };
        let samples: Vec<InstrumentSample> = rows.iter().map(|row| sample(row.0)).collect();
        WorstPayload::find(samples.iter().zip(rows.iter().map(|row| row.1)))
    }

    /// Three rows that are four times as wrong are named, two are not, and neither is a small difference.
    #[test]
    fn a_payload_is_named_by_its_held_out_rows() {
        let mut rows = vec![(0.0, 0.1); 20];
        rows.extend([(3.0, 0.4), (3.0, 0.5)]);
        assert_eq!(found(&rows), None);
        rows.push((3.0, 0.3));
        let worst = found(&rows).unwrap();
        assert_eq!((worst.payload_kg, worst.rows), (3.0, 3));
        assert!((worst.mean_mm[0] - 0.4).abs() < 1e-12 && (worst.mean_mm[1] - 0.1).abs() < 1e-12);
        assert!(
            worst
                .finding()
                .text
                .starts_with("the 3 rows with 3 kg are off by 0.400 mm")
        );
        let small: Vec<(f64, f64)> = rows.iter().map(|row| (row.0, 0.1 * row.1)).collect();
        assert_eq!(found(&small), None);
    }
}
