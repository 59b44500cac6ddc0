//! The page of the cycle's settings: a sequence of records, never erased by this code.
//!
//! ```text
//!  position 0, 1, 2 …   records in the order in which they were written
//!
//!  one record, filled up with ones to whole units, integers and floats little endian:
//!   offset  size  field
//!        0     4  "PGC1"
//!        4     4  time between two commands in µs
//!        8     4  largest rate, rad/s, f32
//!       12     4  largest acceleration, rad/s², f32
//!       16     4  blend time in s, f32
//!       20     4  most instructions of a command
//!       24     4  CRC-32C of bytes 0..24
//! ```
//!
//! The last valid record is in force. The next one goes behind everything that is not blank, so that no unit is written
//! twice: a record that a power cut has torn, or that is damaged, is skipped and keeps its position. So at every moment the
//! settings are either the old ones or the new ones. When there is no room behind the last record, the page is full for good
//! ([`StoreError::SettingsFull`]), because an erase could be interrupted and lose the settings. A page of 4096 bytes has
//! room for 146 changes. Settings that are in force already are not written again.

use embedded_storage::nor_flash::NorFlash;
use poegp_protocol::link::CycleSettings;

use crate::store::error::StoreError;
use crate::store::flash::{self, blank};
use crate::store::layout::{Layout, SETTINGS_RECORD, stride};

const LENGTH: usize = SETTINGS_RECORD as usize;
const MAGIC: u32 = u32::from_le_bytes(*b"PGC1");

fn record(settings: &CycleSettings) -> [u8; LENGTH] {
    let words = [
        MAGIC,
        settings.period_us,
        settings.rate.to_bits(),
        settings.acceleration.to_bits(),
        settings.blend_s.to_bits(),
        settings.max_instructions,
    ];
    let mut bytes = [0; LENGTH];
    if let Some((fields, crc)) = bytes.split_last_chunk_mut::<4>() {
        for (field, word) in fields.as_chunks_mut().0.iter_mut().zip(words) {
            *field = word.to_le_bytes();
        }
        *crc = flash::checksum(fields).to_le_bytes();
    }
    bytes
}

fn settings_of(bytes: &[u8; LENGTH]) -> Option<CycleSettings> {
    let (fields, crc) = bytes.split_last_chunk::<4>()?;
    let mut words = fields.as_chunks().0.iter().copied().map(u32::from_le_bytes);
    if words.next()? != MAGIC || flash::checksum(fields) != u32::from_le_bytes(*crc) {
        return None;
    }
    Some(CycleSettings {
        period_us: words.next()?,
        rate: f32::from_bits(words.next()?),
        acceleration: f32::from_bits(words.next()?),
        blend_s: f32::from_bits(words.next()?),
        max_instructions: words.next()?,
    })
}

/// Contents of the page: the settings in force, and the address of the next record if there is room for one.
struct Page {
    settings: Option<CycleSettings>,
    room: Option<u32>,
}

fn page<F: NorFlash>(flash: &mut F, layout: &Layout) -> Page {
    let stride = stride::<F>(SETTINGS_RECORD);
    let (mut at, mut after_last) = (layout.cycle.start, layout.cycle.start);
    let mut settings = None;
    while layout.cycle.end - at >= stride {
        let mut bytes = [0; LENGTH];
        let read = flash::read(flash, at, &mut bytes).is_ok();
        settings = settings_of(&bytes).filter(|_| read).or(settings);
        if !read || !blank(flash, at, stride) {
            after_last = at + stride;
        }
        at += stride;
    }
    let room = layout.cycle.end - after_last >= stride;
    Page {
        settings,
        room: room.then_some(after_last),
    }
}

/// Returns the settings in force; `None` when none were ever written.
pub fn read<F: NorFlash>(flash: &mut F, layout: &Layout) -> Option<CycleSettings> {
    page(flash, layout).settings
}

/// Writes settings, unless they are in force already.
pub fn write<F: NorFlash>(
    flash: &mut F,
    layout: &Layout,
    settings: &CycleSettings,
) -> Result<(), StoreError> {
    let page = page(flash, layout);
    let record = record(settings);
    if page
        .settings
        .is_some_and(|there| self::record(&there) == record)
    {
        return Ok(());
    }
    let at = page.room.ok_or(StoreError::SettingsFull)?;
    flash::write(flash, at, &record)
}
