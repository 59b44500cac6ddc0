//! Signatures that show who made a model: Ed25519 over a blob (RFC 8032).
//!
//! A device with a provisioned public key accepts only models that this module has verified. A verification costs two
//! million instructions, 173 more for each byte of the blob, and 5 kB of stack, once for each model, never in a cycle. The
//! curve is `ed25519-compact`'s.
//!
//! Besides wrong signatures, it refuses keys and points of small order, and points and scalars that are not in canonical
//! encoding. The equation is checked up to the cofactor (8·S·B = 8·R + 8·h·A). The holder of the secret key can make
//! signatures that pass this check and fail one without the cofactor; nobody else can make signatures that pass either.

use core::fmt;
use core::hint::black_box;

use ed25519_compact::{Error, PublicKey, Signature, VerifyingState};
use poegp_protocol::blob::envelope::{self, KEY_ID_LENGTH, SIGNATURE_LENGTH};

/// Why a blob is not accepted as signed by the holder of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SignatureError {
    /// The envelope is damaged; [`envelope::open`] says how.
    Malformed,
    /// The blob is not signed.
    Unsigned,
    /// The blob is signed by another key.
    WrongKey {
        /// Id of the key that signed the blob.
        id: [u8; KEY_ID_LENGTH],
    },
    /// The signature is not one of these bytes by this key, or the key is not valid.
    Invalid,
}

impl SignatureError {
    /// Returns the explicit number of the error on the wire. The numbers are append-only.
    pub const fn code(self) -> u8 {
        match self {
            Self::Malformed => 1,
            Self::Unsigned => 2,
            Self::WrongKey { .. } => 3,
            Self::Invalid => 4,
        }
    }
}

impl fmt::Display for SignatureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed => f.write_str("the blob is damaged"),
            Self::Unsigned => f.write_str("the blob is not signed"),
            Self::WrongKey { id } => {
                f.write_str("the blob is signed by another key, ")?;
                id.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
            }
            Self::Invalid => f.write_str("the signature does not fit the blob and the key"),
        }
    }
}

impl core::error::Error for SignatureError {}

/// Verifies that the holder of `public_key` has signed the blob `bytes` and returns its revision. Does not check the
/// contents of the blob.
///
/// # Errors
/// [`SignatureError`], in the order of its variants.
// Not inlined: nothing else must share its large stack frame.
#[inline(never)]
pub fn verify(bytes: &[u8], public_key: &[u8; 32]) -> Result<u32, SignatureError> {
    let envelope = envelope::open(bytes).map_err(|_| SignatureError::Malformed)?;
    let trailer = envelope.trailer.ok_or(SignatureError::Unsigned)?;
    if trailer.key_id != envelope::key_id(public_key) {
        return Err(SignatureError::WrongKey { id: trailer.key_id });
    }
    verify_message(envelope.signed, &trailer.signature, public_key)?;
    Ok(trailer.revision)
}

/// The function that begins a verification.
type Begin = fn(&PublicKey, &Signature) -> Result<VerifyingState, Error>;

/// Verifies that `signature` is one of `message` by the holder of `public_key`.
///
/// # Errors
/// [`SignatureError::Invalid`].
pub fn verify_message<'m>(
    message: &'m [u8],
    signature: &[u8; SIGNATURE_LENGTH],
    public_key: &[u8; 32],
) -> Result<(), SignatureError> {
    // Called through pointers that are opaque to the optimiser: inlined here, the curve would be compiled for speed instead
    // of size, and its own checks, which cannot fail, would become panics in a function of the runtime.
    let begin = black_box::<Begin>(PublicKey::verify_incremental);
    let absorb = black_box::<fn(&mut VerifyingState, &'m [u8])>(VerifyingState::absorb);
    let end = black_box::<fn(&VerifyingState) -> Result<(), Error>>(VerifyingState::verify);
    let key = PublicKey::new(*public_key);
    let mut state =
        begin(&key, &Signature::new(*signature)).map_err(|_| SignatureError::Invalid)?;
    absorb(&mut state, message);
    end(&state).map_err(|_| SignatureError::Invalid)
}

/// Returns whether `public_key` can verify anything: a canonical point that is not of small order. Check this before a
/// key is provisioned for good.
pub fn is_public_key(public_key: &[u8; 32]) -> bool {
    PublicKey::new(*public_key).validate().is_ok()
}
