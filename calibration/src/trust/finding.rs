//! What an examination of measurements ends with: causes, how grave each is, and the text for its user.

use serde::{Deserialize, Serialize};

/// How grave a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tier {
    /// Worth knowing; a model is not in doubt.
    Note,
    /// A model is possible, and somebody must look.
    Warning,
    /// No reading of the file as it is given is this robot.
    Refused,
}

/// What is wrong, or may be.
macro_rules! causes {
    ($($(#[$doc:meta])* $variant:ident = $name:literal,)*) => {
        /// The cause of a finding, by the name that `--accept` takes.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub enum Cause {
            $($(#[$doc])* #[serde(rename = $name)] $variant,)*
        }

        impl Cause {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// The name on the command line, in JSON and in a blob.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }
        }
    };
}

causes! {
    /// Fewer equations than the unknowns need.
    Few = "few",
    /// A joint does not move.
    Still = "still",
    /// Rows repeat earlier rows.
    Copies = "copies",
    /// The same pose stands at other joints.
    Stuck = "stuck",
    /// A value that stands for a missing one.
    Placeholder = "placeholder",
    /// Several rows share the extreme value of a column.
    Clip = "clip",
    /// Another unit than the column's name says.
    Unit = "unit",
    /// A joint counts the other way.
    Sign = "sign",
    /// Columns are exchanged.
    Swap = "swap",
    /// The zero of a joint is elsewhere.
    Offset = "offset",
    /// A joint moves with another.
    Coupling = "coupling",
    /// The quaternion is in another order, or describes another rotation.
    Quaternion = "quaternion",
    /// The pose is that of the instrument as the target sees it.
    Inverse = "inverse",
    /// One axis of the instrument is reversed.
    Mirror = "mirror",
    /// The axes of the instrument are exchanged.
    Axes = "axes",
    /// Another robot.
    Robot = "robot",
    /// Poses belong to other rows of joints.
    Rows = "rows",
    /// Two populations of rows.
    Mixed = "mixed",
    /// The robot moved when it was measured.
    Lag = "lag",
    /// The orientations are not those of the robot.
    Orientation = "orientation",
    /// Nothing that was tried explains the poses.
    NoFit = "no-fit",
    /// The controller computed the poses.
    Readout = "readout",
    /// The set-up changed at one row.
    Step = "step",
    /// The set-up moves through the file.
    Drift = "drift",
    /// Rows that do not belong.
    Outlier = "outlier",
    /// The payloads do not explain how the arm sags.
    Payload = "payload",
    /// The stated uncertainty is not the scatter.
    Noise = "noise",
    /// Too few digits.
    Rounding = "rounding",
    /// A link is not as drawn.
    Frames = "frames",
    /// The order of the rows is not that of time.
    Time = "time",
    /// A richer model is worse than a simpler one on held-out rows.
    Model = "model",
    /// The calibration is not expected to be better than the nominal arm.
    Gain = "gain",
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
        let cause = Self::ALL.iter().find(|c| c.name() == name);
        cause.copied().ok_or_else(|| UnknownCause {
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
