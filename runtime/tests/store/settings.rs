//! The settings of the cycle: the last written ones are in force, through every power cut and all damage.

use poegp_protocol::link::CycleSettings;
use poegp_runtime::store::StoreError;

use crate::nor::Cut;
use crate::steps::{Step, TestStore, again, carry_out, layout, random, store, whole};

const UNITS: usize = 3;

fn settings(number: u32) -> CycleSettings {
    CycleSettings {
        period_us: 1_000 + number,
        rate: 0.01 * number as f32,
        acceleration: 0.5,
        blend_s: 0.25,
        max_instructions: 30_000,
    }
}

#[test]
fn the_last_ones_are_in_force() {
    let mut store = store::<4, 64>(UNITS);
    assert_eq!(store.cycle_settings(), None);
    // Two units of 64 bytes hold four records of 28.
    for number in 1..=4 {
        store.set_cycle_settings(&settings(number)).unwrap();
        let operations = store.flash().operations;
        store.set_cycle_settings(&settings(number)).unwrap();
        assert_eq!(store.flash().operations, operations, "not written again");
        assert_eq!(store.cycle_settings(), Some(settings(number)));
        store = again(&mut store, UNITS);
        assert_eq!(store.cycle_settings(), Some(settings(number)));
    }
    let full = store.set_cycle_settings(&settings(5));
    assert_eq!(full, Err(StoreError::SettingsFull));
    store.set_cycle_settings(&settings(4)).unwrap();
    assert_eq!(store.cycle_settings(), Some(settings(4)));
    assert_eq!(store.flash().erased, 0, "the page is never erased");
}

/// After a cut, the old or the new settings are in force, models and key are unchanged, and there is room for new settings.
fn every_cut<const WRITE: usize, const ERASE: usize>(corrects_errors: bool) -> u64 {
    let mut fresh = store::<WRITE, ERASE>(UNITS);
    fresh.flash().corrects_errors = corrects_errors;
    carry_out(&mut fresh, Step::Write, 1).unwrap();
    fresh.provision(&[7; 32]).unwrap();
    let models = whole(&mut fresh);
    let mut cuts = 0;
    let mut before = fresh;
    for number in 1..=2 {
        let there = before.cycle_settings();
        let mut uncut = again(&mut before, UNITS);
        let start = uncut.flash().operations;
        uncut.set_cycle_settings(&settings(number)).unwrap();
        let operations = uncut.flash().operations - start;
        for at in 0..operations {
            for cut in Cut::ALL {
                let what = format!("{number}, {cut:?} at operation {at} of {operations}");
                let mut store = again(&mut before, UNITS);
                store.flash().cut_at(at, cut);
                assert!(store.set_cycle_settings(&settings(number)).is_err());
                let mut store = again(&mut store, UNITS);
                let now = store.cycle_settings();
                let last = at + 1 == operations;
                assert!(
                    now == there || last && now == Some(settings(number)),
                    "{what}: {now:?}"
                );
                assert_eq!(whole(&mut store), models, "{what}");
                assert_eq!(store.public_key(), Ok(Some([7; 32])), "{what}");
                store
                    .set_cycle_settings(&settings(number))
                    .unwrap_or_else(|error| panic!("{what}: {error:?}"));
                assert_eq!(store.cycle_settings(), Some(settings(number)), "{what}");
                cuts += 1;
            }
        }
        before = uncut;
    }
    cuts
}

#[test]
fn every_operation_of_a_change() {
    let mut cuts = 0;
    for corrects_errors in [false, true] {
        cuts += every_cut::<1, 64>(corrects_errors);
        cuts += every_cut::<4, 64>(corrects_errors);
        cuts += every_cut::<8, 64>(corrects_errors);
        cuts += every_cut::<8, 128>(corrects_errors);
    }
    println!("{cuts} cuts");
    assert!(cuts > 500);
}

/// Changes of settings among random steps of the store, with power failing in every other one.
#[test]
fn long_lives() {
    let (mut cuts, mut full) = (0, 0);
    for seed in 1..=200_u64 {
        let mut random = random(seed);
        let mut store = store::<4, 128>(UNITS);
        let mut there = None;
        for number in 1..=30 {
            if random(2) == 0 {
                let cut = Cut::ALL[random(6) as usize];
                store.flash().cut_at(random(12), cut);
            }
            let is_setting = random(2) == 0;
            let result = if is_setting {
                store.set_cycle_settings(&settings(number))
            } else {
                carry_out(&mut store, Step::ALL[random(5) as usize], number)
            };
            cuts += u64::from(store.flash().is_off());
            full += u64::from(result == Err(StoreError::SettingsFull));
            store = again(&mut store, UNITS);
            let now = store.cycle_settings();
            let new = Some(settings(number));
            match (is_setting, result) {
                (true, Ok(())) => assert_eq!(now, new),
                (true, Err(StoreError::SettingsFull)) | (false, _) => assert_eq!(now, there),
                (true, Err(_)) => assert!(now == there || now == new, "{seed}, {number}"),
            }
            there = now;
        }
    }
    println!("{cuts} cuts, {full} changes found the page full");
    assert!(cuts > 1_000 && full > 50);
}

/// A damaged record is ignored and the one before it is in force. Models and key stay as they are.
#[test]
fn every_bit_of_the_page() {
    let page = layout::<64>(UNITS).cycle;
    let mut whole_store: TestStore<4, 64> = store(UNITS);
    carry_out(&mut whole_store, Step::Write, 1).unwrap();
    let models = whole(&mut whole_store);
    for number in 1..=3 {
        whole_store.set_cycle_settings(&settings(number)).unwrap();
    }
    let (mut same, mut older) = (0, 0);
    for bit in 8 * page.start..8 * page.end {
        let mut store = again(&mut whole_store, UNITS);
        store.flash().bytes_mut()[bit as usize / 8] ^= 1 << (bit % 8);
        match store.cycle_settings() {
            now if now == Some(settings(3)) => same += 1,
            now if now == Some(settings(2)) => older += 1,
            now => panic!("bit {bit}: {now:?}"),
        }
        assert_eq!(whole(&mut store), models);
        // The flip may make free room look used, so the page may be full.
        match store.set_cycle_settings(&settings(9)) {
            Ok(()) => assert_eq!(store.cycle_settings(), Some(settings(9))),
            error => assert_eq!(error, Err(StoreError::SettingsFull), "bit {bit}"),
        }
    }
    println!("{same} bits change nothing, {older} lead to the settings before");
    assert_eq!(older, 8 * 28);
}
