//! The link: damage is counted and answered, order is enforced, and repetition is harmless.

use poegp_protocol::blob::CRC;
use poegp_protocol::link::frame::{MAX_FRAME, OVERHEAD};
use poegp_protocol::link::{MAX_CHUNK, PROTOCOL_VERSION, Refusal, Request, Response};
use poegp_tests::device::Device;
use poegp_tests::sample::{Sample, SampleCorrection};

use crate::device;

/// Returns the next answer, whatever its sequence number.
fn answer(device: &mut Device) -> (u16, Response) {
    device
        .receive()
        .unwrap()
        .expect("the device answers every frame")
}

/// Returns the refusal that answers a request.
fn refusal(device: &mut Device, request: &Request<'_>) -> Refusal {
    match device.request(request).unwrap() {
        Response::Refused(refusal) => refusal,
        other => panic!("{request:?} was answered by {other:?}"),
    }
}

fn assert_answers(device: &mut Device) {
    device.identify().unwrap();
}

#[test]
fn damaged_frames_are_answered_and_counted() {
    let mut device = device();
    let (_, good) = device.frame(&Request::Identify);
    let mut sent = 0;
    // Every bit except those of the final zero. A flip that makes a byte zero cuts the frame in two.
    for bit in 0..8 * (good.len() - 1) {
        let mut bytes = good.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let pieces = bytes
            .split(|byte| *byte == 0)
            .filter(|piece| !piece.is_empty())
            .count();
        device.send_bytes(&bytes).unwrap();
        for _ in 0..pieces {
            assert_eq!(
                answer(&mut device),
                (0, Response::Refused(Refusal::BadFrame)),
                "bit {bit}"
            );
            sent += 1;
        }
    }
    assert_answers(&mut device);
    let statistics = device.statistics().unwrap();
    assert_eq!((statistics.bad_frames, statistics.frames), (sent, 2));
}

#[test]
fn noise_before_a_frame_is_dropped_with_the_next_zero() {
    let mut device = device();
    device.send_bytes(&[0, 0, 0]).unwrap();
    device.send_bytes(b"noise\0").unwrap();
    assert_eq!(
        answer(&mut device),
        (0, Response::Refused(Refusal::BadFrame))
    );
    assert_answers(&mut device);
}

#[test]
fn too_long_frames_are_dropped_whole() {
    let mut device = device();
    let mut bytes = vec![0x55; 3 * MAX_FRAME];
    bytes.push(0);
    device.send_bytes(&bytes).unwrap();
    assert_eq!(
        answer(&mut device),
        (0, Response::Refused(Refusal::BadFrame))
    );
    assert_answers(&mut device);
    assert_eq!(device.statistics().unwrap().bad_frames, 1);
}

/// Returns a frame of these bytes, whatever they are, with CRC and COBS.
fn frame_of(body: &[u8]) -> Vec<u8> {
    let mut raw = body.to_vec();
    raw.extend(CRC.checksum(body).to_le_bytes());
    let mut out = vec![0; raw.len() + raw.len() / 254 + 2];
    // COBS written out here, so that the test does not rely on the crate that the device uses.
    let (mut code_at, mut code, mut at) = (0, 1_u8, 1);
    for byte in raw {
        if byte != 0 {
            out[at] = byte;
            at += 1;
            code += 1;
        }
        if byte == 0 || code == u8::MAX {
            out[code_at] = code;
            (code_at, code) = (at, 1);
            at += 1;
        }
    }
    out[code_at] = code;
    out.truncate(at);
    out.push(0);
    out
}

#[test]
fn another_version_is_named_with_our_own() {
    let mut device = device();
    let found = PROTOCOL_VERSION + 1;
    device
        .send_bytes(&frame_of(&[found, 0x34, 0x12, 0]))
        .unwrap();
    let expected = Refusal::ProtocolVersion {
        found,
        expected: PROTOCOL_VERSION,
    };
    assert_eq!(answer(&mut device), (0x1234, Response::Refused(expected)));
    assert_answers(&mut device);
}

#[test]
fn unknown_messages_are_refused() {
    let mut device = device();
    for message in [&[99_u8][..], &[], &[0, 0], &[1], &[4, 9]] {
        let mut body = vec![PROTOCOL_VERSION, 7, 0];
        body.extend(message);
        device.send_bytes(&frame_of(&body)).unwrap();
        assert_eq!(
            answer(&mut device),
            (7, Response::Refused(Refusal::UnknownMessage)),
            "{message:?}"
        );
    }
    assert_answers(&mut device);
}

#[test]
fn the_longest_frame_fits() {
    const { assert!(MAX_FRAME > MAX_CHUNK + OVERHEAD) };
    let mut device = device();
    let bytes = [0xff; MAX_CHUNK];
    let crc = CRC.checksum(&bytes);
    let length = MAX_CHUNK as u32;
    device
        .request(&Request::BeginUpload {
            length,
            crc,
            replaces_robot: true,
        })
        .unwrap();
    let answer = device.request(&Request::UploadChunk {
        offset: 0,
        bytes: &bytes,
    });
    assert_eq!(answer.unwrap(), Response::Uploading { received: length });
}

#[test]
fn oversized_blobs_are_refused_before_a_byte_is_sent() {
    let mut device = device();
    let capacity = device.identify().unwrap().capacity_bytes;
    for length in [capacity + 1, u32::MAX] {
        let refused = refusal(
            &mut device,
            &Request::BeginUpload {
                length,
                crc: 0,
                replaces_robot: true,
            },
        );
        assert_eq!(refused, Refusal::BlobTooLong { length, capacity });
    }
    let accepted = device.request(&Request::BeginUpload {
        length: capacity,
        crc: 0,
        replaces_robot: true,
    });
    assert_eq!(accepted.unwrap(), Response::Uploading { received: 0 });
}

#[test]
fn pieces_come_in_order_and_may_be_repeated() {
    let blob = Sample::plain(60, SampleCorrection::Shared(40)).blob();
    let (length, crc) = (blob.len() as u32, CRC.checksum(&blob));
    let piece = |offset: u32, end: u32| Request::UploadChunk {
        offset,
        bytes: &blob[offset as usize..end as usize],
    };
    let mut device = device();
    assert_eq!(refusal(&mut device, &piece(0, 10)), Refusal::NoUpload);
    assert_eq!(
        refusal(&mut device, &Request::VerifyUpload),
        Refusal::NoUpload
    );
    device
        .request(&Request::BeginUpload {
            length,
            crc,
            replaces_robot: true,
        })
        .unwrap();
    device.request(&piece(0, 100)).unwrap();
    // A gap, an overlap with other bytes, and more bytes than announced.
    assert_eq!(
        refusal(&mut device, &piece(101, 200)),
        Refusal::UnexpectedOffset {
            found: 101,
            expected: 100
        }
    );
    let other = Request::UploadChunk {
        offset: 0,
        bytes: &[0xaa; 50],
    };
    assert_eq!(
        refusal(&mut device, &other),
        Refusal::UnexpectedOffset {
            found: 0,
            expected: 100
        }
    );
    let beyond = Request::UploadChunk {
        offset: length - 1,
        bytes: &[0; 2],
    };
    assert_eq!(
        refusal(&mut device, &beyond),
        Refusal::ChunkTooLong {
            end: length + 1,
            length
        }
    );
    assert_eq!(
        refusal(&mut device, &Request::VerifyUpload),
        Refusal::Incomplete {
            received: 100,
            length
        }
    );
    // The same bytes again, all of them or the first part.
    for end in [100, 60] {
        let repeated = device.request(&piece(0, end)).unwrap();
        assert_eq!(repeated, Response::Uploading { received: 100 });
    }
    let mut offset = 100;
    while offset < length {
        let end = (offset + MAX_CHUNK as u32).min(length);
        for _ in 0..2 {
            let answer = device.request(&piece(offset, end)).unwrap();
            assert_eq!(answer, Response::Uploading { received: end });
        }
        offset = end;
    }
    for _ in 0..2 {
        let answer = device.request(&Request::VerifyUpload).unwrap();
        assert!(matches!(answer, Response::Verified(_)), "{answer:?}");
        // Even now a piece may be repeated.
        let answer = device.request(&piece(0, 60)).unwrap();
        assert_eq!(answer, Response::Uploading { received: length });
    }
    let blob_crc = poegp_protocol::blob::stored_crc(&blob).unwrap();
    for _ in 0..2 {
        let answer = device.request(&Request::Activate { blob_crc }).unwrap();
        assert!(matches!(answer, Response::Identity(_)), "{answer:?}");
    }
    assert_eq!(device.statistics().unwrap().activations, 1);
}

#[test]
fn bytes_other_than_announced_are_refused() {
    let blob = Sample::plain(61, SampleCorrection::None).blob();
    let computed = CRC.checksum(&blob);
    let stored = !computed;
    let mut device = device();
    let length = blob.len() as u32;
    device
        .request(&Request::BeginUpload {
            length,
            crc: stored,
            replaces_robot: true,
        })
        .unwrap();
    for (index, bytes) in blob.chunks(MAX_CHUNK).enumerate() {
        let offset = (index * MAX_CHUNK) as u32;
        device
            .request(&Request::UploadChunk { offset, bytes })
            .unwrap();
    }
    assert_eq!(
        refusal(&mut device, &Request::VerifyUpload),
        Refusal::TransferCrc { stored, computed }
    );
    device.load(&blob).unwrap();
}
