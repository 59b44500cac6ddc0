//! Blobs as version 0.1 wrote them, which every version up to the last 1.x must read (docs/reference/stability.md).
//!
//! `runtime/tests/golden.rs` and `tests/tests/device/golden.rs` compare their answers. A file that a later version rewrites
//! is no longer one of these: keep the old file beside it, and the code that reads it.

use poegp_protocol::blob::{CRC, FORMAT_VERSION, decode};
use poegp_protocol::link::PROTOCOL_VERSION;

macro_rules! released {
    ($($file:literal, $crc:literal;)*) => {
        [$(($file, include_bytes!(concat!("../../../", $file)) as &[u8], $crc)),*]
    };
}

#[test]
fn blobs_of_0_1_are_kept_and_read() {
    let released = released! {
        "tests/data/golden_elastic.blob", 0x799b_4a8c;
        "tests/data/golden_elastic_curve.blob", 0x10d7_a777;
        "tests/data/golden_elastic_std.blob", 0x2311_4c88;
        "tests/data/golden_folded.blob", 0x2dd5_0248;
        "tests/data/golden_full_elastic.blob", 0xe856_d97f;
        "tests/data/golden_full_shared.blob", 0x549b_efd3;
        "tests/data/golden_per_output.blob", 0xec87_5954;
        "tests/data/golden_shared.blob", 0x0de7_e944;
        "runtime/capi/examples/arm.blob", 0x21c4_c2b7;
    };
    for (file, bytes, crc) in released {
        assert_eq!(
            CRC.checksum(bytes),
            crc,
            "{file} is not the file that 0.1 wrote: keep that file as well"
        );
        assert!(decode(bytes).is_ok(), "{file} is not read");
    }
}

/// The page of promises names the versions of the formats and of the C interface.
#[test]
fn the_page_has_the_versions_of_formats_and_of_c() {
    let page = include_str!("../../../docs/reference/stability.md");
    let header = include_str!("../../../runtime/capi/include/poegp.h");
    let c = header
        .split("#define POEGP_API_VERSION ")
        .nth(1)
        .and_then(|rest| rest.lines().next())
        .unwrap();
    for row in [
        format!("| model blob | format version {FORMAT_VERSION} |"),
        format!("| device link | protocol version {PROTOCOL_VERSION} |"),
        format!("| C and C++ | `POEGP_API_VERSION` {c} |"),
    ] {
        assert!(page.contains(&row), "{row}");
    }
}
