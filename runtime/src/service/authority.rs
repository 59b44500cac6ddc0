//! Authorisation of requests once a key is provisioned: a nonce of the device, signed together with a request, is good for
//! that request once.
//!
//! ```text
//!  workstation                                 device
//!  Challenge                        ──>
//!                                   <──        Challenge { nonce }
//!  Signed { signature, request }    ──>        checks the signature with this nonce, carries the request out
//! ```
//!
//! The nonce is valid until the next service: anything that comes between the two frames ends it. A repetition of the very
//! same frame is the same request whose answer was lost, as long as nothing else has come in between; every request may be
//! repeated. While commands come, a repetition is not accepted: commands are no services, and a `StopCyclic` that was
//! recorded would stop those that came after it.

use poegp_protocol::blob::envelope::SIGNATURE_LENGTH;
use poegp_protocol::link::{NONCE_LENGTH, Refusal, Request, order};

use crate::model::signature::verify_message;

type Nonce = [u8; NONCE_LENGTH];

/// The valid nonce and its use.
#[derive(Debug, Default)]
pub(super) struct Authority {
    nonce: Option<Nonce>,
    /// Signature that was accepted with the nonce.
    used: Option<[u8; SIGNATURE_LENGTH]>,
}

impl Authority {
    /// Returns the valid unused nonce or, without one, `fresh`: a challenge may be repeated.
    pub(super) fn challenge(&mut self, fresh: impl FnOnce() -> Nonce) -> Nonce {
        if self.used.take().is_some() {
            self.nonce = None;
        }
        *self.nonce.get_or_insert_with(fresh)
    }

    /// Invalidates the nonce.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Verifies a signed request and returns the request inside. `commanded` says whether commands come.
    ///
    /// # Errors
    /// [`Refusal::WrongSignature`], [`Refusal::UnknownMessage`]. After the first, no nonce is valid.
    pub(super) fn open<'r>(
        &mut self,
        signature: &[u8],
        request: &'r [u8],
        key: &[u8; 32],
        commanded: bool,
    ) -> Result<Request<'r>, Refusal> {
        if (self.used).is_some_and(|used| commanded || used != signature) {
            self.forget();
        }
        let message = self.nonce.and_then(|nonce| order(&nonce, request));
        let signature = <&[u8; SIGNATURE_LENGTH]>::try_from(signature).ok();
        let signature = signature.filter(|signature| {
            message.is_some_and(|message| verify_message(&message, signature, key).is_ok())
        });
        let Some(signature) = signature else {
            self.forget();
            return Err(Refusal::WrongSignature);
        };
        self.used = Some(*signature);
        Request::decode(request).ok_or(Refusal::UnknownMessage)
    }
}
