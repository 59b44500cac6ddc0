//! The two slots for a model, and what a slot holds.

/// One of the two places for a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The first.
    A,
    /// The second.
    B,
}

impl Slot {
    /// 0 or 1.
    pub const fn index(self) -> u8 {
        match self {
            Self::A => 0,
            Self::B => 1,
        }
    }

    /// The other one.
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// A blob in flash, as its header announces it. [`Store::read`](super::Store::read) says whether it is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Where it is.
    pub slot: Slot,
    /// Its length in bytes.
    pub length: u32,
    /// CRC-32C of all its bytes.
    pub crc: u32,
}
