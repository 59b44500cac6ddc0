//! Uploads of a blob: every refusal and every repetition, with the old model running until the activation.

use poegp_protocol::blob::{self, CRC, DecodeError};
use poegp_protocol::link::{Key, MAX_CHUNK, PROTOCOL_VERSION, Refusal, Request, Response};

use super::desk::{BYTES, Desk};
use super::known::{Known, begin, piece, query, refused, upload};
use crate::arm::{Arm, WORDS};

#[test]
fn identify_without_and_with_a_model() {
    let mut desk = Desk::default();
    let identity = desk.identity();
    assert_eq!(identity.protocol_version, PROTOCOL_VERSION);
    assert_eq!(identity.firmware_version, env!("CARGO_PKG_VERSION"));
    assert_eq!(identity.board, "a desk with a name that is longe");
    let capacity = (identity.capacity_words, identity.capacity_bytes);
    assert_eq!(capacity, (WORDS as u32, BYTES as u32));
    assert_eq!((identity.tick_hz, identity.deadline_ticks), (1_000, 1_000));
    assert_eq!(identity.image_crc, 0x1234_5678);
    assert_eq!((identity.key, identity.bypass), (Key::None, false));
    assert_eq!((identity.model, identity.slots), (None, [None, None]));

    let known = Known::new(Arm::sound(3, 7));
    let Response::Verified(model) = known.upload(&mut desk) else {
        panic!()
    };
    assert_eq!(model.blob_crc, known.blob_crc);
    assert_eq!(
        (model.joints, model.inducing_points, model.revision),
        (3, 7, None)
    );
    let names = (model.robot.as_str(), model.serial_number.as_str());
    assert_eq!(names, ("arm", ""));
    let Response::Committed(stored) = desk.ask(&Request::CommitUpload) else {
        panic!()
    };
    let length = known.bytes.len() as u32;
    assert_eq!((stored.length, stored.first), (length, true));
    assert_eq!(stored.crc, CRC.checksum(&known.bytes));
    assert_eq!(desk.identity().model, None, "not active yet");
    let Response::Identity(identity) = desk.ask_twice(&known.activate()) else {
        panic!()
    };
    assert_eq!(identity.model, Some(model));
    assert_eq!(identity.slots[usize::from(stored.slot)], Some(stored));
    assert_eq!(identity.slots[usize::from(1 - stored.slot)], None);
    assert_eq!(desk.identity(), identity);
}

#[test]
fn every_refusal_of_a_transfer_by_name() {
    let mut desk = Desk::default();
    let bytes = Known::new(Arm::sound(3, 7)).bytes;
    let length = bytes.len() as u32;
    let no_upload = refused(Refusal::NoUpload);
    assert_eq!(desk.ask_twice(&piece(&bytes, 0, 10)), no_upload);
    assert_eq!(desk.ask_twice(&Request::VerifyUpload), no_upload);
    let not_verified = refused(Refusal::NotVerified);
    assert_eq!(desk.ask_twice(&Request::CommitUpload), not_verified);
    for length in [BYTES as u32 + 1, u32::MAX] {
        let too_long = Refusal::BlobTooLong {
            length,
            capacity: BYTES as u32,
        };
        let request = Request::BeginUpload {
            length,
            crc: 0,
            replaces_robot: false,
        };
        assert_eq!(desk.ask_twice(&request), refused(too_long));
    }
    assert_eq!(
        desk.ask(&Request::VerifyUpload),
        no_upload,
        "still no upload"
    );
    let received = |received| Response::Uploading { received };
    assert_eq!(desk.ask_twice(&begin(&bytes)), received(0));
    assert_eq!(desk.ask_twice(&piece(&bytes, 0, 100)), received(100));
    assert_eq!(desk.ask_twice(&piece(&bytes, 20, 70)), received(100));
    assert_eq!(desk.ask_twice(&piece(&bytes, 100, 100)), received(100));
    assert_eq!(desk.ask_twice(&piece(&bytes, 40, 40)), received(100));
    let unexpected = |found| {
        refused(Refusal::UnexpectedOffset {
            found,
            expected: 100,
        })
    };
    for (from, to) in [(101, 200), (101, 101), (99, 101), (0, 101)] {
        let answer = desk.ask_twice(&piece(&bytes, from, to));
        assert_eq!(answer, unexpected(from as u32), "{from} to {to}");
    }
    for offset in [0, 50, 89] {
        let other = Request::UploadChunk {
            offset,
            bytes: b"other bytes",
        };
        assert_eq!(desk.ask_twice(&other), unexpected(offset));
    }
    for (offset, end) in [
        (length - 5, length + 6),
        (u32::MAX - 11, u32::MAX),
        (u32::MAX, u32::MAX),
    ] {
        let beyond = Request::UploadChunk {
            offset,
            bytes: b"eleven more",
        };
        let refusal = Refusal::ChunkTooLong { end, length };
        assert_eq!(desk.ask_twice(&beyond), refused(refusal));
    }
    let incomplete = Refusal::Incomplete {
        received: 100,
        length,
    };
    assert_eq!(desk.ask_twice(&Request::VerifyUpload), refused(incomplete));
    assert_eq!(desk.ask_twice(&Request::CommitUpload), not_verified);
    // After all refusals the upload continues where it was.
    assert_eq!(desk.ask_twice(&piece(&bytes, 100, 150)), received(150));
    // A second BeginUpload starts again; a refused one does not.
    let refused_begin = Request::BeginUpload {
        length: u32::MAX,
        crc: 0,
        replaces_robot: false,
    };
    desk.ask(&refused_begin);
    assert_eq!(desk.ask_twice(&piece(&bytes, 150, 160)), received(160));
    assert_eq!(desk.ask_twice(&begin(&bytes)), received(0));
    assert_eq!(desk.ask_twice(&piece(&bytes, 0, 10)), received(10));
    assert_eq!(desk.identity().model, None);
}

/// A blob is refused at `VerifyUpload`, twice with the same refusal, while the old model stays active.
#[test]
fn a_refused_blob_leaves_the_old_model() {
    let mut desk = Desk::default();
    let good = Known::new(Arm::sound(2, 5));
    good.install(&mut desk);
    let before = desk.identity();
    let question = Request::Evaluate(query(&[0.1, 0.2], 1.0));
    let answer = desk.ask(&question);

    let other = Known::new(Arm::sound(3, 7));
    let mut damaged = other.bytes.clone();
    damaged[300] ^= 1;
    let crc = DecodeError::CrcMismatch {
        stored: blob::stored_crc(&damaged).unwrap(),
        computed: blob::blob_crc(&damaged[..16], &damaged[20..]),
    };
    let mut bad_limit = Arm::sound(3, 7);
    bad_limit.task().limit.position_m = -1.0;
    let mut buffer = vec![0; BYTES];
    let bad_limit = blob::encode(&bad_limit.blob(), &mut buffer).unwrap();
    let truncated = DecodeError::Truncated {
        expected: 20,
        found: 0,
    };
    let cases = [
        (damaged, Refusal::Blob(crc)),
        (
            b"not a blob, long enough".to_vec(),
            Refusal::Blob(DecodeError::WrongMagic),
        ),
        (Vec::new(), Refusal::Blob(truncated)),
        (bad_limit.to_vec(), Refusal::Model { code: 8 }),
    ];
    for (bytes, refusal) in cases {
        assert_eq!(upload(&mut desk, &bytes), refused(refusal));
        let again = desk.ask(&Request::VerifyUpload);
        assert_eq!(again, refused(refusal), "repeated");
        let commit = desk.ask_twice(&Request::CommitUpload);
        assert_eq!(commit, refused(Refusal::NotVerified));
        assert_eq!(desk.ask(&question), answer);
        assert_eq!(desk.identity(), before);
    }
    // Bytes other than the announced ones.
    desk.ask(&Request::BeginUpload {
        length: 4,
        crc: 5,
        replaces_robot: false,
    });
    desk.ask(&piece(&[1, 2, 3, 4], 0, 4));
    let refusal = Refusal::TransferCrc {
        stored: 5,
        computed: CRC.checksum(&[1, 2, 3, 4]),
    };
    assert_eq!(desk.ask_twice(&Request::VerifyUpload), refused(refusal));
    assert_eq!(desk.ask(&question), answer);
    assert_eq!(desk.statistics().activations, 1);
    // None of the refused blobs can be activated.
    let unknown = refused(Refusal::UnknownModel {
        blob_crc: other.blob_crc,
    });
    assert_eq!(desk.ask_twice(&other.activate()), unknown);
    other.install(&mut desk);
}

/// Every frame of an upload is sent twice: the answers are equal, and there is one activation and one write.
#[test]
fn a_whole_upload_with_every_frame_twice() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    let operations = |desk: &Desk| desk.flash.borrow().operations;
    assert_eq!(
        desk.ask_twice(&new.begin()),
        Response::Uploading { received: 0 }
    );
    for from in (0..new.bytes.len()).step_by(MAX_CHUNK) {
        let to = new.bytes.len().min(from + MAX_CHUNK);
        let answer = desk.ask_twice(&piece(&new.bytes, from, to));
        let received = to as u32;
        assert_eq!(answer, Response::Uploading { received });
    }
    let before = operations(&desk);
    let verified = desk.ask_twice(&Request::VerifyUpload);
    assert_eq!(operations(&desk), before, "nothing is written yet");
    let committed = desk.ask(&Request::CommitUpload);
    let written = operations(&desk);
    assert!(written > before);
    assert_eq!(desk.ask_twice(&Request::CommitUpload), committed);
    assert_eq!(operations(&desk), written, "written once");
    let activated = desk.ask_twice(&new.activate());
    // Earlier requests may still be repeated.
    assert_eq!(desk.ask_twice(&Request::VerifyUpload), verified);
    assert_eq!(desk.ask_twice(&Request::CommitUpload), committed);
    assert_eq!(desk.ask_twice(&new.activate()), activated);
    let (from, to) = (0, new.bytes.len().min(MAX_CHUNK));
    let received = new.bytes.len() as u32;
    let answer = desk.ask_twice(&piece(&new.bytes, from, to));
    assert_eq!(answer, Response::Uploading { received });
    assert_eq!(operations(&desk), written);
    assert_eq!(desk.statistics().activations, 2);
    assert_eq!(desk.active(), Some(new.blob_crc));
}

/// The same blob uploaded again from the beginning writes nothing to flash.
#[test]
fn an_upload_that_is_there_already_costs_no_flash() {
    let [known, ..] = Known::three();
    let mut desk = Desk::default();
    known.install(&mut desk);
    let identity = desk.identity();
    let before = desk.flash.borrow().operations;
    known.install(&mut desk);
    assert_eq!(desk.flash.borrow().operations, before);
    assert_eq!(desk.identity(), identity);
    assert_eq!(desk.statistics().activations, 1);
}
