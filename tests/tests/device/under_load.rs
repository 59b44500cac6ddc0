//! Corrections while the background is busy with a signature, an upload or flash. Time is counted in instructions (QEMU
//! `-icount`), so that the load of this machine does not matter.

use poegp_protocol::blob;
use poegp_protocol::blob::CRC;
use poegp_protocol::link::{MAX_CHUNK, MAX_SIGNED, Query, Request, Response};
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::{CommandBits, Host};
use poegp_trainer::signing::SecretKey;

/// Most instructions from the last byte of a correction to its answer, whatever the background does: the correction itself
/// (at most 40 000), its frame, the answer's frame, and one frame of an upload before it.
const BOUND: f64 = 52_000.0;

/// A controller that asks all the time.
struct Controller {
    queries: Vec<Query>,
    asked: usize,
    /// Each model's CRC, with the model on the host.
    models: Vec<(u32, Host)>,
}

impl Controller {
    /// Asks for one correction after the other until the service is answered. Returns how many were answered before.
    fn during(&mut self, device: &mut Device, request: &Request<'_>) -> (Response, usize) {
        let (service, frame) = device.frame(request);
        device.send_bytes(&frame).unwrap();
        let (mut answered, mut count) = (None, 0);
        loop {
            let query = self.queries[self.asked % self.queries.len()].clone();
            self.asked += 1;
            let (sequence, frame) = device.frame(&Request::Correct(query.clone()));
            device.send_bytes(&frame).unwrap();
            loop {
                match device.receive().unwrap().expect("an answer") {
                    (number, response) if number == service => answered = Some(response),
                    (number, Response::Corrected(corrected)) if number == sequence => {
                        let model = |(crc, _): &&(u32, Host)| *crc == corrected.blob_crc;
                        let (_, host) = self.models.iter().find(model).expect("a known model");
                        assert_eq!(CommandBits::from(&corrected), host.command(&query));
                        break;
                    }
                    other => panic!("{other:?}"),
                }
            }
            match answered {
                Some(response) => return (response, count),
                None => count += 1,
            }
        }
    }

    /// Loads a blob as [`Device::load`] does, with corrections meanwhile. Returns how many were answered during each
    /// service.
    fn load(&mut self, device: &mut Device, bytes: &[u8]) -> Vec<(&'static str, usize)> {
        let begin = Request::BeginUpload {
            length: bytes.len() as u32,
            crc: CRC.checksum(bytes),
            replaces_robot: false,
        };
        self.during(device, &begin);
        let mut pieces = 0;
        for (index, bytes) in bytes.chunks(MAX_CHUNK).enumerate() {
            let offset = (index * MAX_CHUNK) as u32;
            let (answer, count) = self.during(device, &Request::UploadChunk { offset, bytes });
            assert!(matches!(answer, Response::Uploading { .. }), "{answer:?}");
            pieces += count;
        }
        let (answer, verify) = self.during(device, &Request::VerifyUpload);
        assert!(
            matches!(&answer, Response::Verified(model) if model.revision.is_some()),
            "{answer:?}"
        );
        let (answer, commit) = self.during(device, &Request::CommitUpload);
        assert!(matches!(answer, Response::Committed(_)), "{answer:?}");
        let blob_crc = blob::stored_crc(bytes).unwrap();
        let (answer, activate) = self.during(device, &Request::Activate { blob_crc });
        assert!(matches!(answer, Response::Identity(_)), "{answer:?}");
        vec![
            ("pieces", pieces),
            ("verify", verify),
            ("commit", commit),
            ("activate", activate),
        ]
    }
}

#[test]
fn a_correction_does_not_wait_for_services() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    let key = SecretKey::generate().unwrap();
    device.client().provision(key.public().bytes()).unwrap();
    device.client().set_signer(key.signer());
    let elastic = |seed| Sample::plain(seed, SampleCorrection::Elastic(Elastic::PLAIN));
    let blobs = [elastic(110), elastic(111), elastic(112)]
        .map(|sample| key.sign(&sample.blob(), 1).unwrap());
    let mut controller = Controller {
        queries: elastic(110).queries(32),
        asked: 0,
        models: blobs
            .iter()
            .map(|bytes| (blob::stored_crc(bytes).unwrap(), Host::load(bytes).unwrap()))
            .collect(),
    };
    device.load(&blobs[0]).unwrap();
    for query in &controller.queries {
        device.correct(query).unwrap();
    }
    let tick_hz = device.identify().unwrap().tick_hz;
    let quiet = device.statistics().unwrap();

    // Chance decides how many corrections meet a service; a busy machine needs more services.
    let mut counts: Vec<(&str, usize)> = Vec::new();
    let during = |counts: &[(&str, usize)], names: &[&str]| -> usize {
        let named = counts.iter().filter(|(of, _)| names.contains(of));
        named.map(|(_, count)| count).sum()
    };
    for _ in 0..30 {
        for bytes in [1, 2, 0, 1].map(|index: usize| &blobs[index]) {
            counts.extend(controller.load(&mut device, bytes));
        }
        let from_crc = blob::stored_crc(&blobs[1]).unwrap();
        let Response::Challenge { nonce } = device.request(&Request::Challenge).unwrap() else {
            panic!("no challenge")
        };
        let mut buffer = [0; MAX_SIGNED];
        let request = Request::RollBack { from_crc }.encode(&mut buffer).unwrap();
        let signed = Request::Signed {
            signature: &key.sign_request(&nonce, request).unwrap(),
            request,
        };
        let (answer, count) = controller.during(&mut device, &signed);
        assert!(matches!(answer, Response::Identity(_)), "{answer:?}");
        counts.push(("roll back", count));
        if during(&counts, &["verify"]) >= 20 && during(&counts, &["commit", "roll back"]) >= 2 {
            break;
        }
    }

    let busy = device.statistics().unwrap();
    println!(
        "corrections answered while a service was carried out, instructions from the last byte to the answer:"
    );
    println!("  {counts:?}");
    let in_instructions = |ticks| instructions(ticks, tick_hz);
    println!(
        "  quiet: at most {:.0}, {:.0} of them the correction; busy: {:.0}, {:.0}",
        in_instructions(quiet.max_latency_ticks),
        in_instructions(quiet.max_ticks),
        in_instructions(busy.max_latency_ticks),
        in_instructions(busy.max_ticks)
    );
    assert!(during(&counts, &["verify"]) >= 20, "{counts:?}");
    assert!(during(&counts, &["commit", "roll back"]) >= 2, "{counts:?}");
    assert!(in_instructions(busy.max_latency_ticks) <= BOUND);
    assert_eq!((busy.missed_deadlines, busy.restarts), (0, 0));
}
