//! Named causes of bad measurements: the trainer reports them; a blob and the identity of a device store them.

use serde::{Deserialize, Serialize};

/// Why measurements are refused or warned about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The measurements give fewer equations than the unknowns need.
    Few,
    /// A joint does not move.
    Still,
    /// Some rows repeat earlier rows.
    Copies,
    /// The same pose is recorded for different joint values.
    Stuck,
    /// A placeholder such as 9999 stands for a missing value.
    Placeholder,
    /// Several rows share the extreme value of a column.
    Clip,
    /// A column is in a different unit than its name says.
    Unit,
    /// The sign of a joint is reversed.
    Sign,
    /// Columns are swapped.
    Swap,
    /// The zero of a joint differs from the robot's description.
    Offset,
    /// A joint is coupled to another one.
    Coupling,
    /// The quaternion has a different component order, or describes another rotation.
    Quaternion,
    /// The poses are inverted: they are those of the instrument seen from the target.
    Inverse,
    /// One axis of the instrument is reversed.
    Mirror,
    /// The axes of the instrument are swapped.
    Axes,
    /// The measurements are of another robot.
    Robot,
    /// The poses belong to other rows of joint values.
    Rows,
    /// The rows belong to two populations: some fit one base and tool, the others do not.
    Mixed,
    /// The robot moved while it was measured.
    Lag,
    /// The orientations do not fit the robot.
    Orientation,
    /// No tested explanation fits the poses.
    NoFit,
    /// The poses were computed by the controller, not measured.
    Readout,
    /// The set-up changed abruptly at one row.
    Step,
    /// The set-up moved slowly during the measurement.
    Drift,
    /// Some rows contradict all others.
    Outlier,
    /// The stated payloads do not explain how the arm sags.
    Payload,
    /// The stated uncertainty does not match the observed scatter.
    Noise,
    /// The values have too few digits.
    Rounding,
    /// A link differs from the nominal model.
    Frames,
    /// The rows are not in chronological order.
    Time,
    /// A richer model is worse than a simpler one on held-out rows.
    Model,
    /// The calibration is not expected to be better than the nominal arm.
    Gain,
}

/// Each cause with its name for `--accept`, in the order of [`Cause`].
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
    /// All causes in the order of their declaration.
    pub const ALL: [Self; NAMES.len()] = {
        let mut all = [Self::Few; NAMES.len()];
        let mut i = 0;
        while i < all.len() {
            all[i] = NAMES[i].0;
            i += 1;
        }
        all
    };

    /// Whether this cause means that the file makes sense when it is read differently: with other units, signs, order,
    /// zeros or conventions, or for another robot.
    pub fn is_a_reading(self) -> bool {
        (Self::Unit..=Self::Rows).contains(&self) || self == Self::Lag
    }

    /// Returns the name of the cause on the command line, in JSON and in a blob.
    pub fn name(self) -> &'static str {
        NAMES[self as usize].1
    }
}

impl core::fmt::Display for Cause {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

/// The error for a name that no cause has.
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

/// Set of causes: bit i stands for cause i of [`Cause::ALL`]. Its encoding always has four bytes, lowest bits first.
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
    /// The empty set.
    pub const NONE: Self = Self(0);

    /// Adds a cause to the set.
    pub fn insert(&mut self, cause: Cause) {
        self.0 |= Self::bit(cause);
    }

    /// Whether the set contains a cause.
    pub fn contains(self, cause: Cause) -> bool {
        self.0 & Self::bit(cause) != 0
    }

    /// Returns an iterator over the causes in the set, in the order of [`Cause::ALL`].
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
