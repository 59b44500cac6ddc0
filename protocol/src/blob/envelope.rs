//! The envelope of a model blob: what is checked before anything in it is believed.
//!
//! ```text
//!  offset   size  field, integers little endian
//!  ------   ----  -----------------------------------------------------------------
//!       0      8  magic, the ASCII letters "POEGPARM"
//!       8      2  format version
//!      10      2  flags: bit 0 says that the blob is signed; the others are reserved, 0
//!      12      4  length n of the payload in bytes
//!      16      4  CRC-32C (Castagnoli) of bytes 0..16 and the payload
//!      20      n  payload: the postcard encoding of [`Blob`](crate::blob::Blob)
//!  ------   ----  of a signed blob only: the trailer ---------------------------------
//!    20+n      8  key id: the first eight bytes of the public key
//!    28+n      4  revision
//!    32+n     64  Ed25519 signature over bytes 0..32+n
//!    96+n      4  CRC-32C of bytes 20+n..96+n
//! ```
//!
//! [`open`] refuses a foreign file, another version, a length that does not fit, any changed bit and any byte too few or
//! too many, each by name. It does not verify signatures: that is arithmetic, and the runtime's. The key id is part of
//! the key itself, not a hash: a public key is as random as a hash of it, and nobody has to compute one. It only shows
//! which key to take; that the key is the right one is what the signature says.
//!
//! The *revision* orders what a key has signed: a device that has a model of some revision takes no lower one.

use crc::{CRC_32_ISCSI, Crc};
use serde::{Deserialize, Serialize};

/// The format version that is written and read.
pub const FORMAT_VERSION: u16 = 1;
/// First bytes of every blob.
pub const MAGIC: [u8; 8] = *b"POEGPARM";
/// Bytes before the payload.
pub const HEADER_LENGTH: usize = 20;
/// Bytes after the payload of a signed blob.
pub const TRAILER_LENGTH: usize = SIGNED_TRAILER_LENGTH + SIGNATURE_LENGTH + 4;
/// Bytes of the trailer that are signed: key id and revision.
pub const SIGNED_TRAILER_LENGTH: usize = KEY_ID_LENGTH + 4;
/// Bytes of a key id.
pub const KEY_ID_LENGTH: usize = 8;
/// Bytes of an Ed25519 signature.
pub const SIGNATURE_LENGTH: usize = 64;

/// The flag of a signed blob.
const SIGNED: u16 = 1;

/// CRC-32C, the checksum of blobs and of link frames.
pub const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

/// A blob whose envelope is intact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope<'a> {
    /// The payload, not looked into.
    pub payload: &'a [u8],
    /// All bytes before the trailer.
    pub before_trailer: &'a [u8],
    /// What the signature is over: these and the first [`SIGNED_TRAILER_LENGTH`] bytes of the trailer. Without one, the same.
    pub signed: &'a [u8],
    /// The trailer of a signed blob. Intact, not verified.
    pub trailer: Option<Trailer>,
}

/// What follows the payload of a signed blob, without its CRC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// The first bytes of the public key.
    pub key_id: [u8; KEY_ID_LENGTH],
    /// Revision of the model.
    pub revision: u32,
    /// Ed25519 signature.
    pub signature: [u8; SIGNATURE_LENGTH],
}

impl Trailer {
    /// The bytes at the end of a signed blob.
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

    /// Its bytes that are signed behind those of the blob.
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

/// The key id of a public key.
pub const fn key_id(public_key: &[u8; 32]) -> [u8; KEY_ID_LENGTH] {
    let [a, b, c, d, e, f, g, h, ..] = *public_key;
    [a, b, c, d, e, f, g, h]
}

/// Why bytes are not a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DecodeError {
    /// Fewer bytes than the header, or than it announces.
    Truncated {
        /// Bytes needed.
        expected: u32,
        /// Bytes there.
        found: u32,
    },
    /// The first eight bytes are not [`MAGIC`].
    WrongMagic,
    /// Written in a format that this version does not know.
    UnknownVersion {
        /// Version of the blob.
        found: u16,
        /// The version that can be read.
        supported: u16,
    },
    /// A reserved bit of the flags is not zero.
    ReservedBitsSet,
    /// More bytes than the header announces.
    TrailingBytes {
        /// Bytes announced.
        expected: u32,
        /// Bytes there.
        found: u32,
    },
    /// Some bit has changed, of header and payload or of the trailer.
    CrcMismatch {
        /// CRC that the header or the trailer has.
        stored: u32,
        /// CRC of the bytes.
        computed: u32,
    },
    /// The checksum is right and the payload is not: written by another program.
    MalformedPayload,
}

/// What was found, as a noun.
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

/// The buffer given to an encoder is too small.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferTooSmall;

impl core::fmt::Display for BufferTooSmall {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the buffer is too small for the encoded value")
    }
}

impl core::error::Error for BufferTooSmall {}

/// The CRC that the header of a blob stores: over the header before it and the payload.
pub fn blob_crc(header: &[u8], payload: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(header);
    digest.update(payload);
    digest.finalize()
}

/// The CRC in the header of `bytes`, which identifies a blob; `None` when there is no header.
pub fn stored_crc(bytes: &[u8]) -> Option<u32> {
    bytes.get(16..20)?.try_into().ok().map(u32::from_le_bytes)
}

/// Writes the header of an unsigned blob before the `length` bytes of payload that `buffer` has behind it.
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

/// Sets or clears the flag of a signed blob in `bytes`, a header and its payload without trailer, and renews the CRC.
/// These bytes, and behind them the first ones of its [`Trailer`], are to be signed.
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

/// The fields of the header.
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

/// The envelope that `bytes` are, which must hold it exactly.
///
/// # Errors
/// [`DecodeError`], in the order of its variants: length of the header, magic, version, flags, length, CRC of header and
/// payload, CRC of the trailer. Never `MalformedPayload`.
// Not inlined: what decodes the payload needs a large stack frame and must not share this one.
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
