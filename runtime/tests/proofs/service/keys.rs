//! The public key: it can be provisioned once, and from then on only signed models run.

use poegp_protocol::blob::envelope::{key_id, set_signed};
use poegp_protocol::link::{Key, Refusal, Request, Response};

use super::desk::{Desk, layout};
use super::known::{Known, key, public, query, refused, signed, signed_as, upload};

fn provision(desk: &mut Desk) {
    let public_key = public(&key(1));
    let Response::Identity(identity) = desk.ask_twice(&Request::Provision { public_key }) else {
        panic!()
    };
    assert_eq!(identity.key, Key::Provisioned(key_id(&public_key)));
}

/// The refusal of an unsigned model.
const UNSIGNED: Refusal = Refusal::Signature { code: 2 };

fn is_unsigned(response: &Response) -> bool {
    *response == Response::Refused(UNSIGNED)
}

/// Models signed by the key work as without a key, and the device reports their revision.
#[test]
fn signed_models_come_in() {
    let [old, new, _] = Known::three();
    let [old, new] = [&old, &new].map(|known| signed(known, &key(1)));
    let mut desk = Desk::default();
    // Including a model that came before the key, whose revision was not reported then.
    old.install(&mut desk);
    assert_eq!(desk.identity().model.expect("a model").revision, None);
    provision(&mut desk);
    let mut desk = desk.restarted();
    assert_eq!(desk.active(), Some(old.blob_crc));
    assert_eq!(desk.identity().model.expect("a model").revision, Some(1));
    new.install(&mut desk);
    assert_eq!(desk.identity().model.expect("a model").revision, Some(1));
    desk.ask_signed(&new.roll_back(), &key(1));
    assert_eq!(desk.active(), Some(old.blob_crc));
    let question = query(&[0.1, 0.2], 1.0);
    let Response::Corrected(answer) = desk.ask(&Request::Correct(question.clone())) else {
        panic!()
    };
    old.assert_corrected(&question, &answer);
    let mut desk = desk.restarted();
    assert_eq!(desk.not_started, [None, None]);
    assert_eq!(desk.active(), Some(old.blob_crc));
}

#[test]
fn what_is_signed_wrong_is_refused_and_says_why() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    provision(&mut desk);
    signed(&old, &key(1)).install(&mut desk);
    let before = desk.identity();
    let refusal = |code| refused(Refusal::Signature { code });
    let other = signed(&new, &key(2));
    assert_eq!(upload(&mut desk, &new.bytes), refusal(2));
    assert_eq!(upload(&mut desk, &other.bytes), refusal(3));
    // Another model with the signature of a good one.
    let good = signed(&new, &key(1));
    let mut body = old.bytes.clone();
    set_signed(&mut body, true);
    let trailer = good.bytes[new.bytes.len()..].to_vec();
    let forged = [body, trailer].concat();
    assert_eq!(upload(&mut desk, &forged), refusal(4));
    // Damage is reported as damage, signed or not.
    for place in [30, good.bytes.len() - 20] {
        let mut damaged = good.bytes.clone();
        damaged[place] ^= 1;
        let answer = upload(&mut desk, &damaged);
        assert!(matches!(answer, Response::Refused(Refusal::Blob(_))));
    }
    let not_verified = refused(Refusal::NotVerified);
    assert_eq!(desk.ask_twice(&Request::CommitUpload), not_verified);
    assert_eq!(desk.identity(), before);
    good.install(&mut desk);
}

#[test]
fn what_is_no_key_is_not_taken() {
    let mut desk = Desk::default();
    // Not on the curve, of small order, not canonical.
    let mut not_canonical = [0xff; 32];
    (not_canonical[0], not_canonical[31]) = (0xee, 0x7f);
    for public_key in [[7; 32], [0; 32], not_canonical] {
        let request = Request::Provision { public_key };
        assert_eq!(desk.ask_twice(&request), refused(Refusal::NotAKey));
    }
    assert_eq!(desk.identity().key, Key::None);
    provision(&mut desk);
}

#[test]
fn a_key_is_taken_once() {
    let mut desk = Desk::default();
    assert_eq!(desk.identity().key, Key::None);
    provision(&mut desk);
    let id = desk.identity().key;
    for seed in 2..5 {
        let public_key = public(&key(seed));
        let answer = desk.ask_twice(&Request::Provision { public_key });
        assert_eq!(answer, refused(Refusal::KeyIsFixed));
    }
    let mut desk = desk.restarted();
    assert_eq!(desk.identity().key, id);
    provision(&mut desk);
}

#[test]
fn nothing_unsigned_comes_in_any_more() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.install(&mut desk);
    provision(&mut desk);
    // Not by an upload,
    assert!(is_unsigned(&old.upload(&mut desk)));
    assert!(is_unsigned(&desk.ask(&Request::VerifyUpload)));
    let not_verified = refused(Refusal::NotVerified);
    assert_eq!(desk.ask_twice(&Request::CommitUpload), not_verified);
    // nor from flash,
    assert!(is_unsigned(&desk.ask_signed(&new.roll_back(), &key(1))));
    // nor after a start. Until then the active model continues.
    let question = query(&[0.1, 0.2], 1.0);
    let Response::Corrected(answer) = desk.ask(&Request::Correct(question.clone())) else {
        panic!()
    };
    new.assert_corrected(&question, &answer);
    assert_eq!(
        desk.identity().model.expect("the active one").revision,
        None
    );
    let mut desk = desk.restarted();
    assert_eq!(desk.not_started, [Some(UNSIGNED); 2]);
    assert_eq!(desk.identity().model, None);
}

/// A model that was verified before the key was provisioned cannot be activated or stored.
#[test]
fn nothing_that_was_verified_without_the_key_becomes_active() {
    let [old, new, _] = Known::three();
    for uploaded in [false, true] {
        let mut desk = Desk::default();
        old.install(&mut desk);
        if uploaded {
            new.upload(&mut desk);
        } else {
            // In memory because it was active before.
            new.install(&mut desk);
            desk.ask(&old.activate());
        }
        provision(&mut desk);
        let unknown = refused(Refusal::UnknownModel {
            blob_crc: new.blob_crc,
        });
        assert_eq!(desk.ask_twice(&new.activate()), unknown);
        let answer = desk.ask_twice(&Request::CommitUpload);
        assert_eq!(answer, refused(Refusal::NotVerified));
        if uploaded {
            // All of its bytes are still there and are verified again.
            assert!(is_unsigned(&desk.ask_twice(&Request::VerifyUpload)));
        }
        assert_eq!(desk.active(), Some(old.blob_crc));
    }
}

/// A model that was active before the key stays in memory beside a signed one, but cannot be activated again.
#[test]
fn what_ran_before_the_key_does_not_come_back() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    provision(&mut desk);
    let new = signed_as(0, &new, &key(1));
    new.install(&mut desk);
    assert!(is_unsigned(&desk.ask(&old.activate())));
    assert_eq!(desk.active(), Some(new.blob_crc));
}

/// A device whose key cannot be read accepts nothing.
#[test]
fn a_damaged_key_takes_nothing() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    provision(&mut desk);
    let page = layout().key;
    let (start, end) = (page.start as usize, page.end as usize);
    desk.flash.borrow_mut().bytes_mut()[start..end].fill(0);
    // `KeyDamaged` of the store.
    let damaged = Refusal::Store { code: 15 };
    assert_eq!(new.upload(&mut desk), refused(damaged));
    let public_key = public(&key(1));
    let answer = desk.ask_twice(&Request::Provision { public_key });
    assert_eq!(answer, refused(damaged));
    let mut desk = desk.restarted();
    assert_eq!(desk.not_started, [Some(damaged), None]);
    assert_eq!(desk.identity().model, None);
}
