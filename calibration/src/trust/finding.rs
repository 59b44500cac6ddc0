//! What an examination of measurements ends with: causes, how grave each is, and the text for its user.

use poegp_protocol::cause::Cause;
use serde::Serialize;

/// How grave a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tier {
    /// Worth knowing; a model is not in doubt.
    Note,
    /// A model is possible, and somebody must look.
    Warning,
    /// No reading of the file as it is given is this robot.
    Refused,
}

/// One thing that an examination noticed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What it is.
    pub cause: Cause,
    /// How grave it is.
    pub tier: Tier,
    /// One sentence for the user, with the number as read and the number if the cause is right.
    pub text: String,
    /// Lines of the file that it is about, from 1; empty when it is about all of them.
    pub rows: Vec<usize>,
    /// The statistic that decided.
    pub value: f64,
    /// What the statistic was compared with.
    pub threshold: f64,
}

impl Finding {
    /// Whether it is about values that no instrument measured: they judge no model either.
    pub fn is_of_values(&self) -> bool {
        matches!(self.cause, Cause::Stuck | Cause::Placeholder | Cause::Clip)
    }
}

/// What an examination noticed, gravest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Findings(pub Vec<Finding>);

impl Findings {
    /// Turns each accepted cause down by one tier.
    pub fn accept(&mut self, causes: &[Cause]) {
        for finding in self.0.iter_mut().filter(|f| causes.contains(&f.cause)) {
            finding.tier = match finding.tier {
                Tier::Refused => Tier::Warning,
                Tier::Warning | Tier::Note => Tier::Note,
            };
        }
        self.0.sort_by_key(|f| std::cmp::Reverse(f.tier));
    }

    /// The findings of one tier.
    pub fn of(&self, tier: Tier) -> impl Iterator<Item = &Finding> {
        self.0.iter().filter(move |f| f.tier == tier)
    }

    /// Whether no model should be made.
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
        let finding = |cause, tier| Finding {
            cause,
            tier,
            text: String::new(),
            rows: Vec::new(),
            value: 0.0,
            threshold: 0.0,
        };
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
