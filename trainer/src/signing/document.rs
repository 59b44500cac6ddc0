//! Signatures of documents (reports and JSON), each in a file beside the document.
//!
//! ```text
//! poegp signature of a document, Ed25519
//! 16 hexadecimal digits: the id of the key
//! 128 hexadecimal digits: the signature
//! ```
//!
//! The signed message begins with eight letters, so that it is never taken for a model or a request, and continues with the
//! bytes of the document.

use std::path::Path;

use ed25519_dalek::{Signature, Signer, VerifyingKey};
use poegp_calibration::input_error::InputError;

use crate::signing::{PublicKey, SecretKey, from_hex, id_text};

/// First line of a signature file.
pub const TITLE: &str = "poegp signature of a document, Ed25519";
const DOCUMENT: [u8; 8] = *b"POEGPDOC";

/// Reason why a signature does not belong to a document and a key.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DocumentError {
    /// The signature is by another key.
    #[error("it was signed by key {0}")]
    OtherKey(String),
    /// The document is another one, or the signature was changed.
    #[error("the document is not the one that was signed")]
    Changed,
}

/// Returns the text of the signature file of `document`.
pub fn sign(key: &SecretKey, document: &[u8]) -> String {
    let signature = key.0.sign(&message(document)).to_bytes();
    let digits: String = signature.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{TITLE}\n{}\n{digits}\n", id_text(&key.public().id()))
}

/// Checks whether `text`, read from `path`, is the signature of `document` by `key`.
///
/// # Errors
/// [`InputError`] where it is no signature file.
pub fn verify(
    path: &Path,
    text: &str,
    document: &[u8],
    key: &PublicKey,
) -> Result<Result<(), DocumentError>, InputError> {
    let expected = "a signature file written by `trainer sign`";
    let lines: Vec<&str> = text.lines().collect();
    let [title, id, digits] = lines[..] else {
        return Err(InputError::new(path, "another kind of file", expected));
    };
    let mut signature = [0; 64];
    if title != TITLE || from_hex(digits, &mut signature).is_none() {
        return Err(InputError::new(path, "another kind of file", expected));
    }
    if id != id_text(&key.id()) {
        return Ok(Err(DocumentError::OtherKey(id.to_owned())));
    }
    let verified = VerifyingKey::from_bytes(key.bytes())
        .and_then(|key| key.verify_strict(&message(document), &Signature::from_bytes(&signature)));
    Ok(verified.map_err(|_| DocumentError::Changed))
}

fn message(document: &[u8]) -> Vec<u8> {
    [&DOCUMENT[..], document].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signature_is_of_one_document_by_one_key() {
        let (ours, theirs) = (
            SecretKey::generate().unwrap(),
            SecretKey::generate().unwrap(),
        );
        let document = b"<!DOCTYPE html>";
        let text = sign(&ours, document);
        let path = Path::new("a.html.sig");
        let by = |text: &str, document: &[u8], key: &SecretKey| {
            verify(path, text, document, &key.public())
        };
        assert_eq!(by(&text, document, &ours), Ok(Ok(())));
        assert_eq!(
            by(&text, b"<!DOCTYPE htm1>", &ours),
            Ok(Err(DocumentError::Changed))
        );
        let other = DocumentError::OtherKey(id_text(&ours.public().id()));
        assert_eq!(by(&text, document, &theirs), Ok(Err(other)));
        // Another key's id in the text does not help.
        let renamed = text.replace(
            &id_text(&ours.public().id()),
            &id_text(&theirs.public().id()),
        );
        assert_eq!(
            by(&renamed, document, &theirs),
            Ok(Err(DocumentError::Changed))
        );
        for broken in ["", "x", &text[..text.len() - 3], &text.replace("poegp", "")] {
            assert!(by(broken, document, &ours).is_err(), "{broken}");
        }
    }
}
