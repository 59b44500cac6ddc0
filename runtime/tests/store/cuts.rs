//! Power cuts at every operation of `write` and `promote`.

use crate::nor::Cut;
use crate::steps::{Step, TestStore, again, boots_with, carry_out, random, read, store, whole};

/// Returns the erase units of a slot: one for the head, and those for blobs of at most 85 bytes.
fn units(erase: usize) -> usize {
    1 + 85_usize.div_ceil(erase)
}

/// Counts of what was tried.
#[derive(Debug, Default)]
struct Tried {
    sequences: u64,
    cuts: u64,
    double_cuts: u64,
}

/// Cuts the power at every operation of `step` in every way. After each cut the store has the old or the new state and nothing
/// is lost; the same step then succeeds. `then` gets the store as it was when power came back.
fn cut_everywhere<const WRITE: usize, const ERASE: usize>(
    before: &mut TestStore<WRITE, ERASE>,
    step: Step,
    number: u32,
    cuts: &[Cut],
    then: &mut impl FnMut(TestStore<WRITE, ERASE>, &str),
) -> u64 {
    let units = units(ERASE);
    let there = whole(before);
    let outcomes = boots_with(&there, step, number);
    let mut uncut = again(before, units);
    let start = uncut.flash().operations;
    carry_out(&mut uncut, step, number).expect("nothing fails without a cut");
    outcomes.check(
        &whole(&mut again(&mut uncut, units)),
        false,
        "without a cut",
    );
    let operations = uncut.flash().operations - start;
    for at in 0..operations {
        for cut in cuts {
            let what = format!("{step:?} cut {cut:?} operation {at} of {operations}");
            let mut cut_store = again(before, units);
            cut_store.flash().cut_at(at, *cut);
            let result = carry_out(&mut cut_store, step, number);
            assert!(cut_store.flash().is_off(), "{what}");
            assert!(result.is_err(), "{what}: {result:?}");
            let mut after = again(&mut cut_store, units);
            let now = whole(&mut after);
            outcomes.check(&now, true, &what);
            then(again(&mut after, units), &what);
            // The interrupted step can be repeated, whether or not the caller knows how far it came. Only `Write` is repeated:
            // with the new model first, "the second" of the other steps is a different one.
            if step == Step::Write && now.first() == there.first() {
                carry_out(&mut after, step, number).unwrap_or_else(|e| panic!("{what}: {e:?}"));
                outcomes.check(&whole(&mut after), false, &what);
            }
        }
    }
    operations * cuts.len() as u64
}

/// Runs every sequence of at most `length` steps with the last step cut at every operation; if `twice`, so is the next step.
fn all_sequences<const WRITE: usize, const ERASE: usize>(
    length: u32,
    corrects_errors: bool,
    twice: bool,
    tried: &mut Tried,
) {
    let mut flash = store::<WRITE, ERASE>(units(ERASE));
    flash.flash().corrects_errors = corrects_errors;
    // Only a head of one record never looks usable after an interrupted erase, so only there writing must find whole erases.
    flash.flash().needs_whole_erases = ERASE == 32;
    let mut level = vec![flash];
    for depth in 0..length {
        let mut next = Vec::new();
        for before in &mut level {
            for step in Step::ALL {
                let number = depth + 1;
                tried.sequences += 1;
                let mut double_cuts = 0;
                // After a cut in the last step of a shorter sequence, the next step is cut as well.
                let double = twice && depth + 2 == length;
                tried.cuts +=
                    cut_everywhere(before, step, number, &Cut::ALL, &mut |mut after, _| {
                        let follows: &[Step] = if double {
                            &[Step::Write, Step::PromoteSecond]
                        } else {
                            &[]
                        };
                        for second in follows {
                            let ways = [Cut::Garbage, Cut::After];
                            double_cuts +=
                                cut_everywhere(&mut after, *second, 9, &ways, &mut |_, _| {});
                        }
                    });
                tried.double_cuts += double_cuts;
                let mut after = again(before, units(ERASE));
                carry_out(&mut after, step, number).unwrap();
                next.push(after);
            }
        }
        level = next;
    }
}

#[test]
fn every_operation_of_every_short_sequence() {
    let mut tried = Tried::default();
    // Heads with room for one, two, three and four records.
    all_sequences::<1, 32>(3, false, false, &mut tried);
    all_sequences::<1, 64>(3, true, false, &mut tried);
    all_sequences::<4, 32>(3, false, true, &mut tried);
    all_sequences::<4, 64>(3, true, true, &mut tried);
    all_sequences::<8, 32>(4, true, false, &mut tried);
    all_sequences::<8, 64>(3, false, true, &mut tried);
    all_sequences::<8, 128>(3, false, false, &mut tried);
    println!("{tried:?}");
    assert!(
        tried.cuts > 50_000 && tried.double_cuts > 100_000,
        "{tried:?}"
    );
}

/// Fills heads of ordinary size to the last record, and cuts power around the moment when they are full. Returns the number
/// of cuts and of erased heads.
fn full_heads<const WRITE: usize>() -> (u64, u64) {
    let units = units(4096);
    let mut store = store::<WRITE, 4096>(units);
    for number in 1..=2 {
        carry_out(&mut store, Step::Write, number).unwrap();
    }
    let (mut cuts, mut erased_heads) = (0, 0);
    let room = 2 * (4096 / 28_u32.next_multiple_of(WRITE as u32));
    for promotions in 0..2 * room {
        let before = store.flash().erased;
        let mut ahead = again(&mut store, units);
        carry_out(&mut ahead, Step::PromoteSecond, 0).unwrap();
        // The last record of a head, its erase, and the first record in the other: the cases that differ from all others.
        if ahead.flash().erased > before || promotions < 2 {
            erased_heads += ahead.flash().erased - before;
            for step in [Step::PromoteSecond, Step::WriteBesideSecond] {
                cuts += cut_everywhere(&mut store, step, 7, &Cut::ALL, &mut |_, _| {});
            }
        }
        store = ahead;
    }
    (cuts, erased_heads)
}

#[test]
fn every_operation_around_full_heads_of_4096_bytes() {
    for (write, (cuts, erased)) in [
        (1, full_heads::<1>()),
        (4, full_heads::<4>()),
        (8, full_heads::<8>()),
    ] {
        println!("write unit {write}: {cuts} cuts, heads erased {erased} times");
        assert!(erased >= 2, "the heads were never full");
    }
}

/// Runs many steps in a row and cuts power in every other one. Returns the number of cuts.
fn lives<const WRITE: usize, const ERASE: usize>() -> u64 {
    let units = units(ERASE);
    let mut cuts = 0;
    for seed in 1..=150_u64 {
        let mut random = random(seed);
        let mut store = store::<WRITE, ERASE>(units);
        store.flash().corrects_errors = seed % 2 == 0;
        store.flash().needs_whole_erases = ERASE == 32;
        for number in 1..=60 {
            let step = Step::ALL[random(5) as usize];
            let outcomes = boots_with(&whole(&mut store), step, number);
            if random(2) == 0 {
                let cut = Cut::ALL[random(6) as usize];
                let within = 1 + random(40);
                store.flash().cut_at(random(within), cut);
            }
            let result = carry_out(&mut store, step, number);
            let off = store.flash().is_off();
            cuts += u64::from(off);
            let what = format!("seed {seed}, step {number}, {step:?}");
            assert_eq!(result.is_err(), off, "{what}: {result:?}");
            store = again(&mut store, units);
            outcomes.check(&whole(&mut store), off, &what);
        }
    }
    cuts
}

#[test]
fn long_lives() {
    for (unit, cuts) in [
        (32, lives::<4, 32>()),
        (64, lives::<4, 64>()),
        (32, lives::<8, 32>()),
    ] {
        println!("erase unit {unit}: {cuts} cuts in 150 lives of 60 steps");
        assert!(cuts > 1_500);
    }
}

/// The record of a blob is written last, so the first candidate is always whole, and nobody has to read it to find out.
#[test]
fn the_first_candidate_is_whole_whenever_power_fails() {
    let mut cuts = 0;
    for cut in Cut::ALL {
        for operation in 0.. {
            let mut store = store::<4, 64>(3);
            for number in 1..=2 {
                carry_out(&mut store, Step::Write, number).unwrap();
            }
            store.flash().cut_at(operation, cut);
            let result = carry_out(&mut store, Step::Write, 3);
            if !store.flash().is_off() {
                result.unwrap();
                break;
            }
            let mut store = again(&mut store, 3);
            let [Some(first), _] = store.candidates() else {
                panic!("{cut:?} at {operation}: there is no candidate")
            };
            let bytes = read(&mut store, &first);
            assert!(
                bytes.is_some(),
                "{cut:?} at {operation}: {first:?} is not whole"
            );
            cuts += 1;
        }
    }
    println!("{cuts} cuts of a write");
    assert!(cuts > 100);
}
