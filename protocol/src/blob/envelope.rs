//! The envelope of a model blob: it is checked before the payload is decoded.
//!
//! ```text
//!  offset   size  field, integers little endian
//!  ------   ----  -----------------------------------------------------------------
//!       0      8  magic, the ASCII letters "POEGPARM"
//!       8      2  format version
//!      10      2  flags: bit 0 is set in a signed blob; the others are reserved, 0
//!      12      4  length n of the payload in bytes
//!      16      4  CRC-32C (Castagnoli) of bytes 0..16 and the payload
//!      20      n  payload: the postcard encoding of [`Blob`](crate::blob::Blob)
//!  ------   ----  the trailer, only in a signed blob ---------------------------------
//!    20+n      8  key id: the first eight bytes of the public key
//!    28+n      4  revision
//!    32+n     64  Ed25519 signature over bytes 0..32+n
//!    96+n      4  CRC-32C of bytes 20+n..96+n
//! ```
//!
//! [`open`] rejects a foreign file, another version, a wrong length, any changed bit and any missing or extra byte, each by
//! its own error. It does not verify signatures: that is arithmetic, which the runtime does. The key id is the beginning of
//! the key itself, not a hash: a public key is as random as its hash, and nobody has to compute one. The key id only
//! selects a key; the signature proves that the key is the right one.
//!
//! The *revision* orders the models that a key has signed: a device does not accept a lower revision than it has.

use crc::{CRC_32_ISCSI, Crc};
use serde::{Deserialize, Serialize};

/// Format version that this crate writes and reads.
pub const FORMAT_VERSION: u16 = 1;
/// First bytes of every blob.
pub const MAGIC: [u8; 8] = *b"POEGPARM";
/// Number of bytes before the payload.
pub const HEADER_LENGTH: usize = 20;
/// Number of bytes after the payload of a signed blob.
pub const TRAILER_LENGTH: usize = SIGNED_TRAILER_LENGTH + SIGNATURE_LENGTH + 4;
/// Number of signed bytes of the trailer: key id and revision.
pub const SIGNED_TRAILER_LENGTH: usize = KEY_ID_LENGTH + 4;
/// Length of a key id in bytes.
pub const KEY_ID_LENGTH: usize = 8;
/// Length of an Ed25519 signature in bytes.
pub const SIGNATURE_LENGTH: usize = 64;

/// Header flag that marks a signed blob.
const SIGNED: u16 = 1;

/// CRC-32C algorithm, the checksum of blobs and link frames.
pub const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

/// The parts of a blob whose envelope is intact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope<'a> {
    /// The payload, not yet decoded.
    pub payload: &'a [u8],
    /// All bytes before the trailer.
    pub before_trailer: &'a [u8],
    /// Signed bytes: `before_trailer` and the first [`SIGNED_TRAILER_LENGTH`] bytes of the trailer. Equals `before_trailer`
    /// for an unsigned blob.
    pub signed: &'a [u8],
    /// Trailer of a signed blob. Its CRC is checked, its signature is not.
    pub trailer: Option<Trailer>,
}

/// The trailer, which follows the payload of a signed blob, without its CRC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// First bytes of the public key.
    pub key_id: [u8; KEY_ID_LENGTH],
    /// Revision of the model.
    pub revision: u32,
    /// Ed25519 signature.
    pub signature: [u8; SIGNATURE_LENGTH],
}

impl Trailer {
    /// Encodes the trailer, with its CRC, as the last bytes of a signed blob.
    pub fn to_bytes(&self) -> [u8; TRAILER_LENGTH] {
        let mut bytes = [0; TRAILER_LENGTH];
        let revision = self.revision.to_le_bytes();
        let fields = self.key_id.iter().chain(&revision).chain(&self.signature);
        for (byte, field) in bytes.iter_mut().zip(fields) {
            *byte = *field;
        }
        if let Some((fields, crc)) = bytes.split_last_chunk_mut::<4>() {
            *crc = CRC.checksum(fields).to_le_bytes();
        }
        bytes
    }

    /// Returns the bytes of the trailer that the signature covers, after those of header and payload.
    pub fn signed_part(&self) -> [u8; SIGNED_TRAILER_LENGTH] {
        let mut part = [0; SIGNED_TRAILER_LENGTH];
        for (byte, field) in part.iter_mut().zip(self.to_bytes()) {
            *byte = field;
        }
        part
    }

    fn from_bytes(bytes: &[u8; TRAILER_LENGTH]) -> Result<Self, DecodeError> {
        let malformed = DecodeError::MalformedPayload;
        let (fields, stored) = bytes.split_last_chunk::<4>().ok_or(malformed)?;
        let stored = u32::from_le_bytes(*stored);
        let computed = CRC.checksum(fields);
        if stored != computed {
            return Err(DecodeError::CrcMismatch { stored, computed });
        }
        let (key_id, fields) = fields.split_first_chunk().ok_or(malformed)?;
        let (revision, signature) = fields.split_first_chunk().ok_or(malformed)?;
        Ok(Self {
            key_id: *key_id,
            revision: u32::from_le_bytes(*revision),
            signature: signature.try_into().map_err(|_| malformed)?,
        })
    }
}

/// Returns the key id of a public key: its first eight bytes.
pub const fn key_id(public_key: &[u8; 32]) -> [u8; KEY_ID_LENGTH] {
    let [a, b, c, d, e, f, g, h, ..] = *public_key;
    [a, b, c, d, e, f, g, h]
}

/// The reason why bytes are not a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DecodeError {
    /// There are fewer bytes than a header has, or than the header announces.
    Truncated {
        /// Number of bytes needed.
        expected: u32,
        /// Number of bytes present.
        found: u32,
    },
    /// The first eight bytes are not [`MAGIC`].
    WrongMagic,
    /// The blob has a format version that this software does not know.
    UnknownVersion {
        /// Format version of the blob.
        found: u16,
        /// Format version that can be read.
        supported: u16,
    },
    /// A reserved bit of the flags is not zero.
    ReservedBitsSet,
    /// There are more bytes than the header announces.
    TrailingBytes {
        /// Number of bytes announced.
        expected: u32,
        /// Number of bytes present.
        found: u32,
    },
    /// A bit has changed in the header, the payload or the trailer.
    CrcMismatch {
        /// CRC stored in the header or the trailer.
        stored: u32,
        /// CRC computed from the bytes.
        computed: u32,
    },
    /// The checksum is right but the payload cannot be decoded: another program has written it.
    MalformedPayload,
}

/// Describes what was found as a noun phrase.
impl core::fmt::Display for DecodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Truncated { expected, found } => {
                write!(
                    f,
                    "a truncated blob of {found} bytes, which should have at least {expected}"
                )
            }
            Self::WrongMagic => write!(f, "another kind of file (it does not begin with POEGPARM)"),
            Self::UnknownVersion { found, supported } => {
                write!(
                    f,
                    "a blob of format version {found}; this version reads version {supported}"
                )
            }
            Self::ReservedBitsSet => {
                write!(
                    f,
                    "a blob with a damaged header (reserved bits are not zero)"
                )
            }
            Self::TrailingBytes { expected, found } => {
                write!(
                    f,
                    "a blob of {found} bytes whose header announces {expected}"
                )
            }
            Self::CrcMismatch { stored, computed } => {
                write!(
                    f,
                    "a damaged blob: its bytes have CRC {computed:08x}, but it says {stored:08x}"
                )
            }
            Self::MalformedPayload => write!(
                f,
                "a blob with an intact checksum and a payload that cannot be read"
            ),
        }
    }
}

impl core::error::Error for DecodeError {}

/// The error of an encoder whose output buffer is too small.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferTooSmall;

impl core::fmt::Display for BufferTooSmall {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the buffer is too small for the encoded value")
    }
}

impl core::error::Error for BufferTooSmall {}

/// Computes the CRC that the header of a blob stores. It covers the header before the CRC, and the payload.
pub fn blob_crc(header: &[u8], payload: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(header);
    digest.update(payload);
    digest.finalize()
}

/// Returns the CRC stored in the header of `bytes`, which identifies a blob; `None` if `bytes` is too short for it.
pub fn stored_crc(bytes: &[u8]) -> Option<u32> {
    bytes.get(16..20)?.try_into().ok().map(u32::from_le_bytes)
}

/// Writes the header of an unsigned blob to the front of `buffer`, which already holds `length` bytes of payload after it.
/// Returns the bytes of the blob.
///
/// # Errors
/// [`BufferTooSmall`].
pub(crate) fn seal(length: usize, buffer: &mut [u8]) -> Result<&[u8], BufferTooSmall> {
    let end = HEADER_LENGTH + length;
    let bytes = buffer.get_mut(..end).ok_or(BufferTooSmall)?;
    let length = u32::try_from(length).map_err(|_| BufferTooSmall)?;
    let fields = MAGIC
        .into_iter()
        .chain(FORMAT_VERSION.to_le_bytes())
        .chain([0, 0])
        .chain(length.to_le_bytes());
    for (byte, field) in bytes.iter_mut().zip(fields) {
        *byte = field;
    }
    renew_crc(bytes);
    Ok(bytes)
}

/// Sets or clears the signed flag in `bytes`, a header and its payload without a trailer, and recomputes the CRC.
/// The signature covers these bytes, followed by [`Trailer::signed_part`].
pub fn set_signed(bytes: &mut [u8], signed: bool) {
    if let Some(flags) = bytes.get_mut(10..12) {
        flags.copy_from_slice(&(if signed { SIGNED } else { 0 }).to_le_bytes());
        renew_crc(bytes);
    }
}

fn renew_crc(bytes: &mut [u8]) {
    if let Some((header, payload)) = bytes.split_first_chunk_mut::<HEADER_LENGTH>()
        && let Some((before_crc, crc)) = header.split_last_chunk_mut::<4>()
    {
        *crc = blob_crc(before_crc, payload).to_le_bytes();
    }
}

/// Fields of the header after the magic.
struct Header {
    version: u16,
    flags: u16,
    length: u32,
    crc: u32,
}

impl Header {
    fn new(bytes: &[u8; HEADER_LENGTH]) -> Option<Self> {
        let rest = bytes.strip_prefix(&MAGIC)?;
        let (version, rest) = rest.split_first_chunk()?;
        let (flags, rest) = rest.split_first_chunk()?;
        let (length, rest) = rest.split_first_chunk()?;
        Some(Self {
            version: u16::from_le_bytes(*version),
            flags: u16::from_le_bytes(*flags),
            length: u32::from_le_bytes(*length),
            crc: u32::from_le_bytes(rest.try_into().ok()?),
        })
    }
}

/// Opens the envelope in `bytes`, which must contain exactly one blob, and checks it.
///
/// # Errors
/// [`DecodeError`], in the order of its variants: length of the header, magic, version, flags, length, CRC of header and
/// payload, CRC of the trailer. Never `MalformedPayload`.
// Not inlined: the function that decodes the payload needs a large stack frame and must not share this one.
#[inline(never)]
pub fn open(bytes: &[u8]) -> Result<Envelope<'_>, DecodeError> {
    let found = bytes.len() as u32;
    let (header, rest) =
        bytes
            .split_first_chunk::<HEADER_LENGTH>()
            .ok_or(DecodeError::Truncated {
                expected: HEADER_LENGTH as u32,
                found,
            })?;
    let fields = Header::new(header).ok_or(DecodeError::WrongMagic)?;
    if fields.version != FORMAT_VERSION {
        return Err(DecodeError::UnknownVersion {
            found: fields.version,
            supported: FORMAT_VERSION,
        });
    }
    if fields.flags & !SIGNED != 0 {
        return Err(DecodeError::ReservedBitsSet);
    }
    let trailer_length = if fields.flags == SIGNED {
        TRAILER_LENGTH as u32
    } else {
        0
    };
    let expected = fields
        .length
        .saturating_add(HEADER_LENGTH as u32 + trailer_length);
    match expected.cmp(&found) {
        core::cmp::Ordering::Greater => return Err(DecodeError::Truncated { expected, found }),
        core::cmp::Ordering::Less => return Err(DecodeError::TrailingBytes { expected, found }),
        core::cmp::Ordering::Equal => {}
    }
    let (payload, trailer) = rest
        .split_at_checked(fields.length as usize)
        .unwrap_or_default();
    let (before_crc, _) = header.split_at(16);
    let computed = blob_crc(before_crc, payload);
    if fields.crc != computed {
        return Err(DecodeError::CrcMismatch {
            stored: fields.crc,
            computed,
        });
    }
    let trailer = trailer.first_chunk().map(Trailer::from_bytes).transpose()?;
    let end = HEADER_LENGTH + payload.len();
    let signed_end = end + trailer.map_or(0, |_| SIGNED_TRAILER_LENGTH);
    Ok(Envelope {
        payload,
        before_trailer: bytes.get(..end).unwrap_or_default(),
        signed: bytes.get(..signed_end).unwrap_or_default(),
        trailer,
    })
}
