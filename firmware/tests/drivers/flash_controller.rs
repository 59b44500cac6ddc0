//! A model of the STM32F4's flash controller, from RM0090, chapter 3. Where the manual leaves the behaviour open or forbids
//! an operation without stating its effect, the model does the worst or panics.

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
    /// Whether the control register is locked until a reset.
    pub locked_up: bool,
    pub busy_for: u32,
    /// How often the busy flag must be read until an operation is done.
    pub looks: u32,
    /// Whether the supply allows programming 32 bits at a time.
    pub above_2_7_v: bool,
    /// Whether the controller stays busy for ever after the next operation.
    pub stays_busy: bool,
    pub operations: u64,
    /// Longest time of all operations so far (data sheet DS8626, flash memory programming), µs.
    pub micros: u64,
    pub cut: Option<(u64, Cut)>,
    pub off: bool,
    pub random: u64,
}

impl Controller {
    /// Returns an erased flash after a reset, with these option bytes.
    pub fn new(options: u32) -> Self {
        let bytes = KIB * SECTORS.iter().sum::<usize>();
        Self {
            cells: vec![0xff; bytes],
            cached: vec![0; bytes],
            is_cached: vec![false; bytes / LINE],
            // The HAL sets five wait states, prefetch and both caches.
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

    /// Returns the controller after a loss of power: a reset with empty caches.
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

    /// Returns whether an operation may begin; if not, sets an error.
    fn begins(&mut self, error: u32) -> bool {
        if self.off {
            // Without power a driver would not run any more; in this model it gets an error.
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

    /// Changes the cells from `at` on to `target`.
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
        assert!(
            start >= START_OFFSET as usize,
            "the erased sector contains the image"
        );
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
        // Programming only turns ones into zeros.
        let target: Vec<u8> = bytes
            .iter()
            .zip(&self.cells[at..])
            .map(|(to, from)| to & from)
            .collect();
        self.change(at, &target);
        self.micros += 100;
    }
}

/// One controller that driver and test share.
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
                // A reset of the cache has no effect while the cache is on.
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
                assert!(
                    this.busy_for == 0 || this.stays_busy,
                    "the control register is written while busy"
                );
                this.control = value & !(1 << 16);
                if value & (1 << 16) != 0 {
                    assert_ne!(value & 0b10, 0, "started without a selected operation");
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
        // A cache that never forgets: a line that was read once keeps its content, whatever is erased or programmed.
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
