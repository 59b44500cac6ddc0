//! The store in the sectors of the STM32F405: after a power cut at any operation it has the old or the new state and
//! nothing is lost; and how long a commit stops the processor.

use poegp_runtime::store::{Layout, Store, Stored};

use crate::drivers::flash::{SECTOR, SectorFlash};
use crate::flash_controller::{Controller, Cut, Shared};
use crate::flash_rules::{LEVEL_3, OFF};

type Device = Store<SectorFlash<Shared>>;

/// Returns the layout of `firmware/src/board/stm32f405.rs`.
fn layout() -> Layout {
    Layout {
        slots: [2 * SECTOR..4 * SECTOR, 4 * SECTOR..6 * SECTOR],
        key: SECTOR..2 * SECTOR,
        cycle: 0..SECTOR,
    }
}

fn device(controller: Controller) -> (Device, Shared) {
    let shared = Shared::new(controller);
    let flash = SectorFlash::new(shared.clone(), 100);
    (Store::new(flash, layout()).unwrap(), shared)
}

fn blob(number: u8) -> Vec<u8> {
    (0..30)
        .map(|i: u8| i.wrapping_mul(number) ^ number)
        .collect()
}

/// Returns the stored models that are whole, the first candidate first.
fn whole(store: &mut Device) -> Vec<(Stored, Vec<u8>)> {
    let mut buffer = [0; 64];
    let candidates = store.candidates();
    let read = |stored: Stored| Some((stored, store.read(&stored, &mut buffer).ok()?.to_vec()));
    candidates.into_iter().flatten().filter_map(read).collect()
}

fn blobs(store: &mut Device) -> Vec<Vec<u8>> {
    whole(store).into_iter().map(|(_, bytes)| bytes).collect()
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Write(u8),
    Promote,
    Provision,
}

fn carry_out(store: &mut Device, step: Step) -> bool {
    let there = whole(store);
    match step {
        Step::Write(number) => {
            let active = there.first().map(|(stored, _)| stored.slot);
            store.write(&blob(number), active).is_ok()
        }
        Step::Promote => there
            .get(1)
            .is_none_or(|(stored, _)| store.promote(stored).is_ok()),
        Step::Provision => store.provision(&[7; 32]).is_ok(),
    }
}

#[test]
fn a_power_cut_at_any_operation_leaves_old_or_new() {
    let steps = [
        Step::Write(1),
        Step::Write(2),
        Step::Provision,
        Step::Write(3),
        Step::Promote,
        Step::Write(4),
    ];
    let mut cuts = 0;
    // Where the supply voltage is not guaranteed, bytes are programmed in place of words; the laws are the same.
    for (options, above_2_7_v, steps) in [(LEVEL_3, true, &steps[..]), (OFF, false, &steps[..3])] {
        let mut before = Controller {
            above_2_7_v,
            ..Controller::new(options)
        };
        for step in steps {
            let (mut store, shared) = device(before.restarted());
            let old = blobs(&mut store);
            let had_key = store.public_key().unwrap();
            assert!(carry_out(&mut store, *step), "{step:?}");
            let operations = shared.0.borrow().operations;
            let after = shared.0.borrow().restarted();
            let (mut store, _) = device(after.clone());
            let new = blobs(&mut store);
            for at in 0..operations {
                // A sample is enough in the middle of a long write.
                if at > 6 && at + 12 < operations && at % 5 != 0 {
                    continue;
                }
                for cut in Cut::ALL {
                    let (mut store, shared) = device(Controller {
                        cut: Some((at, cut)),
                        ..before.restarted()
                    });
                    assert!(!carry_out(&mut store, *step), "{step:?} {at} {cut:?}");
                    let torn = shared.0.borrow().restarted();
                    let (mut store, _) = device(torn);
                    let there = blobs(&mut store);
                    let what = format!("{step:?} {at}/{operations} {cut:?}: {there:02x?}");
                    assert!(
                        there.first() == old.first() || there.first() == new.first(),
                        "{what}"
                    );
                    if had_key.is_some() {
                        assert_eq!(store.public_key(), Ok(had_key), "{what}");
                    }
                    // The interrupted step can be repeated.
                    assert!(carry_out(&mut store, *step), "{what}");
                    cuts += 1;
                }
            }
            before = after;
        }
    }
    println!("{cuts} power cuts");
    assert!(cuts > 500, "{cuts}");
}

/// Longest times by the data sheet for a commit and a roll back: no cycle could meet them.
#[test]
fn a_commit_stops_the_processor_for_seconds() {
    println!("| supply | commit of 30 bytes | roll back | longest operation |");
    println!("|---|---|---|---|");
    for (options, erase) in [(LEVEL_3, 2_000_000), (OFF, 4_000_000)] {
        let (mut store, shared) = device(Controller::new(options));
        let mut took = |step| {
            let before = shared.0.borrow().micros;
            assert!(carry_out(&mut store, step));
            shared.0.borrow().micros - before
        };
        took(Step::Write(1));
        took(Step::Write(2));
        let commit = took(Step::Write(3));
        let roll_back = took(Step::Promote);
        let width = if options == LEVEL_3 { 32 } else { 8 };
        println!("| {width} bits | {commit} µs | {roll_back} µs | {erase} µs |");
        assert!(commit >= erase, "{commit}");
        // The watchdog waits for at least 5.4 s and is fed before each operation.
        assert!(erase < 5_400_000);
    }
}
