//! Bits that change while nobody writes: a damaged record is ignored, and the rest still works.

use std::collections::BTreeMap;

use poegp_runtime::store::{Slot, Stored};

use crate::steps::{Step, TestStore, again, blob, carry_out, layout, store, whole};

const UNITS: usize = 3;
/// Bits of a record.
const RECORD_BITS: usize = 8 * 28;

/// Flips every bit of the slots and counts what the device has afterwards. `written` is all that was ever stored.
fn every_bit<const WRITE: usize, const ERASE: usize>(
    before: &mut TestStore<WRITE, ERASE>,
    written: &[Stored],
    counts: &mut BTreeMap<&'static str, u64>,
) {
    let there = whole(before);
    let announced = before.candidates();
    let mut changed = 0;
    for slot in layout::<ERASE>(UNITS).slots {
        for bit in 8 * slot.start..8 * slot.end {
            let mut store = again(before, UNITS);
            store.flash().bytes_mut()[bit as usize / 8] ^= 1 << (bit % 8);
            // A damaged record is ignored before the checksum of a blob could show the damage.
            let says = store.candidates();
            for stored in says.iter().flatten() {
                assert!(
                    written.contains(stored),
                    "bit {bit}: never written: {stored:?}"
                );
            }
            changed += usize::from(says != announced);
            let now = whole(&mut store);
            assert!(
                now.iter().all(|model| there.contains(model)),
                "bit {bit}: a model that was never stored: {now:02x?}"
            );
            assert!(
                there.is_empty() || there.len() == 1 || !now.is_empty(),
                "bit {bit}"
            );
            *counts
                .entry(match &now {
                    now if *now == there => "nothing changes",
                    now if now.is_empty() => "nothing is left of one",
                    now if now.len() < there.len() && now.first() == there.first() => {
                        "the second is refused"
                    }
                    now if now.len() < there.len() => "the first is refused",
                    _ => "an older record: the same models in the other order",
                })
                .or_insert(0) += 1;
            // The next write works as usual.
            carry_out(&mut store, Step::Write, 50).unwrap_or_else(|e| panic!("bit {bit}: {e:?}"));
            assert_eq!(
                whole(&mut store).first().map(|it| it.1.clone()),
                Some(blob(50))
            );
            assert_eq!(whole(&mut store).len(), 2.min(1 + now.len()), "bit {bit}");
        }
    }
    // Damage of an older record never makes it the newest.
    assert!(
        changed <= RECORD_BITS,
        "{changed} bits change which models are found"
    );
}

#[test]
fn every_single_bit_of_the_slots() {
    let mut counts = BTreeMap::new();
    let mut store = store::<4, 64>(UNITS);
    let mut written = Vec::new();
    every_bit(&mut store, &written, &mut counts);
    for (number, step) in [
        Step::Write,
        Step::Write,
        Step::PromoteSecond,
        Step::PromoteSecond,
        Step::PromoteSecond,
        Step::WriteBesideSecond,
    ]
    .into_iter()
    .enumerate()
    {
        carry_out(&mut store, step, number as u32).unwrap();
        written.extend(store.candidates().into_iter().flatten());
        every_bit(&mut store, &written, &mut counts);
    }
    for (what, count) in &counts {
        println!("| {what:<55} | {count:>6} |");
    }
    assert_eq!(counts.values().sum::<u64>(), 7 * 2 * 3 * 64 * 8);
}

/// Whatever the caller knows of the blobs, a damaged one is not kept in place of an intact one.
#[test]
fn a_damaged_blob_is_not_kept() {
    for (damaged, keep) in [
        (Slot::B, None),
        (Slot::B, Some(Slot::B)),
        (Slot::A, Some(Slot::A)),
    ] {
        let mut store = store::<4, 64>(UNITS);
        let slots = [Slot::A, Slot::B];
        for (slot, number) in slots.into_iter().zip(1..) {
            assert_eq!(store.write(&blob(number), None).unwrap().slot, slot);
        }
        let start = layout::<64>(UNITS).slots[usize::from(damaged.index())].start as usize;
        store.flash().bytes_mut()[start + 64] ^= 1;
        let intact = whole(&mut store);
        assert_eq!(intact.len(), 1);
        store.write(&blob(3), keep).unwrap();
        assert_eq!(
            whole(&mut store),
            [vec![(damaged, blob(3))], intact].concat()
        );
    }
}

/// A record with a right checksum but wrong content cannot come from damage. Even so, one that points beyond its slot is
/// ignored.
#[test]
fn a_forged_record_cannot_point_outside_its_slot() {
    let mut store = store::<4, 64>(UNITS);
    store.write(&blob(1), None).unwrap();
    let mut record = store.flash().bytes_mut()[..24].to_vec();
    record[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    record.extend(poegp_protocol::blob::CRC.checksum(&record).to_le_bytes());
    store.flash().bytes_mut()[..28].copy_from_slice(&record);
    assert_eq!(store.candidates(), [None; 2]);
    store.write(&blob(2), None).unwrap();
    assert_eq!(whole(&mut store), [(Slot::A, blob(2))]);
}
