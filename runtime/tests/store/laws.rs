//! The store without failures, and what it refuses.

use poegp_protocol::blob::CRC;
use poegp_runtime::store::{Layout, Slot, Store, StoreError, Stored};

use crate::nor::Nor;
use crate::steps::{blob, layout, read, store, whole};

fn stored(slot: Slot, bytes: &[u8]) -> Stored {
    Stored {
        slot,
        length: bytes.len() as u32,
        crc: CRC.checksum(bytes),
    }
}

#[test]
fn erased_flash_has_nothing() {
    let mut store = store::<4, 256>(3);
    assert_eq!(store.candidates(), [None; 2]);
    assert_eq!(store.public_key(), Ok(None));
    assert_eq!(store.capacity(), 512);
    let nothing = stored(Slot::A, &blob(1));
    let error = StoreError::NotStored { slot: Slot::A };
    assert_eq!(store.promote(&nothing), Err(error));
}

/// Memory that was never erased, like RAM after a reset.
#[test]
fn foreign_memory_has_nothing_and_can_be_written() {
    for fill in [0, 0x55] {
        let mut store = store::<4, 256>(3);
        store.flash().bytes_mut().fill(fill);
        assert_eq!(store.candidates(), [None; 2]);
        assert_eq!(store.public_key(), Err(StoreError::KeyDamaged));
        for number in 1..=3 {
            store.write(&blob(number), None).unwrap();
        }
        assert_eq!(whole(&mut store), [(Slot::A, blob(3)), (Slot::B, blob(2))]);
    }
}

#[test]
fn newest_first_and_roll_back() {
    let mut store = store::<8, 256>(3);
    let (one, two, three) = (blob(1), blob(2), blob(3));
    assert_eq!(store.write(&one, None), Ok(stored(Slot::A, &one)));
    assert_eq!(store.candidates(), [Some(stored(Slot::A, &one)), None]);
    assert_eq!(store.write(&two, Some(Slot::A)), Ok(stored(Slot::B, &two)));
    let [Some(first), Some(second)] = store.candidates() else {
        panic!("two candidates");
    };
    assert_eq!(
        (first, second),
        (stored(Slot::B, &two), stored(Slot::A, &one))
    );
    assert_eq!(read(&mut store, &second), Some(one.clone()));
    assert_eq!(store.promote(&second), Ok(second));
    assert_eq!(store.candidates(), [Some(second), Some(first)]);
    // The active model is kept, whether or not it is the newest.
    assert_eq!(
        store.write(&three, Some(Slot::B)),
        Ok(stored(Slot::A, &three))
    );
    assert_eq!(
        store.promote(&second),
        Err(StoreError::NotStored { slot: Slot::A })
    );
    assert_eq!(whole(&mut store), [(Slot::A, three), (Slot::B, two)]);
}

/// The host repeats an upload whose last answer was lost.
#[test]
fn the_same_blob_again_erases_nothing() {
    let mut store = store::<4, 256>(3);
    let (one, two) = (blob(1), blob(2));
    store.write(&one, None).unwrap();
    store.write(&two, Some(Slot::A)).unwrap();
    let before = (store.flash().operations, store.flash().erased);
    for keep in [None, Some(Slot::A), Some(Slot::B)] {
        assert_eq!(store.write(&two, keep), Ok(stored(Slot::B, &two)));
    }
    assert_eq!((store.flash().operations, store.flash().erased), before);
    // The blob of the other slot becomes the first by one record.
    assert_eq!(store.write(&one, Some(Slot::B)), Ok(stored(Slot::A, &one)));
    assert_eq!(store.flash().erased, before.1);
    assert_eq!(whole(&mut store), [(Slot::A, one), (Slot::B, two)]);
}

#[test]
fn blobs_of_every_length_that_fits() {
    let mut store = store::<8, 64>(3);
    let bytes: Vec<u8> = (0..=129).collect();
    for length in 1..=128 {
        let blob = &bytes[..length];
        let at = store.write(blob, None).unwrap();
        assert_eq!(read(&mut store, &at).as_deref(), Some(blob));
        let error = StoreError::BufferTooSmall {
            length: length as u32,
            room: length as u32 - 1,
        };
        assert_eq!(store.read(&at, &mut vec![0; length - 1]), Err(error));
    }
    for length in [0, 129] {
        let error = StoreError::BlobLength {
            length: length as u32,
            capacity: 128,
        };
        assert_eq!(store.write(&bytes[..length], None), Err(error));
    }
    assert_eq!(whole(&mut store).len(), 2);
}

#[test]
fn layouts_that_cannot_be_used_are_refused() {
    let refused = |layout: Layout| Store::new(Nor::<4, 256>::new(8), layout).map(drop);
    let with = |a, b, key| Layout {
        slots: [a, b],
        key,
        cycle: 1792..2048,
    };
    assert_eq!(refused(with(0..512, 512..1024, 1024..1280)), Ok(()));
    let cases = [
        (
            with(0..512, 512..1024, 1024..1281),
            StoreError::NotAligned {
                at: 1281,
                unit: 256,
            },
        ),
        (
            with(0..512, 512..1024, 2048..2304),
            StoreError::OutOfBounds {
                end: 2304,
                capacity: 2048,
            },
        ),
        (
            with(0..512, 512..768, 1024..1280),
            StoreError::RangeTooSmall {
                length: 256,
                needed: 512,
            },
        ),
        (
            with(0..512, 512..1024, 1280..1280),
            StoreError::RangeTooSmall {
                length: 0,
                needed: 80,
            },
        ),
        (
            with(0..512, 256..1024, 1024..1280),
            StoreError::Overlap { at: 256 },
        ),
        (
            with(0..512, 512..1024, 256..512),
            StoreError::Overlap { at: 256 },
        ),
    ];
    let settings = |cycle| Layout {
        cycle,
        ..with(0..512, 512..1024, 1024..1280)
    };
    let empty = StoreError::RangeTooSmall {
        length: 0,
        needed: 28,
    };
    let overlaps = |at| StoreError::Overlap { at };
    let more = [
        (settings(1280..1280), empty),
        (settings(256..512), overlaps(256)),
        (settings(768..1024), overlaps(768)),
        (settings(1024..1280), overlaps(1024)),
    ];
    for (layout, error) in cases.into_iter().chain(more) {
        assert_eq!(refused(layout), Err(error));
    }
    let head_too_small = Store::new(Nor::<8, 24>::new(20), layout::<24>(3)).map(drop);
    let error = StoreError::RangeTooSmall {
        length: 24,
        needed: 32,
    };
    assert_eq!(head_too_small, Err(error));
    let unit_too_large = Store::new(Nor::<128, 256>::new(20), layout::<256>(3)).map(drop);
    assert_eq!(unit_too_large, Err(StoreError::Unit { size: 128 }));
    let unit_of_three = Store::new(Nor::<3, 192>::new(20), layout::<192>(3)).map(drop);
    assert_eq!(unit_of_three, Err(StoreError::Unit { size: 3 }));
    let largest_unit = Store::new(Nor::<64, 256>::new(20), layout::<256>(3)).map(drop);
    assert_eq!(largest_unit, Ok(()));
    let no_whole_units = Store::new(Nor::<16, 200>::new(20), layout::<200>(3)).map(drop);
    let error = StoreError::NotAligned { at: 200, unit: 16 };
    assert_eq!(no_whole_units, Err(error));
    assert_eq!([Slot::A.index(), Slot::B.index()], [0, 1]);
    assert_eq!([Slot::A.other(), Slot::B.other()], [Slot::B, Slot::A]);
}
