//! Self-test: whether this processor, with the code compiled for it, computes the same bits as all others.

use poegp_protocol::blob::CRC;

use crate::service::loaded_model::ModelSlot;

/// A small elastic model of three joints.
const BLOB: &[u8] = include_bytes!("self_test.blob");
/// Joints in rad and payload in kg of each question: inside the trained ranges, outside, and far outside.
const QUESTIONS: [([f32; 3], f32); 3] = [
    ([0.3, -0.7, 0.4], 1.5),
    ([-2.9, 1.6, -1.2], 0.0),
    ([40.0, -30.0, 20.0], 60.0),
];
/// CRC-32C of the bits of all answers.
const ANSWERS: u32 = 0xd5b6_641b;

/// Loads a model into `slot`, which is empty afterwards, and compares the bits of its answers with those of a workstation. A
/// device that fails must not correct anything; see [`BoardInfo::self_test`](crate::service::BoardInfo::self_test).
// Not inlined: the background must not share its stack frame.
#[inline(never)]
pub fn self_test<const WORDS: usize>(slot: &mut ModelSlot<WORDS>) -> bool {
    let loaded = slot.load_unverified(BLOB).is_ok();
    let mut digest = CRC.digest();
    for (joints, payload_kg) in &QUESTIONS {
        let model = slot.model();
        let evaluation = model.evaluate(joints, *payload_kg);
        let corrected = model.correct(joints, *payload_kg);
        let numbers = (evaluation.pose.to_rows().into_iter())
            .chain(evaluation.correction.to_array())
            .chain(corrected.joints)
            .chain([evaluation.trust, corrected.position_error]);
        for number in numbers {
            digest.update(&number.to_bits().to_le_bytes());
        }
        digest.update(&[evaluation.status.bits(), corrected.status.bits()]);
    }
    slot.unload();
    loaded && digest.finalize() == ANSWERS
}
