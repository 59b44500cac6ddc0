//! Flips every bit of the flash that holds models and key. After a start the device runs a model that was stored whole, or
//! none.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Range;
use std::rc::Rc;

use poegp_protocol::link::{Request, Response};
use poegp_runtime::guard::status::Status;
use poegp_runtime::service::ModelSlot;
use poegp_runtime::store::Store;

use super::desk::{BYTES, Desk, Flash, layout};
use super::known::{Known, assert_as_it_came, key, public, query, signed};
use crate::arm::WORDS;

const ERASE: u32 = 256;

/// Returns the parts of the flash, with their byte ranges.
fn parts() -> Vec<(&'static str, Range<u32>)> {
    let [a, b] = layout().slots;
    vec![
        ("head of slot A", a.start..a.start + ERASE),
        ("blob of slot A", a.start + ERASE..a.end),
        ("head of slot B", b.start..b.start + ERASE),
        ("blob of slot B", b.start + ERASE..b.end),
        ("page of the key", layout().key),
        ("page of the settings", layout().cycle),
    ]
}

/// Returns what the device would run: the store and the loader as [`Desk`]'s start uses them, without a whole device for
/// each bit.
fn runs(flash: Flash, resident: &mut ModelSlot<WORDS>) -> Option<u32> {
    let mut store = Store::new(flash, layout()).expect("a layout");
    let key = store.public_key().ok()?;
    let mut buffer = [0; BYTES];
    for stored in store.candidates().into_iter().flatten() {
        if let Ok(bytes) = store.read(&stored, &mut buffer)
            && resident.load(bytes, key.as_ref()).is_ok()
        {
            return resident.identity().map(|model| model.blob_crc);
        }
    }
    None
}

/// Flips every bit and counts what runs afterwards.
fn flip_every_bit(flash: &Flash, newest: &Known, other: &Known) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    let mut resident = ModelSlot::<WORDS>::default();
    assert_eq!(runs(flash.clone(), &mut resident), Some(newest.blob_crc));
    for (part, bytes) in parts() {
        for bit in 8 * bytes.start..8 * bytes.end {
            let mut flipped = flash.clone();
            flipped.bytes_mut()[bit as usize / 8] ^= 1 << (bit % 8);
            let what = match runs(flipped, &mut resident) {
                Some(crc) if crc == newest.blob_crc => "the newest model runs",
                Some(crc) if crc == other.blob_crc => "the model before it runs",
                Some(crc) => panic!("bit {bit}: {crc:08x} was never stored"),
                None => "no model runs",
            };
            *counts.entry(format!("{part}: {what}")).or_insert(0) += 1;
        }
    }
    for (what, count) in &counts {
        println!("| {what:<45} | {count:>6} |");
    }
    counts
}

fn installed(models: &[&Known]) -> Desk {
    let mut desk = Desk::default();
    for known in models {
        known.install(&mut desk);
    }
    desk
}

/// Without a key, the other model replaces a damaged one. Only a flip in the key's page leaves the device without a model.
#[test]
fn every_bit_of_the_flash_without_a_key() {
    let [old, new, _] = Known::three();
    let desk = installed(&[&old, &new]);
    let flash = desk.flash.borrow().clone();
    let counts = flip_every_bit(&flash, &new, &old);
    let all: usize = counts.values().sum();
    assert_eq!(all as u32, 8 * layout().cycle.end);
    let none: Vec<_> = counts
        .keys()
        .filter(|k| k.ends_with("no model runs"))
        .collect();
    // A key page that is not blank and holds no key refuses every model: it fails closed.
    assert_eq!(none, ["page of the key: no model runs"]);
    let replaced = counts["blob of slot B: the model before it runs"];
    assert_eq!(replaced, 8 * new.bytes.len());
}

/// Each of the two copies of the key replaces the other.
#[test]
fn every_bit_of_the_key() {
    let [old, new, _] = Known::three();
    let key = key(1);
    let (old, new) = (signed(&old, &key), signed(&new, &key));
    let mut desk = Desk::default();
    let public_key = public(&key);
    desk.ask(&Request::Provision { public_key });
    old.install(&mut desk);
    new.install(&mut desk);
    let flash = desk.flash.borrow().clone();
    let mut resident = ModelSlot::<WORDS>::default();
    let range = layout().key;
    for bit in 8 * range.start..8 * range.end {
        let mut flipped = flash.clone();
        flipped.bytes_mut()[bit as usize / 8] ^= 1 << (bit % 8);
        let mut store = Store::new(flipped.clone(), layout()).expect("a layout");
        assert_eq!(store.public_key(), Ok(Some(public_key)), "bit {bit}");
        // A sample is enough, because the check of the signature is the same computation each time.
        if bit % 64 == 0 {
            assert_eq!(
                runs(flipped, &mut resident),
                Some(new.blob_crc),
                "bit {bit}"
            );
        }
    }
    println!(
        "{} bits of the key's page: the same key",
        8 * (range.end - range.start)
    );
}

/// A whole device starts with any bit flipped that was written in the heads. It answers to the bit with the model that it
/// names, and takes a new model.
#[test]
fn a_device_starts_with_any_bit_of_the_heads_flipped() {
    let [old, new, third] = Known::three();
    let desk = installed(&[&old, &new]);
    let flash = desk.flash.borrow().clone();
    let mut starts = 0;
    for slot in layout().slots {
        // Covers the two records of 28 bytes, which is more than was written.
        for bit in 8 * slot.start..8 * (slot.start + 56) {
            let mut flipped = flash.clone();
            flipped.bytes_mut()[bit as usize / 8] ^= 1 << (bit % 8);
            let mut desk = Desk::start(Rc::new(RefCell::new(flipped)), false);
            let query = query(&[0.3, 0.4], 2.0);
            let Response::Corrected(answer) = desk.ask(&Request::Correct(query.clone())) else {
                panic!("bit {bit}")
            };
            match desk.active() {
                Some(crc) if crc == new.blob_crc => new.assert_corrected(&query, &answer),
                Some(crc) if crc == old.blob_crc => old.assert_corrected(&query, &answer),
                Some(crc) => panic!("bit {bit}: {crc:08x} was never stored"),
                None => assert_as_it_came(&query, &answer, Status::NO_MODEL),
            }
            if bit % 16 == 0 {
                third.install(&mut desk);
                assert_eq!(desk.restarted().active(), Some(third.blob_crc), "bit {bit}");
            }
            starts += 1;
        }
    }
    println!("{starts} starts with one bit of the heads flipped");
}
