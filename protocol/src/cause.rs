//! What can be wrong with measurements, by name: the trainer says it, a blob and the identity of a device keep it.

use serde::{Deserialize, Serialize};

/// Why measurements are refused or warned about.
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

impl core::fmt::Display for Cause {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that no cause has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownCause;

impl core::fmt::Display for UnknownCause {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("unknown cause, expected one of ")?;
        for (i, cause) in Cause::ALL.into_iter().enumerate() {
            f.write_str(if i == 0 { "" } else { ", " })?;
            f.write_str(cause.name())?;
        }
        Ok(())
    }
}

impl core::error::Error for UnknownCause {}

impl core::str::FromStr for Cause {
    type Err = UnknownCause;

    fn from_str(name: &str) -> Result<Self, UnknownCause> {
        let mut all = Self::ALL.into_iter();
        all.find(|c| c.name() == name).ok_or(UnknownCause)
    }
}

/// A set of causes: bit i is that of cause i of [`Cause::ALL`]. As bytes it has always four, the lowest bits first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "[u8; 4]", into = "[u8; 4]")]
pub struct Causes(u32);

impl From<[u8; 4]> for Causes {
    fn from(bytes: [u8; 4]) -> Self {
        Self(u32::from_le_bytes(bytes))
    }
}

impl From<Causes> for [u8; 4] {
    fn from(causes: Causes) -> Self {
        causes.0.to_le_bytes()
    }
}

impl Causes {
    /// No cause.
    pub const NONE: Self = Self(0);

    /// Adds a cause.
    pub fn insert(&mut self, cause: Cause) {
        self.0 |= Self::bit(cause);
    }

    /// Whether a cause is in it.
    pub fn contains(self, cause: Cause) -> bool {
        self.0 & Self::bit(cause) != 0
    }

    /// Its causes in the order of [`Cause::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Cause> {
        Cause::ALL.into_iter().filter(move |c| self.contains(*c))
    }

    fn bit(cause: Cause) -> u32 {
        1 << cause as u32
    }
}

impl FromIterator<Cause> for Causes {
    fn from_iter<I: IntoIterator<Item = Cause>>(causes: I) -> Self {
        let mut out = Self::NONE;
        causes.into_iter().for_each(|cause| out.insert(cause));
        out
    }
}
