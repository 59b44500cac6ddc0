//! Counts which rules forbid the drawn configurations, and finds which rules would have to be dropped.

use std::collections::BTreeMap;

/// Counts of forbidden configurations, by the set of all rules that forbid them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Refusals {
    by_rules: BTreeMap<Vec<usize>, usize>,
}

/// Rules that would have to be dropped together, and how many of the drawn configurations that would allow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Release {
    /// Indices of the rules.
    pub rules: Vec<usize>,
    /// Number of configurations that only these rules, or some of them, forbid.
    pub frees: usize,
}

impl Refusals {
    /// Counts a configuration that these rules forbid; their indices are in ascending order.
    pub fn count(&mut self, rules: Vec<usize>) {
        *self.by_rules.entry(rules).or_default() += 1;
    }

    /// Returns how many configurations a rule forbids, whatever other rules do.
    pub fn forbidden_by(&self, rule: usize) -> usize {
        let with = self
            .by_rules
            .iter()
            .filter(|(rules, _)| rules.contains(&rule));
        with.map(|(_, count)| count).sum()
    }

    /// Returns how many configurations would be allowed without these rules.
    pub fn freed_by(&self, without: &[usize]) -> usize {
        let freed = self
            .by_rules
            .iter()
            .filter(|(rules, _)| rules.iter().all(|rule| without.contains(rule)));
        freed.map(|(_, count)| count).sum()
    }

    /// Returns the smallest sets of rules that allow a configuration when they are dropped, those that free most first:
    /// single rules if there are any, else pairs, and so on.
    pub fn releases(&self) -> Vec<Release> {
        let fewest = self.by_rules.keys().map(Vec::len).min().unwrap_or(0);
        let smallest = self.by_rules.keys().filter(|rules| rules.len() == fewest);
        let mut out: Vec<Release> = smallest
            .map(|rules| Release {
                rules: rules.clone(),
                frees: self.freed_by(rules),
            })
            .collect();
        out.sort_by_key(|release| std::cmp::Reverse(release.frees));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three rules: 0 forbids most, but only 1 and 2 alone forbid anything.
    #[test]
    fn what_frees_most_comes_first() {
        let mut refusals = Refusals::default();
        for (rules, times) in [(&[0, 1][..], 50), (&[1], 3), (&[2], 7), (&[0, 1, 2], 40)] {
            (0..times).for_each(|_| refusals.count(rules.to_vec()));
        }
        assert_eq!([0, 1, 2].map(|i| refusals.forbidden_by(i)), [90, 93, 47]);
        let frees: Vec<(Vec<usize>, usize)> = refusals
            .releases()
            .into_iter()
            .map(|r| (r.rules, r.frees))
            .collect();
        assert_eq!(frees, [(vec![2], 7), (vec![1], 3)]);
        assert_eq!(refusals.freed_by(&[0, 1]), 53);
    }

    /// Where no single rule frees anything, the pairs do, with what each of them frees alone: nothing.
    #[test]
    fn pairs_are_named_where_no_rule_alone_frees_anything() {
        let mut refusals = Refusals::default();
        for (rules, times) in [(&[0, 1][..], 5), (&[1, 2], 9), (&[0, 1, 2], 70)] {
            (0..times).for_each(|_| refusals.count(rules.to_vec()));
        }
        let releases = refusals.releases();
        assert_eq!(
            (releases[0].rules.as_slice(), releases[0].frees),
            (&[1, 2][..], 9)
        );
        assert_eq!(
            (releases[1].rules.as_slice(), releases[1].frees),
            (&[0, 1][..], 5)
        );
        assert!(Refusals::default().releases().is_empty());
    }
}
