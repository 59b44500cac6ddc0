//! What the flash holds, what runs after a start, and how to roll back.

use embedded_storage::nor_flash::NorFlash;
use poegp_protocol::link::{Refusal, Request, Response};
use poegp_runtime::service::BoardInfo;

use super::desk::{BOARD, Desk, flash, layout};
use super::known::{Known, begin, piece, query, refused};
use super::nor::Cut;

/// Changes one byte of the blob in a slot.
fn damage(desk: &Desk, slot: u8) {
    let start = layout().slots[usize::from(slot)].start as usize;
    desk.flash.borrow_mut().bytes_mut()[start + 256 + 100] ^= 0x40;
}

/// Returns the slot that holds `known`.
fn slot_of(desk: &mut Desk, known: &Known) -> Option<u8> {
    let crc = poegp_protocol::blob::CRC.checksum(&known.bytes);
    let slots = desk.identity().slots;
    let stored = slots.into_iter().flatten();
    stored
        .filter(|stored| stored.crc == crc)
        .map(|s| s.slot)
        .next()
}

#[test]
fn nothing_stored_nothing_runs() {
    let mut desk = Desk::default();
    assert_eq!(desk.not_started, [None, None]);
    assert_eq!(desk.identity().model, None);
    assert_eq!(desk.statistics().activations, 0);
}

#[test]
fn the_newest_runs_and_when_it_is_damaged_the_other() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    let mut desk = desk.restarted();
    assert_eq!(desk.active(), Some(old.blob_crc));
    new.install(&mut desk);
    let mut desk = desk.restarted();
    assert_eq!(desk.not_started, [None, None]);
    assert_eq!(desk.active(), Some(new.blob_crc));
    assert_eq!(desk.statistics().activations, 1);
    let query = query(&[0.3, 0.4], 2.0);
    let Response::Corrected(answer) = desk.ask(&Request::Correct(query.clone())) else {
        panic!()
    };
    new.assert_corrected(&query, &answer);

    let (newer, older) = (
        slot_of(&mut desk, &new).expect("stored"),
        slot_of(&mut desk, &old).expect("stored"),
    );
    damage(&desk, newer);
    let mut desk = desk.restarted();
    // `CrcMismatch` of the store.
    let damaged = Some(Refusal::Store { code: 9 });
    assert_eq!(desk.not_started, [damaged, None]);
    assert_eq!(desk.active(), Some(old.blob_crc));
    // A new model replaces the damaged one.
    new.install(&mut desk);
    assert_eq!(slot_of(&mut desk, &new), Some(newer));
    assert_eq!(slot_of(&mut desk, &old), Some(older));

    damage(&desk, newer);
    damage(&desk, older);
    let mut desk = desk.restarted();
    assert_eq!(desk.not_started, [damaged, damaged]);
    assert_eq!(desk.identity().model, None);
    // The device can be repaired.
    new.install(&mut desk);
    assert_eq!(desk.restarted().active(), Some(new.blob_crc));
}

#[test]
fn activated_and_not_committed_is_gone_after_a_restart() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.upload(&mut desk);
    desk.ask_twice(&new.activate());
    assert_eq!(desk.active(), Some(new.blob_crc));
    assert_eq!(slot_of(&mut desk, &new), None);
    assert_eq!(desk.ask_twice(&Request::Restart), Response::Restarting);
    assert_eq!(desk.restarted().active(), Some(old.blob_crc));
}

#[test]
fn committed_and_not_activated_runs_after_a_restart() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.upload(&mut desk);
    desk.ask_twice(&Request::CommitUpload);
    assert_eq!(desk.active(), Some(old.blob_crc));
    let mut desk = desk.restarted();
    assert_eq!(desk.active(), Some(new.blob_crc));
    // A restart ends an upload.
    let answer = desk.ask(&piece(&new.bytes, 0, 10));
    assert_eq!(answer, refused(Refusal::NoUpload));
}

#[test]
fn activate_and_commit_in_either_order_keep_the_old_one() {
    let [old, new, third] = Known::three();
    for activate_first in [false, true] {
        let mut desk = Desk::default();
        old.install(&mut desk);
        for known in [&new, &third] {
            let before = desk.active();
            known.upload(&mut desk);
            if activate_first {
                desk.ask_twice(&known.activate());
                desk.ask_twice(&Request::CommitUpload);
            } else {
                desk.ask_twice(&Request::CommitUpload);
                desk.ask_twice(&known.activate());
            }
            assert_eq!(desk.active(), Some(known.blob_crc));
            // The previous model is in the other slot.
            desk.ask_twice(&known.roll_back());
            assert_eq!(desk.active(), before);
            // Forward again to the stored model.
            let back = Request::RollBack {
                from_crc: before.expect("a model"),
            };
            desk.ask_twice(&back);
            assert_eq!(desk.active(), Some(known.blob_crc));
        }
        assert_eq!(slot_of(&mut desk, &old), None);
        assert_eq!(desk.restarted().active(), Some(third.blob_crc));
    }
}

#[test]
fn the_model_before_can_be_activated_again() {
    let [old, new, third] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.install(&mut desk);
    for known in [&old, &new, &old] {
        desk.ask_twice(&known.activate());
        assert_eq!(desk.active(), Some(known.blob_crc));
    }
    // It stays in memory only until another model is verified in its place.
    third.upload(&mut desk);
    let unknown = refused(Refusal::UnknownModel {
        blob_crc: new.blob_crc,
    });
    assert_eq!(desk.ask_twice(&new.activate()), unknown);
    assert_eq!(desk.active(), Some(old.blob_crc));
    // The first model in flash stays first, because no request changed that.
    assert_eq!(desk.restarted().active(), Some(new.blob_crc));
}

#[test]
fn a_roll_back_is_done_once_and_survives() {
    let [old, new, other] = Known::three();
    let mut desk = Desk::default();
    assert!(matches!(
        desk.ask_twice(&old.roll_back()),
        Response::Identity(identity) if identity.model.is_none()
    ));
    old.install(&mut desk);
    let none = refused(Refusal::NoOtherModel);
    assert_eq!(desk.ask_twice(&old.roll_back()), none);
    new.install(&mut desk);
    for from in [&old, &other] {
        let before = desk.identity();
        let answer = desk.ask_twice(&from.roll_back());
        assert_eq!(
            answer,
            Response::Identity(before),
            "a roll back from another model than the active one does nothing"
        );
    }
    // Repeated twice: done once, refused afterwards.
    let Response::Identity(identity) = desk.ask_twice(&new.roll_back()) else {
        panic!()
    };
    assert_eq!(
        identity.model.map(|model| model.blob_crc),
        Some(old.blob_crc)
    );
    let operations = desk.flash.borrow().operations;
    desk.ask(&new.roll_back());
    assert_eq!(desk.flash.borrow().operations, operations);
    assert_eq!(desk.active(), Some(old.blob_crc));
    let mut desk = desk.restarted();
    assert_eq!(desk.active(), Some(old.blob_crc));
    // Forward again.
    desk.ask_twice(&old.roll_back());
    assert_eq!(desk.restarted().active(), Some(new.blob_crc));
}

#[test]
fn a_roll_back_ends_an_upload() {
    let [old, new, third] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.install(&mut desk);
    desk.ask(&begin(&third.bytes));
    desk.ask(&piece(&third.bytes, 0, 50));
    // A roll back that does nothing does not end an upload.
    desk.ask(&old.roll_back());
    let received = Response::Uploading { received: 60 };
    assert_eq!(desk.ask(&piece(&third.bytes, 50, 60)), received);
    desk.ask_twice(&new.roll_back());
    let no_upload = refused(Refusal::NoUpload);
    assert_eq!(desk.ask_twice(&piece(&third.bytes, 60, 70)), no_upload);
    assert_eq!(desk.ask_twice(&Request::VerifyUpload), no_upload);
    // A roll back also drops a verified model.
    third.upload(&mut desk);
    desk.ask_twice(&old.roll_back());
    assert_eq!(desk.active(), Some(new.blob_crc));
    let not_verified = refused(Refusal::NotVerified);
    assert_eq!(desk.ask_twice(&Request::CommitUpload), not_verified);
}

#[test]
fn a_roll_back_to_a_damaged_model_is_refused() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.install(&mut desk);
    let place = slot_of(&mut desk, &old).expect("stored");
    damage(&desk, place);
    let before = desk.identity();
    let damaged = refused(Refusal::Store { code: 9 });
    assert_eq!(desk.ask_twice(&new.roll_back()), damaged);
    assert_eq!(desk.identity(), before);
    assert_eq!(desk.restarted().active(), Some(new.blob_crc));
}

/// A stored model that is uploaded again and activated without a commit is recognised as the stored one.
#[test]
fn a_stored_model_that_comes_again_is_known() {
    let [old, new, third] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.upload(&mut desk);
    desk.ask(&Request::CommitUpload);
    // `new` is first in flash and not active; it is uploaded again.
    desk.ask(&old.begin());
    new.upload(&mut desk);
    desk.ask(&new.activate());
    // A roll back must not lead to the model that is active.
    desk.ask_twice(&new.roll_back());
    assert_eq!(desk.active(), Some(old.blob_crc));
    // A commit must not overwrite the active model.
    new.upload(&mut desk);
    desk.ask(&new.activate());
    third.upload(&mut desk);
    desk.ask(&Request::CommitUpload);
    assert!(slot_of(&mut desk, &new).is_some());
    assert_eq!(slot_of(&mut desk, &old), None);
}

/// A model in memory whose slot in flash was overwritten no longer has a slot.
#[test]
fn a_model_that_was_overwritten_has_no_slot() {
    let [old, new, third] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.upload(&mut desk);
    desk.ask(&Request::CommitUpload);
    // `new` is first and was never active, so it is kept, and `third` replaces `old`.
    third.upload(&mut desk);
    desk.ask(&third.activate());
    desk.ask(&Request::CommitUpload);
    assert_eq!(slot_of(&mut desk, &old), None);
    desk.ask(&old.activate());
    // A roll back from `old` leads to the newest model, which is now where `old` was.
    desk.ask_twice(&old.roll_back());
    assert_eq!(desk.active(), Some(third.blob_crc));
}

/// The newest model is damaged or too slow, so the older one was started. A model that is activated and then committed
/// replaces the one that does not start.
#[test]
fn what_was_started_is_kept() {
    for spoilt in [true, false] {
        let bound = |known: &Known| known.model.size().expect("a model").command_bound();
        let mut three = Known::three();
        three.sort_by_key(bound);
        let [old, third, new] = three;
        let mut desk = Desk::default();
        old.install(&mut desk);
        new.upload(&mut desk);
        desk.ask(&Request::CommitUpload);
        let board = BoardInfo {
            max_instructions: match spoilt {
                true => BOARD.max_instructions,
                false => bound(&new) - 1,
            },
            ..BOARD
        };
        if spoilt {
            let slot = slot_of(&mut desk, &new).expect("stored");
            damage(&desk, slot);
        }
        let mut desk = Desk::start_on(desk.flash, false, board);
        assert_eq!(desk.active(), Some(old.blob_crc));
        third.upload(&mut desk);
        desk.ask(&third.activate());
        assert_eq!(desk.active(), Some(third.blob_crc));
        desk.ask(&Request::CommitUpload);
        assert!(slot_of(&mut desk, &old).is_some());
        desk.ask(&third.roll_back());
        assert_eq!(desk.active(), Some(old.blob_crc));
    }
}

/// It is kept even if it was uploaded and committed again meanwhile, which writes nothing.
#[test]
fn what_was_started_and_comes_again_is_kept() {
    let [old, new, third] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    let mut desk = desk.restarted();
    old.install(&mut desk);
    new.upload(&mut desk);
    desk.ask(&Request::CommitUpload);
    third.upload(&mut desk);
    desk.ask(&third.activate());
    desk.ask(&Request::CommitUpload);
    assert!(slot_of(&mut desk, &old).is_some());
    assert_eq!(slot_of(&mut desk, &new), None);
}

/// The flash fails in the middle of a commit: the old model runs on.
#[test]
fn flash_that_fails_is_named() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.upload(&mut desk);
    desk.flash.borrow_mut().cut_at(5, Cut::Prefix);
    let failed = refused(Refusal::Store { code: 11 });
    assert_eq!(desk.ask_twice(&Request::CommitUpload), failed);
    assert_eq!(desk.active(), Some(old.blob_crc));
    let question = query(&[0.1, 0.2], 1.0);
    let Response::Corrected(answer) = desk.ask(&Request::Correct(question.clone())) else {
        panic!()
    };
    old.assert_corrected(&question, &answer);
    desk.flash.borrow_mut().restart();
    // The request can be repeated.
    let again = desk.ask_twice(&Request::CommitUpload);
    assert!(matches!(again, Response::Committed(_)), "{again:?}");
    assert_eq!(desk.restarted().active(), Some(new.blob_crc));
}

/// A loop of uploads and roll backs ends at the limit of writes, before the flash wears out.
#[test]
fn a_loop_does_not_wear_out_the_flash() {
    let known = Known::three();
    let allowed = 60;
    let board = BoardInfo {
        slot_writes: allowed,
        ..BOARD
    };
    let mut desk = Desk::start_on(flash(), false, board);
    let limit = refused(Refusal::TooManyWrites { allowed });
    let mut turn = 0;
    for _ in 0..2 {
        let mut changes = 0;
        loop {
            let model = &known[turn % 3];
            turn += 1;
            model.upload(&mut desk);
            let before = desk.identity().slot_writes;
            if desk.ask_twice(&Request::CommitUpload) == limit {
                turn -= 1;
                break;
            }
            changes += 1;
            desk.ask(&model.activate());
            // One write for the new blob, and one more if the model to keep was not first.
            let writes = desk.identity().slot_writes - before;
            assert!((1..=2).contains(&writes), "{writes}");
            // The same upload again writes nothing.
            model.upload(&mut desk);
            let committed = desk.ask_twice(&Request::CommitUpload);
            assert!(matches!(committed, Response::Committed(_)) || committed == limit);
            if turn % 5 == 0 && changes < allowed {
                let before = desk.identity().slot_writes;
                desk.ask(&model.roll_back());
                changes += 1;
                assert_eq!(desk.identity().slot_writes, before + 1);
            }
        }
        assert_eq!(changes, allowed);
        // Nothing is written any more, and the active model stays.
        let identity = desk.identity();
        let operations = desk.flash.borrow().operations;
        let from_crc = desk.active().expect("a model");
        assert_eq!(desk.ask(&Request::RollBack { from_crc }), limit);
        assert_eq!(desk.active(), Some(from_crc));
        assert_eq!(desk.flash.borrow().operations, operations);
        desk = Desk::start_on(desk.flash, false, board);
        assert_eq!(desk.identity().slot_writes, identity.slot_writes);
    }
}

/// If the processor stops while flash is written, nothing is written while cycles are expected.
#[test]
fn flash_that_blocks_waits_until_cycles_stop() {
    let [old, new, third] = Known::three();
    let board = BoardInfo {
        flash_blocks: true,
        ..BOARD
    };
    let mut desk = Desk::start_on(flash(), false, board);
    old.install(&mut desk);
    new.install(&mut desk);
    desk.ask(&Request::Correct(query(&[0.1, 0.2], 1.0)));
    let operations = desk.flash.borrow().operations;
    third.upload(&mut desk);
    let running = refused(Refusal::CyclesRunning);
    // The base point of the curve.
    let mut public_key = [0x66; 32];
    public_key[0] = 0x58;
    let key = Request::Provision { public_key };
    for request in [&Request::CommitUpload, &new.roll_back(), &key] {
        assert_eq!(desk.ask_twice(request), running);
    }
    // Requests that write nothing are carried out, and the upload stays.
    assert!(matches!(
        desk.ask_twice(&old.roll_back()),
        Response::Identity(_)
    ));
    desk.ask_twice(&third.activate());
    assert_eq!(desk.active(), Some(third.blob_crc));
    assert_eq!(desk.flash.borrow().operations, operations);
    desk.ask(&Request::StopCyclic);
    let committed = desk.ask_twice(&Request::CommitUpload);
    assert!(matches!(committed, Response::Committed(_)));
    desk.ask_twice(&third.roll_back());
    assert_eq!(desk.active(), Some(new.blob_crc));
}

#[test]
fn foreign_flash_is_no_model() {
    let foreign = flash();
    for at in (0..2 * layout().slots[0].end as usize).step_by(4) {
        let word = (at as u32).wrapping_mul(0x9e37_79b9).to_le_bytes();
        foreign.borrow_mut().write(at as u32, &word).unwrap();
    }
    let mut desk = Desk::start(foreign, false);
    assert_eq!(desk.identity().model, None);
    assert_eq!(desk.identity().slots, [None, None]);
}
