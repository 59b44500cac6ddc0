//! The public key: taken once, and then nothing runs that is not signed.

use poegp_protocol::link::{Refusal, Request, Response};

use super::desk::{Desk, layout};
use super::known::{Known, query, refused};

const KEY: [u8; 32] = [
    0xd7, 0x5a, 0x98, 0x01, 0x82, 0xb1, 0x0a, 0xb7, 0xd5, 0x4b, 0xfe, 0xd3, 0xc9, 0x64, 0x07, 0x3a,
    0x0e, 0xe1, 0x72, 0xf3, 0xda, 0xa6, 0x23, 0x25, 0xaf, 0x02, 0x1a, 0x68, 0xf7, 0x07, 0x51, 0x1a,
];

fn provision(desk: &mut Desk) {
    let answer = desk.ask_twice(&Request::Provision { public_key: KEY });
    assert!(matches!(answer, Response::Identity(identity) if identity.key.is_some()));
}

fn is_unsigned(response: &Response) -> bool {
    matches!(response, Response::Refused(Refusal::Signature { .. }))
}

#[test]
fn a_key_is_taken_once() {
    let mut desk = Desk::default();
    assert_eq!(desk.identity().key, None);
    provision(&mut desk);
    let id = desk.identity().key;
    for bit in [0, 100, 255] {
        let mut public_key = KEY;
        public_key[bit / 8] ^= 1 << (bit % 8);
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
    assert!(is_unsigned(&desk.ask_twice(&new.roll_back())));
    // nor after a start. Until then the active one goes on.
    let question = query(&[0.1, 0.2], 1.0);
    let Response::Corrected(answer) = desk.ask(&Request::Correct(question.clone())) else {
        panic!()
    };
    new.assert_corrected(&question, &answer);
    assert!(!desk.identity().model.expect("the active one").signed);
    let mut desk = desk.restarted();
    let unsigned = |refusal: &Option<Refusal>| matches!(refusal, Some(Refusal::Signature { .. }));
    assert!(desk.not_started.iter().all(unsigned));
    assert_eq!(desk.identity().model, None);
}

/// What was verified while there was no key.
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
            // All of its bytes are still there, and are looked at again.
            assert!(is_unsigned(&desk.ask_twice(&Request::VerifyUpload)));
        }
        assert_eq!(desk.active(), Some(old.blob_crc));
    }
}

/// A device that had a key and cannot read it takes nothing.
#[test]
fn a_damaged_key_takes_nothing() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    provision(&mut desk);
    let page = layout().key;
    let (start, end) = (page.start as usize, page.end as usize);
    desk.flash.borrow_mut().bytes_mut()[start..end].fill(0);
    // KeyDamaged of the store.
    let damaged = Refusal::Store { code: 15 };
    assert_eq!(new.upload(&mut desk), refused(damaged));
    let answer = desk.ask_twice(&Request::Provision { public_key: KEY });
    assert_eq!(answer, refused(damaged));
    let mut desk = desk.restarted();
    assert_eq!(desk.not_started, [Some(damaged), None]);
    assert_eq!(desk.identity().model, None);
}
