//! Texts for the codes in a device's answers.

use poegp_protocol::link::Refusal;
use poegp_runtime::filter::FilterError;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::signature::SignatureError;
use poegp_runtime::store::StoreError;

/// Describes why the device refused a request.
pub fn refusal(refusal: &Refusal) -> String {
    match refusal {
        Refusal::BadFrame => "the frame was damaged in transit".to_owned(),
        Refusal::ProtocolVersion { found, expected } => {
            format!("it speaks link protocol version {expected}, this trainer version {found}")
        }
        Refusal::UnknownMessage => {
            "it does not support this message: firmware and trainer are of different versions".to_owned()
        }
        Refusal::Busy => "it is busy with another service; ask again".to_owned(),
        Refusal::BlobTooLong { length, capacity } => format!(
            "the model has {length} bytes, there is room for {capacity}; calibrate with fewer --inducing-points"
        ),
        Refusal::NoUpload => {
            "it has no upload in progress: a restart or a roll-back has ended it".to_owned()
        }
        Refusal::UnexpectedOffset { found, expected } => format!(
            "it received byte {found} of the model where it expected byte {expected}: is another workstation uploading?"
        ),
        Refusal::ChunkTooLong { end, length } => {
            format!("it received {end} bytes of a model of {length}: is another workstation uploading?")
        }
        Refusal::Incomplete { received, length } => {
            format!("it has received only {received} of {length} bytes of the model")
        }
        Refusal::TransferCrc { stored, computed } => {
            format!("the model was damaged in transit (CRC {computed:08x}, announced {stored:08x})")
        }
        Refusal::Blob(error) => error.to_string(),
        Refusal::Model { code } => model(*code),
        Refusal::Signature { code } => signature(*code),
        Refusal::NotVerified => "no uploaded model was verified".to_owned(),
        Refusal::UnknownModel { blob_crc } => {
            format!("it has no verified model {blob_crc:08x}: upload it first")
        }
        Refusal::NoOtherModel => "there is no other stored model to roll back to".to_owned(),
        Refusal::Store { code } => store(*code),
        Refusal::KeyIsFixed => {
            "another public key is provisioned, and that cannot be undone".to_owned()
        }
        Refusal::NotAKey => "these bytes are not an Ed25519 public key".to_owned(),
        Refusal::CyclesRunning => {
            "the request would disturb its cycles; stop the controller, run `trainer device stop`, and try again"
                .to_owned()
        }
        Refusal::TooSlow {
            instructions,
            allowed,
        } => format!(
            "a command with the model may take {instructions} instructions, and {allowed} are allowed in a cycle; calibrate \
             with --max-instructions {allowed}, or allow more if the controller's cycle leaves time for them (`trainer device \
             cycle --max-instructions`)"
        ),
        Refusal::OldRevision { revision, lowest } => format!(
            "the model is signed as revision {revision}, and the device accepts none below {lowest}; sign it again if \
             it is to replace the newer one"
        ),
        Refusal::AnotherRobot => "the model is of another robot than the active one, by name or serial number; upload it with \
                                  --replace-robot if the device has moved to that robot"
            .to_owned(),
        Refusal::NotSigned => {
            "it has a public key, and this request needs a signature by the secret key (--key)".to_owned()
        }
        Refusal::WrongSignature => {
            "the signature of the request is wrong: the key of --key does not belong to the device's public key".to_owned()
        }
        Refusal::CycleSetting { code } => cycle_setting(*code),
        Refusal::SelfTest => {
            "it failed its self-test: its processor or image computes wrong results, and it corrects nothing; flash the \
             firmware again, or replace the board"
                .to_owned()
        }
        Refusal::SlowClock { hz, needed } => format!(
            "its processor runs at {:.0} MHz instead of {:.0} MHz, too slow for its deadline, and it corrects \
            nothing; look at its crystal and supply, and restart it",
            f64::from(*hz) / 1e6,
            f64::from(*needed) / 1e6
        ),
        Refusal::TooManyWrites { allowed } => format!(
            "models were stored or rolled back {allowed} times since it started, and each time wears its flash; `trainer device \
             restart` if that was on purpose"
        ),
    }
}

/// Describes a setting of the cycle that the device refused.
fn cycle_setting(code: u8) -> String {
    let out_of_range = [
        FilterError::Period,
        FilterError::Rate,
        FilterError::Acceleration,
        FilterError::Blend,
    ];
    if code == FilterError::Engaged.code() {
        return "a correction is applied, and other limits would break those in force; switch the bypass on and keep \
        sending commands until the weight is 0, or restart the device, and try again"
            .to_owned();
    }
    match out_of_range.iter().find(|error| error.code() == code) {
        Some(error) => error.to_string(),
        None => format!("setting {code} of the cycle, which this trainer does not know"),
    }
}

/// Describes why the device cannot run a model. The link transmits the kind of a [`LoadError`], but not its numbers.
fn model(code: u8) -> String {
    let plain = [
        LoadError::Chain,
        LoadError::Coupling,
        LoadError::JointLimits,
        LoadError::Ranges,
        LoadError::Kernel,
        LoadError::CorrectionLimit,
        LoadError::Gravity,
        LoadError::Ripple,
        LoadError::Groups,
        LoadError::Row,
        LoadError::Variance,
        LoadError::Curve,
    ];
    if let Some(error) = plain.iter().find(|error| error.code() == code) {
        return format!("unusable model: {error}");
    }
    let numbered = [
        (
            LoadError::Frame { index: 0 },
            "a frame of the chain is not a rigid transform",
        ),
        (
            LoadError::Inputs {
                found: 0,
                expected: 0,
            },
            "the number of inputs of the correction does not match joints and payload",
        ),
        (
            LoadError::PartialRow { bytes: 0 },
            "the inducing points are not whole rows",
        ),
        (
            LoadError::InducingPointsTooLarge {
                needed: 0,
                capacity: 0,
            },
            "it has more inducing points than fit; calibrate with fewer (--inducing-points)",
        ),
    ];
    match numbered.iter().find(|(error, _)| error.code() == code) {
        Some((_, text)) => format!("unusable model: {text}"),
        None => format!("unusable model (code {code}, unknown to this version of trainer)"),
    }
}

/// Describes why no key that the device trusts has signed a model. The link does not transmit the key ids in a
/// [`SignatureError`].
fn signature(code: u8) -> String {
    let known = [
        (SignatureError::Malformed, "the model is damaged"),
        (
            SignatureError::Unsigned,
            "the model is not signed, and this device accepts only signed ones; `trainer sign` signs it",
        ),
        (
            SignatureError::WrongKey {
                id: Default::default(),
            },
            "the model is signed by another key than the provisioned one",
        ),
        (
            SignatureError::Invalid,
            "the signature does not fit the model and the provisioned key",
        ),
    ];
    match known.iter().find(|(error, _)| error.code() == code) {
        Some((_, text)) => (*text).to_owned(),
        None => format!("signature error {code}, which this trainer does not know"),
    }
}

/// Describes an error of the flash.
fn store(code: u8) -> String {
    let known = [
        (
            StoreError::NotAligned { at: 0, unit: 0 },
            "the layout of its flash is wrong",
        ),
        (
            StoreError::OutOfBounds {
                end: 0,
                capacity: 0,
            },
            "the layout of its flash is wrong",
        ),
        (
            StoreError::Overlap { at: 0 },
            "the layout of its flash is wrong",
        ),
        (
            StoreError::RangeTooSmall {
                length: 0,
                needed: 0,
            },
            "the layout of its flash is wrong",
        ),
        (
            StoreError::Unit { size: 0 },
            "the layout of its flash is wrong",
        ),
        (
            StoreError::BlobLength {
                length: 0,
                capacity: 0,
            },
            "the model does not fit into a slot of the flash",
        ),
        (
            StoreError::BufferTooSmall { length: 0, room: 0 },
            "the stored model does not fit into memory",
        ),
        (
            StoreError::NotStored {
                slot: poegp_runtime::store::Slot::A,
            },
            "the slot no longer holds that model",
        ),
        (
            StoreError::CrcMismatch {
                stored: 0,
                computed: 0,
            },
            "the stored model is damaged",
        ),
        (
            StoreError::ReadBack { at: 0 },
            "the flash does not hold what was written: it may be worn out",
        ),
        (
            StoreError::Flash {
                kind: embedded_storage::nor_flash::NorFlashErrorKind::Other,
            },
            "the driver of the flash failed",
        ),
        (
            StoreError::SequenceExhausted,
            "the flash was written more often than can be counted",
        ),
        (
            StoreError::KeyProvisioned,
            "another public key is provisioned",
        ),
        (
            StoreError::KeyUnfinished,
            "provisioning the public key was interrupted: repeat it; until then no model is accepted",
        ),
        (
            StoreError::KeyDamaged,
            "the page of the public key is damaged: no model is accepted",
        ),
        (
            StoreError::KeyPageFull,
            "the page of the public key has no room left",
        ),
        (
            StoreError::SettingsFull,
            "the settings of the cycle were changed so often that their page has no room left; those in force stay",
        ),
    ];
    match known.iter().find(|(error, _)| error.code() == code) {
        Some((_, text)) => format!("{text} (store error {code})"),
        None => format!("store error {code}, which this trainer does not know"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_has_words() {
        for code in 1..=14 {
            assert!(!model(code).contains("does not know"), "{code}");
        }
        for code in 1..=4 {
            assert!(!signature(code).contains("does not know"), "{code}");
        }
        for code in 1..=17 {
            assert!(!store(code).contains("does not know"), "{code}");
        }
        for code in 1..=5 {
            assert!(!cycle_setting(code).contains("does not know"), "{code}");
        }
        assert!(cycle_setting(9).contains('9'));
        assert!(model(200).contains("200") && store(200).contains("200"));
    }
}
