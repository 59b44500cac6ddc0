//! The record of a soak, one line for each round, and the flash that passes from one round to the next.
//!
//! A round is written after its end. An interrupted round is therefore repeated, from the flash as it was left, which acts
//! as another power cut.

use std::fmt::Write as _;
use std::fs::{self, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Bytes of a slot in the flash of the MPS2 boards (`firmware/src/board/mps2.rs`), and of the slot's head.
const SLOT: u64 = 16 * 4_096;
const HEAD: u64 = 4_096;
/// Bytes of a slot's head, and of its blob, that are used.
const WRITTEN_HEAD: u64 = 256;
const WRITTEN_BLOB: u64 = 2_048;

/// One round.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Round {
    /// Number from 0, which seeds all random numbers.
    pub number: usize,
    /// Number of answered corrections, all of them right.
    pub answered: usize,
    /// Number of corrections that the device computed.
    pub cycles: u32,
    /// Number of damaged requests that the device received.
    pub bad_frames: u32,
    /// Number of activations by the workstation.
    pub activations: usize,
    /// Number of commits by the workstation.
    pub commits: usize,
    /// Number of roll backs by the workstation.
    pub roll_backs: usize,
    /// Number of bytes that the line damaged, dropped or doubled.
    pub damaged_bytes: u64,
    /// Deepest use of the stack in the first part of the round, bytes.
    pub stack_first: u32,
    /// Deepest use of the stack until the end, bytes.
    pub stack_last: u32,
    /// CRC of the model that the start found in the flash; 0 if none.
    pub found: u32,
    /// Whether the power was cut while the flash may have been in the middle of a write.
    pub writing_at_the_cut: bool,
}

const HEADING: &str = "# round answered cycles bad_frames activations commits roll_backs damaged_bytes stack_first stack_last \
                       found writing_at_the_cut\n";

impl Round {
    fn line(&self) -> String {
        format!(
            "{} {} {} {} {} {} {} {} {} {} {:08x} {}\n",
            self.number,
            self.answered,
            self.cycles,
            self.bad_frames,
            self.activations,
            self.commits,
            self.roll_backs,
            self.damaged_bytes,
            self.stack_first,
            self.stack_last,
            self.found,
            u8::from(self.writing_at_the_cut)
        )
    }

    fn from_line(line: &str) -> Option<Self> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [
            number,
            answered,
            cycles,
            bad,
            activations,
            commits,
            roll_backs,
            damaged,
            first,
            last,
            found,
            writing,
        ] = words.try_into().ok()?;
        Some(Self {
            number: number.parse().ok()?,
            answered: answered.parse().ok()?,
            cycles: cycles.parse().ok()?,
            bad_frames: bad.parse().ok()?,
            activations: activations.parse().ok()?,
            commits: commits.parse().ok()?,
            roll_backs: roll_backs.parse().ok()?,
            damaged_bytes: damaged.parse().ok()?,
            stack_first: first.parse().ok()?,
            stack_last: last.parse().ok()?,
            found: u32::from_str_radix(found, 16).ok()?,
            writing_at_the_cut: writing == "1",
        })
    }
}

/// All rounds, with the files of record and flash.
#[derive(Debug)]
pub struct Record {
    path: PathBuf,
    memory: PathBuf,
    /// The rounds in order.
    pub rounds: Vec<Round>,
}

impl Record {
    /// Opens the record at `path`, or begins one.
    ///
    /// # Panics
    /// If the file is not a record or its flash is missing, because a soak must continue from a known state.
    pub fn at(path: &Path) -> Self {
        let mut memory = path.as_os_str().to_owned();
        memory.push(".flash");
        let memory = PathBuf::from(memory);
        let text = fs::read_to_string(path).unwrap_or_default();
        let lines = text
            .lines()
            .enumerate()
            .filter(|(_, line)| !line.starts_with('#'));
        let rounds: Vec<Round> = lines
            .map(|(index, line)| {
                Round::from_line(line).unwrap_or_else(|| {
                    panic!("{}:{}: not a round of a soak", path.display(), index + 1)
                })
            })
            .collect();
        if rounds.is_empty() {
            let _ = fs::remove_file(&memory);
            fs::write(path, HEADING).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        } else {
            let there = memory.is_file();
            assert!(
                there,
                "{}: the flash of the record is gone",
                memory.display()
            );
        }
        Self {
            path: path.to_owned(),
            memory,
            rounds,
        }
    }

    /// Returns the file of the flash.
    pub fn memory(&self) -> &Path {
        &self.memory
    }

    /// Returns the number of corrections in all rounds.
    pub fn answered(&self) -> usize {
        self.rounds.iter().map(|round| round.answered).sum()
    }

    /// Adds a round.
    ///
    /// # Panics
    /// If it cannot be written.
    pub fn add(&mut self, round: Round) {
        let file = OpenOptions::new().append(true).open(&self.path);
        let line = round.line();
        assert_eq!(Round::from_line(&line), Some(round));
        file.and_then(|mut file| file.write_all(line.as_bytes()))
            .unwrap_or_else(|e| panic!("{}: {e}", self.path.display()));
        self.rounds.push(round);
    }

    /// Summarises all rounds in a sentence.
    pub fn summary(&self) -> String {
        let sum = |of: fn(&Round) -> usize| self.rounds.iter().map(of).sum::<usize>();
        let stack = |of: fn(&Round) -> u32| self.rounds.iter().map(of).max().unwrap_or(0);
        let mut out = String::new();
        let _ = write!(
            out,
            "soak: {} corrections answered ({} computed) in {} rounds, all right to the bit; {} activations, {} commits, {} roll \
             backs; {} bytes of the line damaged, {} damaged requests seen; {} cuts of the power, {} while flash was written, a \
             bit flipped after each: {} starts without a model; deepest stack {} bytes after the first thousand of a round, {} \
             at its end, the same in {} rounds",
            self.answered(),
            sum(|r| r.cycles as usize),
            self.rounds.len(),
            sum(|r| r.activations),
            sum(|r| r.commits),
            sum(|r| r.roll_backs),
            sum(|r| r.damaged_bytes as usize),
            sum(|r| r.bad_frames as usize),
            self.rounds.len(),
            sum(|r| usize::from(r.writing_at_the_cut)),
            // The first start is that of a new device.
            self.rounds.iter().skip(1).filter(|r| r.found == 0).count(),
            stack(|r| r.stack_first),
            stack(|r| r.stack_last),
            sum(|r| usize::from(r.stack_first == r.stack_last)),
        );
        out
    }
}

/// Flips one bit in the used part of a slot, every other time in its head. Returns the byte and the bit.
///
/// # Panics
/// If the file cannot be changed.
pub fn flip_a_bit(memory: &Path, number: usize) -> (u64, u8) {
    let mut generator = ChaCha8Rng::seed_from_u64(1_000 + number as u64);
    let slot = SLOT * generator.random_range(0..2_u64);
    let byte = slot
        + if number.is_multiple_of(2) {
            generator.random_range(0..WRITTEN_HEAD)
        } else {
            HEAD + generator.random_range(0..WRITTEN_BLOB)
        };
    let bit = generator.random_range(0..8_u8);
    let file = OpenOptions::new().read(true).write(true).open(memory);
    let flip = |mut file: fs::File| {
        let mut value = [0];
        file.seek(SeekFrom::Start(byte))?;
        file.read_exact(&mut value)?;
        file.seek(SeekFrom::Start(byte))?;
        file.write_all(&[value[0] ^ (1 << bit)])
    };
    file.and_then(flip)
        .unwrap_or_else(|e| panic!("{}: {e}", memory.display()));
    (byte, bit)
}
