//! A simulated NOR flash that can lose power at any operation.
//!
//! An operation programs one write unit or erases one erase unit. Erasing sets a unit to ones; a write unit may be written once
//! until it is erased again, otherwise this panics. Power fails before, during or after an operation; from then on the driver
//! refuses everything until [`Nor::restart`]. The content after an interrupted operation is undefined; [`Cut`] has four kinds
//! of it.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// How power fails at an operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// The operation did nothing.
    Before,
    /// About half of the bytes were done, from the first on.
    Prefix,
    /// Some of the changing bits were changed.
    SomeBits,
    /// The unit has random bytes.
    Garbage,
    /// An erase whose unit reads as erased but must be erased again; a write that did nothing.
    AlmostErased,
    /// The operation was completed, but reported no success.
    After,
}

impl Cut {
    pub const ALL: [Self; 6] = [
        Self::Before,
        Self::Prefix,
        Self::SomeBits,
        Self::Garbage,
        Self::AlmostErased,
        Self::After,
    ];
}

/// The flash: write units of `WRITE` bytes, erase units of `ERASE` bytes.
#[derive(Clone, Debug)]
pub struct Nor<const WRITE: usize, const ERASE: usize> {
    bytes: Vec<u8>,
    /// Whether each write unit was written since it was last erased.
    written: Vec<bool>,
    /// Whether the error correction of each write unit does not match its data.
    unreadable: Vec<bool>,
    /// Whether each write unit was part of an interrupted erase and has not been erased since.
    unsound: Vec<bool>,
    /// Whether writing panics where an erase was interrupted, even if the unit looks erased.
    pub needs_whole_erases: bool,
    /// Whether interrupted units cannot be read, as in flash with error correction.
    pub corrects_errors: bool,
    /// Number of operations.
    pub operations: u64,
    /// Number of erase operations.
    pub erased: u64,
    cut: Option<(u64, Cut)>,
    off: bool,
    random: u64,
}

impl<const WRITE: usize, const ERASE: usize> Nor<WRITE, ERASE> {
    /// Returns erased flash of `units` erase units.
    pub fn new(units: usize) -> Self {
        Self {
            bytes: vec![0xff; units * ERASE],
            written: vec![false; units * ERASE / WRITE],
            unreadable: vec![false; units * ERASE / WRITE],
            unsound: vec![false; units * ERASE / WRITE],
            needs_whole_erases: false,
            corrects_errors: false,
            operations: 0,
            erased: 0,
            cut: None,
            off: false,
            random: 1,
        }
    }

    /// Makes power fail `operations` operations from now (0 is the next).
    pub fn cut_at(&mut self, operations: u64, cut: Cut) {
        self.cut = Some((self.operations + operations, cut));
        self.random = operations.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    }

    /// Restores power.
    pub fn restart(&mut self) {
        self.cut = None;
        self.off = false;
    }

    /// Returns whether power has failed.
    pub fn is_off(&self) -> bool {
        self.off
    }

    /// Returns the bytes, for inspection and damage.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    fn random(&mut self) -> u8 {
        // xorshift64*
        self.random ^= self.random >> 12;
        self.random ^= self.random << 25;
        self.random ^= self.random >> 27;
        (self.random.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 56) as u8
    }

    /// Changes the bytes from `at` on to `target`, in one operation that a power cut may interrupt.
    fn operate(&mut self, at: usize, target: &[u8], erases: bool) -> Result<(), NorFlashErrorKind> {
        if self.off {
            return Err(NorFlashErrorKind::Other);
        }
        let cut = self.cut.filter(|(when, _)| *when == self.operations);
        self.operations += 1;
        let before = self.bytes[at..at + target.len()].to_vec();
        let torn = match cut {
            None | Some((_, Cut::After)) => target.to_vec(),
            Some((_, Cut::AlmostErased)) if erases => target.to_vec(),
            Some((_, Cut::Before | Cut::AlmostErased)) => before.clone(),
            Some((_, Cut::Prefix)) => {
                let half = target.len() / 2;
                [&target[..half], &before[half..]].concat()
            }
            Some((_, Cut::SomeBits)) => before
                .iter()
                .zip(target)
                .map(|(from, to)| from ^ ((from ^ to) & self.random()))
                .collect(),
            Some((_, Cut::Garbage)) => target.iter().map(|_| self.random()).collect(),
        };
        let almost = cut.is_some_and(|(_, cut)| cut == Cut::AlmostErased);
        let half_done = torn != target && torn != before;
        self.bytes[at..at + torn.len()].copy_from_slice(&torn);
        for unit in at / WRITE..(at + torn.len()) / WRITE {
            let content = &self.bytes[unit * WRITE..][..WRITE];
            // An interrupted erase leaves some units erased and some not.
            self.written[unit] = content.iter().any(|byte| *byte != 0xff);
            self.unsound[unit] = erases && (half_done || almost);
            self.unreadable[unit] = self.corrects_errors && half_done && self.written[unit];
        }
        if cut.is_some() {
            self.off = true;
            return Err(NorFlashErrorKind::Other);
        }
        Ok(())
    }
}

impl<const WRITE: usize, const ERASE: usize> ErrorType for Nor<WRITE, ERASE> {
    type Error = NorFlashErrorKind;
}

impl<const WRITE: usize, const ERASE: usize> ReadNorFlash for Nor<WRITE, ERASE> {
    // One size has a read unit of more than a byte.
    const READ_SIZE: usize = if WRITE == 4 { 4 } else { 1 };

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        let (at, end) = (offset as usize, offset as usize + bytes.len());
        if self.off || self.unreadable[at / WRITE..end.div_ceil(WRITE)].contains(&true) {
            return Err(NorFlashErrorKind::Other);
        }
        bytes.copy_from_slice(&self.bytes[at..end]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const WRITE: usize, const ERASE: usize> NorFlash for Nor<WRITE, ERASE> {
    const WRITE_SIZE: usize = WRITE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        for at in (from as usize..to as usize).step_by(ERASE) {
            self.erased += 1;
            self.operate(at, &[0xff; ERASE], true)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        for (i, unit) in bytes.chunks(WRITE).enumerate() {
            let at = offset as usize + i * WRITE;
            assert!(
                self.off || !self.written[at / WRITE],
                "the write unit at {at:#x} is written twice"
            );
            assert!(
                self.off || !self.needs_whole_erases || !self.unsound[at / WRITE],
                "the unit at {at:#x} was never wholly erased"
            );
            self.operate(at, unit, false)?;
            if !self.off {
                // Also if all bytes of the unit are ones.
                self.written[at / WRITE] = true;
            }
        }
        Ok(())
    }
}
