//! Random sequences of requests, compared with a simple model of the device.

use poegp_protocol::link::{Key, Query, Refusal, Request, Response};
use poegp_runtime::guard::status::Status;
use proptest::prelude::*;

use super::desk::Desk;
use super::known::{Known, assert_as_it_came, begin, key, piece, public, query, refused, signed};
use crate::seeded::config;

/// Pieces of each blob in these tests.
const PIECES: usize = 6;
/// The index of the blob that no device accepts, after the three that it does.
const BROKEN: usize = 3;
/// The only one that is signed.
const SIGNED: usize = 2;
/// What a device with a key answers to the unsigned ones.
const UNSIGNED: Refusal = Refusal::Signature { code: 2 };

/// A request or another event.
#[derive(Clone, Debug)]
enum Step {
    Begin(usize),
    Piece(usize, usize),
    /// The next piece of the current upload.
    Next,
    Verify,
    Commit,
    Activate(usize),
    RollBack(usize),
    /// A roll back from the active model, if there is one.
    RollBackHere,
    Bypass(bool),
    Provision,
    Ask(usize),
    Identify,
    Restart,
    /// A whole upload.
    Upload(usize),
}

fn steps() -> impl Strategy<Value = Vec<(Step, bool)>> {
    let step = prop_oneof![
        2 => (0..=BROKEN).prop_map(Step::Begin),
        2 => (0..PIECES, 1_usize..3).prop_map(|(at, count)| Step::Piece(at, count)),
        8 => Just(Step::Next),
        3 => Just(Step::Verify),
        4 => Just(Step::Commit),
        4 => (0..3_usize).prop_map(Step::Activate),
        1 => (0..3_usize).prop_map(Step::RollBack),
        2 => Just(Step::RollBackHere),
        2 => any::<bool>().prop_map(Step::Bypass),
        1 => Just(Step::Provision),
        4 => (0..5_usize).prop_map(Step::Ask),
        1 => Just(Step::Identify),
        1 => Just(Step::Restart),
        4 => (0..=BROKEN).prop_map(Step::Upload),
    ];
    // Each step, with whether its request is sent twice.
    prop::collection::vec((step, any::<bool>()), 1..60)
}

/// The expected state. Blobs are named by their index, slots by 0 and 1.
#[derive(Clone, Debug, Default)]
struct Expected {
    begun: Option<usize>,
    received: usize,
    verified: Option<usize>,
    committed: bool,
    active: Option<usize>,
    /// The model in memory beside the active one.
    spare: Option<usize>,
    slots: [Option<usize>; 2],
    first: usize,
    bypass: bool,
    /// Whether a key is provisioned.
    key: bool,
    activations: u32,
    refused: u32,
    cycles: u32,
}

impl Expected {
    /// Returns the slot that holds a blob.
    fn slot_of(&self, blob: Option<usize>) -> Option<usize> {
        self.slots
            .iter()
            .position(|held| blob.is_some() && *held == blob)
    }

    /// Writes a new blob into the slot that holds neither the active model nor, if possible, the newest.
    fn write(&mut self, blob: usize) {
        let there = self.slot_of(Some(blob));
        let other_than = |slot: usize| self.slots[slot].map(|_| 1 - slot);
        self.first = there.unwrap_or_else(|| {
            self.slot_of(self.active)
                .and_then(other_than)
                .or(other_than(self.first))
                .or(other_than(1 - self.first))
                .unwrap_or(0)
        });
        self.slots[self.first] = Some(blob);
    }

    fn end_upload(&mut self) {
        (self.begun, self.received) = (None, 0);
        (self.verified, self.committed) = (None, false);
    }

    fn takes(&self, blob: usize) -> bool {
        !self.key || blob == SIGNED
    }

    fn run(&mut self, blob: usize) {
        self.spare = self.active.replace(blob);
        self.activations += 1;
    }

    fn roll_back(&mut self, from: Option<usize>) -> Result<(), Refusal> {
        if from.is_none() || self.active != from {
            return Ok(());
        }
        let active_slot = self.slot_of(self.active);
        let stored = [self.first, 1 - self.first].into_iter();
        let other = stored
            .filter(|slot| Some(*slot) != active_slot)
            .find_map(|slot| Some((slot, self.slots[slot]?)));
        let (slot, blob) = other.ok_or(Refusal::NoOtherModel)?;
        self.end_upload();
        if !self.takes(blob) {
            return Err(UNSIGNED);
        }
        self.first = slot;
        self.run(blob);
        Ok(())
    }

    fn restart(&mut self) {
        let stored = [self.slots[self.first], self.slots[1 - self.first]];
        let mut stored = stored.into_iter().flatten();
        *self = Self {
            active: stored.find(|blob| self.takes(*blob)),
            key: self.key,
            slots: self.slots,
            first: self.first,
            bypass: self.bypass,
            ..Self::default()
        };
        self.activations = u32::from(self.active.is_some());
    }
}

/// The blobs, the device, and its expected state.
struct Proof {
    known: [Known; 3],
    blobs: [Vec<u8>; 4],
    desk: Desk,
    expected: Expected,
}

impl Proof {
    fn new() -> Self {
        let [first, second, third] = Known::three();
        let known = [first, second, signed(&third, &key(1))];
        let mut broken = known[1].bytes.clone();
        broken[100] ^= 8;
        let bytes = |index: usize| known[index].bytes.clone();
        Self {
            blobs: [bytes(0), bytes(1), bytes(2), broken],
            known,
            desk: Desk::default(),
            expected: Expected::default(),
        }
    }

    /// Sends a request as the owner, who signs what must be signed.
    fn asked_by_the_owner(&mut self, request: &Request<'_>) -> Response {
        match self.expected.key && request.needs_signature() {
            true => self.desk.ask_signed(request, &key(1)),
            false => self.desk.ask(request),
        }
    }

    fn refuse(&mut self, refusal: Refusal) -> Response {
        self.expected.refused += 1;
        refused(refusal)
    }

    /// Checks that the device's identity is the expected one.
    fn check_identity(&self, response: &Response) {
        let Response::Identity(identity) = response else {
            panic!("{response:?}")
        };
        let expected = &self.expected;
        let active = identity.model.as_ref().map(|model| model.blob_crc);
        assert_eq!(
            active,
            expected.active.map(|blob| self.known[blob].blob_crc)
        );
        assert_eq!(identity.bypass, expected.bypass);
        assert_eq!(identity.key != Key::None, expected.key);
        for (place, (found, held)) in identity.slots.iter().zip(expected.slots).enumerate() {
            assert_eq!(
                found.map(|stored| stored.length as usize),
                held.map(|blob| self.blobs[blob].len())
            );
            if let Some(found) = found {
                assert_eq!(usize::from(found.slot), place);
                assert_eq!(found.first, place == expected.first);
            }
        }
    }

    fn piece(&mut self, from: usize, to: usize) {
        let bytes = self.blobs[self.expected.begun.unwrap_or(0)].clone();
        let answer = self.desk.ask(&piece(&bytes, from, to));
        let received = self.expected.received;
        let expected = if self.expected.begun.is_none() {
            self.refuse(Refusal::NoUpload)
        } else if to <= received || from == received {
            self.expected.received = received.max(to);
            let received = self.expected.received as u32;
            Response::Uploading { received }
        } else {
            let (found, expected) = (from as u32, received as u32);
            self.refuse(Refusal::UnexpectedOffset { found, expected })
        };
        assert_eq!(answer, expected);
    }

    fn verify(&mut self) {
        let answer = self.desk.ask(&Request::VerifyUpload);
        let Some(begun) = self.expected.begun else {
            assert_eq!(answer, self.refuse(Refusal::NoUpload));
            return;
        };
        let (received, length) = (
            self.expected.received as u32,
            self.blobs[begun].len() as u32,
        );
        if received != length {
            assert_eq!(
                answer,
                self.refuse(Refusal::Incomplete { received, length })
            );
        } else if begun == BROKEN {
            self.expected.refused += 1;
            assert!(matches!(answer, Response::Refused(Refusal::Blob(_))));
        } else if !self.expected.takes(begun) {
            assert_eq!(answer, self.refuse(UNSIGNED));
        } else {
            let Response::Verified(model) = answer else {
                panic!("{answer:?}")
            };
            assert_eq!(model.blob_crc, self.known[begun].blob_crc);
            assert_eq!(usize::from(model.joints), self.known[begun].joints);
            if self.expected.verified.is_none() {
                self.expected.verified = Some(begun);
                self.expected.spare = Some(begun);
            }
        }
    }

    fn commit(&mut self) {
        let answer = self.desk.ask(&Request::CommitUpload);
        let Some(verified) = self.expected.verified else {
            assert_eq!(answer, self.refuse(Refusal::NotVerified));
            return;
        };
        if !self.expected.committed {
            self.expected.write(verified);
            self.expected.committed = true;
        }
        let Response::Committed(stored) = answer else {
            panic!("{answer:?}")
        };
        assert_eq!(usize::from(stored.slot), self.expected.first);
        assert_eq!(stored.length as usize, self.blobs[verified].len());
    }

    fn activate(&mut self, blob: usize) {
        let answer = self.desk.ask(&self.known[blob].activate());
        if self.expected.active == Some(blob) {
            self.check_identity(&answer);
        } else if self.expected.spare == Some(blob) && !self.expected.takes(blob) {
            // The model was active before there was a key.
            self.expected.spare = None;
            assert_eq!(answer, self.refuse(UNSIGNED));
        } else if self.expected.spare == Some(blob) {
            self.expected.run(blob);
            self.check_identity(&answer);
        } else {
            let blob_crc = self.known[blob].blob_crc;
            assert_eq!(answer, self.refuse(Refusal::UnknownModel { blob_crc }));
        }
    }

    fn roll_back(&mut self, from: Option<usize>) {
        let from_crc = from.map_or(0, |blob| self.known[blob].blob_crc);
        let answer = self.asked_by_the_owner(&Request::RollBack { from_crc });
        match self.expected.roll_back(from) {
            Ok(()) => self.check_identity(&answer),
            Err(refusal) => assert_eq!(answer, self.refuse(refusal)),
        }
    }

    /// Sends one cyclic request of each kind.
    fn ask(&mut self, query: &Query) {
        let active = self.expected.active.map(|blob| &self.known[blob]);
        let evaluations = [
            self.desk.ask(&Request::Evaluate(query.clone())),
            self.desk.ask(&Request::Trace(query.clone())),
        ];
        for answer in evaluations {
            let evaluation = match answer {
                Response::Evaluation(evaluation) => evaluation,
                Response::Trace(trace) => trace.evaluation,
                other => panic!("{other:?}"),
            };
            match active {
                Some(known) => known.assert_evaluated(query, &evaluation),
                None => assert_eq!(evaluation.status, Status::NO_MODEL.bits()),
            }
        }
        let Response::Corrected(answer) = self.desk.ask(&Request::Correct(query.clone())) else {
            panic!()
        };
        match active {
            _ if self.expected.bypass => assert_as_it_came(query, &answer, Status::BYPASSED),
            Some(known) => known.assert_corrected(query, &answer),
            None => assert_as_it_came(query, &answer, Status::NO_MODEL),
        }
        assert_eq!(answer.blob_crc, active.map_or(0, |known| known.blob_crc));
        self.expected.cycles += 3;
    }

    fn carry_out(mut self, step: &Step) -> Self {
        let unit = |proof: &Self| {
            let blob = proof.expected.begun.unwrap_or(0);
            (
                proof.blobs[blob].len(),
                proof.blobs[blob].len().div_ceil(PIECES),
            )
        };
        match step {
            Step::Begin(which) => {
                let answer = self.desk.ask(&begin(&self.blobs[*which]));
                assert_eq!(answer, Response::Uploading { received: 0 });
                self.expected.end_upload();
                self.expected.begun = Some(*which);
            }
            Step::Piece(at, count) => {
                let (length, unit) = unit(&self);
                // Some pieces are longer than a frame allows.
                let (from, to) = (at * unit, length.min((at + count) * unit));
                self.piece(from, to.min(from + 256));
            }
            Step::Next => {
                let (length, unit) = unit(&self);
                let from = self.expected.received;
                self.piece(from, length.min(from + unit.min(256)));
            }
            Step::Verify => self.verify(),
            Step::Commit => self.commit(),
            Step::Activate(blob) => self.activate(*blob),
            Step::RollBack(from) => self.roll_back(Some(*from)),
            Step::RollBackHere => self.roll_back(self.expected.active),
            Step::Bypass(on) => {
                let answer = self.asked_by_the_owner(&Request::SetBypass { on: *on });
                self.expected.bypass = *on;
                self.check_identity(&answer);
            }
            Step::Provision => {
                let public_key = public(&key(1));
                let answer = self.desk.ask(&Request::Provision { public_key });
                if !self.expected.key {
                    // What was verified before the key does not count any more.
                    self.expected.key = true;
                    self.expected.spare = None;
                    (self.expected.verified, self.expected.committed) = (None, false);
                }
                self.check_identity(&answer);
            }
            Step::Ask(which) => {
                let queries = [
                    query(&[0.1, -0.3], 2.0),
                    query(&[1.9, 0.7], 9.5),
                    query(&[0.2, 0.3, 0.4], 0.0),
                    query(&[-5.0, 0.3, 2.5], 11.0),
                    query(&[], 1.0),
                ];
                self.ask(&queries[*which]);
            }
            Step::Identify => {
                let answer = self.desk.ask(&Request::Identify);
                self.check_identity(&answer);
            }
            Step::Restart => {
                let answer = self.asked_by_the_owner(&Request::Restart);
                assert_eq!(answer, Response::Restarting);
                self.desk = self.desk.restarted();
                self.expected.restart();
            }
            Step::Upload(which) => {
                let mut steps = vec![Step::Begin(*which)];
                // The last piece may be short, so one step more than needed may find no piece.
                steps.extend(vec![Step::Next; PIECES + 1]);
                steps.push(Step::Verify);
                for step in &steps {
                    self = self.carry_out(step);
                }
            }
        }
        self
    }
}

proptest! {
    #![proptest_config(config(51, 400))]

    #[test]
    fn any_sequence_of_requests(steps in steps()) {
        let mut proof = Proof::new();
        for (step, twice) in steps {
            proof = proof.carry_out(&step);
            if twice {
                proof = proof.carry_out(&step);
            }
        }
        let counted = proof.desk.statistics();
        prop_assert_eq!(counted.refused, proof.expected.refused);
        prop_assert_eq!(counted.cycles, proof.expected.cycles);
        prop_assert_eq!(counted.activations, proof.expected.activations);
        prop_assert_eq!(counted.bad_frames, 0);
        // After any sequence, a restart finds what is stored.
        proof = proof.carry_out(&Step::Restart);
        proof.carry_out(&Step::Identify).carry_out(&Step::Ask(0));
    }
}
