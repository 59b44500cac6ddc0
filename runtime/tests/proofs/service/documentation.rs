//! The tables of `docs/reference/link.md` whose numbers this crate defines.

use embedded_storage::nor_flash::NorFlashErrorKind;
use poegp_runtime::filter::FilterError;
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::signature::SignatureError;
use poegp_runtime::store::{Slot, StoreError};

/// Returns the section with this heading, which contains the table.
fn table(heading: &str) -> &'static str {
    let page = include_str!("../../../../docs/reference/link.md");
    let (_, section) = page.split_once(heading).expect("a section");
    section.split("\n## ").next().unwrap_or("")
}

fn assert_rows(heading: &str, rows: &[(u8, String)]) {
    let table = table(heading);
    for (code, name) in rows {
        let row = format!("| {code} | `{name}` |");
        assert!(
            table.contains(&row),
            "{row} is not in docs/reference/link.md"
        );
    }
    let documented = table.lines().filter(|line| line.contains("| `"));
    assert_eq!(documented.count(), rows.len(), "{heading}");
}

/// Returns the name of the variant.
fn name(error: &impl core::fmt::Debug) -> String {
    let text = format!("{error:?}");
    text[..text.find(' ').unwrap_or(text.len())].to_owned()
}

/// Numbers on the wire never change; new errors are appended.
#[test]
fn codes_of_the_store() {
    let errors = [
        StoreError::NotAligned { at: 0, unit: 0 },
        StoreError::OutOfBounds {
            end: 0,
            capacity: 0,
        },
        StoreError::Overlap { at: 0 },
        StoreError::RangeTooSmall {
            length: 0,
            needed: 0,
        },
        StoreError::Unit { size: 0 },
        StoreError::BlobLength {
            length: 0,
            capacity: 0,
        },
        StoreError::BufferTooSmall { length: 0, room: 0 },
        StoreError::NotStored { slot: Slot::A },
        StoreError::CrcMismatch {
            stored: 0,
            computed: 0,
        },
        StoreError::ReadBack { at: 0 },
        StoreError::Flash {
            kind: NorFlashErrorKind::Other,
        },
        StoreError::SequenceExhausted,
        StoreError::KeyProvisioned,
        StoreError::KeyUnfinished,
        StoreError::KeyDamaged,
        StoreError::KeyPageFull,
        StoreError::SettingsFull,
    ];
    assert!(errors.iter().all(|error| !error.to_string().is_empty()));
    let rows = errors.map(|error| (error.code(), name(&error)));
    assert!((1..).zip(&rows).all(|(code, row)| row.0 == code));
    assert_rows("\n## Codes of `Store`\n", &rows);
}

#[test]
fn codes_of_signatures() {
    let errors = [
        SignatureError::Malformed,
        SignatureError::Unsigned,
        SignatureError::WrongKey { id: [0; 8] },
        SignatureError::Invalid,
    ];
    let rows = errors.map(|error| (error.code(), name(&error)));
    assert!((1..).zip(&rows).all(|(code, row)| row.0 == code));
    assert_rows("\n## Codes of `Signature`\n", &rows);
}

#[test]
fn codes_of_settings() {
    let errors = [
        FilterError::Period,
        FilterError::Rate,
        FilterError::Acceleration,
        FilterError::Blend,
        FilterError::Engaged,
    ];
    let rows = errors.map(|error| (error.code(), name(&error)));
    assert!((1..).zip(&rows).all(|(code, row)| row.0 == code));
    assert_rows("\n## Codes of `CycleSetting`\n", &rows);
}

#[test]
fn bits_of_the_status() {
    let bit = |bit| 1_u8 << bit;
    let rows: Vec<(u8, String)> = (0..8)
        .map(|index| (bit(index), Status::from_bits(bit(index)).to_string()))
        .filter(|(_, name)| !name.is_empty())
        .collect();
    assert_eq!(rows.len(), 8);
    assert_rows("\n## Status\n", &rows);
}
