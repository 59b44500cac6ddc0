//! The two slots for a model, and what a slot holds.

/// One of the two slots for a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The first slot.
    A,
    /// The second slot.
    B,
}

impl Slot {
    /// Returns the index of the slot, 0 or 1.
    pub const fn index(self) -> u8 {
        match self {
            Self::A => 0,
            Self::B => 1,
        }
    }

    /// Returns the other slot.
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// A blob in flash as its header announces it. [`Store::read`](super::Store::read) checks that it is really there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Slot that holds the blob.
    pub slot: Slot,
    /// Length of the blob in bytes.
    pub length: u32,
    /// CRC-32C of all bytes of the blob.
    pub crc: u32,
}
