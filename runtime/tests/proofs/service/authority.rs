//! Authority: replayed models and requests are refused, and each message does only what it may without the secret key.

use ed25519_dalek::SigningKey;
use poegp_protocol::blob;
use poegp_protocol::link::{
    CycleSettings, MAX_SIGNED, REQUESTS, Refusal, Request, Response, order,
};

use super::desk::{Desk, signature};
use super::known::{Known, begin, key, public, query, refused, signed_as, upload};
use crate::arm::Arm;

/// Returns a device with the owner's key (seed 1) that stores two revisions of a robot's model and runs the second.
fn owned() -> (Desk, [Known; 2]) {
    let [first, second, _] = Known::three();
    let revisions = [
        signed_as(10, &first, &key(1)),
        signed_as(20, &second, &key(1)),
    ];
    let mut desk = Desk::default();
    let public_key = public(&key(1));
    desk.ask(&Request::Provision { public_key });
    for known in &revisions {
        known.install(&mut desk);
    }
    (desk, revisions)
}

fn revision(desk: &mut Desk) -> Option<u32> {
    desk.identity().model.and_then(|model| model.revision)
}

fn command(desk: &mut Desk) {
    desk.ask(&Request::Command(query(&[0.1, 0.2], 1.0)));
}

/// Returns a signed request with a nonce, as bytes that anybody can record and send again.
fn recorded(desk: &mut Desk, request: &Request<'_>, key: &SigningKey) -> ([u8; 64], Vec<u8>) {
    let nonce = desk.challenge();
    let mut buffer = [0; MAX_SIGNED];
    let bytes = request.encode(&mut buffer).expect("short").to_vec();
    (signature(&nonce, &bytes, key), bytes)
}

fn send(desk: &mut Desk, (signature, request): &([u8; 64], Vec<u8>)) -> Response {
    desk.ask(&Request::Signed { signature, request })
}

const BYPASS_OFF: Request<'_> = Request::SetBypass { on: false };
const WRONG: Response = Response::Refused(Refusal::WrongSignature);

/// A recorded upload of an old model, signed by the key, is refused when it is played back.
#[test]
fn an_old_model_does_not_come_back() {
    let (mut desk, [old, new]) = owned();
    let too_old = |lowest| {
        refused(Refusal::OldRevision {
            revision: 10,
            lowest,
        })
    };
    // The previous model is still in memory.
    assert_eq!(desk.ask(&old.activate()), too_old(20));
    assert_eq!(revision(&mut desk), Some(20));
    for restarted in [false, true] {
        if restarted {
            desk = desk.restarted();
        }
        assert_eq!(old.upload(&mut desk), too_old(20));
        assert_eq!(
            desk.ask(&Request::CommitUpload),
            refused(Refusal::NotVerified)
        );
        let unknown = Refusal::UnknownModel {
            blob_crc: old.blob_crc,
        };
        assert_eq!(desk.ask(&old.activate()), refused(unknown));
        assert_eq!(desk.ask(&old.roll_back()), refused(Refusal::NotSigned));
        assert_eq!(revision(&mut desk), Some(20));
    }
    // The same revision again and a higher one are accepted.
    new.install(&mut desk);
    let [first, ..] = Known::three();
    let newest = signed_as(30, &first, &key(1));
    newest.install(&mut desk);
    assert_eq!(
        new.upload(&mut desk),
        refused(Refusal::OldRevision {
            revision: 20,
            lowest: 30
        })
    );
    // A stored revision counts although another model runs, and a running one counts although it is not stored.
    let latest = signed_as(40, &first, &key(1));
    assert!(matches!(latest.upload(&mut desk), Response::Verified(_)));
    desk.ask(&Request::CommitUpload);
    assert_eq!(revision(&mut desk), Some(30));
    assert_eq!(old.upload(&mut desk), too_old(40));
    let other = signed_as(50, &Known::three()[1], &key(1));
    assert!(matches!(other.upload(&mut desk), Response::Verified(_)));
    desk.ask(&other.activate());
    assert_eq!(revision(&mut desk), Some(50));
    assert_eq!(old.upload(&mut desk), too_old(50));
}

/// The owner can return to an old model by rolling back or by signing it as a new revision.
#[test]
fn the_owner_steps_down() {
    let (mut desk, [old, new]) = owned();
    let answer = desk.ask_signed(&new.roll_back(), &key(1));
    assert!(matches!(answer, Response::Identity(_)), "{answer:?}");
    assert!(matches!(old.upload(&mut desk), Response::Verified(_)));
    for _ in 0..2 {
        assert_eq!(revision(&mut desk), Some(10));
        desk = desk.restarted();
    }
    assert!(matches!(old.upload(&mut desk), Response::Verified(_)));
    new.install(&mut desk);
    let [first, ..] = Known::three();
    signed_as(21, &first, &key(1)).install(&mut desk);
    assert_eq!(revision(&mut desk), Some(21));
    // The highest revision is no dead end: it is accepted again.
    for known in [&first, &Known::three()[1]] {
        signed_as(u32::MAX, known, &key(1)).install(&mut desk);
    }
}

/// Revisions from before the key do not count, because anybody may have written them.
#[test]
fn revisions_count_from_the_key_on() {
    let [first, second, _] = Known::three();
    let mut desk = Desk::default();
    signed_as(u32::MAX, &first, &key(2)).install(&mut desk);
    let public_key = public(&key(1));
    desk.ask(&Request::Provision { public_key });
    let desk = &mut desk.restarted();
    signed_as(0, &second, &key(1)).install(desk);
    assert_eq!(revision(desk), Some(0));
}

#[test]
fn a_signed_request_is_carried_out_once() {
    let (mut desk, _) = owned();
    desk.ask(&Request::SetBypass { on: true });
    assert_eq!(desk.ask(&BYPASS_OFF), refused(Refusal::NotSigned));
    assert!(desk.identity().bypass);
    let off = recorded(&mut desk, &BYPASS_OFF, &key(1));
    assert!(matches!(send(&mut desk, &off), Response::Identity(_)));
    // The sender repeats the request because the answer was lost.
    assert!(matches!(send(&mut desk, &off), Response::Identity(_)));
    assert!(!desk.identity().bypass);
    // A challenge directly after the request makes its nonce invalid.
    let again = recorded(&mut desk, &BYPASS_OFF, &key(1));
    assert!(matches!(send(&mut desk, &again), Response::Identity(_)));
    desk.challenge();
    assert_eq!(send(&mut desk, &again), WRONG);
    // Replayed at once, after another challenge, and after a restart.
    desk.ask(&Request::SetBypass { on: true });
    assert_eq!(send(&mut desk, &off), WRONG);
    let nonce = desk.challenge();
    assert_eq!(send(&mut desk, &off), WRONG);
    assert_ne!(
        desk.challenge(),
        nonce,
        "a nonce is valid for one attempt only"
    );
    let mut desk = desk.restarted();
    assert_eq!(send(&mut desk, &off), WRONG);
    desk.challenge();
    assert_eq!(send(&mut desk, &off), WRONG);
    assert!(desk.identity().bypass);
}

/// A recorded stop is not accepted again after a command, although commands are not services.
#[test]
fn a_recorded_stop_does_not_stop_later_commands() {
    let (mut desk, _) = owned();
    command(&mut desk);
    let stop = recorded(&mut desk, &Request::StopCyclic, &key(1));
    for _ in 0..2 {
        assert_eq!(send(&mut desk, &stop), Response::CyclicStopped);
    }
    for _ in 0..2 {
        command(&mut desk);
        assert_eq!(send(&mut desk, &stop), WRONG);
        assert!(desk.is_running());
    }
    let answer = desk.ask_signed(&Request::StopCyclic, &key(1));
    assert_eq!(answer, Response::CyclicStopped);
}

#[test]
fn what_is_signed_otherwise_is_not_carried_out() {
    let (mut desk, _) = owned();
    desk.ask(&Request::SetBypass { on: true });
    // Signed by another key, for another request, or with any bit changed.
    let by_another = recorded(&mut desk, &BYPASS_OFF, &key(2));
    assert_eq!(send(&mut desk, &by_another), WRONG);
    let (restart, _) = recorded(&mut desk, &Request::Restart, &key(1));
    let (_, off) = recorded(&mut desk, &BYPASS_OFF, &key(1));
    assert_eq!(send(&mut desk, &(restart, off.clone())), WRONG);
    for bit in (0..512).step_by(37) {
        let (mut changed, _) = recorded(&mut desk, &BYPASS_OFF, &key(1));
        changed[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(send(&mut desk, &(changed, off.clone())), WRONG, "bit {bit}");
    }
    // A signature of another length.
    let (signature_of, _) = recorded(&mut desk, &BYPASS_OFF, &key(1));
    for length in [0, 32, 63] {
        let signature = &signature_of[..length];
        let request = &off;
        assert_eq!(desk.ask(&Request::Signed { signature, request }), WRONG);
    }
    // With an invalid nonce: none was asked for, or another request came in between.
    let mut without = Desk::start(desk.flash.clone(), true);
    let nonce = [0; 16];
    assert_eq!(
        send(
            &mut without,
            &(signature(&nonce, &off, &key(1)), off.clone())
        ),
        WRONG
    );
    let late = recorded(&mut desk, &BYPASS_OFF, &key(1));
    desk.ask(&Request::Identify);
    assert_eq!(send(&mut desk, &late), WRONG);
    // A signed request that contains a signed, an unknown, a malformed or a cyclic request.
    let evaluate = Request::Evaluate(query(&[], 0.0));
    for bytes in [vec![18; 3], vec![99], vec![14, 0], encoded(&evaluate)] {
        let nonce = desk.challenge();
        let answer = send(
            &mut desk,
            &(signature(&nonce, &bytes, &key(1)), bytes.clone()),
        );
        assert_eq!(answer, refused(Refusal::UnknownMessage), "{bytes:?}");
    }
    assert!(desk.identity().bypass);
    // A repeated challenge returns the same nonce.
    let nonce = desk.challenge();
    assert_eq!(desk.challenge(), nonce);
    // The same request with a valid signature is carried out.
    assert!(matches!(
        desk.ask_signed(&BYPASS_OFF, &key(1)),
        Response::Identity(_)
    ));
    assert!(!desk.identity().bypass);
}

fn encoded(request: &Request<'_>) -> Vec<u8> {
    let mut buffer = [0; MAX_SIGNED];
    request.encode(&mut buffer).expect("short").to_vec()
}

/// A signature for one purpose is invalid for the other.
#[test]
fn a_request_is_no_blob() {
    let message = order(&[0; 16], &[1, 2, 3]).expect("short");
    assert_ne!(message[..8], blob::MAGIC);
    assert_eq!(order(&[0; 16], &[0; MAX_SIGNED + 1]), None);
}

/// Returns the model with another serial number.
fn of_another_robot(known: &Known) -> Known {
    let mut decoded = blob::decode(&known.bytes).expect("a blob");
    decoded.robot.serial_number = "another one";
    let mut buffer = vec![0; known.bytes.len() + 64];
    let bytes = blob::encode(&decoded, &mut buffer).expect("fits").to_vec();
    Known {
        blob_crc: blob::stored_crc(&bytes).expect("a header"),
        bytes,
        ..Known::new(Arm::sound(2, 5))
    }
}

#[test]
fn another_robots_model_is_an_order_of_its_own() {
    let ours = Known::new(Arm::sound(2, 5));
    let theirs = of_another_robot(&ours);
    let replace = |known: &Known| Request::BeginUpload {
        length: known.bytes.len() as u32,
        crc: blob::CRC.checksum(&known.bytes),
        replaces_robot: true,
    };
    // Without a key, with one, and while the owner's next announcement waits for its upload.
    for (provisioned, announced) in [(false, false), (true, false), (true, true)] {
        let mut desk = Desk::default();
        let mut both = [&ours, &theirs].map(|known| signed_as(1, known, &key(1)));
        if provisioned {
            let public_key = public(&key(1));
            desk.ask(&Request::Provision { public_key });
        }
        let [ours, theirs] = &mut both;
        ours.install(&mut desk);
        assert_eq!(theirs.upload(&mut desk), refused(Refusal::AnotherRobot));
        assert_eq!(desk.active(), Some(ours.blob_crc));
        let request = replace(theirs);
        if provisioned {
            assert_eq!(desk.ask(&request), refused(Refusal::NotSigned));
            let begun = desk.ask_signed(&request, &key(1));
            assert_eq!(begun, Response::Uploading { received: 0 });
        } else {
            assert_eq!(desk.ask(&request), Response::Uploading { received: 0 });
        }
        for (index, piece) in theirs.bytes.chunks(256).enumerate() {
            let offset = 256 * index as u32;
            desk.ask(&Request::UploadChunk {
                offset,
                bytes: piece,
            });
        }
        assert!(matches!(
            desk.ask(&Request::VerifyUpload),
            Response::Verified(_)
        ));
        desk.ask(&Request::CommitUpload);
        desk.ask(&theirs.activate());
        assert_eq!(desk.active(), Some(theirs.blob_crc));
        if announced {
            desk.ask_signed(&replace(theirs), &key(1));
        }
        if provisioned {
            // Nor does the other one come back unsigned, even with the same revision.
            let back = desk.ask(&ours.activate());
            assert_eq!(back, refused(Refusal::AnotherRobot));
        }
        // The permission was for one upload only.
        assert_eq!(
            upload(&mut desk, &ours.bytes),
            refused(Refusal::AnotherRobot)
        );
    }
}

/// A device whose key cannot be read refuses every request that needs a signature.
#[test]
fn a_damaged_key_takes_no_order() {
    let (mut desk, [_, new]) = owned();
    let page = super::desk::layout().key;
    desk.flash.borrow_mut().bytes_mut()[page.start as usize..page.end as usize].fill(0);
    let damaged = refused(Refusal::Store { code: 15 });
    for request in [new.roll_back(), BYPASS_OFF, Request::Restart] {
        assert_eq!(desk.ask(&request), damaged);
        assert_eq!(desk.ask_signed(&request, &key(1)), damaged);
    }
    let on = desk.ask(&Request::SetBypass { on: true });
    assert!(matches!(on, Response::Identity(_)));
}

/// Every request to an owned device, without the key; SECURITY.md has the same table.
#[test]
fn what_each_message_may_without_the_key() {
    let page = include_str!("../../../../SECURITY.md");
    let heading = "\n## What each message may without the key\n";
    let (_, section) = page.split_once(heading).expect("a section");
    let section = section.split("\n## ").next().unwrap_or("");
    let documented = |name: &str| {
        let row = section
            .lines()
            .find(|line| line.starts_with(&format!("| `{name}` |")));
        let row = row.unwrap_or_else(|| panic!("{name} is not in SECURITY.md"));
        row.split('|').nth(2).expect("a column").trim().to_owned()
    };
    let settings = CycleSettings {
        period_us: 2_000,
        ..owned().0.identity().cycle
    };
    let (_, [_, new]) = owned();
    for message in REQUESTS {
        // Each request in a form that would change something.
        let request = match message.name {
            "Identify" => Request::Identify,
            "Evaluate" => Request::Evaluate(query(&[0.1, 0.2], 1.0)),
            "Correct" => Request::Correct(query(&[0.1, 0.2], 1.0)),
            "Trace" => Request::Trace(query(&[0.1, 0.2], 1.0)),
            "Command" => Request::Command(query(&[0.1, 0.2], 1.0)),
            "StopCyclic" => Request::StopCyclic,
            "BeginUpload" => begin(&new.bytes),
            "UploadChunk" => Request::UploadChunk {
                offset: 0,
                bytes: &new.bytes[..8],
            },
            "VerifyUpload" => Request::VerifyUpload,
            "CommitUpload" => Request::CommitUpload,
            "Activate" => new.activate(),
            "RollBack" => new.roll_back(),
            "SetBypass" => BYPASS_OFF,
            "Provision" => Request::Provision {
                public_key: public(&key(2)),
            },
            "ReadStatistics" => Request::ReadStatistics,
            "Restart" => Request::Restart,
            "ProvisionCycle" => Request::ProvisionCycle(settings),
            "Challenge" => Request::Challenge,
            "Signed" => Request::Signed {
                signature: &[7; 64],
                request: &[14],
            },
            other => panic!("{other} is new: add it to this test and to SECURITY.md"),
        };
        let (mut desk, _) = owned();
        desk.ask(&begin(&new.bytes));
        command(&mut desk);
        let before = desk.identity();
        let answer = desk.ask(&request);
        let found = match answer {
            Response::Refused(Refusal::NotSigned) => "signed only",
            Response::Refused(Refusal::WrongSignature | Refusal::KeyIsFixed) => "no",
            _ => "yes",
        };
        assert_eq!(
            documented(message.name),
            found,
            "{}: {answer:?}",
            message.name
        );
        // In every case the models and settings stay, the bypass does not end, and the device continues.
        let after = desk.identity();
        assert_eq!(
            (
                after.model,
                after.slots,
                after.cycle,
                after.key,
                after.bypass
            ),
            (
                before.model,
                before.slots,
                before.cycle,
                before.key,
                before.bypass
            )
        );
        assert!(!desk.restarting);
        // The owner may send everything that needs a signature.
        if found == "signed only" {
            let answer = desk.ask_signed(&request, &key(1));
            assert!(!matches!(answer, Response::Refused(_)), "{answer:?}");
        }
    }
    assert_eq!(
        section
            .lines()
            .filter(|line| line.starts_with("| `"))
            .count(),
        REQUESTS.len() + 3
    );
    // The rows for messages whose permission depends on their fields or on earlier messages.
    let (mut desk, _) = owned();
    assert_eq!(documented("StopCyclic`, before the first `Command"), "yes");
    assert_eq!(desk.ask(&Request::StopCyclic), Response::CyclicStopped);
    assert_eq!(documented("SetBypass { on }"), "yes");
    assert!(matches!(
        desk.ask(&Request::SetBypass { on: true }),
        Response::Identity(_)
    ));
    assert_eq!(documented("BeginUpload { replaces_robot }"), "signed only");
    let request = Request::BeginUpload {
        length: 8,
        crc: 0,
        replaces_robot: true,
    };
    assert_eq!(desk.ask(&request), refused(Refusal::NotSigned));
}

/// While a controller sends commands, only the owner may stop the cycle. Without a provisioned key, anybody may.
#[test]
fn standing_down_under_a_controller_is_the_owners() {
    let (mut desk, _) = owned();
    desk.ask(&Request::Evaluate(query(&[0.1, 0.2], 1.0)));
    assert_eq!(desk.ask(&Request::StopCyclic), Response::CyclicStopped);
    command(&mut desk);
    assert_eq!(desk.ask(&Request::StopCyclic), refused(Refusal::NotSigned));
    assert!(desk.is_running());
    assert_eq!(
        desk.ask_signed(&Request::StopCyclic, &key(1)),
        Response::CyclicStopped
    );
    assert!(!desk.is_running());
    // After the stop, the state is as before the first command.
    assert_eq!(desk.ask(&Request::StopCyclic), Response::CyclicStopped);
    let mut without = Desk::default();
    command(&mut without);
    assert_eq!(without.ask(&Request::StopCyclic), Response::CyclicStopped);
}
