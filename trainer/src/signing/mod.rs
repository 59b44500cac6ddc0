//! Keys and signatures of models: Ed25519 over a blob, which the device verifies.
//!
//! A key is a text file of two lines, so that it can be recognised and copied:
//!
//! ```text
//! poegp secret key, Ed25519: it signs models, keep it secret
//! 64 hexadecimal digits: the 32 bytes of RFC 8032
//! ```
//!
//! A public key has the title `poegp public key, Ed25519`. Nothing in this module prints or returns key material in an
//! error; secrets are wiped from memory when they go out of scope. The signature covers all of the blob before its trailer,
//! flag and checksum included (`docs/reference/blob-format.md`).

pub mod document;

use std::path::Path;

use ed25519_dalek::{Signer, SigningKey};
use poegp_protocol::blob::envelope::{self, DecodeError, KEY_ID_LENGTH, SIGNATURE_LENGTH, Trailer};
use poegp_protocol::link::{NONCE_LENGTH, order};
use poegp_runtime::model::signature;
use zeroize::Zeroizing;

use poegp_calibration::input_error::InputError;

use crate::device::client;

const SECRET_TITLE: &str = "poegp secret key, Ed25519: it signs models, keep it secret";
const PUBLIC_TITLE: &str = "poegp public key, Ed25519";

/// Secret key, which signs.
#[derive(Clone)]
pub struct SecretKey(SigningKey);

/// Public key, which verifies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublicKey([u8; 32]);

impl SecretKey {
    /// Generates a key from the randomness of the operating system.
    ///
    /// # Errors
    /// What the operating system says when it has none.
    pub fn generate() -> Result<Self, getrandom::Error> {
        let mut seed = Zeroizing::new([0; 32]);
        getrandom::fill(&mut *seed)?;
        Ok(Self(SigningKey::from_bytes(&seed)))
    }

    /// Reads a key file.
    ///
    /// # Errors
    /// [`InputError`] names the file and what is wrong with it, never what is in it.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let expected = "a secret key written by `trainer keys new`";
        let bytes = read_key(path, SECRET_TITLE, PUBLIC_TITLE, "a public key", expected)?;
        Ok(Self(SigningKey::from_bytes(&bytes)))
    }

    /// Returns the text of the key file.
    pub fn to_text(&self) -> Zeroizing<String> {
        let seed = Zeroizing::new(self.0.to_bytes());
        key_text(SECRET_TITLE, &seed)
    }

    /// Returns the public key that belongs to this key.
    pub fn public(&self) -> PublicKey {
        PublicKey(self.0.verifying_key().to_bytes())
    }

    /// Returns `blob` signed by this key with this revision; replaces a signature that it has.
    ///
    /// # Errors
    /// [`DecodeError`] when `blob` is none.
    pub fn sign(&self, blob: &[u8], revision: u32) -> Result<Vec<u8>, DecodeError> {
        let mut bytes = envelope::open(blob)?.before_trailer.to_vec();
        envelope::set_signed(&mut bytes, true);
        let mut trailer = Trailer {
            key_id: self.public().id(),
            revision,
            signature: [0; SIGNATURE_LENGTH],
        };
        let message = [&bytes[..], &trailer.signed_part()].concat();
        trailer.signature = self.0.sign(&message).to_bytes();
        bytes.extend(trailer.to_bytes());
        Ok(bytes)
    }

    /// Returns the signer of requests for a client of a device.
    pub fn signer(&self) -> client::Signer {
        let key = self.clone();
        Box::new(move |nonce, request| key.sign_request(nonce, request))
    }

    /// Returns the signature of a request with the device's nonce; `None` when the request is too long to be signed.
    pub fn sign_request(
        &self,
        nonce: &[u8; NONCE_LENGTH],
        request: &[u8],
    ) -> Option<[u8; SIGNATURE_LENGTH]> {
        Some(self.0.sign(&order(nonce, request)?).to_bytes())
    }
}

impl PublicKey {
    /// Reads a key file.
    ///
    /// # Errors
    /// [`InputError`] names the file and what is wrong with it.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let expected = "a public key written by `trainer keys new`";
        let key = read_key(path, PUBLIC_TITLE, SECRET_TITLE, "a secret key", expected)?;
        if !signature::is_public_key(&key) {
            let found = "32 bytes that are not a point of the curve";
            return Err(InputError::new(path, found, expected));
        }
        Ok(Self(*key))
    }

    /// Returns the text of the key file.
    pub fn to_text(&self) -> String {
        key_text(PUBLIC_TITLE, &self.0).to_string()
    }

    /// Returns the bytes of the key, as a device expects them.
    pub fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Returns the key id, which names this key in the trailer of a blob.
    pub fn id(&self) -> [u8; KEY_ID_LENGTH] {
        envelope::key_id(&self.0)
    }
}

/// Formats a key id as sixteen hexadecimal digits, for people.
pub fn id_text(id: &[u8; KEY_ID_LENGTH]) -> String {
    id.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn key_text(title: &str, key: &[u8; 32]) -> Zeroizing<String> {
    // Allocate all the room at once: a string that grows would leave copies behind.
    let mut text = Zeroizing::new(String::with_capacity(title.len() + 2 + 64));
    text.push_str(title);
    text.push('\n');
    for byte in key {
        for digit in [byte >> 4, byte & 15] {
            text.push(char::from(b"0123456789abcdef"[usize::from(digit)]));
        }
    }
    text.push('\n');
    text
}

fn read_key(
    path: &Path,
    title: &str,
    other_title: &str,
    other: &str,
    expected: &str,
) -> Result<Zeroizing<[u8; 32]>, InputError> {
    let unreadable = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::InvalidData => {
            InputError::new(path, "a file that is not text", expected)
        }
        _ => InputError::unreadable(path, &e, expected),
    };
    let text = Zeroizing::new(std::fs::read_to_string(path).map_err(unreadable)?);
    let mut lines = text.lines();
    match lines.next() {
        Some(line) if line == title => {}
        Some(line) if line == other_title => return Err(InputError::new(path, other, expected)),
        _ => return Err(InputError::new(path, "another kind of file", expected)),
    }
    let mut key = Zeroizing::new([0; 32]);
    from_hex(lines.next().unwrap_or(""), &mut key)
        .filter(|()| lines.next().is_none())
        .map(|()| key)
        .ok_or_else(|| {
            InputError::new(path, "something else", "64 hexadecimal digits and no more").at_line(2)
        })
}

/// Returns a blob without its signature.
pub fn unsigned(blob: &[u8]) -> Vec<u8> {
    let opened = envelope::open(blob);
    let mut out = opened.map_or(Vec::new(), |opened| opened.before_trailer.to_vec());
    envelope::set_signed(&mut out, false);
    out
}

/// Reads as many bytes as `out` has from hexadecimal digits; `None` for other digits or another number of them.
fn from_hex<const N: usize>(digits: &str, out: &mut [u8; N]) -> Option<()> {
    let (pairs, rest) = digits.as_bytes().as_chunks::<2>();
    if pairs.len() != N || !rest.is_empty() {
        return None;
    }
    for (byte, [high, low]) in out.iter_mut().zip(pairs) {
        let digit = |letter: &u8| char::from(*letter).to_digit(16);
        *byte = (digit(high)? << 4 | digit(low)?) as u8;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_what_its_file_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        let key = SecretKey::generate().unwrap();
        std::fs::write(&path, key.to_text().as_bytes()).unwrap();
        let again = SecretKey::read(&path).unwrap();
        assert_eq!(again.public(), key.public());
        let text = key.to_text();
        assert_eq!(text.capacity(), text.len(), "no copy was left behind");
        std::fs::write(&path, key.public().to_text()).unwrap();
        assert_eq!(PublicKey::read(&path).unwrap(), key.public());
        let other = SecretKey::generate().unwrap();
        assert_ne!(other.public(), key.public());
    }

    #[test]
    fn what_is_no_key_file_is_refused_without_its_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        let digits = "5e".repeat(32);
        let secret = format!("{SECRET_TITLE}\n");
        let cases = [
            (format!("{PUBLIC_TITLE}\n{digits}\n"), "found a public key"),
            (digits.clone(), "another kind of file"),
            (String::new(), "another kind of file"),
            (secret.clone(), "a.key:2: found something else"),
            (format!("{secret}{}", &digits[1..]), "64 hexadecimal"),
            (format!("{secret}{digits}00\n"), "64 hexadecimal"),
            (format!("{secret}{digits}\nmore\n"), "64 hexadecimal"),
            (format!("{secret}{}xx\n", &digits[2..]), "64 hexadecimal"),
            (format!("{secret}{}é\n", &digits[2..]), "64 hexadecimal"),
        ];
        for (text, part) in cases {
            std::fs::write(&path, &text).unwrap();
            let error = SecretKey::read(&path).err().unwrap().to_string();
            assert!(error.contains(part), "{error}");
            assert!(!error.contains("5e5e"), "{error}");
        }
        std::fs::write(&path, [0xff, 0xfe]).unwrap();
        let error = SecretKey::read(&path).err().unwrap().to_string();
        assert!(error.contains("not text"), "{error}");
        std::fs::write(&path, format!("{PUBLIC_TITLE}\n{}\n", "02".repeat(32))).unwrap();
        let error = PublicKey::read(&path).unwrap_err().to_string();
        assert!(error.contains("not a point"), "{error}");
    }
}
