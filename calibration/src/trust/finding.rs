//! Results of an examination of measurements: causes, their severity, and texts for the user.

use poegp_protocol::cause::Cause;
use serde::Serialize;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tier {
    /// Worth knowing; the model is not in doubt.
    Note,
    /// A model is possible, but the user must check.
    Warning,
    /// No interpretation of the file as given fits this robot.
    Refused,
}

impl Tier {
    /// Returns the tier of a finding that only a grave case refuses.
    pub fn refused_if(is_grave: bool) -> Self {
        match is_grave {
            true => Self::Refused,
            false => Self::Warning,
        }
    }
}

/// One result of an examination.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Cause of the finding.
    pub cause: Cause,
    /// Severity of the finding.
    pub tier: Tier,
    /// One sentence for the user, with the residual as given and the residual if the cause is right.
    pub text: String,
    /// Lines of the file concerned, from 1; empty if all of them are.
    pub rows: Vec<usize>,
    /// The statistic that decided.
    pub value: f64,
    /// Threshold with which the statistic was compared.
    pub threshold: f64,
}

impl Finding {
    /// Creates a finding about the whole file; `value` decided, by comparison with `threshold`.
    pub fn new(cause: Cause, tier: Tier, text: String, value: f64, threshold: f64) -> Self {
        Self {
            cause,
            tier,
            text,
            rows: Vec::new(),
            value,
            threshold,
        }
    }

    /// Limits the finding to some lines of the file.
    #[must_use]
    pub fn of_rows(self, rows: Vec<usize>) -> Self {
        Self { rows, ..self }
    }

    /// Returns whether `other` names the same cause, or says why these are outliers, in at least half of the rows.
    pub fn is_named_by(&self, other: &Self) -> bool {
        let named = self.rows.iter().filter(|row| other.rows.contains(row));
        let named = named.count();
        let is_same = other.cause == self.cause
            || (self.cause == Cause::Outlier && other.cause == Cause::Lag);
        is_same && named > 0 && 2 * named >= self.rows.len()
    }

    /// Returns whether the finding concerns values that no instrument measured: they must not be used to judge a model,
    /// either.
    pub fn is_of_values(&self) -> bool {
        matches!(self.cause, Cause::Stuck | Cause::Placeholder | Cause::Clip)
    }
}

/// The results of an examination, most severe first.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Findings(pub Vec<Finding>);

impl Findings {
    /// Lowers each accepted cause by one tier.
    pub fn accept(&mut self, causes: &[Cause]) {
        for finding in self.0.iter_mut().filter(|f| causes.contains(&f.cause)) {
            finding.tier = match finding.tier {
                Tier::Refused => Tier::Warning,
                Tier::Warning | Tier::Note => Tier::Note,
            };
        }
        self.0.sort_by_key(|f| std::cmp::Reverse(f.tier));
    }

    /// Returns the findings of one tier.
    pub fn of(&self, tier: Tier) -> impl Iterator<Item = &Finding> {
        self.0.iter().filter(move |f| f.tier == tier)
    }

    /// Returns whether no model should be made.
    pub fn is_refused(&self) -> bool {
        self.of(Tier::Refused).next().is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_has_its_name_in_json() {
        for cause in Cause::ALL {
            assert_eq!(
                serde_json::to_string(&cause).unwrap(),
                format!("\"{cause}\"")
            );
        }
    }

    #[test]
    fn a_cause_that_is_accepted_is_one_tier_less_grave() {
        let finding = |cause, tier| Finding::new(cause, tier, String::new(), 0.0, 0.0);
        let mut findings = Findings(vec![
            finding(Cause::Still, Tier::Warning),
            finding(Cause::Step, Tier::Refused),
        ]);
        assert!(findings.is_refused());
        findings.accept(&[Cause::Step]);
        assert!(!findings.is_refused());
        assert_eq!(findings.of(Tier::Warning).count(), 2);
        findings.accept(&[Cause::Still]);
        let tiers: Vec<Tier> = findings.0.iter().map(|f| f.tier).collect();
        assert_eq!(tiers, [Tier::Warning, Tier::Note]);
    }
}
