//! The sizes that both sides rely on, as the format pages state them; an arm of eight joints fits.

use poegp_protocol::blob::envelope::{HEADER_LENGTH, TRAILER_LENGTH};
use poegp_protocol::blob::{self, Correction, FORMAT_VERSION, MAX_LENGTH_WITHOUT_ROWS};
use poegp_protocol::limits::{MAX_FRAMES, MAX_INPUTS, MAX_JOINTS, MAX_LINK_TERMS};
use poegp_protocol::link::frame::{MAX_FRAME, OVERHEAD};
use poegp_protocol::link::{MAX_CHUNK, Request};

use crate::sample;

#[test]
fn sizes_are_those_of_the_pages() {
    assert_eq!((MAX_JOINTS, MAX_FRAMES, MAX_INPUTS), (8, 9, 9));
    // A term for each joint and each link from that joint on: 1 + 2 + … + 8.
    assert_eq!(MAX_LINK_TERMS, 36);
    assert_eq!((HEADER_LENGTH, TRAILER_LENGTH), (20, 8 + 4 + 64 + 4));
    assert_eq!(FORMAT_VERSION, 1);
    assert_eq!(MAX_LENGTH_WITHOUT_ROWS, 4_096);
    // Version, sequence number and checksum. COBS adds a byte, and one more per 254 bytes; then comes the zero.
    assert_eq!(OVERHEAD, 7);
    assert_eq!(MAX_FRAME, (MAX_CHUNK + 8 + OVERHEAD) + 2 + 1);
}

/// Every list that grows with the joints is full.
#[test]
fn the_longest_arm_is_read_as_it_was_written() {
    let rows = sample::rows();
    let mut arm = sample::blob(&rows);
    let joint = arm.robot.joints[0];
    arm.robot.joints = [joint; 8].into_iter().collect();
    arm.robot.coupling = (0..64_u8).map(f32::from).collect();
    let Correction::TaskSpace(task) = &mut arm.correction else {
        panic!("the sample has a correction of the task space")
    };
    // A constant, eight joints and the payload.
    task.affine = std::array::from_fn(|_| (0..10_u8).map(f32::from).collect());
    let mut buffer = vec![0; 4_096];
    let bytes = blob::encode(&arm, &mut buffer).expect("room");
    assert_eq!(blob::decode(bytes), Ok(arm));
}

/// A frame has room for a few bytes more than a chunk may have.
#[test]
fn a_longer_chunk_is_no_request() {
    for length in 0..=MAX_CHUNK + 8 {
        let bytes = vec![7; length];
        let request = Request::UploadChunk {
            offset: u32::MAX,
            bytes: &bytes,
        };
        let mut buffer = [0; MAX_CHUNK + 20];
        let encoded = request.encode(&mut buffer).expect("room");
        let decoded = Request::decode(encoded);
        assert_eq!(decoded.is_some(), length <= MAX_CHUNK, "{length}");
    }
}
