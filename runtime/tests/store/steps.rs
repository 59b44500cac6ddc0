//! What a device does with its store, as steps that can be repeated after a power cut.

use poegp_runtime::store::{Layout, Slot, Store, StoreError, Stored};

use crate::nor::Nor;

/// A store in the simulated flash.
pub type TestStore<const WRITE: usize, const ERASE: usize> = Store<Nor<WRITE, ERASE>>;

/// One step of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Writes a new blob while the first candidate is the active model.
    Write,
    /// Writes a new blob while the second candidate is the active model.
    WriteBesideSecond,
    /// Writes the blob that is the second candidate already.
    WriteSecondAgain,
    /// Rolls back.
    PromoteSecond,
    /// Promotes the first candidate, which changes nothing.
    PromoteFirst,
}

impl Step {
    pub const ALL: [Self; 5] = [
        Self::Write,
        Self::WriteBesideSecond,
        Self::WriteSecondAgain,
        Self::PromoteSecond,
        Self::PromoteFirst,
    ];
}

/// Returns a generator of random numbers below a bound (xorshift64).
pub fn random(seed: u64) -> impl FnMut(u64) -> u64 {
    let mut state = seed;
    move |below| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 8) % below
    }
}

/// Returns the layout of the simulated flash: slots of `units` erase units with the key page between them, then the
/// settings.
pub fn layout<const ERASE: usize>(units: usize) -> Layout {
    let (erase, units) = (ERASE as u32, units as u32);
    Layout {
        slots: [
            0..units * erase,
            (units + 4) * erase..(2 * units + 4) * erase,
        ],
        key: units * erase..(units + 4) * erase,
        cycle: (2 * units + 4) * erase..(2 * units + 6) * erase,
    }
}

/// Returns a store in erased flash with slots of `units` erase units.
pub fn store<const WRITE: usize, const ERASE: usize>(units: usize) -> TestStore<WRITE, ERASE> {
    Store::new(Nor::new(2 * units + 6), layout::<ERASE>(units)).expect("a layout")
}

/// Returns the same store after a restart.
pub fn again<const WRITE: usize, const ERASE: usize>(
    store: &mut TestStore<WRITE, ERASE>,
    units: usize,
) -> TestStore<WRITE, ERASE> {
    let mut flash = store.flash().clone();
    flash.restart();
    Store::new(flash, layout::<ERASE>(units)).expect("a layout")
}

/// Returns the blob with this number; no two have the same length and bytes.
pub fn blob(number: u32) -> Vec<u8> {
    let length = 41 + number % 37;
    let mut state = number.wrapping_mul(0x9e37_79b9) | 1;
    let mut byte = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as u8
    };
    let mut bytes: Vec<u8> = (0..length).map(|_| byte()).collect();
    // Ends with bytes that look erased, where units are filled up.
    bytes.extend([0xff; 3]);
    bytes.extend(number.to_le_bytes());
    bytes
}

/// Returns the bytes of a candidate if they match its header.
pub fn read<const WRITE: usize, const ERASE: usize>(
    store: &mut TestStore<WRITE, ERASE>,
    stored: &Stored,
) -> Option<Vec<u8>> {
    let mut buffer = [0; 256];
    store.read(stored, &mut buffer).ok().map(<[u8]>::to_vec)
}

/// Returns the whole candidates in order: what a device boots with, and what it can roll back to.
pub fn whole<const WRITE: usize, const ERASE: usize>(
    store: &mut TestStore<WRITE, ERASE>,
) -> Vec<(Slot, Vec<u8>)> {
    let candidates = store.candidates();
    candidates
        .iter()
        .flatten()
        .filter_map(|stored| Some((stored.slot, read(store, stored)?)))
        .collect()
}

/// Carries out `step`. `number` names a blob that was never written.
pub fn carry_out<const WRITE: usize, const ERASE: usize>(
    store: &mut TestStore<WRITE, ERASE>,
    step: Step,
    number: u32,
) -> Result<(), StoreError> {
    let there = whole(store);
    let (first, second) = (there.first(), there.get(1));
    let stored = |(slot, bytes): &(Slot, Vec<u8>)| Stored {
        slot: *slot,
        length: bytes.len() as u32,
        crc: poegp_protocol::blob::CRC.checksum(bytes),
    };
    let slot_of = |it: Option<&(Slot, Vec<u8>)>| it.map(|(slot, _)| *slot);
    match step {
        Step::Write => store.write(&blob(number), slot_of(first)).map(drop),
        Step::WriteBesideSecond => store.write(&blob(number), slot_of(second)).map(drop),
        Step::WriteSecondAgain => second.map_or(Ok(()), |(_, bytes)| {
            store.write(bytes, slot_of(first)).map(drop)
        }),
        Step::PromoteSecond => second.map_or(Ok(()), |it| store.promote(&stored(it)).map(drop)),
        Step::PromoteFirst => first.map_or(Ok(()), |it| store.promote(&stored(it)).map(drop)),
    }
}

/// Returns what a device may boot with after `step`, starting from `before`.
pub fn boots_with(before: &[(Slot, Vec<u8>)], step: Step, number: u32) -> Outcomes {
    let first = before.first().map(|(_, bytes)| bytes.clone());
    let second = before.get(1).map(|(_, bytes)| bytes.clone());
    let (done, kept) = match step {
        Step::Write => (Some(blob(number)), first.clone()),
        Step::WriteBesideSecond => (Some(blob(number)), second.clone().or_else(|| first.clone())),
        Step::WriteSecondAgain | Step::PromoteSecond => {
            (second.clone().or_else(|| first.clone()), first.clone())
        }
        Step::PromoteFirst => (first.clone(), first.clone()),
    };
    // A step that overwrites nothing must lose nothing.
    let all = match step {
        Step::Write | Step::WriteBesideSecond => kept.iter().cloned().collect(),
        _ => before.iter().map(|(_, bytes)| bytes.clone()).collect(),
    };
    Outcomes {
        interrupted: [first, kept, done.clone()].into(),
        done,
        all,
    }
}

/// The allowed outcomes of a step.
#[derive(Debug)]
pub struct Outcomes {
    /// The first whole candidate after an interrupted step is one of these. None is allowed only if there was none before.
    pub interrupted: Vec<Option<Vec<u8>>>,
    /// The first whole candidate after an uninterrupted step.
    pub done: Option<Vec<u8>>,
    /// What must be there in any case.
    pub all: Vec<Vec<u8>>,
}

impl Outcomes {
    /// Asserts that `there` is an allowed outcome.
    #[track_caller]
    pub fn check(&self, there: &[(Slot, Vec<u8>)], interrupted: bool, what: &str) {
        let first = there.first().map(|(_, bytes)| bytes.clone());
        if interrupted {
            assert!(
                self.interrupted.contains(&first),
                "{what}: neither old nor new: {there:02x?}, not {self:02x?}"
            );
        } else {
            assert_eq!(first, self.done, "{what}");
        }
        for bytes in &self.all {
            let found = there.iter().any(|(_, found)| found == bytes);
            assert!(found, "{what}: lost {bytes:02x?}, there is {there:02x?}");
        }
    }
}
