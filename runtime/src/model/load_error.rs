//! Reasons why an intact blob is not a model that a robot may be moved by.

use core::fmt;

/// Why a blob was refused. The previous model is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadError {
    /// The chain has no joints, too many, or not one frame more than joints.
    Chain,
    /// A fixed frame is not a rigid transform of at most 100 m.
    Frame {
        /// Index of the frame, counted from the base.
        index: u8,
    },
    /// The coupling matrix is not n×n, or an element is not within ±2.
    Coupling,
    /// A lower joint limit is above the upper one, or a limit is NaN.
    JointLimits,
    /// A training range is missing, reversed or unbounded.
    Ranges,
    /// The correction's number of inputs does not match the joints and the payload.
    Inputs {
        /// Number of inputs of the correction.
        found: u8,
        /// Number of joints, plus one if the payload is known.
        expected: u8,
    },
    /// A scale, rate or coefficient of the kernel is not usable: negative, not finite, or beyond 1e30.
    Kernel,
    /// The limit of the correction is negative, above 1 m or 0.5 rad, or NaN.
    CorrectionLimit,
    /// The bytes of the inducing points are not whole rows.
    PartialRow {
        /// Number of bytes found.
        bytes: u32,
    },
    /// The inducing points do not fit into the model.
    InducingPointsTooLarge {
        /// Number of words in the blob.
        needed: u32,
        /// Number of words that fit.
        capacity: u32,
    },
    /// The number of gravity terms does not match the number of joints.
    Gravity,
    /// A ripple term names a joint that does not exist or too many cycles, or there are too many terms.
    Ripple,
    /// The own-joint curves have more than 64 orders, different numbers of orders, or an amplitude beyond ±1 rad.
    Curve,
    /// The inducing sets do not match the joints, the payload groups or the number of rows.
    Groups,
    /// A weight of an inducing point is not within ±1e30, an input is beyond ±200 lengthscales, or a sine or cosine is
    /// beyond ±1.
    Row,
    /// The variance does not fit the correction, or its rates or landmarks are too many, incomplete or not usable.
    Variance,
}

impl LoadError {
    /// Returns the explicit number of the error on the wire. The numbers are append-only.
    pub const fn code(self) -> u8 {
        match self {
            Self::Chain => 1,
            Self::Frame { .. } => 2,
            Self::Coupling => 3,
            Self::JointLimits => 4,
            Self::Ranges => 5,
            Self::Inputs { .. } => 6,
            Self::Kernel => 7,
            Self::CorrectionLimit => 8,
            Self::PartialRow { .. } => 9,
            Self::InducingPointsTooLarge { .. } => 10,
            Self::Row => 11,
            Self::Gravity => 12,
            Self::Ripple => 13,
            Self::Groups => 14,
            Self::Variance => 15,
            Self::Curve => 16,
        }
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Chain => {
                f.write_str("the chain has no joints, too many, or the wrong number of frames")
            }
            Self::Frame { index } => write!(f, "frame {index} is not a rigid transform"),
            Self::Coupling => f.write_str("the joint coupling is not a usable n×n matrix"),
            Self::JointLimits => f.write_str("joint limits are reversed"),
            Self::Ranges => f.write_str("a training range is missing, reversed or unbounded"),
            Self::Inputs { found, expected } => {
                write!(
                    f,
                    "the correction has {found} inputs, joints and payload make {expected}"
                )
            }
            Self::Kernel => f.write_str("a coefficient of the kernel is not usable"),
            Self::CorrectionLimit => f.write_str("the limit of the correction is not usable"),
            Self::PartialRow { bytes } => {
                write!(f, "{bytes} bytes of inducing points are not whole rows")
            }
            Self::InducingPointsTooLarge { needed, capacity } => {
                write!(
                    f,
                    "the inducing points take {needed} numbers; there is room for {capacity}"
                )
            }
            Self::Gravity => f.write_str("the gravity terms do not fit the number of joints"),
            Self::Ripple => f.write_str("a gear ripple term is not usable"),
            Self::Curve => f.write_str("the own-joint curves are not usable"),
            Self::Groups => f.write_str(
                "the inducing sets do not fit the joints, the payload groups or the rows",
            ),
            Self::Variance => f.write_str("the variance of the position is not usable"),
            Self::Row => f.write_str("a number of an inducing point is not usable"),
        }
    }
}

impl core::error::Error for LoadError {}
