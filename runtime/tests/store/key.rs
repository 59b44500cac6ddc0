//! The public key is provisioned once, through every power cut and all damage.

use poegp_runtime::store::StoreError;

use crate::nor::Cut;
use crate::steps::{TestStore, again, layout, store};

const UNITS: usize = 2;
const KEY: [u8; 32] = *b"a public key of thirty-two bytes";
const OTHER: [u8; 32] = *b"another key of as many characters"
    .first_chunk()
    .expect("33 bytes");

#[test]
fn once_and_for_all() {
    let mut store = store::<8, 256>(UNITS);
    assert_eq!(store.public_key(), Ok(None));
    store.provision(&KEY).unwrap();
    let operations = store.flash().operations;
    store.provision(&KEY).unwrap();
    assert_eq!(store.provision(&OTHER), Err(StoreError::KeyProvisioned));
    assert_eq!(store.public_key(), Ok(Some(KEY)));
    assert_eq!(store.flash().operations, operations);
    assert_eq!(store.flash().erased, 0, "the page is never erased");
    assert_eq!(again(&mut store, UNITS).public_key(), Ok(Some(KEY)));
}

/// Cuts power at every operation of provisioning `key`, then calls `then` with the store.
fn cut_everywhere<const WRITE: usize, const ERASE: usize>(
    before: &mut TestStore<WRITE, ERASE>,
    key: &[u8; 32],
    then: &mut impl FnMut(TestStore<WRITE, ERASE>, &str),
) -> u64 {
    let mut uncut = again(before, UNITS);
    let start = uncut.flash().operations;
    // Provisioning may fail because the page is full or has another key.
    let _ = uncut.provision(key);
    let operations = uncut.flash().operations - start;
    for at in 0..operations {
        for cut in Cut::ALL {
            let what = format!("{cut:?} at operation {at} of {operations}");
            let mut store = again(before, UNITS);
            store.flash().cut_at(at, cut);
            assert!(store.provision(key).is_err(), "{what}");
            then(again(&mut store, UNITS), &what);
        }
    }
    operations * Cut::ALL.len() as u64
}

fn every_cut<const WRITE: usize, const ERASE: usize>(corrects_errors: bool) -> u64 {
    let mut fresh = store::<WRITE, ERASE>(UNITS);
    fresh.flash().corrects_errors = corrects_errors;
    let mut twice = 0;
    let once = cut_everywhere(&mut fresh, &KEY, &mut |mut store, what| {
        let now = store.public_key();
        let allowed = [Ok(None), Ok(Some(KEY)), Err(StoreError::KeyUnfinished)];
        assert!(allowed.contains(&now), "{what}: {now:?}");
        // `None` is reported only if nothing was written.
        let key = layout::<ERASE>(UNITS).key;
        let blank = store.flash().bytes_mut()[key.start as usize..key.end as usize]
            .iter()
            .all(|byte| *byte == 0xff);
        assert_eq!(now == Ok(None), blank, "{what}");
        // A key in force stays; before that, another key may be provisioned.
        let result = again(&mut store, UNITS).provision(&OTHER);
        let expected = match now {
            Ok(Some(_)) => Err(StoreError::KeyProvisioned),
            _ => Ok(()),
        };
        assert_eq!(result, expected, "{what}");
        let mut repeated = again(&mut store, UNITS);
        repeated
            .provision(&KEY)
            .unwrap_or_else(|e| panic!("{what}: {e:?}"));
        assert_eq!(repeated.public_key(), Ok(Some(KEY)), "{what}");
        // Power is cut during the repetition as well.
        twice += cut_everywhere(&mut store, &KEY, &mut |mut store, again_what| {
            let then = store.public_key();
            if now == Ok(Some(KEY)) {
                assert_eq!(then, now, "{what}, then {again_what}");
            } else {
                assert!(
                    allowed.contains(&then) && (then != Ok(None) || now == Ok(None)),
                    "{what}, then {again_what}: {then:?}"
                );
            }
            store
                .provision(&KEY)
                .unwrap_or_else(|e| panic!("{what}, then {again_what}: {e:?}"));
            assert_eq!(
                store.public_key(),
                Ok(Some(KEY)),
                "{what}, then {again_what}"
            );
        });
    });
    once + twice
}

#[test]
fn every_operation_of_provisioning() {
    let mut cuts = 0;
    for corrects_errors in [false, true] {
        cuts += every_cut::<1, 64>(corrects_errors);
        cuts += every_cut::<4, 128>(corrects_errors);
        cuts += every_cut::<8, 128>(corrects_errors);
        cuts += every_cut::<8, 256>(corrects_errors);
    }
    println!("{cuts} cuts");
    assert!(cuts > 10_000);
}

/// A page that has held a key never again accepts unsigned models.
#[test]
fn every_damage_of_a_provisioned_page_refuses_or_is_harmless() {
    let mut whole = store::<4, 64>(UNITS);
    whole.provision(&KEY).unwrap();
    let key = layout::<64>(UNITS).key;
    for bit in 8 * key.start..8 * key.end {
        let mut store = again(&mut whole, UNITS);
        store.flash().bytes_mut()[bit as usize / 8] ^= 1 << (bit % 8);
        assert_eq!(store.public_key(), Ok(Some(KEY)), "bit {bit}");
        assert_eq!(store.provision(&OTHER), Err(StoreError::KeyProvisioned));
    }
    // One bit in each of both records.
    let start = key.start as usize;
    for one in 0..8 * 40 {
        for two in 0..8 * 40 {
            let mut store = again(&mut whole, UNITS);
            store.flash().bytes_mut()[start + one / 8] ^= 1 << (one % 8);
            store.flash().bytes_mut()[start + 40 + two / 8] ^= 1 << (two % 8);
            assert_eq!(store.public_key(), Err(StoreError::KeyDamaged));
            assert_eq!(store.provision(&KEY), Err(StoreError::KeyDamaged));
        }
    }
}

#[test]
fn a_page_with_no_room_for_another_attempt_says_so() {
    // Four erase units of 64 bytes hold the seal and five attempts of 40 bytes.
    let mut store = store::<8, 64>(UNITS);
    for attempt in 0..5 {
        store.flash().cut_at(2, Cut::Garbage);
        store.provision(&KEY).unwrap_err();
        store.flash().restart();
        assert_eq!(
            store.public_key(),
            Err(StoreError::KeyUnfinished),
            "{attempt}"
        );
    }
    assert_eq!(store.provision(&KEY), Err(StoreError::KeyPageFull));
    assert_eq!(store.public_key(), Err(StoreError::KeyUnfinished));
}
