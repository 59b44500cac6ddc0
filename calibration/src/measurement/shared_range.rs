//! Whether rows that were singled out share a short range of one joint, or a payload: a damaged tooth, a cable or a brake puts
//! every row of its range off, and an arm that gives way every row of its load; a mistake of measuring puts rows off wherever
//! the arm is and whatever it carries.

use crate::numeric::statistics::distinct;

/// Least number of rows that can share a range.
const LEAST: usize = 5;
/// Share of the rows that must be within the range.
const WITHIN: f64 = 0.8;
/// Most ranges this short expected of as many rows drawn at random.
const BY_CHANCE: f64 = 1e-3;

/// Largest share of all rows of a payload that few carry, and most such payloads expected of rows drawn at random: a row
/// that is kept by mistake does less harm than a payload that is not learnt from.
const RARE: f64 = 0.15;
const RARE_BY_CHANCE: f64 = 0.02;

/// A range of one joint that rows share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedRange {
    /// The joint, from 0.
    pub joint: usize,
    /// Smallest and largest value of the joint, in rad or m.
    pub limits: (f64, f64),
    /// Number of the rows within.
    pub within: usize,
}

impl SharedRange {
    /// Returns the range that `rows`, indices into `joints`, share more clearly than rows drawn at random would; `None` if
    /// there is none.
    ///
    /// With all values in order, the chance that k rows of n lie within m neighbours is below k (m/n)^(k−1) for a uniform
    /// draw; it is multiplied by the number of joints and of choices of k among the rows.
    pub fn find(joints: &[&[f64]], rows: &[usize]) -> Option<Self> {
        let within = (WITHIN * rows.len() as f64).ceil() as usize;
        if within < LEAST {
            return None;
        }
        let columns = (0..joints.first()?.len()).map(|joint| Column::new(joints, rows, joint));
        let ranges = columns.flat_map(|column| {
            let of = |within: usize| {
                let range = column.shortest(within)?;
                Some((range, column.chance(&range, joints[0].len())))
            };
            (within..=rows.len()).filter_map(of).collect::<Vec<_>>()
        });
        let (best, chance) = ranges.min_by(|a, b| a.1.total_cmp(&b.1))?;
        (chance < BY_CHANCE).then_some(best)
    }
}

/// The values of one joint in ascending order.
struct Column {
    joint: usize,
    /// Values of all rows.
    all: Vec<f64>,
    /// Values of the rows that were singled out.
    rows: Vec<f64>,
}

impl Column {
    fn new(joints: &[&[f64]], rows: &[usize], joint: usize) -> Self {
        let mut all: Vec<f64> = joints.iter().map(|q| q[joint]).collect();
        let mut rows: Vec<f64> = rows.iter().map(|row| all[*row]).collect();
        all.sort_by(f64::total_cmp);
        rows.sort_by(f64::total_cmp);
        Self { joint, all, rows }
    }

    /// Returns the number of all rows within the limits.
    fn neighbours(&self, (low, high): (f64, f64)) -> usize {
        self.all.partition_point(|q| *q <= high) - self.all.partition_point(|q| *q < low)
    }

    /// Returns the range of `within` rows that has the fewest other rows.
    fn shortest(&self, within: usize) -> Option<SharedRange> {
        let windows = self.rows.windows(within).map(|w| (w[0], w[within - 1]));
        let limits = windows.min_by_key(|limits| self.neighbours(*limits))?;
        Some(SharedRange {
            joint: self.joint,
            limits,
            within,
        })
    }

    /// Returns how many ranges with as few neighbours are expected of rows drawn at random from all, in one of `joints`.
    fn chance(&self, range: &SharedRange, joints: usize) -> f64 {
        let share = self.neighbours(range.limits) as f64 / self.all.len() as f64;
        let outside = self.rows.len() - range.within;
        let choices = (0..outside).map(|i| (self.rows.len() - i) as f64 / (i + 1) as f64);
        let drawn = range.within as f64 * libm::pow(share, (range.within - 1) as f64);
        drawn * choices.product::<f64>() * joints as f64
    }
}

/// Returns the payload in kg, carried by few rows, that `rows`, indices into `payloads`, share more clearly than rows drawn at
/// random would; `None` if there is none: an arm that gives way as no other row shows is off wherever it carries that payload.
///
/// The chance that k rows drawn at random from n are all among the m rows of one payload is below (m/n)^k.
pub fn shared_payload(payloads: &[Option<f64>], rows: &[usize]) -> Option<f64> {
    let of_rows = distinct(rows.iter().filter_map(|row| payloads[*row]));
    let all = payloads.len() as f64;
    let count = |rows: &mut dyn Iterator<Item = Option<f64>>, payload: f64| {
        rows.filter(|p| *p == Some(payload)).count()
    };
    of_rows.into_iter().find(|payload| {
        let within = count(&mut rows.iter().map(|row| payloads[*row]), *payload);
        let share = count(&mut payloads.iter().copied(), *payload) as f64 / all;
        let kinds = distinct(payloads.iter().flatten().copied()).len() as f64;
        within as f64 >= WITHIN * rows.len() as f64
            && share <= RARE
            && kinds * libm::pow(share, within as f64) < RARE_BY_CHANCE
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of two joints that change independently of each other.
    fn two_joints() -> Vec<[f64; 2]> {
        let row = |k: usize| [k as f64, ((37 * k) % 101) as f64];
        (0..101).map(row).collect()
    }

    fn find(rows: &[usize]) -> Option<SharedRange> {
        let all = two_joints();
        let joints: Vec<&[f64]> = all.iter().map(|q| q.as_slice()).collect();
        SharedRange::find(&joints, rows)
    }

    #[test]
    fn rows_of_a_damaged_sector_share_its_range() {
        let all = two_joints();
        let in_sector = |k: &usize| (40.0..48.0).contains(&all[*k][1]);
        let mut sector: Vec<usize> = (0..101).filter(in_sector).collect();
        let found = find(&sector).unwrap();
        assert_eq!((found.joint, found.within), (1, 8));
        assert_eq!(found.limits, (40.0, 47.0));
        // A single row elsewhere does not hide it.
        sector.push((0..101).find(|k| all[*k][1] > 90.0).unwrap());
        let found = find(&sector).unwrap();
        assert_eq!((found.joint, found.limits), (1, (40.0, 47.0)));
    }

    #[test]
    fn rows_anywhere_share_no_range() {
        assert_eq!(find(&[3, 20, 41, 60, 77, 90, 99]), None);
        // Three rows are beside each other too easily.
        assert_eq!(find(&[40, 41, 42]), None);
    }

    #[test]
    fn of_rows_drawn_at_random_one_list_in_a_thousand_shares_a_range() {
        let mut seed = 1_u64;
        let mut drawn = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as usize
        };
        let mut found = 0;
        for _ in 0..4000 {
            let mut list: Vec<usize> = (0..5 + drawn() % 8).map(|_| drawn() % 101).collect();
            list.sort_unstable();
            list.dedup();
            found += usize::from(find(&list).is_some());
        }
        assert!(found <= 8, "{found} of 4000");
    }

    #[test]
    fn rows_of_a_rare_payload_share_it() {
        let payloads: Vec<Option<f64>> = (0..60)
            .map(|k| Some(if k < 55 { 0.0 } else { 3.0 }))
            .collect();
        assert_eq!(shared_payload(&payloads, &[55, 56, 58, 59]), Some(3.0));
        assert_eq!(shared_payload(&payloads, &[55, 56]), Some(3.0));
        // Rows of the usual payload share it by chance, and one row is too few.
        assert_eq!(shared_payload(&payloads, &[1, 7, 20, 33, 41]), None);
        assert_eq!(shared_payload(&payloads, &[55]), None);
        assert_eq!(shared_payload(&payloads, &[1, 55, 56]), None);
        assert_eq!(shared_payload(&[None; 60], &[1, 7, 20]), None);
    }
}
