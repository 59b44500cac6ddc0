//! What an examination of measurements ends with: causes, how grave each is, and the text for its user.

use serde::{Deserialize, Serialize};

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

/// The cause of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// Fewer equations than the unknowns need.
    Few,
    /// A joint does not move.
    Still,
    /// Rows repeat earlier rows.
    Copies,
    /// The same pose stands at other joints.
    Stuck,
    /// A value that stands for a missing one.
    Placeholder,
    /// Several rows share the extreme value of a column.
    Clip,
    /// Another unit than the column's name says.
    Unit,
    /// A joint counts the other way.
    Sign,
    /// Columns are exchanged.
    Swap,
    /// The zero of a joint is elsewhere.
    Offset,
    /// A joint moves with another.
    Coupling,
    /// The quaternion is in another order, or describes another rotation.
    Quaternion,
    /// The pose is that of the instrument as the target sees it.
    Inverse,
    /// One axis of the instrument is reversed.
    Mirror,
    /// The axes of the instrument are exchanged.
    Axes,
    /// Another robot.
    Robot,
    /// Poses belong to other rows of joints.
    Rows,
    /// Two populations of rows.
    Mixed,
    /// The robot moved when it was measured.
    Lag,
    /// The orientations are not those of the robot.
    Orientation,
    /// Nothing that was tried explains the poses.
    NoFit,
    /// The controller computed the poses.
    Readout,
    /// The set-up changed at one row.
    Step,
    /// The set-up moves through the file.
    Drift,
    /// Rows that do not belong.
    Outlier,
    /// The payloads do not explain how the arm sags.
    Payload,
    /// The stated uncertainty is not the scatter.
    Noise,
    /// Too few digits.
    Rounding,
    /// A link is not as drawn.
    Frames,
    /// The order of the rows is not that of time.
    Time,
    /// A richer model is worse than a simpler one on held-out rows.
    Model,
    /// The calibration is not expected to be better than the nominal arm.
    Gain,
}

/// Every cause with the name that `--accept` takes, in the order of [`Cause`].
#[rustfmt::skip]
const NAMES: [(Cause, &str); 32] = [
    (Cause::Few, "few"), (Cause::Still, "still"), (Cause::Copies, "copies"), (Cause::Stuck, "stuck"),
    (Cause::Placeholder, "placeholder"), (Cause::Clip, "clip"), (Cause::Unit, "unit"), (Cause::Sign, "sign"),
    (Cause::Swap, "swap"), (Cause::Offset, "offset"), (Cause::Coupling, "coupling"), (Cause::Quaternion, "quaternion"),
    (Cause::Inverse, "inverse"), (Cause::Mirror, "mirror"), (Cause::Axes, "axes"), (Cause::Robot, "robot"),
    (Cause::Rows, "rows"), (Cause::Mixed, "mixed"), (Cause::Lag, "lag"), (Cause::Orientation, "orientation"),
    (Cause::NoFit, "no-fit"), (Cause::Readout, "readout"), (Cause::Step, "step"), (Cause::Drift, "drift"),
    (Cause::Outlier, "outlier"), (Cause::Payload, "payload"), (Cause::Noise, "noise"), (Cause::Rounding, "rounding"),
    (Cause::Frames, "frames"), (Cause::Time, "time"), (Cause::Model, "model"), (Cause::Gain, "gain"),
];

impl Cause {
    /// All of them.
    pub const ALL: [Self; NAMES.len()] = {
        let mut all = [Self::Few; NAMES.len()];
        let mut i = 0;
        while i < all.len() {
            all[i] = NAMES[i].0;
            i += 1;
        }
        all
    };

    /// Whether the file reads well in another way: units, signs, order, zeros, conventions, another robot.
    pub fn is_a_reading(self) -> bool {
        (Self::Unit..=Self::Rows).contains(&self) || self == Self::Lag
    }

    /// The name on the command line, in JSON and in a blob.
    pub fn name(self) -> &'static str {
        NAMES[self as usize].1
    }
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that no cause has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown cause `{name}`, expected one of {}", Cause::ALL.iter().map(|c| c.name()).collect::<Vec<_>>().join(", "))]
pub struct UnknownCause {
    /// The name.
    pub name: String,
}

impl std::str::FromStr for Cause {
    type Err = UnknownCause;

    fn from_str(name: &str) -> Result<Self, UnknownCause> {
        let cause = Self::ALL.into_iter().find(|c| c.name() == name);
        cause.ok_or_else(|| UnknownCause {
            name: name.to_owned(),
        })
    }
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
    fn every_cause_has_its_name() {
        for (i, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause as usize, i);
            assert_eq!(cause.name().parse(), Ok(cause));
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
