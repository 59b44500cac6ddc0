//! The texts of errors contain every number that the errors carry.

use poegp_protocol::blob::envelope::{BufferTooSmall, DecodeError};
use poegp_protocol::cause::{Cause, Causes, UnknownCause};
use poegp_protocol::link::PROTOCOL_VERSION;
use poegp_protocol::link::frame::FrameError;

use crate::sample::BLOB_FORMAT;

#[test]
fn texts_of_a_blob_have_its_numbers() {
    let errors = [
        (
            DecodeError::Truncated {
                expected: 123,
                found: 45,
            },
            &["45 bytes", "at least 123"][..],
        ),
        (DecodeError::WrongMagic, &["POEGPARM"]),
        (
            DecodeError::UnknownVersion {
                found: 77,
                supported: 1,
            },
            &["version 77", "reads version 1"],
        ),
        (DecodeError::ReservedBitsSet, &["reserved bits"]),
        (
            DecodeError::TrailingBytes {
                expected: 123,
                found: 456,
            },
            &["456 bytes", "announces 123"],
        ),
        (
            DecodeError::CrcMismatch {
                stored: 0xabc,
                computed: 0xdef0,
            },
            &["CRC 0000def0", "says 00000abc"],
        ),
        (
            DecodeError::MalformedPayload,
            &["payload", "cannot be read"],
        ),
    ];
    for (error, parts) in errors {
        let text = error.to_string();
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    }
    assert!(BufferTooSmall.to_string().contains("too small"));
}

#[test]
fn texts_of_a_frame_have_its_numbers() {
    let version = FrameError::Version {
        found: 9,
        sequence: 1,
    };
    let text = version.to_string();
    let own = format!("this side version {PROTOCOL_VERSION}");
    assert!(text.contains("version 9") && text.contains(&own), "{text}");
    assert!(FrameError::Damaged.to_string().contains("damaged"));
    let unknown = FrameError::UnknownMessage { sequence: 1 };
    assert!(unknown.to_string().contains("unknown message"));
}

#[test]
fn every_cause_has_its_name_and_its_bit() {
    for (i, cause) in Cause::ALL.into_iter().enumerate() {
        assert_eq!(cause as usize, i);
        assert_eq!(cause.name().parse(), Ok(cause));
        let one: Causes = [cause].into_iter().collect();
        assert!(one.iter().eq([cause]));
        let row = format!(" {i} {cause} ");
        let listed = BLOB_FORMAT.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(listed.contains(&row), "blob-format.md:{row}");
    }
    let all: Causes = Cause::ALL.into_iter().collect();
    assert!(all.iter().eq(Cause::ALL));
    assert!(!Causes::NONE.contains(Cause::Few));
    assert_eq!("fews".parse::<Cause>(), Err(UnknownCause));
    let text = UnknownCause.to_string();
    assert!(
        text.contains("few, still,") && text.ends_with("gain"),
        "{text}"
    );
}
