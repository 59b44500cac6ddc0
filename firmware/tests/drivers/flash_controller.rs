//! A model of the STM32F4's flash controller, from RM0090, chapter 3. Where the manual leaves something open, or forbids it
//! without saying what comes of it, the model does the worst or panics.

use std::cell::RefCell;
use std::rc::Rc;

use crate::drivers::flash::{FlashRegister, FlashRegisters, START_OFFSET};
use crate::random;

const KIB: usize = 1_024;
/// Twelve sectors: four of 16 kB, one of 64, seven of 128.
const SECTORS: [usize; 12] = [16, 16, 16, 16, 64, 128, 128, 128, 128, 128, 128, 128];
const LINE: usize = 16;

const OPERATION_ERROR: u32 = 1 << 1;
pub const WRITE_PROTECTED: u32 = 1 << 4;
pub const WRONG_WIDTH: u32 = 1 << 6;
pub const WRONG_SEQUENCE: u32 = 1 << 7;
const ERRORS: u32 = OPERATION_ERROR | WRITE_PROTECTED | (1 << 5) | WRONG_WIDTH | WRONG_SEQUENCE;
const BUSY: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;

/// What an interrupted operation leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    Before,
    Half,
    SomeBits,
    After,
}

impl Cut {
    pub const ALL: [Self; 4] = [Self::Before, Self::Half, Self::SomeBits, Self::After];
}

#[derive(Clone)]
pub struct Controller {
    pub cells: Vec<u8>,
    pub cached: Vec<u8>,
    pub is_cached: Vec<bool>,
    pub access: u32,
    pub status: u32,
    pub control: u32,
    pub options: u32,
    pub keys_seen: u32,
    /// Until a reset.
    pub locked_up: bool,
    pub busy_for: u32,
    /// Looks at the busy flag that an operation takes.
    pub looks: u32,
    /// The supply allows 32 bits at a time.
    pub above_2_7_v: bool,
    /// Never ready again after the next operation.
    pub stays_busy: bool,
    pub operations: u64,
    /// Longest that all operations may take (data sheet DS8626, flash memory programming), in µs.
    pub micros: u64,
    pub cut: Option<(u64, Cut)>,
    pub off: bool,
    pub random: u64,
}

impl Controller {
    /// Erased, after a reset, with these option bytes.
    pub fn new(options: u32) -> Self {
        let bytes = KIB * SECTORS.iter().sum::<usize>();
        Self {
            cells: vec![0xff; bytes],
            cached: vec![0; bytes],
            is_cached: vec![false; bytes / LINE],
            // What the HAL sets: five wait states, prefetch, both caches.
            access: 0x705,
            status: 0,
            control: LOCK,
            options,
            keys_seen: 0,
            locked_up: false,
            busy_for: 0,
            looks: 3,
            above_2_7_v: true,
            stays_busy: false,
            operations: 0,
            micros: 0,
            cut: None,
            off: false,
            random: 1,
        }
    }

    /// Power is back: a reset, with empty caches.
    pub fn restarted(&self) -> Self {
        Self {
            cells: self.cells.clone(),
            above_2_7_v: self.above_2_7_v,
            ..Self::new(self.options)
        }
    }

    fn data_cache_is_on(&self) -> bool {
        self.access & (1 << 10) != 0
    }

    /// Whether an operation may begin; if not, an error is set.
    fn begins(&mut self, error: u32) -> bool {
        if self.off {
            // The driver of a device without power runs no more; here it runs into an error.
            self.status |= OPERATION_ERROR;
            return false;
        }
        assert_eq!(self.busy_for, 0, "the controller is busy");
        assert_eq!(self.status & ERRORS, 0, "old errors were not cleared");
        if error != 0 {
            self.status |= error;
        }
        error == 0
    }

    fn check_supply(&self, width: u32) {
        assert!(
            self.above_2_7_v || width == 0,
            "32 bits at a time below 2.7 V"
        );
    }

    /// Brings the cells from `at` on to `target`.
    fn change(&mut self, at: usize, target: &[u8]) {
        let cut = self.cut.filter(|(when, _)| *when == self.operations);
        self.operations += 1;
        let half = target.len() / 2;
        for (index, to) in target.iter().enumerate() {
            let from = self.cells[at + index];
            self.cells[at + index] = match cut {
                None | Some((_, Cut::After)) => *to,
                Some((_, Cut::Before)) => from,
                Some((_, Cut::Half)) if index < half => *to,
                Some((_, Cut::Half)) => from,
                Some((_, Cut::SomeBits)) => {
                    from ^ ((from ^ to) & random(&mut self.random, 256) as u8)
                }
            };
        }
        if cut.is_some() {
            self.off = true;
            self.status |= OPERATION_ERROR;
        }
        self.busy_for = self.looks;
        self.status |= BUSY;
    }

    fn write_protected(&self, sector: usize) -> u32 {
        let free = self.options >> 16 & (1 << sector) != 0;
        if free { 0 } else { WRITE_PROTECTED }
    }

    fn start_of(sector: usize) -> usize {
        KIB * SECTORS[..sector].iter().sum::<usize>()
    }

    fn erase(&mut self, sector: usize) {
        assert_eq!(self.control & 1, 0, "erased and programmed at once");
        let width = self.control >> 8 & 0b11;
        self.check_supply(width);
        if !self.begins(self.write_protected(sector)) {
            return;
        }
        let (start, length) = (Self::start_of(sector), KIB * SECTORS[sector]);
        assert!(start >= START_OFFSET as usize, "that is the image");
        self.change(start, &vec![0xff; length]);
        self.micros += if width == 0b10 { 2_000_000 } else { 4_000_000 };
    }

    fn program(&mut self, at: usize, bytes: &[u8]) {
        let width = self.control >> 8 & 0b11;
        self.check_supply(width);
        let sector = (0..SECTORS.len())
            .rev()
            .find(|sector| Self::start_of(*sector) <= at)
            .unwrap();
        let error = if self.control & (LOCK | 1) != 1 {
            WRONG_SEQUENCE
        } else if bytes.len() != 1 << width {
            WRONG_WIDTH
        } else {
            self.write_protected(sector)
        };
        if !self.begins(error) {
            return;
        }
        // Ones become zeros, and nothing else happens.
        let target: Vec<u8> = bytes
            .iter()
            .zip(&self.cells[at..])
            .map(|(to, from)| to & from)
            .collect();
        self.change(at, &target);
        self.micros += 100;
    }
}

/// One controller, shared by driver and test.
#[derive(Clone)]
pub struct Shared(pub Rc<RefCell<Controller>>);

impl Shared {
    pub fn new(controller: Controller) -> Self {
        Self(Rc::new(RefCell::new(controller)))
    }
}

impl FlashRegisters for Shared {
    fn get(&mut self, register: FlashRegister) -> u32 {
        let mut this = self.0.borrow_mut();
        match register {
            FlashRegister::Access => this.access,
            FlashRegister::Key => panic!("the key register is only written"),
            FlashRegister::Status => {
                let status = this.status;
                if this.busy_for > 0 && !this.stays_busy {
                    this.busy_for -= 1;
                    if this.busy_for == 0 {
                        this.status &= !BUSY;
                    }
                }
                status
            }
            FlashRegister::Control => this.control,
            FlashRegister::Options => this.options,
        }
    }

    fn set(&mut self, register: FlashRegister, value: u32) {
        let mut this = self.0.borrow_mut();
        match register {
            FlashRegister::Access => {
                // Reset while it is on: without effect.
                if value & (1 << 12) != 0 && !this.data_cache_is_on() {
                    this.is_cached.fill(false);
                }
                this.access = value;
            }
            FlashRegister::Key => {
                let expected = [0x4567_0123, 0xcdef_89ab][this.keys_seen as usize % 2];
                if this.locked_up || this.control & LOCK == 0 || value != expected {
                    this.locked_up = true;
                    return;
                }
                this.keys_seen += 1;
                if this.keys_seen == 2 {
                    this.keys_seen = 0;
                    this.control &= !LOCK;
                }
            }
            FlashRegister::Status => this.status &= !(value & (ERRORS | 1)),
            FlashRegister::Control => {
                if this.control & LOCK != 0 {
                    return;
                }
                assert_eq!(value & (1 << 2), 0, "mass erase");
                assert!(this.busy_for == 0 || this.stays_busy, "control while busy");
                this.control = value & !(1 << 16);
                if value & (1 << 16) != 0 {
                    assert_ne!(value & 0b10, 0, "started, but what?");
                    this.erase(value as usize >> 3 & 0xf);
                }
            }
            FlashRegister::Options => panic!("option bytes are not written"),
        }
    }

    fn load(&mut self, offset: u32) -> Option<u32> {
        let mut this = self.0.borrow_mut();
        let this = &mut *this;
        let at = offset as usize;
        assert!(at.is_multiple_of(4));
        if at < START_OFFSET as usize || at >= this.cells.len() {
            return None;
        }
        let word = |bytes: &[u8]| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        if !this.data_cache_is_on() {
            return Some(word(&this.cells));
        }
        // A cache that never forgets: what was read once stays what it was, whatever is erased or programmed.
        let line = at / LINE;
        if !this.is_cached[line] {
            let bytes = LINE * line..LINE * (line + 1);
            this.cached[bytes.clone()].copy_from_slice(&this.cells[bytes]);
            this.is_cached[line] = true;
        }
        Some(word(&this.cached))
    }

    fn store_word(&mut self, offset: u32, value: u32) {
        self.0
            .borrow_mut()
            .program(offset as usize, &value.to_le_bytes());
    }

    fn store_byte(&mut self, offset: u32, value: u8) {
        self.0.borrow_mut().program(offset as usize, &[value]);
    }
}
