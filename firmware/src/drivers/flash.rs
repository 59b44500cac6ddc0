//! Driver for the flash of the STM32F4 (RM0090, chapter 3): its sectors of 128 kB behind the trait of embedded-storage.
//!
//! ```text
//!  unlock, wait, clear errors ─> erase a sector, or program units ─> wait, errors? ─> lock ─> flush the data cache
//! ```
//!
//! The controller changes 32 bits at a time if the supply is above 2.7 V, else 8 (RM0090, 3.6.2), and nothing reports the
//! supply voltage. The option bytes can guarantee it: at brown-out level 3 the processor is held in reset below 2.7 V. So
//! the driver uses 32 bits at that level and 8 at all others; an erase then takes up to 4 s instead of 2 (DS8626, table
//! 40).
//!
//! While the controller is busy, the processor stalls, because it fetches its instructions from the same flash.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// A register of the flash controller; the value is its offset in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashRegister {
    /// `ACR`, access control: the caches.
    Access = 0x00,
    /// `KEYR`, key register: unlocks the controller.
    Key = 0x04,
    /// `SR`, status register.
    Status = 0x0c,
    /// `CR`, control register.
    Control = 0x10,
    /// `OPTCR`, option control: the option bytes as loaded at the start.
    Options = 0x14,
}

/// The flash controller and its memory. All offsets are from the start of the flash.
pub trait FlashRegisters {
    /// Reads a register.
    fn get(&mut self, register: FlashRegister) -> u32;
    /// Writes a register.
    fn set(&mut self, register: FlashRegister, value: u32);
    /// Reads the word at `offset`, a multiple of 4; `None` beyond what the driver may touch.
    fn load(&mut self, offset: u32) -> Option<u32>;
    /// Writes 32 bits at `offset`, a multiple of 4, in one access.
    fn store_word(&mut self, offset: u32, value: u32);
    /// Writes 8 bits at `offset` in one access.
    fn store_byte(&mut self, offset: u32, value: u8);
}

const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

const DATA_CACHE: u32 = 1 << 10;
const DATA_CACHE_RESET: u32 = 1 << 12;

const PROGRAM: u32 = 1;
const SECTOR_ERASE: u32 = 1 << 1;
const SECTOR_NUMBER: u32 = 3;
const BY_WORD: u32 = 0b10 << 8;
const START: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;

/// Error bits of `SR`: sequence, parallelism, alignment, write protection, operation. Writing ones clears them.
const ERRORS: u32 = 0b1111_0010;
const BUSY: u32 = 1 << 16;

/// Bits of the brown-out level in `OPTCR`: 0 is level 3, 3 is off. (The manufacturer's SVD file states the reverse.)
const BROWN_OUT: u32 = 0b11 << 2;

/// Size of a sector in bytes.
pub const SECTOR: u32 = 128 * 1_024;
/// Number of the first sector that belongs to the driver. The image occupies the sectors before it.
const FIRST_SECTOR: u32 = 6;
/// Offset of the driver's first byte from the start of the flash.
pub const START_OFFSET: u32 = 2 * SECTOR;
/// Number of bytes that belong to the driver: sectors 6 to 11.
pub const BYTES: u32 = 6 * SECTOR;

/// The reason why a flash operation failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashFault {
    /// The range goes beyond the end.
    OutOfBounds,
    /// The range does not consist of whole words or sectors.
    NotAligned,
    /// The controller stays locked: it has seen a wrong key and accepts none before the next reset.
    Locked,
    /// The controller stays busy.
    Busy,
    /// The controller has reported errors: the error bits of `SR`.
    Refused(u32),
}

impl NorFlashError for FlashFault {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::Locked | Self::Busy | Self::Refused(_) => NorFlashErrorKind::Other,
        }
    }
}

/// The flash of the driver, sectors 6 to 11.
pub struct SectorFlash<R> {
    registers: R,
    /// Maximum number of polls of the busy flag for one operation.
    looks: u32,
}

impl<R: FlashRegisters> SectorFlash<R> {
    /// Creates the driver. An operation fails if the controller is still busy after `looks` polls of the busy flag.
    pub fn new(registers: R, looks: u32) -> Self {
        Self { registers, looks }
    }

    /// Whether the option bytes guarantee a supply above 2.7 V (brown-out level 3).
    pub fn supply_is_sure(&mut self) -> bool {
        self.registers.get(FlashRegister::Options) & BROWN_OUT == 0
    }

    fn wait(&mut self) -> Result<(), FlashFault> {
        for _ in 0..self.looks {
            if self.registers.get(FlashRegister::Status) & BUSY == 0 {
                return Ok(());
            }
        }
        Err(FlashFault::Busy)
    }

    fn unlock(&mut self) -> Result<(), FlashFault> {
        self.wait()?;
        if self.registers.get(FlashRegister::Control) & LOCK != 0 {
            for key in KEYS {
                self.registers.set(FlashRegister::Key, key);
            }
        }
        if self.registers.get(FlashRegister::Control) & LOCK != 0 {
            return Err(FlashFault::Locked);
        }
        // An old error would be mistaken for one of this operation, and may keep the controller from carrying it out.
        self.registers.set(FlashRegister::Status, ERRORS);
        Ok(())
    }

    /// Waits for the end of an operation and checks its errors.
    fn finish(&mut self) -> Result<(), FlashFault> {
        self.wait()?;
        match self.registers.get(FlashRegister::Status) & ERRORS {
            0 => Ok(()),
            errors => Err(FlashFault::Refused(errors)),
        }
    }

    /// Locks the controller, whatever happened, and resets the data cache, which does not notice an erase.
    fn lock(&mut self) {
        self.registers.set(FlashRegister::Control, LOCK);
        let access = self.registers.get(FlashRegister::Access) & !DATA_CACHE_RESET;
        let off = access & !DATA_CACHE;
        // The data cache can only be reset while it is off.
        for value in [off, off | DATA_CACHE_RESET, off, access] {
            self.registers.set(FlashRegister::Access, value);
        }
    }

    fn width(&mut self) -> u32 {
        if self.supply_is_sure() { BY_WORD } else { 0 }
    }

    fn erase_sector(&mut self, number: u32) -> Result<(), FlashFault> {
        self.unlock()?;
        let control = SECTOR_ERASE | (number << SECTOR_NUMBER) | self.width();
        self.registers.set(FlashRegister::Control, control);
        self.registers.set(FlashRegister::Control, control | START);
        let finished = self.finish();
        self.lock();
        finished
    }

    fn program(&mut self, offset: u32, words: &[[u8; 4]]) -> Result<(), FlashFault> {
        self.unlock()?;
        let width = self.width();
        self.registers.set(FlashRegister::Control, PROGRAM | width);
        let mut at = offset;
        let mut finished = Ok(());
        for word in words {
            finished = self.program_word(at, *word, width == BY_WORD);
            if finished.is_err() {
                break;
            }
            at += 4;
        }
        self.lock();
        finished
    }

    fn program_word(&mut self, at: u32, word: [u8; 4], whole: bool) -> Result<(), FlashFault> {
        if whole {
            self.registers.store_word(at, u32::from_le_bytes(word));
            return self.finish();
        }
        for (index, byte) in (0..).zip(word) {
            self.registers.store_byte(at + index, byte);
            self.finish()?;
        }
        Ok(())
    }
}

/// Checks that `length` bytes from `offset` on are whole units of `unit` bytes inside the driver's flash.
fn check(offset: u32, length: usize, unit: u32) -> Result<(), FlashFault> {
    let length = u32::try_from(length).map_err(|_| FlashFault::OutOfBounds)?;
    if !offset.is_multiple_of(unit) || !length.is_multiple_of(unit) {
        return Err(FlashFault::NotAligned);
    }
    if offset > BYTES || length > BYTES - offset {
        return Err(FlashFault::OutOfBounds);
    }
    Ok(())
}

impl<R: FlashRegisters> ErrorType for SectorFlash<R> {
    type Error = FlashFault;
}

impl<R: FlashRegisters> ReadNorFlash for SectorFlash<R> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashFault> {
        check(offset, bytes.len(), 4)?;
        let mut at = START_OFFSET + offset;
        for chunk in bytes.as_chunks_mut().0 {
            let value = self.registers.load(at).ok_or(FlashFault::OutOfBounds)?;
            *chunk = value.to_le_bytes();
            at += 4;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES as usize
    }
}

impl<R: FlashRegisters> NorFlash for SectorFlash<R> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashFault> {
        let length = to.checked_sub(from).ok_or(FlashFault::OutOfBounds)?;
        check(from, length as usize, SECTOR)?;
        for sector in from / SECTOR..to / SECTOR {
            self.erase_sector(FIRST_SECTOR + sector)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashFault> {
        check(offset, bytes.len(), 4)?;
        self.program(START_OFFSET + offset, bytes.as_chunks().0)
    }
}
