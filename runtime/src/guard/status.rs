//! Status of an evaluation: how far it can be trusted.

use core::fmt;

/// A set of remarks on one evaluation. An empty set means that the answer is fully trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status(u8);

/// Remark bits and their names, as they appear in files and on the wire. Append-only.
const NAMES: [(Status, &str); 8] = [
    (Status::OUTSIDE_JOINT_RANGE, "outside-joint-range"),
    (Status::OUTSIDE_PAYLOAD_RANGE, "outside-payload-range"),
    (Status::CORRECTION_LIMITED, "correction-limited"),
    (Status::NO_MODEL, "no-model"),
    (Status::BAD_INPUT, "bad-input"),
    (Status::PARTLY_CORRECTED, "partly-corrected"),
    (Status::BYPASSED, "bypassed"),
    (Status::BLENDING, "blending"),
];

impl Status {
    /// No remark: everything is as trained.
    pub const OK: Self = Self(0);
    /// Some joint is outside the trained range, so the correction is an extrapolation.
    pub const OUTSIDE_JOINT_RANGE: Self = Self(1);
    /// The payload is outside the trained range.
    pub const OUTSIDE_PAYLOAD_RANGE: Self = Self(2);
    /// The correction exceeded the limit in the blob and was scaled back to it.
    pub const CORRECTION_LIMITED: Self = Self(4);
    /// There is no model, and the pose is the identity.
    pub const NO_MODEL: Self = Self(8);
    /// The number of joints is wrong, or a number is not finite or far out of range: nothing was corrected.
    pub const BAD_INPUT: Self = Self(16);
    /// By an estimate from the model, more than 5 µm or 5 µrad of the arm's error remain: near a singularity, or because a
    /// bound acts.
    pub const PARTLY_CORRECTED: Self = Self(32);
    /// The correction is switched off, and the answer is the unchanged command.
    pub const BYPASSED: Self = Self(64);
    /// The joints are still on their way to those that were asked for: the filter keeps the correction from stepping.
    pub const BLENDING: Self = Self(128);

    /// Creates a status from the bits of [`Status::bits`].
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits)
    }

    /// Returns the bits, as sent over the link.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Returns the union of both sets.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns `self`, with `other` added when `condition` holds.
    #[must_use]
    pub const fn with_if(self, condition: bool, other: Self) -> Self {
        if condition { self.with(other) } else { self }
    }

    /// Returns `self` without the remarks of `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Returns whether all remarks of `other` are in `self`.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Returns whether there is no remark.
    pub const fn is_ok(self) -> bool {
        self.0 == 0
    }
}

/// Writes `ok`, or the names of the remarks joined by `+`.
impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_ok() {
            return f.write_str("ok");
        }
        let mut separator = "";
        for (status, name) in NAMES {
            if self.contains(status) {
                f.write_str(separator)?;
                f.write_str(name)?;
                separator = "+";
            }
        }
        Ok(())
    }
}
