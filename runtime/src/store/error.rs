//! Errors of the store.

use core::fmt;

use embedded_storage::nor_flash::NorFlashErrorKind;

use crate::store::slot::Slot;

/// Reason why the store refused. What it held before is still there, unless [`super`] says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// The flash or the layout cannot be used: an address or size that is not a multiple of `unit` bytes.
    NotAligned {
        /// Address or size that is not aligned.
        at: u32,
        /// Required unit in bytes.
        unit: u32,
    },
    /// The layout goes beyond the flash.
    OutOfBounds {
        /// Address at which the layout ends.
        end: u32,
        /// Size of the flash in bytes.
        capacity: u32,
    },
    /// Two ranges of the layout overlap.
    Overlap {
        /// Address at which the overlap begins.
        at: u32,
    },
    /// A range of the layout is too small.
    RangeTooSmall {
        /// Length of the range in bytes.
        length: u32,
        /// Required length in bytes.
        needed: u32,
    },
    /// The flash reads or writes in units that this store is not made for.
    Unit {
        /// Size of the unit in bytes.
        size: u32,
    },
    /// The blob is longer than a slot, or empty.
    BlobLength {
        /// Length of the blob in bytes.
        length: u32,
        /// Largest length in bytes that a slot can hold.
        capacity: u32,
    },
    /// The buffer is shorter than the blob.
    BufferTooSmall {
        /// Length of the blob in bytes.
        length: u32,
        /// Length of the buffer in bytes.
        room: u32,
    },
    /// The slot no longer holds that blob.
    NotStored {
        /// Slot that was to hold the blob.
        slot: Slot,
    },
    /// The bytes in the slot are not the blob that its header announces.
    CrcMismatch {
        /// CRC-32C in the header.
        stored: u32,
        /// CRC-32C of the bytes.
        computed: u32,
    },
    /// The flash does not read back what was written.
    ReadBack {
        /// Address of the write that failed.
        at: u32,
    },
    /// The driver of the flash refused.
    Flash {
        /// Kind of error that the driver reports.
        kind: NorFlashErrorKind,
    },
    /// Sequence numbers have run out, which cannot happen within the life of a flash.
    SequenceExhausted,
    /// Another key is provisioned and cannot be replaced.
    KeyProvisioned,
    /// Power failed while the first key was provisioned: no key is in force, and nothing may be accepted until provisioning
    /// is repeated.
    KeyUnfinished,
    /// A key was provisioned and its page is damaged: nothing may be accepted.
    KeyDamaged,
    /// Power failed so often while the first key was provisioned that there is no room for another attempt.
    KeyPageFull,
    /// The settings of the cycle were changed so often that there is no room for another record.
    SettingsFull,
}

impl StoreError {
    /// Returns the number of the error on the wire. Numbers are explicit and append-only.
    pub const fn code(self) -> u8 {
        match self {
            Self::NotAligned { .. } => 1,
            Self::OutOfBounds { .. } => 2,
            Self::Overlap { .. } => 3,
            Self::RangeTooSmall { .. } => 4,
            Self::Unit { .. } => 5,
            Self::BlobLength { .. } => 6,
            Self::BufferTooSmall { .. } => 7,
            Self::NotStored { .. } => 8,
            Self::CrcMismatch { .. } => 9,
            Self::ReadBack { .. } => 10,
            Self::Flash { .. } => 11,
            Self::SequenceExhausted => 12,
            Self::KeyProvisioned => 13,
            Self::KeyUnfinished => 14,
            Self::KeyDamaged => 15,
            Self::KeyPageFull => 16,
            Self::SettingsFull => 17,
        }
    }
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAligned { at, unit } => {
                write!(f, "{at:#x} in the flash is not a multiple of {unit} bytes")
            }
            Self::OutOfBounds { end, capacity } => {
                write!(
                    f,
                    "the store ends at {end:#x}, the flash has {capacity:#x} bytes"
                )
            }
            Self::Overlap { at } => write!(f, "two parts of the store overlap at {at:#x}"),
            Self::RangeTooSmall { length, needed } => {
                write!(
                    f,
                    "a part of the store has {length} bytes and needs {needed}"
                )
            }
            Self::Unit { size } => {
                write!(f, "the store is not made for units of {size} bytes")
            }
            Self::BlobLength { length, capacity } => {
                write!(
                    f,
                    "the blob has {length} bytes, a slot holds 1 to {capacity}"
                )
            }
            Self::BufferTooSmall { length, room } => {
                write!(
                    f,
                    "the blob has {length} bytes, there is room for {room} in memory"
                )
            }
            Self::NotStored { slot } => {
                write!(f, "slot {} no longer holds that blob", slot.index())
            }
            Self::CrcMismatch { stored, computed } => {
                write!(
                    f,
                    "the stored blob is damaged: CRC {computed:08x}, its header says {stored:08x}"
                )
            }
            Self::ReadBack { at } => {
                write!(
                    f,
                    "the flash does not hold at {at:#x} what was written there"
                )
            }
            Self::Flash { kind } => write!(f, "the flash refused: {kind}"),
            Self::SequenceExhausted => f.write_str("sequence numbers of the store have run out"),
            Self::KeyProvisioned => f.write_str("another public key is provisioned"),
            Self::KeyUnfinished => {
                f.write_str("provisioning the public key was interrupted; repeat it")
            }
            Self::KeyDamaged => f.write_str("the page of the public key is damaged"),
            Self::KeyPageFull => f.write_str("the page of the public key has no room left"),
            Self::SettingsFull => f.write_str("the page of the cycle's settings has no room left"),
        }
    }
}

impl core::error::Error for StoreError {}
